"""Which points the lights reach.

All shadow segments end at a light, so an object can only block those that pass
it on their way.  That is decided from coarse to fine, by one test: for whole
objects, for tiles of the picture, for stretches of neighbouring points, each in
a ball; the segments from a ball to the light lie in a capsule, which an object
misses, meets or cuts.  What it only meets goes to the exact test, point by point.

With more objects than can be tried against each other, those that a point may
meet are listed by cells of direction around the light instead.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tracer.cells import NONE, Cells, Extents, list_objects
from tracer.groups import Bools, Triple, dot, each, expand, pick, runs
from tracer.intersection import (
    INSIDE,
    ON,
    OUTSIDE,
    SURFACE_TOLERANCE,
    box_and_capsule,
    box_blocks,
    sphere_and_capsule,
    sphere_blocks,
    sphere_crosses,
    sphere_side,
)
from tracer.pencil import box_corners, silhouette_planes
from tracer.scene import Floats, Ints, Surfaces
from tracer.visibility import Hits, View

__all__ = ["Occluders", "Shadows", "occluders_of", "shadows_of"]

# Objects are tried against each other where each has so many samples, and they are not too many.
_SAMPLES_EACH, _MOST = 1000, 1024

# Pairs of objects that are tried at a time.
_PAIRS = 1 << 17

# Points in a stretch at most, coarse and fine, and pixels along the sides of a tile.
_LONG, _SHORT, _TILE = 32, 8, 32

# Pairs of a stretch and an object that are tried at a time.
_BATCH = 1 << 15

# Balls are larger by so much of all sizes around: far more than all roundings.
_SLACK = 1e-9


class Occluders(NamedTuple):
    """All surfaces, spheres first, as whatever may cast a shadow.

    Attributes
    ----------
    surfaces : Surfaces
    eye : (3,)
    eye_inside, seen : (n,)
        Which of them are seen from inside, and which may be seen at all.
    middle, radius : three (n,) and (n,)
        A ball around each.
    size : (n,)
        What a point's tolerance at each object scales with.
    slack : (n,)
        More than rounding displaces a point on each object.
    """

    surfaces: Surfaces
    eye: Floats
    eye_inside: Bools
    seen: Bools
    middle: Triple
    radius: Floats
    size: Floats
    slack: Floats


class _Balls(NamedTuple):
    """Stretches of neighbouring points of one object, each in a ball.

    Attributes
    ----------
    owner : (m,)
        The object.
    start, length : (m,)
        The points.
    middle, radius : three (m,) and (m,)
    """

    owner: Ints
    start: Ints
    length: Ints
    middle: Triple
    radius: Floats

    def take(self, index: Ints) -> _Balls:
        """Some of them."""
        return _Balls(
            self.owner[index],
            self.start[index],
            self.length[index],
            pick(self.middle, index),
            self.radius[index],
        )


class _Pairs(NamedTuple):
    """Balls, each with a light and an object that may come between: all spheres, or all boxes."""

    balls: _Balls
    light: Ints
    other: Ints

    def points(self) -> tuple[Ints, Ints, Ints]:
        """All points of all balls, with their light and object."""
        count = self.balls.length
        return (
            runs(self.balls.start, count),
            np.repeat(self.light, count),
            np.repeat(self.other, count),
        )


class _Lists(NamedTuple):
    """Which spheres, or which boxes, may keep each light from each object.

    Attributes
    ----------
    spheres : bool
    first, listed : (lights * n + 1,) and (m,)
        For light l and object i: listed[first[l * n + i]:first[l * n + i + 1]].
    """

    spheres: bool
    first: Ints
    listed: Ints


class Shadows(NamedTuple):
    """What may keep lights from points.

    Attributes
    ----------
    occluders : Occluders
    lights : (3, lights)
    side : (lights, n)
        Where each light is to each sphere: `OUTSIDE`, `ON` or `INSIDE`; to
        each box `INSIDE`, or else `ON`.
    lists : tuple of _Lists
        For the spheres and for the boxes.
    cells : tuple of Cells
        Around each light: they take the place of the lists.
    """

    occluders: Occluders
    lights: Floats
    side: NDArray[np.int8]
    lists: tuple[_Lists, ...]
    cells: tuple[Cells, ...]

    def blocked(self, hits: Hits, facing: Bools) -> Bools:
        """Whether other objects than their own keep lights from points that face them.

        `facing` and the answer: (lights, n); it is of no meaning where they do not face.
        """
        dark = np.zeros(facing.shape, dtype=np.bool_)
        blocked = np.zeros(facing.shape, dtype=np.bool_)
        for pairs in self._pairs(hits, facing, dark):
            point, light, other = pairs.points()
            blocks = np.flatnonzero(self._blocks(hits, pairs, point, light, other))
            blocked[light[blocks], point[blocks]] = True
        return blocked | dark

    def edges(
        self, hits: Hits, facing: Bools, footprint: Floats
    ) -> tuple[Bools, tuple[Ints, Ints, Ints]]:
        """`blocked`, and where it may change within a distance (n,) of a point.

        That is a point, a light and an object that blocks when it is larger by
        as much, and does not when smaller by as much; unless another blocks,
        too, when smaller.
        """
        blocked, solid, dark = np.zeros((3, *facing.shape), dtype=np.bool_)
        none = np.zeros(0, dtype=np.intp)
        found = [(none, none, none)]
        for pairs in self._pairs(hits, facing, dark, footprint):
            point, light, other = pairs.points()
            may = np.flatnonzero(self._blocks(hits, pairs, point, light, other, footprint[point]))
            point, light, other = point[may], light[may], other[may]
            if not may.size:
                continue
            pairs = self._pairs_of_points(hits, point, light, other, footprint)
            does = self._blocks(hits, pairs, point, light, other)
            must = self._blocks(hits, pairs, point, light, other, -footprint[point])
            blocked[light[does], point[does]] = True
            solid[light[must], point[must]] = True
            edge = np.flatnonzero(~must & facing[light, point])
            found.append((point[edge], light[edge], other[edge]))
        point, light, other = (np.concatenate(m) for m in zip(*found, strict=True))
        seen = np.flatnonzero(~(solid | dark)[light, point])
        return blocked | dark, (point[seen], light[seen], other[seen])

    def _pairs(
        self, hits: Hits, facing: Bools, dark: Bools, footprint: Floats | None = None
    ) -> Iterator[_Pairs]:
        """Stretches of points and what may shade them: spheres, then boxes.

        With a footprint (n,): what may shade anything so near to a point.
        Sets `dark` (lights, n) where a shadow is certain, and leaves that out.
        """
        if self.cells:
            yield from self._pairs_in_cells(hits, facing, footprint)
            return
        start, count, run = _cut(hits.first[:-1], np.diff(hits.first), _LONG)
        if not (start.size and self.lists):
            return
        balls = self._balls(hits, hits.owner[run], start, count)
        margin = np.zeros(start.size)
        if footprint is not None:
            margin = np.maximum.reduceat(footprint, start)
        balls.radius[:] += margin
        asked = np.logical_or.reduceat(facing, start, axis=1)
        tiles = _tiles(hits, balls, run)
        objects, tile_count = self.side.shape[1], tiles.owner.size
        # Every tile for every light.
        key = np.add.outer(np.arange(len(facing)) * objects, tiles.owner).ravel()
        for kind in self.lists:
            first = kind.first[key]
            place, rest = expand(kind.first[key + 1] - first)
            other = kind.listed[first[place] + rest]
            light, tile = np.divmod(place, tile_count)
            may, _ = self._near(kind, pick(tiles.middle, tile), tiles.radius[tile], light, other)
            near = np.flatnonzero(may)
            for batch in _batches(tiles.length[tile[near]]):
                at = near[batch]
                pair, rest = expand(tiles.length[tile[at]])
                stretch = tiles.order[tiles.first[tile[at]][pair] + rest]
                pairs = self._sifted(
                    kind,
                    hits,
                    balls,
                    margin,
                    asked,
                    dark,
                    stretch,
                    light[at][pair],
                    other[at][pair],
                )
                if pairs.other.size:
                    yield pairs

    def _sifted(
        self,
        kind: _Lists,
        hits: Hits,
        balls: _Balls,
        margin: Floats,
        asked: Bools,
        dark: Bools,
        stretch: Ints,
        light: Ints,
        other: Ints,
    ) -> _Pairs:
        """Stretches, each with a light and an object: short ones of them, neither lit nor dark."""
        some = np.flatnonzero(asked[light, stretch])
        stretch, light, other = stretch[some], light[some], other[some]
        may, cut = self._near(
            kind, pick(balls.middle, stretch), balls.radius[stretch], light, other
        )
        asked[light[cut], stretch[cut]] = False
        _mark(dark, light[cut], balls.start[stretch[cut]], balls.length[stretch[cut]])
        near = np.flatnonzero(may & asked[light, stretch])
        stretch, light, other = stretch[near], light[near], other[near]
        start, count, parent = _cut(balls.start[stretch], balls.length[stretch], _SHORT)
        stretch, light, other = stretch[parent], light[parent], other[parent]
        short = self._balls(hits, balls.owner[stretch], start, count)
        short.radius[:] += margin[stretch]
        may, cut = self._near(kind, short.middle, short.radius, light, other)
        _mark(dark, light[cut], start[cut], count[cut])
        near = np.flatnonzero(may & ~dark[light, start])
        return _Pairs(short.take(near), light[near], other[near])

    def _balls(self, hits: Hits, owner: Ints, start: Ints, count: Ints) -> _Balls:
        """Put balls around stretches of points of some objects."""
        # The points of a row lie on a line, or on an arc of less than half a circle.
        a, b = _rows(hits.p, start), _rows(hits.p, start + count - 1)
        middle = each(lambda a, b: 0.5 * (a + b), a, b)
        across = each(np.subtract, b, a)
        radius = 0.5 * np.sqrt(dot(across, across))
        spheres = len(self.occluders.surfaces.radius)
        if self.occluders.eye_inside[:spheres].any():
            # Seen from inside, an arc may be longer.
            inside = np.flatnonzero(self.occluders.eye_inside[owner] & (owner < spheres))
            for m, c in zip(middle, self.occluders.middle, strict=True):
                m[inside] = c[owner[inside]]
            radius[inside] = self.occluders.radius[owner[inside]]
        return _Balls(owner, start, count, middle, radius + self.occluders.slack[owner])

    def _near(
        self, kind: _Lists, middle: Triple, radius: Floats, light: Ints, other: Ints
    ) -> tuple[Bools, Bools]:
        """Whether objects may come between balls and lights, and whether they surely do."""
        surfaces = self.occluders.surfaces
        x, y, z = self.lights
        end = x[light], y[light], z[light]
        if kind.spheres:
            center = _columns(surfaces.center, other)
            return sphere_and_capsule(middle, end, radius, center, surfaces.radius[other])
        box = other - len(surfaces.radius)
        low, high = _columns(surfaces.min_pt, box), _columns(surfaces.max_pt, box)
        return box_and_capsule(middle, end, radius, low, high)

    def _blocks(
        self,
        hits: Hits,
        pairs: _Pairs,
        point: Ints,
        light: Ints,
        other: Ints,
        larger: Floats | None = None,
    ) -> Bools:
        """Whether objects keep lights from points: those of `pairs`, one by one.

        `larger` (n,) is added to the objects' sizes on all sides.
        """
        surfaces, spheres = self.occluders.surfaces, len(self.occluders.surfaces.radius)
        count = pairs.balls.length
        p = _rows(hits.p, point)
        end = each(lambda c: np.repeat(c, count), _rows(self.lights, pairs.light))
        if pairs.other[0] >= spheres:
            box = pairs.other - spheres
            low, high = (
                each(lambda c: np.repeat(c, count), _columns(corner, box))
                for corner in (surfaces.min_pt, surfaces.max_pt)
            )
            if larger is not None:
                low, high = each(lambda c: c - larger, low), each(lambda c: c + larger, high)
            blocks = box_blocks(p, end, low, high)
            # Ends that may be on a face's plane are looked at more closely.
            at = np.flatnonzero(np.repeat(self._on_planes(pairs), count))
            if at.size:
                blocks[at] = box_blocks(
                    pick(p, at),
                    pick(end, at),
                    pick(low, at),
                    pick(high, at),
                    self._tolerance(pick(p, at), light[at], other[at]),
                )
            if larger is not None:
                # A box smaller than nothing is none.
                blocks &= (low[0] <= high[0]) & (low[1] <= high[1]) & (low[2] <= high[2])
            return blocks
        to_light = each(np.subtract, end, p)
        center = _columns(surfaces.center, pairs.other)
        to_center = each(lambda c, p: np.repeat(c, count) - p, center, p)
        radius = np.repeat(surfaces.radius[pairs.other], count)
        if larger is not None:
            radius = np.maximum(radius + larger, 0)
        blocks = sphere_crosses(to_light, to_center, radius)
        # Ends that may be in or on a sphere are looked at more closely.
        aside = each(np.subtract, pairs.balls.middle, center)
        reach = surfaces.radius[pairs.other] + pairs.balls.radius
        closely = self.side[pairs.light, pairs.other] != OUTSIDE
        closely |= dot(aside, aside) <= reach * reach
        at = np.flatnonzero(np.repeat(closely, count))
        if at.size:
            ball = other[at]
            distance = np.sqrt(dot(pick(to_center, at), pick(to_center, at)))
            closely = distance <= radius[at] * (1 + _SLACK) + self.occluders.slack[ball]
            at = at[closely | (self.side[light[at], ball] != OUTSIDE)]
            ball = other[at]
            blocks[at] = sphere_blocks(
                pick(to_light, at),
                pick(to_center, at),
                radius[at],
                self._tolerance(pick(p, at), light[at], ball),
                self.side[light[at], ball],
                self.occluders.eye_inside[ball],
            )
        return blocks

    def _on_planes(self, pairs: _Pairs) -> Bools:
        """Whether balls, or their lights, touch the plane of a face of their boxes."""
        surfaces = self.occluders.surfaces
        box = pairs.other - len(surfaces.radius)
        slack = self.occluders.slack[pairs.other]
        result = np.zeros(box.size, dtype=np.bool_)
        for k, (middle, light) in enumerate(zip(pairs.balls.middle, self.lights, strict=True)):
            end = light[pairs.light]
            for corner in (surfaces.min_pt, surfaces.max_pt):
                plane = corner[box, k]
                result |= np.abs(middle - plane) <= pairs.balls.radius
                result |= np.abs(end - plane) <= slack + _SLACK * np.abs(end)
        return result

    def _tolerance(self, p: Triple, light: Ints, other: Ints) -> Floats:
        """How near to an object the ends of a segment count as on it, pair by pair."""
        x, y, z = self.occluders.eye.tolist()
        ray = p[0] - x, p[1] - y, p[2] - z
        reach: Floats = np.sqrt(dot(ray, ray)) + sum(each(np.abs, p))
        at_light = np.abs(self.lights).sum(axis=0)[light]
        reach = np.where(self.side[light, other] == ON, np.maximum(reach, at_light), reach)
        return SURFACE_TOLERANCE * (reach + self.occluders.size[other])

    def _pairs_in_cells(
        self, hits: Hits, facing: Bools, footprint: Floats | None
    ) -> Iterator[_Pairs]:
        """The same by the cells: stretches of one point."""
        own = np.repeat(hits.owner, np.diff(hits.first))
        spheres = len(self.occluders.surfaces.radius)
        for number, cells in enumerate(self.cells):
            asked = np.flatnonzero(facing[number] & ~cells.safe[own])
            p = _rows(hits.p, asked)
            x, y, z = self.lights[:, number].tolist()
            to_light = x - p[0], y - p[1], z - p[2]
            if footprint is None:
                point, other = _listed(cells, own[asked], to_light)
            else:
                point, other = _around(cells, own[asked], to_light, footprint[asked])
            for of_kind in (other < spheres, other >= spheres):
                at = np.flatnonzero(of_kind)
                if at.size:
                    light = np.full(at.size, number)
                    yield self._pairs_of_points(hits, asked[point[at]], light, other[at], footprint)

    def _pairs_of_points(
        self, hits: Hits, point: Ints, light: Ints, other: Ints, footprint: Floats | None
    ) -> _Pairs:
        """Stretches of one point."""
        owner = np.repeat(hits.owner, np.diff(hits.first))[point]
        radius = self.occluders.slack[owner]
        if footprint is not None:
            radius = radius + footprint[point]
        p = _rows(hits.p, point)
        return _Pairs(_Balls(owner, point, np.ones_like(point), p, radius), light, other)


class _Tiles(NamedTuple):
    """The stretches of one object in a tile of the picture, in a ball.

    Attributes
    ----------
    owner : (m,)
        The object.
    order : (n,)
        The stretches, tile by tile.
    first, length : (m,)
        Those of each tile.
    middle, radius : three (m,) and (m,)
    """

    owner: Ints
    order: Ints
    first: Ints
    length: Ints
    middle: Triple
    radius: Floats


def _tiles(hits: Hits, balls: _Balls, run: Ints) -> _Tiles:
    """Sort stretches into tiles by where they begin."""
    column = (hits.column[run] + (balls.start - hits.first[run])) // _TILE + 1
    row = hits.row[run] // _TILE + 1
    owner = hits.owner[run]
    key = (owner * (row.max() + 1) + row) * (column.max() + 1) + column
    order = np.argsort(key, kind="stable")
    first = np.flatnonzero(np.diff(key[order], prepend=-1))
    radius = balls.radius[order]
    middle = pick(balls.middle, order)
    low = each(lambda m: np.minimum.reduceat(m - radius, first), middle)
    high = each(lambda m: np.maximum.reduceat(m + radius, first), middle)
    half = each(lambda a, b: 0.5 * (b - a), low, high)
    return _Tiles(
        owner[order[first]],
        order,
        first,
        np.diff(first, append=order.size),
        each(lambda a, b: 0.5 * (a + b), low, high),
        np.sqrt(dot(half, half)),
    )


def _cut(start: Ints, count: Ints, longest: int) -> tuple[Ints, Ints, Ints]:
    """Cut runs into pieces: their start and length, and the run of each."""
    run, place = expand(-(-count // longest))
    offset = place * longest
    return start[run] + offset, np.minimum(count[run] - offset, longest), run


def _batches(sizes: Ints) -> Iterator[slice]:
    """Ranges of so many pairs at a time as stay in cache."""
    total = np.cumsum(sizes)
    start = 0
    while start < sizes.size:
        before = total[start] - sizes[start]
        stop = max(start + 1, int(np.searchsorted(total, before + _BATCH, side="right")))
        yield slice(start, stop)
        start = stop


def _mark(mask: Bools, light: Ints, start: Ints, count: Ints) -> None:
    """Set all points of some stretches."""
    mask[np.repeat(light, count), runs(start, count)] = True


def _columns(points: Floats, index: Ints | slice) -> Triple:
    return points[index, 0], points[index, 1], points[index, 2]


def _rows(points: Floats, index: Ints) -> Triple:
    return points[0][index], points[1][index], points[2][index]


def _listed(cells: Cells, own: Ints, to_light: Triple) -> tuple[Ints, Ints]:
    """Pairs (point, object) that the cells do not rule out."""
    distance, cell = cells.locate(to_light)
    # Most cells hold nothing, or the object itself.
    sole = cells.sole[cell]
    point = np.flatnonzero((sole != NONE) & (sole != own))
    owner, other = cells.objects(cell[point])
    point = point[owner]
    keep = (other != own[point]) & (cells.near[other] <= distance[point])
    return point[keep], other[keep]


def _around(cells: Cells, own: Ints, to_light: Triple, footprint: Floats) -> tuple[Ints, Ints]:
    """The same for all that is as near to each point as its footprint (n,)."""
    distance, point, cell = cells.around(to_light, footprint)
    sole = cells.sole[cell]
    some = np.flatnonzero((sole != NONE) & (sole != own[point]))
    owner, other = cells.objects(cell[some])
    point = point[some[owner]]
    keep = (other != own[point]) & (cells.near[other] <= distance[point])
    # Each pair once, though they share several cells.
    count = len(cells.near)
    pair = np.sort(point[keep] * count + other[keep])
    return np.divmod(pair[np.diff(pair, prepend=-1) > 0], count)


def occluders_of(view: View) -> Occluders:
    """Gather spheres and boxes."""
    surfaces, eye = view.surfaces, view.raster.eye
    center, radius = surfaces.center.T, surfaces.radius
    corner = np.maximum(np.abs(surfaces.min_pt), np.abs(surfaces.max_pt))
    size = np.concatenate([np.abs(center).sum(axis=0) + radius, corner.sum(axis=1)])
    x, y, z = np.concatenate([center, 0.5 * (surfaces.min_pt + surfaces.max_pt).T], axis=1)
    half = 0.5 * np.sqrt(((surfaces.max_pt - surfaces.min_pt) ** 2).sum(axis=1))
    return Occluders(
        surfaces,
        eye,
        view.eye_inside,
        view.outlines.in_picture(),
        (x, y, z),
        np.concatenate([radius, half]),
        size,
        _SLACK * (size + np.abs(eye).sum()),
    )


def shadows_of(lights: Floats, occluders: Occluders, samples: int) -> Shadows:
    """Prepare lights (n, 3) for the shadows at so many samples."""
    surfaces, spheres = occluders.surfaces, len(occluders.surfaces.radius)
    every = lights[:, None, :]
    away = surfaces.center - every
    size = np.abs(every).sum(axis=2) + occluders.size[:spheres]
    strictly = ((surfaces.min_pt < every) & (every < surfaces.max_pt)).all(axis=2)
    distance = np.sqrt((away * away).sum(axis=2))
    side = np.concatenate(
        [
            sphere_side(distance, surfaces.radius, SURFACE_TOLERANCE * size),
            np.where(strictly, INSIDE, ON).astype(np.int8),
        ],
        axis=1,
    )
    if len(surfaces) <= min(samples / _SAMPLES_EACH, _MOST):
        return Shadows(occluders, lights.T, side, _lists(lights, occluders), ())
    cells = []
    extents = Extents.of(surfaces, occluders.seen)
    for light in lights:
        x, y, z = np.moveaxis(np.array(box_corners(surfaces.min_pt, surfaces.max_pt)) - light, 2, 0)
        silhouettes = silhouette_planes((x, y, z), light, surfaces.min_pt, surfaces.max_pt)
        cells.append(list_objects(light, surfaces, extents, silhouettes))
    return Shadows(occluders, lights.T, side, (), tuple(cells))


def _lists(lights: Floats, occluders: Occluders) -> tuple[_Lists, ...]:
    """What may keep each light from each object, by trying all against each other."""
    surfaces, count = occluders.surfaces, len(occluders.surfaces)
    # A row for each light and each object it may light, a column for each that may shade it.
    light, own = (m.ravel() for m in np.indices((len(lights), count)))
    step = max(1, _PAIRS // max(1, count))
    center, low, high = (
        _columns(m, slice(None)) for m in (surfaces.center, surfaces.min_pt, surfaces.max_pt)
    )
    many: list[list[Ints]] = [[], []]
    listed: list[list[Ints]] = [[], []]
    for start in range(0, light.size, step):
        row = slice(start, start + step)
        end = each(lambda c: c[:, None], _columns(lights, light[row]))
        middle = each(lambda c: c[:, None], pick(occluders.middle, own[row]))
        thickness = occluders.radius[own[row]] + 2 * occluders.slack[own[row]]
        thickness = (thickness + _SLACK * np.abs(lights).sum(axis=1)[light[row]])[:, None]
        balls, _ = sphere_and_capsule(middle, end, thickness, center, surfaces.radius)
        boxes, _ = box_and_capsule(middle, end, thickness, low, high)
        may = np.concatenate([balls, boxes], axis=1)
        may[np.arange(len(may)), own[row]] = False
        may &= occluders.seen[own[row], None]
        spheres = len(surfaces.radius)
        for kind, part, before in ((0, may[:, :spheres], 0), (1, may[:, spheres:], spheres)):
            many[kind].append(np.count_nonzero(part, axis=1))
            listed[kind].append(np.nonzero(part)[1] + before)
    return tuple(
        _Lists(kind == 0, np.cumsum([0, *np.concatenate(many[kind])]), np.concatenate(listed[kind]))
        for kind in (0, 1)
        if any(part.size for part in listed[kind])
    )
