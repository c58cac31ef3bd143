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

from collections.abc import Iterator
from math import sqrt
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from tracer.arrays import Bools, Floats, Ints, Triple, batches, dot, each, expand, pick, scaled
from tracer.occluders import SLACK, Candidates, Occluders, candidates_by_kind
from tracer.outlines import box_corners, silhouette_planes
from tracer.scene import Surfaces
from tracer.visibility import Hits

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


class _Extents(NamedTuple):
    """Bounding boxes of all objects, spheres first, a little enlarged.

    Attributes
    ----------
    low, high : (3, n)
    """

    low: Floats
    high: Floats

    @classmethod
    def of(cls, occluders: Occluders) -> _Extents:
        """Gather spheres and boxes."""
        surfaces, slack = occluders.surfaces, occluders.slack
        center, radius = surfaces.center.T, surfaces.radius
        low = np.concatenate([center - radius, surfaces.min_pt.T], axis=1)
        high = np.concatenate([center + radius, surfaces.max_pt.T], axis=1)
        return cls(low - slack, high + slack)

    def from_near(self, light: Floats) -> tuple[Floats, _Extents]:
        """Where a light (3,) may be taken to be, and boxes enlarged for that: see `_FAR`."""
        low, high = self.low.min(axis=1), self.high.max(axis=1)
        middle, size = low / 2 + high / 2, (high - low).sum()
        away = light - middle
        part = _FAR * size / np.abs(away).sum()
        if not part < 1:
            return light, self
        slack = 2 * size / _FAR
        return middle + part * away, _Extents(self.low - slack, self.high + slack)

    def around(self, light: Floats) -> _Extents:
        """The same boxes seen from a light (3,)."""
        slack = _FROM_LIGHT * np.abs(light).sum()
        return _Extents(self.low - (light + slack)[:, None], self.high - (light - slack)[:, None])

    def nearest(self) -> Floats:
        """Least distances (n,) from the origin, in the 1-norm."""
        x, y, z = np.maximum(np.maximum(self.low, -self.high), 0)
        return np.asarray(x + y + z)


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
        x, y, z = to_light
        total = sum(each(np.abs, to_light)) + 2 * radius
        none = np.zeros(0, dtype=np.intp)
        balls, cells, reaches = [none], [none], [_query_bounds(*np.zeros((4, 0)))]
        for number in range(8):
            a, b, c = (-m if number >> k & 1 else m for k, m in enumerate((x, y, z)))
            ball = np.flatnonzero((a >= -radius) & (b >= -radius) & (c >= -radius))
            if not ball.size:
                continue
            middle, r = pick((a, b, c), ball), radius[ball]
            x0, y0, z0 = (np.maximum(m - r, 0) for m in middle)
            x1, y1, z1 = (m + r for m in middle)
            bounds = _octahedral((x0, y0, z0), (x1, y1, z1))
            bounds = _to_cells(bounds, self.scale[:, number], self.shift[:, number])
            west, east, north, south = np.clip(bounds, 0, self.resolution - 1).astype(np.intp)
            tall = south - north + 1
            owner, place = expand((east - west + 1) * tall)
            over, down = np.divmod(place, tall[owner])
            cell = (west[owner] + over) * self.resolution + north[owner] + down
            balls.append(ball[owner])
            cells.append(self.base[number] + cell)
            reaches.append(_query_bounds(*bounds).take(owner, axis=0))
        ball, cell = np.concatenate(balls), np.concatenate(cells)
        return total * (1 + SLACK), ball, cell, np.concatenate(reaches)

    def lengths(self, cell: Ints) -> Ints:
        """How many objects are listed in cells."""
        return self.first[cell + 1] - self.first[cell]

    def objects(self, cell: Ints, within: Bounds) -> tuple[Ints, Ints]:
        """Pairs of a place in `cell` (n,) and an object there that may meet `within` (n, 4)."""
        count = self.lengths(cell)
        owner, place = expand(count, self.first[cell])
        meet = self.bounds.take(place, axis=0) >= within.take(owner, axis=0)
        # The four answers of a row as one integer: much faster than all(axis=1).
        at = np.flatnonzero(meet.view(np.uint32) == 0x01010101)
        return owner[at], self.listed[place[at]]


def _query_bounds(left: Floats, right: Floats, top: Floats, bottom: Floats) -> Bounds:
    """Rectangles as (-right, left, -bottom, top): `_object_bounds` of what meets them are >=."""
    within = np.empty((left.size, 4), dtype=np.float32)
    within[:, 0], within[:, 1], within[:, 2], within[:, 3] = -right, left, -bottom, top
    return within


def _object_bounds(left: Floats, right: Floats, top: Floats, bottom: Floats) -> Bounds:
    """Rectangles that objects lie in, a little enlarged, as (-left, right, -top, bottom)."""
    return _query_bounds(right + _ROUNDED, left - _ROUNDED, bottom + _ROUNDED, top - _ROUNDED)


class _Octant(NamedTuple):
    """Objects of one octant, bounds in octahedral coordinates (4, n), greatest distances (1-norm).

    Bit k of the octant's number is set where the way to the light is negative
    along axis k, that is, where points lie beyond the light.
    """

    number: int
    objects: Ints
    bounds: Floats
    farthest: Floats

    @classmethod
    def of(cls, number: int, extents: _Extents) -> _Octant:
        """What reaches into an octant, given bounds seen from the light."""
        ends = [
            (low, high) if number >> k & 1 else (-high, -low)
            for k, (low, high) in enumerate(zip(extents.low, extents.high, strict=True))
        ]
        (_, x), (_, y), (_, z) = ends
        objects = np.flatnonzero((x >= 0) & (y >= 0) & (z >= 0))
        x0, y0, z0 = (np.maximum(low[objects], 0) for low, _ in ends)
        x1, y1, z1 = (high[objects] for _, high in ends)
        bounds = _octahedral((x0, y0, z0), (x1, y1, z1))
        return cls(number, objects, bounds, x1 + y1 + z1)


class _Field(NamedTuple):
    """The part of an octant that is divided into cells, and what may shade something there.

    Attributes
    ----------
    number : int
        The octant's.
    origin, size : (2,)
        In octahedral coordinates: around what is to be lit, or less, see `_crowded`.
    objects, bounds : (n,), (4, n)
        As those of `_Octant`.
    """

    number: int
    origin: Floats
    size: Floats
    objects: Ints
    bounds: Floats

    @classmethod
    def of(cls, octant: _Octant, near: Floats, seen: Bools) -> _Field | None:
        """The field of an octant, if anything in it may be `seen` (n,) and shaded.

        `near` (n,): each object's least distance to the light, in the 1-norm.
        """
        lit = np.flatnonzero(seen[octant.objects])
        if not lit.size:
            return None
        u0, u1, v0, v1 = octant.bounds
        low = np.array([u0[lit].min(), v0[lit].min()])
        high = np.array([u1[lit].max(), v1[lit].max()])
        may = np.flatnonzero(
            (near[octant.objects] <= _reach(octant, lit) * (1 + SLACK))
            & ((u0 <= high[0]) & (u1 >= low[0]) & (v0 <= high[1]) & (v1 >= low[1]))
        )
        if not may.size:
            return None
        bounds = octant.bounds[:, may]
        low, high = _crowded(bounds, low, high)
        return cls(octant.number, low, high - low, octant.objects[may], bounds)

    def covered(self) -> float:
        """How much of the field its objects cover, all together: more than 1 where they overlap."""
        u0, u1, v0, v1 = self.bounds
        (left, top), (right, bottom) = self.origin, self.origin + self.size
        wide = np.maximum(np.minimum(u1, right) - np.maximum(u0, left), 0)
        tall = np.maximum(np.minimum(v1, bottom) - np.maximum(v0, top), 0)
        return float((wide * tall).sum() / self.size.prod())


def _crowded(bounds: Floats, low: Floats, high: Floats) -> tuple[Floats, Floats]:
    """The part of a field, from `low` to `high` (2,), in which all but its largest objects lie.

    It is the whole field if that part is more than `_CROWDED`.  `bounds`: as those of `_Octant`.
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


class _Listing(NamedTuple):
    """What is listed in the cells of a field.

    Attributes
    ----------
    scale, shift : (2,)
        From octahedral coordinates to cells.
    objects, bounds : (n,), (n, 4)
        What may shade something there, and `LightBuffer.bounds`.
    cell, place : (m,)
        Pairs of a cell of the octant and an index into `objects`.
    """

    scale: Floats
    shift: Floats
    objects: Ints
    bounds: Bounds
    cell: Ints
    place: Ints


def _buffer_around(
    light: Floats, surfaces: Surfaces, extents: _Extents, seen: Bools
) -> LightBuffer:
    """Fill the cells around a light (3,); `seen` (n,): nothing else needs light."""
    light, extents = extents.from_near(light)
    around = extents.around(light)
    near = around.nearest()
    octants = (_Octant.of(number, around) for number in range(8))
    fields = [field for octant in octants if (field := _Field.of(octant, near, seen))]
    side = _side(len(surfaces), sum(field.covered() for field in fields))
    scale, shift, base = np.zeros((2, 8)), np.zeros((2, 8)), np.zeros(8, dtype=np.intp)
    none = np.zeros(0, dtype=np.intp)
    cells, places, objects, bounds = [none], [none], [none], [_query_bounds(*np.zeros((4, 0)))]
    total, before = 1, 0
    for field in fields:
        listing = _listing(field, side, light, surfaces)
        number = field.number
        scale[:, number], shift[:, number], base[number] = listing.scale, listing.shift, total
        cells.append(listing.cell + total)
        places.append(listing.place + before)
        objects.append(listing.objects)
        bounds.append(listing.bounds)
        total, before = total + side * side, before + listing.objects.size
    cell = np.concatenate(cells)
    counts = np.bincount(cell, minlength=total)
    first = np.append(0, np.cumsum(counts))
    # Sorting the pairs themselves, as one number each, is faster than finding their order.
    bits = before.bit_length()
    pairs = cell.astype(np.int64, copy=False) << bits | np.concatenate(places)
    at = (np.sort(pairs) & ((1 << bits) - 1)).astype(np.intp, copy=False)
    listed = np.concatenate(objects)[at]
    reach = np.concatenate(bounds).take(at, axis=0)
    single = np.flatnonzero(counts == 1)
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


def _side(count: int, covered: float) -> int:
    """How many cells octants have along each side, if objects cover so much of their fields."""
    wanted = min(9 * count ** (1 / 3), _SIDE_MOST)
    return max(1, int(min(wanted, sqrt(_PAIRS / covered)) if covered else wanted))


def _listing(field: _Field, side: int, light: Floats, surfaces: Surfaces) -> _Listing:
    """List objects in the cells of a field, `side` along each side."""
    scale = side / field.size
    shift = -field.origin * scale
    extent = _to_cells(field.bounds, scale, shift)
    left, right, top, bottom = np.clip(extent, 0, side - 1).astype(np.intp)
    wide, tall = right - left + 1, bottom - top + 1
    # Column by column of each object's rectangle.
    strip, column = expand(wide, left)
    part, cell = expand(tall[strip], column * side + top[strip])
    place = strip[part]
    size = wide * tall
    large = np.flatnonzero(((size > _FEW_CELLS) & (size < _MOST_CELLS * side**2))[place])
    sign = tuple(1.0 if field.number >> k & 1 else -1.0 for k in range(3))
    grid = _Grid(sign, scale, field.origin)
    kept = np.ones(cell.size, dtype=np.bool_)
    for start in range(0, large.size, _AT_ONCE):
        some = large[start : start + _AT_ONCE]
        column, row = np.divmod(cell[some], side)
        # Cells at the rim stand for all that lies beyond: no plane bounds them.
        rim = (np.minimum(column, row) == 0) | (np.maximum(column, row) == side - 1)
        kept[some] = rim | ~_apart(grid, column, row, field.objects[place[some]], light, surfaces)
    bounds = _object_bounds(*extent)
    return _Listing(scale, shift, field.objects, bounds, cell[kept], place[kept])


def _octahedral(low: Triple, high: Triple) -> Floats:
    """Least and greatest of both octahedral coordinates (4, n) of bounding boxes."""
    (x0, y0, z0), (x1, y1, z1) = low, high
    bounds = np.empty((4, x0.size))
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
    return bounds


def _to_cells(bounds: Floats, scale: Floats, shift: Floats) -> Floats:
    """Bounds (4, n) in cells, from those in octahedral coordinates."""
    result: Floats = bounds * np.repeat(scale, 2)[:, None] + np.repeat(shift, 2)[:, None]
    return result


def _reach(octant: _Octant, seen: Ints) -> Floats:
    """For each object, the distance (n,) from the light to the farthest point of any other seen.

    What begins farther away shades nothing.
    """
    far = octant.farthest[seen]
    place = int(far.argmax())
    reach = np.full(octant.objects.size, far[place])
    reach[seen[place]] = np.delete(far, place).max(initial=-np.inf)
    return reach


class _Grid(NamedTuple):
    """An octant's cells: column = (u - origin[0]) * scale[0], and so for v and rows.

    The direction at (u, v) is (sign[0] u, sign[1] v, sign[2] (1 - u - v)).
    """

    sign: tuple[float, ...]
    scale: Floats
    origin: Floats

    def direction(self, column: Floats, row: Floats) -> Triple:
        """Directions to points given in cells."""
        u, v = column / self.scale[0] + self.origin[0], row / self.scale[1] + self.origin[1]
        return self.sign[0] * u, self.sign[1] * v, self.sign[2] * (1 - u - v)

    def planes(self, normal: Triple) -> Triple:
        """Planes through the light, given by their normals, as a + b column + c row >= 0."""
        x, y, z = (n * sign for n, sign in zip(normal, self.sign, strict=True))
        u, v = self.origin.tolist()
        return x * u + y * v + z * (1 - u - v), (x - z) / self.scale[0], (y - z) / self.scale[1]


def _apart(
    grid: _Grid,
    column: Ints,
    row: Ints,
    owner: Ints,
    light: Floats,
    surfaces: Surfaces,
) -> Bools:
    """Whether a plane through the light lies between cells and objects, pair by pair.

    Tried are a box's silhouette planes, and a sphere's tangent plane towards
    the cell's centre.
    """
    apart = np.zeros(owner.size, dtype=np.bool_)
    spheres = surfaces.sphere_count

    at = np.flatnonzero(owner < spheres)
    x, y, z = (surfaces.center[owner[at]] - light).T
    length = np.sqrt(x * x + y * y + z * z)
    sine = surfaces.radius[owner[at]] / length
    m = scaled((x, y, z), 1 / length)
    middle = grid.direction(column[at].astype(float) + 0.5, row[at].astype(float) + 0.5)
    aside = each(np.subtract, middle, scaled(m, dot(middle, m)))
    square = dot(aside, aside)
    turn = np.sqrt((1 - sine * sine) / square)
    tangent = each(np.subtract, scaled(m, sine), scaled(aside, turn))
    # NaN with the light inside: not apart.  Nor with the cell so nearly towards the centre that
    # rounding turns the plane by more than the slack.
    beyond = _beyond(grid.planes(tangent), column[at], row[at])
    apart[at] = beyond & (square > _LEAST_ANGLE**2)

    at = np.flatnonzero(owner >= spheres)
    column, row = column[at], row[at]
    boxes, box = _distinct(owner[at] - spheres, len(surfaces.min_pt))
    beyond = np.zeros(at.size, dtype=np.bool_)
    low, high = surfaces.min_pt[boxes], surfaces.max_pt[boxes]
    silhouettes = silhouette_planes(box_corners(low, high, light), light, low, high)
    size = sum(each(np.abs, silhouettes))
    for plane in zip(*grid.planes(each(lambda n: n / size, silhouettes)), strict=True):
        beyond |= _beyond(pick(plane, box), column, row)
    apart[at] = beyond
    return apart


def _distinct(values: Ints, count: int) -> tuple[Ints, Ints]:
    """The distinct values, all of them below `count`, and the place of each value among them."""
    # As np.unique, which sorts: for many pairs of few boxes that takes a hundred times as long.
    there = np.zeros(count, dtype=np.bool_)
    there[values] = True
    return np.flatnonzero(there), (np.cumsum(there) - 1)[values]


def _beyond(plane: Triple, column: Ints, row: Ints) -> Bools:
    """Whether all of a cell is on the wrong side of a plane a + b column + c row >= 0."""
    a, b, c = plane
    most = a + b * column + c * row + np.maximum(b, 0) + np.maximum(c, 0)
    beyond: Bools = most < -SLACK
    return beyond


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
            asked = np.flatnonzero(facing[number])
            x, y, z = buffer.light.tolist()
            p = pick(points, asked)
            to_light = x - p[0], y - p[1], z - p[2]
            if footprint is None:
                distance, cell, within = buffer.locate(to_light)
                ball = np.arange(asked.size)
            else:
                distance, ball, cell, within = buffer.around(to_light, footprint[asked])
                distance = distance[ball]
            for at, occluder in _listed(buffer, own[asked[ball]], cell, distance, within):
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


def _listed(
    buffer: LightBuffer, own: Ints, cell: Ints, distance: Floats, within: Bounds
) -> Iterator[tuple[Ints, Ints]]:
    """Pairs of a point (n,) and another object than its own, listed in its cell and near enough.

    Yields some at a time: they are still in cache then.
    """
    # Most cells hold nothing, or the point's own object alone.
    sole = buffer.sole[cell]
    asked = np.flatnonzero((sole != _NONE) & (sole != own))
    for batch in batches(buffer.lengths(cell[asked]), _AT_ONCE):
        some = asked[batch]
        owner, occluder = buffer.objects(cell[some], within.take(some, axis=0))
        point = some[owner]
        keep = np.flatnonzero((occluder != own[point]) & (buffer.near[occluder] <= distance[point]))
        yield point[keep], occluder[keep]


def _once(point: Ints, occluder: Ints, count: int) -> tuple[Ints, Ints]:
    """Each pair (point, object) once, though they share several cells; `count`: of all objects."""
    pair = np.sort(point * count + occluder)
    return np.divmod(pair[np.diff(pair, prepend=-1) > 0], count)


def light_buffer_finder(occluders: Occluders) -> LightBufferFinder:
    """Fill the cells around all lights."""
    surfaces = occluders.surfaces
    extents, seen = _Extents.of(occluders), occluders.seen
    buffers = (_buffer_around(light, surfaces, extents, seen) for light in occluders.lights)
    return LightBufferFinder(occluders, tuple(buffers))
