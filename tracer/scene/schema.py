"""Validators of the values in a scene.

The metadata of a dataclass field contain its validator, and its tags in a file (`xml_field`).  The
same rules validate the fields of one object (`Checked`), the arrays of `Surfaces`, and the numbers
in a file (`errors`).
"""

from __future__ import annotations

import operator
import reprlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import fields
from typing import Any, TypeAlias, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

_Instance = TypeVar("_Instance")
Floats: TypeAlias = NDArray[np.float64]
Columns: TypeAlias = Mapping[str, Floats]
"""Numbers (n, count) of n objects of one dataclass, by field; NaN for absent ones."""
RowError: TypeAlias = tuple[int, str, str]
"""An invalid number: the index of its object, the name of its field, and the message."""

MAX_PIXELS = 1 << 28
"""Maximum number of pixels in a picture: 2^28 (16384 x 16384), 6 GiB as float64 RGB."""

# Limits for the magnitude of lengths and coordinates other than 0.  The upper one is also that of
# colours and exponents.  The fourth powers of numbers between them are normal in float64.
_MIN_LENGTH, _MAX_VALUE = 1e-75, 1e75


def number_text(value: float) -> str:
    """Return the shortest text of a number, without a final ``.0``: 3, 0.5, 1e+20."""
    return f"{value}".removesuffix(".0")


class SceneError(ValueError):
    """An invalid scene; the message has one line for each error.

    Attributes
    ----------
    lines : tuple of str
        The lines of the message: ``parameter: what is wrong; suggested fix``.
    """

    def __init__(self, lines: Iterable[str]) -> None:
        self.lines = tuple(lines)
        super().__init__(self.lines)

    def __str__(self) -> str:
        return "\n".join(self.lines)


def raise_any(lines: Iterable[str]) -> None:
    """Raise `SceneError` with these lines, if there are any."""
    if message := tuple(lines):
        raise SceneError(message)


_Validator: TypeAlias = Callable[[Any, str], Any]


def xml_field(validator: _Validator, *tags: str) -> dict[str, Any]:
    """Return the metadata of a dataclass field.

    Parameters
    ----------
    validator : callable
        Takes a value and the field's name; returns the value to store, or raises `SceneError`.
    *tags : str
        Tags of the elements that contain the field's value in a file.

    Returns
    -------
    metadata : dict
        The entries "validator" and "tags".
    """
    return {"validator": validator, "tags": tags}


class Checked:
    """A frozen dataclass whose fields are validated one by one, and then together."""

    __slots__ = ("__weakref__",)

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
            row = {
                name: np.array([getattr(self, name)], np.float64)
                for name in number_validators(self)
            }
            lines = [f"{name}: {message}" for _, name, message in self.conflicts(row)]
        raise_any(lines)

    @classmethod
    def conflicts(cls, columns: Columns) -> Iterable[RowError]:
        """Find objects whose values are valid one by one, but not together.

        Parameters
        ----------
        columns : mapping of (n, count) float array
            The numbers of n objects, by field; NaN for absent ones.

        Returns
        -------
        errors : iterable of tuple
            For each error, the index of the object, the field's name, and the message.
        """
        return ()


def construct_unchecked(dataclass: type[_Instance], **values: object) -> _Instance:
    """Construct an object of a frozen dataclass from the values of all fields, without checks."""
    instance = object.__new__(dataclass)
    for name, value in values.items():
        object.__setattr__(instance, name, value)
    return instance


# A predicate that is true for invalid values (n, count), and the message about the first of them.
_Rule: TypeAlias = tuple[Callable[[Floats], NDArray[np.bool_]], str]

_LIMITS = f"lengths other than 0 are from {number_text(_MIN_LENGTH)} to {number_text(_MAX_VALUE)}"
_FINITE: _Rule = (lambda x: ~np.isfinite(x), "must be finite")
_NOT_LARGE: _Rule = (lambda x: abs(x) > _MAX_VALUE, f"{{}} is too large; {_LIMITS}")
_NOT_HUGE: _Rule = (
    lambda x: x > _MAX_VALUE,
    f"{{}} is too large; it is at most {number_text(_MAX_VALUE)}",
)
_NOT_SMALL: _Rule = (lambda x: (abs(x) < _MIN_LENGTH) & (x != 0), f"{{}} is too small; {_LIMITS}")
_NOT_NEGATIVE: _Rule = (lambda x: x < 0, "must not be negative, has {}")
_POSITIVE: _Rule = (lambda x: x <= 0, "must be positive, is {}")
_NOT_ZERO: _Rule = (
    lambda x: (x == 0) & ~x.any(axis=1, keepdims=True),
    "must not be the zero vector",
)


class Numbers:
    """Validator of a field that consists of numbers.

    Parameters
    ----------
    count : int
        How many numbers the field has.
    *rules : tuple
        The rules that the numbers must obey.
    """

    def __init__(self, count: int, *rules: _Rule) -> None:
        self.count, self.rules = count, rules
        self.needed = f"needs {count} number{'s' * (count > 1)}"

    def __call__(self, value: ArrayLike, name: str) -> tuple[float, ...] | float:
        """Validate the value of the field `name`; return a tuple, or the single number."""
        array = _float_array(value, name)
        if array.size != self.count or array.ndim > 1:
            has = f"shape {array.shape}" if array.ndim > 1 else array.size
            raise SceneError([f"{name}: {self.needed}, has {has}"])
        row = array.reshape(1, self.count)
        raise_any(f"{name}: {message}" for _, message in self.errors(row))
        return tuple(row[0].tolist()) if self.count > 1 else row.item()

    def rows(self, value: ArrayLike, name: str) -> Floats:
        """Copy the values of many objects into an array, without applying the rules.

        Parameters
        ----------
        value : array_like
            Numbers of n objects, in rows.
        name : str
            Name of the field, for messages.

        Returns
        -------
        rows : (n, count) or (n,) float array
            One-dimensional if the field is a single number.
        """
        array = _float_array(value, name)
        if array.size % self.count or array.shape[1:] not in ((), (self.count,)):
            raise SceneError([f"{name}: {self.needed} in each row, has shape {array.shape}"])
        return array.reshape((-1, self.count) if self.count > 1 else -1)

    def errors(self, values: Floats) -> Iterator[tuple[int, str]]:
        """Yield the index and the message of each row of `values` (n, count) that breaks a rule."""
        messages: dict[int, str] = {}
        for is_broken, message in self.rules:
            broken = is_broken(values)
            for i in np.flatnonzero(broken.any(axis=1)).tolist():
                messages.setdefault(i, message.format(number_text(values[i, broken[i]][0])))
        yield from messages.items()


POINT = Numbers(3, _FINITE, _NOT_LARGE, _NOT_SMALL)
DIRECTION = Numbers(3, _FINITE, _NOT_ZERO)
COLOR = Numbers(3, _FINITE, _NOT_NEGATIVE, _NOT_HUGE)
LENGTH = Numbers(1, _FINITE, _POSITIVE, _NOT_LARGE, _NOT_SMALL)
EXPONENT = Numbers(1, _FINITE, _NOT_NEGATIVE, _NOT_HUGE)


def number_validators(dataclass: Any) -> dict[str, Numbers]:
    """Return the validators of those fields of a dataclass that consist of numbers, by name."""
    validators = {field.name: field.metadata.get("validator") for field in fields(dataclass)}
    return {
        name: validator for name, validator in validators.items() if isinstance(validator, Numbers)
    }


def errors(dataclass: type[Checked], columns: Columns) -> Iterator[RowError]:
    """Find invalid objects of a dataclass.

    Parameters
    ----------
    dataclass : subclass of Checked
    columns : mapping of (n, count) float array
        The numbers of n objects, by field.

    Yields
    ------
    error : tuple
        The index of the object, the name of the field, and the message.
    """
    for name, validator in number_validators(dataclass).items():
        yield from ((i, name, message) for i, message in validator.errors(columns[name]))
    yield from dataclass.conflicts(columns)


def integer_array(value: ArrayLike, name: str) -> NDArray[np.intp]:
    """Validate whole numbers; return a copy (n,)."""
    floats = _float_array(value, name).ravel()
    with np.errstate(invalid="ignore"):
        array = floats.astype(np.intp)
    if not np.array_equal(array, floats):
        raise SceneError([f"{name}: must be whole numbers"])
    return array


def pixel_count(value: int, name: str) -> int:
    """Validate a number of pixels; return it as a Python int, whose products do not overflow."""
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
    """Return a validator of any number of objects of these types; it returns a tuple."""
    allowed = " or ".join(each.__name__ for each in types)

    def validator(values: Iterable[object], name: str) -> tuple[object, ...]:
        try:
            items = tuple(values)
        except TypeError:
            message = f"{name}: must be a list, is of type {type(values).__name__}"
            raise SceneError([message]) from None
        others = dict.fromkeys(type(item).__name__ for item in items if not isinstance(item, types))
        raise_any(f"{name}: must be of type {allowed}, is of type {other}" for other in others)
        return items

    return validator


def one_of(*types: type) -> _Validator:
    """Return a validator of one object of these types."""
    validate = list_of(*types)
    return lambda value, name: validate([value], name)[0]


def _float_array(value: ArrayLike, name: str) -> Floats:
    """Copy numbers into an array; raise `SceneError` for anything but real numbers."""
    try:
        array = np.asarray(value)
        # NumPy would parse text, convert None and times to NaN, and drop imaginary parts.
        if value is None or array.dtype.kind in "USmMc":
            raise TypeError
        return np.array(array, dtype=np.float64)
    except OverflowError:
        message = "must be finite"
    except (TypeError, ValueError):
        message = f"must be given in numbers, is {reprlib.repr(value)}"
    raise SceneError([f"{name}: {message}"])
