"""Which points the lights reach.

All shadow segments end at a light, so an object can be ruled out for many of
them at once.  The pairs of points and objects that remain are found in one of
two ways, whichever has less to do: from coarse to fine in the picture
(`stretches`), or by light buffers; near points that were looked at before, they
are taken from a cache.  All pairs go through the same exact test.
"""

from __future__ import annotations

from collections.abc import Callable
from math import sqrt
from typing import NamedTuple

import numpy as np

from tracer.arrays import (
    Bools,
    Floats,
    Ints,
    Triple,
    columns,
    dot,
    each,
    entries,
    indices,
    pick,
    put,
)
from tracer.shadow.occluders import (
    Candidates,
    Finder,
    Occluders,
    Pairs,
    ShadowEdges,
    point_candidates,
)
from tracer.shadow.packets import StretchFinder, stretch_finder
from tracer.shapes.intersection import (
    INSIDE,
    ON,
    OUTSIDE,
    SURFACE_TOLERANCE,
    box_blocks,
    sphere_blocks,
    sphere_crosses,
)
from tracer.view.camera import Raster
from tracer.view.visibility import Hits

__all__ = ["Shadows", "shadows_of"]

# Stretches are used for up to `_FEW` objects; beyond that, for up to `_MOST` if there are
# `_PIXELS_EACH` pixels for each object (`_SPLIT_EACH`, where pixels are split).
_PIXELS_EACH, _SPLIT_EACH, _MOST, _FEW = 2000, 400, 1024, 64


class Shadows(NamedTuple):
    """What may keep lights from points.

    Attributes
    ----------
    occluders : Occluders
    finder : Finder
    """

    occluders: Occluders
    finder: Finder

    def blocked(self, hits: Hits, facing: Bools) -> Bools:
        """Whether other objects than their own keep lights from points that face them.

        `facing` and the answer: (lights, n).  Where a point does not face a light, the answer has
        no meaning.
        """
        dark = np.zeros(facing.shape, dtype=np.bool_)
        blocked = np.zeros(facing.shape, dtype=np.bool_)
        for candidates in self.finder.candidates(hits, facing, dark):
            pairs = candidates.pairs()
            block = pairs.take(indices(self._blocks(hits, candidates, pairs)))
            put(blocked, block.light, block.point, True)
        return blocked | dark

    def edges(self, hits: Hits, facing: Bools, footprint: Floats) -> tuple[Bools, ShadowEdges]:
        """`blocked`, and where it may change within a distance `footprint` (n,) of a point.

        Listed are the objects whose shadow's edge may be as near as that.  They block as they are,
        or when grown by the footprint, or have the light within it of their surface; and they do
        not block when shrunk by it.  Where any object does even then, all that is near is dark.
        """
        blocked, dark, solid = np.zeros((3, *facing.shape), dtype=np.bool_)
        own, none = hits.own, np.zeros(0, dtype=np.intp)
        found = [Pairs(none, none, none)]
        for candidates in self.finder.candidates(hits, facing, dark, footprint):
            pairs = candidates.pairs()
            reach = footprint[pairs.point]
            grown = self._blocks(hits, candidates, pairs, reach)
            gap = self._gap_to_light(candidates)
            near = indices(grown | (gap <= reach))
            if not near.size:
                continue
            pairs, reach, grown, gap = pairs.take(near), reach[near], grown[near], gap[near]
            single = point_candidates(
                self.occluders, own, hits.points(pairs.point), pairs, footprint
            )
            itself = self._blocks(hits, single, pairs)
            # A point on a sphere's inner side is outside the shrunk one: the answer of that alone
            # says nothing.
            shrunk = itself & self._blocks(hits, single, pairs, -reach)
            # Nor does that of a sphere with the light on its surface.
            shrunk &= entries(self.occluders.side, pairs.light, pairs.occluder) != ON
            put(blocked, pairs.light[itself], pairs.point[itself], True)
            put(solid, pairs.light[shrunk], pairs.point[shrunk], True)
            changes = grown | itself | (np.abs(gap) <= reach)
            edge = ~shrunk & changes & entries(facing, pairs.light, pairs.point)
            found.append(pairs.take(indices(edge)))
        every = Pairs(*(np.concatenate(m) for m in zip(*found, strict=True)))
        blocked |= dark
        dark |= solid
        edges = every.take(indices(~entries(dark, every.light, every.point)))
        return blocked, ShadowEdges(hits, own, footprint, facing, dark, *edges)

    @property
    def caches(self) -> bool:
        """Whether it pays to cache shadow edges: not for stretches, which take points together."""
        return not isinstance(self.finder, StretchFinder)

    def cached(self, found: ShadowEdges) -> Callable[[Ints], Shadows]:
        """A function from the point near each sample to `Shadows` that use what is known there.

        `found`: the points' shadow edges.  A point is a place among these, or -1 for none.
        """
        from tracer.shadow.shadow_cache import ShadowCache

        known = ShadowCache.of(self.finder, found)
        return lambda near: self._replace(finder=known._replace(near=near))

    def _blocks(
        self,
        hits: Hits,
        candidates: Candidates,
        pairs: Pairs,
        larger: Floats | None = None,
    ) -> Bools:
        """Whether objects keep lights from points: the exact test of `candidates`, pair by pair.

        `pairs` (n,): those of the candidates; `larger` (n,) grows objects on all sides.
        """
        # A ball around one point is centred on it.
        p = candidates.balls.middle if candidates.single else hits.points(pairs.point)
        end = each(candidates.spread, columns(self.occluders.lights, candidates.light))
        block = self._boxes_block if self._of_boxes(candidates) else self._spheres_block
        return block(candidates, pairs, p, end, larger)

    def _of_boxes(self, candidates: Candidates) -> bool:
        """Whether the objects are boxes."""
        return bool(candidates.occluder[0] >= self.occluders.surfaces.sphere_count)

    def _boxes_block(
        self, candidates: Candidates, pairs: Pairs, p: Triple, end: Triple, larger: Floats | None
    ) -> Bools:
        """`_blocks` for boxes, from points `p` to the lights at `end`."""
        surfaces = self.occluders.surfaces
        box = candidates.occluder - surfaces.sphere_count
        corners = columns(surfaces.min_pt, box), columns(surfaces.max_pt, box)
        low, high = (each(candidates.spread, corner) for corner in corners)
        if larger is not None:
            low, high = each(lambda c: c - larger, low), each(lambda c: c + larger, high)
        blocks = box_blocks(p, end, low, high)
        # Ends that may be on a face's plane are looked at more closely.
        at = indices(candidates.spread(self._on_planes(candidates, *corners)))
        if at.size:
            near, some = pick(p, at), pairs.take(at)
            tolerance = self._tolerance(near, some)
            blocks[at] = box_blocks(
                near,
                pick(end, at),
                pick(low, at),
                pick(high, at),
                (tolerance, self._tolerance_at_light(some, tolerance)),
            )
        if larger is not None:
            # A box shrunk to less than nothing blocks nothing.
            blocks &= (low[0] <= high[0]) & (low[1] <= high[1]) & (low[2] <= high[2])
        return blocks

    def _spheres_block(
        self, candidates: Candidates, pairs: Pairs, p: Triple, end: Triple, larger: Floats | None
    ) -> Bools:
        """`_blocks` for spheres, from points `p` to the lights at `end`."""
        occluders, surfaces = self.occluders, self.occluders.surfaces
        to_light = each(np.subtract, end, p)
        center = columns(surfaces.center, candidates.occluder)
        to_center = each(lambda c, p: candidates.spread(c) - p, center, p)
        radius_of = surfaces.radius[candidates.occluder]
        radius = candidates.spread(radius_of)
        if larger is not None:
            radius = np.maximum(radius + larger, 0)
        blocks = sphere_crosses(to_light, to_center, radius)
        # Ends that may be in or on a sphere are looked at more closely.
        aside = each(np.subtract, candidates.balls.middle, center)
        reach = radius_of + candidates.balls.radius + occluders.slack[candidates.occluder]
        closely = entries(occluders.side, candidates.light, candidates.occluder) != OUTSIDE
        closely |= dot(aside, aside) <= reach * reach
        at = indices(candidates.spread(closely))
        if at.size:
            some = pairs.take(at)
            blocks[at] = sphere_blocks(
                pick(to_light, at),
                pick(to_center, at),
                radius[at],
                self._tolerance(pick(p, at), some),
                entries(occluders.side, some.light, some.occluder),
                occluders.view.eye_inside[some.occluder],
            )
        return blocks

    def _gap_to_light(self, candidates: Candidates) -> Floats:
        """How far objects must grow to reach their light, for each point; negative with it inside.

        An object grown by more holds the light.  It may then hold the whole of a segment, and
        block nothing, where the object itself blocks it.
        """
        surfaces, light = self.occluders.surfaces, columns(self.occluders.lights, candidates.light)
        if not self._of_boxes(candidates):
            away = each(np.subtract, columns(surfaces.center, candidates.occluder), light)
            radius = surfaces.radius[candidates.occluder]
            return candidates.spread(np.sqrt(dot(away, away)) - radius)
        box = candidates.occluder - surfaces.sphere_count
        low, high = columns(surfaces.min_pt, box), columns(surfaces.max_pt, box)
        sides = (*each(np.subtract, low, light), *each(np.subtract, light, high))
        return candidates.spread(np.max(sides, axis=0))

    def _on_planes(self, candidates: Candidates, low: Triple, high: Triple) -> Bools:
        """Whether balls, or their lights, touch the plane of a face of their boxes."""
        occluders, balls = self.occluders, candidates.balls
        reach = balls.radius + occluders.slack[candidates.occluder]
        box = candidates.occluder - occluders.surfaces.sphere_count
        result = entries(occluders.on_plane, candidates.light, box)
        for middle, a, b in zip(balls.middle, low, high, strict=True):
            # The distance from the nearer of the two planes.
            offset = np.abs(middle - 0.5 * (a + b))
            offset -= 0.5 * (b - a)
            result |= np.abs(offset, out=offset) <= reach
        return result

    def _tolerance(self, p: Triple, pairs: Pairs) -> Floats:
        """How near to an object points count as on it, pair by pair."""
        x, y, z = self.occluders.view.raster.eye.tolist()
        ray = p[0] - x, p[1] - y, p[2] - z
        reach: Floats = np.sqrt(dot(ray, ray)) + sum(each(np.abs, p))
        return SURFACE_TOLERANCE * (reach + self.occluders.size[pairs.occluder])

    def _tolerance_at_light(self, pairs: Pairs, tolerance: Floats) -> Floats:
        """How near to a box its light counts as on it; `tolerance`: how near the points do."""
        occluders = self.occluders
        reach = np.abs(occluders.lights).sum(axis=1)[pairs.light]
        at_light = SURFACE_TOLERANCE * (reach + occluders.size[pairs.occluder])
        inside = entries(occluders.side, pairs.light, pairs.occluder) == INSIDE
        return np.where(inside, tolerance, np.maximum(tolerance, at_light))


def shadows_of(occluders: Occluders, raster: Raster, split: bool) -> Shadows:
    """Prepare the shadows in a picture; `split`: whether its pixels may be split."""
    pixels_each = _SPLIT_EACH if split else _PIXELS_EACH
    # Stretches lie along rows: more pixels across make them longer, more rows only more numerous.
    pixels = raster.width * raster.height * sqrt(raster.step_v / raster.step_u)
    if len(occluders.surfaces) <= max(_FEW, min(pixels / pixels_each, _MOST)):
        return Shadows(occluders, stretch_finder(occluders))
    from tracer.shadow.grid import light_buffer_finder

    return Shadows(occluders, light_buffer_finder(occluders))
