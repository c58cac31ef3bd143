"""Objects that may block the light at hits, found for many neighbouring hits at a time.

Testing every object for every hit and every light would take too long.  So neighbouring hits on one
object form a *packet*, with a bounding sphere.  The segments from the hits of a packet to a light
lie in a capsule: around the segment from the center of the sphere to the light, with the radius of
the sphere (Haines and Wallace, Shaft culling, 1991).

- An object that misses the capsule shades no hit of the packet.
- An object that cuts right through the capsule shades all hits of the packet.  Then no other object
  has to be tested with the packet: for a heap of 1,000 balls in the shadow of one large ball, this
  saves a third of the time.
- Any other object is a *candidate*, which may shade some of the hits.

Packets form a hierarchy of one or two levels.  *Row packets* contain hits that are consecutive in
one row of samples.  If objects are large in the picture, *square packets* contain row packets.  The
*children* of a packet are what it contains.  The light grid lists candidates for the largest
packets.  Capsule tests exclude objects, first for these packets, then for their children.

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

# Rows of an array whose columns are *triples*.  A receiver is what may be in the shadow that the
# object casts: a packet, or a hit.  A *pair* consists of the first two rows.
_LIGHT, _RECEIVER, _OBJECT = range(3)


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
    # Whether the light may be visible from any hit.  At first, this is True if any hit faces the
    # light.  It is set to False when a single object is found to shade all hits.
    may_be_lit: Shaped[Bools, "lights packets"]

    def reorder(self, packet_index: Shaped[Ints, "packets"]) -> _Packets:
        """Return the packets in another order."""
        return _Packets._make(field.take(packet_index, axis=-1) for field in self)

    def mark_shaded(self, shaded_pairs: Shaped[Ints, "2 n"]) -> None:
        """Set `may_be_lit` to False for pairs of a light (row 0) and a packet (row 1)."""
        put_2d(self.may_be_lit, shaded_pairs[_LIGHT], shaded_pairs[_RECEIVER], False)

    def drop_unlit(self, triples: Shaped[Ints, "3 n"]) -> Shaped[Ints, "3 k"]:
        """Drop triples (light, packet, object) where no hit of the packet can see the light."""
        may_be_lit = take_2d(self.may_be_lit, triples[_LIGHT], triples[_RECEIVER])
        return triples.take(find(may_be_lit), axis=1)

    def replace_by_children(self, columns: Shaped[Ints, "rows n"]) -> Shaped[Ints, "rows k"]:
        """Replace each column, whose row 1 is a packet, by one column for each child of the packet.

        Row 1 of the result contains the children.  The other rows are repeated.
        """
        packet_index = columns[_RECEIVER]
        child_count, child_start = self.child_count[packet_index], self.child_start[packet_index]
        parent_column, child_index = enumerate_ranges(child_count, child_start)
        child_columns = columns.take(parent_column, axis=1)
        child_columns[_RECEIVER] = child_index
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
        yield _test_levels(levels, lights, shape, triples)


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
            triples[_RECEIVER] += first_packet
            for shape in shapes:
                is_of_shape = shape.objects.contains(triples[_OBJECT])
                shape_triples = triples.take(find(is_of_shape), axis=1)
                for batch in split_by_size(packets.child_count[shape_triples[_RECEIVER]]):
                    yield shape, shape_triples[:, batch]


def _test_levels(
    levels: list[_Packets], lights: Lights, shape: Shape, triples: Shaped[Ints, "3 n"]
) -> Candidates:
    """Test objects with packets (groups of hits) of each level, from the largest to the smallest.

    The triples of a light, a packet of the first level and an object become triples of a light, a
    hit and an object that may shade it.  Where an object shades a whole packet, `may_be_lit` of its
    level is set to False.
    """
    child_triples = triples  # at last, the children are hits
    shaded_children = np.zeros((2, 0), dtype=np.intp)
    for packets in levels:
        # An object in an earlier batch may shade the whole packet.
        packet_triples = packets.drop_unlit(child_triples)
        may_block, blocks_all = _test_capsules(packets, lights, shape, packet_triples)
        shaded_packets = packet_triples[:2].take(find(blocks_all), axis=1)
        packets.mark_shaded(shaded_packets)
        # Another object in this batch may shade the whole packet.
        remaining_triples = packets.drop_unlit(packet_triples.take(find(may_block), axis=1))
        child_triples = packets.replace_by_children(remaining_triples)
        shaded_pairs = np.concatenate([shaded_children, shaded_packets], axis=1)
        shaded_children = packets.replace_by_children(shaded_pairs)
    return Candidates(shape=shape, triples=child_triples, shaded_pairs=shaded_children)


def _test_capsules(
    packets: _Packets, lights: Lights, shape: Shape, triples: Shaped[Ints, "3 n"]
) -> tuple[Shaped[Bools, "n"], Shaped[Bools, "n"]]:
    """Test each object with the capsule around the segments from a packet's hits to a light.

    The rows of `triples` are indices of lights, of packets and of objects.  The results tell
    whether the object may shade any hit, and whether it shades all (see `Shape.test_capsules`).
    """
    light_index, packet_index, object_index = triples
    center, radius = take(packets.center, packet_index), packets.radius[packet_index]
    light_position = take(lights.position.T, light_index)
    return shape.test_capsules(object_index, center, light_position, radius)


def _build_levels(
    hits: Hits, faces_light: Shaped[Bools, "lights n"], margin: Shaped[Floats, "n"] | None
) -> list[_Packets]:
    """Group neighbouring hits into row packets, and these into square packets if objects are large.

    Returns the levels of the hierarchy, from the largest packets to the smallest.  The bounding
    spheres contain all points that are at most `margin` away from a hit.
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

    A run consists of consecutive hits on one object.  The packets have the order of the hits.
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
    group_key = _encode_squares(hits, row_packets, square_width)
    order = group_key.argsort(kind="stable")
    depth = hits.from_eye[2].take(row_packets.child_start)
    depth_layer = assign_depth_layers(hits.scene.frame, depth, square_width)
    first_child, child_count = find_runs(group_key[order], depth_layer[order])
    sorted_packets = row_packets.reorder(order)
    return _merge_row_packets(sorted_packets, first_child, child_count), sorted_packets


def _encode_squares(
    hits: Hits, row_packets: _Packets, square_width: float
) -> Shaped[Ints, "packets"]:
    """Encode the object of each row packet, and the square of its first hit, as one integer.

    Two integers are equal only if both the objects and the squares are the same.  The squares
    divide the picture, and are `square_width` pixels wide.
    """
    key = row_packets.object_index
    for coordinate in hits.samples.get_positions(hits.sample_index.take(row_packets.child_start)):
        # First the column of the square, then its row.
        square_coordinate = (coordinate / square_width).astype(np.intp)
        square_coordinate -= square_coordinate.min()
        key = key * (square_coordinate.max() + 1) + square_coordinate
    return key


def _compute_bounding_spheres(
    hits: Hits, first_hit: Shaped[Ints, "packets"]
) -> tuple[Shaped[Floats, "3 packets"], Shaped[Floats, "packets"]]:
    """Compute the center, in scene axes, and the radius of a bounding sphere for each row packet.

    Packet i contains the hits from first_hit[i] up to, but not including, first_hit[i + 1].
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
    right, down, ahead = corner + half_diagonal
    center = np.array(hits.scene.frame.point_to_scene((right, down, ahead)))
    return center, np.sqrt((half_diagonal * half_diagonal).sum(axis=0))


def _merge_row_packets(
    row_packets: _Packets,
    first_child: Shaped[Ints, "squares"],
    child_count: Shaped[Ints, "squares"],
) -> _Packets:
    """Merge consecutive row packets into square packets.

    Each square packet consists of `child_count` row packets, of which `first_child` is the first.
    """
    low_corner = np.minimum.reduceat(row_packets.center, first_child, axis=1)
    high_corner = np.maximum.reduceat(row_packets.center, first_child, axis=1)
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
