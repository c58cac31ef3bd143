"""Shadow caches: what may shade samples near points whose shadows have been sought.

A look at a cell of the picture finds which objects keep which lights from all
that it sees of a surface, and which may keep them from some of it.  For samples
in the cell, and for its quarters, no other objects need to be tried.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from tracer.arrays import Bools, Floats, Ints, batches, dot, each, expand, rows
from tracer.light_buffers import LightBufferFinder
from tracer.occluders import Candidates, candidates_by_kind
from tracer.visibility import Hits

__all__ = ["ShadowCache", "ShadowEdges"]


class ShadowEdges(NamedTuple):
    """What may keep lights from what is near some points, each on its own object.

    Attributes
    ----------
    hits : Hits
        The points.
    own : (n,)
        The object that each is on.
    footprint : (n,)
        Within which distance of each point is near.
    facing, dark : (lights, n)
        Which points face which light, and where it reaches nothing that is near.
    point, light, occluder : (m,)
        Objects that may keep a light from some of what is near a point.
    """

    hits: Hits
    own: Ints
    footprint: Floats
    facing: Bools
    dark: Bools
    point: Ints
    light: Ints
    occluder: Ints


class ShadowCache(NamedTuple):
    """Finds what may shade samples by what is known of points near them.

    Attributes
    ----------
    finder : LightBufferFinder
        For samples of which nothing is known.
    near : (samples,)
        The point that each sample is near: an index into all that follows.
    own, p, footprint : (points,), (3, points), (points,)
        See `ShadowEdges`.
    facing, dark : (lights, points)
        See `ShadowEdges`: of a light that a point does not face, nothing is known near it.
    first, length : (lights, points)
        Where the objects that may keep the light away begin in `listed`, and how many they are.
    listed : (m,)
    """

    finder: LightBufferFinder
    near: Ints
    own: Ints
    p: Floats
    footprint: Floats
    facing: Bools
    dark: Bools
    first: Ints
    length: Ints
    listed: Ints

    @classmethod
    def of(
        cls, finder: LightBufferFinder, found: Sequence[ShadowEdges], place: Ints
    ) -> ShadowCache:
        """Gather points, given the `place` (points,) of each among all found; -1 for those unseen.

        No samples are given yet: `near` is empty.
        """
        shape = len(found[0].dark), place.size
        known = cls(
            finder=finder,
            near=np.zeros(0, dtype=np.intp),
            own=np.full(place.size, -1),
            p=np.zeros((3, place.size)),
            footprint=np.zeros(place.size),
            facing=np.zeros(shape, dtype=np.bool_),
            dark=np.zeros(shape, dtype=np.bool_),
            first=np.zeros(shape, dtype=np.intp),
            length=np.zeros(shape, dtype=np.intp),
            listed=np.zeros(sum(edges.occluder.size for edges in found), dtype=np.intp),
        )
        start = before = 0
        for edges in found:
            size = edges.own.size
            at = np.flatnonzero((place >= start) & (place < start + size))
            point = place[at] - start
            known.own[at], known.footprint[at] = edges.own[point], edges.footprint[point]
            known.p[:, at] = rows(edges.hits.p, point)
            key = edges.light * size + edges.point
            order = np.argsort(key)
            known.listed[before : before + key.size] = edges.occluder[order]
            asked = np.add.outer(np.arange(shape[0]) * size, point)
            first, end = (np.searchsorted(key, asked, side, order) for side in ("left", "right"))
            known.first[:, at], known.length[:, at] = first + before, end - first
            known.facing[:, at], known.dark[:, at] = edges.facing[:, point], edges.dark[:, point]
            start, before = start + size, before + key.size
        return known

    def candidates(
        self, hits: Hits, facing: Bools, dark: Bools, footprint: Floats | None = None
    ) -> Iterator[Candidates]:
        """See `Finder.candidates`."""
        near, own = self.near[hits.sample], hits.own
        known = self.facing.take(near, axis=1) & self._inside(hits.p, own, near, footprint)
        unknown = facing & ~known
        if unknown.any():
            yield from self.finder.candidates(hits, unknown, dark, footprint)
        dark |= known & self.dark.take(near, axis=1)
        points = hits.points(slice(None))
        for number, asked in enumerate(facing & known):
            which = np.flatnonzero(asked)
            first, length = (m[number][near[which]] for m in (self.first, self.length))
            for batch in batches(length):
                at, place = expand(length[batch], first[batch])
                yield from candidates_by_kind(
                    self.finder.occluders,
                    own=own,
                    points=points,
                    point=which[batch][at],
                    light=number,
                    occluder=self.listed[place],
                    footprint=footprint,
                )

    def _inside(self, p: Floats, own: Ints, near: Ints, footprint: Floats | None) -> Bools:
        """Whether hits, with their footprints, are near their points, and on the same object."""
        away = each(np.subtract, rows(p, slice(None)), rows(self.p, near))
        reach = self.footprint[near]
        if footprint is not None:
            reach = np.maximum(reach - footprint, 0)
        inside: Bools = (dot(away, away) <= reach * reach) & (own == self.own[near])
        return inside
