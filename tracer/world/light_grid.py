"""A light buffer: for each light, a grid of directions that lists the objects in each cell.

Which objects may lie between a point and a light?  Only those that, as seen from the light, lie in
the same direction as the point (Haines and Greenberg, The light buffer, 1986).  Here a query is
for all points of a ball together.  All vectors lead from points to the light.

Octahedral map (Engelhardt and Dachsbacher, 2008)
    A light has eight octants of directions: one for each combination of the signs of x, y and z.
    In each octant, a direction (x, y, z) has the octahedral coordinates u = |x| / s and
    v = |y| / s, with s = |x| + |y| + |z|.  They form a triangle of the unit square.

The grid uses five private concepts:

patch
    A rectangle in the octahedral coordinates of one octant, which contains most of the objects
    that the camera may see.  Each patch is divided into a square array of cells; directions of the
    octant outside of the patch are treated as those at its border.
cell
    One element of this array, for which the grid lists objects.
entry
    The part of one object that lies in one octant of one light.
rectangle
    The bounding rectangle of an entry, or of a ball in one octant: the minimum and maximum of u,
    and the minimum and maximum of v, in octahedral coordinates or, in `relative_rectangles`, in
    coordinates that run from 0 to 1 across the patch.
direction bounds
    For an entry, or for a ball in one octant, the range of the distances from the light, and ranges
    of the ratios of the vectors' components, which correspond to planes through the light.

An entry is listed in all cells that its rectangle overlaps.  The rectangle of a ball overlaps
several cells, too, so the query may find an entry several times.

Rectangles are loose bounds for long objects.  So the query also compares the direction bounds of
the entry and the ball.

All bounds are computed by interval arithmetic on bounding boxes.  Each ratio has the form
a / (a + b) with a, b >= 0.  It increases with a and decreases with b, so it is least for the
smallest a and the largest b.  The light may be outside, on or inside a box.  All bounds are widened
by more than their rounding errors.  So the query excludes only objects that cannot lie between the
ball and the light.

All positions are in scene axes.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product
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
    sort_distinct,
    split_by_size,
)
from tracer.geometry.rounding import DIRECTION_ROUNDING, MIN_DIVISOR, POSITION_ROUNDING

# Maximum number of cells along each side of a patch.  With n objects, a patch has sqrt(n) cells
# along each side.  Smaller cells have shorter lists, but filling them takes longer.
_MAX_SIDE = 320

# Cells are larger where objects would be listed more than this many times for each light: it limits
# memory.
_MAX_ENTRIES = 32 * BATCH_SIZE

# Cells are larger if all patches together would have more than this many cells: it limits memory.
_MAX_CELLS = 256 * BATCH_SIZE

# Maximum number of pairs of a ball and an entry in one batch: their arrays stay in the CPU cache.
_PAIRS_PER_BATCH = 4 * CACHE_SIZE

# The same for pairs of a rectangle and a cell.
_CELLS_PER_BATCH = 4 * CACHE_SIZE

# On each of its sides, a patch excludes one in this many objects, which are listed in the cells at
# the border of the patch.  Otherwise a single huge object could stretch the patch until all other
# objects lie in one cell.
_OBJECTS_PER_OUTLIER = 64

# A light farther away than this many times the scene's size is moved to this distance.  Directions
# to the light turn by at most the reciprocal, in radians.
_MAX_LIGHT_DISTANCE = 2.0**22

# Eight bools that are all True, read as one integer.
_EIGHT_TRUE = 0x0101010101010101

# Row of the direction bounds that contains the minimum distance from the light.
_MIN_DISTANCE_ROW = 7


class _Parts(NamedTuple):
    """Boxes of vectors to lights, split by octant: the vectors of each part lie in one octant."""

    # Index, octant * lights + light, of the octant of one light; ascends.
    octant_index: Shaped[Ints, "parts"]
    box_index: Shaped[Ints, "parts"]  # index in the flattened (lights, n) array of boxes
    rectangles: Shaped[Floats, "4 parts"]  # minimum and maximum of u, then of v
    bounds: Shaped[Floats, "8 parts"]  # direction bounds: see `_bound_directions`


class _Range(NamedTuple):
    """Smallest and largest absolute values of one component of the vectors in each part."""

    low: Shaped[Floats, "parts"]
    high: Shaped[Floats, "parts"]  # above 0, so no bound is 0 / 0


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
        """Convert rectangles to coordinates that run from 0 to 1 across their patches."""
        origin = self.origin.take(patch_index, axis=1)
        size = self.size.take(patch_index, axis=1)
        return ((rectangles.reshape(2, 2, -1) - origin[:, None]) / size[:, None]).reshape(4, -1)


class LightGrid(NamedTuple):
    """Lists of objects by their direction from each light."""

    # Distant lights are moved closer: see `_MAX_LIGHT_DISTANCE`.
    light_position: Shaped[Floats, "3 lights 1"]
    patches: Patches
    cells_per_side: int
    # Position in `listed_entry` where the list of each cell begins.
    list_start: Shaped[NDArray[np.uint32], "cells+1"]
    # Indices of the entries in all lists, cell by cell.
    listed_entry: Shaped[NDArray[np.uint32], "listed"]
    # Direction bounds, arranged so that an entry may block segments from a ball only if each of
    # the ball's eight bounds is at most the entry's bound.
    entry_bounds: Shaped[Floats, "entries 8"]
    entry_object: Shaped[Ints, "entries"]

    def query(
        self,
        centers: Shaped[Floats, "3 n"],
        radii: Shaped[Floats, "... n"],
        own_object_index: Shaped[Ints, "n"],
        is_active: Shaped[Bools, "lights n"],
    ) -> Iterator[Shaped[Ints, "3 k"]]:
        """Yield (light, ball, object) indices of objects that may lie between balls and lights.

        Every object that blocks a segment from a point of a ball to a light is found.  Other
        objects may be found, too, and the same object may be found several times.

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
        # The vectors from a ball to a light fill a box, which is split into up to eight parts.
        to_light = self.light_position - centers[:, None]
        parts = _split_by_octant(
            to_light - radii, to_light + radii, self.patches.of_octant >= 0, is_active
        )
        for part_index, entry_index in self._match_entries(parts):
            light_index, ball_index = np.divmod(parts.box_index.take(part_index), ball_count)
            occluder_index = self.entry_object.take(entry_index)
            kept_index = find(occluder_index != own_object_index.take(ball_index))
            rows = light_index, ball_index, occluder_index
            yield np.array([row.take(kept_index) for row in rows])

    def _match_entries(
        self, parts: _Parts
    ) -> Iterator[tuple[Shaped[Ints, "k"], Shaped[Ints, "k"]]]:
        """Yield indices of parts of balls, and of listed entries whose direction bounds match.

        Within a batch, no pair occurs twice, even if a part and an entry have several cells in
        common.
        """
        # An occluder may be closer to the light than all of the ball.  So the minimum distance of
        # the ball excludes nothing.
        part_bounds = parts.bounds.T.copy()
        part_bounds[:, _MIN_DISTANCE_ROW] = -np.inf
        for part_index, entry_index in self._list_entries(parts):
            meets_bound = self.entry_bounds.take(entry_index, 0) >= part_bounds.take(part_index, 0)
            # The same as meets_bound.all(axis=1), but much faster.
            match_index = find(meets_bound.view(np.uint64) == _EIGHT_TRUE)
            match_part, match_entry = part_index.take(match_index), entry_index.take(match_index)
            # Each key contains the indices of a part and an entry.
            distinct_key = sort_distinct(match_part << 32 | match_entry)
            yield distinct_key >> 32, distinct_key & 0xFFFFFFFF

    def _list_entries(
        self, parts: _Parts
    ) -> Iterator[tuple[Shaped[Ints, "k"], Shaped[NDArray[np.uint32], "k"]]]:
        """Yield every (part, entry) pair in which a cell that the part overlaps lists the entry.

        Each batch consists of two parallel arrays: the parts' indices and the entries' indices.  A
        pair occurs once for each such cell.
        """
        patch_index = self.patches.of_octant.take(parts.octant_index)
        rectangles = self.patches.to_relative(parts.rectangles, patch_index)
        overlaps = _find_overlaps(rectangles, patch_index, self.cells_per_side)
        for part_index, cell_index in overlaps:
            start = self.list_start.take(cell_index).astype(np.intp)
            length = self.list_start.take(cell_index + 1) - start
            for batch in split_by_size(length, _PAIRS_PER_BATCH):
                entry_index = self.listed_entry.take(join_ranges(length[batch], start[batch]))
                yield part_index[batch].repeat(length[batch]), entry_index


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
    # Bounds on the vectors from the points of each object to each light.
    vector_min = (near_position - vector_error) - box_max[:, None]
    vector_max = (near_position + vector_error) - box_min[:, None]
    parts = _split_by_octant(
        vector_min,
        vector_max,
        has_patch=np.ones(8 * light_count, dtype=np.bool_),
        is_active=np.array([[True]]),
    )
    object_index = parts.box_index % object_count
    visible_part = find(is_visible[object_index])
    patches = _choose_patches(
        parts.octant_index[visible_part], parts.rectangles[:, visible_part], 8 * light_count
    )
    patch_index = patches.of_octant[parts.octant_index]
    entry_part = find((patch_index >= 0) & is_occluder[object_index])
    entry_patch, entry_object = patch_index[entry_part], object_index[entry_part]
    entry_bounds = _reverse_bounds(parts.bounds.take(entry_part, axis=1))
    rectangles = parts.rectangles.take(entry_part, axis=1)
    # Free arrays that are large if there are many objects.
    del vector_min, vector_max, parts, object_index, patch_index
    rectangles = patches.to_relative(rectangles, entry_patch)
    patch_count = patches.origin.shape[1]
    cells_per_side = _choose_cells_per_side(rectangles, object_count, light_count, patch_count)
    list_start, listed_entry = _build_lists(rectangles, entry_patch, cells_per_side, patch_count)
    return LightGrid(
        light_position=near_position,
        patches=patches,
        cells_per_side=cells_per_side,
        list_start=list_start,
        listed_entry=listed_entry,
        entry_bounds=np.ascontiguousarray(entry_bounds.T),
        entry_object=entry_object,
    )


def _choose_patches(
    octant_index: Shaped[Ints, "n"], rectangles: Shaped[Floats, "4 n"], octant_count: int
) -> Patches:
    """Choose a patch for each octant that contains visible objects, from their rectangles.

    The octant indices ascend.
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


def _move_far_lights(
    positions: Shaped[Floats, "lights 3"],
    box_min: Shaped[Floats, "3 objects"],
    box_max: Shaped[Floats, "3 objects"],
) -> tuple[Shaped[Floats, "3 lights 1"], Shaped[Floats, "lights 1"]]:
    """Move lights farther away than `_MAX_LIGHT_DISTANCE` closer to the scene.

    The second result bounds the errors of vectors from the scene to each light, which are due to
    the move and to rounding.
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


def _split_by_octant(
    vector_min: Shaped[Floats, "3 lights n"],
    vector_max: Shaped[Floats, "3 lights n"],
    has_patch: Shaped[Bools, "8*lights"],
    is_active: Shaped[Bools, "#lights #n"],
) -> _Parts:
    """Split boxes of vectors by octant, and bound the directions of the vectors in each part.

    A box contains the vectors to one light whose x, y and z are in given ranges, so it has up to
    eight parts.  Boxes that are not active, and parts in octants without a patch, are skipped.
    """
    _, light_count, box_count = vector_min.shape
    pair_count = light_count * box_count
    # Row 0: whether each box contains vectors with x >= 0.  Row 1: the same for x <= 0.
    has_x, has_y, has_z = np.array([vector_max >= 0, vector_min <= 0]).swapaxes(0, 1)
    has_part = np.array([z & y & x & is_active for z, y, x in product(has_z, has_y, has_x)])
    # The index of a part is (sign_bits * lights + light) * n + box.  Bit 0 of `sign_bits` is set if
    # x is negative, bit 1 if y is, and bit 2 if z is.
    part_index = find(has_part & has_patch.reshape(8, -1, 1))
    sign_bits = part_index // pair_count
    box_index = part_index - sign_bits * pair_count
    x, y, z = (
        _bound_component(
            vector_min[axis].take(box_index),
            vector_max[axis].take(box_index),
            is_negative=(sign_bits >> axis & 1).astype(np.bool_),
        )
        for axis in range(3)
    )
    return _Parts(
        octant_index=part_index // box_count,
        box_index=box_index,
        rectangles=np.array([*_bound_share(x, y, z), *_bound_share(y, x, z)]),
        bounds=_bound_directions(x, y, z),
    )


def _bound_component(
    low: Shaped[Floats, "parts"], high: Shaped[Floats, "parts"], is_negative: Shaped[Bools, "parts"]
) -> _Range:
    """Bound the absolute value of a component that lies between two bounds and has one sign."""
    return _Range(
        low=np.maximum(np.where(is_negative, -high, low), 0),
        high=np.where(is_negative, -low, high) + MIN_DIVISOR,
    )


def _bound_share(
    a: _Range, b: _Range, c: _Range
) -> tuple[Shaped[Floats, "parts"], Shaped[Floats, "parts"]]:
    """Compute the minimum and the maximum of a / (a + b + c): u or v, if a is |x| or |y|."""
    min_share = a.low / (a.low + (b.high + c.high)) - DIRECTION_ROUNDING
    max_share = a.high / (a.high + (b.low + c.low)) + DIRECTION_ROUNDING
    return min_share, max_share


def _bound_directions(x: _Range, y: _Range, z: _Range) -> Shaped[Floats, "8 parts"]:
    """Compute the direction bounds of the vectors in each part.

    Here x, y and z are the absolute values of a vector's components, and x + y + z measures its
    length.  Rows 0 to 5 contain the minimum and the negated maximum of x / (x + y), of y / (y + z)
    and of z / (z + x).  Row 6 contains the negated maximum of x + y + z, and row 7 the minimum.
    Maxima are negated, so that all bounds are lower bounds.
    """
    bounds = np.empty((8, x.low.size))
    for pair_index, (a, b) in enumerate(((x, y), (y, z), (z, x))):
        bounds[2 * pair_index] = a.low / (a.low + b.high) - DIRECTION_ROUNDING
        bounds[2 * pair_index + 1] = -(a.high / (a.high + b.low)) - DIRECTION_ROUNDING
    bounds[6] = -(1 + POSITION_ROUNDING) * (x.high + y.high + z.high)
    bounds[_MIN_DISTANCE_ROW] = (1 - POSITION_ROUNDING) * (x.low + y.low + z.low)
    return bounds


def _reverse_bounds(bounds: Shaped[Floats, "8 n"]) -> Shaped[Floats, "8 n"]:
    """Swap and negate each pair of a minimum and a negated maximum.

    Then each minimum of a ball is compared with the maximum of an entry, and vice versa.
    """
    return -bounds.reshape(4, 2, -1)[:, ::-1].reshape(8, -1)


def _choose_cells_per_side(
    relative_rectangles: Shaped[Floats, "4 entries"],
    object_count: int,
    light_count: int,
    patch_count: int,
) -> int:
    """Choose the number of cells along each side of a patch: see `_MAX_SIDE`."""
    min_u, max_u, min_v, max_v = relative_rectangles.clip(0, 1)
    total_area = float(((max_u - min_u) * (max_v - min_v)).sum())  # 1 is the area of a patch
    max_cells = _MAX_ENTRIES / (total_area / light_count)
    cell_count = min(object_count, _MAX_SIDE**2, max_cells, _MAX_CELLS / patch_count)
    return max(1, int(sqrt(cell_count)))


def _build_lists(
    relative_rectangles: Shaped[Floats, "4 entries"],
    patch_index: Shaped[Ints, "entries"],
    cells_per_side: int,
    patch_count: int,
) -> tuple[
    Shaped[NDArray[np.uint32], "patch_count*cells_per_side**2+1"],
    Shaped[NDArray[np.uint32], "listed"],
]:
    """Build `list_start` and `listed_entry`: for each cell, the entries that overlap it.

    In each list, entries ascend.
    """
    sort_keys = []
    list_start = np.zeros(patch_count * cells_per_side**2 + 1, dtype=np.uint32)
    overlaps = _find_overlaps(relative_rectangles, patch_index, cells_per_side)
    for entry_index, cell_index in overlaps:
        # `np.add.at` is twenty times as fast if the increment has the type of the array.
        np.add.at(list_start, cell_index + 1, np.uint32(1))
        sort_keys.append(cell_index << 32 | entry_index)
    # Each key contains the indices of a cell and an entry.  Sorting keys is faster than argsort.
    sorted_keys = np.concatenate(sort_keys)
    del sort_keys
    sorted_keys.sort()
    list_start.cumsum(out=list_start)
    return list_start, sorted_keys.astype(np.uint32)  # the lower half of a key is the entry


def _find_overlaps(
    relative_rectangles: Shaped[Floats, "4 n"],
    patch_index: Shaped[Ints, "n"],
    cells_per_side: int,
) -> Iterator[tuple[Shaped[Ints, "k"], Shaped[Ints, "k"]]]:
    """Yield the indices of each rectangle and of all cells that it overlaps.

    The cells at the border of a patch also cover everything beyond the border.  The index of a cell
    is (patch * cells_per_side + column) * cells_per_side + row.
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
        yield strip_rectangle.take(strip_index), cell_index
