"""Tables of the elements in a scene file: one table for each dataclass, one row for each object.

Files may contain millions of objects.  Their numbers are therefore collected in arrays, validated
together at the end, and copied into the arrays of `Surfaces`, without an object for each surface.
Line numbers are stored beside the numbers, so that error messages can state them.
"""

from __future__ import annotations

import re
from array import array
from collections.abc import Iterable, Iterator
from dataclasses import MISSING, Field, fields
from itertools import repeat
from typing import Annotated as Shaped
from typing import Any, cast

import numpy as np

from tracer.arrays import Floats
from tracer.scene import schema
from tracer.scene.schema import NumberValidator, construct_unchecked

# Characters of decimal numbers.  float() accepts more: 1_0, nan, infinity.
_is_decimal = re.compile(r"[-+.0-9eE\s]*", re.ASCII).fullmatch

# Matches in text with numbers that may underflow to zero in float().
_may_underflow = re.compile(r"[eE]-|[0-9.]{300}").search
# Words that denote 0 exactly.
_is_zero = re.compile(r"[-+]?[0.]+([eE].*)?").fullmatch


def parse_numbers(text: str, number_count: int) -> list[float]:
    """Parse `number_count` decimal numbers that are separated by white space.

    Return an empty list if the text does not consist of exactly so many numbers, or if a number
    other than 0 would underflow to zero in float64.
    """
    words = text.split()
    try:
        numbers = [*map(float, words)] if len(words) == number_count and _is_decimal(text) else []
    except ValueError:
        return []
    if 0 in numbers and _may_underflow(text):  # a nonzero number may have become 0
        zero_words = (word for number, word in zip(numbers, words, strict=True) if number == 0)
        return numbers if all(map(_is_zero, zero_words)) else []
    return numbers


class Column:
    """The rows of a numeric field.

    A row is read from a child of the object's element, such as the <center> of a sphere.
    """

    validator: NumberValidator
    tags: tuple[str, ...]  # the tags that the child may have; nearly all fields have only one
    default: Any  # value if the child is absent; `dataclasses.MISSING` if it is required
    default_row: list[float]  # the numbers of the default; NaN if there is none
    numbers: array[float]  # row after row; NaN for unknown and invalid numbers
    lines: array[int]  # for each row, the line of the child; 0 if it is absent
    tag_indices: array[int]  # for each row, the index of the child's tag in `tags`

    def __init__(self, field: Field[Any]) -> None:
        self.validator = field.metadata["validator"]
        self.tags = field.metadata["tags"]
        self.default = field.default
        default_numbers: Any = np.nan if self.default in (MISSING, None) else self.default
        self.default_row = np.broadcast_to(default_numbers, self.validator.number_count).tolist()
        self.numbers = array("d")
        self.lines = array("i")
        self.tag_indices = array("b")

    def append(self, numbers: list[float], line: int, tag: str) -> None:
        """Append the numbers, the line and the tag of a child.

        If the child is absent, the caller gives `default_row`, 0 and any of the tags.
        """
        self.numbers.fromlist(numbers)  # takes half the time of extend()
        self.lines.append(line)
        self.tag_indices.append(self.tags.index(tag))

    def to_array(self) -> Shaped[Floats, "n count"]:
        return np.reshape(self.numbers, (-1, self.validator.number_count))

    def get_values(self) -> Iterable[Any]:
        """Return the field's values as the dataclass stores them: floats, or tuples of floats."""
        if not any(self.lines):
            # The child is absent in all objects.  The default may be None.  All rows share it.
            return repeat(self.default, len(self.lines))
        components = self.to_array().T.tolist()
        return zip(*components, strict=True) if len(components) > 1 else components[0]


class Table:
    """The objects of one dataclass in a scene file, one in each row."""

    dataclass: type[schema.Validated]
    field_of_tag: dict[str, str]  # names of all fields, by the tags that define them in a file
    columns: dict[str, Column]  # the columns of all numeric fields, by the field's name
    lines: array[int]  # for each row, the line of the object
    # In a table of shaders or surfaces: for each row, the index among all shaders or surfaces.
    object_indices: array[int]
    # In a table of surfaces: for each row, the index of the surface's shader, and the line of the
    # surface's element <shader>.  Both are 0 if the surface has no <shader>.
    shader_indices: array[int]
    shader_lines: array[int]

    def __init__(self, dataclass: type[schema.Validated]) -> None:
        self.dataclass = dataclass
        self.field_of_tag = {}
        self.columns = {}
        for field in fields(cast(Any, dataclass)):
            self.field_of_tag |= dict.fromkeys(field.metadata.get("tags", ()), field.name)
            if isinstance(field.metadata.get("validator"), NumberValidator):
                self.columns[field.name] = Column(field)
        self.lines = array("i")
        self.object_indices = array("i")
        self.shader_indices = array("i")
        self.shader_lines = array("i")

    def to_arrays(self) -> dict[str, Shaped[Floats, "n count"]]:
        """Copy the rows of all numeric fields into arrays."""
        return {name: column.to_array() for name, column in self.columns.items()}

    def find_errors(self) -> Iterator[tuple[int, str, str]]:
        """Find invalid and contradictory numbers, and yield the line, the tag and the message.

        The message names XML elements, not dataclass fields.  Values that contain NaN are skipped:
        their errors were reported while the file was read.
        """
        field_arrays = self.to_arrays()
        for row, name, message in schema.find_errors(self.dataclass, field_arrays):
            if np.isnan(field_arrays[name][row]).any():
                continue
            column = self.columns[name]
            line = column.lines[row] or self.lines[row]
            # For example, view_dir becomes viewDir.
            message = re.sub("_([a-z])", lambda match: match[1].upper(), message)
            yield line, column.tags[column.tag_indices[row]], message

    def make_objects(self) -> Iterator[Any]:
        """Yield an instance of the dataclass for each row; all rows must be valid."""
        field_values = {name: column.get_values() for name, column in self.columns.items()}
        if any(field.name == "line" for field in fields(cast(Any, self.dataclass))):
            field_values["line"] = self.lines
        for row in zip(*field_values.values(), strict=True):
            yield construct_unchecked(self.dataclass, **dict(zip(field_values, row, strict=True)))
