"""Shadows: which lights reach which hits, and where shadows have edges.

The problem is to avoid testing every object for every hit and every light.  Five private concepts
serve this purpose:

packet
    A group of neighbouring hits on one object, with a bounding sphere.
shadow segment
    The straight segment from a hit to a light.  The shadow segments of all hits in a packet lie in
    one capsule: around the segment from the centre of the bounding sphere to the light, with the
    radius of the sphere.
footprint
    The part of a surface, around a hit, that is visible in a cell of the picture (a pixel or a
    square part of a pixel).
candidate
    A triple of a light, a hit (or a packet) and an object that may block the light there.
crowded
    A hit is crowded if more than `_MAX_EDGES_PER_HIT` shadow edges of one light may cross its
    footprint.

An object that misses the capsule of a packet shades no hit of the packet.  An object that cuts
right through the capsule shades all hits of the packet (Haines and Wallace, Shaft culling, 1991).
Then no other object has to be tested with the packet: for a heap of 1,000 balls in the shadow of
one large ball, this saves a third of the time.

Packets form a hierarchy of one or two levels.  Row packets contain hits that are consecutive in one
row of samples.  If objects are large in the picture, square packets contain row packets.  The
light grid lists the objects that may meet the capsules of the largest packets.  Capsule tests then
remove objects level by level, and an exact test decides each remaining pair of a hit and an object.

All steps before the exact test are conservative.  They remove a pair of a packet and an object only
if (1) the object certainly blocks no shadow segment of the packet, or (2) a single object certainly
shades the whole packet.  So the result equals that of testing all pairs.

For antialiasing, each object is tested three times with a shadow segment: unchanged, grown by the
radius of the footprint, and shrunk by it.  The first row that applies tells how the shadow of the
object meets the footprint (`_test_footprints`):

==================  ===========================================================================
shadow              condition
==================  ===========================================================================
covers it           The unchanged and the shrunk object block the segment, and the light is not on
                    the surface of the object.
may have an edge    The grown object blocks the segment, or the light is at most the radius of the
                    footprint away from the surface of the object.
does not reach it   otherwise
==================  ===========================================================================
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Annotated as Shaped
from typing import NamedTuple

import numpy as np

from tracer.arrays import (
    BATCH_SIZE,
    Bools,
    Floats,
    Ints,
    enumerate_ranges,
    find,
    find_runs,
    put_2d,
    sort_distinct,
    split_by_size,
    take,
    take_2d,
)
from tracer.geometry.rounding import ON
from tracer.geometry.shape import Shape
from tracer.trace.hits import Hits
from tracer.trace.packet_size import assign_depth_layers, compute_samples_per_side
from tracer.trace.samples import Scattered
from tracer.world.light_grid import LightGrid
from tracer.world.prepared_scene import Lights

# Maximum number of packets in one query of the light grid: it limits memory.
_PACKETS_PER_QUERY = BATCH_SIZE // 4

# Maximum number of shadow edges that are collected before duplicates are removed: it limits memory.
_EDGES_PER_BATCH = 8 * BATCH_SIZE

# A hit with more shadow edges of one light than this is crowded.
_MAX_EDGES_PER_HIT = 64

# Maximum number of hits in a row packet.  Tuned on six scenes of 4 to 1,000 objects: with half of
# it, rendering takes 1.08 times as long; with twice as many, the time is within 4 %.
_MAX_ROW_HITS = 6

# Square packets are built if they would have at least this side, in samples.  Tuned on the same
# scenes: with twice the side, rendering takes 1.12 times as long; with half, it is within 4 %.
_MIN_SQUARE_SIDE = 6

# Maximum side of a square packet, in samples.  Tuned on the same scenes: with half of it, rendering
# takes 1.07 times as long; with twice the side, the time is within 4 %.
_MAX_SQUARE_SIDE = 16


class Packets(NamedTuple):
    """One level of the packet hierarchy: packets of neighbouring hits on one object.

    The children of a row packet are hits.  The children of a square packet are row packets.
    """

    object_index: Shaped[Ints, "packets"]
    # The children have the indices child_start to child_start + child_count - 1.
    child_start: Shaped[Ints, "packets"]
    child_count: Shaped[Ints, "packets"]
    # Bounding spheres, in scene axes, which contain the footprints of all hits.
    center: Shaped[Floats, "3 packets"]
    radius: Shaped[Floats, "packets"]
    # Whether the light may be visible from any hit.  At first this is True if any hit faces the
    # light.  `_find_occluders` sets it to False when a single object shades the whole packet.
    may_be_lit: Shaped[Bools, "lights packets"]

    def replace_by_children(self, packet_columns: Shaped[Ints, "rows n"]) -> Shaped[Ints, "rows k"]:
        """Repeat each column for every child of its packet.

        Row 1 contains indices of packets, which the indices of their children replace.
        """
        packet_index = packet_columns[1]
        child_count, child_start = self.child_count[packet_index], self.child_start[packet_index]
        parent_column, child_index = enumerate_ranges(child_count, child_start)
        child_columns = packet_columns.take(parent_column, axis=1)
        child_columns[1] = child_index
        return child_columns


class _Occluders(NamedTuple):
    """Objects of one shape that may block the light at hits, and hits that are certainly in shadow.

    A hit is certainly in shadow if a single object shades its whole packet.
    """

    shape: Shape
    candidates: Shaped[Ints, "3 n"]  # indices of lights, of hits, and of objects between them
    shaded_pairs: Shaped[Ints, "2 k"]  # indices of lights, and of hits in shadow


def _find_occluders(
    hits: Hits,
    lights: Lights,
    faces_light: Shaped[Bools, "lights n"],
    margin: Shaped[Floats, "n"] | None = None,
) -> Iterator[_Occluders]:
    """Find, in batches, the objects that may block the light at each hit.

    Where the surface does not face the light, occluders may be skipped.  With a margin, the result
    holds for all points of the surface within this distance of the hit.
    """
    if lights.grid is None or not faces_light.any():
        return
    levels = build_packet_levels(hits, faces_light, margin)
    for shape, candidates in _query_grid(lights.grid, levels[0], hits.scene.shapes):
        shaded_pairs = np.zeros((2, 0), dtype=np.intp)
        for packets in levels:
            candidates, shaded_packets = _test_packets(packets, lights, shape, candidates)
            shaded_pairs = np.concatenate([shaded_pairs, shaded_packets], axis=1)
            candidates, shaded_pairs = map(packets.replace_by_children, (candidates, shaded_pairs))
        yield _Occluders(shape=shape, candidates=candidates, shaded_pairs=shaded_pairs)


def _query_grid(
    grid: LightGrid, packets: Packets, shapes: Iterable[Shape]
) -> Iterator[tuple[Shape, Shaped[Ints, "3 n"]]]:
    """Find the objects that may lie between packets and lights, in batches of one shape.

    The rows contain indices of lights, of packets, and of objects.  Pairs of a light and a packet
    are skipped unless `packets.may_be_lit`.
    """
    for first_packet in range(0, packets.object_index.size, _PACKETS_PER_QUERY):
        packet_slice = slice(first_packet, first_packet + _PACKETS_PER_QUERY)
        triples = grid.query(
            packets.center[:, packet_slice],
            packets.radius[packet_slice],
            packets.object_index[packet_slice],
            packets.may_be_lit[:, packet_slice],
        )
        for candidates in triples:
            candidates[1] += first_packet
            for shape in shapes:
                group = candidates.take(find(shape.objects.contains(candidates[2])), axis=1)
                for batch in split_by_size(packets.child_count[group[1]]):
                    yield shape, group[:, batch]


def _test_packets(
    packets: Packets, lights: Lights, shape: Shape, candidates: Shaped[Ints, "3 n"]
) -> tuple[Shaped[Ints, "3 k"], Shaped[Ints, "2 j"]]:
    """Test which objects shade all hits of a packet, and which may shade some.

    Where an object shades all hits, `packets.may_be_lit` is set to False.

    Parameters
    ----------
    candidates
        Indices of lights, of packets, and of objects of the given shape.

    Returns
    -------
    undecided_candidates
        The candidates whose object may shade some hits of the packet, without packets that a single
        object shades entirely.
    shaded_packets
        Indices of lights, and of packets that an object shades entirely.
    """
    # An object in an earlier batch may shade the whole packet.
    candidates = candidates.take(find(take_2d(packets.may_be_lit, *candidates[:2])), axis=1)
    light_index, packet_index, object_index = candidates
    center, radius = take(packets.center, packet_index), packets.radius[packet_index]
    light_position = take(lights.position.T, light_index)
    may_block, blocks_all = shape.test_capsules(object_index, center, light_position, radius)
    shaded_packets = candidates[:2].take(find(blocks_all), axis=1)
    put_2d(packets.may_be_lit, shaded_packets[0], shaded_packets[1], False)
    # Another object in this batch may shade the whole packet.
    is_undecided = may_block & take_2d(packets.may_be_lit, light_index, packet_index)
    return candidates.take(find(is_undecided), axis=1), shaded_packets


class _EdgeSet:
    """A set of shadow edges without duplicates, except for those of crowded (light, hit) pairs.

    A shadow edge is a triple of a light, a hit and an occluder: the edge of the occluder's shadow
    may pass near the hit.  The set encodes each triple as one integer key.
    """

    is_crowded: Shaped[Bools, "lights hits"]

    def __init__(self, light_count: int, hit_count: int, object_count: int) -> None:
        self.is_crowded = np.zeros((light_count, hit_count), dtype=np.bool_)
        self._counts = light_count, hit_count, object_count
        # The first batch is sorted, and has no duplicates.
        self._key_batches = [np.zeros(0, dtype=np.intp)]

    def add(self, edges: Shaped[Ints, "3 n"]) -> None:
        """Add edges, with duplicates, unless their pair is already marked as crowded."""
        is_kept = ~take_2d(self.is_crowded, edges[0], edges[1])
        self._key_batches.append(np.ravel_multi_index(tuple(edges[:, is_kept]), self._counts))
        if sum(batch.size for batch in self._key_batches[1:]) > _EDGES_PER_BATCH:
            self._merge_batches()

    def get_edges(self) -> Shaped[Ints, "3 n"]:
        """Return all edges, sorted by light, then by hit, then by occluder."""
        self._merge_batches()
        return np.array(np.unravel_index(self._key_batches[0], self._counts))

    def _merge_batches(self) -> None:
        """Merge all batches into one without duplicates, and mark and remove crowded pairs."""
        keys = sort_distinct(np.concatenate(self._key_batches))
        pair_key = keys // self._counts[2]  # encodes the light and the hit
        pair_start, edge_count = find_runs(pair_key)
        is_pair_crowded = edge_count > _MAX_EDGES_PER_HIT
        self.is_crowded.ravel()[pair_key[pair_start[is_pair_crowded]]] = True
        self._key_batches = [keys[~is_pair_crowded.repeat(edge_count)]]


def find_shadows(
    hits: Hits, lights: Lights, faces_light: Shaped[Bools, "lights n"]
) -> Shaped[Bools, "lights n"]:
    """Test whether an object blocks the segment from each hit to each light.

    The result is meaningless where the surface does not face the light.  The object on which a hit
    lies is not tested.  All objects are convex, so it can only block lights that its surface does
    not face at the hit.
    """
    is_blocked = np.zeros(faces_light.shape, dtype=np.bool_)
    for occluders in _find_occluders(hits, lights, faces_light):
        is_blocking = _test_blocking(hits, lights, occluders.shape, occluders.candidates)
        light_index, hit_index, _ = occluders.candidates[:, is_blocking]
        put_2d(is_blocked, light_index, hit_index, True)
        shaded_light, shaded_hit = occluders.shaded_pairs
        put_2d(is_blocked, shaded_light, shaded_hit, True)
    return is_blocked


class ShadowEdges(NamedTuple):
    """Which hits are in shadow, and the visible shadow edges that may cross their footprints."""

    # Whether an object other than the hit's own blocks the segment from the hit to the light;
    # meaningless where the surface does not face the light.
    is_blocked: Shaped[Bools, "lights n"]
    # Indices of lights, of hits, and of occluders, sorted in this order.  Some edges of crowded
    # hits are omitted.
    edges: Shaped[Ints, "3 k"]
    is_crowded: Shaped[Bools, "n"]


def find_shadow_edges(
    hits: Hits,
    lights: Lights,
    faces_light: Shaped[Bools, "lights n"],
    radius: Shaped[Floats, "n"],
) -> ShadowEdges:
    """Test which hits are in shadow, and find the visible shadow edges near each hit.

    Shadow edges that may cross the footprint are found, given its radius, unless a single object
    shades the whole footprint from the same light.
    """
    is_blocked, is_covered = np.zeros((2, *faces_light.shape), dtype=np.bool_)
    light_count, hit_count = faces_light.shape
    edge_set = _EdgeSet(light_count, hit_count, hits.scene.position_error.size)
    for occluders in _find_occluders(hits, lights, faces_light, radius):
        candidates = occluders.candidates
        test = _test_footprints(hits, lights, occluders.shape, candidates, radius)
        light_index, hit_index, _ = candidates
        put_2d(is_blocked, light_index[test.is_blocking], hit_index[test.is_blocking], True)
        put_2d(is_covered, light_index[test.is_covering], hit_index[test.is_covering], True)
        shaded_light, shaded_hit = occluders.shaded_pairs
        put_2d(is_covered, shaded_light, shaded_hit, True)
        is_facing = take_2d(faces_light, light_index, hit_index)
        edge_set.add(candidates[:, test.has_edge & is_facing])
    edges = edge_set.get_edges()
    is_visible = ~take_2d(is_covered, edges[0], edges[1])
    return ShadowEdges(
        is_blocked=is_blocked | is_covered,
        edges=edges[:, is_visible],
        is_crowded=np.any(edge_set.is_crowded & ~is_covered, axis=0),
    )


class _FootprintTest(NamedTuple):
    """How the shadow of each candidate's object meets the footprint of its hit."""

    is_blocking: Shaped[Bools, "n"]  # the object blocks the segment from the hit to the light
    is_covering: Shaped[Bools, "n"]  # the shadow covers the footprint
    has_edge: Shaped[Bools, "n"]  # the edge of the shadow may cross the footprint


def _test_footprints(
    hits: Hits,
    lights: Lights,
    shape: Shape,
    candidates: Shaped[Ints, "3 k"],
    footprint_radius: Shaped[Floats, "n"],
) -> _FootprintTest:
    """Apply the table in the module's docstring to (light, hit, object) triples."""
    # If the object shades any part of the footprint, the grown object shades the hit.
    growth = footprint_radius[candidates[1]]
    grown_object_blocks = _test_blocking(hits, lights, shape, candidates, growth)
    light_distance = shape.measure_distance(candidates[2], take(lights.position.T, candidates[0]))
    is_blocking = _test_blocking(hits, lights, shape, candidates)
    # The object shades the whole footprint if the shrunk object blocks the segment, too.  A test of
    # the shrunk object does not suffice, because the hit may lie between the two surfaces.
    is_covering = is_blocking & _test_blocking(hits, lights, shape, candidates, -growth)
    # A light on the object's surface illuminates only one side of the tangent plane there, and this
    # plane may cross the footprint.
    is_covering &= take_2d(lights.side, candidates[0], candidates[2]) != ON
    has_edge = ~is_covering & (grown_object_blocks | (np.abs(light_distance) <= growth))
    return _FootprintTest(is_blocking=is_blocking, is_covering=is_covering, has_edge=has_edge)


def _test_blocking(
    hits: Hits,
    lights: Lights,
    shape: Shape,
    candidates: Shaped[Ints, "3 k"],
    growth: Shaped[Floats, "k"] | None = None,
) -> Shaped[Bools, "k"]:
    """Test whether the object of each (light, hit, object) triple blocks the segment.

    Each object is grown by `growth` before the test; a negative distance shrinks it.
    """
    light_index, hit_index, object_index = candidates
    light_position = take(lights.position.T, light_index)
    light_side = take_2d(lights.side, light_index, object_index)
    hit_position = hits.get_points(hit_index)
    return shape.occludes(object_index, hit_position, light_position, light_side, growth)


def build_packet_levels(
    hits: Hits, faces_light: Shaped[Bools, "lights n"], margin: Shaped[Floats, "n"] | None
) -> list[Packets]:
    """Group neighbouring hits into packets: [row packets], or [square packets, row packets].

    With a margin, bounding spheres contain all points within this distance of each hit.
    """
    samples_per_side = compute_samples_per_side(hits.samples)
    samples_across_packet = hits.scene.packet_width * samples_per_side
    max_row_hits = int(min(max(samples_across_packet, 1), _MAX_ROW_HITS))
    row_packets = _build_row_packets(hits, faces_light, margin, max_row_hits)
    square_side = int(min(samples_across_packet, _MAX_SQUARE_SIDE))  # in samples
    if square_side < _MIN_SQUARE_SIDE:
        return [row_packets]
    return [*_build_square_packets(hits, row_packets, square_side / samples_per_side)]


def _build_row_packets(
    hits: Hits,
    faces_light: Shaped[Bools, "lights n"],
    margin: Shaped[Floats, "n"] | None,
    max_hits: int,
) -> Packets:
    """Divide runs into row packets, in the order of the hits.

    The last packet of a run may have fewer than `max_hits` hits.
    """
    run_length = np.diff(hits.run_start)
    packets_per_run = -(-run_length // max_hits)  # rounded up
    run_index, packet_in_run = enumerate_ranges(packets_per_run)
    offset_in_run = packet_in_run * max_hits
    first_hit = hits.run_start[run_index] + offset_in_run
    object_index = hits.run_object[run_index]
    center, radius = _compute_bounding_spheres(hits, first_hit)
    radius += hits.scene.position_error[object_index]
    if margin is not None:
        radius += np.maximum.reduceat(margin, first_hit)
    return Packets(
        object_index=object_index,
        child_start=first_hit,
        child_count=np.minimum(run_length[run_index] - offset_in_run, max_hits),
        center=center,
        radius=radius,
        may_be_lit=np.logical_or.reduceat(faces_light, first_hit, axis=1),
    )


def _build_square_packets(
    hits: Hits, row_packets: Packets, square_width: float
) -> tuple[Packets, Packets]:
    """Group row packets into square packets; return these, and the row packets in their order.

    The row packets of a square packet lie on the same object, in the same square of the picture,
    which is `square_width` pixels wide, and at similar depths.
    """
    first_hit = row_packets.child_start
    # One integer encodes the object, and the row and the column of the square.
    group_key = row_packets.object_index
    for coordinate in hits.samples.get_positions(hits.sample_index.take(first_hit)):
        square_coordinate = (coordinate / square_width).astype(np.intp)
        square_coordinate -= square_coordinate.min()
        group_key = group_key * (square_coordinate.max() + 1) + square_coordinate
    order = group_key.argsort(kind="stable")
    depth = hits.from_eye[2].take(first_hit)
    depth_layer = assign_depth_layers(hits.scene.frame, depth, square_width)
    row_packets = Packets._make(field.take(order, axis=-1) for field in row_packets)
    first_child, child_count = find_runs(group_key[order], depth_layer[order])
    return _merge_row_packets(row_packets, first_child, child_count), row_packets


def _compute_bounding_spheres(
    hits: Hits, first_hit: Shaped[Ints, "packets"]
) -> tuple[Shaped[Floats, "3 packets"], Shaped[Floats, "packets"]]:
    """Compute the centre and radius of a bounding sphere for each group of consecutive hits.

    A group ends before the first hit of the next group.
    """
    if hits.scene.are_rows_bounded_by_ends and not isinstance(hits.samples, Scattered):
        # On usual pictures, this takes 0.8 times the time that the minima and maxima would take.
        last_hit = np.append(first_hit[1:], hits.from_eye.shape[1]) - 1
        corner = hits.from_eye.take(first_hit, axis=1)
        opposite_corner = hits.from_eye.take(last_hit, axis=1)
    else:
        # The sphere encloses the bounding box of the hits.
        corner = np.minimum.reduceat(hits.from_eye, first_hit, axis=1)
        opposite_corner = np.maximum.reduceat(hits.from_eye, first_hit, axis=1)
    half_diagonal = 0.5 * (opposite_corner - corner)
    center = hits.scene.frame.point_to_scene(take(corner + half_diagonal, slice(None)))
    return np.array(center), np.sqrt((half_diagonal * half_diagonal).sum(axis=0))


def _merge_row_packets(
    row_packets: Packets, first_child: Shaped[Ints, "squares"], child_count: Shaped[Ints, "squares"]
) -> Packets:
    """Merge consecutive row packets into square packets."""
    low_corner, high_corner = (
        extremum.reduceat(row_packets.center, first_child, axis=1)
        for extremum in (np.minimum, np.maximum)
    )
    center = 0.5 * (low_corner + high_corner)
    center_offset = row_packets.center - center.repeat(child_count, axis=1)
    needed_radius = np.sqrt((center_offset * center_offset).sum(axis=0)) + row_packets.radius
    return Packets(
        object_index=row_packets.object_index[first_child],
        child_start=first_child,
        child_count=child_count,
        center=center,
        radius=np.maximum.reduceat(needed_radius, first_child),
        may_be_lit=np.logical_or.reduceat(row_packets.may_be_lit, first_child, axis=1),
    )
