"""Shadow caches: what may shade samples near points whose shadows have been sought.

A look at a cell of the picture finds which objects keep which lights from all
that it sees of a surface, and which may keep them from some of it.  For samples
in the cell, and for its quarters, no other objects need to be tried.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tracer.arrays import Bools, Floats, Ints, batches, dot, each, expand, indices, pick
from tracer.shadow.occluders import Candidates, Finder, Occluders, ShadowEdges, candidates_by_kind
from tracer.view.hits import Hits

__all__ = ["ShadowCache"]


class ShadowCache(NamedTuple):
    """Finds what may shade samples by what is known of points near them.

    Attributes
    ----------
    finder : Finder
        For samples of which nothing is known.
    near : (samples,)
        The point that each sample is near: an index into all that follows, the last of which is of
        no point.
    own, p, footprint : (points,), (3, points), (points,)
        See `ShadowEdges`.
    facing, dark : (lights, points)
        See `ShadowEdges`: of a light that a point does not face, nothing is known near it.
    first : (lights * points + 1,)
        For light l and point i, listed[first[l * points + i]:first[l * points + i + 1]] are the
        objects that may keep the light away.
    listed : (m,)
    """

    finder: Finder
    near: Ints
    own: Ints
    p: Floats
    footprint: Floats
    facing: Bools
    dark: Bools
    first: Ints
    listed: Ints

    @classmethod
    def of(cls, finder: Finder, found: ShadowEdges) -> ShadowCache:
        """What is known of some points.  No samples are given yet: `near` is empty."""

        def ended(values: NDArray[Any], none: int = 0) -> NDArray[Any]:
            """Values of all points, and last of no point."""
            last = np.full((*values.shape[:-1], 1), none, dtype=values.dtype)
            return np.append(values, last, axis=-1)

        own, dark = ended(found.own, -1), ended(found.dark)
        key = found.light * own.size + found.point
        return cls(
            finder=finder,
            near=np.zeros(0, dtype=np.intp),
            own=own,
            p=ended(found.hits.p),
            footprint=ended(found.footprint),
            facing=ended(found.facing),
            dark=dark,
            first=np.append(0, np.cumsum(np.bincount(key, minlength=dark.size))),
            listed=found.occluder[key.argsort()],
        )

    @property
    def occluders(self) -> Occluders:
        """See `Finder.occluders`."""
        return self.finder.occluders

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
            which = indices(asked)
            key = number * self.own.size + near[which]
            first = self.first[key]
            length = self.first[key + 1] - first
            for batch in batches(length):
                at, place = expand(length[batch], first[batch])
                yield from candidates_by_kind(
                    self.occluders,
                    own=own,
                    points=points,
                    point=which[batch][at],
                    light=number,
                    occluder=self.listed[place],
                    footprint=footprint,
                )

    def _inside(self, p: Floats, own: Ints, near: Ints, footprint: Floats | None) -> Bools:
        """Whether hits, with their footprints, are near their points, and on the same object."""
        away = each(np.subtract, pick(p, slice(None)), pick(self.p, near))
        reach = self.footprint[near]
        if footprint is not None:
            reach = np.maximum(reach - footprint, 0)
        inside: Bools = (dot(away, away) <= reach * reach) & (own == self.own[near])
        return inside
