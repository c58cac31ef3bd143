"""What may shade samples near points that have been looked at.

A look at a cell of the picture finds which objects keep which lights from all
that it sees of a surface, and which may keep them from some of it.  For samples
in the cell, and for its quarters, no other objects need to be tried.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tracer.arrays import Bools, Floats, Ints, batches, dot, each, expand, rows
from tracer.light_buffers import InLightBuffers
from tracer.occluders import Pairs, pairs_with_objects
from tracer.visibility import Hits

__all__ = ["InSurroundings", "Look"]

# What is known of a light at a point: nothing where that does not face it; that it reaches all, or
# nothing, that is near; or else objects are listed.
_UNKNOWN, _LIT, _DARK, _LISTED = range(4)


class Look(NamedTuple):
    """What keeps lights from all that is near some points, on the same objects.

    Attributes
    ----------
    hits : Hits
        The points.
    own : (n,)
        The object that each is on.
    footprint : (n,)
        How near.
    facing, dark : (lights, n)
        Which points face which light, and where it reaches nothing that is near.
    point, light, other : (m,)
        Objects that may keep a light from some of what is near a point.
    """

    hits: Hits
    own: Ints
    footprint: Floats
    facing: Bools
    dark: Bools
    point: Ints
    light: Ints
    other: Ints


class InSurroundings(NamedTuple):
    """Finds what may shade samples by what is known of points that they are near.

    Attributes
    ----------
    finder : InLightBuffers
        For samples of which nothing is known.
    near : (samples,)
        Each sample's point, of those that follow.
    own, p, footprint : (points,), (3, points), (points,)
        See `Look`.
    state, first, listed : (lights, points)
        What is known of a light, where the objects for it begin in `others`, and how many are
        listed.
    others : (m,)
    """

    finder: InLightBuffers
    near: Ints
    own: Ints
    p: Floats
    footprint: Floats
    state: NDArray[np.int8]
    first: Ints
    listed: Ints
    others: Ints

    @classmethod
    def of(cls, finder: InLightBuffers, looks: Sequence[Look], place: Ints) -> InSurroundings:
        """Gather points, given their `place` (points,) in all looks, or -1 where nothing is seen.

        Samples are near none so far.
        """
        shape = len(looks[0].dark), place.size
        known = cls(
            finder,
            np.zeros(0, dtype=np.intp),
            np.full(place.size, -1),
            np.zeros((3, place.size)),
            np.zeros(place.size),
            np.zeros(shape, dtype=np.int8),
            np.zeros(shape, dtype=np.intp),
            np.zeros(shape, dtype=np.intp),
            np.zeros(sum(look.other.size for look in looks), dtype=np.intp),
        )
        start = before = 0
        for look in looks:
            count = look.own.size
            at = np.flatnonzero((place >= start) & (place < start + count))
            point = place[at] - start
            known.own[at], known.footprint[at] = look.own[point], look.footprint[point]
            known.p[:, at] = rows(look.hits.p, point)
            key = look.light * count + look.point
            order = np.argsort(key)
            known.others[before : before + key.size] = look.other[order]
            asked = np.add.outer(np.arange(shape[0]) * count, point)
            first, end = (np.searchsorted(key, asked, side, order) for side in ("left", "right"))
            known.first[:, at], known.listed[:, at] = first + before, end - first
            state = np.where(first < end, _LISTED, np.where(look.dark[:, point], _DARK, _LIT))
            known.state[:, at] = np.where(look.facing[:, point], state, _UNKNOWN)
            start, before = start + count, before + key.size
        return known

    def pairs(
        self, hits: Hits, facing: Bools, dark: Bools, footprint: Floats | None = None
    ) -> Iterator[Pairs]:
        """Points and what may shade them, as in `InStretches.pairs`."""
        near, own = self.near[hits.sample], hits.own
        state = self.state.take(near, axis=1)
        state *= self._inside(hits.p, own, near, footprint)
        unknown = facing & (state == _UNKNOWN)
        if unknown.any():
            yield from self.finder.pairs(hits, unknown, dark, footprint)
        dark |= state == _DARK
        points = hits.points(slice(None))
        for number, asked in enumerate(facing & (state == _LISTED)):
            which = np.flatnonzero(asked)
            first, listed = (m[number][near[which]] for m in (self.first, self.listed))
            for batch in batches(listed):
                at, place = expand(listed[batch], first[batch])
                yield from pairs_with_objects(
                    self.finder.occluders,
                    own,
                    points,
                    which[batch][at],
                    number,
                    self.others[place],
                    footprint,
                )

    def _inside(self, p: Floats, own: Ints, near: Ints, footprint: Floats | None) -> Bools:
        """Whether all that is asked about hits is known: they lie on the same object, and near."""
        away = each(np.subtract, rows(p, slice(None)), rows(self.p, near))
        reach = self.footprint[near]
        if footprint is not None:
            reach = np.maximum(reach - footprint, 0)
        inside: Bools = (dot(away, away) <= reach * reach) & (own == self.own[near])
        return inside
