"""Validate the values of a scene.

The parts of a scene are dataclasses.  The metadata of each field contain its *validator*, a
function of a value and the name of the field.  It returns the value to store, or raises
`SceneError`.

The same rules validate one object, the arrays of `Surfaces`, and the tables of a scene file.
Numbers are therefore checked as the *rows* of a field: its values in n objects, one row of numbers
for each object.  A row of NaN stands for a missing value.  Two kinds of errors are found: a row
that violates a rule of its field (`NumberValidator.find_invalid_rows`), and an object whose fields
are valid, each on its own, but contradict each other (`Validated.find_conflicts`).
`find_field_errors` finds both in all fields of a class.
"""

from __future__ import annotations

import operator
import reprlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import fields
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias, TypeVar
from typing import Annotated as Shaped

import numpy as np
from numpy.typing import ArrayLike

from tracer.arrays import Bools, Floats, Ints

_Instance = TypeVar("_Instance")

MAX_PIXELS = 1 << 28
"""Maximum number of pixels in a picture: 2^28 (16384 x 16384), 6 GiB as float64 RGB."""

# Minimum magnitude of lengths and coordinates other than 0.
_MIN_LENGTH = 1e-75
# Maximum magnitude of lengths, coordinates, colours and exponents.  The fourth powers of numbers
# between the limits are normal float64.
_MAX_VALUE = 1e75


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
    """Raise a `SceneError` with these lines as its message; do nothing if there are none."""
    if message_lines := tuple(lines):
        raise SceneError(message_lines)


class FieldError(NamedTuple):
    """An error in a field of one object."""

    row: int  # index of the object among those that were checked
    name: str  # name of the field
    message: str  # what is wrong, without the name of the field


_Validator: TypeAlias = Callable[[Any, str], Any]


def tag_field(validator: _Validator, *tags: str) -> dict[str, Any]:
    """Create the metadata of a dataclass field: its validator, and its XML tags.

    A scene file may contain any of the tags.  `save_scene` writes the first one.
    """
    return {"validator": validator, "tags": tags}


class Validated:
    """A base class of frozen dataclasses that validate their fields, one by one and then together.

    A subclass gives each field a validator with `tag_field`, and overrides `find_conflicts` if
    values that are valid on their own can contradict each other.  Its constructor takes keywords
    only, and raises one `SceneError` that lists all invalid values.
    """

    __slots__ = ("__weakref__",)

    # Python passes the arguments of a call to `__new__`, and then to the `__init__` that @dataclass
    # generates.  If values are given by position, `__init__` would only say how many arguments it
    # takes, so `__new__` raises an error that lists the keywords.  Type checkers must not see
    # `__new__`: as it accepts any arguments, they would no longer compare calls with the fields.
    if not TYPE_CHECKING:

        def __new__(cls, *args: object, **_values: object) -> Any:
            """Create an instance, or raise a TypeError that lists the keywords to use."""
            if args:
                names = [field.name for field in fields(cls) if "validator" in field.metadata]
                keywords = ", ".join(f"{name}=..." for name in names)
                raise TypeError(f"{cls.__name__} takes keywords only: {cls.__name__}({keywords})")
            return super().__new__(cls)

    def __post_init__(self: Any) -> None:
        lines: list[str] = []
        for field in fields(self):
            validate = field.metadata.get("validator")
            value = getattr(self, field.name)
            # A field whose default is None may be omitted.  In all others, None is an error.
            is_omitted = value is None and field.default is None
            if validate is None or is_omitted:
                continue
            try:
                # The instance is frozen, so `setattr` would fail.
                object.__setattr__(self, field.name, validate(value, field.name))
            except SceneError as error:
                lines += error.lines
        raise_if_any(lines)

        def get_row(name: str) -> Floats:
            return np.array([getattr(self, name)], dtype=np.float64)  # NaN for None

        raise_if_any(f"{error.name}: {error.message}" for error in self.find_conflicts(get_row))

    @classmethod
    def find_conflicts(cls, get_rows: Callable[[str], Floats]) -> Iterable[FieldError]:
        """Find objects whose fields contradict each other.  This default finds none.

        `get_rows` takes the name of a field, and returns an array with one row of numbers for each
        object.  It may contain rows that violate the rules of the field, which are reported anyway.
        """
        return ()


def construct_unchecked(dataclass: type[_Instance], **values: object) -> _Instance:
    """Create an instance of a frozen dataclass without calling its constructor.

    This saves validating the values again.  `values` must contain a valid value for each field.
    """
    instance = object.__new__(dataclass)
    for name, value in values.items():
        object.__setattr__(instance, name, value)
    return instance


class _Rule(NamedTuple):
    """A rule that the numbers in each row of a field must obey."""

    find_invalid: Callable[[Floats], Bools]  # takes rows, and marks the numbers that break the rule
    message: str  # what is wrong; {} stands for the invalid number


_MAX_TEXT = format_number(_MAX_VALUE)
_LIMITS = f"lengths other than 0 are from {format_number(_MIN_LENGTH)} to {_MAX_TEXT}"
_FINITE = _Rule(lambda x: ~np.isfinite(x), "must be finite")
_NOT_LARGE = _Rule(lambda x: abs(x) > _MAX_VALUE, f"{{}} is too large; {_LIMITS}")
_NOT_HUGE = _Rule(lambda x: x > _MAX_VALUE, f"{{}} is too large; it is at most {_MAX_TEXT}")
_NOT_SMALL = _Rule(lambda x: (abs(x) < _MIN_LENGTH) & (x != 0), f"{{}} is too small; {_LIMITS}")
_NOT_NEGATIVE = _Rule(lambda x: x < 0, "must be 0 or more, not {}")
_POSITIVE = _Rule(lambda x: x <= 0, "must be positive, not {}")
_NOT_ZERO = _Rule(lambda x: (x == 0) & ~x.any(axis=1, keepdims=True), "must not be the zero vector")


class NumberValidator:
    """The validator of a field that consists of one or several numbers, such as a point."""

    number_count: int  # count of numbers in each row
    rules: tuple[_Rule, ...]
    requirement: str  # the count as a phrase for messages: "needs 3 numbers"

    def __init__(self, number_count: int, *rules: _Rule) -> None:
        self.number_count = number_count
        self.rules = rules
        self.requirement = f"needs {number_count} number{'s' * (number_count > 1)}"

    def __call__(self, value: ArrayLike, name: str) -> tuple[float, ...] | float:
        """Validate the value of the field in one object, and return the value to store.

        The result is a tuple of floats, or a float if `number_count` is 1.  Raise `SceneError` if
        the value has the wrong type or shape, or violates a rule.
        """
        array = _copy_floats(value, name)
        if array.size != self.number_count or array.ndim > 1:
            shape_or_size = f"shape {array.shape}" if array.ndim > 1 else array.size
            raise SceneError([f"{name}: {self.requirement}, but has {shape_or_size}"])
        row = array.reshape(1, self.number_count)
        raise_if_any(f"{name}: {message}" for _, message in self.find_invalid_rows(row))
        return tuple(row[0].tolist()) if self.number_count > 1 else row.item()

    def copy_rows(self, values: ArrayLike, name: str) -> Shaped[Floats, "n ..."]:
        """Copy the rows of the field into an array: (n, number_count), or (n,) for one number.

        Raise `SceneError`, with the name of the field, if the values have the wrong type or shape.
        The rules are not checked here, but by `find_invalid_rows`.
        """
        array = _copy_floats(values, name)
        if array.size % self.number_count or array.shape[1:] not in ((), (self.number_count,)):
            raise SceneError([f"{name}: {self.requirement} per row, but has shape {array.shape}"])
        return array.reshape((-1, self.number_count) if self.number_count > 1 else -1)

    def find_invalid_rows(
        self, rows: Shaped[Floats, "n number_count"]
    ) -> Iterator[tuple[int, str]]:
        """Yield the index of each row that violates a rule, and what is wrong.

        If a row violates several rules, the first of these is reported.  NaN is not finite, so it
        violates the first rule of all fields.
        """
        message_of_row: dict[int, str] = {}
        for rule in self.rules:
            is_invalid = rule.find_invalid(rows)
            if not is_invalid.any():
                continue
            for index in np.flatnonzero(is_invalid.any(axis=1)).tolist():
                invalid_number = rows[index, is_invalid[index]][0]
                message_of_row.setdefault(index, rule.message.format(format_number(invalid_number)))
        yield from message_of_row.items()


POINT = NumberValidator(3, _FINITE, _NOT_LARGE, _NOT_SMALL)
DIRECTION = NumberValidator(3, _FINITE, _NOT_ZERO)
COLOR = NumberValidator(3, _FINITE, _NOT_NEGATIVE, _NOT_HUGE)
LENGTH = NumberValidator(1, _FINITE, _POSITIVE, _NOT_LARGE, _NOT_SMALL)
EXPONENT = NumberValidator(1, _FINITE, _NOT_NEGATIVE, _NOT_HUGE)


def get_number_validators(dataclass: Any) -> dict[str, NumberValidator]:
    """Map the name of each numeric field of a dataclass to the validator of its numbers."""
    items = ((field.name, field.metadata.get("validator")) for field in fields(dataclass))
    return {name: validator for name, validator in items if isinstance(validator, NumberValidator)}


def find_field_errors(
    dataclass: type[Validated], field_rows: Mapping[str, Shaped[Floats, "n number_count"]]
) -> Iterator[FieldError]:
    """Find invalid and contradictory numbers in n objects of one class.

    `field_rows` maps the name of each numeric field to an array with a row for each object.
    """
    for name, validator in get_number_validators(dataclass).items():
        for index, message in validator.find_invalid_rows(field_rows[name]):
            yield FieldError(row=index, name=name, message=message)
    yield from dataclass.find_conflicts(field_rows.__getitem__)


def copy_integers(values: ArrayLike, name: str) -> Shaped[Ints, "n"]:
    """Copy whole numbers into a one-dimensional int array; they may be floats such as 3.0.

    Raise `SceneError`, with the name, if a value is not a number, or not whole.
    """
    floats = _copy_floats(values, name).ravel()
    with np.errstate(invalid="ignore"):
        integers = floats.astype(np.intp)
    if not np.array_equal(integers, floats):
        raise SceneError([f"{name}: must be whole numbers"])
    return integers


def validate_picture_side(value: int, name: str) -> int:
    """Validate the width or height of a picture, and convert it to a Python int.

    The conversion is necessary because products of NumPy integers may overflow.  Raise
    `SceneError`, with the name, unless the value is an integer from 1 to `MAX_PIXELS`.
    """
    try:
        side = int(operator.index(value))
    except TypeError:
        raise SceneError([f"{name}: must be an int, not {value!r}"]) from None
    if not 1 <= side <= MAX_PIXELS:
        # Python cannot format integers that have too many digits.
        value_text = f", not {side}" if abs(side) < 1e18 else ""
        raise SceneError([f"{name}: must be a whole number from 1 to {MAX_PIXELS}{value_text}"])
    return side


def require_list(*types: type) -> _Validator:
    """Return a validator of iterables whose items must have one of these types.

    The validator stores the items as a tuple.
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
    """Return a validator of objects that must have one of these types; it stores the object."""
    validate_list = require_list(*types)
    return lambda value, name: validate_list([value], name)[0]


def _copy_floats(value: ArrayLike, name: str) -> Shaped[Floats, "..."]:
    """Copy real numbers into a float64 array of the same shape.

    Raise `SceneError`, with the name, if they are not real numbers, or too large for float64.
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
