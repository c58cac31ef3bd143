"""Hits that are hidden, and shadows: do they cover the footprint of a hit, or end in it?"""

import numpy as np
import pytest
from probe import scene_of
from scene_files import HARD_SCENES

from tracer import Box, Camera, Sphere, load_scene
from tracer.antialias.lattice import PIXEL_CENTERS
from tracer.trace.occlusion import find_shadow_edges
from tracer.trace.visibility import find_nearest_and_hidden_hits, find_nearest_hits
from tracer.world.prepared_scene import PreparedScene

FLOOR = Box(min_pt=(-20, -1, -20), max_pt=(20, 0, 20))
BALL = Sphere(center=(0, 3, 0), radius=1)
PLATE = Box(min_pt=(-4, 2, -4), max_pt=(4, 2.1, 4))
HALL = Box(min_pt=(-9, -2, -9), max_pt=(9, 9, 9))
CUBE = Box(min_pt=(-1, 2, -1), max_pt=(1, 4, 1))

# Whether the object blocks the light at the hit, and whether its shadow has an edge in the
# footprint.
CLEAR, EDGE, EDGE_SHADED, COVERED = (False, False), (False, True), (True, True), (True, False)

# The hit is at the origin, on the first object; its footprint has the radius 0.5.  The
# shadow is that of the second object.
CASES = {
    "segment far from the ball": (FLOOR, BALL, (8, 6, 0), CLEAR),
    "segment next to the ball": (FLOOR, BALL, (3, 6, 0), EDGE),
    "segment through the ball, near its silhouette": (FLOOR, BALL, (1.5, 6, 0), EDGE_SHADED),
    "segment through the centre of the ball": (FLOOR, BALL, (0, 6, 0), COVERED),
    "segment through a plate thinner than the footprint": (FLOOR, PLATE, (0, 6, 0), EDGE_SHADED),
    "segment through a plate that is thin along x": (
        *(FLOOR, Box(min_pt=(1, -4, -4), max_pt=(1.1, 8, 4)), (4, 2, 0), EDGE_SHADED),
    ),
    "segment through a plate that is thin along z": (
        *(FLOOR, Box(min_pt=(-4, -4, 1), max_pt=(4, 8, 1.1)), (0, 2, 4), EDGE_SHADED),
    ),
    "light far in front of the ball": (FLOOR, BALL, (0, 1, 0), CLEAR),
    "light in the centre of the ball": (FLOOR, BALL, (0, 3, 0), COVERED),
    # A ball blocks every light inside it.  For a light near a face of a box, an edge is assumed.
    "light in the ball, near its surface": (FLOOR, BALL, (0, 2.3, 0), COVERED),
    "light in the cube, near its surface": (FLOOR, CUBE, (0, 2.3, 0), EDGE_SHADED),
    "light on the far side of the ball": (FLOOR, BALL, (0, 4, 0), COVERED),
    # The plane that touches the ball at the light crosses the floor 1/6 to either side of the hit.
    "light on the ball, just above the hit's horizon": (
        *(FLOOR, BALL, (24 / 25, 3 - 7 / 25, 0), EDGE_SHADED),
    ),
    "light on the ball, just below the hit's horizon": (
        *(FLOOR, BALL, (12 / 13, 3 - 5 / 13, 0), EDGE),
    ),
    "light and hit in a hall": (FLOOR, HALL, (0, 6, 0), CLEAR),
    "light and hit in a hall, the light near the ceiling": (FLOOR, HALL, (0, 8.7, 0), EDGE),
    # The grown box contains the hit and the light, and therefore blocks nothing.
    "light in a box that the footprint meets": (
        *(FLOOR, Box(min_pt=(0.2, 0, -4), max_pt=(8, 8, 4)), (4, 4, 0), COVERED),
    ),
    # The hit is outside the shrunk hall, but inside the unchanged one.
    "light and hit in a hall, the hit near the wall": (
        *(FLOOR, Box(min_pt=(-9, -2, -0.3), max_pt=(9, 9, 9)), (0, 4, 4), CLEAR),
    ),
}


@np.errstate(all="ignore")  # as where pictures are rendered
@pytest.mark.parametrize(
    ("ground", "other", "light", "expected"), [pytest.param(*c, id=n) for n, c in CASES.items()]
)
def test_shadow_in_a_footprint(ground, other, light, expected):
    camera = Camera(view_point=(-0.75, 0.5, 0), view_dir=(0.75, -0.5, 0))
    scene = PreparedScene(scene_of(ground, other, camera=camera, size=(1, 1), lights=light))
    hits = find_nearest_hits(scene, PIXEL_CENTERS.place_in_pixels(slice(0, 1), slice(0, 1)))
    np.testing.assert_allclose(np.ravel(hits.get_points(slice(None))), 0, atol=1e-12)
    faces_light, radius = np.ones((1, 1), dtype=np.bool_), np.full(1, 0.5)
    (lights,) = scene.iterate_light_batches()
    is_blocked, edges, is_crowded = find_shadow_edges(hits, lights, faces_light, radius)
    assert (is_blocked.item(), edges[0].size > 0) == expected
    assert not is_crowded.any()


@np.errstate(all="ignore")  # as where pictures are rendered
def test_hidden_hits_are_behind_the_nearest_ones():
    scene = PreparedScene(load_scene(HARD_SCENES / "surfaces-that-cross-within-pixels.xml"))
    rows, columns = slice(0, scene.frame.height), slice(0, scene.frame.width)
    samples = PIXEL_CENTERS.place_in_pixels(rows, columns)
    nearest, hidden = find_nearest_and_hidden_hits(scene, samples)
    nearest_distance = np.full(samples.size, np.inf)
    nearest_distance[nearest.sample_index] = nearest.distance
    assert hidden.sample_index.size
    assert (hidden.distance > nearest_distance[hidden.sample_index]).all()
