"""Types of arrays, and operations on groups of their elements, for the certificate.

`segment_indices` also exists in the tracer.  This module repeats it on purpose: a reference that
shares code with what it validates would repeat its errors.
"""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Floats: TypeAlias = NDArray[np.float64]
Ints: TypeAlias = NDArray[np.intp]
Bools: TypeAlias = NDArray[np.bool_]
Index: TypeAlias = Ints | Bools


def sums_by_index(index: Ints, values: Floats, count: int) -> Floats:
    """Add up the values that have the same index.

    Parameters
    ----------
    index : (n,) int array
        For each value, the element of the result to which it is added; from 0 to count - 1.
    values : (n,) float array
        The values.
    count : int
        Length of the result.

    Returns
    -------
    sums : (count,) float array
        The sum for each index; 0 for an index that does not occur.
    """
    # np.bincount returns integers if there are no values.
    return np.bincount(index, values, count).astype(np.float64, copy=False)


def add_runs(total: Floats, index: Ints, values: Floats) -> None:
    """Add values to the elements of `total` that their indices select.

    Unlike ``total[..., index] += values``, this also adds values whose index occurs repeatedly.

    Parameters
    ----------
    total : (..., m) float array
        Changed in place.
    index : (n,) int array
        For each value, an index into the last axis of `total`, in ascending order.
    values : (..., n) float array
        The values.
    """
    run_start = np.flatnonzero(np.diff(index, prepend=-1))
    total[..., index[run_start]] += np.add.reduceat(values, run_start, axis=-1)


def segment_indices(length: Ints, start: Ints) -> tuple[Ints, Ints]:
    """List the elements of segments of an array, segment after segment.

    Parameters
    ----------
    length, start : (n,) int arrays
        Segment i consists of the elements start[i] to start[i] + length[i] - 1.

    Returns
    -------
    segment : (sum of length,) int array
        The segment to which each listed element belongs.
    element : (sum of length,) int array
        The index of each listed element in the array.
    """
    segment = np.arange(length.size).repeat(length)
    return segment, np.arange(segment.size) - (length.cumsum() - length - start)[segment]


def positions(keys: Ints, wanted: Ints) -> Ints:
    """Find numbers in a sorted array.

    Parameters
    ----------
    keys : (m,) int array
        Numbers from 0 on, in ascending order.
    wanted : (n,) int array
        Numbers from 0 on to search for.

    Returns
    -------
    position : (n,) int array
        The index of each wanted number in `keys`, or -1 if it is not there.
    """
    position = keys.searchsorted(wanted)
    return np.where(np.append(keys, -1)[position] == wanted, position, -1)
