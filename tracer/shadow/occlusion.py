"""Which points the lights reach.

Packets of neighbouring points ask the lights' grids for objects that may come between.  What is
found is narrowed down, from large packets to small ones, by whether objects meet the capsules
around their segments; one that cuts a capsule certainly shades all of the packet.  The points that
remain go through the exact test with each object that remains, pair by pair.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from tracer.arrays import Bools, Floats, Ints, batches, entries, indices, pick, put
from tracer.shadow.grid import LightGrid
from tracer.shadow.occluders import Occluders
from tracer.shadow.packets import Packets, packets_of
from tracer.shapes.rounding import ON
from tracer.view.view import Shape, View, Visible

__all__ = ["occlusion", "shadow_edges"]

# So many packets ask at a time.
_AT_ONCE = 1 << 14


def occlusion(occluders: Occluders, hits: Visible, frontlit: Bools) -> Bools:
    """Whether other objects than their own keep lights from points.

    `frontlit` and the answer: (lights, n).  Where a point does not face a light, the answer has no
    meaning.
    """
    blocked = np.zeros(frontlit.shape, dtype=np.bool_)
    for shape, pairs, closely in _candidates(occluders, hits, frontlit, blocked, None):
        block = _blocks(occluders, hits, shape, pairs, closely)
        put(blocked, pairs[0, block], pairs[1, block], True)
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
    table, found = (*frontlit.shape, occluders.slack.size), [np.zeros(0, dtype=np.intp)]
    for shape, pairs, closely in _candidates(occluders, hits, frontlit, umbra, footprint):
        reach = footprint[pairs[1]]
        grown = _blocks(occluders, hits, shape, pairs, closely, reach)
        # An object grown by more than the gap holds the light.  It may then hold the whole of a
        # segment, and block nothing, where the object itself blocks it.
        gap = shape.gap(pairs[2], pick(occluders.lights.T, pairs[0]))
        near = indices(grown | (gap <= reach))
        pairs, closely = pairs.take(near, axis=1), closely[near]
        reach, grown, gap = reach[near], grown[near], gap[near]
        itself = _blocks(occluders, hits, shape, pairs, closely)
        # A point on a sphere's inner side is outside the shrunk one: the answer of that alone says
        # nothing.  Nor does that of a sphere with the light on its surface.
        shrunk = itself & _blocks(occluders, hits, shape, pairs, closely, -reach)
        shrunk &= entries(occluders.side, pairs[0], pairs[2]) != ON
        put(blocked, pairs[0, itself], pairs[1, itself], True)
        put(umbra, pairs[0, shrunk], pairs[1, shrunk], True)
        edge = ~shrunk & (grown | itself | (np.abs(gap) <= reach))
        edge &= entries(frontlit, pairs[0], pairs[1])
        found.append(np.ravel_multi_index(tuple(pairs[:, edge]), table))
    # A pair may have been found in several octants of the grid.
    light, point, occluder = np.unravel_index(np.unique(np.concatenate(found)), table)
    kept = indices(~entries(umbra, light, point))
    return blocked | umbra, (light[kept], point[kept], occluder[kept])


def _blocks(
    occluders: Occluders,
    hits: Visible,
    shape: Shape,
    pairs: Ints,
    closely: Bools,
    grown: Floats | None = None,
) -> Bools:
    """The exact test of pairs; `grown` (m,): by how much objects grow on all sides."""
    light, point, occluder = pairs
    eye, end = occluders.view.raster.eye, pick(occluders.lights.T, light)
    return shape.occludes(eye, occluder, hits.points(point), end, closely, grown)


def _candidates(
    occluders: Occluders, hits: Visible, frontlit: Bools, umbra: Bools, footprint: Floats | None
) -> Iterator[tuple[Shape, Ints, Bools]]:
    """All that may keep lights from points.

    Sets `umbra` (lights, n) where points are certainly in shadow, and yields, of a shape, more
    lights, points and occluders (3, m) to be tested, with `closely` (m,) as in `Spheres.occludes`.
    With a `footprint` (n,) all are as for anything on a point's own object within this distance of
    it.
    """
    if occluders.grid is None or not frontlit.any():
        return
    levels = packets_of(hits, occluders.slack, occluders.across, frontlit, footprint)
    rows = levels[-1]
    for shape, pairs in _found(occluders.grid, occluders.view, levels[0]):
        for depth, packets in enumerate(levels):
            if depth:
                pairs = levels[depth - 1].opened(pairs)
                pairs = pairs.take(indices(entries(packets.lit, pairs[0], pairs[1])), axis=1)
            light, packet, occluder = pairs
            middle, radius = pick(packets.middle, packet), packets.radius[packet]
            end = pick(occluders.lights.T, light)
            meets, cuts = shape.capsules(occluder, middle, end, radius)
            dark = pairs.take(indices(cuts), axis=1)
            for level in levels[depth:]:
                put(level.lit, dark[0], dark[1], False)
                dark = level.opened(dark)
            put(umbra, dark[0], dark[1], True)
            pairs = pairs.take(indices(meets & entries(packets.lit, light, packet)), axis=1)
        light, row, occluder = pairs
        around = rows.radius[row] + occluders.slack[occluder]
        closely = shape.touches(occluder, pick(rows.middle, row), around)
        closely |= entries(occluders.near_light, light, occluder)
        yield shape, rows.opened(pairs), closely.repeat(rows.length[row])


def _found(grid: LightGrid, view: View, packets: Packets) -> Iterator[tuple[Shape, Ints]]:
    """Lights, packets and, of a shape, objects (3, m) that may come between, some at a time."""
    for start in range(0, packets.owner.size, _AT_ONCE):
        some = slice(start, start + _AT_ONCE)
        asked = packets.middle[:, some], packets.radius[some], packets.owner[some]
        for pairs in grid.query(*asked, packets.lit[:, some]):
            pairs[1] += start
            for shape in view.shapes:
                kind = pairs.take(indices((pairs[2] >= view.boxes.first) == shape.flat), axis=1)
                for batch in batches(packets.length[kind[1]]):
                    yield shape, kind[:, batch]
