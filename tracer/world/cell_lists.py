"""Lists of rectangles, cell by cell: which stored rectangles are near the rectangle of a query?

Each rectangle belongs to a *patch*, and has coordinates that run from 0 to 1 across it.  A patch is
divided into a square array of *cells*.  The cells at its border also cover everything beyond the
border.  A cell lists the stored rectangles that overlap it.  A query reads lists of all cells that
its own rectangle overlaps, so it finds all rectangles that share a cell with it.

The two rectangles may share several cells, but the query finds the pair only in the first of these.
That cell is in the first column of at least one of the two rectangles, and in the first row of at
least one.  So each cell has four lists:

    place of the cell        list that names a stored     lists that a query reads, if the
    in a rectangle           rectangle with this place    cell has this place in its rectangle
    elsewhere                3                            1
    only in first column     2                            0, 1
    only in first row        0                            1, 2
    in both                  1                            0, 1, 2, 3

With one list a cell, pictures of 100 and more objects take 1.3 to 1.5 times as long.
"""

from __future__ import annotations

from collections.abc import Iterator
from math import sqrt
from typing import Annotated as Shaped
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tracer.arrays import (
    BATCH_SIZE,
    CACHE_SIZE,
    Floats,
    Ints,
    enumerate_ranges,
    join_ranges,
    split_by_size,
)

# Maximum number of cells along each side of a patch.  With n objects, a patch has sqrt(n) cells
# along each side.  Smaller cells have shorter lists, but filling them takes longer.
_MAX_SIDE = 320

# Cells are larger where the lists of each light would contain more rectangles than this: it limits
# memory.
_MAX_LISTED = 32 * BATCH_SIZE

# Cells are larger if all patches together would have more than this many cells: it limits memory.
_MAX_CELLS = 256 * BATCH_SIZE

# Maximum number of pairs of a query's rectangle and a stored one in one batch: their arrays stay in
# the CPU cache.
_PAIRS_PER_BATCH = 4 * CACHE_SIZE

# Maximum number of pairs of a rectangle and a cell in one batch, for the same reason.
_CELLS_PER_BATCH = 4 * CACHE_SIZE

# Flags of a cell in a rectangle of cells: whether it is in the first column, and in the first row.
_FIRST_COLUMN = 1
_FIRST_ROW = 2

# The rows of the table in the docstring, by the flags of the cell: the list that names a stored
# rectangle; and the lists that a query reads, from a first one up to, but not including, a last.
_LIST_OF_FLAGS = np.array([3, 2, 0, 1])
_LISTS_START = np.array([1, 0, 1, 0])
_LISTS_STOP = np.array([2, 2, 3, 4])


class CellLists(NamedTuple):
    """The stored rectangles that overlap each cell, in four lists a cell."""

    cells_per_side: int
    # Position in `listed` where each list begins.  List i of a cell has the index 4 * cell + i.
    list_start: Shaped[NDArray[np.uint32], "lists+1"]
    # Indices of the stored rectangles in all lists, cell by cell and list by list.
    listed: Shaped[NDArray[np.uint32], "listed"]

    def find_pairs(
        self, rectangles: Shaped[Floats, "4 n"], patch_index: Shaped[Ints, "n"]
    ) -> Iterator[tuple[Shaped[Ints, "k"], Shaped[NDArray[np.uint32], "k"]]]:
        """Find the stored rectangles that have a cell in common with each rectangle of a query.

        Yields batches of two arrays: indices of the query's rectangles, and of stored rectangles.
        No pair occurs twice.  The rows of `rectangles` are the minimum and the maximum of u, and
        those of v, from 0 to 1 across the patch.
        """
        for overlap in _find_overlaps(rectangles, patch_index, self.cells_per_side):
            first_list = 4 * overlap.cell_index + _LISTS_START.take(overlap.flags)
            end_list = 4 * overlap.cell_index + _LISTS_STOP.take(overlap.flags)
            start = self.list_start.take(first_list).astype(np.intp)
            length = self.list_start.take(end_list).astype(np.intp) - start
            for batch in split_by_size(length, _PAIRS_PER_BATCH):
                stored_index = self.listed.take(join_ranges(length[batch], start[batch]))
                yield overlap.rectangle_index[batch].repeat(length[batch]), stored_index


def build_cell_lists(
    rectangles: Shaped[Floats, "4 n"],
    patch_index: Shaped[Ints, "n"],
    patch_count: int,
    object_count: int,
    light_count: int,
) -> CellLists:
    """Store rectangles in the lists of the cells that they overlap.

    A rectangle has the rows minimum and maximum of u, then of v, from 0 to 1 across its patch.  The
    numbers of objects and lights in the scene determine the size of the cells.
    """
    cells_per_side = _choose_cells_per_side(rectangles, patch_count, object_count, light_count)
    list_count = 4 * cells_per_side**2 * patch_count
    list_start = np.zeros(list_count + 1, dtype=np.uint32)
    sort_keys = []
    for rectangle_index, cell_index, flags in _find_overlaps(
        rectangles, patch_index, cells_per_side
    ):
        list_index = 4 * cell_index + _LIST_OF_FLAGS.take(flags)
        # Count the rectangles in each list.  `np.add.at` is twenty times as fast if the increment
        # has the type of the array.
        np.add.at(list_start, list_index + 1, np.uint32(1))
        # The upper half of a key is the list, the lower half the rectangle.
        sort_keys.append(list_index << 32 | rectangle_index)
    # Sorting keys is faster than argsort.
    sorted_keys = np.concatenate(sort_keys)
    del sort_keys
    sorted_keys.sort()
    list_start.cumsum(out=list_start)
    return CellLists(
        cells_per_side=cells_per_side,
        list_start=list_start,
        listed=sorted_keys.astype(np.uint32),  # the lower half of each key
    )


def _choose_cells_per_side(
    rectangles: Shaped[Floats, "4 n"], patch_count: int, object_count: int, light_count: int
) -> int:
    """Choose the number of cells along each side of a patch.

    It is limited by `_MAX_SIDE`, `_MAX_LISTED` and `_MAX_CELLS`.
    """
    min_u, max_u, min_v, max_v = rectangles.clip(0, 1)
    # The unit of area is a patch.  So with c cells in a patch, the lists together contain about
    # total_area * c rectangles, and the lists of each light about total_area * c / light_count.
    total_area = float(((max_u - min_u) * (max_v - min_v)).sum())
    max_cells = _MAX_LISTED / (total_area / light_count)
    cell_count = min(object_count, _MAX_SIDE**2, max_cells, _MAX_CELLS / patch_count)
    return max(1, int(sqrt(cell_count)))


class _Overlaps(NamedTuple):
    """Pairs of a rectangle and a cell that it overlaps."""

    rectangle_index: Shaped[Ints, "k"]
    cell_index: Shaped[Ints, "k"]  # (patch * cells_per_side + column) * cells_per_side + row
    # Sum of `_FIRST_COLUMN` and `_FIRST_ROW`, if they apply to the cell in the rectangle.
    flags: Shaped[NDArray[np.uint8], "k"]


def _find_overlaps(
    rectangles: Shaped[Floats, "4 n"],
    patch_index: Shaped[Ints, "n"],
    cells_per_side: int,
) -> Iterator[_Overlaps]:
    """Find, in batches, all cells of its patch that each rectangle overlaps.

    The cells at the border of a patch also cover everything beyond the border.
    """
    cell_ranges = (cells_per_side * rectangles).clip(0, cells_per_side - 1).astype(np.intp)
    first_column, last_column, first_row, last_row = cell_ranges
    column_count = last_column - first_column + 1
    row_count = last_row - first_row + 1
    for batch in split_by_size(column_count * row_count, _CELLS_PER_BATCH):
        # A strip consists of the cells that one rectangle overlaps in one column.
        strip_rectangle, column = enumerate_ranges(column_count[batch], first_column[batch])
        strip_rectangle += batch.start
        strip_column = patch_index.take(strip_rectangle) * cells_per_side + column
        strip_start = strip_column * cells_per_side + first_row.take(strip_rectangle)
        strip_index, cell_index = enumerate_ranges(row_count.take(strip_rectangle), strip_start)
        is_first_column = column == first_column.take(strip_rectangle)
        flags = (is_first_column * np.uint8(_FIRST_COLUMN)).take(strip_index)
        flags |= (cell_index == strip_start.take(strip_index)) * np.uint8(_FIRST_ROW)
        yield _Overlaps(
            rectangle_index=strip_rectangle.take(strip_index), cell_index=cell_index, flags=flags
        )
