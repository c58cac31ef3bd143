"""Which points the lights reach.

Packets of neighbouring points ask the lights' grids for objects that may come between.  What is
found is narrowed down, from large packets to small ones, by whether objects meet the capsules
around their segments; one that cuts a capsule certainly shades all of the packet.  The points that
remain go through the exact test with each object that remains, pair by pair.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from tracer.arrays import (
    Bools,
    Floats,
    Ints,
    batches,
    changes,
    columns,
    entries,
    expand,
    indices,
    put,
    ranges,
)
from tracer.shadow.occluders import LONGEST, Occluders
from tracer.shadow.packets import Packets, cut, packets_of, tiles_of
from tracer.shapes.rounding import ON
from tracer.view.view import Shape, Visible

__all__ = ["occlusion", "shadow_edges"]

# Long packets are cut into packets of at most so many points.
_SHORT = 6


class _Pairs(NamedTuple):
    """Triples of a light, a point and an object of a shape that may come between.

    Attributes
    ----------
    shape : Spheres or Boxes
    light, point, occluder : (m,)
    closely : (m,)
        See `Spheres.occludes`.
    """

    shape: Shape
    light: Ints
    point: Ints
    occluder: Ints
    closely: Bools

    def take(self, index: Ints) -> _Pairs:
        """Some of them."""
        shape, light, point, occluder, closely = self
        return _Pairs(
            shape, light.take(index), point.take(index), occluder.take(index), closely.take(index)
        )


def occlusion(occluders: Occluders, hits: Visible, frontlit: Bools) -> Bools:
    """Whether other objects than their own keep lights from points.

    `frontlit` and the answer: (lights, n).  Where a point does not face a light, the answer has no
    meaning.
    """
    blocked = np.zeros(frontlit.shape, dtype=np.bool_)
    for umbra, pairs in _candidates(occluders, hits, frontlit):
        block = _blocks(occluders, hits, pairs)
        put(blocked, pairs.light[block], pairs.point[block], True)
        blocked |= umbra
    return blocked


def shadow_edges(
    occluders: Occluders, hits: Visible, frontlit: Bools, footprint: Floats
) -> tuple[Bools, tuple[Ints, Ints, Ints]]:
    """`occlusion`, and where it may change within a distance `footprint` (n,) of a point.

    Listed are lights, points and occluders (m,), in ascending order, whose shadow's edge may be as
    near as that, each on the point's own object.  These block as they are, or when grown by the
    footprint, or have the light within it of their surface; and they do not block when shrunk by
    it.  Where any object does even then, nothing near is lit.
    """
    blocked, umbra = np.zeros((2, *frontlit.shape), dtype=np.bool_)
    none, count, objects = np.zeros(0, dtype=np.intp), frontlit.shape[1], occluders.slack.size
    found = [none]
    for dark, pairs in _candidates(occluders, hits, frontlit, footprint):
        reach = footprint[pairs.point]
        grown = _blocks(occluders, hits, pairs, reach)
        # An object grown by more than the gap holds the light.  It may then hold the whole of a
        # segment, and block nothing, where the object itself blocks it.
        gap = pairs.shape.gap(pairs.occluder, columns(occluders.lights, pairs.light))
        near = indices(grown | (gap <= reach))
        pairs, reach, grown, gap = pairs.take(near), reach[near], grown[near], gap[near]
        itself = _blocks(occluders, hits, pairs)
        # A point on a sphere's inner side is outside the shrunk one: the answer of that alone says
        # nothing.  Nor does that of a sphere with the light on its surface.
        shrunk = itself & _blocks(occluders, hits, pairs, -reach)
        shrunk &= entries(occluders.side, pairs.light, pairs.occluder) != ON
        put(blocked, pairs.light[itself], pairs.point[itself], True)
        put(umbra, pairs.light[shrunk], pairs.point[shrunk], True)
        umbra |= dark
        changing = ~shrunk & (grown | itself | (np.abs(gap) <= reach))
        edge = pairs.take(indices(changing & entries(frontlit, pairs.light, pairs.point)))
        found.append((edge.light * count + edge.point) * objects + edge.occluder)
    # A pair may have been found in several octants of the grid.
    triple = np.sort(np.concatenate(found))
    place, occluder = np.divmod(triple[changes(triple)], objects)
    kept = indices(~umbra.reshape(-1).take(place))
    light, point = np.divmod(place[kept], count)
    return blocked | umbra, (light, point, occluder[kept])


def _blocks(
    occluders: Occluders, hits: Visible, pairs: _Pairs, grown: Floats | None = None
) -> Bools:
    """The exact test of pairs; `grown` (m,): by how much objects grow on all sides."""
    end = columns(occluders.lights, pairs.light)
    eye, p = occluders.view.raster.eye, hits.points(pairs.point)
    return pairs.shape.occludes(eye, pairs.occluder, p, end, pairs.closely, grown)


def _candidates(
    occluders: Occluders, hits: Visible, frontlit: Bools, footprint: Floats | None = None
) -> Iterator[tuple[Bools, _Pairs]]:
    """All that may keep lights from points.

    Yields, again and again, one growing table of points (lights, n) that are certainly in shadow,
    and more pairs to be tested.  With a `footprint` (n,) all are as for anything on a point's own
    object within this distance of it.
    """
    umbra = np.zeros(frontlit.shape, dtype=np.bool_)
    for shape, light, packets, occluder in _asking(occluders, hits, frontlit, footprint):
        for short in (False, True) if packets.length.max(initial=0) > _SHORT else (False,):
            if short:
                packets, parent = cut(hits, occluders.slack, packets, _SHORT)
                light, occluder = light[parent], occluder[parent]
            end = columns(occluders.lights, light)
            meets, cuts = shape.capsules(occluder, packets.middle, end, packets.radius)
            start, length = packets.start[cuts], packets.length[cuts]
            put(umbra, light[cuts].repeat(length), ranges(start, length), True)
            near = indices(meets & ~cuts)
            packets, light, occluder = packets.take(near), light[near], occluder[near]
        # A short packet is in umbra as a whole, so its first point tells.
        near = indices(~entries(umbra, light, packets.start))
        packets, light, occluder = packets.take(near), light[near], occluder[near]
        around = packets.radius + occluders.slack[occluder]
        closely = shape.touches(occluder, packets.middle, around)
        closely |= entries(occluders.near_light, light, occluder)
        length = packets.length
        pairs = _Pairs(
            shape=shape,
            light=light.repeat(length),
            point=ranges(packets.start, length),
            occluder=occluder.repeat(length),
            closely=closely.repeat(length),
        )
        yield umbra, pairs


def _asking(
    occluders: Occluders, hits: Visible, frontlit: Bools, footprint: Floats | None
) -> Iterator[tuple[Shape, Ints, Packets, Ints]]:
    """Lights, packets of points, and objects of a shape that may come between, some at a time."""
    if occluders.grid is None or not frontlit.any():
        return
    # Scattered points stand close together: their packets are short from the start.
    tiled = occluders.packet == LONGEST
    longest = LONGEST if tiled and not hits.scattered else min(occluders.packet, _SHORT)
    packets, run = packets_of(hits, occluders.slack, longest, footprint)
    asked = np.logical_or.reduceat(frontlit, packets.start, axis=1)
    tiles, order = packets, np.arange(run.size)
    if tiled:
        tiles, order = tiles_of(hits, packets, run, LONGEST)
    else:
        tiles = tiles._replace(start=order, length=np.ones_like(order))
    in_tiles = np.logical_or.reduceat(asked[:, order], tiles.start, axis=1)
    query = occluders.grid.query(tiles.middle, tiles.radius, tiles.owner, in_tiles)
    for light, tile, occluder in query:
        for shape in occluders.view.shapes:
            kind = indices((occluder >= occluders.view.boxes.first) == shape.flat)
            length = tiles.length[tile[kind]]
            for batch in batches(length):
                part, place = expand(length[batch], tiles.start[tile[kind[batch]]])
                some, packet = kind[batch][part], order[place]
                lit = indices(entries(asked, light[some], packet))
                some, found = some[lit], packets.take(packet[lit])
                yield shape, light[some], found, occluder[some]
