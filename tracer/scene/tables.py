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

# Patterns in a text with numbers that float() may have rounded to 0, and of a word that is 0.
_may_underflow = re.compile(r"[eE]-|[0-9.]{300}").search
_is_zero = re.compile(r"[-+]?[0.]+([eE].*)?").fullmatch


def parse_numbers(text: str, count: int) -> Sequence[float]:
    """Return the decimal numbers that a text consists of.

    Parameters
    ----------
    text : str
    count : int
        How many numbers the text must consist of.

    Returns
    -------
    numbers : sequence of float
        Empty if the text consists of anything else, or of a number that is not 0, but so small that
        float64 would round it to 0.
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
    """The numbers of one field in all rows of a table, and where the file contains them.

    Attributes
    ----------
    count : int
        How many numbers the field has.
    tags : tuple of str
        Tags that an element with these numbers may have; nearly all fields have one.
    required : bool
        Whether each object must have such an element.
    default : object
        Value of the field if the element is absent.
    numbers : array of double
        The numbers of all rows, one row after the other; NaN for unknown and invalid numbers.
    lines : array of int
        For each row, the line of the element; 0 if the element is absent.
    tag_index : array of signed char
        For each row, the index of the element's tag in `tags`.
    """

    def __init__(self, field: Field[Any]) -> None:
        self.count, self.tags = field.metadata["validator"].count, field.metadata["tags"]
        self.default: Any = field.default
        self.required = self.default is MISSING
        is_unknown = self.required or self.default is None
        default: Any = np.nan if is_unknown else self.default
        self._missing = np.broadcast_to(default, self.count).tolist()
        self.numbers, self.lines, self.tag_index = array("d"), array("i"), array("b")

    def append(self, numbers: Sequence[float], line: int, tag: str) -> None:
        """Add a row with the numbers of an element."""
        self.numbers.extend(numbers)
        self.lines.append(line)
        self.tag_index.append(self.tags.index(tag))

    def append_missing(self) -> None:
        """Add a row without an element: the default, or NaN if there is none."""
        self.numbers.extend(self._missing)
        self.lines.append(0)
        self.tag_index.append(0)

    def array(self) -> Floats:
        """Return the numbers as an array (rows, numbers per row)."""
        return np.reshape(self.numbers, (-1, self.count))

    def values(self) -> Iterable[Any]:
        """Return the field's value in each row: a float, a tuple of float, or the default."""
        if not any(self.lines):
            return repeat(self.default, len(self.lines))  # the rows share one tuple
        rows = self.array().T.tolist()
        return zip(*rows, strict=True) if len(rows) > 1 else rows[0]


class Table:
    """All elements of a file that become objects of one dataclass, a row for each.

    Parameters
    ----------
    made : subclass of Checked
        The dataclass.  Its fields' metadata name the tags and the validator of each field.

    Attributes
    ----------
    tags : dict of str
        Names of the fields by their tags.
    columns : dict of Column
        Columns of the fields that consist of numbers, by the fields' names.
    lines : array of int
        For each row, the line of the element.
    index : array of int
        For each row of shaders or surfaces, the index among all shaders or all surfaces.
    shaders : array of int
        For each row of surfaces, the index of the surface's shader.
    """

    def __init__(self, made: type[schema.Checked]) -> None:
        self.made, validators = made, schema.number_validators(made)
        tagged = [field for field in fields(cast(Any, made)) if field.metadata]
        self.tags = {tag: field.name for field in tagged for tag in field.metadata["tags"]}
        self.columns = {field.name: Column(field) for field in tagged if field.name in validators}
        self.lines, self.index, self.shaders = array("i"), array("i"), array("i")

    def errors(self) -> Iterator[tuple[int, str, str]]:
        """Yield the line, the tag and the message of each invalid number."""
        numbers = {name: column.array() for name, column in self.columns.items()}
        for row, name, message in schema.errors(self.made, numbers):
            column = self.columns[name]
            if not np.isnan(numbers[name][row]).any():  # otherwise it is reported already
                line = column.lines[row] or self.lines[row]
                yield line, column.tags[column.tag_index[row]], _with_tags(message)

    def objects(self) -> Iterator[Any]:
        """Yield the object of each row of a table without errors."""
        values = {name: column.values() for name, column in self.columns.items()}
        if self.made in (model.PointLight, model.Lambertian, model.Phong):
            values["line"] = self.lines
        for row in zip(*values.values(), strict=True):
            yield construct_unchecked(self.made, **dict(zip(values, row, strict=True)))


def _with_tags(message: str) -> str:
    """Replace the names of fields in a message by tags, such as view_dir by viewDir."""
    return re.sub("_([a-z])", lambda match: match[1].upper(), message)
