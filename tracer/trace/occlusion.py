"""Shadows: which lights reach which hits, and where shadows have edges.

`packets` finds the candidates: objects that may block the segment from a hit to a light.  An exact
test, `Shape.occludes`, then decides about each of them.

For antialiasing, the *footprint* of a hit matters: the part of the surface that is visible in a
cell of the picture (a pixel or a square part of a pixel).  The test is repeated with each object
grown, and shrunk, by the radius of the footprint.  If the grown object does not block the segment,
its shadow does not reach the footprint.  If the shrunk object blocks it, too, the shadow covers the
footprint.  Otherwise the edge of the shadow may cross the footprint.

A *triple* is a column of three indices: of a light, of a hit, and of an object.  A *pair* consists
of the first two.
"""

from __future__ import annotations

from typing import Annotated as Shaped
from typing import NamedTuple

import numpy as np

from tracer.arrays import Bools, Floats, Ints, put_2d, take, take_2d
from tracer.geometry.rounding import ON
from tracer.geometry.shape import Shape
from tracer.trace.edge_set import EdgeSet
from tracer.trace.hits import Hits
from tracer.trace.packets import find_candidates
from tracer.world.prepared_scene import Lights


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
        _mark(is_blocked, candidates.triples[:2, is_blocking])
        _mark(is_blocked, candidates.shaded_pairs)
    return is_blocked


class ShadowEdges(NamedTuple):
    """Which hits are in shadow, and the visible shadow edges that may cross their footprints."""

    # Whether an object other than the hit's own blocks the segment from the hit to the light;
    # meaningless where the surface does not face the light.
    is_blocked: Shaped[Bools, "lights n"]
    # Triples of a light, a hit, and the object that casts the shadow, sorted in this order.
    edges: Shaped[Ints, "3 k"]
    # Whether edges near the hit are missing in `edges`, because one light has more than
    # `edge_set.MAX_EDGES_PER_HIT` there.
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
    is_blocked = np.zeros(faces_light.shape, dtype=np.bool_)
    is_covered = np.zeros(faces_light.shape, dtype=np.bool_)  # by the shadow of a single object
    light_count, hit_count = faces_light.shape
    edge_set = EdgeSet(light_count, hit_count, hits.scene.position_error.size)
    for candidates in find_candidates(hits, lights, faces_light, footprint_radius):
        triples = candidates.triples
        test = _test_footprints(hits, lights, candidates.shape, triples, footprint_radius)
        _mark(is_blocked, triples[:2, test.is_blocking])
        _mark(is_covered, triples[:2, test.is_covering])
        _mark(is_covered, candidates.shaded_pairs)
        is_facing = take_2d(faces_light, triples[0], triples[1])
        edge_set.add(triples[:, test.has_edge & is_facing])
    edges = edge_set.get_edges()
    is_visible = ~take_2d(is_covered, edges[0], edges[1])
    return ShadowEdges(
        is_blocked=is_blocked | is_covered,
        edges=edges[:, is_visible],
        is_crowded=np.any(edge_set.is_crowded & ~is_covered, axis=0),
    )


def _mark(table: Shaped[Bools, "lights n"], pairs: Shaped[Ints, "2 k"]) -> None:
    """Set table[light, hit] to True for each pair of a light (row 0) and a hit (row 1)."""
    put_2d(table, pairs[0], pairs[1], True)


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
    growth = footprint_radius[hit_index]
    # If the object shades any part of the footprint, the grown object shades the hit.
    grown_object_blocks = _test_blocking(hits, lights, shape, triples, growth)
    light_distance = shape.measure_distance(object_index, take(lights.position.T, light_index))
    is_blocking = _test_blocking(hits, lights, shape, triples)
    # If the shrunk object shades the hit, the object shades the whole footprint.  A test of the
    # shrunk object does not suffice, because the hit may lie between the two surfaces.
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
