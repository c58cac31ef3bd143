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
from typing import Any, cast

import numpy as np

from tracer.arrays import Floats
from tracer.scene import schema
from tracer.scene.schema import NumberValidator, construct_unchecked

# Characters of decimal numbers.  float() accepts more: 1_0, nan, infinity.
_is_decimal = re.compile(r"[-+.0-9eE\s]*", re.ASCII).fullmatch

# Match strings with numbers that float() may have rounded to 0, and words that denote 0 exactly.
_may_underflow = re.compile(r"[eE]-|[0-9.]{300}").search
_is_zero = re.compile(r"[-+]?[0.]+([eE].*)?").fullmatch


def parse_numbers(text: str, number_count: int) -> list[float]:
    """Parse decimal numbers that are separated by white space.

    Parameters
    ----------
    text : str
        The text.
    number_count : int
        Required number of numbers, at least 1.

    Returns
    -------
    numbers : list of float
        The numbers.  The list is empty if the text does not consist of exactly
        `number_count` decimal numbers, or if float64 would round a nonzero number to 0.
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
    """The numbers of one field of a dataclass for many objects: a column of a table.

    Each row belongs to one object, and is read from one XML element inside the object's element.

    Parameters
    ----------
    field : dataclasses.Field
        The field, which must consist of numbers.

    Attributes
    ----------
    validator : NumberValidator
        Validator of the field, which defines how many numbers a row has.
    tags : tuple of str
        Tags that the elements may have; nearly all fields have only one tag.
    default : object
        Value of the field if the element is absent; `dataclasses.MISSING` if the element is
        required.
    default_row : list of float
        The numbers of an absent element: those of the default, or NaN if there are none.
    numbers : array of double
        The numbers of all rows, one row after the other; NaN for unknown and invalid numbers.
    lines : array of int
        For each row, the line of the element in the file; 0 if the element is absent.
    tag_indices : array of signed char
        For each row, the index of the element's tag in `tags`.
    """

    def __init__(self, field: Field[Any]) -> None:
        self.validator, self.tags = field.metadata["validator"], field.metadata["tags"]
        self.default: Any = field.default
        default_numbers: Any = np.nan if self.default in (MISSING, None) else self.default
        self.default_row = np.broadcast_to(default_numbers, self.validator.number_count).tolist()
        self.numbers, self.lines, self.tag_indices = array("d"), array("i"), array("b")

    def append(self, numbers: list[float], line: int, tag: str) -> None:
        """Append a row with the numbers that an XML element gives for the next object.

        Parameters
        ----------
        numbers : list of float
            The numbers in the element, or `default_row` if there is no element.
        line : int
            Line of the element in the file, or 0 if there is no element.
        tag : str
            Tag of the element, or any allowed tag if there is no element.
        """
        self.numbers.fromlist(numbers)  # takes half the time of extend()
        self.lines.append(line)
        self.tag_indices.append(self.tags.index(tag))

    def to_array(self) -> Floats:
        """Copy the numbers of all n objects into a float array with one row per object."""
        return np.reshape(self.numbers, (-1, self.validator.number_count))

    def get_values(self) -> Iterable[Any]:
        """Return the field's values for all objects, as the dataclass stores them.

        Returns
        -------
        values : iterable
            Floats if the field consists of one number, otherwise tuples of floats.  If no object in
            the file gives a value, every value is the field's default.
        """
        if not any(self.lines):
            return repeat(self.default, len(self.lines))  # the rows share one tuple
        components = self.to_array().T.tolist()
        return zip(*components, strict=True) if len(components) > 1 else components[0]


class Table:
    """A table of the objects of one dataclass in a scene file, with one row for each object.

    Parameters
    ----------
    dataclass : subclass of Validated
        The class of the objects.  The metadata of its fields contain tags and validators.

    Attributes
    ----------
    field_of_tag : dict of str to str
        For each XML tag that may occur inside an object's element, the name of the dataclass field
        that it defines.
    columns : dict of str to Column
        The column of each field that consists of numbers, by the field's name.
    lines : array of int
        For each row, the line of the object in the file.
    object_indices : array of int
        In a table of shaders or surfaces: for each row, the index among all shaders or surfaces.
    shader_indices, shader_lines : array of int
        In a table of surfaces: for each row, the index of the surface's shader, and the line of the
        surface's element <shader>.  Both are 0 if the surface has no <shader>.
    """

    def __init__(self, dataclass: type[schema.Validated]) -> None:
        self.dataclass = dataclass
        self.field_of_tag, self.columns = dict[str, str](), dict[str, Column]()
        for field in fields(cast(Any, dataclass)):
            self.field_of_tag |= dict.fromkeys(field.metadata.get("tags", ()), field.name)
            if isinstance(field.metadata.get("validator"), NumberValidator):
                self.columns[field.name] = Column(field)
        self.lines, self.object_indices = array("i"), array("i")
        self.shader_indices, self.shader_lines = array("i"), array("i")

    def to_arrays(self) -> dict[str, Floats]:
        """Copy all numbers into float arrays: one array per field, one row per object.

        Returns
        -------
        arrays : dict of str to (n, number_count) float array
            For each field name, the values of this field in n objects.
        """
        return {name: column.to_array() for name, column in self.columns.items()}

    def find_errors(self) -> Iterator[tuple[int, str, str]]:
        """Find the invalid and contradictory numbers of all objects in the table.

        Values that contain NaN are skipped: their errors were reported while the file was read.

        Yields
        ------
        line : int
            Line of the invalid number in the file.
        tag : str
            Tag of the element that contains the number.
        message : str
            What is wrong.  It names XML elements, not dataclass fields.
        """
        field_arrays = self.to_arrays()
        for row_index, name, message in schema.find_errors(self.dataclass, field_arrays):
            column = self.columns[name]
            if not np.isnan(field_arrays[name][row_index]).any():
                line = column.lines[row_index] or self.lines[row_index]
                # For example, view_dir becomes viewDir.
                message = re.sub("_([a-z])", lambda match: match[1].upper(), message)
                yield line, column.tags[column.tag_indices[row_index]], message

    def make_objects(self) -> Iterator[Any]:
        """Create an instance of the dataclass from each row of the table, without validation.

        Call this only if all rows are valid.

        Yields
        ------
        instance : object
            The instance created from the next row.
        """
        field_values = {name: column.get_values() for name, column in self.columns.items()}
        if any(field.name == "line" for field in fields(cast(Any, self.dataclass))):
            field_values["line"] = self.lines
        for row in zip(*field_values.values(), strict=True):
            yield construct_unchecked(self.dataclass, **dict(zip(field_values, row, strict=True)))
