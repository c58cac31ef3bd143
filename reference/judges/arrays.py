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
    """Add up the values that have the same index.

    Parameters
    ----------
    index : (n,) int array
        For each value, the element of the result to which it is added; from 0 to count - 1.
    values : (n,) float array
        The numbers to add up.
    count : int
        Length of the result.

    Returns
    -------
    sums : (count,) float array
        The sum of the values for each index; 0 for an index that does not occur.
    """
    # np.bincount returns integers if there are no values.
    return np.bincount(index, values, count).astype(np.float64, copy=False)


def add_at_sorted_index(total: Floats, index: Ints, values: Floats) -> None:
    """Add each value to the element of `total` that the value's index selects.

    Unlike ``total[..., index] += values``, this adds all values of an index that occurs repeatedly.

    Parameters
    ----------
    total : (..., m) float array
        The sums so far.  This array is changed in place.
    index : (n,) int array
        For each value, an index into the last axis of `total`.  The indices ascend, so equal ones
        are adjacent.
    values : (..., n) float array
        The numbers to add.  The leading axes are those of `total`.
    """
    run_start = np.flatnonzero(np.diff(index, prepend=-1))
    total[..., index[run_start]] += np.add.reduceat(values, run_start, axis=-1)


def list_segment_elements(length: Ints, start: Ints) -> tuple[Ints, Ints]:
    """List the elements of segments of an array, segment after segment.

    Parameters
    ----------
    length, start : (n,) int arrays
        Segment i consists of the elements start[i] to start[i] + length[i] - 1.

    Returns
    -------
    segment : (m,) int array
        The segment to which each listed element belongs.  Here m is the sum of `length`.
    element : (m,) int array
        The index of each listed element in the array.
    """
    segment = np.arange(length.size).repeat(length)
    return segment, np.arange(segment.size) - (length.cumsum() - length - start)[segment]


def find_in_sorted(keys: Ints, wanted: Ints) -> Ints:
    """Find the positions of numbers in a sorted array.

    Parameters
    ----------
    keys : (m,) int array
        Numbers that are at least 0, in ascending order.
    wanted : (n,) int array
        Numbers that are at least 0, in any order.

    Returns
    -------
    position : (n,) int array
        For each wanted number, its index in `keys`, or -1 if `keys` does not contain the number.
    """
    position = keys.searchsorted(wanted)
    return np.where(np.append(keys, -1)[position] == wanted, position, -1)
