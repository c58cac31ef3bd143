"""Mitsuba's XML: plugins with their parameters, numbers within float32."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from xml.sax.saxutils import quoteattr

__all__ = ["WRITTEN", "document", "element", "matrix", "plugin", "rgb", "xyz"]

WRITTEN = "<!--\nWritten by converters.to_mitsuba"
"""How every converted scene begins."""

_LARGEST = (2 - 2**-23) * 2.0**127  # of float32


def element(head: str, *children: str) -> str:
    """An element that begins with a kind and attributes, its children indented."""
    if not children:
        return f"<{head}/>"
    body = "\n".join(children).replace("\n", "\n    ")
    return f"<{head}>\n    {body}\n</{head.split()[0]}>"


def plugin(
    kind: str,
    plugin: str,
    *children: str,
    name: str | None = None,
    **values: bool | int | float | str,
) -> str:
    """A plugin with parameters of one value, then others; `name` is the id for references to it."""
    label = "" if name is None else f" id={quoteattr(name)}"
    parameters = [_value(key, value) for key, value in values.items()]
    return element(f"{kind} type={quoteattr(plugin)}{label}", *parameters, *children)


def _value(name: str, value: bool | int | float | str) -> str:
    """A parameter of one value."""
    kind = {bool: "boolean", int: "integer", float: "float", str: "string"}[type(value)]
    text = _number(name, value) if isinstance(value, float) else str(value)
    text = text.lower() if kind == "boolean" else text
    return f'<{kind} name="{name}" value={quoteattr(text)}/>'


def _number(name: str, value: float) -> str:
    """The text of a number; raises ValueError if it is beyond float32."""
    if not abs(value) <= _LARGEST:
        raise ValueError(
            f"cannot be converted: {name} would be {value:g}, and Mitsuba's numbers end at"
            f" {_LARGEST:.2g}; keep the numbers of the scene closer to 1"
        )
    return repr(float(value))


def _numbers(name: str, values: Iterable[float]) -> str:
    return " ".join(_number(name, value) for value in values)


def xyz(kind: str, name: str | None, value: Iterable[float]) -> str:
    """A point, a vector or, without a name, a part of a transform."""
    label = "" if name is None else f' name="{name}"'
    x, y, z = (_number(name or kind, number) for number in value)
    return f'<{kind}{label} x="{x}" y="{y}" z="{z}"/>'


def rgb(name: str, value: Iterable[float]) -> str:
    """A colour, linear."""
    return f'<rgb name="{name}" value="{_numbers(name, value)}"/>'


def matrix(name: str, rows: Iterable[Iterable[float]]) -> str:
    """A transform by its matrix."""
    values = _numbers(name, (value for row in rows for value in row))
    return element(f'transform name="{name}"', f'<matrix value="{values}"/>')


def document(comment: str, parts: Sequence[str]) -> str:
    """A scene, after a comment on it."""
    body = "\n".join(parts)
    return f'{WRITTEN}, {comment.strip()}\n-->\n<scene version="3.0.0">\n{body}\n</scene>\n'
