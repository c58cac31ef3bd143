"""Build Mitsuba's scene files as trees of XML elements.

Mitsuba computes with float32.  Numbers beyond its range would become infinite; they are refused.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any
from xml.etree import ElementTree as ET
from xml.etree.ElementTree import Element

__all__ = ["HEAD", "ConversionError", "Document", "matrix", "plugin", "rgb", "xyz"]

HEAD = "<!--\nWritten by converters.to_mitsuba"
"""The beginning of every converted scene."""

_MAX_FLOAT32 = (2 - 2**-23) * 2.0**127

# Names of Mitsuba's parameters by the types of their values.
_PARAMETER_TAGS = {bool: "boolean", int: "integer", float: "float", str: "string"}


class ConversionError(ValueError):
    """A scene that Mitsuba cannot represent; the message contains a suggested fix."""


@dataclass(frozen=True)
class Document:
    """A converted scene; its `str` is the content of the file.

    Attributes
    ----------
    comment : str
        Text about the whole scene, which follows the file's `HEAD`.
    root : Element
        The scene.
    """

    comment: str
    root: Element

    def __str__(self) -> str:
        ET.indent(self.root, "    ")
        text = ET.tostring(self.root, encoding="unicode")
        return f"{HEAD}, {self.comment.strip()}\n-->\n{text}\n"


def plugin(
    tag: str,
    plugin_type: str,
    *children: Element[Any],
    name: str | None = None,
    **parameters: bool | int | float | str,
) -> Element:
    """Create the XML element of a Mitsuba plugin.

    Parameters
    ----------
    tag : str
        Kind of the plugin, such as "sensor" or "bsdf".
    plugin_type : str
        Mitsuba's name of the plugin, such as "perspective" or "diffuse".
    *children : Element
        Parameters that consist of several numbers, and plugins inside this one.
    name : str, optional
        Identifier by which other plugins refer to this one.
    **parameters : bool, int, float or str
        Parameters that have a single value, by their names.

    Returns
    -------
    element : Element
        The new element.  It contains an element for each parameter, then the children.

    Raises
    ------
    ConversionError
        If a number is beyond the range of float32.
    """
    element = Element(tag, {"type": plugin_type} | ({} if name is None else {"id": name}))
    for key, value in parameters.items():
        text = _format_number(key, value) if isinstance(value, float) else str(value)
        text = text.lower() if isinstance(value, bool) else text
        ET.SubElement(element, _PARAMETER_TAGS[type(value)], name=key, value=text)
    element.extend(children)
    return element


def xyz(tag: str, name: str | None, value: Iterable[float]) -> Element:
    """Create the XML element of a parameter with the components x, y and z.

    Parameters
    ----------
    tag : str
        Kind of the parameter, such as "point", "vector" or "translate".
    name : str or None
        Name of the parameter; None for a step of a transform, which has no name.
    value : iterable of three floats
        The components.

    Returns
    -------
    element : Element
        The new element.

    Raises
    ------
    ConversionError
        If a number is beyond the range of float32.
    """
    numbers = {axis: _format_number(name or tag, x) for axis, x in zip("xyz", value, strict=True)}
    return Element(tag, ({} if name is None else {"name": name}) | numbers)


def rgb(name: str, value: Iterable[float]) -> Element:
    """Create the XML element of a colour.

    Parameters
    ----------
    name : str
        Name of the parameter.
    value : iterable of three floats
        Linear red, green and blue.

    Returns
    -------
    element : Element
        The new element.

    Raises
    ------
    ConversionError
        If a number is beyond the range of float32.
    """
    return Element("rgb", name=name, value=_format_numbers(name, value))


def matrix(name: str, rows: Iterable[Iterable[float]]) -> Element:
    """Create the XML element of a transform from its matrix.

    Parameters
    ----------
    name : str
        Name of the parameter.
    rows : iterable of four iterables of four floats
        The matrix, row by row.

    Returns
    -------
    element : Element
        The new element.

    Raises
    ------
    ConversionError
        If a number is beyond the range of float32.
    """
    element = Element("transform", name=name)
    ET.SubElement(element, "matrix", value=_format_numbers(name, (x for row in rows for x in row)))
    return element


def _format_number(name: str, value: float) -> str:
    """Format a number as text.

    Parameters
    ----------
    name : str
        Name of the parameter, for the error message.
    value : float
        The number.

    Returns
    -------
    text : str
        The shortest text that denotes the same float64 number.

    Raises
    ------
    ConversionError
        If the number is NaN, or beyond the range of float32.
    """
    if not abs(value) <= _MAX_FLOAT32:
        raise ConversionError(
            f"{name} would be {value:g}, and Mitsuba's numbers end at {_MAX_FLOAT32:.2g};"
            " keep the numbers of the scene closer to 1"
        )
    return repr(float(value))


def _format_numbers(name: str, values: Iterable[float]) -> str:
    """Format numbers as one text, separated by spaces.

    Parameters
    ----------
    name : str
        Name of the parameter, for the error message.
    values : iterable of float
        The numbers.

    Returns
    -------
    text : str
        The numbers, each as from `_format_number`.

    Raises
    ------
    ConversionError
        If a number is NaN, or beyond the range of float32.
    """
    return " ".join(_format_number(name, value) for value in values)
