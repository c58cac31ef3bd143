"""Operations on arrays, and on vectors stored as tuples of three arrays.

A tuple contains the x, the y and the z components of many vectors in three arrays of one shape
(a structure of arrays).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

Floats: TypeAlias = NDArray[np.float64]
Ints: TypeAlias = NDArray[np.intp]
Bools: TypeAlias = NDArray[np.bool_]
Sides: TypeAlias = NDArray[np.int8]
# The components x, y and z of vectors: three arrays of one shape.
Triple: TypeAlias = tuple[Floats, Floats, Floats]
# A single vector.
Vector: TypeAlias = tuple[float, float, float]

# Number of elements in a batch whose arrays are to stay in the cache of a CPU core: an array of
# this many floats takes 256 KiB.  Tuned on the project's scenes.
CACHE_SIZE = 1 << 15

# Number of elements in a batch whose arrays only have to fit into memory.  The maximum sizes of all
# batches are multiples of `CACHE_SIZE` or `BATCH_SIZE`; no picture depends on them.
BATCH_SIZE = 1 << 16


def map3(function: Callable[..., Floats], *vectors: Triple) -> Triple:
    """Apply a function separately to the x, y and z components of vectors.

    For example, ``map3(np.maximum, a, b)`` computes the componentwise maximum of `a` and `b`.

    Parameters
    ----------
    function : callable
        Takes one array for each item of `vectors`, and returns an array.
    *vectors : tuples of three arrays
        Each tuple contains the x, y and z components of vectors.

    Returns
    -------
    result : tuple of three arrays
        What the function returns for the x, the y and the z components.
    """
    x, y, z = map(function, *vectors)
    return x, y, z


def dot(a: Triple, b: Triple | Vector) -> Floats:
    """Compute the dot product a . b of each pair of vectors.

    Parameters
    ----------
    a : tuple of three arrays
        The x, y and z components of the first vectors.
    b : tuple of three arrays or of three floats
        The components of the second vectors; three floats are one vector for all pairs.

    Returns
    -------
    product : array
        The dot products.
    """
    total: Floats = a[0] * b[0]
    total += a[1] * b[1]  # in place, because this memory is in the CPU cache
    total += a[2] * b[2]
    return total


def cross(a: Triple, b: Triple) -> Triple:
    """Compute the cross product a x b of each pair of vectors.

    Parameters
    ----------
    a, b : tuples of three arrays
        The x, y and z components of the first and of the second vectors.

    Returns
    -------
    product : tuple of three arrays
        The x, y and z components of the cross products.
    """
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def scale3(vectors: Triple, factor: Floats) -> Triple:
    """Multiply each vector by its own factor.

    Parameters
    ----------
    vectors : tuple of three arrays
        The x, y and z components of the vectors.
    factor : array
        One factor for each vector.

    Returns
    -------
    scaled : tuple of three arrays
        The x, y and z components of the products.
    """
    return vectors[0] * factor, vectors[1] * factor, vectors[2] * factor


def take3(vectors: Triple | Floats, index: Ints | slice) -> Triple:
    """Select vectors by index.

    Parameters
    ----------
    vectors : tuple of three (n,) arrays, or (3, n) array
        The x, y and z components of n vectors.
    index : (k,) int array or slice
        Indices of the vectors to select.

    Returns
    -------
    selected : tuple of three (k,) arrays
        The x, y and z components of the selected vectors, in the order of `index`.
    """
    # `take` is 1.5 times as fast as indexing by an array.
    x, y, z = (row[index] if isinstance(index, slice) else row.take(index) for row in vectors)
    return x, y, z


def repeat_runs(values: NDArray[Any], counts: Ints | None) -> NDArray[Any]:
    """Repeat the value of each run for every element of the run.

    A run consists of consecutive elements that share one value.

    Parameters
    ----------
    values : (runs,) array
        One value for each run.
    counts : (runs,) int array or None
        Number of elements in each run; None if every run has one element.

    Returns
    -------
    repeated : (n,) array
        One value for each element, run by run; n is the sum of `counts`.  If `counts` is None, this
        is `values` itself.
    """
    # This is four times as fast as `take`, which would also need the run of each element.
    return values if counts is None else values.repeat(counts)


def indices(mask: NDArray[Any]) -> Ints:
    """Return the indices of all elements that are True or nonzero.

    Parameters
    ----------
    mask : array of any shape
        The elements to test.

    Returns
    -------
    index : (k,) int array
        Indices into the flattened array, in ascending order.
    """
    # np.flatnonzero does the same, but takes five times as long for arrays with few elements.
    index: Ints = mask.ravel().nonzero()[0]
    return index


def segment_indices(counts: Ints, start: Ints | int = 0) -> tuple[Ints, Ints]:
    """List the members of segments, and the segment to which each member belongs.

    The members of a segment are consecutive integers.

    Parameters
    ----------
    counts : (m,) int array
        Number of members of each of m segments.
    start : (m,) int array or int
        First member of each segment; an int applies to all segments.

    Returns
    -------
    segment : (n,) int array
        Index of each member's segment: 0, repeated counts[0] times, then 1, repeated counts[1]
        times, and so on.  Here n is the sum of `counts`.
    member : (n,) int array
        The members: start[i], ..., start[i] + counts[i] - 1 for each segment i.
    """
    return np.arange(counts.size).repeat(counts), join_ranges(start, counts)


def join_ranges(start: Ints | int, counts: Ints) -> Ints:
    """Join ranges of consecutive integers into one array.

    Parameters
    ----------
    start : (m,) int array or int
        First integer of each of m ranges; an int applies to all ranges.
    counts : (m,) int array
        Number of integers in each range.

    Returns
    -------
    members : (n,) int array
        The integers start[0], ..., start[0] + counts[0] - 1, then those of the second range, and so
        on.  Here n is the sum of `counts`.
    """
    # Within a range, each member differs from its position in the result by the same offset.
    offset = counts - counts.cumsum()
    offset += start
    members: Ints = offset.repeat(counts)
    members += np.arange(members.size)
    return members


def run_starts(*arrays: NDArray[Any]) -> Bools:
    """Mark the positions at which runs of equal elements start.

    A run consists of consecutive positions at which every array is constant.

    Parameters
    ----------
    *arrays : (n,) arrays
        One or more arrays of the same length.

    Returns
    -------
    is_start : (n,) bool array
        True at the first position of each run.
    """
    is_start = np.ones(arrays[0].size, dtype=np.bool_)
    differs = np.not_equal(arrays[0][1:], arrays[0][:-1], out=is_start[1:])
    for array in arrays[1:]:
        differs |= array[1:] != array[:-1]
    return is_start


def run_lengths(*arrays: NDArray[Any]) -> tuple[Ints, Ints]:
    """Find the start and the length of each run of equal elements.

    A run consists of consecutive positions at which every array is constant.

    Parameters
    ----------
    *arrays : (n,) arrays
        One or more arrays of the same length.

    Returns
    -------
    start : (runs,) int array
        First position of each run, in ascending order.
    length : (runs,) int array
        Number of positions in each run.
    """
    start = indices(run_starts(*arrays))
    return start, np.append(start[1:], arrays[0].size) - start


def batches(sizes: Ints, max_size: int = CACHE_SIZE) -> Iterator[slice]:
    """Divide items of different sizes into batches, and yield the slice of each batch.

    Parameters
    ----------
    sizes : (n,) int array
        Size of each item, in any unit.
    max_size : int
        Maximum total size of the items in a batch.  A larger item forms a batch on its own.

    Yields
    ------
    batch : slice
        Slice of consecutive items that starts where the previous batch ends.
    """
    cumulative_size = sizes.cumsum()
    start = 0
    while start < sizes.size:
        size_limit = cumulative_size[start] - sizes[start] + max_size
        stop = max(start + 1, int(cumulative_size.searchsorted(size_limit, side="right")))
        yield slice(start, stop)
        start = stop


def index_batches(index: Ints, max_count: int = BATCH_SIZE) -> Iterator[Ints]:
    """Yield an array of indices in batches of limited size.

    Parameters
    ----------
    index : (n,) int array
        The indices.
    max_count : int
        Maximum number of indices in a batch.

    Yields
    ------
    batch : (k,) int array
        The next `max_count` elements of `index`; the last batch may have fewer.  Nothing is yielded
        if `index` is empty.
    """
    for start in range(0, index.size, max_count):
        yield index[start : start + max_count]


def take_2d(table: NDArray[Any], row: Ints | int, column: Ints) -> NDArray[Any]:
    """Look up the elements of a table at the given rows and columns.

    Parameters
    ----------
    table : (m, n) array
        The table.
    row : (k,) int array or int
        Row of each element; an int applies to all elements.
    column : (k,) int array
        Column of each element.

    Returns
    -------
    elements : (k,) array
        table[row[i], column[i]] for each i.
    """
    elements: NDArray[Any] = table.reshape(-1).take(row * table.shape[1] + column)
    return elements


def put_2d(table: NDArray[Any], row: Ints, column: Ints, value: bool) -> None:
    """Set the elements of a table at the given rows and columns to one value, in place.

    Parameters
    ----------
    table : (m, n) bool array
        The table; must be contiguous in memory (C order).
    row, column : (k,) int arrays
        Row and column of each element to set.
    value : bool
        The new value of these elements.
    """
    table.reshape(-1)[row * table.shape[1] + column] = value
