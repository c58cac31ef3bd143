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
    """Return the element of a plugin.

    Parameters
    ----------
    tag : str
        Kind of the plugin, such as "sensor" or "bsdf".
    plugin_type : str
        Mitsuba's name of the plugin, such as "perspective" or "diffuse".
    *children : Element
        Parameters of several numbers, and plugins inside this one.
    name : str, optional
        Identifier by which other plugins refer to this one.
    **parameters : bool, int, float or str
        Parameters of one value.

    Returns
    -------
    element : Element

    Raises
    ------
    ConversionError
        If a number is beyond the range of float32.
    """
    element = Element(tag, {"type": plugin_type} | ({} if name is None else {"id": name}))
    for key, value in parameters.items():
        text = _number(key, value) if isinstance(value, float) else str(value)
        text = text.lower() if isinstance(value, bool) else text
        ET.SubElement(element, _PARAMETER_TAGS[type(value)], name=key, value=text)
    element.extend(children)
    return element


def xyz(tag: str, name: str | None, value: Iterable[float]) -> Element:
    """Return the element of a point, a vector or, without a name, a step of a transform."""
    numbers = {axis: _number(name or tag, x) for axis, x in zip("xyz", value, strict=True)}
    return Element(tag, ({} if name is None else {"name": name}) | numbers)


def rgb(name: str, value: Iterable[float]) -> Element:
    """Return the element of a colour, in linear RGB."""
    return Element("rgb", name=name, value=_numbers(name, value))


def matrix(name: str, rows: Iterable[Iterable[float]]) -> Element:
    """Return the element of a transform by its matrix (4, 4)."""
    element = Element("transform", name=name)
    ET.SubElement(element, "matrix", value=_numbers(name, (x for row in rows for x in row)))
    return element


def _number(name: str, value: float) -> str:
    """Return the text of a number; raise `ConversionError` if it is beyond float32's range."""
    if not abs(value) <= _MAX_FLOAT32:
        raise ConversionError(
            f"{name} would be {value:g}, and Mitsuba's numbers end at {_MAX_FLOAT32:.2g};"
            " keep the numbers of the scene closer to 1"
        )
    return repr(float(value))


def _numbers(name: str, values: Iterable[float]) -> str:
    """Return the text of several numbers, separated by spaces."""
    return " ".join(_number(name, value) for value in values)
