"""A light buffer: for each light, a grid of directions that lists the objects in each cell.

Which objects may lie between a point and a light?  Only those that, as seen from the light, lie in
the same direction as the point (Haines and Greenberg, The light buffer, 1986).  Here a query is for
all points of a ball together.

The directions of a light are divided into eight octants, and each object into *parts*, one for each
octant that it lies in.  Each part has a rectangle of octahedral coordinates, and direction bounds
(see `directions`).  In an octant, the *patch* is a rectangle that contains most of the objects that
the camera may see.  A patch is divided into a square array of *cells*.  Directions outside of the
patch are treated as those at its border.  A cell lists all parts whose rectangles overlap it, in
four lists (see `_LIST_OF_FLAGS`).

For a query, the ball is divided into parts, too.  Each of them is compared with the parts that are
listed in the cells that it overlaps.  Rectangles are loose bounds for long objects, so the
direction bounds of the two parts are compared.  The query excludes only objects that cannot lie
between the ball and the light.

Positions are in scene axes, and vectors lead from points to the light.  *Relative* rectangles have
coordinates that run from 0 to 1 across the patch.
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
    Bools,
    Floats,
    Ints,
    enumerate_ranges,
    find,
    find_runs,
    join_ranges,
    split_by_size,
)
from tracer.geometry.rounding import DIRECTION_ROUNDING
from tracer.world.directions import MIN_DISTANCE_ROW, BoxParts, reverse_bounds, split_by_octant

# Maximum number of cells along each side of a patch.  With n objects, a patch has sqrt(n) cells
# along each side.  Smaller cells have shorter lists, but filling them takes longer.
_MAX_SIDE = 320

# Cells are larger where the lists of each light would contain more parts than this: it limits
# memory.
_MAX_LISTED_PARTS = 32 * BATCH_SIZE

# Cells are larger if all patches together would have more than this many cells: it limits memory.
_MAX_CELLS = 256 * BATCH_SIZE

# Maximum number of pairs of a ball's part and an object's part in one batch: their arrays stay in
# the CPU cache.
_PAIRS_PER_BATCH = 4 * CACHE_SIZE

# Maximum number of pairs of a rectangle and a cell in one batch, for the same reason.
_CELLS_PER_BATCH = 4 * CACHE_SIZE

# On each of its sides, a patch excludes one in this many objects, which are listed in the cells at
# the border of the patch.  Otherwise a single huge object could stretch the patch until all other
# objects lie in one cell.
_OBJECTS_PER_OUTLIER = 64

# Flags of a cell in a rectangle of cells: whether it is in the first column, and in the first row.
_FIRST_COLUMN = 1
_FIRST_ROW = 2

# The rectangles of a ball's part and of an object's part may have several cells in common.  A query
# finds the pair only in the first of these.  That cell is in the first column of at least one of
# the two rectangles, and in the first row of at least one.  So each cell has four lists:
#
#     place of the cell        list that names the       lists that a query reads, if the
#     in a rectangle           object with this place    ball's rectangle has this place
#     elsewhere                3                         1
#     only in first column     2                         0, 1
#     only in first row        0                         1, 2
#     in both                  1                         0, 1, 2, 3
#
# With one list a cell, pictures of 100 and more objects take 1.3 to 1.5 times as long.  The next
# three tables have these rows, by the flags of the cell.
_LIST_OF_FLAGS = np.array([3, 2, 0, 1])
_LISTS_START = np.array([1, 0, 1, 0])
_LISTS_STOP = np.array([2, 2, 3, 4])

# A light farther away than this many times the scene's size is moved to this distance.  Directions
# to the light turn by at most the reciprocal, in radians.
_MAX_LIGHT_DISTANCE = 2.0**22

# Eight bools that are all True, read as one integer.
_EIGHT_TRUE = 0x0101010101010101


class Patches(NamedTuple):
    """The patches of the octants that contain objects that the camera may see."""

    # Element octant * lights + light is the index of the patch in this octant of the light; -1 if
    # the octant has no patch.
    of_octant: Shaped[Ints, "octants"]
    origin: Shaped[Floats, "2 patches"]  # smallest u and v
    size: Shaped[Floats, "2 patches"]  # width in u and in v

    def to_relative(
        self, rectangles: Shaped[Floats, "4 n"], patch_index: Shaped[Ints, "n"]
    ) -> Shaped[Floats, "4 n"]:
        """Convert bounds on u and v to coordinates that run from 0 to 1 across the patches."""
        origin = self.origin.take(patch_index, axis=1)
        size = self.size.take(patch_index, axis=1)
        return ((rectangles.reshape(2, 2, -1) - origin[:, None]) / size[:, None]).reshape(4, -1)


class LightGrid(NamedTuple):
    """Lists of objects by their direction from each light."""

    # Distant lights are moved closer: see `_MAX_LIGHT_DISTANCE`.
    light_position: Shaped[Floats, "3 lights 1"]
    patches: Patches
    cells_per_side: int
    # Position in `listed_part` where each list begins.  Each cell has four: see `_LIST_OF_FLAGS`.
    list_start: Shaped[NDArray[np.uint32], "lists+1"]
    # Indices of the objects' parts in all lists, cell by cell and list by list.
    listed_part: Shaped[NDArray[np.uint32], "listed"]
    # Reversed direction bounds.  A part of an object may block segments from a part of a ball only
    # if each of the eight bounds of the ball's part is at most the bound here.
    part_bounds: Shaped[Floats, "parts 8"]
    part_object: Shaped[Ints, "parts"]

    def query(
        self,
        centers: Shaped[Floats, "3 n"],
        radii: Shaped[Floats, "... n"],
        own_object_index: Shaped[Ints, "n"],
        is_active: Shaped[Bools, "lights n"],
    ) -> Iterator[Shaped[Ints, "3 k"]]:
        """Find the objects that may lie between each ball and each light.

        Yields batches with indices of lights in row 0, of balls in row 1, and of objects in row 2.
        Every object that blocks a segment from a point of a ball to a light is found.  Objects that
        block none may be found, too, and an object may be found several times.

        Parameters
        ----------
        radii
            Radii (n,) of the balls.  To search around boxes instead, pass half their widths along
            each axis, (3, 1, n).
        own_object_index
            The object on whose surface the points of each ball lie; it is excluded.
        is_active
            Whether to search between the light and the ball.
        """
        ball_count = own_object_index.size
        to_light = self.light_position - centers[:, None]
        ball_parts = split_by_octant(
            to_light - radii, to_light + radii, self.patches.of_octant >= 0, is_active
        )
        for ball_part, object_part in self._match_parts(ball_parts):
            light_index, ball_index = np.divmod(ball_parts.box_index.take(ball_part), ball_count)
            object_index = self.part_object.take(object_part)
            kept_index = find(object_index != own_object_index.take(ball_index))
            rows = light_index, ball_index, object_index
            yield np.array([row.take(kept_index) for row in rows])

    def _match_parts(
        self, ball_parts: BoxParts
    ) -> Iterator[tuple[Shaped[Ints, "k"], Shaped[NDArray[np.uint32], "k"]]]:
        """Find the parts of objects that have directions in common with each part of a ball.

        A part is what lies in one octant, as seen from a light.  Yields batches of two arrays:
        indices of parts of balls, and of parts of objects.  No pair occurs twice.
        """
        # An object may be closer to the light than all of the ball.  So the minimum distance of
        # the ball excludes nothing.
        ball_bounds = ball_parts.bounds.T.copy()
        ball_bounds[:, MIN_DISTANCE_ROW] = -np.inf
        for ball_part, object_part in self._list_parts(ball_parts):
            meets_bound = self.part_bounds.take(object_part, 0) >= ball_bounds.take(ball_part, 0)
            # The same as meets_bound.all(axis=1), but much faster.
            match_index = find(meets_bound.view(np.uint64) == _EIGHT_TRUE)
            yield ball_part.take(match_index), object_part.take(match_index)

    def _list_parts(
        self, ball_parts: BoxParts
    ) -> Iterator[tuple[Shaped[Ints, "k"], Shaped[NDArray[np.uint32], "k"]]]:
        """Look up the parts of objects that overlap a cell with each part of a ball.

        Yields batches of two arrays: indices of parts of balls, and of parts of objects.  No pair
        occurs twice.
        """
        patch_index = self.patches.of_octant.take(ball_parts.octant_index)
        rectangles = self.patches.to_relative(ball_parts.rectangles, patch_index)
        overlaps = _find_overlaps(rectangles, patch_index, self.cells_per_side)
        for ball_part, cell_index, flags in overlaps:
            first_list = 4 * cell_index + _LISTS_START.take(flags)
            end_list = 4 * cell_index + _LISTS_STOP.take(flags)
            start = self.list_start.take(first_list).astype(np.intp)
            length = self.list_start.take(end_list).astype(np.intp) - start
            for batch in split_by_size(length, _PAIRS_PER_BATCH):
                object_part = self.listed_part.take(join_ranges(length[batch], start[batch]))
                yield ball_part[batch].repeat(length[batch]), object_part


def build_light_grid(
    light_position: Shaped[Floats, "lights 3"],
    box_min: Shaped[Floats, "3 objects"],
    box_max: Shaped[Floats, "3 objects"],
    position_error: Shaped[Floats, "objects"],
    is_visible: Shaped[Bools, "objects"],
    is_occluder: Shaped[Bools, "objects"],
) -> LightGrid | None:
    """Build a light grid; return None if no object can be in the shadow of another object.

    Parameters
    ----------
    box_min, box_max
        Smallest and largest coordinates of each object.
    position_error
        Bound on the rounding errors of points on each object.
    is_visible
        Whether the camera may see the object.  Shadows on all other objects are ignored.
    is_occluder
        Whether the object may cast a shadow on other objects.
    """
    light_count, object_count = len(light_position), position_error.size
    if not (light_count and object_count > 1 and is_visible.any()):
        return None
    box_min, box_max = box_min - position_error, box_max + position_error
    near_position, vector_error = _move_far_lights(light_position, box_min, box_max)
    parts = _split_objects(near_position, vector_error, box_min, box_max)
    object_index = parts.box_index % object_count
    visible_part = find(is_visible[object_index])
    patches = _choose_patches(
        parts.octant_index[visible_part], parts.rectangles[:, visible_part], 8 * light_count
    )
    has_patch = patches.of_octant[parts.octant_index] >= 0
    listed_parts = parts.take(find(has_patch & is_occluder[object_index]))
    # Free arrays that are large if there are many objects.
    del parts, object_index, has_patch
    patch_index = patches.of_octant[listed_parts.octant_index]
    patch_count = patches.origin.shape[1]
    rectangles = patches.to_relative(listed_parts.rectangles, patch_index)
    cells_per_side = _choose_cells_per_side(rectangles, object_count, light_count, patch_count)
    list_start, listed_part = _build_lists(rectangles, patch_index, cells_per_side, patch_count)
    return LightGrid(
        light_position=near_position,
        patches=patches,
        cells_per_side=cells_per_side,
        list_start=list_start,
        listed_part=listed_part,
        part_bounds=np.ascontiguousarray(reverse_bounds(listed_parts.bounds).T),
        part_object=listed_parts.box_index % object_count,
    )


def _move_far_lights(
    positions: Shaped[Floats, "lights 3"],
    box_min: Shaped[Floats, "3 objects"],
    box_max: Shaped[Floats, "3 objects"],
) -> tuple[Shaped[Floats, "3 lights 1"], Shaped[Floats, "lights 1"]]:
    """Move lights farther away than `_MAX_LIGHT_DISTANCE` closer to the scene.

    The first result contains the positions of all lights.  The second bounds the error of each
    component of a vector from the scene to the light, due to the move and to rounding.
    """
    scene_min = box_min.min(axis=1, keepdims=True)
    scene_max = box_max.max(axis=1, keepdims=True)
    scene_size = (scene_max - scene_min).sum()
    center = scene_min / 2 + scene_max / 2
    from_center = positions.T - center
    shrink_factor = _MAX_LIGHT_DISTANCE * scene_size / np.abs(from_center).sum(axis=0)
    is_far = shrink_factor < 1
    near_positions = np.where(is_far, center + shrink_factor * from_center, positions.T)
    move_error = np.where(is_far, 2 * scene_size / _MAX_LIGHT_DISTANCE, 0)
    vector_error = DIRECTION_ROUNDING * np.abs(near_positions).sum(axis=0) + move_error
    return near_positions[:, :, None], vector_error[:, None]


def _split_objects(
    light_position: Shaped[Floats, "3 lights 1"],
    vector_error: Shaped[Floats, "lights 1"],
    box_min: Shaped[Floats, "3 objects"],
    box_max: Shaped[Floats, "3 objects"],
) -> BoxParts:
    """Divide each object, as seen from each light, into its parts in all octants."""
    return split_by_octant(
        vector_min=(light_position - vector_error) - box_max[:, None],
        vector_max=(light_position + vector_error) - box_min[:, None],
        keeps_octant=np.ones(8 * vector_error.size, dtype=np.bool_),
        keeps_box=np.array([[True]]),
    )


def _choose_patches(
    octant_index: Shaped[Ints, "n"], rectangles: Shaped[Floats, "4 n"], octant_count: int
) -> Patches:
    """Choose a patch for each octant, from the rectangles of the visible parts in it.

    The parts are sorted by octant, so `octant_index` ascends.  Octants without visible parts get no
    patch.
    """
    octant_start, _ = find_runs(octant_index)
    of_octant = np.full(octant_count, -1)
    of_octant[octant_index[octant_start]] = np.arange(octant_start.size)
    origins, sizes = [], []
    for octant_rectangles in np.split(rectangles, octant_start[1:], axis=1):
        outlier_count = octant_rectangles.shape[1] // _OBJECTS_PER_OUTLIER
        sorted_minima = np.partition(octant_rectangles[::2], outlier_count)
        sorted_maxima = np.partition(octant_rectangles[1::2], -1 - outlier_count)
        origin = sorted_minima[:, outlier_count]
        origins.append(origin)
        sizes.append(sorted_maxima[:, -1 - outlier_count] - origin)
    return Patches(of_octant=of_octant, origin=np.array(origins).T, size=np.array(sizes).T)


def _choose_cells_per_side(
    relative_rectangles: Shaped[Floats, "4 parts"],
    object_count: int,
    light_count: int,
    patch_count: int,
) -> int:
    """Choose the number of cells along each side of a patch.

    It is limited by `_MAX_SIDE`, `_MAX_LISTED_PARTS` and `_MAX_CELLS`.
    """
    min_u, max_u, min_v, max_v = relative_rectangles.clip(0, 1)
    total_area = float(((max_u - min_u) * (max_v - min_v)).sum())  # 1 is the area of a patch
    max_cells = _MAX_LISTED_PARTS / (total_area / light_count)
    cell_count = min(object_count, _MAX_SIDE**2, max_cells, _MAX_CELLS / patch_count)
    return max(1, int(sqrt(cell_count)))


def _build_lists(
    relative_rectangles: Shaped[Floats, "4 parts"],
    patch_index: Shaped[Ints, "parts"],
    cells_per_side: int,
    patch_count: int,
) -> tuple[
    Shaped[NDArray[np.uint32], "4*cells_per_side**2*patch_count+1"],
    Shaped[NDArray[np.uint32], "listed"],
]:
    """Build the four lists of each cell, of the parts that overlap it, in ascending order.

    The results are `list_start` and `listed_part` of a `LightGrid`.
    """
    sort_keys = []
    list_start = np.zeros(4 * cells_per_side**2 * patch_count + 1, dtype=np.uint32)
    overlaps = _find_overlaps(relative_rectangles, patch_index, cells_per_side)
    for part_index, cell_index, flags in overlaps:
        list_index = 4 * cell_index + _LIST_OF_FLAGS.take(flags)
        # `np.add.at` is twenty times as fast if the increment has the type of the array.
        np.add.at(list_start, list_index + 1, np.uint32(1))
        sort_keys.append(list_index << 32 | part_index)
    # Each key contains the indices of a list and a part.  Sorting keys is faster than argsort.
    sorted_keys = np.concatenate(sort_keys)
    del sort_keys
    sorted_keys.sort()
    list_start.cumsum(out=list_start)
    return list_start, sorted_keys.astype(np.uint32)  # the lower half of a key is the part


class _Overlaps(NamedTuple):
    """Pairs of a rectangle and a cell that it overlaps."""

    rectangle_index: Shaped[Ints, "k"]
    cell_index: Shaped[Ints, "k"]  # (patch * cells_per_side + column) * cells_per_side + row
    # Sum of `_FIRST_COLUMN` and `_FIRST_ROW`, if they apply to the cell in the rectangle.
    flags: Shaped[NDArray[np.uint8], "k"]


def _find_overlaps(
    relative_rectangles: Shaped[Floats, "4 n"],
    patch_index: Shaped[Ints, "n"],
    cells_per_side: int,
) -> Iterator[_Overlaps]:
    """Find, in batches, all cells of its patch that each rectangle overlaps.

    The cells at the border of a patch also cover everything beyond the border.
    """
    cell_ranges = (cells_per_side * relative_rectangles).clip(0, cells_per_side - 1).astype(np.intp)
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
