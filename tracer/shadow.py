"""Which points a light reaches: one pencil from each light.

All shadow segments end at a light, so an object can only block those that pass
it on their way.  That is decided from coarse to fine, by one test: for whole
objects, then for stretches of neighbouring points, each in a ball; the segments
from a ball to the light lie in a capsule, which an object meets or not.  What
is left goes to the exact test, point by point.

With more objects than can be tried against each other, those that a point may
meet are listed by cells of direction around the light instead.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from tracer.cells import NONE, Cells, Extents, list_objects
from tracer.groups import Bools, Index, Triple, dot, each, pick, runs, select
from tracer.intersection import (
    INSIDE,
    ON,
    OUTSIDE,
    SURFACE_TOLERANCE,
    box_blocks,
    box_and_capsule,
    sphere_blocks,
    sphere_crosses,
    sphere_and_capsule,
    sphere_side,
)
from tracer.pencil import box_corners, expand, silhouette_planes
from tracer.scene import Floats, Ints, Surfaces
from tracer.visibility import Hits

__all__ = ["LightPencil", "Occluders", "Points", "light_pencil", "occluders_of"]

# Up to so many objects, all are tried against each other.
_MOST_IN_PAIRS = 512

# Points in a stretch at most, coarse and fine, and pixels of a tile.
_LONG, _SHORT = 32, 8
_TILE_WIDTH, _TILE_HEIGHT = 32, 32

# Balls are larger by so much of all sizes around: far more than all roundings.
_SLACK = 1e-9


@dataclass(frozen=True, slots=True)
class Occluders:
    """All surfaces, spheres first, as whatever may cast a shadow.

    Attributes
    ----------
    surfaces : Surfaces
    eye_inside : (n,)
        Which of them are seen from inside.
    extents : Extents
    middle, radius : three (n,) and (n,)
        A ball around each.
    size : (n,)
        What a point's tolerance at each object scales with.
    slack : (n,)
        More than rounding displaces a point on each object.
    """

    surfaces: Surfaces
    eye_inside: Bools
    extents: Extents
    middle: Triple
    radius: Floats
    size: Floats
    slack: Floats


@dataclass(frozen=True, slots=True)
class Points:
    """Those points of some hits that face a light.

    Attributes
    ----------
    hits : Hits
    facing
        Which of them.
    to_light : three (n,)
        From these points to the light.
    """

    hits: Hits
    facing: Ints | slice
    to_light: Triple

    @property
    def size(self) -> int:
        """How many."""
        return self.hits.t.size if isinstance(self.facing, slice) else self.facing.size

    @property
    def own(self) -> Index:
        """The object that each lies on."""
        return select(self.hits.owner, self.facing)

    def at(self, index: Ints) -> Ints:
        """Their places among the hits."""
        return index if isinstance(self.facing, slice) else self.facing[index]

    def reach(self, index: Ints) -> Floats:
        """What the rounding of some points scales with: distances from origin and eye."""
        of = self.at(index)
        ray = pick(self.hits.direction, of)
        reach: Floats = self.hits.t[of] * np.sqrt(dot(ray, ray))
        return reach + sum(each(np.abs, pick(self.hits.p, of)))


@dataclass(frozen=True, slots=True)
class _Stretches:
    """Stretches of neighbouring points of one object, each in a ball.

    Attributes
    ----------
    start, count : (m,)
        The points.
    middle, radius : three (m,) and (m,)
    """

    start: Ints
    count: Ints
    middle: Triple
    radius: Floats

    def take(self, index: Ints) -> _Stretches:
        """Some of them."""
        middle = pick(self.middle, index)
        return _Stretches(self.start[index], self.count[index], middle, self.radius[index])


def _stretches(occluders: Occluders, points: Points, start: Ints, count: Ints) -> _Stretches:
    """Put balls around stretches of points."""
    begin, end = points.at(start), points.at(start + count - 1)
    owner = select(points.hits.owner, begin)
    # The points of a row lie on a line, or on an arc of less than half a circle.
    a, b = pick(points.hits.p, begin), pick(points.hits.p, end)
    middle = each(lambda a, b: 0.5 * (a + b), a, b)
    across = each(np.subtract, b, a)
    radius = 0.5 * np.sqrt(dot(across, across))
    if points.hits.face == 3:
        inside = occluders.eye_inside[owner]
        if inside.any():
            # Seen from inside, an arc may be longer.
            middle = each(lambda m, c: np.where(inside, c[owner], m), middle, occluders.middle)
            radius = np.where(inside, occluders.radius[owner], radius)
    return _Stretches(start, count, middle, radius + occluders.slack[owner])


@dataclass(frozen=True, slots=True)
class _Lists:
    """Which spheres, or which boxes, may shade each object.

    Attributes
    ----------
    spheres : bool
    first, listed : (n + 1,) and (m,)
        Those of object i are listed[first[i]:first[i + 1]].
    """

    spheres: bool
    first: Ints
    listed: Ints


@dataclass(frozen=True, slots=True)
class LightPencil:
    """What a light may be kept from, and by what.

    Attributes
    ----------
    position : (3,)
    side : (n,)
        Where the light is to each sphere: `OUTSIDE`, `ON` or `INSIDE`; to each
        box `INSIDE`, or else `ON`.
    lists : tuple of _Lists
        For the spheres and for the boxes.
    cells : Cells, optional
        Takes the place of these lists.
    """

    position: Floats
    side: NDArray[np.int8]
    lists: tuple[_Lists, ...]
    cells: Cells | None

    def blocked(self, occluders: Occluders, points: Points) -> Bools:
        """Whether another object than their own keeps points from the light."""
        result, dark = np.zeros((2, points.size), dtype=np.bool_)
        for pairs in self._pairs(occluders, points, dark):
            point, blocks = self._blocks(occluders, points, *pairs)
            result[point[blocks]] = True
        return result | dark

    def grazed(self, occluders: Occluders, points: Points, footprint: Floats) -> Bools:
        """Whether `blocked` may change within a distance (n,) of each point.

        An object that blocks when it is larger by as much, and does not when
        smaller by as much, has the edge of its shadow there.
        """
        result, solid, dark = np.zeros((3, footprint.size), dtype=np.bool_)
        for pairs in self._pairs(occluders, points, dark, footprint):
            point, may = self._blocks(occluders, points, *pairs, footprint)
            _, must = self._blocks(occluders, points, *pairs, -footprint)
            result[point[may & ~must]] = True
            solid[point[must]] = True
        # The edge of a shadow within another is not seen.
        return result & ~solid & ~dark

    def _pairs(
        self,
        occluders: Occluders,
        points: Points,
        dark: Bools,
        footprint: Floats | None = None,
    ) -> Iterator[tuple[_Stretches, Ints]]:
        """Pairs of a stretch and an object that may shade it: spheres, then boxes.

        With a footprint (n,): that may shade what is so near to its points.
        Sets `dark` (n,) where that is certain, and leaves out these points.
        """
        if self.cells:
            yield from _pairs_in_cells(self.cells, occluders, points, footprint)
            return
        own = points.hits.owner
        lists = [m for m in self.lists if np.ndim(own) or m.first[own] < m.first[own + 1]]
        if not lists:
            return
        first = points.hits.first
        if not isinstance(points.facing, slice):
            first = np.searchsorted(points.facing, first)
        start, count, _ = _cut(first[:-1], np.diff(first), _LONG)
        stretches = _stretches(occluders, points, start, count)
        wider = np.zeros(start.size)
        if footprint is not None:
            wider = np.maximum.reduceat(footprint, start)
        stretches.radius[:] += wider
        tiles = _Tiles.of(points, stretches)
        done = np.zeros(start.size, dtype=np.bool_)
        for kind in lists:
            tile, other = tiles.pairs(kind)
            near, _ = self._near(
                occluders, kind, pick(tiles.middle, tile), tiles.radius[tile], other
            )
            near = np.flatnonzero(near)
            pair, place = expand(tiles.count[tile[near]])
            stretch = tiles.order[tiles.first[tile[near]][pair] + place]
            other = other[near][pair]
            near, covers = self._near(
                occluders,
                kind,
                pick(stretches.middle, stretch),
                stretches.radius[stretch],
                other,
            )
            if not near.any():
                continue
            covered = stretch[covers]
            done[covered] = True
            dark[runs(stretches.start[covered], stretches.count[covered])] = True
            near = np.flatnonzero(near & ~done[stretch])
            stretch, other = stretch[near], other[near]
            start, count, parent = _cut(stretches.start[stretch], stretches.count[stretch], _SHORT)
            short, other = _stretches(occluders, points, start, count), other[parent]
            short.radius[:] += wider[stretch[parent]]
            near, covers = self._near(occluders, kind, short.middle, short.radius, other)
            dark[runs(start[covers], count[covers])] = True
            near = np.flatnonzero(near & ~dark[start])
            if near.size:
                yield short.take(near), other[near]

    def _near(
        self, occluders: Occluders, kind: _Lists, middle: Triple, radius: Floats, other: Ints
    ) -> tuple[Bools, Bools]:
        """Whether objects may come between balls and the light, and whether they surely do."""
        surfaces = occluders.surfaces
        x, y, z = self.position.tolist()
        if kind.spheres:
            center = _columns(surfaces.center, other)
            return sphere_and_capsule(middle, (x, y, z), radius, center, surfaces.radius[other])
        box = other - len(surfaces.radius)
        low, high = _columns(surfaces.min_pt, box), _columns(surfaces.max_pt, box)
        return box_and_capsule(middle, (x, y, z), radius, low, high)

    def _blocks(
        self,
        occluders: Occluders,
        points: Points,
        stretches: _Stretches,
        other: Ints,
        larger: Floats | None = None,
    ) -> tuple[Ints, Bools]:
        """All points of stretches, and whether an object (of each) keeps them from the light.

        `larger` (n,), of each point, is added to the objects' sizes on all sides.
        """
        surfaces, spheres = occluders.surfaces, len(occluders.surfaces.radius)
        count = stretches.count
        point = runs(stretches.start, count)
        p = pick(points.hits.p, points.at(point))
        if other[0] >= spheres:
            box = other - spheres
            low, high = (
                each(lambda c: np.repeat(c, count), _columns(corner, box))
                for corner in (surfaces.min_pt, surfaces.max_pt)
            )
            if larger is not None:
                low = each(lambda c: c - larger[point], low)
                high = each(lambda c: c + larger[point], high)
            x, y, z = self.position.tolist()
            tolerance = self._tolerance(occluders, points, point, np.repeat(other, count))
            blocks = box_blocks(p, (x, y, z), low, high, tolerance)
            if larger is not None:
                # A box smaller than nothing is none.
                blocks &= (low[0] <= high[0]) & (low[1] <= high[1]) & (low[2] <= high[2])
            return point, blocks
        to_light = pick(points.to_light, point)
        center = _columns(surfaces.center, other)
        to_center = each(lambda c, p: np.repeat(c, count) - p, center, p)
        radius = np.repeat(surfaces.radius[other], count)
        if larger is not None:
            radius = np.maximum(radius + larger[point], 0)
        blocks = sphere_crosses(to_light, to_center, radius)
        # Ends that may be in or on a sphere are looked at more closely.
        aside = each(np.subtract, stretches.middle, center)
        reach = surfaces.radius[other] + stretches.radius
        closely = (self.side[other] != OUTSIDE) | (dot(aside, aside) <= reach * reach)
        if closely.any():
            at = np.flatnonzero(np.repeat(closely, count))
            ball = np.repeat(other, count)[at]
            blocks[at] = sphere_blocks(
                pick(to_light, at),
                pick(to_center, at),
                radius[at],
                self._tolerance(occluders, points, point[at], ball),
                self.side[ball],
                occluders.eye_inside[ball],
            )
        return point, blocks

    def _tolerance(self, occluders: Occluders, points: Points, point: Ints, other: Ints) -> Floats:
        """How near to an object the ends of a segment count as on it, pair by pair."""
        reach = points.reach(point)
        at_light = np.abs(self.position).sum()
        reach = np.where(self.side[other] == ON, np.maximum(reach, at_light), reach)
        return SURFACE_TOLERANCE * (reach + occluders.size[other])


@dataclass(frozen=True, slots=True)
class _Tiles:
    """All stretches of one object in a part of the picture, in a ball.

    Attributes
    ----------
    owner : (m,)
        The object.
    order : (n,)
        The stretches, tile by tile.
    first, count : (m,)
        Those of each tile.
    middle, radius : three (m,) and (m,)
    """

    owner: Ints
    order: Ints
    first: Ints
    count: Ints
    middle: Triple
    radius: Floats

    @classmethod
    def of(cls, points: Points, stretches: _Stretches) -> _Tiles:
        """Sort stretches into tiles."""
        hits, begin = points.hits, points.at(stretches.start)
        sample = hits.sample[begin]
        column = (hits.samples.x[sample] / _TILE_WIDTH).astype(np.intp)
        row = (hits.samples.y[hits.samples.row[sample]] / _TILE_HEIGHT).astype(np.intp)
        owner = np.broadcast_to(select(hits.owner, begin), column.shape)
        key = (owner * (row.max() + 1) + row) * (column.max() + 2) + column
        order = np.argsort(key, kind="stable")
        first = np.flatnonzero(np.diff(key[order], prepend=-1))
        low, high = (
            each(lambda m: bound.reduceat((m + sign * stretches.radius)[order], first), stretches.middle)
            for bound, sign in ((np.minimum, -1.0), (np.maximum, 1.0))
        )
        half = each(lambda a, b: 0.5 * (b - a), low, high)
        return cls(
            owner[order[first]],
            order,
            first,
            np.diff(first, append=order.size),
            each(lambda a, b: 0.5 * (a + b), low, high),
            np.sqrt(dot(half, half)),
        )

    def pairs(self, lists: _Lists) -> tuple[Ints, Ints]:
        """Each tile with all objects that may shade its own."""
        first = lists.first[self.owner]
        tile, place = expand(lists.first[self.owner + 1] - first)
        return tile, lists.listed[first[tile] + place]


def _cut(start: Ints, count: Ints, longest: int) -> tuple[Ints, Ints, Ints]:
    """Cut runs into pieces: their start and length, and the run of each."""
    run, place = expand(-(-count // longest))
    offset = place * longest
    return start[run] + offset, np.minimum(count[run] - offset, longest), run


def _columns(points: Floats, index: Ints) -> Triple:
    return points[index, 0], points[index, 1], points[index, 2]


def _pairs_in_cells(
    cells: Cells, occluders: Occluders, points: Points, footprint: Floats | None
) -> Iterator[tuple[_Stretches, Ints]]:
    """The same from the cells: stretches of one point."""
    point, other = _listed_in_cells(cells, points, footprint)
    single = _stretches(occluders, points, point, np.ones(point.size, dtype=np.intp))
    if footprint is not None:
        single.radius[:] += footprint[point]
    spheres = other < len(occluders.surfaces.radius)
    for kind in (spheres, ~spheres):
        index = np.flatnonzero(kind)
        if index.size:
            yield single.take(index), other[index]


def _listed_in_cells(
    cells: Cells, points: Points, footprint: Floats | None = None
) -> tuple[Ints, Ints]:
    """Pairs (point, object) that the cells do not rule out.

    With a footprint (n,), also those of cells as far away as that.
    """
    if footprint is not None:
        pairs = [_listed_in_cells(cells, points)]
        for signs in product((-1.0, 1.0), repeat=3):
            x, y, z = (
                d + sign * footprint for d, sign in zip(points.to_light, signs, strict=True)
            )
            pairs.append(_listed_in_cells(cells, Points(points.hits, points.facing, (x, y, z))))
        point, other = (np.concatenate(part) for part in zip(*pairs, strict=True))
        # Each pair once.
        pair = np.unique(point * len(cells.near) + other)
        return np.divmod(pair, len(cells.near))
    own = points.own
    asked = ~cells.safe[own]
    if not asked.any():
        none = np.zeros(0, dtype=np.intp)
        return none, none
    distance, cell = cells.locate(points.to_light)
    # Most cells hold nothing, or the object itself.
    sole = cells.sole[cell]
    point = np.flatnonzero(asked & (sole != NONE) & (sole != own))
    owner, other = cells.objects(cell[point])
    point = point[owner]
    keep = other != select(own, point)
    keep &= cells.near[other] <= distance[point]
    return point[keep], other[keep]


def occluders_of(eye: Floats, surfaces: Surfaces, eye_inside: Bools, seen: Bools) -> Occluders:
    """Gather spheres and boxes; `seen` (n,) are those that may be in the picture."""
    center, radius = surfaces.center.T, surfaces.radius
    low = np.concatenate([center - radius, surfaces.min_pt.T], axis=1)
    high = np.concatenate([center + radius, surfaces.max_pt.T], axis=1)
    corner = np.maximum(np.abs(surfaces.min_pt), np.abs(surfaces.max_pt))
    size = np.concatenate([np.abs(center).sum(axis=0) + radius, corner.sum(axis=1)])
    x, y, z = np.concatenate([center, 0.5 * (surfaces.min_pt + surfaces.max_pt).T], axis=1)
    half = 0.5 * np.sqrt(((surfaces.max_pt - surfaces.min_pt) ** 2).sum(axis=1))
    return Occluders(
        surfaces,
        eye_inside,
        Extents(low, high, seen),
        (x, y, z),
        np.concatenate([radius, half]),
        size,
        _SLACK * (size + np.abs(eye).sum()),
    )


def light_pencil(position: tuple[float, float, float], occluders: Occluders) -> LightPencil:
    """Prepare a light for its shadows."""
    surfaces, light = occluders.surfaces, np.array(position)
    x, y, z = (surfaces.center - light).T
    spheres = len(surfaces.radius)
    size = np.abs(light).sum() + occluders.size[:spheres]
    strictly = ((surfaces.min_pt < light) & (light < surfaces.max_pt)).all(axis=1)
    side = np.concatenate(
        [
            sphere_side(np.sqrt(x * x + y * y + z * z), surfaces.radius, SURFACE_TOLERANCE * size),
            np.where(strictly, INSIDE, ON).astype(np.int8),
        ]
    )
    if len(surfaces) <= _MOST_IN_PAIRS:
        return LightPencil(light, side, _lists(light, occluders), None)
    x, y, z = np.moveaxis(np.array(box_corners(surfaces.min_pt, surfaces.max_pt)) - light, 2, 0)
    silhouettes = silhouette_planes((x, y, z), light, surfaces.min_pt, surfaces.max_pt)
    cells = list_objects(light, surfaces, occluders.extents, silhouettes)
    return LightPencil(light, side, (), cells)


def _lists(light: Floats, occluders: Occluders) -> tuple[_Lists, _Lists]:
    """What may shade each object, by trying all against each other."""
    surfaces = occluders.surfaces
    end: Triple = tuple(light.tolist())
    # A row for each object that may be shaded, a column for each that may shade it.
    x, y, z = (m[:, None] for m in occluders.middle)
    thickness = (occluders.radius + 2 * occluders.slack + _SLACK * np.abs(light).sum())[:, None]
    balls, _ = sphere_and_capsule((x, y, z), end, thickness, surfaces.center.T, surfaces.radius)
    boxes, _ = box_and_capsule((x, y, z), end, thickness, surfaces.min_pt.T, surfaces.max_pt.T)
    lists = []
    for before, may in ((0, balls), (len(surfaces.radius), boxes)):
        owner = before + np.arange(may.shape[1])
        may[owner, owner - before] = False
        may[~occluders.extents.seen] = False
        first = np.concatenate([[0], np.cumsum(np.count_nonzero(may, axis=1))])
        lists.append(_Lists(before == 0, first, np.nonzero(may)[1] + before))
    return lists[0], lists[1]
