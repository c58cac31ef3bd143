"""Operations on arrays, and on vectors stored as tuples of three arrays.

A tuple contains the x, the y and the z components of many vectors in three arrays of one shape
(a structure of arrays).

A *run* is a sequence of consecutive elements that have something in common, such as their value.

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


def map_xyz(
    function: Callable[..., Floats], *vectors: Shaped[Triple, "..."]
) -> Shaped[Triple, "..."]:
    """Apply a function to each component (x, y and z) of vectors.

    For example, ``map_xyz(np.maximum, a, b)`` computes the componentwise maximum of `a` and `b`.
    """
    x, y, z = map(function, *vectors)
    return x, y, z


def dot(a: Shaped[Triple, "..."], b: Shaped[Triple, "..."] | Vector) -> Shaped[Floats, "..."]:
    """Compute the dot products of the vectors in `a` with those in `b`, or with one vector `b`.

    Arrays of different shapes are broadcast.  The x components must already have, together, the
    shape of the result.
    """
    products: Floats = a[0] * b[0]
    # Adding in place allocates fewer arrays.
    products += a[1] * b[1]
    products += a[2] * b[2]
    return products


def cross(a: Shaped[Triple, "... #n"], b: Shaped[Triple, "... #n"]) -> Shaped[Triple, "... n"]:
    """Compute the cross product a x b of each pair of vectors."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def scale(
    vectors: Shaped[Triple, "... #n"], factors: Shaped[Floats, "... #n"]
) -> Shaped[Triple, "... n"]:
    """Multiply each vector by its own factor."""
    return vectors[0] * factors, vectors[1] * factors, vectors[2] * factors


def take(
    vectors: Shaped[Triple, "n"] | Shaped[Floats, "3 n"], index: Shaped[Ints, "k"] | slice
) -> Shaped[Triple, "k"]:
    """Select vectors by index.

    The arrays of the result are views if `index` is a slice, and copies otherwise.
    """
    # `take` is 1.5 times as fast as indexing with an array.
    x, y, z = (row[index] if isinstance(index, slice) else row.take(index) for row in vectors)
    return x, y, z


def take_columns(
    vectors: Shaped[Triple, "#m n"], column_index: Shaped[Ints, "k"]
) -> Shaped[Triple, "#m k"]:
    """Select columns from a table of vectors."""
    x, y, z = (component[:, column_index] for component in vectors)
    return x, y, z


def repeat_runs(
    values: Shaped[NDArray[Any], "runs"], counts: Shaped[Ints, "runs"] | None
) -> Shaped[NDArray[Any], "n"]:
    """Repeat the value of each run for every element of the run.

    `counts` contains the number of elements of each run.  If it is None, every run has one element,
    and the result is `values` itself.
    """
    # `repeat` is four times as fast as looking up the value of each element's run.
    return values if counts is None else values.repeat(counts)


def find(mask: Shaped[NDArray[Any], "..."]) -> Shaped[Ints, "k"]:
    """Find the indices, in the flattened array, of all elements that are True or nonzero."""
    # For small arrays, np.flatnonzero takes five times as long.
    nonzero_index: Ints = mask.ravel().nonzero()[0]
    return nonzero_index


def enumerate_ranges(
    counts: Shaped[Ints, "ranges"], starts: Shaped[Ints, "ranges"] | int = 0
) -> tuple[Shaped[Ints, "n"], Shaped[Ints, "n"]]:
    """Join ranges of consecutive integers, of which each is given by its length and its start.

    Return (1) the index of the range to which each integer belongs, and (2) the integers.  For
    example, counts (2, 3) and starts (7, 4) give (0, 0, 1, 1, 1) and (7, 8, 4, 5, 6).
    """
    return np.arange(counts.size).repeat(counts), join_ranges(counts, starts)


def join_ranges(
    counts: Shaped[Ints, "ranges"], starts: Shaped[Ints, "ranges"] | int
) -> Shaped[Ints, "n"]:
    """Join ranges of consecutive integers, of which each is given by its length and its start.

    For example, counts (2, 3) and starts (7, 4) give (7, 8, 4, 5, 6).
    """
    # Within a range, integer minus position in the result is constant.
    offsets = counts - counts.cumsum()
    offsets += starts
    integers: Ints = offsets.repeat(counts)
    integers += np.arange(integers.size)
    return integers


def mark_run_starts(*arrays: Shaped[NDArray[Any], "n"]) -> Shaped[Bools, "n"]:
    """Mark the positions at which a run starts.

    Within a run, the values of each array are equal.  So a run starts at the first position, and
    wherever the value of at least one array differs from the value before it.
    """
    is_start = np.ones(arrays[0].size, dtype=np.bool_)
    has_changed = np.not_equal(arrays[0][1:], arrays[0][:-1], out=is_start[1:])
    for array in arrays[1:]:
        has_changed |= array[1:] != array[:-1]
    return is_start


def sort_distinct(keys: Shaped[Ints, "n"]) -> Shaped[Ints, "distinct"]:
    """Sort an array in place, and return its distinct values.

    `np.unique` builds a hash table, and takes four to six times as long.
    """
    keys.sort()
    return keys.take(find(mark_run_starts(keys)))


def find_runs(
    *arrays: Shaped[NDArray[Any], "n"],
) -> tuple[Shaped[Ints, "runs"], Shaped[Ints, "runs"]]:
    """Find the start and the length of each run of equal values.

    If there are several arrays, the values of all of them are equal within a run.
    """
    starts = find(mark_run_starts(*arrays))
    return starts, np.append(starts[1:], arrays[0].size) - starts


def split_by_size(sizes: Shaped[Ints, "n"], max_size: int = CACHE_SIZE) -> Iterator[slice]:
    """Divide items of different sizes into batches, and yield the slice of the items in each batch.

    The items in a batch have a total size of at most `max_size`.  An item that is larger forms a
    batch on its own.
    """
    total_sizes = sizes.cumsum()  # for each item, the total size of the items up to and with it
    start = 0
    while start < sizes.size:
        max_total_size = total_sizes[start] - sizes[start] + max_size
        stop = max(start + 1, int(total_sizes.searchsorted(max_total_size, side="right")))
        yield slice(start, stop)
        start = stop


def split_indices(
    indices: Shaped[Ints, "n"], max_count: int = BATCH_SIZE
) -> Iterator[Shaped[Ints, "k"]]:
    """Divide an array of indices into views of `max_count` indices; the last may have fewer."""
    for start in range(0, indices.size, max_count):
        yield indices[start : start + max_count]


def take_2d(
    table: Shaped[NDArray[Any], "rows columns"],
    row: Shaped[Ints, "n"] | int,
    column: Shaped[Ints, "n"],
) -> Shaped[NDArray[Any], "n"]:
    """Return table[row[i], column[i]] for each i, or table[row, column[i]] if `row` is an int."""
    elements: NDArray[Any] = table.reshape(-1).take(row * table.shape[1] + column)
    return elements


def put_2d(
    table: Shaped[Bools, "rows columns"],
    row: Shaped[Ints, "n"],
    column: Shaped[Ints, "n"],
    value: bool,
) -> None:
    """Set table[row[i], column[i]] to the value for each i.

    The table must be contiguous in memory (C order).  Otherwise, nothing would be changed.
    """
    table.reshape(-1)[row * table.shape[1] + column] = value
