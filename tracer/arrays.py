"""Operations on arrays, and on vectors as triples of arrays.

Docstrings say "three (n,)" for such a triple (a structure of arrays).
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
Triple: TypeAlias = tuple[Floats, Floats, Floats]
Vector: TypeAlias = tuple[float, float, float]

CACHE_SIZE = 1 << 15
"""Number of elements in a batch whose arrays are to stay in a core's cache: an array of this many
numbers takes 256 KiB.  Tuned on the project's scenes."""

BATCH_SIZE = 1 << 16
"""Number of elements in a batch whose arrays only have to fit into memory.  All batches have a
multiple of `CACHE_SIZE` or of `BATCH_SIZE`; no picture depends on it."""


def map3(function: Callable[..., Floats], *vectors: Triple) -> Triple:
    """Apply a function to the first components, the second and the third."""
    x, y, z = map(function, *vectors)
    return x, y, z


def dot(a: Triple, b: Triple | Vector, out: Floats | None = None) -> Floats:
    """Dot product, element by element."""
    total: Floats = np.multiply(a[0], b[0], out=out)
    # In place: memory that is in cache already.
    total += a[1] * b[1]
    total += a[2] * b[2]
    return total


def cross(a: Triple, b: Triple) -> Triple:
    """Cross product, element by element."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def repeat_runs(values: NDArray[Any], counts: Ints | None) -> NDArray[Any]:
    """Values of runs (m,), repeated for each sample of these.

    `counts` (m,): how many samples each run has; None if it is one in each.
    """
    # A quarter of the time of `take`, which would need each sample's run besides.
    return values if counts is None else values.repeat(counts)


def take3(vector: Triple | Floats, index: Ints | slice) -> Triple:
    """Some elements of each component; of points (3, n) as of a triple."""
    # `take` needs two thirds of the time that indexing by an array takes.
    x, y, z = (m[index] if isinstance(index, slice) else m.take(index) for m in vector)
    return x, y, z


def scaled(vector: Triple, factor: Floats) -> Triple:
    """Product with a factor, element by element."""
    return vector[0] * factor, vector[1] * factor, vector[2] * factor


def indices(mask: NDArray[Any]) -> Ints:
    """Places at which a mask holds, or numbers are not zero; of any array as if it were flat."""
    # The same as np.flatnonzero, in a fifth of the time where there are few.
    found: Ints = mask.ravel().nonzero()[0]
    return found


def segment_indices(counts: Ints, start: Ints | int = 0) -> tuple[Ints, Ints]:
    """For each i, counts[i] pairs of i and a place: start[i], start[i] + 1, ..."""
    return np.arange(counts.size).repeat(counts), ranges(start, counts)


def ranges(start: Ints | int, counts: Ints) -> Ints:
    """Ranges end to end: counts[0] numbers from start[0] on, counts[1] from start[1] on, ..."""
    skip = counts - counts.cumsum()
    skip += start
    places: Ints = skip.repeat(counts)
    places += np.arange(places.size)
    return places


def run_starts(*values: NDArray[Any]) -> Bools:
    """Mask of elements (n,) that differ from those before them, in any array; the first do."""
    change = np.ones(values[0].size, dtype=np.bool_)
    later = np.not_equal(values[0][1:], values[0][:-1], out=change[1:])
    for more in values[1:]:
        later |= more[1:] != more[:-1]
    return change


def run_lengths(*values: NDArray[Any]) -> tuple[Ints, Ints]:
    """Starts of runs of neighbours that are equal in all arrays, and their lengths."""
    first = indices(run_starts(*values))
    return first, np.append(first[1:], values[0].size) - first


def batches(sizes: Ints, most: int = CACHE_SIZE) -> Iterator[slice]:
    """Slices of consecutive elements, few enough for all their pairs to stay in cache.

    Element i has sizes[i] pairs; a slice has at most `most`, or is a single element.
    """
    total = sizes.cumsum()
    start = 0
    while start < sizes.size:
        before = total[start] - sizes[start]
        stop = max(start + 1, int(total.searchsorted(before + most, side="right")))
        yield slice(start, stop)
        start = stop


def take_2d(table: NDArray[Any], row: Ints | int, column: Ints) -> NDArray[Any]:
    """Some entries of a table (m, n), one for each pair of row and column."""
    some: NDArray[Any] = table.reshape(-1).take(row * table.shape[1] + column)
    return some


def put_2d(table: NDArray[Any], row: Ints, column: Ints, value: bool) -> None:
    """Set some entries of a contiguous table (m, n), one for each pair of row and column."""
    table.reshape(-1)[row * table.shape[1] + column] = value
