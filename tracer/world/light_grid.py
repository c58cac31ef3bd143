"""A light buffer: a grid of directions around each light, with the objects that lie in each cell.

Haines and Greenberg (The light buffer, 1986) divide a cube around the light; here each octant of
directions is projected onto its face of |x| + |y| + |z| = 1 (the octahedral map of Engelhardt and
Dachsbacher, 2008).  Directions are those of ways from points to the light.  A *field* is the part
of one light's octant in which most objects lie; all fields have the same number of cells.  An
object is listed in all cells that its bounding box can touch; its *wedge*, planes through the light
along the box's edges, rules out most of what else lies in the cell.

All bounds are found by interval arithmetic.  They are valid with the light beside, on or inside an
object: they leave out only pairs that cannot meet.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product
from math import sqrt
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tracer.arrays import (
    Bools,
    Floats,
    Ints,
    batches,
    indices,
    ranges,
    run_lengths,
    segment_indices,
)
from tracer.scene.model import Surfaces

POSITION_ERROR = 1e-9
"""Bounds are widened by this much of the coordinates involved: far more than all roundings."""

# With n objects a field has sqrt(n) cells along each side, up to `_SIDE_MOST`.  Finer cells list
# less, and take longer to fill: where objects are so large that their bounds would fill more cells
# than `_PAIRS` for each light, or there are more than `_CELLS` in all, cells are larger.
_SIDE_MOST, _PAIRS, _CELLS = 320, 1 << 21, 1 << 24

# So many listed objects are tried, and so many cells are visited, at a time.
_PAIRS_AT_ONCE, _CELLS_AT_ONCE = 1 << 17, 1 << 17

# A field may leave one in so many objects beyond either of its sides.
_BEYOND = 64

# A cell has four lists, by where it is in the rectangle of an object (see `_cells`): in its first
# row, in its first corner, in its first column, and elsewhere.  These are their numbers, and from
# which list on, and before which, a ball finds all that it has not found in another cell.
_LIST = np.array([3, 2, 0, 1])
_SHARED = np.array([[1, 0, 1, 0], [2, 2, 3, 4]])

# If all fields are wider than this, wedges need no more than half of their bytes.
_NARROW = 1e-4

# More than nothing, and nothing to any distance.
_TINY = 1e-300

# Directions from a light are rounded, and points snapped to planes, by less than this part of its
# distance: little enough for suns, which see a whole scene under an angle of 1e-9 and less.
_FROM_LIGHT = 1e-13

# A light farther away than this many times the size of all objects together is taken to be no
# farther: that turns none of its rays by more than one over it.
_FAR = 2.0**22


class LightGrid(NamedTuple):
    """Lists of objects by direction from each light.

    Attributes
    ----------
    light : (3, lights, 1)
        Where each light is, or is taken to be: see `_FAR`.
    field : (8 * lights,)
        The field in octant o of light l, at o * lights + l; -1 where nothing is to be lit.
    side : int
        Cells along each side of a field.
    origin, size : (2, fields)
        Octahedral coordinates of each field's corner, and its extent.
    first : (4 * fields * side**2 + 1,)
        Where the four lists of each cell begin in `listed`: see `_LIST`.
    listed : (m,)
        Parts of objects, each in one octant of one light.
    obj : (parts,)
        The object.
    wedge : (parts, 8)
        What meets the part has a wedge (see `_octants`) no larger than this in any component.
    """

    light: Floats
    field: Ints
    side: int
    origin: Floats
    size: Floats
    first: NDArray[np.uint32]
    listed: NDArray[np.uint32]
    obj: Ints
    wedge: NDArray[np.floating[Any]]

    def query(self, middle: Floats, radius: Floats, obj: Ints, asked: Bools) -> Iterator[Ints]:
        """Objects, other than a ball's own, that may come between balls (n,) and lights.

        `asked` (lights, n): whether a light may reach any of a ball.  Yields lights, balls and
        occluders some at a time: they are still in cache then.
        """
        lights, count = asked.shape
        to_light = self.light - middle[:, None]
        octant, way, rect, wedge = _octants(to_light - radius, to_light + radius, self.field, asked)
        wedge[7] = -np.inf  # what is listed may reach beyond the ball
        wedge = wedge.T.astype(self.wedge.dtype, order="C")
        field = self.field.take(octant * lights + way // count)
        rect = _in_fields(rect, field, self.origin, self.size)
        for ball, cell, corner in _cells(rect, field, self.side):
            # A pair is found in the first of the cells that it shares.
            shared = (self.first.take(4 * cell + m.take(corner)) for m in _SHARED)
            start, stop = (m.astype(np.intp) for m in shared)
            some = indices(stop > start)
            ball, start, length = ball.take(some), start.take(some), (stop - start).take(some)
            for batch in batches(length, _PAIRS_AT_ONCE):
                which = ball[batch].repeat(length[batch])
                part = self.listed.take(ranges(start[batch], length[batch]))
                meet = self.wedge.take(part, axis=0) >= wedge.take(which, axis=0)
                # The eight answers of a row as one integer: much faster than all(axis=1).
                at = indices(meet.view(np.uint64) == 0x0101010101010101)
                occluder = self.obj.take(part.take(at))
                light, which = np.divmod(way.take(which.take(at)), count)
                kept = indices(occluder != obj.take(which))
                yield np.array([light.take(kept), which.take(kept), occluder.take(kept)])


def light_grid(
    lights: Floats, surfaces: Surfaces, position_error: Floats, lit: Bools, shades: Bools
) -> LightGrid | None:
    """Fill the grid around lights (n, 3); None if nothing can be shaded.

    `position_error` (n,): by how much points on each object may be off; `lit`, `shades` (n,):
    whether it may be seen, as nothing else needs light, and whether it may keep light from others.
    """
    if not (len(lights) and position_error.size > 1 and lit.any()):
        return None
    center, radius = surfaces.center, surfaces.radius[:, None]
    # A row for each axis, in one piece: of columns, minima take ten times as long.
    low = np.concatenate([center - radius, surfaces.min_pt]).T.copy() - position_error
    high = np.concatenate([center + radius, surfaces.max_pt]).T.copy() + position_error
    light, blur = _taken_nearer(lights, low, high)
    low, high = (light - blur) - high[:, None], (light + blur) - low[:, None]
    field = np.zeros(8 * len(lights), dtype=np.intp)
    octant, way, rect, wedge = _octants(low, high, field, np.ones((1, 1), dtype=np.bool_))
    light_of, obj = np.divmod(way, position_error.size)
    octant = octant * len(lights) + light_of
    some = indices(lit[obj])
    begin, _ = run_lengths(octant[some])
    field[:] = -1
    field[octant[some[begin]]] = np.arange(begin.size)
    parts = [_middle_part(rect[:, part]) for part in np.split(some, begin[1:])]
    origin, size = np.array(parts).transpose(1, 2, 0)
    some = indices((field[octant] >= 0) & shades[obj])
    # Rounding keeps the order, so that no bound fails.
    kind = np.float32 if size.min() > _NARROW else np.float64
    bounds = -wedge.reshape(4, 2, -1)[:, ::-1].reshape(8, -1).take(some, axis=1)
    bounds = bounds.T.astype(kind, order="C")
    number, rect, obj = field[octant[some]], rect.take(some, axis=1), obj[some]
    del low, high, octant, way, light_of, wedge  # much memory, with many objects
    rect = _in_fields(rect, number, origin, size)
    u0, u1, v0, v1 = rect.clip(0, 1)
    covered = float(((u1 - u0) * (v1 - v0)).sum()) / len(lights)
    finest = min(position_error.size, _SIDE_MOST**2, _PAIRS / covered, _CELLS / begin.size)
    side = max(1, int(sqrt(finest)))
    filled, first = [], np.zeros(4 * begin.size * side**2 + 1, dtype=np.uint32)
    for part, cell, corner in _cells(rect, number, side):
        cell = 4 * cell + _LIST.take(corner)
        np.add.at(first, cell + 1, np.uint32(1))  # of the same type: twenty times as fast
        filled.append(cell << 32 | part)
    # Sorting the pairs, as one number each, is faster than finding their order.
    pairs = np.concatenate(filled)
    del filled, rect, number
    pairs.sort()
    first.cumsum(out=first)
    return LightGrid(
        light=light,
        field=field,
        side=side,
        origin=origin,
        size=size,
        first=first,
        listed=pairs.astype(np.uint32),
        obj=obj,
        wedge=bounds,
    )


def _middle_part(rect: Floats) -> tuple[Floats, Floats]:
    """The part of a field in which nearly all of the rectangles (4, n) lie: its corner and size.

    Beside a planet all else would lie in one cell.  What is beyond is listed at the border.
    """
    beyond = rect.shape[1] // _BEYOND
    low = np.partition(rect[::2], beyond)[:, beyond]
    return low, np.partition(rect[1::2], -1 - beyond)[:, -1 - beyond] - low


def _taken_nearer(lights: Floats, low: Floats, high: Floats) -> tuple[Floats, Floats]:
    """Where lights (n, 3) may be taken to be (3, n, 1), and by how much ways to them are off.

    `low`, `high` (3, objects): bounds of the objects.  See `_FAR` and `_FROM_LIGHT`.
    """
    first, last = low.min(axis=1, keepdims=True), high.max(axis=1, keepdims=True)
    middle, size = first / 2 + last / 2, (last - first).sum()
    away = lights.T - middle
    part = _FAR * size / np.abs(away).sum(axis=0)
    light = np.where(part < 1, middle + part * away, lights.T)
    blur = _FROM_LIGHT * np.abs(light).sum(axis=0) + np.where(part < 1, 2 * size / _FAR, 0)
    return light[:, :, None], blur[:, None]


def _octants(
    low: Floats, high: Floats, field: Ints, asked: Bools
) -> tuple[Ints, Ints, Floats, Floats]:
    """Cut boxes of ways to lights by octants: bit k is set where ways are negative along axis k.

    `low`, `high` (3, lights, n): bounds of each box; `field` (8 * lights,): negative for octants of
    lights that are left out; `asked` (lights, n): False for boxes that are left out.

    Returns
    -------
    octant, way : (m,)
        Pairs of an octant and a box, light * n + index, which ascend.
    rect : (4, m)
        The part's least and greatest first octahedral coordinate, then second.
    wedge : (8, m)
        Least and, with the opposite sign, greatest a / (a + b) for the components (a, b) = (x, y),
        (y, z) and (z, x); last, the opposite of the greatest distance from the light (1-norm), and
        the least.
    """
    (x0, y0, z0), (x1, y1, z1) = low <= 0, high >= 0
    reached = [z & y & x & asked for z, y, x in product((z1, z0), (y1, y0), (x1, x0))]
    wanted = (field >= 0).reshape(8, -1, 1)
    octant, way = np.divmod(indices(np.array(reached) & wanted), low[0].size)
    ends = []
    for k in range(3):
        negative = (octant >> k & 1).astype(np.bool_)
        a, b = low[k].take(way), high[k].take(way)
        # Not 0 / 0, in boxes that only just reach the light: that would bound nothing.
        ends.append((np.maximum(np.where(negative, -b, a), 0), np.where(negative, -a, b) + _TINY))
    (a0, a1), (b0, b1), (c0, c1) = ends
    rect = np.array(
        [a0 / (a0 + (b1 + c1)), a1 / (a1 + (b0 + c0)), b0 / (b0 + (a1 + c1)), b1 / (b1 + (a0 + c0))]
    )
    rect[::2] -= _FROM_LIGHT
    rect[1::2] += _FROM_LIGHT
    wedge = np.empty((8, way.size))
    for k, (p0, p1, q0, q1) in enumerate(((a0, a1, b0, b1), (b0, b1, c0, c1), (c0, c1, a0, a1))):
        wedge[2 * k] = p0 / (p0 + q1) - _FROM_LIGHT
        wedge[2 * k + 1] = -(p1 / (p1 + q0)) - _FROM_LIGHT
    wedge[6] = -(1 + POSITION_ERROR) * (a1 + b1 + c1)
    wedge[7] = (1 - POSITION_ERROR) * (a0 + b0 + c0)
    return octant, way, rect, wedge


def _in_fields(rect: Floats, field: Ints, origin: Floats, size: Floats) -> Floats:
    """Rectangles (4, n) in units of their fields (n,), of given corners and extents (2, fields)."""
    origin, size = origin.take(field, axis=1), size.take(field, axis=1)
    return ((rect.reshape(2, 2, -1) - origin[:, None]) / size[:, None]).reshape(4, -1)


def _cells(rect: Floats, field: Ints, side: int) -> Iterator[tuple[Ints, Ints, NDArray[np.uint8]]]:
    """Cells that rectangles (4, n) reach in their fields (n,), some at a time.

    Yields rectangles, cells, and where these are in them: bit 0 is set in its first column, bit 1
    in its first row.
    """
    left, right, top, bottom = (side * rect).clip(0, side - 1).astype(np.intp)
    wide, tall = right - left + 1, bottom - top + 1
    for batch in batches(wide * tall, _CELLS_AT_ONCE):
        # Column by column of each rectangle.
        strip, column = segment_indices(wide[batch], left[batch])
        strip += batch.start
        begin = (field.take(strip) * side + column) * side + top.take(strip)
        part, cell = segment_indices(tall.take(strip), begin)
        corner = (column == left.take(strip)).view(np.uint8).take(part)
        corner |= (cell == begin.take(part)).view(np.uint8) << 1
        yield strip.take(part), cell, corner
