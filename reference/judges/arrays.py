"""Types of arrays, and operations on groups of their elements, for the certificate.

`list_segment_elements` also exists in the tracer, under another name.  This module repeats it on
purpose: a reference that shares code with what it validates would repeat its errors.
"""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Floats: TypeAlias = NDArray[np.float64]
Ints: TypeAlias = NDArray[np.intp]
Bools: TypeAlias = NDArray[np.bool_]
Index: TypeAlias = Ints | Bools
"""Indices of elements, or a mask with one bool per element."""


def sum_by_index(index: Ints, values: Floats, count: int) -> Floats:
    """Add up the values that share an index.

    Parameters
    ----------
    index : (n,) int array
        The index of each value, from 0 to count - 1.
    values : (n,) float array
        The numbers to add up.
    count : int
        Number of sums.

    Returns
    -------
    sums : (count,) float array
        For each index, the sum of its values, or 0 if it has none.
    """
    # Without values, np.bincount returns integers.
    return np.bincount(index, values, count).astype(np.float64, copy=False)


def add_at_sorted_index(totals: Floats, index: Ints, values: Floats) -> None:
    """Add values to the elements of an array at given indices, which may repeat.

    Unlike ``totals[..., index] += values``, this adds all values that share an index.

    Parameters
    ----------
    totals : (..., m) float array
        The array, which is changed in place.
    index : (n,) int array
        For each value, an index into the last axis of `totals`, in ascending order.
    values : (..., n) float array
        The values to add, with the same leading axes as `totals`.
    """
    run_start = np.flatnonzero(np.diff(index, prepend=-1))
    totals[..., index[run_start]] += np.add.reduceat(values, run_start, axis=-1)


def list_segment_elements(lengths: Ints, starts: Ints) -> tuple[Ints, Ints]:
    """List the elements of several segments of an array, one segment after another.

    Parameters
    ----------
    lengths, starts : (n,) int arrays
        Segment i contains the elements starts[i] to starts[i] + lengths[i] - 1 of the array.

    Returns
    -------
    segment_index : (m,) int array
        For each listed element, the index of its segment.  Here m is the sum of `lengths`.
    element_index : (m,) int array
        For each listed element, its index in the array.
    """
    segment_index = np.arange(lengths.size).repeat(lengths)
    offset = lengths.cumsum() - lengths - starts
    return segment_index, np.arange(segment_index.size) - offset[segment_index]


def find_in_sorted(sorted_numbers: Ints, wanted_numbers: Ints) -> Ints:
    """Find the positions of numbers in a sorted array.

    Parameters
    ----------
    sorted_numbers : (m,) int array
        Non-negative numbers in ascending order.
    wanted_numbers : (n,) int array
        Non-negative numbers in any order.

    Returns
    -------
    position : (n,) int array
        For each wanted number, its index in `sorted_numbers`, or -1 if it is missing there.
    """
    position = sorted_numbers.searchsorted(wanted_numbers)
    return np.where(np.append(sorted_numbers, -1)[position] == wanted_numbers, position, -1)
