"""Pictures that are hard to antialias, each for a reason of its own.

Even so, many samples a pixel are no worse than a uniform grid, or nearly as good as a fine one.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from probe import scene_of
from random_scenes import random_scene
from uniform_grid import no_worse_than_the_uniform_grid, uniform

from tracer import Box, Camera, Lambertian, Phong, PointLight, Scene, Sphere, render
from tracer.antialias import refine as antialias
from tracer.antialias.curvature import curvature
from tracer.arrays import Floats, Ints, Vector

WALL = Box(min_pt=(-60, -60, -6), max_pt=(60, 60, -5))
RED = Lambertian(diffuse=(1, 0, 0))


def test_a_small_object_beside_the_rim_before_a_wide_one() -> None:
    # All samples beside edges are far left, and the wall in their rows reaches far right.
    ball = Sphere(center=(-1.7, -0.3, -3.9), radius=0.1, shader=RED)
    no_worse_than_the_uniform_grid(scene_of(WALL, ball, size=(96, 72), lights=(0, 3, 4)), 2)


@pytest.mark.usefixtures("pixels_are_split")
def test_the_shadow_of_a_box_on_a_small_ball() -> None:
    # Its edges are straight, but not on a ball of a few pixels.
    ball = Sphere(center=(0, 0, 0), radius=0.55)
    box = Box(min_pt=(0.933, 1.304, 0.797), max_pt=(1.35, 1.746, 1.072), shader=RED)
    floor = Box(min_pt=(-9, -1.55, -9), max_pt=(9, -0.55, 9))
    camera = Camera(
        view_point=(0, 1.4, 8), view_dir=(0, -0.1, -1), proj_distance=4, view_width=3, view_height=2
    )
    scene = scene_of(ball, box, floor, camera=camera, size=(36, 24), lights=(3.04, 4.625, 2.95))
    no_worse_than_the_uniform_grid(scene, numbers=(64,))


def test_the_shadow_of_a_box_that_hardly_bends_within_a_pixel() -> None:
    # For as many samples it bends too much.
    box = Box(min_pt=(0.9, 1.2, 1.5), max_pt=(1.5, 1.8, 2.1))
    camera = Camera(view_point=(0, 0, 10), proj_distance=10, view_width=3, view_height=3)
    scene = scene_of(Sphere(), box, camera=camera, size=(24, 24), lights=(3, 4, 5))
    no_worse_than_the_uniform_grid(scene, numbers=(64, 256))


@pytest.mark.usefixtures("pixels_are_split")
def test_the_shadow_of_a_box_on_a_ball_in_tall_pixels() -> None:
    # The plane that touches the ball in a pixel's middle is far from it in the corners.
    camera = Camera(
        view_point=(1.934, -0.955, -4.511),
        view_dir=(-0.3868, 0.191, 0.9022),
        view_up=(0.3754, -0.5468, 0.7484),
        view_width=0.0296,
        view_height=0.6667,
    )
    box = Box(min_pt=(-1.401, -1.014, -1.69), max_pt=(-0.496, 0.099, -1.105))
    ball = Sphere(center=(0.7515, -0.7091, -1.1605), radius=0.4899)
    scene = scene_of(box, ball, camera=camera, size=(16, 24), lights=(-4.0502, 1.5368, -2.4968))
    no_worse_than_the_uniform_grid(scene, numbers=(64, 256))


@pytest.mark.usefixtures("pixels_are_split")
def test_surfaces_that_cross_within_pixels() -> None:
    no_worse_than_the_uniform_grid(random_scene("touching", 111, 36, 24), numbers=(64,))


def test_a_lamp_behind_a_plate() -> None:
    # Light and shaded points are both so near to the plate that one a pixel larger holds both.
    floor = Box(min_pt=(-9, -1, -9), max_pt=(9, 0, 9))
    plate = Box(min_pt=(-1, 0, -4.02), max_pt=(1, 0.5, -4))
    camera = Camera(view_point=(0, 0.3, 0))
    scene = scene_of(floor, plate, camera=camera, size=(41, 41), lights=(0, 0.2, -4.1))
    no_worse_than_the_uniform_grid(scene, 2)


def test_shadows_on_a_hollow_ball_that_is_there_twice() -> None:
    # Points on one of the two are outside of the other as soon as that is a little smaller.
    hollow = Sphere(center=(0, 0, 0), radius=6)
    plate = Box(min_pt=(-0.7, -0.5, -2.5), max_pt=(0.4, 0.8, -2.4), shader=RED)
    camera = Camera(view_point=(0, 0, 4))
    scene = scene_of(hollow, hollow, plate, camera=camera, size=(36, 36), lights=(2, 1.5, 1))
    no_worse_than_the_uniform_grid(scene, 2)


def low_over(*surfaces: Sphere | Box, height: float, light: tuple[float, float, float]) -> Scene:
    """The eye so high over the origin's level, and looking a little down."""
    camera = Camera(
        view_point=(0, height, 3), view_dir=(0, -0.03, -1), view_width=0.7, view_height=0.7 * 2 / 3
    )
    return scene_of(*surfaces, camera=camera, size=(36, 24), lights=light)


def test_a_floor_to_the_horizon() -> None:
    # Within a pixel beside the horizon the floor comes nearer to the light, and leaves it again.
    floor = Box(min_pt=(-1e3, -1, -1e3), max_pt=(1e3, 0, 1e3))
    no_worse_than_the_uniform_grid(low_over(floor, height=0.5, light=(1, 1, -6)), 2)


@pytest.mark.parametrize(("slope", "pixel"), [(5e-4, 1e-4), (1e-4, 1e-5), (1e-5, 1e-6)])
def test_a_shadow_far_away_on_a_floor(slope: float, pixel: float) -> None:
    # Seen so nearly edge-on that a pixel sees as much of the floor as is before it.
    wide = 24 * pixel
    camera = Camera(
        view_point=(0, 100 * slope, 0),
        view_dir=(0.03 * wide, -slope - 0.4 * pixel, -1),
        view_width=wide,
        view_height=wide * 2 / 3,
    )
    floor = Box(min_pt=(-1e3, -5, -1e3), max_pt=(1e3, 0, 1e3))
    above = Box(min_pt=(-300, 150, -103), max_pt=(300, 160, -100), shader=RED)
    scene = scene_of(floor, above, camera=camera, size=(24, 16), lights=(3, 2000, -101))
    no_worse_than_the_uniform_grid(scene)


def test_a_shadow_seen_nearly_edge_on() -> None:
    # Both sides of a long shadow in one pixel, and most of what lies before and behind it.
    floor = Box(min_pt=(-1e3, -1, -1e3), max_pt=(1e3, 0, 1e3))
    ball = Sphere(center=(0, 0.6, -16), radius=0.6, shader=RED)
    no_worse_than_the_uniform_grid(low_over(floor, ball, height=0.5, light=(-20, 5, -14)), 2)


@pytest.mark.parametrize(
    ("ball", "radius", "light"),
    [
        ((0.0605, 0.9, -5.6067), 0.456, (6.7206, 9, -4.3108)),
        ((0.0275, 0.9, -3.9131), 0.332, (5.8868, 9, 2.4878)),
    ],
)
def test_a_shadow_less_deep_than_its_pixels(
    ball: tuple[float, float, float], radius: float, light: tuple[float, float, float]
) -> None:
    # It is wider than they are: what is nearest to a pixel's centre does not cross the pixel.
    floor = Box(min_pt=(-1e3, -1, -1e3), max_pt=(1e3, 0, 1e3))
    camera = Camera(view_point=(0, 0.5, 0), view_width=0.7, view_height=0.7 * 2 / 3)
    above = Sphere(center=ball, radius=radius, shader=RED)
    scene = scene_of(floor, above, camera=camera, size=(36, 24), lights=light)
    no_worse_than_the_uniform_grid(scene, 2)


@pytest.mark.parametrize(
    ("height", "ahead", "wide", "ball", "radius", "light"),
    [
        pytest.param(
            0.4908, (0.2594, -0.063, -0.998), 0.222,
            (2.2266, 1.1065, -8.1563), 0.7377, (13.456, 10.215, -9.003), id="its near side",
        ),
        pytest.param(
            1, (0.047, -1.047, -11.276), 0.3056,
            (3.2015, 4.3799, -10.1688), 0.7602, (14.979, 20.492, -6.096), id="its tip",
        ),
    ],
)  # fmt: skip
def test_a_shadow_that_leaves_a_pixel_beside_where_it_enters(
    height: float, ahead: Vector, wide: float, ball: Vector, radius: float, light: Vector
) -> None:
    # Pixels see long, narrow parts of the floor, across which a ball's shadow bends back.
    floor = Box(min_pt=(-1e3, -1, -1e3), max_pt=(1e3, 0, 1e3))
    camera = Camera(
        view_point=(0, height, 0), view_dir=ahead, view_width=wide, view_height=wide * 25 / 37
    )
    above = Sphere(center=ball, radius=radius, shader=RED)
    scene = scene_of(floor, above, camera=camera, size=(37, 25), lights=light)
    no_worse_than_the_uniform_grid(scene, 2, numbers=(16, 64))


@pytest.mark.parametrize(("radius", "height"), [(20, 0.2), (400, 0.2), (2000, 0.5)])
def test_the_limb_of_the_ball_that_the_eye_is_next_to(radius: float, height: float) -> None:
    ground = Sphere(center=(0, -radius, 0), radius=radius)
    no_worse_than_the_uniform_grid(low_over(ground, height=height, light=(5, 9, 5)), 2)


@pytest.mark.parametrize("radius", [1e4, 6.4e6, 1e8])
@pytest.mark.parametrize("up", [0, 0.02, -0.02])
def test_the_horizon_of_a_planet(radius: float, up: float) -> None:
    # Rays to its horizon are at right angles to the way to its centre, or nearly.
    planet = Sphere(center=(0, -radius, 0), radius=radius)
    camera = Camera(view_point=(0, 2, 0), view_dir=(0, up, -1))
    scene = scene_of(planet, camera=camera, size=(18, 13), lights=(0, 1e3, -50))
    no_worse_than_the_uniform_grid(scene, 2, numbers=(16, 64))


@pytest.mark.parametrize(
    "floor",
    [
        Box(min_pt=(-9, -1, -9), max_pt=(9, 0, 9), shader=RED),
        Box(min_pt=(0, -1, -9), max_pt=(9, 0, 9), shader=RED),
        Sphere(center=(0, -1, 0), radius=1, shader=RED),
        Sphere(center=(-1, 0, 0), radius=1, shader=RED),
    ],
    ids=["on a face", "on an edge", "on a ball", "beside a ball"],
)
def test_the_eye_on_a_surface(floor: Box | Sphere) -> None:
    """It sees the inside, on one side of the plane that touches it there, and past it elsewhere."""
    room = Box(min_pt=(-30, -30, -30), max_pt=(30, 30, 30))
    camera = Camera(view_dir=(0.3, 0.01, -1), view_up=(0.1, 1, 0))
    scene = scene_of(floor, room, camera=camera, size=(24, 16), lights=(0, 5, 3))
    no_worse_than_the_uniform_grid(scene)


@pytest.mark.parametrize("aside", [0.0, 1e-16, 3e-12])
def test_the_eye_beside_an_edge_but_for_rounding(aside: float) -> None:
    """It looks along a face of a box, from so near to its edge that no outline is known there."""
    room = Box(min_pt=(-30, -30, -30), max_pt=(30, 30, 30))
    box = Box(min_pt=(0, -1, -4), max_pt=(4, 1, -aside), shader=RED)
    camera = Camera(
        view_dir=(0, -1, 0), view_up=(-0.013, 0.49, 0.87), view_width=0.37, view_height=0.37
    )
    scene = scene_of(box, room, camera=camera, size=(24, 20), lights=(-2, 5, -4))
    no_worse_than_the_uniform_grid(scene, numbers=(16, 64))


@pytest.mark.parametrize("up", [0.009, 0, -2e-5])
def test_light_that_falls_off_towards_a_horizon(up: float) -> None:
    # On the near side of the horizon's line light falls from nearly all to nothing.  Or the line
    # passes so near to pixels' centres that the floor's lower edges there may count for it.
    wide, high = 0.4, 0.4 * 13 / 18
    eye, ahead, normal = (0, 1.4, 0), (0, up, -1), (0, 0, 1)
    camera = Camera(
        view_point=eye, view_dir=ahead, proj_normal=normal, view_width=wide, view_height=high
    )
    floor = Box(min_pt=(-3e4, -1, -3e4), max_pt=(3e4, 0, 3e4))
    scene = scene_of(floor, camera=camera, size=(18, 13), lights=(-100, 210, -160))
    no_worse_than_the_uniform_grid(scene, 2, numbers=(16, 64))


def test_a_shadow_on_the_far_part_of_what_a_pixel_sees() -> None:
    camera = Camera(
        view_point=(0, 0.31, 0), view_dir=(0, -0.034, -1), view_width=0.65, view_height=1.3 / 3
    )
    floor = Box(min_pt=(-6e4, -1, -6e4), max_pt=(6e4, 0, 6e4))
    out_of_sight = Box(min_pt=(-3.3, 2.7, -45.5), max_pt=(9.4, 6.6, -30.3))
    scene = scene_of(floor, out_of_sight, camera=camera, size=(24, 16), lights=(-360, 295, 131))
    no_worse_than_the_uniform_grid(scene, 2, numbers=(64, 256))


@pytest.mark.parametrize("distance", [1e4, 1e6, 1e8])
def test_a_box_through_a_long_lens(distance: float) -> None:
    ahead = np.array([2.0, -3.0, 6.0]) / 7
    x, y, z = (-ahead * distance).tolist()
    camera = Camera(
        view_point=(x, y, z),
        view_dir=(2, -3, 6),
        proj_distance=distance,
        view_width=3,
        view_height=2,
    )
    box = Box(min_pt=(-0.5, -0.5, -0.5), max_pt=(0.5, 0.5, 0.5))
    scene = scene_of(box, camera=camera, size=(36, 24), lights=(-0.14, 3.7, -3.4))
    no_worse_than_the_uniform_grid(scene, numbers=(16, 64))


def test_the_ends_of_a_thin_rod_far_away() -> None:
    camera = Camera(view_point=(0, 0, 1e4), proj_distance=1e4, view_width=0.03, view_height=0.02)
    rod = Box(min_pt=(-3, -0.0041, -0.01), max_pt=(0.0007, 0.0041, 0.01))
    scene = scene_of(rod, camera=camera, size=(36, 24), lights=(3, 4, 9))
    no_worse_than_the_uniform_grid(scene, numbers=(16, 64))


@pytest.mark.usefixtures("either_packets")
def test_a_light_on_a_ball() -> None:
    # Its tangent plane there divides what it lights from what the ball shades: on the wall.
    wall = Box(min_pt=(-9, -9, -4), max_pt=(9, 9, -3))
    camera = Camera(
        view_point=(6, 1.02, 5),
        view_dir=(-3, 0, -8),
        proj_normal=(-3, 0, -8),
        view_width=0.6,
        view_height=0.4,
    )
    scene = scene_of(wall, Sphere(shader=RED), camera=camera, size=(24, 16), lights=(0, 1, 0))
    no_worse_than_the_uniform_grid(scene, numbers=(16, 64))


@pytest.mark.parametrize("turn", [0.0, 0.02])
@pytest.mark.parametrize("thickness", [0.05, 0.1, 0.3])
def test_a_wire_on_a_row_of_centres(thickness: float, turn: float) -> None:
    # All centres see it; of a grid of four or sixteen samples none does.
    camera = Camera(view_up=(math.sin(turn), math.cos(turn), 0))
    half = thickness / 6
    wire = Box(min_pt=(-0.8, -half, -6), max_pt=(0.8, half, -5), shader=RED)
    wall = Box(min_pt=(-30, -30, -12), max_pt=(30, 30, -11))
    scene = scene_of(wall, wire, camera=camera, size=(15, 15), lights=(1, 2, 6))
    no_worse_than_the_uniform_grid(scene)


@pytest.mark.parametrize(("up", "roll"), [(-0.081, 0.0133), (-0.012, 0.0164), (0.09, 0.0)])
def test_a_wire_between_rows_of_samples(up: float, roll: float) -> None:
    # Where its shadow divides a pixel, a sample for one side may fall onto the wire.
    wire = Box(min_pt=(-0.2, up - 0.0012, -1), max_pt=(0.9, up + 0.0012, -0.994), shader=RED)
    wall = Box(min_pt=(-9, -9, -1.5), max_pt=(9, 9, -1.02), shader=Lambertian(diffuse=(0.3,) * 3))
    camera = Camera(view_up=(roll, 1, 0))
    scene = scene_of(wire, wall, camera=camera, size=(32, 32), lights=(0, 1.5, 1))
    no_worse_than_the_uniform_grid(scene, numbers=(9, 16, 64))


@pytest.mark.parametrize("part", [0.1, 0.3, 0.7])
@pytest.mark.parametrize("slope", [1e-2, 2e-3])
def test_a_wall_through_a_floor_seen_at_a_low_angle(slope: float, part: float) -> None:
    # Its foot is so much of a pixel below the top of a row; behind it the floor is far away.
    step = slope * 10 / 18
    up = -slope + part * step
    camera = Camera(
        view_point=(0, 10 * slope, 0),
        view_dir=(0, up, -1),
        proj_normal=(0, 0, 1),
        proj_distance=math.hypot(1, up),
        view_width=18 * step,
        view_height=12 * step,
    )
    floor = Box(min_pt=(-50, -1, -50), max_pt=(50, 0, 50))
    wall = Box(min_pt=(-3, -1, -11), max_pt=(3, 2, -10), shader=RED)
    scene = scene_of(floor, wall, camera=camera, size=(18, 12), lights=(5, 20, 5))
    no_worse_than_the_uniform_grid(scene, numbers=(16, 64, 256))


@pytest.mark.parametrize("aside", [-0.01, 0.01, 0.02])
def test_a_narrow_highlight_beside_a_shadow(aside: float) -> None:
    # The pixel's middle lies in the shadow of the plate, its highlight beside it.
    at = -2.5 + 2.5 * 3 / 11
    gloss = Phong(diffuse=(0.2, 0.2, 0.2), specular=(1, 1, 1), exponent=1e5)
    floor = Box(min_pt=(-9, -9, -1), max_pt=(9, 9, 0), shader=gloss)
    plate = Box(min_pt=(-3, -3, 4), max_pt=((at + aside) / 2, 3, 4.01))
    camera = Camera(
        view_point=(-2.5, 0, 3), view_dir=(at + 2.5, 0, -3), view_width=1 / 3, view_height=2 / 9
    )
    scene = scene_of(floor, plate, camera=camera, size=(12, 8), lights=(0, 0, 8))
    assert np.abs(render(scene, samples=64) - uniform(scene, 129)).max() <= 0.002


def test_a_terminator_of_many_dim_lights() -> None:
    # None of them alone shows.
    lights = [PointLight(position=(9, 5, -1.5), intensity=(1 / 300,) * 3)] * 300
    camera = Camera(view_point=(0, 0, 10), proj_distance=10, view_width=6.3, view_height=4.2)
    ball = Sphere(center=(0.1, 0.1, 0))
    scene = scene_of(ball, camera=camera, size=(18, 12), lights=lights)
    no_worse_than_the_uniform_grid(scene, numbers=(16, 64))


def test_a_smooth_surface_in_large_pixels() -> None:
    # No edge at all: the light alone changes, in a highlight, within a pixel.
    camera = Camera(view_point=(0, 0, 3), view_width=0.54, view_height=0.36)
    ball = Sphere(shader=Phong(diffuse=(0.4, 0.4, 0.4), specular=(1, 1, 1), exponent=50))
    scene = scene_of(ball, camera=camera, size=(36, 24), lights=(1, 2, 5))
    no_worse_than_the_uniform_grid(scene, 2)


def test_light_on_a_ball_as_wide_as_a_pixel() -> None:
    # No neighbour sees the ball, and its pixel's quarters do not all see it under the light.
    camera = Camera(view_point=(0, 0, 10), proj_distance=10, view_width=9, view_height=6)
    ball = Sphere(center=(-0.35, -0.29, 0), radius=0.65)
    scene = scene_of(ball, camera=camera, size=(9, 6), lights=(1.4, 1.5, 5.5))
    no_worse_than_the_uniform_grid(scene, numbers=(64, 256))


def test_a_ball_under_a_lamp_at_the_eye() -> None:
    # Light falls off towards the limb, also in parts of pixels whose middles see past the ball.
    eye, ahead = (2, 1, 4), (-2, 0, -4)
    camera = Camera(view_point=eye, view_dir=ahead, view_width=0.5, view_height=1 / 3)
    ball = Sphere(center=(-0.5, 1, 0.5), radius=0.5)
    scene = scene_of(ball, camera=camera, size=(24, 16), lights=eye)
    error = render(scene, samples=256) - uniform(scene, 129)
    assert np.sqrt((error**2).mean()) <= 4e-5


def test_a_shadow_right_behind_an_outline() -> None:
    # By a hundredth of a pixel, all along it: two lines, however near each other.
    aside = 0.004
    wall = Box(min_pt=(-9, -9, -4), max_pt=(9, 9, -2.5))
    plate = Box(min_pt=(-0.3, -0.3, -2), max_pt=(0.3, 0.3, -1.9))
    camera = Camera(view_up=(0.3, 1, 0))
    scene = scene_of(plate, wall, camera=camera, size=(24, 24), lights=(aside, aside, 0))
    no_worse_than_the_uniform_grid(scene, numbers=(16, 64, 256))


def test_a_surface_one_pixel_high() -> None:
    # A highlight bends from row to row, and no row beside it says how.
    half = (0.5 + 1 / 41) * 2 / 13
    gloss = Phong(diffuse=(0.1,) * 3, specular=(1, 1, 1), exponent=34)
    bar = Box(min_pt=(-9, -half, -1), max_pt=(9, half, 0), shader=gloss)
    camera = Camera(view_point=(0, 0, 1), view_width=0.2, view_height=2)
    scene = scene_of(bar, camera=camera, size=(24, 13), lights=(0, 0, 1))
    no_worse_than_the_uniform_grid(scene)


def test_the_outline_of_a_hidden_ball() -> None:
    # It divides nothing of the wall before it, whose light rises along it.
    gloss = Phong(diffuse=(0.1,) * 3, specular=(1, 1, 1), exponent=200)
    wall = Box(min_pt=(-9, -9, -1), max_pt=(9, 9, 0), shader=gloss)
    ball = Sphere(center=(-78.5399, -49.3374, -99.1142), radius=95)
    camera = Camera(view_point=(0, 0, 3), view_width=0.4, view_height=0.8 / 3)
    scene = scene_of(wall, ball, camera=camera, size=(24, 16), lights=(0.5, -0.4, 3))
    no_worse_than_the_uniform_grid(scene, numbers=(4, 16))


@pytest.mark.parametrize(
    ("radius", "eye", "up", "wide", "light"),
    [
        (8580, (0, 0.8, 5), 0, 1.44, (8, 0.8, -19)),
        (1115, (0, 0.293, 0), -0.0724, 1.375, (-4, 0.298, -57.6)),
    ],
)
def test_glitter_below_the_horizon_of_a_planet(
    radius: float, eye: Vector, up: float, wide: float, light: Vector
) -> None:
    # One or two pixels below it light does not depend on the distance from it alone.
    gloss = Phong(diffuse=(0.5,) * 3, specular=(1, 1, 1), exponent=5)
    planet = Sphere(center=(0, -radius, 0), radius=radius, shader=gloss)
    camera = Camera(view_point=eye, view_dir=(0, up, -1), view_width=wide, view_height=wide * 2 / 3)
    scene = scene_of(planet, camera=camera, size=(24, 16), lights=light)
    no_worse_than_the_uniform_grid(scene)


def test_the_shadow_of_a_ball_smaller_than_its_pixel() -> None:
    # Both sides of the shadow lie in a pixel, far from where its middle is.
    floor = Box(min_pt=(-1e4, -1, -1e4), max_pt=(1e4, 0, 1e4))
    ball = Sphere(center=(3.9, 2.7, 11), radius=0.37)
    camera = Camera(
        view_point=(0, 37, 62), view_dir=(0, -0.51, -0.86), view_width=0.7, view_height=0.47
    )
    scene = scene_of(floor, ball, camera=camera, size=(24, 16), lights=(-34, 12.4, -7.9))
    no_worse_than_the_uniform_grid(scene)


def test_more_lights_than_bits(monkeypatch: pytest.MonkeyPatch) -> None:
    # A key says what a pixel sees, and which lights reach it: the first of them counts, too.
    keys: set[int] = set()

    def noted(radiance: Floats, key: Ints, width: int) -> tuple[Floats, Floats]:
        keys.update(key.tolist())
        return curvature(radiance, key, width)

    monkeypatch.setattr(antialias, "curvature", noted)
    first, *others = [PointLight(position=(3, 5, 4), intensity=(1 / 80,) * 3)] * 80
    lights = [first, *(replace(light, position=(0, 0, 0)) for light in others)]
    ball = Sphere(center=(0, 0, -4), radius=1.2, shader=RED)
    scene = scene_of(WALL, ball, size=(24, 24), lights=lights)
    no_worse_than_the_uniform_grid(scene, 2, numbers=(16, 64))
    # The wall and the ball, each in its light and out of it.
    assert len(keys) == 4
