"""Types of arrays, and sums and ranges over them."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Floats: TypeAlias = NDArray[np.float64]
Ints: TypeAlias = NDArray[np.intp]
Bools: TypeAlias = NDArray[np.bool_]


def sums(index: Ints, values: Floats, count: int) -> Floats:
    """Sums (count,) of the values of each index; np.bincount makes integers of none at all."""
    return np.bincount(index, values, count).astype(np.float64, copy=False)


def segments(counts: Ints, start: Ints) -> tuple[Ints, Ints]:
    """For each i, counts[i] pairs of i and a number: start[i], start[i] + 1, ..."""
    which = np.arange(counts.size).repeat(counts)
    return which, np.arange(which.size) - (counts.cumsum() - counts - start)[which]
