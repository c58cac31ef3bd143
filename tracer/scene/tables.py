"""Tables of the elements in a scene file: one table for each dataclass, one row for each object.

Files may contain millions of objects.  Their numbers are therefore collected in arrays, validated
together at the end, and copied into the arrays of `Surfaces`, without an object for each surface.
Line numbers are stored beside the numbers, so that errors can name them.
"""

from __future__ import annotations

import re
from array import array
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import MISSING, Field, fields
from itertools import repeat
from typing import Any, cast

import numpy as np

from tracer.scene import model, schema
from tracer.scene.schema import Floats, construct_unchecked

# Characters of decimal numbers.  float() accepts more: 1_0, nan, infinity.
_is_decimal = re.compile(r"[-+.0-9eE\s]*", re.ASCII).fullmatch

# Patterns of texts that contain numbers that float() may have rounded to 0, and of words for 0.
_may_underflow = re.compile(r"[eE]-|[0-9.]{300}").search
_is_zero = re.compile(r"[-+]?[0.]+([eE].*)?").fullmatch


def parse_numbers(text: str, count: int) -> Sequence[float]:
    """Parse a text that consists of decimal numbers and white space.

    Parameters
    ----------
    text : str
        The text.
    count : int
        Required count of numbers, at least 1.

    Returns
    -------
    numbers : sequence of float
        The numbers.  Empty if the text contains anything else or another count of numbers, or if a
        number other than 0 is so small that float64 would round it to 0.
    """
    words = text.split()
    try:
        numbers = [*map(float, words)] if len(words) == count and _is_decimal(text) else []
    except ValueError:
        return ()
    if 0 in numbers and _may_underflow(text):
        is_exact = [x != 0 or _is_zero(word) for x, word in zip(numbers, words, strict=True)]
        return numbers if all(is_exact) else ()
    return numbers


class Column:
    """A column of a table: the numbers of one field of a dataclass, for many objects.

    Each row belongs to one object, and is read from one XML element inside the object's element.

    Parameters
    ----------
    field : dataclasses.Field
        The field, which consists of numbers.

    Attributes
    ----------
    count : int
        Count of numbers in each row.
    tags : tuple of str
        Tags that the elements may have; nearly all fields have one.
    is_required : bool
        Whether each object must have such an element.
    default : object
        Value of the field if the element is absent.
    numbers : array of double
        The numbers of all rows, one row after the other; NaN for unknown and invalid numbers.
    lines : array of int
        For each row, the line of the element in the file; 0 if the element is absent.
    tag_index : array of signed char
        For each row, the index of the element's tag in `tags`.
    """

    def __init__(self, field: Field[Any]) -> None:
        self.count, self.tags = field.metadata["validator"].count, field.metadata["tags"]
        self.default: Any = field.default
        self.is_required = self.default is MISSING
        has_default = not self.is_required and self.default is not None
        default_numbers: Any = self.default if has_default else np.nan
        self._default_row = np.broadcast_to(default_numbers, self.count).tolist()
        self.numbers, self.lines, self.tag_index = array("d"), array("i"), array("b")

    def append(self, numbers: Sequence[float], line: int, tag: str) -> None:
        """Add the row of an object that has an element for this field.

        Parameters
        ----------
        numbers : sequence of float
            The numbers in the element: `count` of them.
        line : int
            Line of the element in the file.
        tag : str
            Tag of the element, one of `tags`.
        """
        self.numbers.extend(numbers)
        self.lines.append(line)
        self.tag_index.append(self.tags.index(tag))

    def append_default(self) -> None:
        """Add the row of an object without an element: the default, or NaN if there is none."""
        self.numbers.extend(self._default_row)
        self.lines.append(0)
        self.tag_index.append(0)

    def array(self) -> Floats:
        """Return the numbers as a float array (rows, count)."""
        return np.reshape(self.numbers, (-1, self.count))

    def values(self) -> Iterable[Any]:
        """Return the value of the field in each row, as the constructor of the dataclass takes it.

        If no row has an element, all values are the default of the field.  Otherwise each value is
        a float if `count` is 1, and a tuple of floats if not.
        """
        if not any(self.lines):
            return repeat(self.default, len(self.lines))  # the rows share one tuple
        components = self.array().T.tolist()
        return zip(*components, strict=True) if self.count > 1 else components[0]


class Table:
    """A table of the objects of one dataclass in a scene file, with one row for each object.

    Parameters
    ----------
    dataclass : subclass of Validated
        The class of the objects.  The metadata of its fields contain tags and validators.

    Attributes
    ----------
    field_of_tag : dict of str
        For each tag of an XML element that an object may contain, the name of the object's field.
    columns : dict of Column
        For the name of each field that consists of numbers, its column.
    lines : array of int
        For each row, the line of the object in the file.
    index : array of int
        In a table of shaders or surfaces: for each row, the index among all shaders or surfaces.
    shader_index : array of int
        In a table of surfaces: for each row, the index of the surface's shader.
    """

    def __init__(self, dataclass: type[schema.Validated]) -> None:
        self.dataclass, validators = dataclass, schema.number_validators(dataclass)
        tagged = [field for field in fields(cast(Any, dataclass)) if field.metadata]
        self.field_of_tag = {tag: field.name for field in tagged for tag in field.metadata["tags"]}
        self.columns = {field.name: Column(field) for field in tagged if field.name in validators}
        self.lines, self.index, self.shader_index = array("i"), array("i"), array("i")

    def find_errors(self) -> Iterator[tuple[int, str, str]]:
        """Validate all numbers of the table, and yield the errors.

        Rows that contain NaN are skipped: their errors were reported when they were read.

        Yields
        ------
        line : int
            Line of the file with the invalid number.
        tag : str
            Tag of the element that contains the number.
        message : str
            What is wrong.
        """
        numbers = {name: column.array() for name, column in self.columns.items()}
        for row, name, message in schema.find_errors(self.dataclass, numbers):
            column = self.columns[name]
            if not np.isnan(numbers[name][row]).any():
                line = column.lines[row] or self.lines[row]
                yield line, column.tags[column.tag_index[row]], _replace_names(message)

    def objects(self) -> Iterator[Any]:
        """Create the object of each row, without validation; call this only if there are no errors.

        Yields
        ------
        instance : object of the dataclass
            In the order of the rows.
        """
        values = {name: column.values() for name, column in self.columns.items()}
        if self.dataclass in (model.PointLight, model.Lambertian, model.Phong):
            values["line"] = self.lines
        for row in zip(*values.values(), strict=True):
            yield construct_unchecked(self.dataclass, **dict(zip(values, row, strict=True)))


def _replace_names(message: str) -> str:
    """Replace the names of fields in a message by XML tags: view_dir becomes viewDir."""
    return re.sub("_([a-z])", lambda match: match[1].upper(), message)
