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
    indices,
    put_2d,
    run_lengths,
    segment_indices,
    take3,
    take_2d,
)
from tracer.geometry.rounding import ON
from tracer.trace.hits import Hits
from tracer.trace.samples import Scattered
from tracer.world.light_grid import LightGrid
from tracer.world.prepared_scene import Lights, PreparedScene, Shape

# So many packets ask at a time, for each light; and so many edges of shadows are found before those
# found twice are left out.
_PACKETS_AT_ONCE, _EDGES_AT_ONCE = 1 << 14, 1 << 19

# A point with more edges of one light's shadows around it than this is crowded.
_CROWDED = 64

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


def occlusion(hits: Hits, lights: Lights, frontlit: Bools) -> Bools:
    """Whether other objects than their own keep lights from points.

    `frontlit` and the answer: (lights, n).  Where a point does not face a light, the answer has no
    meaning.
    """
    blocked = np.zeros(frontlit.shape, dtype=np.bool_)
    for umbra, shape, pairs in _candidates(hits, lights, frontlit):
        block = _blocks(hits, lights, shape, pairs)
        put_2d(blocked, pairs[0, block], pairs[1, block], True)
        put_2d(blocked, umbra[0], umbra[1], True)
    return blocked


def shadow_edges(
    hits: Hits, lights: Lights, frontlit: Bools, footprint: Floats
) -> tuple[Bools, tuple[Ints, Ints, Ints], Bools]:
    """`occlusion`, and where it may change within a distance `footprint` (n,) of a point.

    Listed are lights, points and occluders (m,), in ascending order, whose shadow's edge may be as
    near as that, each on the point's own object.  These block when grown by the footprint, or have
    the light within it of their surface; and they do not block when shrunk by it.  Where any object
    does even then, nothing near is lit.  Last is which points (n,) are crowded: of so many edges,
    none are listed.
    """
    blocked, umbra, crowded = np.zeros((3, *frontlit.shape), dtype=np.bool_)
    objects = hits.prepared.position_error.size
    found, more, waiting = np.zeros(0, dtype=np.intp), list[Ints](), 0
    for dark, shape, pairs in _candidates(hits, lights, frontlit, footprint):
        put_2d(umbra, dark[0], dark[1], True)
        reach = footprint[pairs[1]]
        blocks_grown = _blocks(hits, lights, shape, pairs, reach)
        # An object grown by more than its distance holds the light.  It may then hold all of a
        # segment, and block nothing, where the object itself blocks it.
        distance = shape.signed_distance(pairs[2], take3(lights.position.T, pairs[0]))
        near = indices(blocks_grown | (distance <= reach))
        pairs = pairs.take(near, axis=1)
        reach, blocks_grown, distance = reach[near], blocks_grown[near], distance[near]
        itself = _blocks(hits, lights, shape, pairs)
        # A point on a sphere's inner side is outside the shrunk one: the answer of that alone says
        # nothing.  Nor does that of a sphere with the light on its surface.
        shrunk = itself & _blocks(hits, lights, shape, pairs, -reach)
        shrunk &= take_2d(lights.side, pairs[0], pairs[2]) != ON
        put_2d(blocked, pairs[0, itself], pairs[1, itself], True)
        put_2d(umbra, pairs[0, shrunk], pairs[1, shrunk], True)
        edge = ~shrunk & (blocks_grown | (np.abs(distance) <= reach))
        edge &= take_2d(frontlit, pairs[0], pairs[1])
        edge &= ~take_2d(crowded, pairs[0], pairs[1])
        light, point, occluder = pairs[:, edge]
        more.append((light * frontlit.shape[1] + point) * objects + occluder)
        waiting += more[-1].size
        if waiting > _EDGES_AT_ONCE:
            found, many = _few_around([found, *more], objects)
            crowded.ravel()[many], more, waiting = True, [], 0
    found, many = _few_around([found, *more], objects)
    crowded.ravel()[many] = True
    found, occluder = np.divmod(found, objects)
    kept = indices(~umbra.ravel()[found])
    light, point = np.divmod(found[kept], frontlit.shape[1])
    return blocked | umbra, (light, point, occluder[kept]), np.any(crowded & ~umbra, axis=0)


def _few_around(edges: list[Ints], objects: int) -> tuple[Ints, Ints]:
    """Distinct edges, as numbers (light * n + point) * objects + occluder, without crowds.

    Also returns the pairs, light * n + point, that have crowds.
    """
    # An edge may have been found in several octants of the grid.
    found = np.unique(np.concatenate(edges))
    pair = found // objects
    begin, count = run_lengths(pair)
    many = count > _CROWDED
    return found[~many.repeat(count)], pair[begin[many]]


def _blocks(
    hits: Hits, lights: Lights, shape: Shape, pairs: Ints, offset: Floats | None = None
) -> Bools:
    """The exact test of pairs; `offset` (m,): see `Spheres.occludes`."""
    light, point, occluder = pairs
    eye, end = hits.prepared.frame.eye, take3(lights.position.T, light)
    side = take_2d(lights.side, light, occluder)
    return shape.occludes(eye, occluder, hits.points(point), end, side, offset)


def _candidates(
    hits: Hits, lights: Lights, frontlit: Bools, footprint: Floats | None = None
) -> Iterator[tuple[Ints, Shape, Ints]]:
    """Find all that may keep lights from points, some at a time.

    Yields lights and points (2, k) that are certainly in shadow; and, of a shape, lights, points
    and occluders (3, m) to be tested.  With a `footprint` (n,) all are as for anything on a point's
    own object within this distance of it.
    """
    if lights.grid is None or not frontlit.any():
        return
    levels, lit = _packets_of(hits, frontlit, footprint)
    rows = levels[-1]
    for shape, pairs in _found(hits.prepared, lights.grid, levels[0], lit[0]):
        umbra = []
        for depth, packets in enumerate(levels):
            if depth:
                pairs = levels[depth - 1].opened(pairs)
                pairs = pairs.take(indices(take_2d(lit[depth], pairs[0], pairs[1])), axis=1)
            light, packet, occluder = pairs
            middle, radius = take3(packets.middle, packet), packets.radius[packet]
            end = take3(lights.position.T, light)
            meets, cuts = shape.capsules(occluder, middle, end, radius)
            dark = pairs.take(indices(cuts), axis=1)
            for level, table in zip(levels[depth:], lit[depth:], strict=True):
                put_2d(table, dark[0], dark[1], False)
                dark = level.opened(dark)
            umbra.append(dark[:2])
            pairs = pairs.take(indices(meets & take_2d(lit[depth], light, packet)), axis=1)
        yield np.concatenate(umbra, axis=1), shape, rows.opened(pairs)


def _found(
    prepared: PreparedScene, grid: LightGrid, packets: Packets, lit: Bools
) -> Iterator[tuple[Shape, Ints]]:
    """Lights, packets and, of a shape, objects (3, m) that may come between, some at a time."""
    for start in range(0, packets.obj.size, _PACKETS_AT_ONCE):
        some = slice(start, start + _PACKETS_AT_ONCE)
        asked = packets.middle[:, some], packets.radius[some], packets.obj[some]
        for pairs in grid.query(*asked, lit[:, some]):
            pairs[1] += start
            for shape in prepared.shapes:
                kind = pairs.take(indices((pairs[2] >= prepared.boxes.first) == shape.flat), axis=1)
                for batch in batches(packets.length[kind[1]]):
                    yield shape, kind[:, batch]


def _packets_of(
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
    prepared, samples = hits.prepared, hits.samples
    across = prepared.packet_pixels * samples.density
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
    square = obj
    for at in samples.grid_position(hits.sample.take(start)):
        square = square * (at.max() // side + 1) + at // side
    order = square.argsort(kind="stable")
    layer = prepared.frame.layer(hits.p[2].take(start), side / samples.density)
    rows, lit = Packets._make(m.take(order, axis=-1) for m in rows), lit.take(order, axis=1)
    start, length = run_lengths(square[order], layer[order])
    return [_squares(rows, start, length), rows], [np.logical_or.reduceat(lit, start, axis=1), lit]


def _balls(hits: Hits, start: Ints, length: Ints) -> tuple[Floats, Floats]:
    """Bounding spheres, middles and radii, of `length` points from `start` on."""
    if isinstance(hits.samples, Scattered) or hits.prepared.spheres.eye_inside.any():
        a, b = (m.reduceat(hits.p, start, axis=1) for m in (np.minimum, np.maximum))
    else:
        # Points of a row lie on a line, or on an arc that is seen from outside, of less than half a
        # circle: the sphere on the chord between the ends holds them.
        a, b = hits.p.take(start, axis=1), hits.p.take(start + length - 1, axis=1)
    half = 0.5 * (b - a)
    middle = hits.prepared.frame.point_to_scene(take3(a + half, slice(None)))
    return np.array(middle), np.sqrt((half * half).sum(axis=0))


def _squares(rows: Packets, start: Ints, length: Ints) -> Packets:
    """Packets of `length` rows each, from `start` on."""
    low, high = (m.reduceat(rows.middle, start, axis=1) for m in (np.minimum, np.maximum))
    middle = 0.5 * (low + high)
    away = rows.middle - middle.repeat(length, axis=1)
    radius = np.maximum.reduceat(np.sqrt((away * away).sum(axis=0)) + rows.radius, start)
    return Packets(rows.obj[start], start, length, middle, radius)
