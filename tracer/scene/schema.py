"""Validate the values of a scene.

The metadata of a dataclass field contain its validator, and its tags in a file (`xml_field`).  The
same rules validate the fields of one object (`Validated`), the arrays of `Surfaces`, and the
numbers in a file (`find_errors`).
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
"""The numbers of n objects of one dataclass.  The key is the name of a field; the value is an array
(n, count) with the numbers of this field, NaN where an object has no value."""
RowError: TypeAlias = tuple[int, str, str]
"""An invalid number: the index of its object, the name of its field, and the message."""

MAX_PIXELS = 1 << 28
"""Maximum number of pixels in a picture: 2^28 (16384 x 16384), 6 GiB as float64 RGB."""

# Limits for the magnitude of lengths and coordinates other than 0.  The upper limit applies to
# colours and exponents, too.  The fourth powers of numbers between the limits are normal float64.
_MIN_LENGTH, _MAX_VALUE = 1e-75, 1e75


def number_text(value: float) -> str:
    """Return the shortest text from which Python reads this number: "3", "0.5", "1e+20"."""
    return f"{value}".removesuffix(".0")


class SceneError(ValueError):
    """The error that a scene contains invalid values; the message has one line for each of them.

    Parameters
    ----------
    lines : iterable of str
        The lines of the message.

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


def raise_if_any(lines: Iterable[str]) -> None:
    """Raise a `SceneError` whose message consists of the given lines; do nothing without lines."""
    if message_lines := tuple(lines):
        raise SceneError(message_lines)


_Validator: TypeAlias = Callable[[Any, str], Any]


def xml_field(validator: _Validator, *tags: str) -> dict[str, Any]:
    """Create the metadata of a dataclass field that is stored in scene files.

    Parameters
    ----------
    validator : callable
        Called with a value and the name of the field.  It returns the value to store in the field,
        or raises `SceneError`.
    *tags : str
        Tags of the XML elements that may contain the value of the field in a file.  The first one
        is used to write files.

    Returns
    -------
    metadata : dict
        The entries "validator" and "tags".
    """
    return {"validator": validator, "tags": tags}


class Validated:
    """A base class of frozen dataclasses whose fields are validated, first singly, then together.

    A subclass gives each field a validator by `xml_field`, and overrides `find_conflicts` if valid
    values can contradict each other.  Its constructor raises `SceneError` for invalid values.
    """

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
            lines = [f"{name}: {message}" for _, name, message in self.find_conflicts(row)]
        raise_if_any(lines)

    @classmethod
    def find_conflicts(cls, columns: Columns) -> Iterable[RowError]:
        """Find objects whose values are valid one by one, but contradict each other.

        Parameters
        ----------
        columns : mapping of (n, count) float arrays
            The numbers of n objects.  The key is the name of a field; the value contains the
            numbers of this field, NaN where an object has no value.

        Returns
        -------
        errors : iterable of (int, str, str)
            For each error, the index of the object, the name of the field, and the message.
        """
        return ()


def construct_unchecked(dataclass: type[_Instance], **values: object) -> _Instance:
    """Construct an object of a frozen dataclass without validating its values.

    Parameters
    ----------
    dataclass : type
        The class.  Its constructor is not called.
    **values : object
        The valid values of all its fields, by their names.

    Returns
    -------
    instance : object of the class
        The new object.
    """
    instance = object.__new__(dataclass)
    for name, value in values.items():
        object.__setattr__(instance, name, value)
    return instance


# A function that tests which of the numbers (n, count) of n objects are invalid, and the message
# about the first invalid number of an object, in which {} stands for the number.
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
    """The validator of a field that consists of a fixed number of numbers, such as a point.

    Parameters
    ----------
    count : int
        Count of numbers in the field.
    *rules : (callable, str)
        Each rule is a function that tests which numbers in an array are invalid, and the message
        about an invalid number, in which {} stands for the number.
    """

    def __init__(self, count: int, *rules: _Rule) -> None:
        self.count, self.rules = count, rules
        self.needed = f"needs {count} number{'s' * (count > 1)}"

    def __call__(self, value: ArrayLike, name: str) -> tuple[float, ...] | float:
        """Validate the value of a field in one object, and convert it to Python floats.

        Parameters
        ----------
        value : array_like
            The value: `count` numbers.
        name : str
            Name of the field, for messages.

        Returns
        -------
        numbers : tuple of float, or float
            A single float if `count` is 1.

        Raises
        ------
        SceneError
            If the value has another count of numbers, or breaks a rule.
        """
        array = _float_array(value, name)
        if array.size != self.count or array.ndim > 1:
            has = f"shape {array.shape}" if array.ndim > 1 else array.size
            raise SceneError([f"{name}: {self.needed}, has {has}"])
        row = array.reshape(1, self.count)
        raise_if_any(f"{name}: {message}" for _, message in self.find_errors(row))
        return tuple(row[0].tolist()) if self.count > 1 else row.item()

    def rows(self, value: ArrayLike, name: str) -> Floats:
        """Copy the values of a field in many objects into an array, without applying the rules.

        Parameters
        ----------
        value : array_like
            Numbers of n objects, in rows or in one dimension.
        name : str
            Name of the field, for messages.

        Returns
        -------
        rows : (n, count) or (n,) float array
            One-dimensional if `count` is 1.

        Raises
        ------
        SceneError
            If the rows have another count of numbers, or contain anything but real numbers.
        """
        array = _float_array(value, name)
        if array.size % self.count or array.shape[1:] not in ((), (self.count,)):
            raise SceneError([f"{name}: {self.needed} in each row, has shape {array.shape}"])
        return array.reshape((-1, self.count) if self.count > 1 else -1)

    def find_errors(self, values: Floats) -> Iterator[tuple[int, str]]:
        """Find the objects whose numbers break a rule.

        Parameters
        ----------
        values : (n, count) float array
            The numbers of n objects.

        Yields
        ------
        index : int
            Index of an object.
        message : str
            The message of the first rule that the object breaks.
        """
        messages: dict[int, str] = {}
        for find_invalid, message in self.rules:
            is_invalid = find_invalid(values)
            for index in np.flatnonzero(is_invalid.any(axis=1)).tolist():
                first_invalid = values[index, is_invalid[index]][0]
                messages.setdefault(index, message.format(number_text(first_invalid)))
        yield from messages.items()


POINT = Numbers(3, _FINITE, _NOT_LARGE, _NOT_SMALL)
DIRECTION = Numbers(3, _FINITE, _NOT_ZERO)
COLOR = Numbers(3, _FINITE, _NOT_NEGATIVE, _NOT_HUGE)
LENGTH = Numbers(1, _FINITE, _POSITIVE, _NOT_LARGE, _NOT_SMALL)
EXPONENT = Numbers(1, _FINITE, _NOT_NEGATIVE, _NOT_HUGE)


def number_validators(dataclass: Any) -> dict[str, Numbers]:
    """Return the validators of all fields of a dataclass that consist of numbers.

    Parameters
    ----------
    dataclass : type or object
        A dataclass, or an instance of one.

    Returns
    -------
    validators : dict of Numbers
        The key is the name of the field.
    """
    validators = {field.name: field.metadata.get("validator") for field in fields(dataclass)}
    return {
        name: validator for name, validator in validators.items() if isinstance(validator, Numbers)
    }


def find_errors(dataclass: type[Validated], columns: Columns) -> Iterator[RowError]:
    """Find invalid numbers, and numbers that contradict each other, in many objects of a dataclass.

    Parameters
    ----------
    dataclass : subclass of Validated
        The class of the objects.
    columns : mapping of (n, count) float arrays
        The numbers of n objects.  The key is the name of a field; the value contains the numbers of
        this field, NaN where an object has no value.

    Yields
    ------
    index : int
        Index of an object, from 0 to n - 1.
    name : str
        Name of the field.
    message : str
        What is wrong.
    """
    for name, validator in number_validators(dataclass).items():
        for index, message in validator.find_errors(columns[name]):
            yield index, name, message
    yield from dataclass.find_conflicts(columns)


def copy_integers(value: ArrayLike, name: str) -> NDArray[np.intp]:
    """Copy whole numbers into a one-dimensional int array.

    Parameters
    ----------
    value : array_like
        The numbers.
    name : str
        Name of the argument, for messages.

    Raises
    ------
    SceneError
        If the value contains anything but whole numbers.
    """
    floats = _float_array(value, name).ravel()
    with np.errstate(invalid="ignore"):
        array = floats.astype(np.intp)
    if not np.array_equal(array, floats):
        raise SceneError([f"{name}: must be whole numbers"])
    return array


def validate_pixel_count(value: int, name: str) -> int:
    """Validate the width or height of a picture.

    Parameters
    ----------
    value : int
        Width or height in pixels; a NumPy integer is accepted.
    name : str
        Name of the field, for messages.

    Returns
    -------
    count : int
        The same number as a Python int.

    Raises
    ------
    SceneError
        If the value is not an integer, is less than 1 or more than `MAX_PIXELS`.
    """
    try:
        count = int(operator.index(value))  # products of NumPy integers may overflow
    except TypeError:
        raise SceneError([f"{name}: must be an int, is {value!r}"]) from None
    if not 1 <= count <= MAX_PIXELS:
        # float() and str() refuse numbers of many digits.
        has = f", is {count}" if abs(count) < 1e18 else ""
        raise SceneError([f"{name}: must be a whole number from 1 to {MAX_PIXELS}{has}"])
    return count


def list_of(*types: type) -> _Validator:
    """Return a function that validates the types of any number of objects.

    Parameters
    ----------
    *types : type
        The allowed types.

    Returns
    -------
    validate : callable
        Called with an iterable of objects and the name of their field, it returns the objects as a
        tuple, or raises `SceneError` if one of them has another type.
    """
    allowed = " or ".join(each.__name__ for each in types)

    def validate(values: Iterable[object], name: str) -> tuple[object, ...]:
        try:
            items = tuple(values)
        except TypeError:
            message = f"{name}: must be a list, is of type {type(values).__name__}"
            raise SceneError([message]) from None
        others = dict.fromkeys(type(item).__name__ for item in items if not isinstance(item, types))
        raise_if_any(f"{name}: must be of type {allowed}, is of type {other}" for other in others)
        return items

    return validate


def one_of(*types: type) -> _Validator:
    """Return a function that validates the type of one object.

    Parameters
    ----------
    *types : type
        The allowed types.

    Returns
    -------
    validate : callable
        Called with an object and the name of its field, it returns the object, or raises
        `SceneError` if the object has another type.
    """
    validate_list = list_of(*types)
    return lambda value, name: validate_list([value], name)[0]


def _float_array(value: ArrayLike, name: str) -> Floats:
    """Copy real numbers into a float64 array of the same shape.

    Parameters
    ----------
    value : array_like
        The numbers.
    name : str
        Name of the field, for messages.

    Raises
    ------
    SceneError
        If the value contains anything but real numbers: text, None, times, complex numbers, or
        integers beyond the range of float64.
    """
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
