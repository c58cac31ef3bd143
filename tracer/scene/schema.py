"""Checks of what a scene is made of: from a value as given to the one to keep.

Told the parameter's name, a check adds what is wrong to a list of faults and goes on with
something harmless in its place: so all faults can be told at once, not only the first.
"""

from __future__ import annotations

import operator
import reprlib
from collections.abc import Callable, Iterable
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tracer.arrays import Floats, Ints, Vector
from tracer.messages import number

__all__ = [
    "LARGEST",
    "MAX_PIXELS",
    "SMALLEST",
    "Check",
    "Fault",
    "SceneError",
    "apply",
    "color",
    "direction",
    "integers",
    "list_of",
    "not_negative",
    "one_of",
    "optional",
    "order_faults",
    "point",
    "point_faults",
    "positive",
    "positive_faults",
    "raise_any",
    "rows",
    "size",
    "values",
]

MAX_PIXELS = 1 << 28
"""Largest picture, in pixels: 2^28 (16384 x 16384), 6 GiB as float64 RGB."""

SMALLEST, LARGEST = 1e-75, 1e75
"""Between these in size are lengths and coordinates other than 0: float64 holds fourth powers."""


class Fault(NamedTuple):
    """One fault: the parameter, and what is wrong with it, and what would be right."""

    field: str
    message: str
    surface: int | None = None
    """Index, in file order, of the surface at fault, if the fault lies in one of many."""

    def __str__(self) -> str:
        where = "" if self.surface is None else f"surface {self.surface}: "
        return f"{where}{self.field}: {self.message}"


class SceneError(ValueError):
    """An impossible scene.

    Attributes
    ----------
    faults : tuple of Fault
        Everything that is wrong, in the order it was found.
    """

    def __init__(self, faults: Iterable[Fault]) -> None:
        self.faults = tuple(faults)
        super().__init__("\n".join(str(fault) for fault in self.faults))

    def __reduce__(self) -> tuple[Any, ...]:
        # By default an exception is copied as cls(*args), and `args` holds only the message.
        return type(self), (self.faults,), self.__dict__


Check: TypeAlias = Callable[[Any, str, list[Fault]], Any]
"""From a value as given and the parameter's name to the value to keep; adds to the faults."""


def apply(made: object, **checks: Check) -> None:
    """Set fields of a frozen dataclass to what their checks make of them; raise `SceneError`."""
    faults: list[Fault] = []
    for name, check in checks.items():
        object.__setattr__(made, name, check(getattr(made, name), name, faults))
    raise_any(faults)


def raise_any(faults: Iterable[Fault]) -> None:
    """Raise `SceneError` if there are faults."""
    if faults := tuple(faults):
        raise SceneError(faults)


# One parameter: each of these is a `Check`, or makes one.


def point(value: ArrayLike, name: str, faults: list[Fault]) -> Vector:
    vector = _vector(value, name, faults)
    faults += _size_faults(name, np.array([vector]))
    return vector


def direction(value: ArrayLike, name: str, faults: list[Fault]) -> Vector:
    vector = _vector(value, name, faults)
    if vector == (0.0, 0.0, 0.0):
        faults.append(Fault(name, "must not be the zero vector"))
    return vector


def color(value: ArrayLike, name: str, faults: list[Fault]) -> Vector:
    vector = _vector(value, name, faults)
    if min(vector) < 0:
        faults.append(Fault(name, f"must not be negative, has {number(min(vector))}"))
    return vector


def positive(value: float, name: str, faults: list[Fault]) -> float:
    value = _number(value, name, faults)
    faults += positive_faults(name, np.array([value]))
    return value


def not_negative(value: float, name: str, faults: list[Fault]) -> float:
    value = _number(value, name, faults)
    if not (0 <= value < np.inf):
        faults.append(Fault(name, f"must be finite and not negative, is {number(value)}"))
    return value


def size(value: int, name: str, faults: list[Fault]) -> int:
    """A Python int: products of NumPy's integers may overflow."""
    try:
        count = int(operator.index(value))
    except TypeError:
        faults.append(Fault(name, f"must be an int, is {value!r}"))
        return 1
    # A message leaves out what may have more digits than float() or str() accepts.
    if count < 1:
        has = f", is {count}" if count > -MAX_PIXELS else ""
        faults.append(Fault(name, f"must be a whole number of at least 1{has}"))
    elif count > MAX_PIXELS:
        faults.append(Fault(name, f"must be at most {MAX_PIXELS}"))
    return count


def optional(check: Check) -> Check:
    return lambda value, name, faults: None if value is None else check(value, name, faults)


def one_of(*types: type) -> Check:
    def check(value: object, name: str, faults: list[Fault]) -> object:
        if not isinstance(value, types):
            right = " or ".join(each.__name__ for each in types)
            wrong = f"must be of type {right}, is of type {type(value).__name__}"
            faults.append(Fault(name, wrong))
        return value

    return check


def list_of(*types: type) -> Check:
    check_one = one_of(*types)

    def check(values: Iterable[object], name: str, faults: list[Fault]) -> tuple[object, ...]:
        try:
            parts = tuple(values)
        except TypeError:
            faults.append(Fault(name, f"must be a list, is of type {type(values).__name__}"))
            return ()
        for part in {type(part): part for part in parts}.values():
            check_one(part, name, faults)
        return parts

    return check


def _vector(value: ArrayLike, name: str, faults: list[Fault]) -> Vector:
    array = _floats(value, name, faults)
    if array is None:
        pass  # told already
    elif array.shape != (3,):
        has = array.size if array.ndim < 2 else f"shape {array.shape}"
        faults.append(Fault(name, f"needs 3 numbers, has {has}"))
    elif not np.isfinite(array).all():
        faults.append(Fault(name, "must be finite"))
    else:
        x, y, z = array.tolist()
        return (x, y, z)
    # In place of what is at fault: a point, a direction and a colour with no fault to add.
    return (0.0, 0.0, 1.0)


def _number(value: float, name: str, faults: list[Fault]) -> float:
    array = _floats(value, name, faults)
    if array is None:
        return 1.0
    if array.size != 1:
        faults.append(Fault(name, f"must be a single number, has {array.size}"))
        return 1.0
    return array.item()


# Parameters of many surfaces at once, as arrays.


def rows(value: ArrayLike, name: str, faults: list[Fault]) -> Floats:
    """A copy as (n, 3)."""
    array = _floats(value, name, faults)
    if array is not None and (array.size % 3 or array.shape[1:] not in ((), (3,))):
        faults.append(Fault(name, f"needs 3 numbers in each row, has shape {array.shape}"))
        array = None
    return np.zeros((0, 3)) if array is None else array.reshape(-1, 3).copy()


def values(value: ArrayLike, name: str, faults: list[Fault]) -> Floats:
    """A copy as (n,)."""
    array = _floats(value, name, faults)
    return np.zeros(0) if array is None else array.flatten()


def integers(value: ArrayLike, name: str, faults: list[Fault]) -> Ints:
    """A copy as (n,)."""
    given = values(value, name, faults)
    with np.errstate(invalid="ignore"):
        array = given.astype(np.intp)
    if not np.array_equal(array, given):
        faults.append(Fault(name, "must be whole numbers"))
    return array


def _floats(value: ArrayLike, name: str, faults: list[Fault]) -> Floats | None:
    """As an array; None after a fault."""
    try:
        array = np.asarray(value)
        # NumPy would read texts, make NaN of None and of times, and drop a part of complex numbers.
        if value is None or array.dtype.kind in "USmMc":
            raise TypeError
        return np.asarray(array, dtype=np.float64)
    except OverflowError:
        faults.append(Fault(name, "must be finite"))
    except (TypeError, ValueError):
        faults.append(Fault(name, f"must be given in numbers, is {reprlib.repr(value)}"))
    return None


# What is wrong with rows of such arrays; `index` (n,) tells of which surface each row is.

# The index of one that is none of many.
_ALONE = np.array([None])


def positive_faults(name: str, values: Floats, index: NDArray[Any] = _ALONE) -> Iterable[Fault]:
    """Values (n,) that are not."""
    for i in np.flatnonzero(~((values > 0) & (values < np.inf))).tolist():
        yield Fault(name, f"must be positive and finite, is {number(values[i])}", index.item(i))
    yield from _size_faults(name, values[:, None], index)


def point_faults(name: str, points: Floats, index: Ints) -> Iterable[Fault]:
    """Points (n, 3) that are not finite, or out of range."""
    for i in np.flatnonzero(~np.isfinite(points).all(axis=1)).tolist():
        yield Fault(name, "must be finite", index.item(i))
    yield from _size_faults(name, points, index)


def order_faults(min_pt: Floats, max_pt: Floats, index: NDArray[Any] = _ALONE) -> Iterable[Fault]:
    """Corners (n, 3) in the wrong order along an axis."""
    wrong = min_pt > max_pt
    for i in np.flatnonzero(wrong.any(axis=1)).tolist():
        has = " and ".join(
            f"{'xyz'[axis]} has {number(min_pt[i, axis])} > {number(max_pt[i, axis])}"
            for axis in np.flatnonzero(wrong[i]).tolist()
        )
        yield Fault("min_pt", f"must not exceed max_pt, but {has}; swap these", index.item(i))


def _size_faults(name: str, lengths: Floats, index: NDArray[Any] = _ALONE) -> Iterable[Fault]:
    """Rows (n, k) of lengths or coordinates too large or too small to compute with."""
    size = np.abs(lengths)
    # What is not finite is another fault.
    wrong = ((size > LARGEST) & (size < np.inf)) | ((size < SMALLEST) & (size > 0))
    for i in np.flatnonzero(wrong.any(axis=1)).tolist():
        k = wrong[i].argmax()
        too = "large" if size[i, k] > 1 else "small"
        limits = f"lengths other than 0 are from {number(SMALLEST)} to {number(LARGEST)}"
        yield Fault(name, f"{number(lengths[i, k])} is too {too}; {limits}", index.item(i))
