"""Types of arrays, and sums and places by groups."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Floats: TypeAlias = NDArray[np.float64]
Ints: TypeAlias = NDArray[np.intp]
Bools: TypeAlias = NDArray[np.bool_]
Index: TypeAlias = Ints | Bools


def sums(index: Ints, values: Floats, count: int) -> Floats:
    """Sums (count,) of the values of each index; np.bincount makes integers of none at all."""
    return np.bincount(index, values, count).astype(np.float64, copy=False)


def add_runs(total: Floats, index: Ints, values: Floats) -> None:
    """Add values (..., n) to the totals (..., m) of their indices (n,), which ascend."""
    first = np.flatnonzero(np.diff(index, prepend=-1))
    total[..., index[first]] += np.add.reduceat(values, first, axis=-1)


def segments(counts: Ints, start: Ints) -> tuple[Ints, Ints]:
    """For each i, counts[i] pairs of i and a number: start[i], start[i] + 1, ..."""
    which = np.arange(counts.size).repeat(counts)
    return which, np.arange(which.size) - (counts.cumsum() - counts - start)[which]


def places(keys: Ints, wanted: Ints) -> Ints:
    """Where numbers are among ascending keys, or -1."""
    at = keys.searchsorted(wanted)
    return np.where(np.append(keys, -1)[at] == wanted, at, -1)
