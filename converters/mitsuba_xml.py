"""Build Mitsuba scene files as trees of XML elements.

Mitsuba computes with float32, in which a number beyond its range would become infinite.  Therefore
every function raises `ConversionError` if it is given such a number.
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

    The file begins with `FILE_START` and the comment, a text about the conversion.  The elements
    are plugins: integrator, sensor, lights, BSDFs and shapes.
    """

    def __init__(self, comment: str, elements: Iterable[Element]) -> None:
        self.comment = comment
        self.root = Element("scene", version="3.0.0")
        self.root.extend(elements)

    def __str__(self) -> str:
        return f"{FILE_START}, {self.comment.strip()}\n-->{_format_element(self.root)}\n"


def _format_element(element: Element[Any], line_start: str = "\n") -> str:
    """Format an XML element and all its descendants as lines, each preceded by its line break.

    `line_start` is the line break and the indentation of the element.

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

    Parameters
    ----------
    tag
        Kind of the plugin, such as "sensor" or "bsdf".
    plugin_type
        Mitsuba's name for the type of the plugin, such as "perspective" or "diffuse".
    *children
        Nested plugins, and parameters that consist of several numbers.
    name
        Name by which other plugins refer to this one.
    **parameters
        Parameters with a single value.
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
    """Create the XML element for three numbers: a point, a vector, a scaling or a translation.

    `name` is the parameter of a plugin that the numbers set.  It is None if they are a part of a
    transform.
    """
    attributes = {} if name is None else {"name": name}
    x, y, z = [_format_number(name or tag, component) for component in components]
    return Element(tag, attributes, x=x, y=y, z=z)


def make_color(name: str, color: Iterable[float]) -> Element:
    """Create the XML element for a colour, in linear RGB, that sets a plugin parameter."""
    return Element("rgb", name=name, value=_format_numbers(name, color))


def make_transform(name: str, matrix_rows: Iterable[Iterable[float]]) -> Element:
    """Create the XML element for a 4 x 4 matrix that sets a plugin parameter, a transform."""
    element = Element("transform", name=name)
    numbers = (number for row in matrix_rows for number in row)
    SubElement(element, "matrix", value=_format_numbers(name, numbers))
    return element


def _format_number(parameter_name: str, value: float) -> str:
    """Format a number as the shortest text that denotes the same float64 number.

    Raise `ConversionError`, with the parameter's name, for NaN and for numbers beyond the range of
    float32.
    """
    if not abs(value) <= _MAX_FLOAT32:  # also if it is NaN
        raise ConversionError(
            f"{parameter_name} would be {value:g}, but Mitsuba's numbers end at {_MAX_FLOAT32:.2g};"
            " keep the numbers of the scene closer to 1"
        )
    return repr(float(value))


def _format_numbers(parameter_name: str, values: Iterable[float]) -> str:
    return " ".join(_format_number(parameter_name, value) for value in values)
