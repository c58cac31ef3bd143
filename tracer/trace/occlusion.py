"""Shadows: which lights reach which hits, and where shadows have edges.

The problem is to avoid testing every object for every hit and every light.  Four private concepts
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
crowded
    A hit is crowded if more than `_MAX_EDGES_PER_HIT` shadow edges of one light may cross its
    footprint.

An object that misses the capsule of a packet shades no hit of the packet.  An object that cuts
right through the capsule shades all hits of the packet (Haines and Wallace, Shaft culling, 1991).
Then no other object has to be tested with the packet: for 5,000 balls under a roof, at 16 samples
per pixel, this halves the time.

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
    split_by_size,
    take,
    take_2d,
)
from tracer.geometry.rounding import ON
from tracer.geometry.shape import Shape
from tracer.trace.hits import Hits
from tracer.world.light_grid import LightGrid
from tracer.world.prepared_scene import Lights

# Maximum number of packets in one query of the light grid, and maximum number of shadow edges that
# are collected before duplicates are removed.  Both limit memory.
_PACKETS_PER_QUERY, _EDGES_PER_BATCH = BATCH_SIZE // 4, 8 * BATCH_SIZE

# A hit with more shadow edges of one light than this is crowded.
_MAX_EDGES_PER_HIT = 64

# Maximum number of hits in a row packet; minimum and maximum side of a square packet, in samples.
# Tuned on six scenes of 4 to 1,000 objects: the factors 1/2, 2 and 1/2 make rendering take 1.08,
# 1.12 and 1.07 times as long; the opposite factors are within 4 %.
_MAX_ROW_HITS, _MIN_SQUARE_SIDE, _MAX_SQUARE_SIDE = 6, 6, 16


class Packets(NamedTuple):
    """One level of the packet hierarchy: m packets, each of neighbouring hits on one object.

    The children of a row packet are hits.  The children of a square packet are row packets.

    Attributes
    ----------
    object_index : (m,) int array
        Index of the object on which all hits of the packet lie.
    child_start, child_count : (m,) int arrays
        The children of each packet have the indices child_start to child_start + child_count - 1.
    center : (3, m) float array
        Centre of each packet's bounding sphere, in scene axes.
    radius : (m,) float array
        Radius of each packet's bounding sphere, which contains the footprints of all its hits.
    may_be_lit : (lights, m) bool array
        Whether the light may be visible from any hit of the packet.  At first this is True if any
        hit of the packet faces the light.  `_find_occluders` sets it to False when a single object
        shades the whole packet.
    """

    object_index: Ints
    child_start: Ints
    child_count: Ints
    center: Floats
    radius: Floats
    may_be_lit: Bools

    def replace_by_children(self, packet_columns: Ints) -> Ints:
        """Replace the index of each packet with the indices of its children.

        A packet is a group of neighbouring hits.  Its children are hits or smaller packets.

        Parameters
        ----------
        packet_columns : (2, k) or (3, k) int array
            Row 0 contains light indices, row 1 packet indices, and row 2, if any, object indices.

        Returns
        -------
        child_columns : (2, j) or (3, j) int array
            Each column, repeated for every child of its packet.  Row 1 contains the indices of the
            children.
        """
        packet_index = packet_columns[1]
        child_count, child_start = self.child_count[packet_index], self.child_start[packet_index]
        parent_column, child_index = enumerate_ranges(child_count, child_start)
        child_columns = packet_columns.take(parent_column, axis=1)
        child_columns[1] = child_index
        return child_columns


def _find_occluders(
    hits: Hits, lights: Lights, faces_light: Bools, margin: Floats | None = None
) -> Iterator[tuple[Shape, Ints, Ints]]:
    """Find, in batches, the objects that may block the light at each hit.

    Some hits are certainly in shadow, because a single object shades their whole packet (a group of
    neighbouring hits).  These hits are yielded separately.

    Parameters
    ----------
    hits : Hits
        The n hits that may be in shadow.
    lights : Lights
        The lights that cast the shadows.
    faces_light : (lights, n) bool array
        Whether the surface at the hit faces the light.  Where it does not, occluders may be
        skipped.
    margin : (n,) float array, optional
        If given, also find objects that may block the light at any surface point within this
        distance of the hit.

    Yields
    ------
    shape : Spheres or Boxes
        The shape of all objects in the batch.
    candidates : (3, k) int array
        Row 0 contains light indices, row 1 hit indices, and row 2 indices of objects that may block
        the segment from the hit to the light.
    shaded_pairs : (2, j) int array
        Row 0 contains light indices, and row 1 indices of hits that are certainly in shadow.  The
        same holds for all surface points within `margin` of these hits.
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
        yield shape, candidates, shaded_pairs


def _query_grid(
    grid: LightGrid, packets: Packets, shapes: Iterable[Shape]
) -> Iterator[tuple[Shape, Ints]]:
    """Find the objects that may lie between packets and lights, in batches.

    A packet is a group of neighbouring hits with a bounding sphere.

    Parameters
    ----------
    grid : LightGrid
        Lists of objects by their direction from each light.
    packets : Packets
        The packets.  Pairs of a light and a packet are skipped if `packets.may_be_lit` is False.
    shapes : iterable of Spheres and Boxes
        All objects, grouped by shape.

    Yields
    ------
    shape : Spheres or Boxes
        The shape of all objects in the batch.
    candidates : (3, k) int array
        Row 0 contains light indices, row 1 packet indices, and row 2 indices of objects that may
        lie between the packet and the light.
    """
    for first_packet in range(0, packets.object_index.size, _PACKETS_PER_QUERY):
        packet_slice = slice(first_packet, first_packet + _PACKETS_PER_QUERY)
        center, radius = packets.center[:, packet_slice], packets.radius[packet_slice]
        owner, is_active = packets.object_index[packet_slice], packets.may_be_lit[:, packet_slice]
        for candidates in grid.query(center, radius, owner, is_active):
            candidates[1] += first_packet
            for shape in shapes:
                group = candidates.take(find(shape.objects.contains(candidates[2])), axis=1)
                for batch in split_by_size(packets.child_count[group[1]]):
                    yield shape, group[:, batch]


def _test_packets(
    packets: Packets, lights: Lights, shape: Shape, candidates: Ints
) -> tuple[Ints, Ints]:
    """Test which objects shade all hits of a packet, and which may shade some.

    A packet is a group of neighbouring hits.  The segments from these hits to a light lie in a
    capsule.  An object that misses the capsule shades no hit of the packet.  An object that cuts
    right through the capsule shades all hits, and `packets.may_be_lit` is set to False.

    Parameters
    ----------
    packets : Packets
        The packets.
    lights : Lights
        The lights.
    shape : Spheres or Boxes
        The shape of all objects in `candidates`.
    candidates : (3, k) int array
        Row 0 contains light indices, row 1 packet indices, and row 2 object indices.

    Returns
    -------
    undecided_candidates : (3, j) int array
        The columns of `candidates` whose object may shade some hits of the packet.  Packets that a
        single object shades entirely are excluded.
    shaded_packets : (2, i) int array
        Row 0 contains light indices, and row 1 indices of packets that an object shades entirely.
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
    """A set of shadow edges without duplicates.

    A shadow edge is a triple of a light, a hit and an occluder: the edge of the occluder's shadow
    may pass near the hit.  The set encodes each triple as one integer key.

    Parameters
    ----------
    counts : (int, int, int)
        Total numbers of lights, hits and objects.

    Attributes
    ----------
    is_crowded : (lights, hits) bool array
        Whether the hit has more than `_MAX_EDGES_PER_HIT` edges of the light.  The set does not
        keep the edges of such a (light, hit) pair.
    """

    def __init__(self, counts: tuple[int, int, int]) -> None:
        self.is_crowded = np.zeros(counts[:2], dtype=np.bool_)
        self._counts, self._key_batches = counts, [np.zeros(0, dtype=np.intp)]

    def add(self, edges: Ints) -> None:
        """Add shadow edges to the set.

        A (light, hit) pair is crowded if it has more than `_MAX_EDGES_PER_HIT` edges.  Edges of
        pairs that are already marked as crowded are not added.

        Parameters
        ----------
        edges : (3, k) int array
            Row 0 contains light indices, row 1 hit indices, and row 2 occluder indices.  Duplicates
            are allowed.
        """
        is_kept = ~take_2d(self.is_crowded, edges[0], edges[1])
        self._key_batches.append(np.ravel_multi_index(tuple(edges[:, is_kept]), self._counts))
        if sum(batch.size for batch in self._key_batches[1:]) > _EDGES_PER_BATCH:
            self._merge_batches()

    def get_edges(self) -> Ints:
        """Return all shadow edges in the set, sorted by light, then by hit, then by occluder.

        A shadow edge is a triple of a light, a hit, and an occluder whose shadow may end near the
        hit.  Edges of (light, hit) pairs with more than `_MAX_EDGES_PER_HIT` edges are excluded.

        Returns
        -------
        edges : (3, m) int array
            Row 0 contains light indices, row 1 hit indices, and row 2 occluder indices.
        """
        self._merge_batches()
        return np.array(np.unravel_index(self._key_batches[0], self._counts))

    def _merge_batches(self) -> None:
        """Merge all batches of keys into one sorted batch without duplicates.

        A key encodes an edge (a light, a hit and an occluder) as one integer.  If a (light, hit)
        pair has more than `_MAX_EDGES_PER_HIT` edges, its keys are removed and `is_crowded` is set.
        """
        keys = np.unique(np.concatenate(self._key_batches))
        pair_key = keys // self._counts[2]  # encodes the light and the hit
        pair_start, edge_count = find_runs(pair_key)
        is_pair_crowded = edge_count > _MAX_EDGES_PER_HIT
        self.is_crowded.ravel()[pair_key[pair_start[is_pair_crowded]]] = True
        self._key_batches = [keys[~is_pair_crowded.repeat(edge_count)]]


def find_shadows(hits: Hits, lights: Lights, faces_light: Bools) -> Bools:
    """Test whether each hit is in the shadow of another object, for each light.

    The object on which a hit lies is not tested.  All objects are convex, so it can only block
    lights that its surface does not face at the hit.

    Parameters
    ----------
    hits : Hits
        The n hits that may be in shadow.
    lights : Lights
        The lights that cast the shadows.
    faces_light : (lights, n) bool array
        Whether the surface at the hit faces the light.

    Returns
    -------
    is_blocked : (lights, n) bool array
        Whether an object blocks the straight segment from the hit to the light; meaningless where
        `faces_light` is False.
    """
    is_blocked = np.zeros(faces_light.shape, dtype=np.bool_)
    for shape, candidates, shaded_pairs in _find_occluders(hits, lights, faces_light):
        light_index, hit_index, _ = candidates[:, _test_blocking(hits, lights, shape, candidates)]
        put_2d(is_blocked, light_index, hit_index, True)
        put_2d(is_blocked, shaded_pairs[0], shaded_pairs[1], True)
    return is_blocked


def find_shadow_edges(
    hits: Hits, lights: Lights, faces_light: Bools, radius: Floats
) -> tuple[Bools, Ints, Bools]:
    """Test which hits are in shadow, and find the visible shadow edges near each hit.

    The footprint of a hit is the part of the surface around it that is visible in one cell of the
    picture (a pixel or a part of it).  Shadow edges that may cross the footprint are found, unless
    a single object shades the whole footprint from the same light.

    Parameters
    ----------
    hits : Hits
        The n hits that may be in shadow.
    lights : Lights
        The lights that cast the shadows.
    faces_light : (lights, n) bool array
        Whether the surface at the hit faces the light.
    radius : (n,) float array
        Radius of each footprint, in the scene's unit of length.

    Returns
    -------
    is_blocked : (lights, n) bool array
        Whether an object other than the hit's own blocks the segment from the hit to the light;
        meaningless where `faces_light` is False.
    edges : (3, m) int array
        The visible edges, sorted by light, then by hit, then by occluder.  Row 0 contains light
        indices, row 1 hit indices, and row 2 occluder indices.  Some edges of crowded hits (see
        `is_crowded`) are omitted.
    is_crowded : (n,) bool array
        Whether the hit has more than `_MAX_EDGES_PER_HIT` visible edges of a single light.
    """
    is_blocked, is_covered = np.zeros((2, *faces_light.shape), dtype=np.bool_)
    edge_set = _EdgeSet((*faces_light.shape, hits.scene.position_error.size))
    for shape, candidates, shaded_pairs in _find_occluders(hits, lights, faces_light, radius):
        is_blocking, is_covering, has_edge = _test_footprints(
            hits, lights, shape, candidates, radius
        )
        put_2d(is_blocked, candidates[0, is_blocking], candidates[1, is_blocking], True)
        put_2d(is_covered, candidates[0, is_covering], candidates[1, is_covering], True)
        put_2d(is_covered, shaded_pairs[0], shaded_pairs[1], True)
        edge_set.add(candidates[:, has_edge & take_2d(faces_light, candidates[0], candidates[1])])
    edges = edge_set.get_edges()
    is_visible = ~take_2d(is_covered, edges[0], edges[1])
    is_crowded = np.any(edge_set.is_crowded & ~is_covered, axis=0)
    return is_blocked | is_covered, edges[:, is_visible], is_crowded


def _test_footprints(
    hits: Hits, lights: Lights, shape: Shape, candidates: Ints, footprint_radius: Floats
) -> tuple[Bools, Bools, Bools]:
    """Test whether the object of each candidate shades all or part of the footprint of its hit.

    The footprint of a hit is the part of the surface around it that is visible in one cell of the
    picture.  If the object shades only part of it, the edge of the shadow crosses the footprint.

    Parameters
    ----------
    hits, lights : Hits, Lights
        All hits and all lights.
    shape : Spheres or Boxes
        The shape of all objects in `candidates`.
    candidates : (3, k) int array
        Triples to test.  Row 0 contains light indices, row 1 hit indices, and row 2 object indices.
    footprint_radius : (n,) float array
        Radius of the footprint of each hit, in the scene's unit of length.

    Returns
    -------
    is_blocking : (k,) bool array
        Whether the object blocks the segment from the hit to the light.
    is_covering : (k,) bool array
        Whether the object shades the whole footprint.
    has_edge : (k,) bool array
        Whether the edge of the object's shadow may cross the footprint.
    """
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
    return is_blocking, is_covering, has_edge


def _test_blocking(
    hits: Hits, lights: Lights, shape: Shape, candidates: Ints, growth: Floats | None = None
) -> Bools:
    """Test whether the object of each candidate blocks the segment from its hit to its light.

    A candidate is a triple of a light, a hit and an object.

    Parameters
    ----------
    hits, lights : Hits, Lights
        All hits and all lights.
    shape : Spheres or Boxes
        The shape of all objects in `candidates`.
    candidates : (3, k) int array
        Triples to test.  Row 0 contains light indices, row 1 hit indices, and row 2 object indices.
    growth : (k,) float array, optional
        Distance by which to grow each object before the test; a negative distance shrinks it.

    Returns
    -------
    is_blocking : (k,) bool array
        Whether the object blocks the segment from the hit to the light.
    """
    light_index, hit_index, object_index = candidates
    light_position = take(lights.position.T, light_index)
    light_side = take_2d(lights.side, light_index, object_index)
    hit_position = hits.get_points(hit_index)
    return shape.occludes(object_index, hit_position, light_position, light_side, growth)


def build_packet_levels(hits: Hits, faces_light: Bools, margin: Floats | None) -> list[Packets]:
    """Group neighbouring hits into packets, on one or two levels.

    A packet is a group of neighbouring hits on one object, with a bounding sphere.  The hits of a
    row packet are consecutive in one row of samples.  A square packet consists of row packets.
    Square packets are built only if objects are large in the picture.

    Parameters
    ----------
    hits : Hits
        The n hits to group.
    faces_light : (lights, n) bool array
        Whether the surface at the hit faces the light.
    margin : (n,) float array or None
        If given, bounding spheres contain all points within this distance of each hit.

    Returns
    -------
    levels : list of Packets
        Either [row packets] or [square packets, row packets].
    """
    samples_across_packet = hits.scene.packet_width * hits.samples.per_pixel_side
    max_row_hits = int(min(max(samples_across_packet, 1), _MAX_ROW_HITS))
    row_packets = _build_row_packets(hits, faces_light, margin, max_row_hits)
    square_side = int(min(samples_across_packet, _MAX_SQUARE_SIDE))  # in samples
    if square_side < _MIN_SQUARE_SIDE:
        return [row_packets]
    return [*_build_square_packets(hits, row_packets, square_side / hits.samples.per_pixel_side)]


def _build_row_packets(
    hits: Hits, faces_light: Bools, margin: Floats | None, max_hits: int
) -> Packets:
    """Divide runs of hits into row packets of at most `max_hits` hits.

    A run consists of consecutive hits on the same object, in one row of samples.  The last packet
    of a run may have fewer hits than the others.

    Parameters
    ----------
    hits : Hits
        The n hits to divide.
    faces_light : (lights, n) bool array
        Whether the surface at the hit faces the light.
    margin : (n,) float array or None
        If given, bounding spheres contain all points within this distance of each hit.
    max_hits : int
        Maximum number of hits in a packet.

    Returns
    -------
    row_packets : Packets
        The packets, in the order of the hits.  `may_be_lit` is True if the surface at any hit of
        the packet faces the light.
    """
    run_length = np.diff(hits.run_start)
    run_index, offset_in_run = enumerate_ranges(-(-run_length // max_hits))
    offset_in_run *= max_hits
    first_hit = hits.run_start[run_index] + offset_in_run
    hit_count = np.minimum(run_length[run_index] - offset_in_run, max_hits)
    object_index = hits.run_object[run_index]
    may_be_lit = np.logical_or.reduceat(faces_light, first_hit, axis=1)
    center, radius = _compute_bounding_spheres(hits, first_hit)
    radius += hits.scene.position_error[object_index]
    if margin is not None:
        radius += np.maximum.reduceat(margin, first_hit)
    return Packets(object_index, first_hit, hit_count, center, radius, may_be_lit)


def _build_square_packets(
    hits: Hits, row_packets: Packets, square_width: float
) -> tuple[Packets, Packets]:
    """Group row packets into square packets.

    A row packet is a group of hits that are consecutive in one row of samples.  The row packets of
    a square packet lie on the same object, in the same square of the picture, and at similar
    depths.  So the hits of a square packet are close together.

    Parameters
    ----------
    hits : Hits
        The hits to which the row packets refer.
    row_packets : Packets
        Packets of hits that are consecutive in one row of samples.
    square_width : float
        Width and height of the squares, in pixels.

    Returns
    -------
    square_packets : Packets
        Packets whose children are row packets.
    row_packets : Packets
        The row packets, sorted so that the children of each square packet are consecutive.
    """
    first_hit = row_packets.child_start
    # One integer encodes the object, and the row and the column of the square.
    group_key = row_packets.object_index
    for coordinate in hits.samples.get_positions(hits.sample_index.take(first_hit)):
        square_coordinate = (coordinate / square_width).astype(np.intp)
        square_coordinate -= square_coordinate.min()
        group_key = group_key * (square_coordinate.max() + 1) + square_coordinate
    order = group_key.argsort(kind="stable")
    depth_layer = hits.scene.frame.assign_layer(hits.from_eye[2].take(first_hit), square_width)
    row_packets = Packets._make(field.take(order, axis=-1) for field in row_packets)
    first_child, child_count = find_runs(group_key[order], depth_layer[order])
    return _merge_row_packets(row_packets, first_child, child_count), row_packets


def _compute_bounding_spheres(hits: Hits, first_hit: Ints) -> tuple[Floats, Floats]:
    """Compute a bounding sphere for each of m groups of consecutive hits.

    Parameters
    ----------
    hits : Hits
        All hits.  The hits of one group lie on the same object, in the same row of samples.
    first_hit : (m,) int array
        Index of the first hit of each group.  A group ends before the first hit of the next group.

    Returns
    -------
    center : (3, m) float array
        Centres of the spheres, in scene axes.
    radius : (m,) float array
        Radii of the spheres.
    """
    # The sphere encloses the bounding box of the hits.
    corner = np.minimum.reduceat(hits.from_eye, first_hit, axis=1)
    opposite_corner = np.maximum.reduceat(hits.from_eye, first_hit, axis=1)
    half_diagonal = 0.5 * (opposite_corner - corner)
    center = hits.scene.frame.point_to_scene(take(corner + half_diagonal, slice(None)))
    return np.array(center), np.sqrt((half_diagonal * half_diagonal).sum(axis=0))


def _merge_row_packets(row_packets: Packets, first_child: Ints, child_count: Ints) -> Packets:
    """Merge consecutive row packets into square packets.

    A row packet is a group of hits that are consecutive in one row of samples.  The bounding sphere
    of a square packet contains the bounding spheres of its row packets.  A square packet may be
    lit if at least one of its row packets may be lit.

    Parameters
    ----------
    row_packets : Packets
        All row packets, sorted so that those of one square packet are consecutive.
    first_child, child_count : (m,) int arrays
        For each square packet, the index of its first row packet, and the number of row packets.

    Returns
    -------
    square_packets : Packets
        The m square packets.
    """
    low_corner, high_corner = (
        extremum.reduceat(row_packets.center, first_child, axis=1)
        for extremum in (np.minimum, np.maximum)
    )
    center = 0.5 * (low_corner + high_corner)
    center_offset = row_packets.center - center.repeat(child_count, axis=1)
    needed_radius = np.sqrt((center_offset * center_offset).sum(axis=0)) + row_packets.radius
    radius = np.maximum.reduceat(needed_radius, first_child)
    may_be_lit = np.logical_or.reduceat(row_packets.may_be_lit, first_child, axis=1)
    object_index = row_packets.object_index[first_child]
    return Packets(object_index, first_child, child_count, center, radius, may_be_lit)
