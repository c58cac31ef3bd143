"""Where in the picture things appear, in closed form, through whole renders.

The target is a wall at z = -8 whose lights make every point's radiance tell where it is: the light
at (0, 0, -7) shines with n.l = 1 / sqrt(1 + x^2 + y^2) on a point (x, y); two more, at (1, 0, -7)
and (0, 1, -7), in other channels, tell left from right and top from bottom.
"""

import math

import numpy as np
import pytest
from probe import EPS, colored, scene_of

from reference.judges import plain
from tracer import Box, Camera, Sphere, render

WALL = Box(min_pt=(-100, -100, -9), max_pt=(100, 100, -8))
LIGHTS = (0, 0), (1, 0), (0, 1)
FOUR = (-3, -1, 1, 3)
SLANTED = {"view_dir": (1, 2, -4), "proj_normal": (0, 0, 1)}
SLANTED_POINTS = [
    [(2 + 8 * s * math.sqrt(21) / 4, 4 - 8 * r * math.sqrt(21) / 4) for s in (-0.125, 0.125)]
    for r in (-0.125, 0.125)
]

CAMERAS = {
    # Window 1 x 1 at distance 1, wall 8 away: columns at 8 ((j + 1/2) / 4 - 1/2), rows down.
    "pixel centres": ({}, [[(x, -y) for x in FOUR] for y in FOUR]),
    "view direction": ({"view_dir": (3, 2, -4), "view_width": 7, "view_height": 0.1}, [[(6, 4)]]),
    # Eye (1, 2, 8), 16 from the wall; window 3 x 1 at distance 2: columns 8 apart, rows 4.
    "window, distance and eye": (
        {"view_point": (1, 2, 8), "proj_distance": 2, "view_width": 3},
        [[(1 + 8 * j, 2 + y) for j in (-1, 0, 1)] for y in (2, -2)],
    ),
    # A window .75 x .5 over 2 x 4 pixels: columns 8 * .375 = 3 apart, rows 8 * .125 = 1.
    "pixels that are not square": (
        {"view_width": 0.75, "view_height": 0.5},
        [[(x, y) for x in (-1.5, 1.5)] for y in (1.5, 0.5, -0.5, -1.5)],
    ),
    # Only its part in the window's plane counts.
    **{
        f"up {up}": ({"view_up": up}, [[(x, -y) for x in FOUR] for y in FOUR])
        for up in ((0.0, 5.0, 3.0), (0.0, 1e-8, -7.0))
    },
    # With +x up, right is up x w = (1, 0, 0) x (0, 0, 1) = (0, -1, 0).
    "up turns the picture": ({"view_up": (1, 0, 0)}, [[(-y, -x) for x in FOUR] for y in FOUR]),
    # View direction (3, 1, -4) to a window parallel to the wall: its centre is sqrt(26) along
    # it, that is at (3, 1, -4); pixels step by 1 there and by 2 on the wall, around (6, 2).
    "shifted window": (
        {"view_dir": (3, 1, -4), "proj_normal": (0, 0, 1), "proj_distance": math.sqrt(26),
         "view_width": 3, "view_height": 2},
        [[(6 + 2 * j, 2 + y) for j in (-1, 0, 1)] for y in (1, -1)],
    ),
    # The window turns about the vertical: normal (3, 0, 4) / 5, centre (0, 0, -1), so that
    # right is (0, 1, 0) x n = (0.8, 0, -0.6).  The ray through s right of the centre,
    # (0.8 s, r, -1 - 0.6 s), meets the wall at 8 (0.8 s, r) / (1 + 0.6 s).
    "oblique window": (
        {"proj_normal": (3, 0, 4), "view_width": 1.5},
        [[(6.4 * s / (1 + 0.6 * s), 8 * r / (1 + 0.6 * s)) for s in (-0.5, 0, 0.5)]
         for r in (0.25, -0.25)],
    ),
    # The distance is along the view direction, of any length: the window, parallel to the wall, is
    # 4 / sqrt(21) before the eye and shows the wall 2 sqrt(21) times as large.  Twice as far it is
    # half as large.  The sign of the normal does not matter.
    "slanted": ({**SLANTED, "view_width": 0.5, "view_height": 0.5}, SLANTED_POINTS),
    "slanted, from afar": (
        {**SLANTED, "view_dir": (4, 8, -16), "view_up": (0, 0.125, 0), "proj_distance": 2},
        SLANTED_POINTS,
    ),
    "slanted, from behind": (
        {**SLANTED, "proj_normal": (0, 0, -1024), "view_width": 0.5, "view_height": 0.5},
        SLANTED_POINTS,
    ),
}  # fmt: skip


@pytest.mark.parametrize(("camera", "points"), CAMERAS.values(), ids=CAMERAS)
def test_points_of_a_wall(camera, points):
    size = len(points[0]), len(points)
    lights = colored(*((x, y, -7) for x, y in LIGHTS))
    scene = scene_of(WALL, camera=Camera(**camera), size=size, lights=lights)
    at = np.array(points)[:, :, None] - LIGHTS
    expected = 1 / np.sqrt(1 + (at**2).sum(axis=3))
    # Points up to 20 away are rounded, against the light's distance of 1.
    np.testing.assert_allclose(render(scene), expected, rtol=0, atol=64 * EPS)
    np.testing.assert_allclose(plain.render(scene), expected, rtol=0, atol=64 * EPS)
    # An offset, right and down, moves the samples of both alike.
    aside, off = plain.render(scene, (0.25, -0.5)), render(scene, offset=(0.25, -0.5))
    assert np.abs(aside - expected).max() > 0.01
    np.testing.assert_allclose(off, aside, rtol=0, atol=64 * EPS)


def test_window_is_not_a_near_plane():
    # What is nearer than the window is seen; what is behind the eye is not.
    for z, radiance in ((-0.5, 1), (0.5, 0)):
        ball = Sphere(center=(0, 0, z), radius=0.125)
        scene = scene_of(ball, camera=Camera(proj_distance=8), size=(1, 1), lights=(0, 0, 0))
        assert render(scene)[0, 0].tolist() == [radiance] * 3
