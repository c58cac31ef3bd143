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
    that the camera may see.  Each patch is divided into side x side cells; directions of the octant
    outside of the patch are treated as those at its border.
cell
    One square of a patch, for which the grid lists objects.
entry
    The part of one object that lies in one octant of one light.
rectangle
    The bounding rectangle, in octahedral coordinates, of an entry or of a ball in one octant.
direction bounds
    Eight numbers for an entry, or for a ball in one octant: see `_bound_directions`.

An entry is listed in all cells that its rectangle overlaps.  The rectangle of a ball overlaps
several cells, too, and yet the query must find each entry only once.  Therefore it finds the entry
only in the first column and the first row that both rectangles have in common.  For this purpose
each cell has four lists (see `_LIST_OF_PLACE`).

Rectangles are loose bounds for long objects.  So the query also compares the direction bounds of
the entry and the ball: the range of their distances from the light, and ranges of the ratios of the
vectors' components, which correspond to planes through the light.

All bounds are computed by interval arithmetic on bounding boxes.  The light may be outside, on or
inside a box.  All bounds are widened by more than their rounding errors.  So the query excludes
only objects that cannot lie between the ball and the light.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product
from math import sqrt
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from tracer.arrays import (
    BATCH_SIZE,
    CACHE_SIZE,
    Bools,
    Floats,
    Ints,
    batches,
    enumerate_ranges,
    find_runs,
    indices,
    join_ranges,
)
from tracer.geometry.rounding import DIRECTION_ROUNDING, MIN_DIVISOR, POSITION_ROUNDING

# With n objects, a patch has sqrt(n) cells along each side, but at most `_MAX_SIDE`.  Smaller cells
# have shorter lists, but filling them takes longer.  Cells are larger where objects would be listed
# more than `_MAX_ENTRIES` times for each light, or all patches together would have more than
# `_MAX_CELLS` cells.
_MAX_SIDE, _MAX_ENTRIES, _MAX_CELLS = 320, 32 * BATCH_SIZE, 256 * BATCH_SIZE

# Maximum number of pairs of a ball and an entry, and of a rectangle and a cell, in one batch: their
# arrays stay in the CPU cache.
_PAIRS_PER_BATCH, _CELLS_PER_BATCH = 4 * CACHE_SIZE, 4 * CACHE_SIZE

# On each of its sides, a patch excludes one in this many objects, which are listed in the cells at
# the border of the patch.  Otherwise a single huge object could stretch the patch until all other
# objects lie in one cell.
_OBJECTS_PER_OUTLIER = 64

# Flags for the place of a cell in a rectangle: the cell is in the rectangle's first column, in its
# first row, in both, or in neither.
_FIRST_COLUMN, _FIRST_ROW = 1, 2

# The rectangles of an entry and a ball may have several cells in common.  Among these, the first
# cell is the one that is in the first column of either rectangle and in the first row of either
# rectangle.  So each cell has four lists of entries, by the place of the cell in the entry's
# rectangle: list 0 for "first row only", 1 for "first column and first row", 2 for "first column
# only", 3 for "neither".
_LIST_OF_PLACE = np.array([3, 2, 0, 1])

# A ball reads a range of these lists, by the place of the cell in the ball's rectangle: the first
# row contains the start of each range, and the second row its end, exclusive.
_LIST_LIMITS = np.array([[1, 0, 1, 0], [2, 2, 3, 4]])

# Direction bounds are stored in float32 if all patches are wider than this, in octahedral
# coordinates, and otherwise in float64.  With float32, rendering 10,000 objects takes 0.88
# times as long and nine tenths of the memory, and scenes of few objects 0.98 times as long.
_MIN_FLOAT32_WIDTH = 1e-4

# A light farther away than this many times the scene's size is moved to this distance.  Directions
# to the light turn by at most the reciprocal, in radians.
_MAX_LIGHT_DISTANCE = 2.0**22

# Eight bools that are all True, read as one integer.
_EIGHT_TRUE = 0x0101010101010101

# Minimum (m,) and maximum (m,) of a quantity.
_Interval: TypeAlias = tuple[Floats, Floats]


class LightGrid(NamedTuple):
    """Lists of objects by their direction from each light.

    An octant contains the directions for one combination of the signs of x, y and z.  Octahedral
    coordinates (u, v) map these directions into the unit square.  A patch is a rectangle in these
    coordinates, and it is divided into square cells.  An entry is the part of one object that lies
    in one octant of one light.  Each cell lists the entries that may lie in the cell's directions.

    The query for a ball, a group of points, uses the attributes in their order:

    1. `light`: the vectors from the ball to the light determine octants.
    2. `patch`: each octant has at most one patch.
    3. `side`, `origin` and `size`: the bounding rectangle of the ball's directions overlaps certain
       cells of the patch.
    4. `list_start` and `listed`: these cells list entries.  A ball and an entry may share several
       cells, but the query finds the pair only in the first of these cells.  For this purpose, each
       cell has four lists, and the query reads one range of these lists.
    5. `entry_bounds`: entries at other distances, or in other directions, are excluded.
    6. `entry_object`: the remaining entries are parts of these objects.

    Attributes
    ----------
    light : (3, lights, 1) float array
        Positions of the lights, in scene axes.  Distant lights are moved closer: see
        `_MAX_LIGHT_DISTANCE`.
    patch : (8 * lights,) int array
        Element octant * lights + light is the index of the patch in this octant of the light, or
        -1 if the octant contains no object that the camera may see.
    side : int
        Number of cells along each side of a patch.
    origin : (2, patches) float array
        Octahedral coordinates (u, v) of the corner of each patch with the smallest u and v.
    size : (2, patches) float array
        Extents of each patch in u and v.
    list_start : (4 * patches * side**2 + 1,) int array
        Element 4 * cell + i is the position in `listed` where list i of the cell begins.
    listed : (m,) int array
        Indices of the entries in all lists, cell by cell and list by list.
    entry_bounds : (entries, 8) float array
        Bounds on each entry's directions and distances from the light: see `_bound_directions`.
        They are arranged so that an entry may block segments from a ball only if each of the ball's
        eight bounds is at most the entry's bound.
    entry_object : (entries,) int array
        Index of the object of each entry.
    """

    light: Floats
    patch: Ints
    side: int
    origin: Floats
    size: Floats
    list_start: NDArray[np.uint32]
    listed: NDArray[np.uint32]
    entry_bounds: NDArray[np.floating[Any]]
    entry_object: Ints

    def query(
        self, center: Floats, radius: Floats, own_object_index: Ints, active: Bools
    ) -> Iterator[Ints]:
        """Find the objects that may lie between each ball and each light; yield them in batches.

        The result is conservative: it includes every object that blocks a segment from a point of
        the ball to the light, and some that block none.  An object may appear several times, at
        most once in each octant of directions.  The ball's own object is excluded.

        Parameters
        ----------
        center : (3, n) float array
            Centres of the balls, in scene axes.
        radius : (n,) or (3, 1, n) float array
            Radii of the balls.  If the points are enclosed by boxes instead of balls, these are the
            half widths of the boxes along each axis.
        own_object_index : (n,) int array
            For each ball, the index of the object on which its points lie.
        active : (lights, n) bool array
            Whether to search for objects between the light and the ball.  Pairs that are not
            active are skipped.

        Yields
        ------
        triples : (3, k) int array
            Row 0 contains light indices, row 1 ball indices, and row 2 indices of objects that may
            block segments from the ball to the light.
        """
        light_count, ball_count = active.shape
        # The vectors from a ball to a light fill a box, which is split into up to eight parts.
        to_light = self.light - center[:, None]
        octant, box_index, rectangle, bounds = _split_by_octant(
            to_light - radius, to_light + radius, self.patch, active
        )
        # Objects may extend beyond the ball, away from the light, so their far ends do not matter.
        bounds[7] = -np.inf
        bounds = bounds.T.astype(self.entry_bounds.dtype, order="C")
        patch = self.patch.take(octant * light_count + box_index // ball_count)
        rectangle = _rescale_to_patch(rectangle, patch, self.origin, self.size)
        for part_index, start, length in self._find_ranges(rectangle, patch):
            for batch in batches(length, _PAIRS_PER_BATCH):
                entry_part = part_index[batch].repeat(length[batch])
                entry = self.listed.take(join_ranges(start[batch], length[batch]))
                is_within = self.entry_bounds.take(entry, axis=0) >= bounds.take(entry_part, axis=0)
                # The same as is_within.all(axis=1), but much faster.
                match = indices(is_within.view(np.uint64) == _EIGHT_TRUE)
                occluder = self.entry_object.take(entry.take(match))
                box_of_match = box_index.take(entry_part.take(match))
                light_index, ball_index = np.divmod(box_of_match, ball_count)
                kept = indices(occluder != own_object_index.take(ball_index))
                yield np.array([light_index.take(kept), ball_index.take(kept), occluder.take(kept)])

    def _find_ranges(self, rectangle: Floats, patch: Ints) -> Iterator[tuple[Ints, Ints, Ints]]:
        """Find which ranges of `listed` contain the entries that each rectangle may overlap.

        A rectangle bounds the directions from a light to some points.  An entry is the part of an
        object in one octant of directions.  `listed` contains four lists of entries for each cell
        of directions.  Only some of the four lists are read, so that no entry is returned twice for
        one rectangle.

        Parameters
        ----------
        rectangle : (4, n) float array
            Minimum and maximum u, then minimum and maximum v, relative to the patch: 0 is the start
            of the patch, and 1 its end.
        patch : (n,) int array
            Index of each rectangle's patch.

        Yields
        ------
        rectangle_index : (k,) int array
            Index of each range's rectangle.
        start, length : (k,) int arrays
            Each range is listed[start : start + length]; `length` is at least 1.
        """
        for rectangle_index, cell_index, place in _find_overlaps(rectangle, patch, self.side):
            start, stop = (
                self.list_start.take(4 * cell_index + list_limit.take(place)).astype(np.intp)
                for list_limit in _LIST_LIMITS
            )
            nonempty = indices(stop > start)
            start, stop = start.take(nonempty), stop.take(nonempty)
            yield rectangle_index.take(nonempty), start, stop - start


def build_light_grid(
    light_position: Floats,
    low: Floats,
    high: Floats,
    position_error: Floats,
    is_visible: Bools,
    is_occluder: Bools,
) -> LightGrid | None:
    """Build a grid for finding the objects that may lie between a point and a light.

    For each light, the grid divides directions into cells, and lists the objects in each cell.

    Parameters
    ----------
    light_position : (lights, 3) float array
        Positions of the lights, in scene axes.
    low, high : (3, n) float arrays
        Smallest and largest coordinates of each object, in scene axes.
    position_error : (n,) float array
        Bound on the rounding errors of points on each object.  The object is enlarged by it.
    is_visible : (n,) bool array
        Whether the camera may see the object, so that shadows on the object matter.
    is_occluder : (n,) bool array
        Whether the object may cast a shadow on other objects.

    Returns
    -------
    grid : LightGrid or None
        None if no object can be in the shadow of another object.
    """
    light_count, object_count = len(light_position), position_error.size
    if not (light_count and object_count > 1 and is_visible.any()):
        return None
    low, high = low - position_error, high + position_error
    light, vector_error = _move_far_lights(light_position, low, high)
    # From here on, these are bounds on the vectors from the points of each object to each light.
    low, high = (light - vector_error) - high[:, None], (light + vector_error) - low[:, None]
    octant_count = 8 * light_count
    no_skips, all_active = np.zeros(octant_count, dtype=np.intp), np.ones((1, 1), dtype=np.bool_)
    sign_bits, box_index, rectangle, bounds = _split_by_octant(low, high, no_skips, all_active)
    light_index, object_index = np.divmod(box_index, object_count)
    octant = sign_bits * light_count + light_index
    visible = indices(is_visible[object_index])
    patch, origin, size = _choose_patches(octant[visible], rectangle[:, visible], octant_count)
    entry_index = indices((patch[octant] >= 0) & is_occluder[object_index])
    # Rounding to float32 is monotonic: what compares as >= still does.
    dtype = np.float32 if size.min() > _MIN_FLOAT32_WIDTH else np.float64
    # Swap and negate each pair of rows, so that each minimum of a ball is compared with the
    # maximum of an entry, and vice versa.
    entry_bounds = -bounds.reshape(4, 2, -1)[:, ::-1].reshape(8, -1).take(entry_index, axis=1)
    entry_bounds = entry_bounds.T.astype(dtype, order="C")
    entry_patch, entry_object = patch[octant[entry_index]], object_index[entry_index]
    rectangle = rectangle.take(entry_index, axis=1)
    # These arrays are large if there are many objects.
    del low, high, sign_bits, octant, box_index, light_index, bounds, object_index
    rectangle = _rescale_to_patch(rectangle, entry_patch, origin, size)
    patch_count = origin.shape[1]
    side = _choose_cells_per_side(rectangle, object_count, light_count, patch_count)
    lists = _fill_lists(rectangle, entry_patch, side, patch_count)
    return LightGrid(light, patch, side, origin, size, *lists, entry_bounds, entry_object)


def _choose_patches(
    octant: Ints, rectangle: Floats, octant_count: int
) -> tuple[Ints, Floats, Floats]:
    """Choose a patch of directions for each octant that contains visible objects.

    Octahedral coordinates (u, v) map the directions of one octant into the unit square.  A patch is
    a rectangle in these coordinates that bounds the octant's visible objects except for outliers.
    At most one object in `_OBJECTS_PER_OUTLIER` extends beyond each of its four sides.

    Parameters
    ----------
    octant : (n,) int array
        The octant number of each rectangle, in ascending order.
    rectangle : (4, n) float array
        Bounding rectangles of the parts of visible objects in each octant: minimum and maximum u,
        then minimum and maximum v.
    octant_count : int
        Total number of octants: 8 for each light.

    Returns
    -------
    patch_of_octant : (octant_count,) int array
        Index of the patch in each octant, or -1 if the octant contains no visible object.
    origin, size : (2, patches) float arrays
        Minimum u and v of each patch, and the extents of the patch in u and v.
    """
    octant_start, _ = find_runs(octant)
    patch_of_octant = np.full(octant_count, -1)
    patch_of_octant[octant[octant_start]] = np.arange(octant_start.size)
    origins_and_sizes = []
    for octant_rectangles in np.split(rectangle, octant_start[1:], axis=1):
        outlier_count = octant_rectangles.shape[1] // _OBJECTS_PER_OUTLIER
        low = np.partition(octant_rectangles[::2], outlier_count)[:, outlier_count]
        high = np.partition(octant_rectangles[1::2], -1 - outlier_count)[:, -1 - outlier_count]
        origins_and_sizes.append((low, high - low))
    origin, size = np.array(origins_and_sizes).transpose(1, 2, 0)
    return patch_of_octant, origin, size


def _move_far_lights(light_position: Floats, low: Floats, high: Floats) -> tuple[Floats, Floats]:
    """Move distant lights towards the scene, to `_MAX_LIGHT_DISTANCE` times the scene's size.

    Beyond that distance, moving a light changes the direction to it, from any point of the scene,
    by a negligible angle.

    Parameters
    ----------
    light_position : (n, 3) float array
        Positions of the lights, in scene axes.
    low, high : (3, objects) float arrays
        Smallest and largest coordinates of each object in the scene.

    Returns
    -------
    position : (3, n, 1) float array
        New positions of the lights; only those of distant lights differ.
    vector_error : (n, 1) float array
        Bound on the error of vectors from points of the scene to each light, due to rounding and,
        if the light was moved, to the change of direction.
    """
    scene_low, scene_high = low.min(axis=1, keepdims=True), high.max(axis=1, keepdims=True)
    center, scene_size = scene_low / 2 + scene_high / 2, (scene_high - scene_low).sum()
    from_center = light_position.T - center
    shrink_factor = _MAX_LIGHT_DISTANCE * scene_size / np.abs(from_center).sum(axis=0)
    position = np.where(shrink_factor < 1, center + shrink_factor * from_center, light_position.T)
    direction_change_bound = np.where(shrink_factor < 1, 2 * scene_size / _MAX_LIGHT_DISTANCE, 0)
    vector_error = DIRECTION_ROUNDING * np.abs(position).sum(axis=0) + direction_change_bound
    return position[:, :, None], vector_error[:, None]


def _split_by_octant(
    low: Floats, high: Floats, patch_of_octant: Ints, active: Bools
) -> tuple[Ints, Ints, Floats, Floats]:
    """Split boxes of vectors at the coordinate planes, and bound the directions in each part.

    Each box contains the vectors from the points of an object, or of a ball, to one light.  A part
    is the intersection of a box with one of the eight octants of directions.

    Parameters
    ----------
    low, high : (3, lights, n) float arrays
        Minimum and maximum of each vector component, for each box.
    patch_of_octant : (8 * lights,) int array
        Element octant * lights + light is negative if this octant of the light is skipped.
    active : (lights, n) or (1, 1) bool array
        Whether to process the box.

    Returns
    -------
    octant : (m,) int array
        Number of each part's octant, in ascending order.  Bit k is set if component k is negative.
    box_index : (m,) int array
        Index of each part's box: light * n + the position of the box among those of the light.
    rectangle : (4, m) float array
        Minimum and maximum of u, then of v: the octahedral coordinates u = |x| / (|x| + |y| + |z|)
        and v = |y| / (|x| + |y| + |z|) of the vectors (x, y, z) in the part.
    bounds : (8, m) float array
        More bounds, in which x, y and z stand for |x|, |y| and |z|: the minimum and the negated
        maximum of x / (x + y), of y / (y + z) and of z / (z + x); then the negated maximum and the
        minimum of x + y + z.
    """
    # Whether each box contains vectors with x >= 0, and with x <= 0; the same for y and z.
    x_signs, y_signs, z_signs = np.moveaxis(np.array([high >= 0, low <= 0]), 1, 0)
    signs = product(z_signs, y_signs, x_signs)
    has_part = [in_z & in_y & in_x & active for in_z, in_y, in_x in signs]
    is_wanted = (patch_of_octant >= 0).reshape(8, -1, 1)
    octant, box_index = np.divmod(indices(np.array(has_part) & is_wanted), low[0].size)
    ranges = []
    for axis in range(3):
        is_negative = (octant >> axis & 1).astype(np.bool_)
        axis_low, axis_high = low[axis].take(box_index), high[axis].take(box_index)
        minimum = np.maximum(np.where(is_negative, -axis_high, axis_low), 0)
        # For a box that only touches a coordinate plane, 0 / 0 would give no bound.
        maximum = np.where(is_negative, -axis_low, axis_high) + MIN_DIVISOR
        ranges.append((minimum, maximum))
    # The minimum, x0, and the maximum, x1, of |x|; the same for |y| and |z|.
    (x0, x1), (y0, y1), (z0, z1) = ranges
    rectangle = np.array(
        [x0 / (x0 + (y1 + z1)), x1 / (x1 + (y0 + z0)), y0 / (y0 + (x1 + z1)), y1 / (y1 + (x0 + z0))]
    )
    rectangle[::2] -= DIRECTION_ROUNDING
    rectangle[1::2] += DIRECTION_ROUNDING
    return octant, box_index, rectangle, _bound_directions(*ranges)


def _bound_directions(x: _Interval, y: _Interval, z: _Interval) -> Floats:
    """Bound ratios and sums of vector components, for each of m sets of vectors.

    Here x, y and z are the absolute values of the components.  Maxima are stored negated, so that
    enlarging a set of vectors never increases any row.  All bounds are widened by more than their
    rounding errors.

    Parameters
    ----------
    x, y, z : pairs of (m,) float arrays
        Minimum and maximum of the absolute value of each component, for each set of vectors.

    Returns
    -------
    bounds : (8, m) float array
        Rows 0 and 1 contain the minimum and the negated maximum of x / (x + y), rows 2 and 3 those
        of y / (y + z), and rows 4 and 5 those of z / (z + x).  Row 6 contains the negated maximum
        of x + y + z, and row 7 the minimum.
    """
    bounds = np.empty((8, x[0].size))
    # Ranges of one component, a, and of the next component, b.
    for pair, ((min_a, max_a), (min_b, max_b)) in enumerate(((x, y), (y, z), (z, x))):
        bounds[2 * pair] = min_a / (min_a + max_b) - DIRECTION_ROUNDING
        bounds[2 * pair + 1] = -(max_a / (max_a + min_b)) - DIRECTION_ROUNDING
    bounds[6] = -(1 + POSITION_ROUNDING) * (x[1] + y[1] + z[1])
    bounds[7] = (1 - POSITION_ROUNDING) * (x[0] + y[0] + z[0])
    return bounds


def _rescale_to_patch(rectangle: Floats, patch: Ints, origin: Floats, size: Floats) -> Floats:
    """Convert rectangles from octahedral coordinates to coordinates relative to their patches.

    Octahedral coordinates (u, v) map the directions of one octant into the unit square.  A patch is
    a rectangle in these coordinates.

    Parameters
    ----------
    rectangle : (4, n) float array
        The rectangles in octahedral coordinates: minimum and maximum u, then minimum and maximum v.
    patch : (n,) int array
        Index of the patch of each rectangle.
    origin, size : (2, patches) float arrays
        Minimum u and v of each patch, and the extents of the patch in u and v.

    Returns
    -------
    relative : (4, n) float array
        The same rectangles in coordinates that are 0 at the origin of the patch, and 1 at its end.
    """
    origin, size = origin.take(patch, axis=1), size.take(patch, axis=1)
    return ((rectangle.reshape(2, 2, -1) - origin[:, None]) / size[:, None]).reshape(4, -1)


def _choose_cells_per_side(
    rectangle: Floats, object_count: int, light_count: int, patch_count: int
) -> int:
    """Choose the number of cells along each side of the patches of a light grid.

    A patch is a square array of cells, each of which lists objects.  A patch has about as many
    cells as there are objects, subject to limits on (1) the cells in a patch, (2) the cells in all
    patches together, and (3) the mean number of entries in the cells' lists, per light.

    Parameters
    ----------
    rectangle : (4, entries) float array
        Bounding rectangles of entries (parts of objects): minimum and maximum u, then minimum and
        maximum v, relative to their patches (0 is the start of the patch, and 1 its end).
    object_count, light_count, patch_count : int
        Numbers of objects, lights and patches.

    Returns
    -------
    side : int
        Each patch has side x side cells; at least 1.
    """
    min_u, max_u, min_v, max_v = rectangle.clip(0, 1)
    total_area = float(((max_u - min_u) * (max_v - min_v)).sum())  # 1 is the area of a patch
    max_cells = _MAX_ENTRIES / (total_area / light_count)
    cell_count = min(object_count, _MAX_SIDE**2, max_cells, _MAX_CELLS / patch_count)
    return max(1, int(sqrt(cell_count)))


def _fill_lists(
    rectangle: Floats, patch: Ints, side: int, patch_count: int
) -> tuple[NDArray[np.uint32], NDArray[np.uint32]]:
    """List each entry (a part of an object) in all cells that its bounding rectangle overlaps.

    A patch of directions is divided into side x side cells.  Each cell has four lists of entries.
    Which of them contains the entry depends on two things: whether the cell is in the first column
    of the entry's rectangle, and whether it is in the first row.  See `_LIST_OF_PLACE`.

    Parameters
    ----------
    rectangle : (4, entries) float array
        Minimum and maximum u, then minimum and maximum v, relative to the patch: 0 is the start of
        the patch, and 1 its end.
    patch : (entries,) int array
        Index of the patch of each entry.
    side : int
        Number of cells along each side of a patch.
    patch_count : int
        Number of patches.

    Returns
    -------
    list_start : (4 * patch_count * side**2 + 1,) int array
        Element 4 * cell + i is the position in `listed` where list i of the cell begins.
    listed : (m,) int array
        Indices of the entries in all lists, cell by cell and list by list; in ascending order
        within each list.
    """
    keys, list_start = [], np.zeros(4 * patch_count * side**2 + 1, dtype=np.uint32)
    for entry_index, cell_index, place in _find_overlaps(rectangle, patch, side):
        list_index = 4 * cell_index + _LIST_OF_PLACE.take(place)
        # `np.add.at` is twenty times as fast if the increment has the type of the array.
        np.add.at(list_start, list_index + 1, np.uint32(1))
        keys.append(list_index << 32 | entry_index)
    # Each (list, entry) pair is packed into one integer: sorting these is faster than argsort.
    sorted_keys = np.concatenate(keys)
    del keys
    sorted_keys.sort()
    list_start.cumsum(out=list_start)
    return list_start, sorted_keys.astype(np.uint32)  # the lower half of a key is the entry


def _find_overlaps(
    rectangle: Floats, patch: Ints, side: int
) -> Iterator[tuple[Ints, Ints, NDArray[np.uint8]]]:
    """Find all cells that each rectangle overlaps, and yield (rectangle, cell) pairs in batches.

    Each rectangle belongs to a patch, which is divided into side x side cells.  A part of a
    rectangle outside of the patch counts as overlapping the nearest cells of the patch.

    Parameters
    ----------
    rectangle : (4, n) float array
        Minimum and maximum u, then minimum and maximum v, relative to the patch: 0 is the start of
        the patch, and 1 its end.
    patch : (n,) int array
        Index of the patch of each rectangle.
    side : int
        Number of cells along each side of a patch.

    Yields
    ------
    rectangle_index : (k,) int array
        Index of each pair's rectangle.
    cell_index : (k,) int array
        Index of each pair's cell: (patch * side + column) * side + row.
    place : (k,) uint8 array
        Flags: `_FIRST_COLUMN` is set if the cell is in the first column that the rectangle
        overlaps, and `_FIRST_ROW` if the cell is in the first row that the rectangle overlaps.
    """
    limits = (side * rectangle).clip(0, side - 1).astype(np.intp)
    first_column, last_column, first_row, last_row = limits
    column_count, row_count = last_column - first_column + 1, last_row - first_row + 1
    for batch in batches(column_count * row_count, _CELLS_PER_BATCH):
        # A strip consists of the cells that one rectangle overlaps in one column.
        strip_rectangle, column = enumerate_ranges(column_count[batch], first_column[batch])
        strip_rectangle += batch.start
        strip_column = patch.take(strip_rectangle) * side + column
        strip_start = strip_column * side + first_row.take(strip_rectangle)
        strip_index, cell_index = enumerate_ranges(row_count.take(strip_rectangle), strip_start)
        is_first_column = column == first_column.take(strip_rectangle)
        place = (is_first_column * np.uint8(_FIRST_COLUMN)).take(strip_index)
        place |= (cell_index == strip_start.take(strip_index)) * np.uint8(_FIRST_ROW)
        yield strip_rectangle.take(strip_index), cell_index, place
