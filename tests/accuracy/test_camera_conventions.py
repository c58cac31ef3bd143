"""Where in the picture things appear, in closed form, through whole renders.

The target is a wall at z = -8 whose single light makes every point's radiance
tell where it is: the light is at (0, 0, -7), so a point (x, y) of the wall has
n.l = 1 / sqrt(1 + x^2 + y^2); two more, at (1, 0, -7) and (0, 1, -7), in other
channels, tell left from right and top from bottom.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from probe import EPS, Vector, colored, scene_of

from tracer import Box, Camera, Lambertian, Sphere, render
from tracer.arrays import Floats

WALL = Box(min_pt=(-100, -100, -9), max_pt=(100, 100, -8))
LIGHTS = colored((0, 0, -7), (1, 0, -7), (0, 1, -7))


def wall_seen(camera: Camera, width: int, height: int) -> Floats:
    """The wall's picture (height, width, 3)."""
    scene = scene_of(WALL, camera=camera, size=(width, height), lights=LIGHTS)
    return render(scene)


def wall_at(x: float, y: float) -> list[float]:
    """What the wall shows at (x, y)."""
    return [1 / math.sqrt(1 + (x - a) ** 2 + (y - b) ** 2) for a, b in ((0, 0), (1, 0), (0, 1))]


def expect(image: Floats, points: list[list[tuple[float, float]]]) -> None:
    """Hold a picture against the wall's points that its pixels should show."""
    assert image.shape == (len(points), len(points[0]), 3)
    expected = [[wall_at(x, y) for x, y in row] for row in points]
    # Points up to 20 away are rounded, against the light's distance of 1.
    assert image == pytest.approx(np.array(expected), abs=64 * EPS)


def test_pixel_centres() -> None:
    # Window 1 x 1 at distance 1, wall 8 away: columns at 8 ((j + 1/2) / 4 - 1/2), rows down.
    at = [-3, -1, 1, 3]
    expect(wall_seen(Camera(), 4, 4), [[(x, -y) for x in at] for y in at])


def test_one_pixel_looks_along_the_view_direction() -> None:
    camera = Camera(view_dir=(3, 2, -4), view_width=7, view_height=0.1)
    expect(wall_seen(camera, 1, 1), [[(6, 4)]])


def test_window_distance_and_eye() -> None:
    # Eye (1, 2, 8), 16 from the wall; window 3 x 1 at distance 2: columns 8 apart, rows 4.
    camera = Camera(view_point=(1, 2, 8), proj_distance=2, view_width=3, view_height=1)
    expect(wall_seen(camera, 3, 2), [[(1 + 8 * j, 2 + y) for j in (-1, 0, 1)] for y in (2, -2)])


def test_lengths_of_vectors_and_sign_of_the_normal_do_not_matter() -> None:
    plain = Camera(view_dir=(1, 0, -8), view_up=(0, 1, 0), proj_normal=(0, 0, 1))
    scaled = Camera(view_dir=(4, 0, -32), view_up=(0, 0.125, 0), proj_normal=(0, 0, 1024))
    for other in (scaled, replace(plain, proj_normal=(0, 0, -1))):
        assert np.array_equal(wall_seen(plain, 5, 3), wall_seen(other, 5, 3))


def test_non_square_pixels() -> None:
    # A window .75 x .5 over 2 x 4 pixels: columns 8 * .375 = 3 apart, rows 8 * .125 = 1.
    camera = Camera(view_width=0.75, view_height=0.5)
    expect(wall_seen(camera, 2, 4), [[(x, y) for x in (-1.5, 1.5)] for y in (1.5, 0.5, -0.5, -1.5)])


@pytest.mark.parametrize("up", [(0.0, 1.0, 0.0), (0.0, 5.0, 3.0), (0.0, 1e-8, -7.0)])
def test_up_need_not_be_perpendicular(up: Vector) -> None:
    # Only its part in the window's plane counts.
    at = [-3, -1, 1, 3]
    expect(wall_seen(Camera(view_up=up), 4, 4), [[(x, -y) for x in at] for y in at])


def test_up_turns_the_picture() -> None:
    # With +x up, right is up x w = (1, 0, 0) x (0, 0, 1) = (0, -1, 0).
    at = [-3, -1, 1, 3]
    expect(wall_seen(Camera(view_up=(1, 0, 0)), 4, 4), [[(-y, -x) for x in at] for y in at])


def test_shifted_window() -> None:
    # View direction (3, 1, -4) to a window parallel to the wall: its centre is sqrt(26) along
    # it, that is at (3, 1, -4); pixels step by 1 there and by 2 on the wall, around (6, 2).
    camera = Camera(
        view_dir=(3, 1, -4),
        proj_normal=(0, 0, 1),
        proj_distance=math.sqrt(26),
        view_width=3,
        view_height=2,
    )
    expect(wall_seen(camera, 3, 2), [[(6 + 2 * j, 2 + y) for j in (-1, 0, 1)] for y in (1, -1)])


def test_oblique_window() -> None:
    # The window turns about the vertical: normal (3, 0, 4) / 5, centre (0, 0, -1), so that
    # right is (0, 1, 0) x n = (0.8, 0, -0.6).  The ray through s right of the centre,
    # (0.8 s, r, -1 - 0.6 s), meets the wall at 8 (0.8 s, r) / (1 + 0.6 s).
    camera = Camera(proj_normal=(3, 0, 4), view_width=1.5, view_height=1)
    expect(
        wall_seen(camera, 3, 2),
        [
            [(6.4 * s / (1 + 0.6 * s), 8 * r / (1 + 0.6 * s)) for s in (-0.5, 0, 0.5)]
            for r in (0.25, -0.25)
        ],
    )


def test_distance_is_along_the_view_direction() -> None:
    # Twice the distance along a slanted direction halves all angles' tangents about it,
    # whatever the normal: the same picture as with half the window.
    near = Camera(view_dir=(1, 2, -4), proj_normal=(0, 0, 1), view_width=0.5, view_height=0.5)
    far = Camera(
        view_dir=(1, 2, -4), proj_normal=(0, 0, 1), proj_distance=2, view_width=1, view_height=1
    )
    assert np.array_equal(wall_seen(near, 5, 5), wall_seen(far, 5, 5))


def test_nothing_is_mirrored() -> None:
    # Four balls at four corners, each of its own colour; the eye looks along +x, so right is
    # up x w = (0, 1, 0) x (-1, 0, 0) = (0, 0, 1).
    colors = {(1, -1): (1, 0, 0), (1, 1): (0, 1, 0), (-1, -1): (0, 0, 1), (-1, 1): (1, 1, 0)}
    balls = [
        Sphere(center=(4, y, z), radius=0.5, shader=Lambertian(diffuse=color))
        for (y, z), color in colors.items()
    ]
    scene = scene_of(*balls, camera=Camera(view_dir=(1, 0, 0)), size=(2, 2), lights=(0, 0, 0))
    seen = render(scene) > 0
    expected = [[colors[y, z] for z in (-1, 1)] for y in (1, -1)]
    assert np.array_equal(seen, np.array(expected) > 0)


def test_row_zero_is_the_top() -> None:
    # The sky is black, the floor is not.
    floor = Box(min_pt=(-100, -2, -100), max_pt=(100, -1, 100))
    scene = scene_of(floor, size=(3, 4), lights=(0, 50, 0))
    assert (render(scene)[:, :, 0] > 0).tolist() == 2 * [3 * [False]] + 2 * [3 * [True]]


def test_window_is_not_a_near_plane() -> None:
    # What is nearer than the window is seen; what is behind the eye is not.
    near = Sphere(center=(0, 0, -0.5), radius=0.125)
    behind = Sphere(center=(0, 0, 0.5), radius=0.125)
    for ball, radiance in ((near, 1), (behind, 0)):
        scene = scene_of(ball, camera=Camera(proj_distance=8), size=(1, 1), lights=(0, 0, 0))
        assert render(scene)[0, 0].tolist() == [radiance] * 3
