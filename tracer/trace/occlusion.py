"""Shadows: which lights reach which hits, and where shadows have edges.

`packets` finds the candidates: objects that may block the segment from a hit to a light.  An exact
test, `Shape.occludes`, then decides about each of them.

For antialiasing, the test is repeated with each object grown and shrunk.  The *footprint* of a hit
is the part of the surface that is visible in a cell of the picture (a pixel or a square part of a
pixel).  The grown and the shrunk object show whether a shadow covers a footprint, or has an edge
there.
"""

from __future__ import annotations

from typing import Annotated as Shaped
from typing import NamedTuple

import numpy as np

from tracer.arrays import (
    BATCH_SIZE,
    Bools,
    Floats,
    Ints,
    find_runs,
    put_2d,
    sort_distinct,
    take,
    take_2d,
)
from tracer.geometry.rounding import ON
from tracer.geometry.shape import Shape
from tracer.trace.hits import Hits
from tracer.trace.packets import find_candidates
from tracer.world.prepared_scene import Lights

# Maximum number of shadow edges that are collected before duplicates are removed: it limits memory.
_EDGES_PER_BATCH = 8 * BATCH_SIZE

# Maximum number of shadow edges of one light near a hit.  If there are more, some are omitted.
_MAX_EDGES_PER_HIT = 64


def find_shadows(
    hits: Hits, lights: Lights, faces_light: Shaped[Bools, "lights n"]
) -> Shaped[Bools, "lights n"]:
    """Test whether an object blocks the segment from each hit to each light.

    The result is meaningless where the surface does not face the light.  The object on which a hit
    lies is not tested: objects are convex, so it blocks no light that its surface faces.
    """
    is_blocked = np.zeros(faces_light.shape, dtype=np.bool_)
    for candidates in find_candidates(hits, lights, faces_light):
        is_blocking = _test_blocking(hits, lights, candidates.shape, candidates.triples)
        light_index, hit_index, _ = candidates.triples[:, is_blocking]
        put_2d(is_blocked, light_index, hit_index, True)
        shaded_light, shaded_hit = candidates.shaded_pairs
        put_2d(is_blocked, shaded_light, shaded_hit, True)
    return is_blocked


class ShadowEdges(NamedTuple):
    """Which hits are in shadow, and the visible shadow edges that may cross their footprints."""

    # Whether an object other than the hit's own blocks the segment from the hit to the light;
    # meaningless where the surface does not face the light.
    is_blocked: Shaped[Bools, "lights n"]
    # Indices of lights, of hits, and of objects that cast shadows, sorted in this order.
    edges: Shaped[Ints, "3 k"]
    # Whether edges near the hit are missing in `edges`, because one light has too many there.
    is_crowded: Shaped[Bools, "n"]


def find_shadow_edges(
    hits: Hits,
    lights: Lights,
    faces_light: Shaped[Bools, "lights n"],
    footprint_radius: Shaped[Floats, "n"],
) -> ShadowEdges:
    """Test which hits are in shadow, and find the shadow edges that may cross their footprints.

    Edges are not visible, and are skipped, where a single object shades the whole footprint from
    the same light, and where the surface does not face the light.
    """
    is_blocked, is_covered = np.zeros((2, *faces_light.shape), dtype=np.bool_)
    light_count, hit_count = faces_light.shape
    edge_set = _EdgeSet(light_count, hit_count, hits.scene.position_error.size)
    for candidates in find_candidates(hits, lights, faces_light, footprint_radius):
        triples = candidates.triples
        test = _test_footprints(hits, lights, candidates.shape, triples, footprint_radius)
        light_index, hit_index, _ = triples
        put_2d(is_blocked, light_index[test.is_blocking], hit_index[test.is_blocking], True)
        put_2d(is_covered, light_index[test.is_covering], hit_index[test.is_covering], True)
        shaded_light, shaded_hit = candidates.shaded_pairs
        put_2d(is_covered, shaded_light, shaded_hit, True)
        is_facing = take_2d(faces_light, light_index, hit_index)
        edge_set.add(triples[:, test.has_edge & is_facing])
    edges = edge_set.get_edges()
    is_visible = ~take_2d(is_covered, edges[0], edges[1])
    return ShadowEdges(
        is_blocked=is_blocked | is_covered,
        edges=edges[:, is_visible],
        is_crowded=np.any(edge_set.is_crowded & ~is_covered, axis=0),
    )


class _EdgeSet:
    """A set of shadow edges: triples of a light, a hit, and an object that casts a shadow near it.

    A pair of a light and a hit is *crowded* if it has more than `_MAX_EDGES_PER_HIT` edges.  The
    set marks the pairs that are found to be crowded, and drops their edges.
    """

    is_crowded: Shaped[Bools, "lights hits"]

    def __init__(self, light_count: int, hit_count: int, object_count: int) -> None:
        self.is_crowded = np.zeros((light_count, hit_count), dtype=np.bool_)
        # One integer key encodes the three indices of an edge.
        self._index_counts = light_count, hit_count, object_count
        # The keys of the first batch are distinct and sorted.
        self._key_batches = [np.zeros(0, dtype=np.intp)]

    def add(self, edges: Shaped[Ints, "3 n"]) -> None:
        """Add edges, unless they are in the set already or their pair is marked as crowded."""
        is_kept = ~take_2d(self.is_crowded, edges[0], edges[1])
        self._key_batches.append(np.ravel_multi_index(tuple(edges[:, is_kept]), self._index_counts))
        if sum(batch.size for batch in self._key_batches[1:]) > _EDGES_PER_BATCH:
            self._merge_batches()

    def get_edges(self) -> Shaped[Ints, "3 n"]:
        """Return all edges, sorted by light, then by hit, then by object."""
        self._merge_batches()
        return np.array(np.unravel_index(self._key_batches[0], self._index_counts))

    def _merge_batches(self) -> None:
        """Remove duplicates; then mark crowded pairs, and remove their edges."""
        keys = sort_distinct(np.concatenate(self._key_batches))
        object_count = self._index_counts[2]
        pair_key = keys // object_count  # encodes the light and the hit
        pair_start, edge_count = find_runs(pair_key)
        is_pair_crowded = edge_count > _MAX_EDGES_PER_HIT
        self.is_crowded.ravel()[pair_key[pair_start[is_pair_crowded]]] = True
        self._key_batches = [keys[~is_pair_crowded.repeat(edge_count)]]


class _FootprintTest(NamedTuple):
    """How the shadows of n objects, each from one light, meet the footprints of hits."""

    is_blocking: Shaped[Bools, "n"]  # the object blocks the segment from the hit to the light
    is_covering: Shaped[Bools, "n"]  # the shadow covers the footprint
    has_edge: Shaped[Bools, "n"]  # the edge of the shadow may cross the footprint


def _test_footprints(
    hits: Hits,
    lights: Lights,
    shape: Shape,
    triples: Shaped[Ints, "3 k"],
    footprint_radius: Shaped[Floats, "n"],
) -> _FootprintTest:
    """Test how the shadow of each triple's object meets the footprint of the triple's hit.

    A triple consists of a light, a hit and an object.  The object is grown and shrunk by the radius
    of the footprint.  The first row that applies tells what its shadow does:

    ==================  =======================================================================
    shadow              condition
    ==================  =======================================================================
    covers it           The unchanged and the shrunk object block the segment, and the light is
                        not on the surface of the object.
    may have an edge    The grown object blocks the segment, or the distance of the light from
                        the surface of the object is at most the radius of the footprint.
    does not reach it   otherwise
    ==================  =======================================================================
    """
    light_index, hit_index, object_index = triples
    # If the object shades any part of the footprint, the grown object shades the hit.
    growth = footprint_radius[hit_index]
    grown_object_blocks = _test_blocking(hits, lights, shape, triples, growth)
    light_distance = shape.measure_distance(object_index, take(lights.position.T, light_index))
    is_blocking = _test_blocking(hits, lights, shape, triples)
    # The object shades the whole footprint if the shrunk object blocks the segment, too.  A test of
    # the shrunk object does not suffice, because the hit may lie between the two surfaces.
    is_covering = is_blocking & _test_blocking(hits, lights, shape, triples, -growth)
    # A light on the object's surface illuminates only one side of the tangent plane there, and this
    # plane may cross the footprint.
    is_covering &= take_2d(lights.side, light_index, object_index) != ON
    has_edge = ~is_covering & (grown_object_blocks | (np.abs(light_distance) <= growth))
    return _FootprintTest(is_blocking=is_blocking, is_covering=is_covering, has_edge=has_edge)


def _test_blocking(
    hits: Hits,
    lights: Lights,
    shape: Shape,
    triples: Shaped[Ints, "3 k"],
    growth: Shaped[Floats, "k"] | None = None,
) -> Shaped[Bools, "k"]:
    """Test, for each triple of a light, a hit and an object, whether the object blocks the light.

    Each object is grown by `growth` before the test; a negative distance shrinks it.
    """
    light_index, hit_index, object_index = triples
    light_position = take(lights.position.T, light_index)
    light_side = take_2d(lights.side, light_index, object_index)
    hit_position = hits.get_points(hit_index)
    return shape.occludes(object_index, hit_position, light_position, light_side, growth)
