"""Build Mitsuba scene files as trees of XML elements.

A Mitsuba scene consists of *plugins*: an integrator, a sensor, lights, shapes and so on.  Each is
an XML element, with child elements for its parameters and for the plugins that it contains.

Mitsuba computes with float32.  All functions here that take numbers raise `ConversionError` for a
NaN, and for a number that would become infinite in float32.
"""

from __future__ import annotations

from collections.abc import Iterable
from itertools import chain
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
    """A converted scene.  Its `str` is the content of the Mitsuba scene file.

    `elements` are the plugins of the scene.  `comment` describes the conversion: it continues the
    sentence `FILE_START` at the beginning of the file.
    """

    def __init__(self, comment: str, elements: Iterable[Element]) -> None:
        self.comment = comment
        self.root = Element("scene", version="3.0.0")
        self.root.extend(elements)

    def __str__(self) -> str:
        return f"{FILE_START}, {self.comment.strip()}\n-->{_format_element(self.root)}\n"


def _format_element(element: Element[Any], line_start: str = "\n") -> str:
    """Format an XML element and all its descendants, each on a line of its own.

    The result begins with `line_start`: a line break, and the indentation of the element.

    This is about twice as fast as ElementTree.  Attribute values are not escaped, because converted
    scenes contain no characters that need it.
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
    """Create the XML element for a Mitsuba plugin, with its parameters and then its children.

    Raise `ConversionError` if Mitsuba cannot represent one of the parameters.

    Parameters
    ----------
    tag
        Kind of the plugin, such as "sensor" or "bsdf".
    plugin_type
        Mitsuba's name for the type of the plugin, such as "perspective" or "diffuse".
    *children
        Plugins that this one contains, and parameters that consist of several numbers.
    name
        Name by which other plugins refer to this one.
    **parameters
        Mitsuba's parameters.  Each value is a bool, an int, a float or a str.
    """
    element = Element(tag, type=plugin_type)
    if name is not None:
        element.set("id", name)
    for parameter_name, value in parameters.items():
        if isinstance(value, float):
            text = _format_number(parameter_name, value)
        elif isinstance(value, bool):
            text = str(value).lower()
        else:
            text = str(value)
        SubElement(element, _PARAMETER_TAGS[type(value)], name=parameter_name, value=text)
    element.extend(children)
    return element


def make_vector(tag: str, name: str | None, components: Iterable[float]) -> Element:
    """Create an XML element of three numbers.

    `tag` is "point" or "vector" for a parameter of a plugin, and then `name` is the name of the
    parameter.  In a transform, `tag` is "scale" or "translate", and `name` is None.  Raise
    `ConversionError` if Mitsuba cannot represent a number.
    """
    attributes = {} if name is None else {"name": name}
    x, y, z = [_format_number(name or tag, component) for component in components]
    return Element(tag, attributes, x=x, y=y, z=z)


def make_color(name: str, color: Iterable[float]) -> Element:
    """Create the XML element that sets a parameter of a plugin to a linear RGB colour.

    Raise `ConversionError` if Mitsuba cannot represent a component of the colour.
    """
    return Element("rgb", name=name, value=_format_numbers(name, color))


def make_transform(name: str, matrix_rows: Iterable[Iterable[float]]) -> Element:
    """Create the XML element that sets a parameter of a plugin to a transform, a 4 x 4 matrix.

    Raise `ConversionError` if Mitsuba cannot represent an element of the matrix.
    """
    element = Element("transform", name=name)
    SubElement(element, "matrix", value=_format_numbers(name, chain.from_iterable(matrix_rows)))
    return element


def _format_number(parameter_name: str, value: float) -> str:
    """Format a number as the shortest text that denotes the same float64 number.

    Raise `ConversionError`, with the name of the parameter that the number sets, for NaN and for
    numbers beyond the range of float32.
    """
    if not abs(value) <= _MAX_FLOAT32:  # also if it is NaN
        raise ConversionError(
            f"{parameter_name} would be {value:g}, but Mitsuba's numbers end at {_MAX_FLOAT32:.2g};"
            " keep the numbers of the scene closer to 1"
        )
    return repr(float(value))


def _format_numbers(parameter_name: str, values: Iterable[float]) -> str:
    return " ".join(_format_number(parameter_name, value) for value in values)
