"""Build Mitsuba scene files as trees of XML elements.

Mitsuba computes with float32.  A number beyond the range of float32 would become infinite, so it
raises an error.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any
from xml.etree.ElementTree import Comment, Element, SubElement

FILE_START = "<!--\nWritten by converters.to_mitsuba"
"""The beginning of every converted scene."""

_MAX_FLOAT32 = (2 - 2**-23) * 2.0**127

# Mitsuba's tags for parameters, by the Python types of their values.
_PARAMETER_TAGS = {bool: "boolean", int: "integer", float: "float", str: "string"}


class ConversionError(ValueError):
    """Raised if Mitsuba cannot represent a scene; the message contains a suggested fix."""


class Document:
    """A converted scene; its `str` is the content of the Mitsuba scene file.

    Parameters
    ----------
    comment : str
        Text about the conversion, which follows `FILE_START` at the beginning of the file.
    elements : iterable of Element
        The plugins of the scene: integrator, sensor, lights, BSDFs and shapes.

    Attributes
    ----------
    root : Element
        The root element of the file, which contains the plugins.
    """

    def __init__(self, comment: str, elements: Iterable[Element]) -> None:
        self.comment, self.root = comment, Element("scene", version="3.0.0")
        self.root.extend(elements)

    def __str__(self) -> str:
        return f"{FILE_START}, {self.comment.strip()}\n-->{_format_element(self.root)}\n"


def _format_element(element: Element[Any], line_start: str = "\n") -> str:
    """Format an XML element and all its descendants as text.

    This is about twice as fast as ElementTree.  Attribute values are not escaped, because converted
    scenes contain no characters that need it.

    Parameters
    ----------
    element : Element
        The element, or a comment.
    line_start : str
        The line break and the indentation that precede the element.

    Returns
    -------
    text : str
        The lines of the element, each preceded by a line break.
    """
    if element.tag is Comment:
        return f"{line_start}<!--{element.text}-->"
    attributes = "".join([f' {name}="{value}"' for name, value in element.items()])
    start_tag = f"{line_start}<{element.tag}{attributes}"
    if not len(element):
        return f"{start_tag} />"
    children = "".join([_format_element(child, line_start + "    ") for child in element])
    return f"{start_tag}>{children}{line_start}</{element.tag}>"


def make_plugin(
    tag: str,
    plugin_type: str,
    *children: Element[Any],
    name: str | None = None,
    **parameters: bool | int | float | str,
) -> Element:
    """Create the XML element for a Mitsuba plugin.

    Parameters
    ----------
    tag : str
        Kind of the plugin, such as "sensor" or "bsdf".
    plugin_type : str
        Mitsuba's name for the type of the plugin, such as "perspective" or "diffuse".
    *children : Element
        Child elements: nested plugins, and parameters that consist of several numbers.
    name : str, optional
        Name by which other plugins refer to this one.
    **parameters : bool, int, float or str
        Parameters with a single value.

    Returns
    -------
    element : Element
        The new element.  It contains an element for each parameter, and then the children.

    Raises
    ------
    ConversionError
        If a number is beyond the range of float32.
    """
    element = Element(tag, {"type": plugin_type} | ({} if name is None else {"id": name}))
    for parameter_name, value in parameters.items():
        text = _format_number(parameter_name, value) if isinstance(value, float) else str(value)
        text = text.lower() if isinstance(value, bool) else text
        SubElement(element, _PARAMETER_TAGS[type(value)], name=parameter_name, value=text)
    element.extend(children)
    return element


def make_vector(tag: str, name: str | None, components: Iterable[float]) -> Element:
    """Create the XML element for a point or vector, with the attributes x, y and z.

    Parameters
    ----------
    tag : str
        Tag of the element, such as "point", "vector" or "translate".
    name : str or None
        Name of the plugin parameter that the vector sets; None for a part of a transform.
    components : iterable of three floats
        The components x, y and z.

    Returns
    -------
    element : Element
        The new element.

    Raises
    ------
    ConversionError
        If a component is beyond the range of float32.
    """
    attributes = {} if name is None else {"name": name}
    x, y, z = [_format_number(name or tag, component) for component in components]
    return Element(tag, attributes, x=x, y=y, z=z)


def make_color(name: str, color: Iterable[float]) -> Element:
    """Create the XML element for a colour.

    Parameters
    ----------
    name : str
        Name of the plugin parameter that the colour sets.
    color : iterable of three floats
        Linear red, green and blue components.

    Returns
    -------
    element : Element
        The new element.

    Raises
    ------
    ConversionError
        If a number is beyond the range of float32.
    """
    return Element("rgb", name=name, value=_format_numbers(name, color))


def make_transform(name: str, matrix_rows: Iterable[Iterable[float]]) -> Element:
    """Create the XML element for a transform that is given by a matrix.

    Parameters
    ----------
    name : str
        Name of the plugin parameter that the transform sets.
    matrix_rows : iterable of four iterables of four floats
        The rows of the matrix.

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
    numbers = (number for row in matrix_rows for number in row)
    SubElement(element, "matrix", value=_format_numbers(name, numbers))
    return element


def _format_number(parameter_name: str, value: float) -> str:
    """Format a number as text, after checking that float32 can represent it.

    Parameters
    ----------
    parameter_name : str
        Name of the plugin parameter, for the error message.
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
            f"{parameter_name} would be {value:g}, but Mitsuba's numbers end at {_MAX_FLOAT32:.2g};"
            " keep the numbers of the scene closer to 1"
        )
    return repr(float(value))


def _format_numbers(parameter_name: str, values: Iterable[float]) -> str:
    """Format several numbers as one string, separated by spaces.

    Parameters
    ----------
    parameter_name : str
        Name of the plugin parameter, for the error message.
    values : iterable of float
        The numbers.

    Returns
    -------
    text : str
        For each number, the shortest text that denotes the same float64 number.

    Raises
    ------
    ConversionError
        If a number is NaN, or beyond the range of float32.
    """
    return " ".join(_format_number(parameter_name, value) for value in values)
