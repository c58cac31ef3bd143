"""Operations on arrays, and on vectors stored as tuples of three arrays.

A tuple contains the x, the y and the z components of many vectors in three arrays of one shape
(a structure of arrays).

In all modules, `Shaped[Floats, "3 n"]` is a float array of shape (3, n): `Shaped` is another name
of `typing.Annotated`, and `tests/shapes.py`, which explains the notation, checks all shapes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Annotated as Shaped
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


def map_xyz(function: Callable[..., Floats], *vectors: Triple) -> Triple:
    """Apply a function to each component (x, y and z) of vectors.

    For example, ``map_xyz(np.maximum, a, b)`` computes the componentwise maximum of `a` and `b`.

    Parameters
    ----------
    function : callable
        Takes one component of each argument in `vectors`, and returns an array.
    *vectors : tuples of three arrays
        The x, y and z components of vectors.

    Returns
    -------
    results : tuple of three arrays
        The results for x, y and z.
    """
    x, y, z = map(function, *vectors)
    return x, y, z


def dot(a: Triple, b: Triple | Vector) -> Floats:
    """Compute the dot product a . b of each pair of vectors.

    Parameters
    ----------
    a : tuple of three arrays
        The x, y and z components of the first vector of each pair.
    b : tuple of three arrays or of three floats
        The components of the second vector of each pair, or of one vector for all pairs.

    Returns
    -------
    products : array
        The dot products.
    """
    products: Floats = a[0] * b[0]
    # Adding in place allocates fewer arrays.
    products += a[1] * b[1]
    products += a[2] * b[2]
    return products


def cross(a: Triple, b: Triple) -> Triple:
    """Compute the cross product a x b of each pair of vectors.

    Parameters
    ----------
    a, b : tuples of three arrays
        The x, y and z components of the first and of the second vector of each pair.

    Returns
    -------
    products : tuple of three arrays
        The x, y and z components of the cross products.
    """
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def scale(vectors: Triple, factors: Floats) -> Triple:
    """Multiply each vector by its own factor.

    Parameters
    ----------
    vectors : tuple of three arrays
        The x, y and z components of the vectors.
    factors : array
        One factor for each vector.

    Returns
    -------
    scaled_vectors : tuple of three arrays
        The x, y and z components of the scaled vectors.
    """
    return vectors[0] * factors, vectors[1] * factors, vectors[2] * factors


def take(vectors: Triple | Floats, index: Ints | slice) -> Triple:
    """Select vectors by index.

    Parameters
    ----------
    vectors : tuple of three (n,) arrays, or (3, n) array
        The x, y and z components of n vectors.
    index : (k,) int array or slice
        Indices of the vectors to select.

    Returns
    -------
    selected_vectors : tuple of three (k,) arrays
        The x, y and z components of the selected vectors, in the order of `index`.
    """
    # `take` is 1.5 times as fast as indexing with an array.
    x, y, z = (row[index] if isinstance(index, slice) else row.take(index) for row in vectors)
    return x, y, z


def take_columns(
    vectors: Shaped[Triple, "#m n"], column_index: Shaped[Ints, "k"]
) -> Shaped[Triple, "#m k"]:
    """Select columns of vectors."""
    x, y, z = (component[:, column_index] for component in vectors)
    return x, y, z


def repeat_runs(values: NDArray[Any], counts: Ints | None) -> NDArray[Any]:
    """Repeat the value of each run for every element of the run.

    A run consists of consecutive elements that share a value.

    Parameters
    ----------
    values : (runs,) array
        The value of each run.
    counts : (runs,) int array or None
        Number of elements in each run; None if every run has one element.

    Returns
    -------
    element_values : (n,) array
        The value of each element.  If `counts` is None, this is `values` itself.
    """
    # `repeat` is four times as fast as looking up the value of each element's run.
    return values if counts is None else values.repeat(counts)


def find(mask: NDArray[Any]) -> Ints:
    """Find the indices of all elements that are True or nonzero.

    Parameters
    ----------
    mask : array of any shape
        The elements to test.

    Returns
    -------
    nonzero_index : (k,) int array
        Indices into the flattened array, in ascending order.
    """
    # For small arrays, np.flatnonzero takes five times as long.
    nonzero_index: Ints = mask.ravel().nonzero()[0]
    return nonzero_index


def enumerate_ranges(counts: Ints, starts: Ints | int = 0) -> tuple[Ints, Ints]:
    """Join ranges of consecutive integers, and return each integer with the index of its range.

    For example, counts (2, 3) and starts (7, 4) give range indices (0, 0, 1, 1, 1) and integers
    (7, 8, 4, 5, 6).

    Parameters
    ----------
    counts : (m,) int array
        Number of integers in each of m ranges.
    starts : (m,) int array or int
        First integer of each range; an int applies to all ranges.

    Returns
    -------
    range_index : (n,) int array
        Index of the range of each integer.
    integers : (n,) int array
        The integers, range by range.
    """
    return np.arange(counts.size).repeat(counts), join_ranges(counts, starts)


def join_ranges(counts: Ints, starts: Ints | int) -> Ints:
    """Join ranges of consecutive integers into one array.

    For example, counts (2, 3) and starts (7, 4) give (7, 8, 4, 5, 6).

    Parameters
    ----------
    counts : (m,) int array
        Number of integers in each of m ranges.
    starts : (m,) int array or int
        First integer of each range; an int applies to all ranges.

    Returns
    -------
    integers : (n,) int array
        The integers, range by range.
    """
    # Within a range, integer minus position in the result is constant.
    offsets = counts - counts.cumsum()
    offsets += starts
    integers: Ints = offsets.repeat(counts)
    integers += np.arange(integers.size)
    return integers


def mark_run_starts(*arrays: NDArray[Any]) -> Bools:
    """Mark the positions where runs start.

    A run is a sequence of consecutive positions at which no array changes.

    Parameters
    ----------
    *arrays : (n,) arrays
        One or more arrays of the same length.

    Returns
    -------
    is_start : (n,) bool array
        Whether a run starts at each position.
    """
    is_start = np.ones(arrays[0].size, dtype=np.bool_)
    has_changed = np.not_equal(arrays[0][1:], arrays[0][:-1], out=is_start[1:])
    for array in arrays[1:]:
        has_changed |= array[1:] != array[:-1]
    return is_start


def find_runs(*arrays: NDArray[Any]) -> tuple[Ints, Ints]:
    """Find the start and the length of each run.

    A run is a sequence of consecutive positions at which no array changes.

    Parameters
    ----------
    *arrays : (n,) arrays
        One or more arrays of the same length.

    Returns
    -------
    starts : (runs,) int array
        First position of each run, in ascending order.
    lengths : (runs,) int array
        Number of positions in each run.
    """
    starts = find(mark_run_starts(*arrays))
    return starts, np.append(starts[1:], arrays[0].size) - starts


def split_by_size(sizes: Ints, max_size: int = CACHE_SIZE) -> Iterator[slice]:
    """Divide items of different sizes into batches, and yield a slice for each batch.

    Parameters
    ----------
    sizes : (n,) int array
        Size of each item, in any unit.
    max_size : int
        Maximum total size of the items in a batch.  A larger item forms a batch on its own.

    Yields
    ------
    batch : slice
        Consecutive items; the first follows the last item of the previous batch.
    """
    total_sizes = sizes.cumsum()  # of the items up to and including each item
    start = 0
    while start < sizes.size:
        max_total_size = total_sizes[start] - sizes[start] + max_size
        stop = max(start + 1, int(total_sizes.searchsorted(max_total_size, side="right")))
        yield slice(start, stop)
        start = stop


def split_indices(indices: Ints, max_count: int = BATCH_SIZE) -> Iterator[Ints]:
    """Divide an array of indices into batches.

    Parameters
    ----------
    indices : (n,) int array
        The indices.
    max_count : int
        Maximum number of indices in a batch.

    Yields
    ------
    batch : (k,) int array
        The next `max_count` indices; the last batch may have fewer.
    """
    for start in range(0, indices.size, max_count):
        yield indices[start : start + max_count]


def take_2d(table: NDArray[Any], rows: Ints | int, columns: Ints) -> NDArray[Any]:
    """Return the elements of a table at the given rows and columns.

    Parameters
    ----------
    table : (m, n) array
        The table.
    rows : (k,) int array or int
        Row of each element; an int applies to all elements.
    columns : (k,) int array
        Column of each element.

    Returns
    -------
    elements : (k,) array
        table[rows[i], columns[i]] for each i.
    """
    elements: NDArray[Any] = table.reshape(-1).take(rows * table.shape[1] + columns)
    return elements


def put_2d(table: NDArray[Any], rows: Ints, columns: Ints, value: bool) -> None:
    """Set the elements of a table at the given rows and columns to one value.

    Parameters
    ----------
    table : (m, n) bool array
        The table, which is changed in place.  It must be contiguous in memory (C order).
    rows, columns : (k,) int arrays
        Row and column of each element to set.
    value : bool
        The new value of the elements.
    """
    table.reshape(-1)[rows * table.shape[1] + columns] = value
