"""What may shade points, found from coarse to fine.

Points are held by balls: around whole objects, then around what is seen of one in
a block and in a tile of the picture, at last around stretches of neighbouring points.
All segments from a ball to a light lie in a capsule.  An object that misses it, or holds
all of it inside, casts no shadow there; the others go on to the next finer step.  One that
cuts the capsule of a stretch certainly shades all of it.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from tracer.arrays import (
    Bools,
    Floats,
    Ints,
    Triple,
    batches,
    columns,
    dot,
    each,
    entries,
    equal_runs,
    expand,
    indices,
    pick,
    put,
    ranges,
)
from tracer.shadow.occluders import SLACK, Balls, Candidates, Occluders
from tracer.view.hits import Hits
from tracer.view.view import Shape

__all__ = ["StretchFinder", "stretch_finder"]

# Most points in a long stretch, and in a short one; pixels along each side of a tile, and tiles
# along each side of a block.
_LONG, _SHORT, _TILE, _BLOCK = 24, 6, 24, 6


class _OccluderLists(NamedTuple):
    """Which spheres, or which boxes, may keep each light from each object.

    Attributes
    ----------
    shape : Spheres or Boxes
        Of what is listed.
    first, listed : (lights * n + 1,) and (m,)
        For light l and object i: listed[first[l * n + i]:first[l * n + i + 1]].
    """

    shape: Shape
    first: Ints
    listed: Ints


class StretchFinder(NamedTuple):
    """Finds what may shade points, from coarse to fine.

    Attributes
    ----------
    occluders : Occluders
    lists : tuple of _OccluderLists
        For the spheres and for the boxes, if there are any.
    """

    occluders: Occluders
    lists: tuple[_OccluderLists, ...]

    def candidates(
        self, hits: Hits, facing: Bools, dark: Bools, footprint: Floats | None = None
    ) -> Iterator[Candidates]:
        """See `Finder.candidates`."""
        if not (hits.owner.size and self.lists):
            return
        # Scattered points stand close together: their stretches are short ones from the start.
        longest, around = (_SHORT, _on_points) if hits.scattered else (_LONG, _on_chords)
        start, length, run = _cut(hits.first[:-1], np.diff(hits.first), longest)
        balls = around(self.occluders, hits, hits.owner[run], start, length)
        margin = np.zeros(start.size)
        if footprint is not None:
            margin = np.maximum.reduceat(footprint, start)
        balls.radius[:] += margin
        asked = np.logical_or.reduceat(facing, start, axis=1)
        search = _Search(self.occluders, hits, balls, margin, asked, dark)
        blocks, tiles, order = _tiles(hits, balls, run)
        for lists in self.lists:
            light, tile, occluder = search.of_tiles(lists, blocks, tiles)
            for batch in batches(tiles.length[tile]):
                part, place = expand(tiles.length[tile[batch]], tiles.start[tile[batch]])
                stretch = order[place]
                candidates = search.of_stretches(
                    lists, light[batch][part], stretch, occluder[batch][part]
                )
                if candidates.occluder.size:
                    yield candidates


def stretch_finder(occluders: Occluders) -> StretchFinder:
    """Prepare the coarsest step: all objects tried against each other."""
    # Nothing shades a lone object.
    shapes = occluders.view.shapes if len(occluders.surfaces) > 1 else ()
    lists = (_occluder_lists(occluders, shape) for shape in shapes)
    return StretchFinder(occluders, tuple(some for some in lists if some.listed.size))


def _occluder_lists(occluders: Occluders, shape: Shape) -> _OccluderLists:
    """Try all objects of a shape against all objects that they may shade."""
    lights, occluder = occluders.lights, shape.first + np.arange(shape.count)
    around_light = SLACK * np.abs(lights).sum(axis=1)
    light, own = (m.ravel() for m in np.indices(occluders.side.shape))
    seen = occluders.view.frames.in_picture(occluders.view.raster)
    counts, listed = [np.zeros(1, dtype=np.intp)], [occluder[:0]]
    # A row for each light and each object it may light, a column for each that may shade it.
    for some in batches(np.full(light.size, occluder.size)):
        at, one = light[some, None], own[some, None]
        thickness = occluders.radius[one] + 2 * occluders.slack[one] + around_light[at]
        middle = pick(occluders.middle, one)
        may, _ = shape.capsules(occluder, middle, columns(lights, at), thickness)
        may &= (one != occluder) & seen[one]
        counts.append(np.count_nonzero(may, axis=1))
        listed.append(occluder[np.nonzero(may)[1]])
    first = np.cumsum(np.concatenate(counts))
    return _OccluderLists(shape, first, np.concatenate(listed))


class _Search(NamedTuple):
    """Stretches of some hits, and what is still to be decided about them.

    Attributes
    ----------
    balls : Balls
        The stretches (m,).
    margin : (m,)
        What the footprints of their points add to the radius.
    asked : (lights, m)
        Whether any of their points may still be lit.
    dark : (lights, n)
        Whether a point is certainly in shadow.
    """

    occluders: Occluders
    hits: Hits
    balls: Balls
    margin: Floats
    asked: Bools
    dark: Bools

    def of_tiles(
        self, lists: _OccluderLists, blocks: Balls, tiles: Balls
    ) -> tuple[Ints, Ints, Ints]:
        """Lights, tiles, and objects that may come between: by blocks, then by their tiles."""
        lights, objects = self.occluders.side.shape
        # A row of keys for each light, with one for each block.
        key = np.add.outer(np.arange(lights) * objects, blocks.owner).ravel()
        place, listed = expand(lists.first[key + 1] - lists.first[key], lists.first[key])
        light, block = np.divmod(place, blocks.owner.size)
        light, block, occluder = self._in_tiles(lists, blocks, light, block, lists.listed[listed])
        part, tile = expand(blocks.length[block], blocks.start[block])
        return self._in_tiles(lists, tiles, light[part], tile, occluder[part])

    def _in_tiles(
        self, lists: _OccluderLists, tiles: Balls, light: Ints, tile: Ints, occluder: Ints
    ) -> tuple[Ints, Ints, Ints]:
        """Those of the given lights, tiles and objects whose object may come between."""
        middle, radius = pick(tiles.middle, tile), tiles.radius[tile]
        end = columns(self.occluders.lights, light)
        meets, _ = lists.shape.capsules(occluder, middle, end, radius)
        near = indices(meets)
        return light[near], tile[near], occluder[near]

    def of_stretches(
        self, lists: _OccluderLists, light: Ints, stretch: Ints, occluder: Ints
    ) -> Candidates:
        """Cut the stretches that may be shaded into short ones; return those that still may be.

        Sets `dark` where shadow is certain; a stretch that is all dark is no longer `asked` about.
        """
        some = indices(entries(self.asked, light, stretch))
        light, stretch, occluder = light[some], stretch[some], occluder[some]
        balls = self.balls.take(stretch)
        end = columns(self.occluders.lights, light)
        meets, cuts = lists.shape.capsules(occluder, balls.middle, end, balls.radius)
        put(self.asked, light[cuts], stretch[cuts], False)
        self._darken(light, balls, cuts)
        near = indices(meets & entries(self.asked, light, stretch))
        if self.hits.scattered:  # they are short already
            return Candidates(balls.take(near), light[near], occluder[near])
        start, length, parent = _cut(balls.start[near], balls.length[near], _SHORT)
        at = near[parent]
        light, stretch, occluder = light[at], stretch[at], occluder[at]
        balls = _on_chords(self.occluders, self.hits, self.balls.owner[stretch], start, length)
        balls.radius[:] += self.margin[stretch]
        end = columns(self.occluders.lights, light)
        meets, cuts = lists.shape.capsules(occluder, balls.middle, end, balls.radius)
        self._darken(light, balls, cuts)
        # A short stretch is marked as a whole, so its first point tells.
        near = indices(meets & ~entries(self.dark, light, start))
        return Candidates(balls.take(near), light[near], occluder[near])

    def _darken(self, light: Ints, balls: Balls, mask: Bools) -> None:
        """Mark all points of some stretches as in shadow."""
        start, length = balls.start[mask], balls.length[mask]
        put(self.dark, light[mask].repeat(length), ranges(start, length), True)


def _tiles(hits: Hits, balls: Balls, run: Ints) -> tuple[Balls, Balls, Ints]:
    """Sort stretches by where they begin: into blocks, into tiles of these, and in what order.

    A block's `start` and `length` are those of its tiles; a tile's, of its stretches in that order.
    """
    column = hits.column[run]
    if not hits.scattered:
        column = column + (balls.start - hits.first[run])
    column, row = column // _TILE, hits.row[run] // _TILE
    block = hits.owner[run]
    for m in (row // _BLOCK, column // _BLOCK):
        block = block * (m.max() + 1) + m
    tile = (block * _BLOCK + row % _BLOCK) * _BLOCK + column % _BLOCK
    order = tile.argsort(kind="stable")
    tile = tile[order]
    tiles = _around(balls.take(order), tile)
    return _around(tiles, tile[tiles.start] // _BLOCK**2), tiles, order


def _around(balls: Balls, key: Ints) -> Balls:
    """Put neighbouring balls of one object, with the same key, in one."""
    first, length = equal_runs(key)
    low = each(lambda m: np.minimum.reduceat(m - balls.radius, first), balls.middle)
    high = each(lambda m: np.maximum.reduceat(m + balls.radius, first), balls.middle)
    half = each(lambda a, b: 0.5 * (b - a), low, high)
    middle = each(lambda a, b: 0.5 * (a + b), low, high)
    return Balls(balls.owner[first], first, length, middle, np.sqrt(dot(half, half)))


def _cut(start: Ints, count: Ints, longest: int) -> tuple[Ints, Ints, Ints]:
    """Cut runs into pieces: their start and length, and the run of each."""
    run, place = expand(-(-count // longest))
    offset = place * longest
    return start[run] + offset, np.minimum(count[run] - offset, longest), run


def _on_chords(occluders: Occluders, hits: Hits, owner: Ints, start: Ints, count: Ints) -> Balls:
    """Put balls around stretches of points in rows."""
    # Points of a row lie on a line, or on an arc of less than half a circle: the ball on the chord
    # between the ends holds them.
    a, b = pick(hits.p, start), pick(hits.p, start + count - 1)
    half = each(lambda a, b: 0.5 * (a + b), a, b)
    middle = hits.view.raster.point_to_scene(half)
    across = each(np.subtract, b, a)
    radius = 0.5 * np.sqrt(dot(across, across))
    spheres, eye_inside = occluders.surfaces.sphere_count, occluders.view.eye_inside
    if eye_inside[:spheres].any():
        # Seen from inside, an arc may be longer: then all of the sphere is the ball.
        inside = indices(eye_inside[owner] & (owner < spheres) & (count > 1))
        center = hits.view.raster.to_camera(occluders.surfaces.center[owner[inside]])
        longer = inside[~_is_short(pick(half, inside), pick(across, inside), center)]
        for m, c in zip(middle, occluders.middle, strict=True):
            m[longer] = c[owner[longer]]
        radius[longer] = occluders.radius[owner[longer]]
    return Balls(owner, start, count, middle, radius + occluders.slack[owner])


def _on_points(occluders: Occluders, hits: Hits, owner: Ints, start: Ints, count: Ints) -> Balls:
    """Put balls around stretches, which follow each other, of points that lie anywhere."""
    low, high = (m.reduceat(hits.p, start, axis=1) for m in (np.minimum, np.maximum))
    half = 0.5 * (high - low)
    middle = hits.view.raster.point_to_scene(pick(low + half, slice(None)))
    radius = np.sqrt((half * half).sum(axis=0))
    return Balls(owner, start, count, middle, radius + occluders.slack[owner])


def _is_short(middle: Triple, chord: Triple, center: Triple) -> Bools:
    """Whether arcs, seen from the origin inside their circles, are surely less than half of these.

    They are if the circle's centre and the origin are on the same side of the chord.
    """
    along = dot(middle, chord) / dot(chord, chord)
    away = each(lambda m, d: m - along * d, middle, chord)
    beyond = dot(away, each(np.subtract, middle, center))
    size = dot(away, away) + dot(middle, middle) + dot(center, center)
    short: Bools = beyond > SLACK * size
    return short
