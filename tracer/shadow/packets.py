"""Packets: neighbouring points of one object, in a bounding sphere.

All segments from a packet to a light lie in a capsule, so one test of an object decides for all of
them (see `capsules`).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tracer.arrays import Bools, Floats, Ints, equal_runs, expand, pick
from tracer.view.view import Visible

__all__ = ["Packets", "packets_of"]

# The most points in a row, the least and the most pixels along each side of a square of rows, and
# how many times as deep as wide it may be: towards a horizon neighbouring rows are far apart.
_LONGEST, _LEAST, _SIDE, _DEEP = 6, 6, 16, 8


class Packets(NamedTuple):
    """Neighbouring points of one object in rows, or rows in squares, with bounding spheres.

    Attributes
    ----------
    owner : (m,)
        The object.
    start, length : (m,)
        The points of a row, or the rows of a square: `length` of them, from `start` on.
    middle, radius : (3, m) and (m,)
        A sphere that holds all that is within the footprint of any of its points.
    lit : (lights, m)
        Whether a light may reach any of its points.
    """

    owner: Ints
    start: Ints
    length: Ints
    middle: Floats
    radius: Floats
    lit: Bools

    def opened(self, pairs: Ints) -> Ints:
        """Lights, packets and occluders (3, m), with each of what a packet holds in its place."""
        part, place = expand(self.length[pairs[1]], self.start[pairs[1]])
        light, _, occluder = pairs.take(part, axis=1)
        return np.array([light, place, occluder])


def packets_of(
    hits: Visible, slack: Floats, across: float, frontlit: Bools, footprint: Floats | None
) -> list[Packets]:
    """Levels of packets: squares of rows, if objects are as large as these; then rows of points.

    `slack`, `across`: as in `Occluders`; `frontlit` (lights, n): whether points face lights;
    `footprint` (n,): the distance from each point within which anything shaded is to be found.
    """
    longest, count = int(min(max(across, 1), _LONGEST)), np.diff(hits.first)
    run, place = expand(-(-count // longest))
    place *= longest
    start, length = hits.first[run] + place, np.minimum(count[run] - place, longest)
    owner = hits.owner[run]
    middle, radius = _balls(hits, start, length)
    radius += slack[owner]
    if footprint is not None:
        radius += np.maximum.reduceat(footprint, start)
    lit = np.logical_or.reduceat(frontlit, start, axis=1)
    rows = Packets(owner, start, length, middle, radius, lit)
    side = int(min(across, _SIDE))
    if side < _LEAST:
        return [rows]
    square, column = owner, hits.column[run]
    if not hits.scattered:
        column += place
    for at in (hits.row[run] // side, column // side):
        square = square * (at.max() + 1) + at
    order = square.argsort(kind="stable")
    # The bits of a number are nearly its logarithm; of twice a number, they are 2^52 more.
    part = min(_DEEP * side * hits.view.raster.step_u / hits.view.raster.depth, 1.0)
    depth = hits.p[2].take(start).view(np.int64) // max(1, int(2**52 * part))
    rows = Packets._make(values.take(order, axis=-1) for values in rows)
    return [_gathered(rows, *equal_runs(square[order], depth[order])), rows]


def _balls(hits: Visible, start: Ints, length: Ints) -> tuple[Floats, Floats]:
    """Bounding spheres, middles and radii, of `length` points from `start` on."""
    if hits.scattered or hits.view.spheres.eye_inside.any():
        a, b = (m.reduceat(hits.p, start, axis=1) for m in (np.minimum, np.maximum))
    else:
        # Points of a row lie on a line, or on an arc that is seen from outside, of less than half a
        # circle: the sphere on the chord between the ends holds them.
        a, b = hits.p.take(start, axis=1), hits.p.take(start + length - 1, axis=1)
    half = 0.5 * (b - a)
    middle = hits.view.raster.point_to_scene(pick(a + half, slice(None)))
    return np.array(middle), np.sqrt((half * half).sum(axis=0))


def _gathered(rows: Packets, start: Ints, length: Ints) -> Packets:
    """Packets of `length` rows each, from `start` on."""
    low, high = (m.reduceat(rows.middle, start, axis=1) for m in (np.minimum, np.maximum))
    middle = 0.5 * (low + high)
    away = rows.middle - middle.repeat(length, axis=1)
    radius = np.maximum.reduceat(np.sqrt((away * away).sum(axis=0)) + rows.radius, start)
    lit = np.logical_or.reduceat(rows.lit, start, axis=1)
    return Packets(rows.owner[start], start, length, middle, radius, lit)
