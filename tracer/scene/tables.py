"""Tables of the objects in a scene file: one table for each dataclass, one row for each object.

Files may contain millions of objects.  Their numbers are therefore collected in arrays, validated
together at the end, and copied into the arrays of `Surfaces`, without creating a Python object for
each surface.  Line numbers are stored beside the numbers, so that error messages can state them.
"""

from __future__ import annotations

import re
from array import array
from collections.abc import Iterable, Iterator
from dataclasses import MISSING, Field, fields
from itertools import repeat
from typing import Annotated as Shaped
from typing import Any, TypeAlias, cast

import numpy as np

from tracer.arrays import Floats
from tracer.scene import schema
from tracer.scene.schema import NumberValidator, construct_unchecked

# Characters of decimal numbers.  float() accepts more: 1_0, nan, infinity.
_is_decimal = re.compile(r"[-+.0-9eE\s]*", re.ASCII).fullmatch

# Tests for numbers that may underflow.  It never misses one, but may match harmless text.
_may_underflow = re.compile(r"[eE]-|[0-9.]{300}").search
# Matches words that denote 0 exactly.
_is_zero = re.compile(r"[-+]?[0.]+([eE].*)?").fullmatch


def parse_numbers(text: str, number_count: int) -> list[float]:
    """Parse `number_count` decimal numbers that are separated by white space.

    Return an empty list if the text does not consist of exactly so many numbers, or if a number
    other than 0 would underflow to 0 in float64.
    """
    words = text.split()
    if len(words) != number_count or not _is_decimal(text):
        return []
    try:
        numbers = [*map(float, words)]
    except ValueError:
        return []
    if 0 in numbers and _may_underflow(text):
        zero_words = (word for number, word in zip(numbers, words, strict=True) if number == 0)
        return numbers if all(map(_is_zero, zero_words)) else []
    return numbers


# The value of a field that consists of numbers, as the dataclass stores it.
_Value: TypeAlias = float | tuple[float, ...] | None


class Column:
    """The numbers of one field in all objects of a table, one row for each object.

    In the file, the numbers of a row are in a child of the object's element, such as the <center>
    of a sphere.
    """

    validator: NumberValidator
    tags: tuple[str, ...]  # the tags that the child may have; nearly all fields have only one
    is_required: bool  # whether each object must have the child
    default: _Value  # value of the field if the child is absent; None if it is required
    numbers: array[float]  # row after row; NaN for missing and unreadable numbers
    lines: array[int]  # for each row, the line of the child; 0 if it is absent
    tag_indices: array[int]  # for each row, the index of the child's tag in `tags`

    def __init__(self, field: Field[Any]) -> None:
        self.validator = field.metadata["validator"]
        self.tags = field.metadata["tags"]
        self.is_required = field.default is MISSING
        self.default = None if field.default is MISSING else field.default
        default_numbers = np.nan if self.default is None else self.default
        self._default_row = np.broadcast_to(default_numbers, self.validator.number_count).tolist()
        self.numbers = array("d")
        self.lines = array("i")
        self.tag_indices = array("b")

    def append(self, numbers: list[float], line: int, tag: str) -> None:
        """Append a row: the numbers in a child, its line and its tag."""
        self.numbers.fromlist(numbers)  # takes half the time of extend()
        self.lines.append(line)
        self.tag_indices.append(self.tags.index(tag))

    def append_default(self) -> None:
        """Append the row of an object without the child: the default, or NaN if that is None."""
        self.append(self._default_row, 0, self.tags[0])

    def to_array(self) -> Shaped[Floats, "n count"]:
        """Return a view of the rows.  While it exists, appending a row raises BufferError."""
        return np.reshape(self.numbers, (-1, self.validator.number_count))

    def get_values(self) -> Iterable[_Value]:
        """Return the value of each row as the dataclass stores it: a float, or a tuple of floats.

        If the child is absent in all objects, each value is the default, which may be None.
        """
        if not any(self.lines):
            return repeat(self.default, len(self.lines))
        components = self.to_array().T.tolist()
        return zip(*components, strict=True) if len(components) > 1 else components[0]


class Table:
    """The objects of one dataclass in a scene file, one in each row.

    To add a row, call `begin_row`, and then `append` or `append_default` of each column.
    """

    dataclass: type[schema.Validated]
    field_of_tag: dict[str, str]  # the name of the field that each tag defines
    columns: dict[str, Column]  # one for each numeric field, by the field's name
    lines: array[int]  # for each row, the line of the object

    def __init__(self, dataclass: type[schema.Validated]) -> None:
        self.dataclass = dataclass
        self.field_of_tag = {}
        self.columns = {}
        for field in fields(cast(Any, dataclass)):
            self.field_of_tag |= dict.fromkeys(field.metadata.get("tags", ()), field.name)
            if isinstance(field.metadata.get("validator"), NumberValidator):
                self.columns[field.name] = Column(field)
        self.lines = array("i")

    def begin_row(self, line: int) -> None:
        """Begin the row of an object that is on this line of the file."""
        self.lines.append(line)

    def to_arrays(self) -> dict[str, Shaped[Floats, "n count"]]:
        """Return views of the rows of all numeric fields, by the field's name."""
        return {name: column.to_array() for name, column in self.columns.items()}

    def locate_errors(self) -> Iterator[tuple[int, str, str]]:
        """Yield the line, the tag and the message of each invalid or contradictory number.

        The message names XML elements, not dataclass fields.  A row of a column that contains NaN
        is skipped, because its error was reported while the file was read.
        """
        field_rows = self.to_arrays()
        for row, name, message in schema.find_field_errors(self.dataclass, field_rows):
            if np.isnan(field_rows[name][row]).any():
                continue
            column = self.columns[name]
            line = column.lines[row] or self.lines[row]
            # For example, view_dir becomes viewDir.
            message = re.sub("_([a-z])", lambda match: match[1].upper(), message)
            yield line, column.tags[column.tag_indices[row]], message

    def make_objects(self) -> Iterator[Any]:
        """Yield an instance of the dataclass for each row.  All rows must be valid."""
        field_values = {name: column.get_values() for name, column in self.columns.items()}
        if any(field.name == "line" for field in fields(cast(Any, self.dataclass))):
            field_values["line"] = self.lines
        for row in zip(*field_values.values(), strict=True):
            yield construct_unchecked(self.dataclass, **dict(zip(field_values, row, strict=True)))


class ShaderTable(Table):
    """The shaders of one dataclass in a scene file.  Each row is completed by `append_index`."""

    indices: array[int]  # for each row, the index among all shaders of the file

    def __init__(self, dataclass: type[schema.Validated]) -> None:
        super().__init__(dataclass)
        self.indices = array("i")

    def append_index(self, index: int) -> None:
        self.indices.append(index)


class SurfaceTable(Table):
    """The surfaces of one dataclass in a scene file.  Each row is completed by `append_indices`."""

    indices: array[int]  # for each row, the index among all surfaces of the file
    shader_indices: array[int]  # for each row, the index among all shaders of the file
    shader_lines: array[int]  # for each row, the line of the <shader> in the surface; 0 if absent

    def __init__(self, dataclass: type[schema.Validated]) -> None:
        super().__init__(dataclass)
        self.indices = array("i")
        self.shader_indices = array("i")
        self.shader_lines = array("i")

    def append_indices(self, index: int, shader_index: int, shader_line: int) -> None:
        """Complete a row; both numbers of the shader are 0 if the surface has no <shader>."""
        self.indices.append(index)
        self.shader_indices.append(shader_index)
        self.shader_lines.append(shader_line)
