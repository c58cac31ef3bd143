"""Light buffers: directions around a light, in cells, each with the objects that lie there.

Haines and Greenberg (1986) divide a cube around the light; here the cells are
those of an octahedral map (Engelhardt and Dachsbacher 2008): each octant of
directions is projected onto its face of |x| + |y| + |z| = 1, where planes through
the light are straight lines.  An object is listed in the cells that its bounding
box can touch, less those that a plane through the light separates from it.  Listed
with it is the rectangle it lies in, which rules out most of a cell's points.

Rectangles are found by interval arithmetic, planes with a slack; both are valid with
the light beside, on or inside an object: they leave out only pairs that cannot meet.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from math import sqrt
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from tracer.arrays import (
    Bools,
    Floats,
    Ints,
    Triple,
    batches,
    changes,
    dot,
    each,
    equal_runs,
    expand,
    indices,
    pick,
    scaled,
)
from tracer.scene.model import Surfaces
from tracer.shadow.occluders import SLACK, Candidates, Occluders, candidates_by_kind
from tracer.shapes.silhouette import box_corners, silhouette_planes
from tracer.view.hits import Hits

__all__ = ["LightBuffer", "LightBufferFinder", "light_buffer_finder"]

# At a smaller angle between a cell and a sphere's centre, the tangent plane towards the cell is too
# uncertain.
_LEAST_ANGLE = 1e-5

# With n objects an octant has 9 cbrt(n) cells along each side, up to `_SIDE_MOST`.  Finer cells
# list less, and take longer to fill: where objects are so large that their bounds would fill more
# cells, in all and for one light, than `_PAIRS`, cells are larger.
_SIDE_MOST = 320
_PAIRS = 1 << 21

# So many pairs are tried at a time.
_AT_ONCE = 1 << 17

# If an object's bounding box touches no more cells than this, or at least this part of all, planes
# would separate hardly any of them from the object: none is tried.
_FEW_CELLS, _MOST_CELLS = 12, 0.5

# Bounds in cells are float32, widened by more than that rounds.
_ROUNDED = 1e-4

# What is seen from a light is rounded, and snapped to planes, by less than this part of its
# distance: little enough for suns, which see a whole scene under an angle of 1e-9 and less.
_FROM_LIGHT = 1e-13

# A light farther away than this many times the size of all objects together is taken to be no
# farther: that turns none of its rays by more than one over it.
_FAR = 2.0**22

# If all but the largest objects of a field lie in so small a part of it, along either side, cells
# divide that part: beside a planet all else would lie in one.  What is beyond is listed at the rim.
_CROWDED = 1 / 32

_NONE, _MANY = -1, -2

Bounds: TypeAlias = NDArray[np.float32]
"""Rectangles of an octant's cells, (n, 4); see `_query_bounds` and `_object_bounds`."""


class LightBuffer(NamedTuple):
    """Lists of objects, by direction from a light.

    Attributes
    ----------
    light : (3,)
        Where the light is, or is taken to be: see `_FAR`.
    resolution : int
        Cells along each side of an octant.
    scale, shift : (2, 8)
        From octahedral coordinates to cells, per octant.
    base : (8,)
        Each octant's first cell.  Where nothing needs light it is 0, and so are scale and shift:
        every point falls into cell 0, which is empty.
    first : (cells + 1,)
        Where each cell's list begins in `listed`.
    listed : (m,)
        Objects.
    bounds : (m, 4)
        How far each reaches in its octant, in cells: see `_object_bounds`.
    sole : (cells,)
        The only object in a cell; `_MANY` or `_NONE`.
    near : (n,)
        Each object's least distance to the light, in the 1-norm.
    """

    light: Floats
    resolution: int
    scale: Floats
    shift: Floats
    base: Ints
    first: Ints
    listed: Ints
    bounds: Bounds
    sole: Ints
    near: Floats

    def locate(self, to_light: Triple) -> tuple[Floats, Ints, Bounds]:
        """Points' distances from the light (1-norm), their cells, and bounds to ask for there."""
        x, y, z = each(np.abs, to_light)
        total = x + y + z
        inverse = 1 / total
        octant = (to_light[0] < 0) + 2 * (to_light[1] < 0) + 4 * (to_light[2] < 0)
        i = x * inverse * self.scale[0][octant] + self.shift[0][octant]
        j = y * inverse * self.scale[1][octant] + self.shift[1][octant]
        # A point in the light itself is in no direction: any cell will do.
        last = self.resolution - 1
        column = np.fmin(np.fmax(i, 0), last).astype(np.intp)
        row = np.fmin(np.fmax(j, 0), last).astype(np.intp)
        cell = self.base[octant] + column * self.resolution + row
        return total * (1 + SLACK), cell, _query_bounds(i, i, j, j)

    def around(self, to_light: Triple, radius: Floats) -> tuple[Floats, Ints, Ints, Bounds]:
        """Balls' greatest distances (1-norm), pairs of ball and cell it reaches, and bounds."""
        low, high = each(lambda m: m - radius, to_light), each(lambda m: m + radius, to_light)
        balls, cells, reaches = [], [], []
        for number in range(8):
            ball, bounds, _ = _in_octant(number, low, high)
            bounds = _to_cells(bounds, self.scale[:, number], self.shift[:, number])
            part, cell, _ = _cells(bounds, self.resolution)
            balls.append(ball[part])
            cells.append(self.base[number] + cell)
            reaches.append(_query_bounds(*bounds).take(part, axis=0))
        total = sum(each(np.abs, to_light)) + 2 * radius
        ball, cell = np.concatenate(balls), np.concatenate(cells)
        return total * (1 + SLACK), ball, cell, np.concatenate(reaches)

    def others(
        self, own: Ints, distance: Floats, cell: Ints, within: Bounds
    ) -> Iterator[tuple[Ints, Ints]]:
        """Pairs of a point (n,) and another object than its own, listed in its cell, near enough.

        Yields some at a time: they are still in cache then.
        """
        # Most cells hold nothing, or the point's own object alone.
        sole = self.sole[cell]
        asked = indices((sole != _NONE) & (sole != own))
        first = self.first[cell[asked]]
        length = self.first[cell[asked] + 1] - first
        for batch in batches(length, _AT_ONCE):
            part, place = expand(length[batch], first[batch])
            point = asked[batch][part]
            meet = self.bounds.take(place, axis=0) >= within.take(point, axis=0)
            # The four answers of a row as one integer: much faster than all(axis=1).
            at = indices(meet.view(np.uint32) == 0x01010101)
            point, occluder = point[at], self.listed[place[at]]
            keep = indices((occluder != own[point]) & (self.near[occluder] <= distance[point]))
            yield point[keep], occluder[keep]


class LightBufferFinder(NamedTuple):
    """Finds what may shade points by the cells they lie in.

    Attributes
    ----------
    occluders : Occluders
    buffers : tuple of LightBuffer
        Around each light.
    """

    occluders: Occluders
    buffers: tuple[LightBuffer, ...]

    def candidates(
        self, hits: Hits, facing: Bools, dark: Bools, footprint: Floats | None = None
    ) -> Iterator[Candidates]:
        """See `Finder.candidates`; `dark` is left as it is."""
        own = hits.own
        points = hits.points(slice(None))
        for number, buffer in enumerate(self.buffers):
            asked = indices(facing[number])
            x, y, z = buffer.light.tolist()
            p = pick(points, asked)
            to_light = x - p[0], y - p[1], z - p[2]
            if footprint is None:
                distance, cell, within = buffer.locate(to_light)
                ball = np.arange(asked.size)
            else:
                distance, ball, cell, within = buffer.around(to_light, footprint[asked])
                distance = distance[ball]
            for at, occluder in buffer.others(own[asked[ball]], distance, cell, within):
                point = asked[ball[at]]
                if footprint is not None:
                    point, occluder = _once(point, occluder, len(buffer.near))
                yield from candidates_by_kind(
                    self.occluders,
                    own=own,
                    points=points,
                    point=point,
                    light=number,
                    occluder=occluder,
                    footprint=footprint,
                )


def light_buffer_finder(occluders: Occluders) -> LightBufferFinder:
    """Fill the cells around all lights."""
    surfaces, slack = occluders.surfaces, occluders.slack
    center, radius = surfaces.center, surfaces.radius[:, None]
    # A row for each axis, in one piece: of columns, minima take ten times as long.
    low = np.concatenate([center - radius, surfaces.min_pt]).T.copy() - slack
    high = np.concatenate([center + radius, surfaces.max_pt]).T.copy() + slack
    seen = occluders.view.frames.in_picture(occluders.view.raster)
    buffers = (_buffer_around(light, low, high, surfaces, seen) for light in occluders.lights)
    return LightBufferFinder(occluders, tuple(buffers))


def _buffer_around(
    light: Floats, low: Floats, high: Floats, surfaces: Surfaces, seen: Bools
) -> LightBuffer:
    """Fill the cells around a light (3,); `seen` (n,): nothing else needs light."""
    light, low, high = _from_near(light, low, high)
    # From here on, bounds of the ways to the light.
    slack = _FROM_LIGHT * np.abs(light).sum()
    low, high = (light - slack)[:, None] - high, (light + slack)[:, None] - low
    near = np.maximum(np.maximum(low, -high), 0).sum(axis=0)
    fields = [field for number in range(8) if (field := _Field.of(number, low, high, near, seen))]
    side = _side(len(surfaces), sum(field.covered() for field in fields))
    scale, shift, base = np.zeros((2, 8)), np.zeros((2, 8)), np.zeros(8, dtype=np.intp)
    none = np.zeros(0, dtype=np.intp)
    cells, places, objects, bounds = [none], [none], [none], [_query_bounds(*np.zeros((4, 0)))]
    total, before = 1, 0
    for field in fields:
        number, to_cells = field.number, field.in_cells(side)
        scale[:, number], shift[:, number], base[number] = *to_cells, total
        extent = _to_cells(field.bounds, *to_cells)
        cell, place = field.listed(extent, side, light, surfaces)
        cells.append(cell + total)
        places.append(place + before)
        objects.append(field.objects)
        bounds.append(_object_bounds(*extent))
        total, before = total + side * side, before + field.objects.size
    cell = np.concatenate(cells)
    counts = np.bincount(cell, minlength=total)
    first = np.append(0, counts.cumsum())
    # Sorting the pairs themselves, as one number each, is faster than finding their order.
    bits = before.bit_length()
    pairs = cell.astype(np.int64, copy=False) << bits | np.concatenate(places)
    at = (np.sort(pairs) & ((1 << bits) - 1)).astype(np.intp, copy=False)
    listed = np.concatenate(objects)[at]
    reach = np.concatenate(bounds).take(at, axis=0)
    single = indices(counts == 1)
    sole = np.where(counts == 0, _NONE, _MANY)
    sole[single] = listed[first[single]]
    return LightBuffer(
        light=light,
        resolution=side,
        scale=scale,
        shift=shift,
        base=base,
        first=first,
        listed=listed,
        bounds=reach,
        sole=sole,
        near=near * (1 - SLACK),
    )


def _from_near(light: Floats, low: Floats, high: Floats) -> tuple[Floats, Floats, Floats]:
    """Where a light (3,) may be taken to be, and boxes (3, n) enlarged for that: see `_FAR`."""
    first, last = low.min(axis=1), high.max(axis=1)
    middle, size = first / 2 + last / 2, (last - first).sum()
    away = light - middle
    part = _FAR * size / np.abs(away).sum()
    if not part < 1:
        return light, low, high
    slack = 2 * size / _FAR
    return middle + part * away, low - slack, high + slack


def _side(count: int, covered: float) -> int:
    """How many cells octants have along each side, if objects cover so much of their fields."""
    wanted = min(9 * count ** (1 / 3), _SIDE_MOST)
    return max(1, int(min(wanted, sqrt(_PAIRS / covered)) if covered else wanted))


class _Field(NamedTuple):
    """The part of an octant that is divided into cells, and what may shade something there.

    The direction at octahedral coordinates (u, v), from a point to the light, has the size
    (u, v, 1 - u - v), and signs as the octant's number says: see `_in_octant`.

    Attributes
    ----------
    number : int
        The octant's.
    origin, size : (2,)
        In octahedral coordinates: around what is to be lit, or less, see `_crowded`.
    objects, bounds : (n,), (4, n)
        What may shade something, and its octahedral coordinates.
    """

    number: int
    origin: Floats
    size: Floats
    objects: Ints
    bounds: Floats

    @classmethod
    def of(cls, number: int, low: Floats, high: Floats, near: Floats, seen: Bools) -> _Field | None:
        """The field of an octant, if anything in it may be `seen` (n,) and shaded.

        `low`, `high`: see `_in_octant`; `near` (n,): each object's least distance to the light, in
        the 1-norm.
        """
        objects, bounds, farthest = _in_octant(number, low, high)
        lit = indices(seen[objects])
        if not lit.size:
            return None
        u0, u1, v0, v1 = bounds
        first = np.array([u0[lit].min(), v0[lit].min()])
        last = np.array([u1[lit].max(), v1[lit].max()])
        # What begins farther away than any other object seen reaches shades nothing.
        far = farthest[lit]
        place = int(far.argmax())
        reach = np.full(objects.size, far[place])
        reach[lit[place]] = np.delete(far, place).max(initial=-np.inf)
        may = indices(
            (near[objects] <= reach * (1 + SLACK))
            & ((u0 <= last[0]) & (u1 >= first[0]) & (v0 <= last[1]) & (v1 >= first[1]))
        )
        if not may.size:
            return None
        bounds = bounds[:, may]
        first, last = _crowded(bounds, first, last)
        return cls(number, first, last - first, objects[may], bounds)

    def in_cells(self, side: int) -> tuple[Floats, Floats]:
        """Scale and shift (2,) from octahedral coordinates to `side` x `side` cells."""
        scale = side / self.size
        return scale, -self.origin * scale

    def covered(self) -> float:
        """How much of the field its objects cover, all together: more than 1 where they overlap."""
        u0, u1, v0, v1 = np.clip(_to_cells(self.bounds, *self.in_cells(1)), 0, 1)
        return float(((u1 - u0) * (v1 - v0)).sum())

    def listed(
        self, extent: Floats, side: int, light: Floats, surfaces: Surfaces
    ) -> tuple[Ints, Ints]:
        """Pairs of a cell, of `side` x `side`, and a place in `objects`; `extent`: all in cells."""
        place, cell, count = _cells(extent, side)
        tried = indices(((count > _FEW_CELLS) & (count < _MOST_CELLS * side**2))[place])
        kept = np.ones(cell.size, dtype=np.bool_)
        for start in range(0, tried.size, _AT_ONCE):
            some = tried[start : start + _AT_ONCE]
            column, row = np.divmod(cell[some], side)
            # Cells at the rim stand for all that lies beyond: no plane bounds them.
            rim = (np.minimum(column, row) == 0) | (np.maximum(column, row) == side - 1)
            owner = self.objects[place[some]]
            kept[some] = rim | ~self._apart(column, row, side, owner, light, surfaces)
        return cell[kept], place[kept]

    def _apart(
        self, column: Ints, row: Ints, side: int, owner: Ints, light: Floats, surfaces: Surfaces
    ) -> Bools:
        """Whether a plane through the light lies between cells and objects, pair by pair.

        Tried are a sphere's tangent plane towards the cell's centre, and a box's silhouette planes.
        `owner` ascends: spheres, then boxes.
        """
        sign = np.array([1.0 if self.number >> k & 1 else -1.0 for k in range(3)])
        wide, tall = (self.size / side).tolist()
        u, v = self.origin[0] + column * wide, self.origin[1] + row * tall

        def beyond(normal: Triple, u: Floats, v: Floats) -> Bools:
            """Whether all of a cell is on the wrong side of a plane with this normal."""
            x, y, z = normal
            b, c = x - z, y - z
            most = z + b * u + c * v + np.maximum(b, 0) * wide + np.maximum(c, 0) * tall
            outside: Bools = most < -SLACK
            return outside

        n = owner.searchsorted(surfaces.sphere_count)
        across, down = u[:n] + wide / 2, v[:n] + tall / 2
        center = ((surfaces.center[owner[:n]] - light) * sign).T
        tangent = _tangent_plane(
            (center[0], center[1], center[2]),
            surfaces.radius[owner[:n]],
            (across, down, 1 - across - down),
        )
        spheres = beyond(tangent, u[:n], v[:n])

        first, count = equal_runs(owner[n:])
        box = owner[n:][first] - surfaces.sphere_count
        low, high = surfaces.min_pt[box], surfaces.max_pt[box]
        silhouettes, _ = silhouette_planes(box_corners(low, high, light), light, low, high)
        size = sum(each(np.abs, silhouettes))
        boxes = np.zeros(u.size - n, dtype=np.bool_)
        normals = (s * normal / size for s, normal in zip(sign, silhouettes, strict=True))
        for plane in zip(*normals, strict=True):
            x, y, z = (component.repeat(count) for component in plane)
            boxes |= beyond((x, y, z), u[n:], v[n:])
        return np.append(spheres, boxes)


def _crowded(bounds: Floats, low: Floats, high: Floats) -> tuple[Floats, Floats]:
    """The part of a field, from `low` to `high` (2,), in which all but its largest objects lie.

    It is the whole field if that part is more than `_CROWDED`.  `bounds`: see `_Field`.
    """
    wide, tall = bounds[1] - bounds[0], bounds[3] - bounds[2]
    while True:
        size = high - low
        u0, u1, v0, v1 = bounds[:, (wide < size[0] / 2) & (tall < size[1] / 2)]
        if not u0.size:
            return low, high
        inner = np.maximum(low, (u0.min(), v0.min()))
        outer = np.minimum(high, (u1.max(), v1.max()))
        part = (outer - inner) / size
        if part.min() <= 0 or part.min() > _CROWDED:
            return low, high
        low, high = inner, outer


def _tangent_plane(center: Triple, radius: Floats, towards: Triple) -> Triple:
    """Normals of planes through the origin that touch spheres on the side of some directions.

    NaN with the origin inside, or a direction so nearly towards the centre that rounding turns the
    plane by more than the slack.
    """
    length = np.sqrt(dot(center, center))
    sine, m = radius / length, scaled(center, 1 / length)
    aside = each(np.subtract, towards, scaled(m, dot(towards, m)))
    square = dot(aside, aside)
    square[square <= _LEAST_ANGLE**2] = np.nan
    turn = np.sqrt((1 - sine * sine) / square)
    return each(np.subtract, scaled(m, sine), scaled(aside, turn))


def _in_octant(
    number: int, low: Iterable[Floats], high: Iterable[Floats]
) -> tuple[Ints, Floats, Floats]:
    """What reaches into an octant, of all whose ways to the light are from `low` to `high`.

    Which of them, their octahedral coordinates there (least and greatest of both, (4, n)), and
    their greatest distances from the light (1-norm).  Bit k of the octant's number is set where
    ways to the light are negative along axis k.
    """
    ends = [
        (-most, -least) if number >> k & 1 else (least, most)
        for k, (least, most) in enumerate(zip(low, high, strict=True))
    ]
    (_, x), (_, y), (_, z) = ends
    some = indices((x >= 0) & (y >= 0) & (z >= 0))
    x0, y0, z0 = (np.maximum(least[some], 0) for least, _ in ends)
    x1, y1, z1 = (most[some] for _, most in ends)
    bounds = np.empty((4, some.size))
    np.divide(x0, x0 + (y1 + z1), out=bounds[0])
    np.divide(x1, x1 + (y0 + z0), out=bounds[1])
    np.divide(y0, y0 + (x1 + z1), out=bounds[2])
    np.divide(y1, y1 + (x0 + z0), out=bounds[3])
    # 0 / 0, in boxes that only just reach the light, bounds nothing: all of the octant.
    whole = np.array([[0.0], [1.0], [0.0], [1.0]])
    around = np.isnan(bounds)
    if around.any():
        bounds = np.where(around, whole, bounds)
    bounds += _FROM_LIGHT * (2 * whole - 1)
    return some, bounds, x1 + y1 + z1


def _to_cells(bounds: Floats, scale: Floats, shift: Floats) -> Floats:
    """Bounds (4, n) in cells, from those in octahedral coordinates."""
    result: Floats = bounds * scale.repeat(2)[:, None] + shift.repeat(2)[:, None]
    return result


def _cells(bounds: Floats, side: int) -> tuple[Ints, Ints, Ints]:
    """Pairs of a rectangle (4, n) and a cell of `side` x `side` it reaches; cells of each."""
    left, right, top, bottom = bounds.clip(0, side - 1).astype(np.intp)
    wide, tall = right - left + 1, bottom - top + 1
    # Column by column of each rectangle.
    strip, column = expand(wide, left)
    part, cell = expand(tall[strip], column * side + top[strip])
    return strip[part], cell, wide * tall


def _query_bounds(left: Floats, right: Floats, top: Floats, bottom: Floats) -> Bounds:
    """Rectangles as (-right, left, -bottom, top): `_object_bounds` of what meets them are >=."""
    within = np.empty((left.size, 4), dtype=np.float32)
    within[:, 0], within[:, 1], within[:, 2], within[:, 3] = -right, left, -bottom, top
    return within


def _object_bounds(left: Floats, right: Floats, top: Floats, bottom: Floats) -> Bounds:
    """Rectangles that objects lie in, a little enlarged, as (-left, right, -top, bottom)."""
    return _query_bounds(right + _ROUNDED, left - _ROUNDED, bottom + _ROUNDED, top - _ROUNDED)


def _once(point: Ints, occluder: Ints, count: int) -> tuple[Ints, Ints]:
    """Each pair (point, object) once, though they share several cells; `count`: of all objects."""
    pair = np.sort(point * count + occluder)
    return np.divmod(pair[changes(pair)], count)
