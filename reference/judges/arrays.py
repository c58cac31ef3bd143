"""Types of arrays, and operations on groups of their elements, for the certificate.

The tracer has a function like `list_segment_elements`.  It is repeated here on purpose: a reference
that shares code with what it validates would repeat its errors.
"""

from __future__ import annotations

from typing import Annotated as Shaped
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Floats: TypeAlias = NDArray[np.float64]
Ints: TypeAlias = NDArray[np.intp]
Bools: TypeAlias = NDArray[np.bool_]
Index: TypeAlias = Ints | Bools
"""Indices of elements, or a mask with one bool per element."""


def sum_by_index(
    index: Shaped[Ints, "n"], values: Shaped[Floats, "n"], count: int
) -> Shaped[Floats, "count"]:
    """Add up the values that share an index, for each index from 0 to count - 1.

    The sum of no values is 0.
    """
    # Without values, np.bincount returns integers.
    return np.bincount(index, values, count).astype(np.float64, copy=False)


def add_at_sorted_index(
    totals: Shaped[Floats, "... m"], index: Shaped[Ints, "n"], values: Shaped[Floats, "... n"]
) -> None:
    """Add values to elements along the last axis of `totals`, in place.

    `index` must be sorted in ascending order, and may contain duplicates.  All values with the same
    index are added, whereas ``totals[..., index] += values`` would add only the last one.
    """
    # Equal indices are adjacent.  Sum the values from each first one to the next.
    run_start = np.flatnonzero(np.diff(index, prepend=-1))
    totals[..., index[run_start]] += np.add.reduceat(values, run_start, axis=-1)


def list_segment_elements(
    lengths: Shaped[Ints, "n"], starts: Shaped[Ints, "n"]
) -> tuple[Shaped[Ints, "m"], Shaped[Ints, "m"]]:
    """List the elements of several segments of an array, segment by segment.

    Segment i contains the elements starts[i] to starts[i] + lengths[i] - 1.  For each element of a
    segment, return the index of the segment, and the index of the element in the array.
    """
    segment_index = np.arange(lengths.size).repeat(lengths)
    # Position of a segment's first element in the result, minus its index in the array.
    offset = lengths.cumsum() - lengths - starts
    return segment_index, np.arange(segment_index.size) - offset[segment_index]


def find_in_sorted(
    sorted_numbers: Shaped[Ints, "m"], wanted_numbers: Shaped[Ints, "n"]
) -> Shaped[Ints, "n"]:
    """Find the index of each wanted number in a sorted array, or -1 if it is missing there.

    No number may be negative.
    """
    # A number larger than all in the array gets the position of the appended -1.
    position = sorted_numbers.searchsorted(wanted_numbers)
    return np.where(np.append(sorted_numbers, -1)[position] == wanted_numbers, position, -1)
