"""Validate the values of a scene.

The metadata of a dataclass field contain its validator, and its XML tags (`tag_field`).  The same
rules validate the fields of one object (`Validated`), the arrays of `Surfaces`, and the numbers in
a scene file (`find_errors`).
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

MAX_PIXELS = 1 << 28
"""Maximum number of pixels in a picture: 2^28 (16384 x 16384), 6 GiB as float64 RGB."""

# Limits for the magnitude of lengths and coordinates other than 0.  The upper limit applies to
# colours and exponents, too.  The fourth powers of numbers between the limits are normal float64.
_MIN_LENGTH, _MAX_VALUE = 1e-75, 1e75


def format_number(value: float) -> str:
    """Format a number as the shortest text that denotes it exactly: "3", "0.5", "1e+20"."""
    return f"{value}".removesuffix(".0")


class SceneError(ValueError):
    """Raised if a scene contains invalid values; the message has one line for each of them.

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
    """Raise a `SceneError` with the given lines as its message, unless there are no lines."""
    if message_lines := tuple(lines):
        raise SceneError(message_lines)


_Validator: TypeAlias = Callable[[Any, str], Any]


def tag_field(validator: _Validator, *tags: str) -> dict[str, Any]:
    """Create the metadata of a dataclass field: its validator, and its XML tags.

    Parameters
    ----------
    validator : callable
        A function that takes a value and the name of the field.  It returns the value to store,
        or raises `SceneError`.
    *tags : str
        Tags of the XML elements that can contain the value in a scene file.  The first tag is used
        for writing files.

    Returns
    -------
    metadata : dict
        The entries "validator" and "tags".
    """
    return {"validator": validator, "tags": tags}


class Validated:
    """A base class of frozen dataclasses that validate their fields, one by one and then together.

    A subclass gives each field a validator with `tag_field`.  It overrides `find_conflicts` if
    valid values can contradict each other.  The constructor raises `SceneError` for invalid values.
    """

    __slots__ = ("__weakref__",)

    def __post_init__(self: Any) -> None:
        lines: list[str] = []
        for field in fields(self):
            validate, value = field.metadata.get("validator"), getattr(self, field.name)
            if validate is not None and (value is not None or field.default is not None):
                try:
                    object.__setattr__(self, field.name, validate(value, field.name))
                except SceneError as error:
                    lines += error.lines
        raise_if_any(lines)
        row = {name: np.array([getattr(self, name)], float) for name in get_number_validators(self)}
        raise_if_any(f"{name}: {message}" for _, name, message in self.find_conflicts(row))

    @classmethod
    def find_conflicts(cls, field_arrays: Mapping[str, Floats]) -> Iterable[tuple[int, str, str]]:
        """Find objects whose values are valid individually but contradict each other.

        Parameters
        ----------
        field_arrays : mapping of str to (n, number_count) float array
            For each field name, the values of this field in n objects.  NaN marks a missing value.

        Returns
        -------
        errors : iterable of (int, str, str)
            For each error, the index of the object, the name of the field, and the message.  The
            base class finds no errors.
        """
        return ()


def construct_unchecked(dataclass: type[_Instance], **values: object) -> _Instance:
    """Create an instance of a frozen dataclass from values that are known to be valid.

    The constructor is not called, because it would validate the values again.

    Parameters
    ----------
    dataclass : type
        The class to instantiate.
    **values : object
        The values of all fields, by field name.

    Returns
    -------
    instance : object
        The new instance of the class.
    """
    instance = object.__new__(dataclass)
    for name, value in values.items():
        object.__setattr__(instance, name, value)
    return instance


# A function that tests which numbers in an array are invalid, and a message, in which {} stands for
# the invalid number.
_Rule: TypeAlias = tuple[Callable[[Floats], NDArray[np.bool_]], str]

_MAX_TEXT = format_number(_MAX_VALUE)
_LIMITS = f"lengths other than 0 are from {format_number(_MIN_LENGTH)} to {_MAX_TEXT}"
_FINITE: _Rule = (lambda x: ~np.isfinite(x), "must be finite")
_NOT_LARGE: _Rule = (lambda x: abs(x) > _MAX_VALUE, f"{{}} is too large; {_LIMITS}")
_NOT_HUGE: _Rule = (lambda x: x > _MAX_VALUE, f"{{}} is too large; it is at most {_MAX_TEXT}")
_NOT_SMALL: _Rule = (lambda x: (abs(x) < _MIN_LENGTH) & (x != 0), f"{{}} is too small; {_LIMITS}")
_NOT_NEGATIVE: _Rule = (lambda x: x < 0, "must be 0 or more, not {}")
_POSITIVE: _Rule = (lambda x: x <= 0, "must be positive, not {}")
_NOT_ZERO: _Rule = (lambda x: (x == 0) & ~x.any(1, keepdims=True), "must not be the zero vector")


class NumberValidator:
    """The validator of a field that consists of one or several numbers, such as a point.

    Parameters
    ----------
    number_count : int
        Number of numbers in the field.
    *rules : (callable, str)
        Each rule is a function and a message.  The function tests which numbers in an array are
        invalid.  In the message, {} stands for the invalid number.

    Attributes
    ----------
    requirement : str
        The required count, as a phrase for messages: "needs 3 numbers".
    """

    def __init__(self, number_count: int, *rules: _Rule) -> None:
        self.number_count, self.rules = number_count, rules
        self.requirement = f"needs {number_count} number{'s' * (number_count > 1)}"

    def __call__(self, value: ArrayLike, name: str) -> tuple[float, ...] | float:
        """Validate the value of a field, and convert it to Python floats.

        Parameters
        ----------
        value : array_like
            A number, or a sequence of `number_count` numbers.
        name : str
            Name of the field, for messages.

        Returns
        -------
        numbers : tuple of float, or float
            A single float if one number is required, otherwise a tuple.

        Raises
        ------
        SceneError
            If there are too few or too many numbers, or a number violates a rule.
        """
        array = _copy_floats(value, name)
        if array.size != self.number_count or array.ndim > 1:
            shape_or_size = f"shape {array.shape}" if array.ndim > 1 else array.size
            raise SceneError([f"{name}: {self.requirement}, but has {shape_or_size}"])
        row = array.reshape(1, self.number_count)
        raise_if_any(f"{name}: {message}" for _, message in self.find_errors(row))
        return tuple(row[0].tolist()) if self.number_count > 1 else row.item()

    def copy_rows(self, values: ArrayLike, name: str) -> Floats:
        """Copy the values of a field into an array, with one row for each object.

        Only the shape and the type are checked here; `find_errors` checks the numbers themselves.

        Parameters
        ----------
        values : (n, number_count) array_like, or (n,) array_like if `number_count` is 1
            The values of the field in n objects, each of which has `number_count` numbers.
        name : str
            Name of the field, for messages.

        Returns
        -------
        rows : (n, number_count) or (n,) float array
            The copy; one-dimensional if `number_count` is 1.

        Raises
        ------
        SceneError
            If the shape is wrong, or the values are not real numbers.
        """
        array = _copy_floats(values, name)
        if array.size % self.number_count or array.shape[1:] not in ((), (self.number_count,)):
            raise SceneError([f"{name}: {self.requirement} per row, but has shape {array.shape}"])
        return array.reshape((-1, self.number_count) if self.number_count > 1 else -1)

    def find_errors(self, rows: Floats) -> Iterator[tuple[int, str]]:
        """Find the rows of an array that violate a rule of this validator.

        A rule tests for one kind of invalid number, such as negative numbers.

        Parameters
        ----------
        rows : (n, number_count) float array
            The values of a field in n objects, one row for each object.

        Yields
        ------
        index : int
            Index of a row with an invalid number.
        message : str
            What is wrong with the row; only the first violated rule is reported.
        """
        message_of_row: dict[int, str] = {}
        for find_invalid_numbers, template in self.rules:
            is_invalid = find_invalid_numbers(rows)
            for index in np.flatnonzero(is_invalid.any(axis=1)).tolist():
                invalid_number = rows[index, is_invalid[index]][0]
                message_of_row.setdefault(index, template.format(format_number(invalid_number)))
        yield from message_of_row.items()


POINT = NumberValidator(3, _FINITE, _NOT_LARGE, _NOT_SMALL)
DIRECTION = NumberValidator(3, _FINITE, _NOT_ZERO)
COLOR = NumberValidator(3, _FINITE, _NOT_NEGATIVE, _NOT_HUGE)
LENGTH = NumberValidator(1, _FINITE, _POSITIVE, _NOT_LARGE, _NOT_SMALL)
EXPONENT = NumberValidator(1, _FINITE, _NOT_NEGATIVE, _NOT_HUGE)


def get_number_validators(dataclass: Any) -> dict[str, NumberValidator]:
    """Return the validators of all numeric fields of a dataclass.

    Parameters
    ----------
    dataclass : type or object
        A dataclass, or an instance of one.

    Returns
    -------
    validators : dict of str to NumberValidator
        The validator of each field that consists of numbers, under the name of the field.
    """
    items = ((field.name, field.metadata.get("validator")) for field in fields(dataclass))
    return {name: validator for name, validator in items if isinstance(validator, NumberValidator)}


def find_errors(
    dataclass: type[Validated], field_arrays: Mapping[str, Floats]
) -> Iterator[tuple[int, str, str]]:
    """Find invalid and contradictory numbers in many objects of one class.

    Parameters
    ----------
    dataclass : subclass of Validated
        The class of the objects.
    field_arrays : mapping of str to (n, number_count) float array
        For each field name, the values of this field in n objects.  NaN marks a missing value.

    Yields
    ------
    index : int
        Index of the object with the error, from 0 to n - 1.
    name : str
        Name of the field with the error.
    message : str
        What is wrong, without the name of the field.
    """
    for name, validator in get_number_validators(dataclass).items():
        for index, message in validator.find_errors(field_arrays[name]):
            yield index, name, message
    yield from dataclass.find_conflicts(field_arrays)


def copy_integers(values: ArrayLike, name: str) -> NDArray[np.intp]:
    """Copy whole numbers into a one-dimensional int array.

    Parameters
    ----------
    values : array_like
        The numbers; floats are accepted if they are whole.
    name : str
        Name of the argument, for messages.

    Returns
    -------
    integers : (n,) int array
        The copy.

    Raises
    ------
    SceneError
        If a value is not a whole number.
    """
    floats = _copy_floats(values, name).ravel()
    with np.errstate(invalid="ignore"):
        integers = floats.astype(np.intp)
    if not np.array_equal(integers, floats):
        raise SceneError([f"{name}: must be whole numbers"])
    return integers


def validate_picture_side(value: int, name: str) -> int:
    """Validate the width or height of a picture, and convert it to a Python int.

    Parameters
    ----------
    value : int
        Width or height in pixels; NumPy integers are accepted.
    name : str
        Name of the field, for messages.

    Returns
    -------
    side : int
        The same number as a Python int.

    Raises
    ------
    SceneError
        If the value is not an integer from 1 to `MAX_PIXELS`.
    """
    try:
        side = int(operator.index(value))  # products of NumPy integers may overflow
    except TypeError:
        raise SceneError([f"{name}: must be an int, not {value!r}"]) from None
    if not 1 <= side <= MAX_PIXELS:
        # Python cannot format integers that have too many digits.
        value_text = f", not {side}" if abs(side) < 1e18 else ""
        raise SceneError([f"{name}: must be a whole number from 1 to {MAX_PIXELS}{value_text}"])
    return side


def require_list(*types: type) -> _Validator:
    """Return a function that checks the types of all objects in a list.

    Parameters
    ----------
    *types : type
        The allowed types.

    Returns
    -------
    validate : callable
        A function that takes an iterable of objects and the name of a field.  It returns the
        objects as a tuple, or raises `SceneError` if an object is of another type.
    """
    allowed_types = " or ".join(allowed_type.__name__ for allowed_type in types)

    def validate(values: Iterable[object], name: str) -> tuple[object, ...]:
        try:
            items = tuple(values)
        except TypeError:
            message = f"{name}: must be a list, not of type {type(values).__name__}"
            raise SceneError([message]) from None
        bad_types = (type(item).__name__ for item in items if not isinstance(item, types))
        requirement = f"{name}: must be of type {allowed_types}"
        raise_if_any(f"{requirement}, not {bad_type}" for bad_type in dict.fromkeys(bad_types))
        return items

    return validate


def require_type(*types: type) -> _Validator:
    """Return a function that checks the type of an object.

    Parameters
    ----------
    *types : type
        The allowed types.

    Returns
    -------
    validate : callable
        A function that takes an object and the name of a field.  It returns the object, or
        raises `SceneError` if the object is of another type.
    """
    validate_list = require_list(*types)
    return lambda value, name: validate_list([value], name)[0]


def _copy_floats(value: ArrayLike, name: str) -> Floats:
    """Copy real numbers into a float64 array of the same shape.

    Parameters
    ----------
    value : array_like
        The numbers.
    name : str
        Name of the field or argument, for messages.

    Returns
    -------
    array : float64 array
        The copy.

    Raises
    ------
    SceneError
        If the value contains text, None, dates, complex numbers, or integers beyond the range of
        float64.
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
        message = f"must consist of numbers, not {reprlib.repr(value)}"
    raise SceneError([f"{name}: {message}"])
