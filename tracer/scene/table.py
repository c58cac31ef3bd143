"""Tables of the elements of each kind: their numbers in columns, converted many at a time."""

from __future__ import annotations

from array import array
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import MISSING, Field, fields
from itertools import repeat
from typing import Any

import numpy as np

from tracer.arrays import Floats
from tracer.scene.schema import Numbers, unchecked


class Column:
    """A field of all objects of a table: their numbers."""

    __slots__ = ("default", "kind", "numbers", "required", "tag", "unread")

    def __init__(self, field: Field[Any]) -> None:
        self.kind: Numbers = field.metadata["kind"]
        self.tag = field.metadata["tags"][0]
        self.required = field.default is MISSING
        self.default: Any = np.nan if field.default in (MISSING, None) else field.default
        self.numbers = array("d")
        # The elements that come next; None where one is not given.
        self.unread: list[Any] = []

    def given(self) -> Floats:
        """The numbers of all rows (n, count)."""
        return np.reshape(self.numbers, (-1, self.kind.count))

    def values(self) -> Iterable[Any]:
        """The same as they stand in a dataclass."""
        given = self.given()
        if (given == self.default).all():
            return repeat(self.default, len(given))  # one tuple for all
        columns = given.T.tolist()
        return zip(*columns, strict=True) if len(columns) > 1 else columns[0]


class Table:
    """All elements that make a dataclass, in rows, as its fields' metadata describe them."""

    def __init__(self, made: type) -> None:
        self.made = made
        tagged = [field for field in fields(made) if field.metadata]
        self.names = {tag: field.name for field in tagged for tag in field.metadata["tags"]}
        self.columns = {
            field.name: Column(field)
            for field in tagged
            if isinstance(field.metadata["kind"], Numbers)
        }
        # Of each row the line, the place among all shaders or surfaces, and a surface's shader.
        self.lines, self.index, self.shaders = array("i"), array("i"), array("i")

    def objects(self) -> Iterator[Any]:
        """Make the dataclass of each row, whose numbers are known to be right."""
        names = [field.name for field in fields(self.made)]
        columns = [self.columns[n].values() if n in self.columns else self.lines for n in names]
        for row in zip(*columns, strict=True):
            yield unchecked(self.made, **dict(zip(names, row, strict=True)))


def numbers(texts: Sequence[str], count: int) -> list[float] | None:
    """The numbers in all `texts`; None unless each surely holds `count`, and nothing else.

    Some words that float() accepts are no numbers: 1_0, nan, infinity, and digits of other scripts.
    """
    # One text for all: to read each by itself takes longer than to make a number of it.
    text = " ; ".join(texts)
    found = text.split()
    between = found[count :: count + 1]
    del found[count :: count + 1]
    if len(found) != count * len(texts) or between != [";"] * (len(texts) - 1):
        return None
    if not text.isascii() or any(map(text.__contains__, "_nN")):
        return None
    try:
        return [*map(float, found)]
    except ValueError:
        return None
