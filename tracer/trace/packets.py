"""Packets: neighbouring points of one object, in a bounding sphere.

All segments from a packet to a light lie in a capsule, so one test of an object decides for all of
them (see `capsules`).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tracer.arrays import Bools, Floats, Ints, run_lengths, segment_indices, take3
from tracer.trace.hits import Hits

# The most points in a row, and the least and the most pixels along each side of a square of rows.
_MOST_POINTS, _LEAST_SIDE, _MOST_SIDE = 6, 6, 16


class Packets(NamedTuple):
    """Neighbouring points of one object in rows, or rows in squares, with bounding spheres.

    Attributes
    ----------
    obj : (m,)
        The object.
    start, length : (m,)
        The points of a row, or the rows of a square: `length` of them, from `start` on.
    middle, radius : (3, m) and (m,)
        A sphere that holds all that is within the footprint of any of its points.
    """

    obj: Ints
    start: Ints
    length: Ints
    middle: Floats
    radius: Floats

    def opened(self, pairs: Ints) -> Ints:
        """Lights, packets and occluders (3, m), one for each part of its packet."""
        part, inner = segment_indices(self.length[pairs[1]], self.start[pairs[1]])
        light, _, occluder = pairs.take(part, axis=1)
        return np.array([light, inner, occluder])


def packets_of(
    hits: Hits, frontlit: Bools, footprint: Floats | None
) -> tuple[list[Packets], list[Bools]]:
    """Levels of packets: squares of rows, if objects are as large as these; then rows of points.

    Parameters
    ----------
    hits : Hits
    frontlit : (lights, n)
        Whether points face lights.
    footprint : (n,), or None
        The distance from each point within which anything shaded is to be found.

    Returns
    -------
    levels : list of Packets
    lit : list of (lights, m) tables
        For each level, whether a light may reach any point of each packet.
    """
    prepared = hits.prepared
    across = prepared.packet_pixels * hits.density
    longest, count = int(min(max(across, 1), _MOST_POINTS)), np.diff(hits.first)
    run, skip = segment_indices(-(-count // longest))
    skip *= longest
    start, length = hits.first[run] + skip, np.minimum(count[run] - skip, longest)
    obj = hits.obj[run]
    middle, radius = _balls(hits, start, length)
    radius += prepared.position_error[obj]
    if footprint is not None:
        radius += np.maximum.reduceat(footprint, start)
    lit = np.logical_or.reduceat(frontlit, start, axis=1)
    rows = Packets(obj, start, length, middle, radius)
    side = int(min(across, _MOST_SIDE))
    if side < _LEAST_SIDE:
        return [rows], [lit]
    square, column = obj, hits.column[run]
    if not hits.scattered:
        column += skip
    for at in (hits.row[run] // side, column // side):
        square = square * (at.max() + 1) + at
    order = square.argsort(kind="stable")
    layer = prepared.frame.layer(hits.p[2].take(start), side / hits.density)
    rows, lit = Packets._make(m.take(order, axis=-1) for m in rows), lit.take(order, axis=1)
    start, length = run_lengths(square[order], layer[order])
    return [_gathered(rows, start, length), rows], [np.logical_or.reduceat(lit, start, axis=1), lit]


def _balls(hits: Hits, start: Ints, length: Ints) -> tuple[Floats, Floats]:
    """Bounding spheres, middles and radii, of `length` points from `start` on."""
    if hits.scattered or hits.prepared.spheres.eye_inside.any():
        a, b = (m.reduceat(hits.p, start, axis=1) for m in (np.minimum, np.maximum))
    else:
        # Points of a row lie on a line, or on an arc that is seen from outside, of less than half a
        # circle: the sphere on the chord between the ends holds them.
        a, b = hits.p.take(start, axis=1), hits.p.take(start + length - 1, axis=1)
    half = 0.5 * (b - a)
    middle = hits.prepared.frame.point_to_scene(take3(a + half, slice(None)))
    return np.array(middle), np.sqrt((half * half).sum(axis=0))


def _gathered(rows: Packets, start: Ints, length: Ints) -> Packets:
    """Packets of `length` rows each, from `start` on."""
    low, high = (m.reduceat(rows.middle, start, axis=1) for m in (np.minimum, np.maximum))
    middle = 0.5 * (low + high)
    away = rows.middle - middle.repeat(length, axis=1)
    radius = np.maximum.reduceat(np.sqrt((away * away).sum(axis=0)) + rows.radius, start)
    return Packets(rows.obj[start], start, length, middle, radius)
