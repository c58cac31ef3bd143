"""Values of a group of samples: one number for all of them, or an array (n,).

A large object fills arrays of its own, and its data stay numbers; small
objects share arrays, and their data are gathered.  NumPy's broadcasting lets
the same arithmetic serve both.
"""

from __future__ import annotations

from typing import Any, TypeAlias, TypeVar

import numpy as np

from tracer.scene import Floats, Ints

__all__ = ["Index", "Scalars", "Vectors", "select", "spread"]

Index: TypeAlias = int | Ints
Scalars: TypeAlias = float | Floats
Vectors: TypeAlias = tuple[Scalars, Scalars, Scalars]

T = TypeVar("T")


def select(value: T, index: Ints | slice) -> T:
    """The value of some samples of the group."""
    if np.ndim(value):  # type: ignore[arg-type]
        chosen: Any = value[index]  # type: ignore[index]
        return chosen  # type: ignore[no-any-return]
    return value


def spread(value: T, counts: Ints) -> T:
    """Each element so many times; a number stays one."""
    if np.ndim(value):  # type: ignore[arg-type]
        repeated: Any = np.repeat(value, counts)  # type: ignore[arg-type]
        return repeated  # type: ignore[no-any-return]
    return value


def where(mask: np.ndarray) -> Ints | slice:
    """Index of the elements where the mask holds: a slice, if that is everywhere."""
    index = np.flatnonzero(mask)
    return slice(None) if index.size == mask.size else index
