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
    columns,
    each,
    entries,
    indices,
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
from tracer.shapes.rounding import ON
from tracer.view.camera import Raster
from tracer.view.hits import Hits
from tracer.view.view import Shape

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
        occluders, balls = self.occluders, candidates.balls
        # A ball around one point is centred on it.
        p = balls.middle if candidates.single else hits.points(pairs.point)
        end = each(candidates.spread, columns(occluders.lights, candidates.light))
        shape = self._shape(candidates)
        # Ends that may be on a surface are looked at more closely.
        reach = balls.radius + occluders.slack[candidates.occluder]
        closely = shape.touches(candidates.occluder, balls.middle, reach)
        closely |= entries(occluders.near_light, candidates.light, candidates.occluder)
        eye, closely = occluders.view.raster.eye, candidates.spread(closely)
        return shape.occludes(eye, pairs.occluder, p, end, closely, larger)

    def _shape(self, candidates: Candidates) -> Shape:
        """The shape of the objects."""
        return self.occluders.view.shape_of(candidates.occluder[0])

    def _gap_to_light(self, candidates: Candidates) -> Floats:
        """How far objects must grow to reach their light, for each point; negative with it inside.

        An object grown by more holds the light.  It may then hold the whole of a segment, and
        block nothing, where the object itself blocks it.
        """
        light = columns(self.occluders.lights, candidates.light)
        return candidates.spread(self._shape(candidates).gap(candidates.occluder, light))


def shadows_of(occluders: Occluders, raster: Raster, split: bool) -> Shadows:
    """Prepare the shadows in a picture; `split`: whether its pixels may be split."""
    pixels_each = _SPLIT_EACH if split else _PIXELS_EACH
    # Stretches lie along rows: more pixels across make them longer, more rows only more numerous.
    pixels = raster.width * raster.height * sqrt(raster.step_v / raster.step_u)
    if len(occluders.surfaces) <= max(_FEW, min(pixels / pixels_each, _MOST)):
        return Shadows(occluders, stretch_finder(occluders))
    from tracer.shadow.grid import light_buffer_finder

    return Shadows(occluders, light_buffer_finder(occluders))
