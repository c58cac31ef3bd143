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
        For each value, the element of `sums` to which it is added, from 0 to count - 1.
    values : (n,) float array
        Numbers to add up.
    count : int
        Length of `sums`.

    Returns
    -------
    sums : (count,) float array
        The sum of the values for each index; 0 for an index that does not occur.
    """
    # Without values, np.bincount returns integers.
    return np.bincount(index, values, count).astype(np.float64, copy=False)


def add_at_sorted_index(total: Floats, index: Ints, values: Floats) -> None:
    """Add each value to the element of an array given by the value's index.

    Unlike ``total[..., index] += values``, this adds all values that share an index.

    Parameters
    ----------
    total : (..., m) float array
        The array, which is changed in place.
    index : (n,) int array
        For each value, an index into the last axis of `total`, in ascending order.
    values : (..., n) float array
        The values to add.  The leading axes are those of `total`.
    """
    run_start = np.flatnonzero(np.diff(index, prepend=-1))
    total[..., index[run_start]] += np.add.reduceat(values, run_start, axis=-1)


def list_segment_elements(length: Ints, start: Ints) -> tuple[Ints, Ints]:
    """List the indices of all elements of some segments of an array, segment by segment.

    Parameters
    ----------
    length, start : (n,) int arrays
        Segment i consists of the elements start[i] to start[i] + length[i] - 1.

    Returns
    -------
    segment : (m,) int array
        The segment of each listed element.  Here m is the sum of `length`.
    element : (m,) int array
        The index of each listed element in the array.
    """
    segment = np.arange(length.size).repeat(length)
    return segment, np.arange(segment.size) - (length.cumsum() - length - start)[segment]


def find_in_sorted(sorted_numbers: Ints, wanted: Ints) -> Ints:
    """Find the positions of numbers in a sorted array.

    Parameters
    ----------
    sorted_numbers : (m,) int array
        Non-negative numbers in ascending order.
    wanted : (n,) int array
        Non-negative numbers in any order.

    Returns
    -------
    position : (n,) int array
        For each wanted number, its index in `sorted_numbers`, or -1 if it is missing there.
    """
    position = sorted_numbers.searchsorted(wanted)
    return np.where(np.append(sorted_numbers, -1)[position] == wanted, position, -1)
