"""Which objects may block the light at hits?  They are found for many hits at a time.

Testing every object for every hit and every light would take too long.  So neighbouring hits on one
object form a *packet*, with a bounding sphere.  The segments from the hits of a packet to a light
lie in a capsule: around the segment from the centre of the sphere to the light, with the radius of
the sphere (Haines and Wallace, Shaft culling, 1991).

- An object that misses the capsule shades no hit of the packet.
- An object that cuts right through the capsule shades all hits of the packet.  Then no other object
  has to be tested with the packet: for a heap of 1,000 balls in the shadow of one large ball, this
  saves a third of the time.
- Any other object is a *candidate*, which may shade some of the hits.

Packets form a hierarchy of one or two levels.  *Row packets* contain hits that are consecutive in
one row of samples.  If objects are large in the picture, *square packets* contain row packets.  The
light grid lists candidates for the largest packets.  Capsule tests then exclude objects, first for
these packets and then for the packets in them.

An object is excluded only if it certainly shades no hit of the packet, or if a single object
certainly shades all hits.  So shadows are those that a test of every object would find.
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
    split_by_size,
    take,
    take_2d,
)
from tracer.geometry.shape import Shape
from tracer.trace.hits import Hits
from tracer.trace.packet_size import assign_depth_layers, compute_samples_per_side
from tracer.trace.samples import Scattered
from tracer.world.light_grid import LightGrid
from tracer.world.prepared_scene import Lights

# Maximum number of packets in one query of the light grid: it limits memory.
_PACKETS_PER_QUERY = BATCH_SIZE // 4

# Maximum number of hits in a row packet.  Tuned on six scenes of 4 to 1,000 objects: with half of
# it, rendering takes 1.08 times as long; with twice as many, the time is within 4 %.
_MAX_ROW_HITS = 6

# Square packets are built if they would have at least this side, in samples.  Tuned on the same
# scenes: with twice the side, rendering takes 1.12 times as long; with half, it is within 4 %.
_MIN_SQUARE_SIDE = 6

# Maximum side of a square packet, in samples.  Tuned on the same scenes: with half of it, rendering
# takes 1.07 times as long; with twice the side, the time is within 4 %.
_MAX_SQUARE_SIDE = 16


class Candidates(NamedTuple):
    """Objects of one shape that may block the light at hits, and hits that are certainly in shadow.

    A hit is certainly in shadow if a single object shades its whole packet.
    """

    shape: Shape
    triples: Shaped[Ints, "3 n"]  # indices of lights, of hits, and of objects between them
    shaded_pairs: Shaped[Ints, "2 k"]  # indices of lights, and of hits that are in shadow


class _Packets(NamedTuple):
    """One level of the hierarchy of packets.

    The children of a row packet are hits.  The children of a square packet are row packets.
    """

    object_index: Shaped[Ints, "packets"]
    # The children have the indices child_start to child_start + child_count - 1.
    child_start: Shaped[Ints, "packets"]
    child_count: Shaped[Ints, "packets"]
    # Bounding spheres, in scene axes.
    center: Shaped[Floats, "3 packets"]
    radius: Shaped[Floats, "packets"]
    # Whether the light may be visible from any hit.  At first this is True if any hit faces the
    # light.  `_test_packets` sets it to False when a single object shades the whole packet.
    may_be_lit: Shaped[Bools, "lights packets"]

    def replace_by_children(self, packet_columns: Shaped[Ints, "rows n"]) -> Shaped[Ints, "rows k"]:
        """Repeat each column for every child of the packet whose index is in row 1.

        In the result, row 1 contains the indices of the children.
        """
        packet_index = packet_columns[1]
        child_count, child_start = self.child_count[packet_index], self.child_start[packet_index]
        parent_column, child_index = enumerate_ranges(child_count, child_start)
        child_columns = packet_columns.take(parent_column, axis=1)
        child_columns[1] = child_index
        return child_columns


def find_candidates(
    hits: Hits,
    lights: Lights,
    faces_light: Shaped[Bools, "lights n"],
    margin: Shaped[Floats, "n"] | None = None,
) -> Iterator[Candidates]:
    """Find, in batches, the objects that may block the light at each hit.

    Parameters
    ----------
    faces_light
        Whether the surface faces the light.  Objects may be missing where it does not.
    margin
        Distance from each hit within which the result holds for all points; 0 by default.
    """
    if lights.grid is None or not faces_light.any():
        return
    levels = _build_levels(hits, faces_light, margin)
    for shape, triples in _query_grid(lights.grid, levels[0], hits.scene.shapes):
        shaded_pairs = np.zeros((2, 0), dtype=np.intp)
        # Row 1 contains indices of the largest packets at first, and of hits at last.
        for packets in levels:
            triples, shaded_packets = _test_packets(packets, lights, shape, triples)
            triples = packets.replace_by_children(triples)
            shaded_pairs = np.concatenate([shaded_pairs, shaded_packets], axis=1)
            shaded_pairs = packets.replace_by_children(shaded_pairs)
        yield Candidates(shape=shape, triples=triples, shaded_pairs=shaded_pairs)


def _query_grid(
    grid: LightGrid, packets: _Packets, shapes: Iterable[Shape]
) -> Iterator[tuple[Shape, Shaped[Ints, "3 n"]]]:
    """Find the objects that may lie between packets (groups of hits) and lights.

    Yields, in batches, a shape with indices of lights in row 0, of packets in row 1, and of objects
    of this shape in row 2.  Lights and packets are skipped where `packets.may_be_lit` is False.
    """
    for first_packet in range(0, packets.object_index.size, _PACKETS_PER_QUERY):
        packet_slice = slice(first_packet, first_packet + _PACKETS_PER_QUERY)
        found = grid.query(
            packets.center[:, packet_slice],
            packets.radius[packet_slice],
            packets.object_index[packet_slice],
            packets.may_be_lit[:, packet_slice],
        )
        for triples in found:
            triples[1] += first_packet
            for shape in shapes:
                group = triples.take(find(shape.objects.contains(triples[2])), axis=1)
                for batch in split_by_size(packets.child_count[group[1]]):
                    yield shape, group[:, batch]


def _test_packets(
    packets: _Packets, lights: Lights, shape: Shape, candidates: Shaped[Ints, "3 k"]
) -> tuple[Shaped[Ints, "3 remaining"], Shaped[Ints, "2 shaded"]]:
    """Test which objects shade all hits in a packet (a group of hits), and which may shade some.

    Where an object shades all hits, `packets.may_be_lit` is set to False.

    Parameters
    ----------
    candidates
        Indices of lights, of packets, and of objects of the given shape.

    Returns
    -------
    remaining_candidates
        The candidates whose object may shade some hits of the packet, except where a single object
        shades all of them.
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
    remains = may_block & take_2d(packets.may_be_lit, light_index, packet_index)
    return candidates.take(find(remains), axis=1), shaded_packets


def _build_levels(
    hits: Hits, faces_light: Shaped[Bools, "lights n"], margin: Shaped[Floats, "n"] | None
) -> list[_Packets]:
    """Group neighbouring hits into row packets, and these into square packets if objects are large.

    Returns the level of the largest packets first.  The bounding spheres contain all points that
    are at most `margin` away from a hit.
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
) -> _Packets:
    """Divide each run of hits into row packets of `max_hits` hits; the last one may have fewer.

    The packets have the order of the hits.
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
    return _Packets(
        object_index=object_index,
        child_start=first_hit,
        child_count=np.minimum(run_length[run_index] - offset_in_run, max_hits),
        center=center,
        radius=radius,
        may_be_lit=np.logical_or.reduceat(faces_light, first_hit, axis=1),
    )


def _build_square_packets(
    hits: Hits, row_packets: _Packets, square_width: float
) -> tuple[_Packets, _Packets]:
    """Group row packets into square packets; return the square packets and then the row packets.

    The row packets of a square packet lie on the same object, in the same square of the picture,
    and at similar depths.  A square is `square_width` pixels wide.  The row packets are sorted, so
    that those of each square packet are consecutive.
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
    row_packets = _Packets._make(field.take(order, axis=-1) for field in row_packets)
    first_child, child_count = find_runs(group_key[order], depth_layer[order])
    return _merge_row_packets(row_packets, first_child, child_count), row_packets


def _compute_bounding_spheres(
    hits: Hits, first_hit: Shaped[Ints, "packets"]
) -> tuple[Shaped[Floats, "3 packets"], Shaped[Floats, "packets"]]:
    """Compute the centre, in scene axes, and the radius of a bounding sphere for each row packet.

    A packet ends before the first hit of the next packet.
    """
    if hits.scene.are_rows_bounded_by_ends and not isinstance(hits.samples, Scattered):
        # The sphere around the first and the last hit contains all hits of the packet (see
        # `Shape.are_rows_bounded_by_ends`).  On usual pictures, finding it takes 0.8 times the time
        # that the minima and maxima would take.
        last_hit = np.append(first_hit[1:], hits.from_eye.shape[1]) - 1
        corner = hits.from_eye.take(first_hit, axis=1)
        opposite_corner = hits.from_eye.take(last_hit, axis=1)
    else:
        # The sphere contains the bounding box of the hits.
        corner = np.minimum.reduceat(hits.from_eye, first_hit, axis=1)
        opposite_corner = np.maximum.reduceat(hits.from_eye, first_hit, axis=1)
    half_diagonal = 0.5 * (opposite_corner - corner)
    center = hits.scene.frame.point_to_scene(take(corner + half_diagonal, slice(None)))
    return np.array(center), np.sqrt((half_diagonal * half_diagonal).sum(axis=0))


def _merge_row_packets(
    row_packets: _Packets,
    first_child: Shaped[Ints, "squares"],
    child_count: Shaped[Ints, "squares"],
) -> _Packets:
    """Merge consecutive row packets into square packets.

    Each square packet consists of `child_count` row packets, of which `first_child` is the first.
    """
    low_corner, high_corner = (
        extremum.reduceat(row_packets.center, first_child, axis=1)
        for extremum in (np.minimum, np.maximum)
    )
    center = 0.5 * (low_corner + high_corner)
    center_offset = row_packets.center - center.repeat(child_count, axis=1)
    needed_radius = np.sqrt((center_offset * center_offset).sum(axis=0)) + row_packets.radius
    return _Packets(
        object_index=row_packets.object_index[first_child],
        child_start=first_child,
        child_count=child_count,
        center=center,
        radius=np.maximum.reduceat(needed_radius, first_child),
        may_be_lit=np.logical_or.reduceat(row_packets.may_be_lit, first_child, axis=1),
    )
