"""Validators of the values in a scene.

The metadata of a dataclass field hold its validator and its tags in a file (`xml_field`).  The same
rules apply to one object (`Checked`), to arrays (`Surfaces`) and to a file: see `faults`.
"""

from __future__ import annotations

import operator
import reprlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import fields
from typing import Any, TypeAlias, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

_Made = TypeVar("_Made")
Floats: TypeAlias = NDArray[np.float64]
Columns: TypeAlias = Mapping[str, Floats]
"""Numbers (n, count) of n objects of one dataclass, by field; NaN for absent ones."""
Fault: TypeAlias = tuple[int, str, str]
"""Index of an object, name of the field, and message."""

MAX_PIXELS = 1 << 28
"""Largest picture, in pixels: 2^28 (16384 x 16384), 6 GiB as float64 RGB."""

# Bounds of the size of lengths and coordinates other than 0, and of colours and exponents from
# above: float64 holds their fourth powers.
_SMALLEST, _LARGEST = 1e-75, 1e75


def number(value: float) -> str:
    """Write a number without a needless ``.0``: 3, 0.5, 1e+20."""
    return f"{value}".removesuffix(".0")


class SceneError(ValueError):
    """An invalid scene; the message has one line for each fault.

    Attributes
    ----------
    lines : tuple of str
        One for each fault: ``parameter: what is wrong; what would be right``.
    """

    def __init__(self, lines: Iterable[str]) -> None:
        self.lines = tuple(lines)
        super().__init__(self.lines)

    def __str__(self) -> str:
        return "\n".join(self.lines)


def raise_any(lines: Iterable[str]) -> None:
    """Raise `SceneError` if there are faults."""
    if found := tuple(lines):
        raise SceneError(found)


_Validator: TypeAlias = Callable[[Any, str], Any]


def xml_field(validator: _Validator, *tags: str) -> dict[str, Any]:
    """Metadata of a field: its validator, and the tags of its elements in a file.

    A validator takes a value and the field's name, and returns the field's value or raises
    `SceneError`.
    """
    return {"validator": validator, "tags": tags}


class Checked:
    """A frozen dataclass that validates each field, and then all of them together."""

    __slots__ = ()

    def __post_init__(self: Any) -> None:
        lines: list[str] = []
        for field in fields(self):
            validator, value = field.metadata.get("validator"), getattr(self, field.name)
            if validator is not None and not (value is None and field.default is None):
                try:
                    object.__setattr__(self, field.name, validator(value, field.name))
                except SceneError as error:
                    lines += error.lines
        if not lines:
            one = {name: np.array([getattr(self, name)], np.float64) for name in numeric(self)}
            lines = [f"{name}: {wrong}" for _, name, wrong in self.conflicts(one)]
        raise_any(lines)

    @classmethod
    def conflicts(cls, columns: Columns) -> Iterable[Fault]:
        """Find objects whose values are valid one by one, but not together."""
        return ()


def construct_unchecked(made: type[_Made], **values: object) -> _Made:
    """Make an object of a frozen dataclass from all its values, without validation."""
    new = object.__new__(made)
    for name, value in values.items():
        object.__setattr__(new, name, value)
    return new


# A rule: a predicate for values (n, count) that break it, and the message about the first of them.
_Rule: TypeAlias = tuple[Callable[[Floats], NDArray[np.bool_]], str]

_LIMITS = f"lengths other than 0 are from {number(_SMALLEST)} to {number(_LARGEST)}"
_FINITE: _Rule = (lambda x: ~np.isfinite(x), "must be finite")
_NOT_LARGE: _Rule = (lambda x: abs(x) > _LARGEST, f"{{}} is too large; {_LIMITS}")
_NOT_HUGE: _Rule = (
    lambda x: x > _LARGEST,
    f"{{}} is too large; it is at most {number(_LARGEST)}",
)
_NOT_SMALL: _Rule = (lambda x: (abs(x) < _SMALLEST) & (x != 0), f"{{}} is too small; {_LIMITS}")
_NOT_NEGATIVE: _Rule = (lambda x: x < 0, "must not be negative, has {}")
_POSITIVE: _Rule = (lambda x: x <= 0, "must be positive, is {}")
_NOT_ZERO: _Rule = (
    lambda x: (x == 0) & ~x.any(axis=1, keepdims=True),
    "must not be the zero vector",
)


class Numbers:
    """Validator of `count` numbers that must obey some rules."""

    def __init__(self, count: int, *rules: _Rule) -> None:
        self.count, self.rules = count, rules
        self.needed = f"needs {count} number{'s' * (count > 1)}"

    def __call__(self, value: ArrayLike, name: str) -> tuple[float, ...] | float:
        """Return a tuple, or the single number."""
        array = _floats(value, name)
        if array.size != self.count or array.ndim > 1:
            has = f"shape {array.shape}" if array.ndim > 1 else array.size
            raise SceneError([f"{name}: {self.needed}, has {has}"])
        row = array.reshape(1, self.count)
        raise_any(f"{name}: {message}" for _, message in self.faults(row))
        return tuple(row[0].tolist()) if self.count > 1 else row.item()

    def rows(self, value: ArrayLike, name: str) -> Floats:
        """Return a copy (n, count), or (n,) of single numbers, without applying the rules."""
        array = _floats(value, name)
        if array.size % self.count or array.shape[1:] not in ((), (self.count,)):
            raise SceneError([f"{name}: {self.needed} in each row, has shape {array.shape}"])
        return array.reshape((-1, self.count) if self.count > 1 else -1)

    def faults(self, values: Floats) -> Iterator[tuple[int, str]]:
        """Find rows of `values` (n, count) that break a rule; yield index and message of each."""
        found: dict[int, str] = {}
        for is_broken, message in self.rules:
            broken = is_broken(values)
            for i in np.flatnonzero(broken.any(axis=1)).tolist():
                found.setdefault(i, message.format(number(values[i, broken[i]][0])))
        yield from found.items()


POINT = Numbers(3, _FINITE, _NOT_LARGE, _NOT_SMALL)
DIRECTION = Numbers(3, _FINITE, _NOT_ZERO)
COLOR = Numbers(3, _FINITE, _NOT_NEGATIVE, _NOT_HUGE)
LENGTH = Numbers(1, _FINITE, _POSITIVE, _NOT_LARGE, _NOT_SMALL)
EXPONENT = Numbers(1, _FINITE, _NOT_NEGATIVE, _NOT_HUGE)


def numeric(made: Any) -> dict[str, Numbers]:
    """Return the validators of a dataclass's fields of numbers, by name."""
    validators = {field.name: field.metadata.get("validator") for field in fields(made)}
    return {
        name: validator for name, validator in validators.items() if isinstance(validator, Numbers)
    }


def faults(made: type[Checked], columns: Columns) -> Iterator[Fault]:
    """Find objects of a dataclass that are invalid, in columns of their numbers."""
    for name, validator in numeric(made).items():
        yield from ((i, name, wrong) for i, wrong in validator.faults(columns[name]))
    yield from made.conflicts(columns)


def integers(value: ArrayLike, name: str) -> NDArray[np.intp]:
    """Return a copy (n,) of whole numbers."""
    given = _floats(value, name).ravel()
    with np.errstate(invalid="ignore"):
        array = given.astype(np.intp)
    if not np.array_equal(array, given):
        raise SceneError([f"{name}: must be whole numbers"])
    return array


def size(value: int, name: str) -> int:
    """Validate a number of pixels; return a Python int, as products of NumPy's may overflow."""
    try:
        count = int(operator.index(value))
    except TypeError:
        raise SceneError([f"{name}: must be an int, is {value!r}"]) from None
    if not 1 <= count <= MAX_PIXELS:
        # float() and str() refuse numbers of many digits.
        has = f", is {count}" if abs(count) < 1e18 else ""
        raise SceneError([f"{name}: must be a whole number from 1 to {MAX_PIXELS}{has}"])
    return count


def list_of(*types: type) -> _Validator:
    """Make a validator of any number of objects of these types; it returns a tuple."""
    right = " or ".join(each.__name__ for each in types)

    def validator(values: Iterable[object], name: str) -> tuple[object, ...]:
        try:
            parts = tuple(values)
        except TypeError:
            wrong = f"{name}: must be a list, is of type {type(values).__name__}"
            raise SceneError([wrong]) from None
        others = dict.fromkeys(type(part).__name__ for part in parts if not isinstance(part, types))
        raise_any(f"{name}: must be of type {right}, is of type {other}" for other in others)
        return parts

    return validator


def one_of(*types: type) -> _Validator:
    """Make a validator of one object of these types."""
    many = list_of(*types)
    return lambda value, name: many([value], name)[0]


def _floats(value: ArrayLike, name: str) -> Floats:
    """Copy numbers into an array."""
    try:
        array = np.asarray(value)
        # NumPy would parse text, turn None and times into NaN, and drop imaginary parts.
        if value is None or array.dtype.kind in "USmMc":
            raise TypeError
        return np.array(array, dtype=np.float64)
    except OverflowError:
        wrong = "must be finite"
    except (TypeError, ValueError):
        wrong = f"must be given in numbers, is {reprlib.repr(value)}"
    raise SceneError([f"{name}: {wrong}"])
