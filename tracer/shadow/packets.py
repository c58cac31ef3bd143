"""Packets: neighbouring points of one object, in a bounding sphere.

All segments from a packet to a light lie in a capsule, so one test of an object decides for all of
them (see `capsules`).  Packets of a level hold those of the next, and at last points.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tracer.arrays import (
    Bools,
    Floats,
    Ints,
    Triple,
    dot,
    each,
    equal_runs,
    expand,
    indices,
    pick,
)
from tracer.shadow.grid import SLACK
from tracer.view.view import Visible

__all__ = ["Packets", "cut", "packets_of", "tiles_of"]


class Packets(NamedTuple):
    """Neighbouring points of one object, or smaller packets, in a bounding sphere.

    Attributes
    ----------
    owner : (m,)
        The object.
    start, length : (m,)
        Its points, or smaller packets: `length` of them, from `start` on.
    middle, radius : three (m,) and (m,)
        A sphere that holds all that is within the footprint of any of its points.
    footprint : (m,)
        The largest of them.
    """

    owner: Ints
    start: Ints
    length: Ints
    middle: Triple
    radius: Floats
    footprint: Floats

    def take(self, index: Ints) -> Packets:
        """Some of them."""
        owner, start, length, middle, radius, footprint = self
        return Packets(
            owner.take(index),
            start.take(index),
            length.take(index),
            pick(middle, index),
            radius.take(index),
            footprint.take(index),
        )


def packets_of(
    hits: Visible, slack: Floats, longest: int, footprint: Floats | None
) -> tuple[Packets, Ints]:
    """Cut the runs of hits into packets of at most `longest` points; and the run of each.

    Parameters
    ----------
    hits : Visible
    slack : (objects,)
        By how much points on each object may be off.
    longest : int
    footprint : (n,), optional
        The distance from each point within which anything shaded is to be found.
    """
    run, start, length = _pieces(hits.first[:-1], np.diff(hits.first), longest)
    owner, margin = hits.owner[run], np.zeros(start.size)
    if footprint is not None:
        margin = np.maximum.reduceat(footprint, start)
    if hits.scattered:
        middle, radius = _around_points(hits, start)
    else:
        middle, radius = _around_chords(hits, owner, start, length)
    return Packets(owner, start, length, middle, radius + slack[owner] + margin, margin), run


def cut(hits: Visible, slack: Floats, packets: Packets, longest: int) -> tuple[Packets, Ints]:
    """Cut packets, of points in rows, into packets of at most `longest`; and the parent of each."""
    parent, start, length = _pieces(packets.start, packets.length, longest)
    owner, footprint = packets.owner[parent], packets.footprint[parent]
    middle, radius = _around_chords(hits, owner, start, length)
    return Packets(
        owner, start, length, middle, radius + slack[owner] + footprint, footprint
    ), parent


def tiles_of(hits: Visible, packets: Packets, run: Ints, side: int) -> tuple[Packets, Ints]:
    """Gather packets of one object that begin in one tile of the picture, `side` pixels square.

    `run`: the run of each packet.  Returns the tiles, and the packets in the order that `start` and
    `length` refer to.
    """
    column = hits.column[run]
    if not hits.scattered:
        column = column + (packets.start - hits.first[run])
    tile = packets.owner
    for place in (hits.row[run] // side, column // side):
        tile = tile * (place.max() + 1) + place
    order = tile.argsort(kind="stable")
    first, length = equal_runs(tile[order])
    middle, radius = pick(packets.middle, order), packets.radius[order]
    low = each(lambda m: np.minimum.reduceat(m - radius, first), middle)
    high = each(lambda m: np.maximum.reduceat(m + radius, first), middle)
    half = each(lambda a, b: 0.5 * (b - a), low, high)
    middle = each(lambda a, b: 0.5 * (a + b), low, high)
    radius = np.sqrt(dot(half, half))
    return Packets(packets.owner[order[first]], first, length, middle, radius, radius), order


def _pieces(start: Ints, count: Ints, longest: int) -> tuple[Ints, Ints, Ints]:
    """Cut runs into pieces: the run, start and length of each."""
    run, place = expand(-(-count // longest))
    offset = place * longest
    return run, start[run] + offset, np.minimum(count[run] - offset, longest)


def _around_chords(hits: Visible, owner: Ints, start: Ints, count: Ints) -> tuple[Triple, Floats]:
    """Bounding spheres, middles and radii, of points in rows."""
    # Points of a row lie on a line, or on an arc of less than half a circle: the sphere on the
    # chord between the ends holds them.
    a, b = pick(hits.p, start), pick(hits.p, start + count - 1)
    half = each(lambda a, b: 0.5 * (a + b), a, b)
    middle = hits.view.raster.point_to_scene(half)
    across = each(np.subtract, b, a)
    radius = 0.5 * np.sqrt(dot(across, across))
    spheres = hits.view.spheres
    if spheres.eye_inside.any():
        # Seen from inside, an arc may be longer: then all of its sphere bounds it.
        inside = indices(hits.view.eye_inside[owner] & (owner < spheres.count) & (count > 1))
        center = pick(spheres.local, owner[inside])
        longer = inside[~_is_short(pick(half, inside), pick(across, inside), center)]
        for k in range(3):
            middle[k][longer] = spheres.center[k, owner[longer]]
        radius[longer] = spheres.radius[owner[longer]]
    return middle, radius


def _around_points(hits: Visible, start: Ints) -> tuple[Triple, Floats]:
    """Bounding spheres, middles and radii, of all points, cut at `start`."""
    low, high = (m.reduceat(hits.p, start, axis=1) for m in (np.minimum, np.maximum))
    half = 0.5 * (high - low)
    middle = hits.view.raster.point_to_scene(pick(low + half, slice(None)))
    return middle, np.sqrt((half * half).sum(axis=0))


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
