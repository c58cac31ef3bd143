"""Which points the lights reach.

All shadow segments end at a light, so an object can only block those that pass
it on their way.  The pairs of points and objects for which that cannot be ruled
out are found in one of two ways, whichever has less to do: from coarse to fine
in the picture, or by light buffers; or they are known from a look nearby.  All
end in the same exact test.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import sqrt
from typing import NamedTuple

import numpy as np

from tracer.arrays import Bools, Floats, Ints, Triple, columns, dot, each, entries, pick, put
from tracer.camera import Raster
from tracer.intersection import (
    ON,
    OUTSIDE,
    SURFACE_TOLERANCE,
    box_blocks,
    sphere_blocks,
    sphere_crosses,
)
from tracer.light_buffers import InLightBuffers, in_light_buffers
from tracer.occluders import SLACK, Occluders, Pairs, pairs_of_points
from tracer.stretches import InStretches, in_stretches
from tracer.surroundings import InSurroundings, Look
from tracer.visibility import Hits

__all__ = ["Shadows", "shadows_of"]

# Stretches are used for up to `_FEW` objects; beyond that, for up to `_MOST` that have
# `_PIXELS_EACH` pixels each (`_SPLIT_EACH`, where pixels are split).
_PIXELS_EACH, _SPLIT_EACH, _MOST, _FEW = 2000, 400, 1024, 64


class Shadows(NamedTuple):
    """What may keep lights from points.

    Attributes
    ----------
    occluders : Occluders
    finder : InStretches, InLightBuffers or InSurroundings
    """

    occluders: Occluders
    finder: InStretches | InLightBuffers | InSurroundings

    def blocked(self, hits: Hits, facing: Bools) -> Bools:
        """Whether other objects than their own keep lights from points that face them.

        `facing` and the answer: (lights, n); it is of no meaning where they do not face.
        """
        dark = np.zeros(facing.shape, dtype=np.bool_)
        blocked = np.zeros(facing.shape, dtype=np.bool_)
        for pairs in self.finder.pairs(hits, facing, dark):
            point, light, other = pairs.points()
            blocks = np.flatnonzero(self._blocks(hits, pairs, point, light, other))
            put(blocked, light[blocks], point[blocks], True)
        return blocked | dark

    def edges(self, hits: Hits, facing: Bools, footprint: Floats) -> tuple[Bools, Look]:
        """`blocked`, and where it may change within a distance `footprint` (n,) of a point.

        Listed are the objects whose shadow's edge may be so near: they block, as they are or when
        grown by the footprint, or have the light so near to their surface; and they do not block
        when shrunk by it.  Where another blocks even so, all that is near is dark.
        """
        blocked, solid, dark = np.zeros((3, *facing.shape), dtype=np.bool_)
        own, none = hits.own, np.zeros(0, dtype=np.intp)
        found = [(none, none, none)]
        for pairs in self.finder.pairs(hits, facing, dark, footprint):
            point, light, other = pairs.points()
            reach = footprint[point]
            does_larger = self._blocks(hits, pairs, point, light, other, reach)
            to_light = self._to_light(pairs)
            may = np.flatnonzero(does_larger | (to_light <= reach))
            if not may.size:
                continue
            point, light, other, reach = point[may], light[may], other[may], reach[may]
            p = hits.points(point)
            pairs = pairs_of_points(self.occluders, own, p, point, light, other, footprint)
            does = self._blocks(hits, pairs, point, light, other)
            # A point on a hollow sphere is outside of one that is smaller: that says nothing.
            must = does & self._blocks(hits, pairs, point, light, other, -reach)
            # Nor does one with the light on it.
            on = entries(self.occluders.side, light, other) == ON
            must &= ~(on & (other < len(self.occluders.surfaces.radius)))
            put(blocked, light[does], point[does], True)
            put(solid, light[must], point[must], True)
            changes = does_larger[may] | does | (np.abs(to_light[may]) <= reach)
            edge = ~must & changes & entries(facing, light, point)
            found.append((point[edge], light[edge], other[edge]))
        point, light, other = (np.concatenate(m) for m in zip(*found, strict=True))
        blocked |= dark
        dark |= solid
        seen = np.flatnonzero(~entries(dark, light, point))
        found_there = point[seen], light[seen], other[seen]
        return blocked, Look(hits, own, footprint, facing, dark, *found_there)

    @property
    def remembers(self) -> bool:
        """Whether it pays to remember looks: stretches take neighbours together, not apart."""
        return isinstance(self.finder, InLightBuffers)

    def remembering(self, looks: Sequence[Look], place: Ints) -> Callable[[Ints], Shadows]:
        """What looks have found holds for samples near their points: these, given that of each.

        `place` (points,): where the points are in all looks, or -1 where nothing is seen.
        """
        assert isinstance(self.finder, InLightBuffers)
        known = InSurroundings.of(self.finder, looks, place)
        return lambda near: self._replace(finder=known._replace(near=near))

    def _blocks(
        self,
        hits: Hits,
        pairs: Pairs,
        point: Ints,
        light: Ints,
        other: Ints,
        larger: Floats | None = None,
    ) -> Bools:
        """Whether objects keep lights from points: those of `pairs`, one by one.

        `larger` (n,) is added to the objects' sizes on all sides.
        """
        # A ball around one point has it for its middle.
        p = pairs.balls.middle if pairs.single else hits.points(point)
        end = each(pairs.spread, columns(self.occluders.lights, pairs.light))
        block = self._boxes_block if self._of_boxes(pairs) else self._spheres_block
        return block(pairs, p, end, light, other, larger)

    def _of_boxes(self, pairs: Pairs) -> bool:
        """Whether the objects are boxes."""
        return bool(pairs.other[0] >= len(self.occluders.surfaces.radius))

    def _boxes_block(
        self,
        pairs: Pairs,
        p: Triple,
        end: Triple,
        light: Ints,
        other: Ints,
        larger: Floats | None,
    ) -> Bools:
        """`_blocks`, from points `p` to the lights at `end`, of boxes."""
        surfaces = self.occluders.surfaces
        box = pairs.other - len(surfaces.radius)
        corners = columns(surfaces.min_pt, box), columns(surfaces.max_pt, box)
        low, high = (each(pairs.spread, corner) for corner in corners)
        if larger is not None:
            low, high = each(lambda c: c - larger, low), each(lambda c: c + larger, high)
        blocks = box_blocks(p, end, low, high)
        # Ends that may be on a face's plane are looked at more closely.
        at = np.flatnonzero(pairs.spread(self._on_planes(pairs, *corners)))
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

    def _spheres_block(
        self,
        pairs: Pairs,
        p: Triple,
        end: Triple,
        light: Ints,
        other: Ints,
        larger: Floats | None,
    ) -> Bools:
        """`_blocks`, from points `p` to the lights at `end`, of spheres."""
        occluders, surfaces = self.occluders, self.occluders.surfaces
        to_light = each(np.subtract, end, p)
        center = columns(surfaces.center, pairs.other)
        to_center = each(lambda c, p: pairs.spread(c) - p, center, p)
        radius = pairs.spread(surfaces.radius[pairs.other])
        if larger is not None:
            radius = np.maximum(radius + larger, 0)
        blocks = sphere_crosses(to_light, to_center, radius)
        # Ends that may be in or on a sphere are looked at more closely.
        aside = each(np.subtract, pairs.balls.middle, center)
        reach = surfaces.radius[pairs.other] + pairs.balls.radius + occluders.slack[pairs.other]
        closely = entries(occluders.side, pairs.light, pairs.other) != OUTSIDE
        closely |= dot(aside, aside) <= reach * reach
        at = np.flatnonzero(pairs.spread(closely))
        if at.size:
            ball = other[at]
            distance = np.sqrt(dot(pick(to_center, at), pick(to_center, at)))
            closely = distance <= radius[at] * (1 + SLACK) + occluders.slack[ball]
            at = at[closely | (entries(occluders.side, light[at], ball) != OUTSIDE)]
            ball = other[at]
            blocks[at] = sphere_blocks(
                pick(to_light, at),
                pick(to_center, at),
                radius[at],
                self._tolerance(pick(p, at), light[at], ball),
                entries(occluders.side, light[at], ball),
                occluders.eye_inside[ball],
            )
        return blocks

    def _to_light(self, pairs: Pairs) -> Floats:
        """How far the lights of `pairs` are from their objects, along some axis; for each point.

        An object that is larger by as much has the light inside.  It may then hold the whole of a
        segment, and block nothing, where the object itself blocks it.
        """
        surfaces, light = self.occluders.surfaces, columns(self.occluders.lights, pairs.light)
        if not self._of_boxes(pairs):
            away = each(np.subtract, columns(surfaces.center, pairs.other), light)
            return pairs.spread(np.sqrt(dot(away, away)) - surfaces.radius[pairs.other])
        box = pairs.other - len(surfaces.radius)
        low, high = columns(surfaces.min_pt, box), columns(surfaces.max_pt, box)
        sides = (*each(np.subtract, low, light), *each(np.subtract, light, high))
        return pairs.spread(np.max(sides, axis=0))

    def _on_planes(self, pairs: Pairs, low: Triple, high: Triple) -> Bools:
        """Whether balls, or their lights, touch the plane of a face of their boxes."""
        occluders, balls = self.occluders, pairs.balls
        reach = balls.radius + occluders.slack[pairs.other]
        result = entries(occluders.on_plane, pairs.light, pairs.other)
        for middle, a, b in zip(balls.middle, low, high, strict=True):
            # From the nearer of two planes.
            offset = np.abs(middle - 0.5 * (a + b))
            offset -= 0.5 * (b - a)
            result |= np.abs(offset, out=offset) <= reach
        return result

    def _tolerance(self, p: Triple, light: Ints, other: Ints) -> Floats:
        """How near to an object the ends of a segment count as on it, pair by pair."""
        occluders = self.occluders
        x, y, z = occluders.eye.tolist()
        ray = p[0] - x, p[1] - y, p[2] - z
        reach: Floats = np.sqrt(dot(ray, ray)) + sum(each(np.abs, p))
        at_light = np.abs(occluders.lights).sum(axis=1)[light]
        on = entries(occluders.side, light, other) == ON
        reach = np.where(on, np.maximum(reach, at_light), reach)
        return SURFACE_TOLERANCE * (reach + occluders.size[other])


def shadows_of(occluders: Occluders, raster: Raster, split: bool) -> Shadows:
    """Prepare for the shadows in a picture, whose pixels may be split."""
    pixels_each = _SPLIT_EACH if split else _PIXELS_EACH
    # Neighbours in a row make stretches; more rows of as many make only more of them.
    pixels = raster.width * raster.height * sqrt(raster.step_v / raster.step_u)
    few = len(occluders.surfaces) <= max(_FEW, min(pixels / pixels_each, _MOST))
    return Shadows(occluders, in_stretches(occluders) if few else in_light_buffers(occluders))
