"""Tables of the elements of each kind: their numbers in columns, converted many at a time."""

from __future__ import annotations

import re
from array import array
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import MISSING, fields
from itertools import repeat
from typing import Any

import numpy as np

from tracer.arrays import Floats
from tracer.scene.elements import Element
from tracer.scene.schema import Numbers, unchecked

__all__ = ["PLACE", "Column", "Table", "decimals", "numbers", "words"]

PLACE = Numbers(1)
"""The kind of a shader in a surface: its place among all shaders."""


class Column:
    """One element of all that a table's rows hold: their numbers, as far as these are given."""

    __slots__ = ("default", "kind", "lines", "name", "numbers", "rows", "tag", "unread")

    def __init__(self, name: str, tag: str, kind: Numbers, default: Any) -> None:
        self.name, self.tag, self.kind, self.default = name, tag, kind, default
        # Of each element: the row, the line, and its numbers, NaN for those with a fault.
        self.rows, self.lines, self.numbers = array("i"), array("i"), array("d")
        # The elements that come next.
        self.unread: list[Element] = []

    def given(self) -> Floats:
        """The numbers that are given (n, count)."""
        return np.asarray(self.numbers).reshape(-1, self.kind.count)


class Table:
    """All elements that make a dataclass, in rows, as its fields' metadata describe them."""

    def __init__(self, made: type) -> None:
        self.made = made
        self.columns: dict[str, Column] = {}
        # Of each row, the line, and the place among all shaders or surfaces.
        self.lines, self.index = array("i"), array("i")
        for each in fields(made):
            kind, default = each.metadata.get("kind"), each.default
            if not isinstance(kind, Numbers):
                kind, default = PLACE, 0
            for tag in each.metadata.get("tags", ()):
                self.columns[tag] = Column(each.name, tag, kind, default)
        self.required = [c for c in self.columns.values() if c.default is MISSING]

    def values(self, name: str) -> Floats:
        """The numbers of a field (n, count), its default or NaN where none are given."""
        columns = [column for column in self.columns.values() if column.name == name]
        kind, default = columns[0].kind, columns[0].default
        if len(columns[0].rows) == len(self.lines):
            return columns[0].given()
        values = np.full((len(self.lines), kind.count), np.nan if default is MISSING else default)
        for column in columns:
            values[np.asarray(column.rows)] = column.given()
        return values

    def objects(self) -> Iterator[Any]:
        """Make the dataclass of each row, whose numbers are known to be right."""
        columns: dict[str, Iterable[Any]] = {"line": self.lines}
        for column in self.columns.values():
            if column.rows:
                each = self.values(column.name).T.tolist()
                columns[column.name] = zip(*each, strict=True) if len(each) > 1 else each[0]
            else:
                columns.setdefault(column.name, repeat(column.default))  # one tuple for all
        names = [each.name for each in fields(self.made)]
        used = [columns[name] for name in names]
        for _, *row in zip(self.lines, *used, strict=False):
            yield unchecked(self.made, **dict(zip(names, row, strict=True)))


def numbers(elements: Sequence[Element], count: int) -> list[float] | None:
    """The numbers in all `elements`; None unless each surely holds `count`, and nothing else."""
    if any(map(len, elements)) or any(element.attrib for element in elements):
        return None
    # One text for all: to read each by itself takes longer than to make a number of it.
    text = " ; ".join([element.text for element in elements])
    found = text.split()
    between = found[count :: count + 1]
    del found[count :: count + 1]
    if len(found) != count * len(elements) or between != [";"] * (len(elements) - 1):
        return None
    return decimals(found, text)


def words(text: str) -> list[str]:
    """Split at XML's white space; str.split() knows more kinds."""
    return re.findall("[^ \t\r\n]+", text)


def decimals(words: list[str], text: str) -> list[float] | None:
    """Read the decimal numbers of a text, given its words; None if any is none.

    Some words that float() accepts are none: 1_0, nan, infinity, and digits of other scripts.
    """
    if not text.isascii() or any(map(text.__contains__, "_nN")):
        return None
    try:
        return [*map(float, words)]
    except ValueError:
        return None
