"""The cases where ray tracers fail, each with its exact answer worked out.

Every case goes through a whole render.  A picture of one pixel has one ray,
along `view_dir`; lights of pure red, green and blue show their n.l apart.
Tolerances are roundings: EPS times the lengths that are rounded, over the
length that they are measured against.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from probe import EPS, Surface, Vector, colored, moved, radiance_along, scene_of, vector
from random_scenes import KINDS, random_scene

from tracer import (
    Box,
    Camera,
    Lambertian,
    Phong,
    PointLight,
    Scene,
    SceneError,
    Shader,
    Sphere,
    Surfaces,
    render,
)

BALL = Sphere()
CUBE = Box(min_pt=(-1, -1, -1), max_pt=(1, 1, 1))
FLOOR = Box(min_pt=(-50, -1, -50), max_pt=(50, 0, 50))


def test_01_unit_sphere_from_1e8() -> None:
    # Axial ray from (0, 0, D): t = D - 1, p = n = (0, 0, 1); light along (3, 0, 4) / 5.
    seen = radiance_along((0, 0, 1e8), (0, 0, -1), (3, 0, 5), BALL)
    assert seen == pytest.approx(0.8, abs=2 * EPS * 1e8)


@pytest.mark.parametrize("distance", [1e4, 1e6, 1e8])
def test_02_impact_parameter(distance: float) -> None:
    # Impact 0.6: t = D - 0.8, p = n = (0.6, 0, 0.8); lights beside and above show n_x, n_z.
    lights = colored((1.6, 0, 0.8), (0.6, 0, 1.8))
    seen = radiance_along((0.6, 0, distance), (0, 0, -1), lights, BALL)
    assert seen == pytest.approx([0.6, 0.8, 0], abs=4 * EPS * distance)


@pytest.mark.parametrize("side", [-1, 1])
def test_03_at_the_limb(side: int) -> None:
    # Impact b = 1 -+ 2^-20 from D = 1e6; the light at the eye sees n_z = sqrt(1 - b^2).
    b = 1 + side * 2.0**-20
    seen = radiance_along((b, 0, 1e6), (0, 0, -1), (b, 0, 1e6), BALL)
    expected = 0.0 if side > 0 else math.sqrt((1 - b) * (1 + b))
    # An impact rounded by EPS D moves n_z by that over n_z, here 1.4e-3.
    assert seen == pytest.approx(expected, abs=0.0 if side > 0 else EPS * 1e6 / expected)


def test_04_small_sphere_far_away() -> None:
    # r = 0.1 from 1e7, impact 0.095: n = (-sqrt(1 - 0.95^2), 0.95, 0), that is
    # t = 1e7 - 0.1 sqrt(1 - 0.95^2) = 9999999.968775.
    nx = math.sqrt(1 - 0.95**2)
    assert 1e7 - 0.1 * nx == pytest.approx(9999999.968775, abs=1e-6)
    p = (-0.1 * nx, 0.095, 0.0)
    lights = colored((p[0] - 1, p[1], 0), (p[0], p[1] + 1, 0))
    seen = radiance_along((-1e7, 0.095, 0), (1, 0, 0), lights, Sphere(radius=0.1))
    assert seen == pytest.approx([nx, 0.95, 0], abs=2e-7)  # EPS D / r, over n_x


def test_05_huge_ground_sphere() -> None:
    # Eye at height 1 over R = 1e6, d = (0.6, -0.8, 0): t = C / (B + sqrt(B^2 - C)),
    # B = 0.8 (R + 1), C = 2 R + 1.
    R = 1e6
    B, C = 0.8 * (R + 1), 2 * R + 1
    t = C / (B + math.sqrt(B * B - C))
    x, y = 0.6 * t, 1 - 0.8 * t
    n = (x / R, (y + R) / R)
    light = (1.25, 0.5, 0.0)
    to_light = (light[0] - x, light[1] - y)
    cosine = (n[0] * to_light[0] + n[1] * to_light[1]) / math.hypot(*to_light)
    seen = radiance_along((0, 1, 0), (0.6, -0.8, 0), light, Sphere(center=(0, -R, 0), radius=R))
    # The point is rounded by EPS R, and the light 0.7 away.
    assert seen == pytest.approx(cosine, abs=2 * EPS * R / 0.7)


def test_07_shifted_by_two_to_the_twenty() -> None:
    # All coordinates are eighths, so the shift itself is exact.
    def scene(shift: float) -> Scene:
        return scene_of(
            Sphere(center=(shift, shift + 1, shift), radius=1.5),
            Box(
                min_pt=(shift - 4, shift - 1, shift - 4), max_pt=(shift + 4, shift - 0.5, shift + 4)
            ),
            camera=Camera(view_point=(shift, shift + 1, shift + 8), proj_distance=2),
            size=(16, 16),
            lights=(shift + 4, shift + 6, shift + 5),
        )

    image = render(scene(0))
    assert np.count_nonzero(image) > 100
    assert render(scene(2.0**20)) == pytest.approx(image, abs=1e-9)


@pytest.mark.parametrize("y", [-1.0, 1.0])
@pytest.mark.parametrize("dy", [-0.0, 0.0])
@pytest.mark.parametrize("up", [-1.0, 1.0])
def test_08_ray_in_a_face(y: float, dy: float, up: float) -> None:
    # The ray lies in the face y = +-1 and enters through z = 1: n = (0, 0, 1), light at the eye.
    scene = scene_of(
        CUBE,
        camera=Camera(view_point=(0, y, 5), view_dir=(0, dy, -1), view_up=(0, up, 0)),
        size=(1, 1),
        lights=(0, y, 5),
    )
    assert render(scene).tolist() == [[[1, 1, 1]]]


def test_09_no_row_of_holes() -> None:
    # Rows 0 and 1 pass above the cube, row 2 lies in its top, rows 3 and 4 meet it; all
    # columns do: the window 2 x 2 at distance 4 is the cube's face, at 0.8 of its size.
    scene = scene_of(
        CUBE,
        camera=Camera(view_point=(0, 1, 5), proj_distance=4, view_width=2, view_height=2),
        size=(5, 5),
        lights=(0, 1, 5),
    )
    assert (render(scene)[:, :, 0] > 0).tolist() == 2 * [[False] * 5] + 3 * [[True] * 5]


@pytest.mark.parametrize("side", [-1, 1])
def test_10_floor_without_thickness(side: int) -> None:
    # From above n = (0, 1, 0), from below (0, -1, 0); the light along (3, +-4, 0) / 5.
    sheet = Box(min_pt=(-5, 0, -5), max_pt=(5, 0, 5))
    seen = radiance_along((0, 2 * side, 0), (0, -side, 0), (3, 4 * side, 0), sheet)
    assert seen == pytest.approx(0.8, abs=EPS)


@pytest.mark.parametrize("side", [-1, 1])
@pytest.mark.parametrize("edge", [-1, 1])
def test_11_shadow_of_a_plate(side: int, edge: int) -> None:
    # A plate of half width 1/2 at y = 1 under a light at y = 4: the shadow's edge on y = 0
    # is at 1/2 * 4 / 3 = 2/3.
    plate = Box(min_pt=(-0.5, 1, -0.5), max_pt=(0.5, 1, 0.5))
    x = edge * (2 / 3 + side * 1e-12)
    seen = radiance_along((x, 0.5, 0), (0, -1, 0), (0, 4, 0), FLOOR, plate)
    expected = 0.0 if side < 0 else 4 / math.hypot(2 / 3, 4)
    assert seen == pytest.approx(expected, abs=1e-12 if expected else 0.0)


@pytest.mark.parametrize(("height", "lit"), [(1.0, 1), (-1.0, 1), (1 - 2.0**-30, 0)])
def test_11b_shadow_ray_in_a_face(height: float, lit: int) -> None:
    # From a wall, straight along a face of the cube: only what is within the cube blocks.
    wall = Box(min_pt=(5, -9, -9), max_pt=(6, 9, 9))
    seen = radiance_along((4, height, 0), (1, 0, 0), (-5, height, 0), CUBE, wall)
    assert seen.tolist() == [lit] * 3


def test_12_inverted_corners() -> None:
    with pytest.raises(SceneError, match=r"^surface 1: min_pt: must not exceed max_pt"):
        Surfaces(
            min_pt=[(0, 0, 0), (0, 2, 0)], max_pt=[(1, 1, 1), (1, 1, 1)], box_shader=[0, 0],
            shaders=(Lambertian(),),
        )  # fmt: skip


@pytest.mark.parametrize("scale", [1e-8, 2.0**-40, 1e-6, 1.0, 2.0**40, 1e8])
def test_13_shadow_at_the_contact(scale: float) -> None:
    # The cube stands on a floor at y = -1.  The light (4, 5, -3) lies on a line with its
    # vertex (1, 1, -1), at (4 - 3 s, 5 - 4 s, -3 + 2 s); s = 1.5 is (-0.5, -1, 0), in the
    # contact face.  The eye within the cube sees the floor there, which is listed first.
    floor = Box(min_pt=(-9, -3, -9), max_pt=(9, -1, 9))
    scene = scene_of(
        floor,
        CUBE,
        camera=Camera(view_point=(-0.5, 0, 0), view_dir=(0, -1, 0), view_up=(0, 0, 1)),
        size=(1, 1),
        lights=(4, 5, -3),
    )
    assert not render(moved(scene, scale)).any()
    # Without the cube: l = (4.5, 6, -3) / sqrt(65.25).
    alone = moved(replace(scene, surfaces=[floor]), scale)
    assert render(alone) == pytest.approx(np.full((1, 1, 3), 6 / math.sqrt(65.25)), abs=4 * EPS)


@pytest.mark.parametrize("offset", [1e-3, 1e-6, 1e-9, 1e-12])
@pytest.mark.parametrize("angle", [0.0, 0.3, 1.0, 1.4])
def test_14_terminator(offset: float, angle: float) -> None:
    # The light at (0, 5, 0) is seen from n iff n.(L - n) > 0, that is n_y > 1 / 5.
    for side in (-1, 1):
        y = 0.2 + side * offset
        across = math.sqrt(1 - y * y)
        eye = (across * math.cos(angle) * 7, y, across * math.sin(angle) * 7)
        seen = radiance_along(eye, (-math.cos(angle), 0, -math.sin(angle)), (0, 5, 0), BALL)
        assert (seen > 0).all() == (side > 0)


@pytest.mark.parametrize("kind", ["scattered", "enormous", "far"])
def test_15_light_at_the_eye(kind: str) -> None:
    # A light at the eye shows whatever is seen: black is only where each object alone is.
    scene = random_scene(kind, 7, width=24, height=24)
    scene = replace(scene, lights=(PointLight(position=scene.camera.view_point),))
    alone = [render(replace(scene, surfaces=[o])) > 0 for o in scene.surfaces[:]]
    seen = np.logical_or.reduce(alone)
    assert seen.any()
    assert np.array_equal(render(scene) > 0, seen)


@pytest.mark.parametrize("height", [3.0, 0.1, 1e5 / 3])
def test_16_light_on_a_ceiling(height: float) -> None:
    # The light is in the ceiling's lower face; the floor y = 0 gets n.l = height / |L - p|.
    ceiling = Box(min_pt=(-9, height, -9), max_pt=(9, 1.1 * height, 9))
    for x in np.linspace(-5, 5, 11).tolist():
        light = (0.3, height, 0.2)
        seen = radiance_along((x, height / 2, 0), (0, -1, 0), light, ceiling, FLOOR)
        expected = height / math.hypot(x - 0.3, height, 0.2)
        assert seen == pytest.approx(expected, rel=8 * EPS)


@pytest.mark.parametrize(("center", "radius"), [((0, 0, 0), 1), ((0.3, 0.7, 0.2), 0.1)])
def test_17_light_on_a_sphere(center: Vector, radius: float) -> None:
    # The light is on top of the sphere; a wall 3 away is lit above that level only, and the
    # sphere itself nowhere, being convex.
    ball = Sphere(center=center, radius=radius)
    top = (center[0], center[1] + radius, center[2])
    wall = Box(min_pt=(3, -9, -9), max_pt=(4, 9, 9))
    for offset in (1, 1e-3, 1e-9):
        for side in (-1, 1):
            eye = (2.0, top[1] + side * offset, center[2])
            seen = radiance_along(eye, (1, 0, 0), top, ball, wall)
            expected = (3 - top[0]) / math.hypot(3 - top[0], offset) if side > 0 else 0.0
            assert seen == pytest.approx(expected, abs=4 * EPS if side > 0 else 0.0)
    for y in np.linspace(-0.99, 0.99, 12).tolist():
        eye = (center[0] + 2, center[1] + y * radius, center[2])
        assert not radiance_along(eye, (-1, 0, 0), top, ball).any()


@pytest.mark.parametrize("x", [-2, 0, 1])
def test_17b_light_on_the_wall_of_a_round_room(x: float) -> None:
    # The lamp is at its top, 4 over a table in the middle, and the room is around both.
    room, table = Sphere(radius=4), Box(min_pt=(-2, -1, -1), max_pt=(2, 0, 1))
    seen = radiance_along((x, 1, 0), (0, -1, 0), (0, 4, 0), room, table)
    assert seen == pytest.approx(4 / math.hypot(x, 4), rel=8 * EPS)


@pytest.mark.parametrize("kind", KINDS)
def test_18_everything_listed_twice(kind: str) -> None:
    for seed in range(20, 26):
        scene = random_scene(kind, seed)
        twice = replace(scene, surfaces=[*scene.surfaces[:], *scene.surfaces[:]])
        assert np.array_equal(render(twice), render(scene))


def test_19_light_at_1e8() -> None:
    # A slab from 0.01 to 0.02 over the floor, |x| <= 1, light along (0.6, 0.8, 0) from 1e8:
    # rays from (x, 0) rise through it where x + 0.0075 <= 1 and x + 0.015 >= -1.
    slab = Box(min_pt=(-1, 0.01, -1), max_pt=(1, 0.02, 1))
    light = (6e7, 8e7, 0.0)
    for x, lit in ((-1.0151, True), (-1.0149, False), (0, False), (0.9924, False), (0.9926, True)):
        seen = radiance_along((x, 0.005, 0), (0, -1, 0), light, FLOOR, slab)
        assert seen == pytest.approx(0.8 if lit else 0.0, abs=2e-8)  # x / 1e8


def test_20_at_the_centre_of_a_sphere() -> None:
    # Eye and light at the centre: l = -d = n, so radiance is kd I everywhere.
    scene = scene_of(
        Sphere(shader=Lambertian(diffuse=(0.5, 0.5, 1))),
        camera=Camera(view_width=3, view_height=3),
        size=(9, 9),
        lights=[PointLight(position=(0, 0, 0), intensity=(1, 0.5, 0.25))],
    )
    expected = np.broadcast_to([0.5, 0.25, 0.25], (9, 9, 3))
    assert render(scene) == pytest.approx(expected, abs=4 * EPS)


def test_20b_eye_on_a_sphere() -> None:
    # It sees the other side, from inside: there the light in the middle arrives straight.
    seen = radiance_along((0, 0, 1), (0, 0, -1), (0, 0, 0), BALL)
    assert seen.tolist() == [1, 1, 1]


@pytest.mark.parametrize("light", [(0, 0, 5), (0, 0, -1), (0, 0, 1.0000001), (3, 2, -9)])
def test_21_in_a_box_with_the_light_outside(light: Vector) -> None:
    # Its wall keeps out all light that is not strictly inside.
    for direction in ((0, 0, -1), (1, 0, 0), (1, 2, 3)):
        assert not radiance_along((0, 0, 0), direction, light, CUBE).any()
    # From within it comes through: n = l = (0, 0, 1).
    assert radiance_along((0, 0, 0), (0, 0, -1), (0, 0, 0.5), CUBE).tolist() == [1, 1, 1]


def test_22_light_inside_a_ball() -> None:
    # Seen from outside: the ball is black, and so is all that it keeps from the light.
    for x in np.linspace(-4, 4, 9).tolist():
        assert not radiance_along((x, 3, 5), (-x / 9, -3, -5), (0.5, 0.25, 0), BALL).any()
        floor = Box(min_pt=(-9, -3, -9), max_pt=(9, -2, 9))
        assert not radiance_along((x, -1.5, 0), (0, -1, 0), (0.5, 0.25, 0), BALL, floor).any()


@pytest.mark.parametrize("room", [Sphere(center=(0.3, 0.1, 0.2), radius=3.7), CUBE])
def test_22b_room_listed_twice(room: Surface) -> None:
    # Of two rooms the first is seen; the second, on which its points lie, hides no light
    # that is within.
    def scene(*rooms: Surface) -> Scene:
        return scene_of(
            *rooms,
            camera=Camera(view_point=(0.1, 0.2, 0.5), view_width=3, view_height=3),
            size=(16, 16),
            lights=(0.4, -0.3, 0.1),
        )

    once = render(scene(room))
    assert (once > 0).all()
    assert np.array_equal(render(scene(room, room)), once)


@pytest.mark.parametrize("side", [-1, 1])
@pytest.mark.parametrize("axis", range(3))
def test_22c_eye_on_a_wall(axis: int, side: int) -> None:
    # Inwards every ray meets a wall that the light in the middle reaches, outwards none, and along
    # the wall those of one half of the picture.
    outwards = np.roll([side, 0, 0], axis)
    for direction, share in ((-outwards, 1.0), (outwards, 0.0), (np.roll(outwards, 1), 0.5)):
        scene = scene_of(
            CUBE,
            camera=Camera(
                view_point=vector(outwards), view_dir=vector(direction), view_up=(1, 2, 4)
            ),
            size=(16, 16),
            lights=(0, 0, 0),
        )
        assert (render(scene) > 0).mean() == share


@pytest.mark.parametrize(
    "shader", [Lambertian(), Phong(specular=(1, 1, 1), exponent=0), Phong(specular=(1, 1, 1))]
)
def test_23_light_at_the_hit_point(shader: Shader) -> None:
    # There is no direction to the light: it adds nothing.
    floor, ball = replace(FLOOR, shader=shader), replace(BALL, shader=shader)
    assert radiance_along((0, 1, 0), (0, -1, 0), (0, 0, 0), floor).tolist() == [0, 0, 0]
    assert radiance_along((0, 0, 5), (0, 0, -1), (0, 0, 1), ball).tolist() == [0, 0, 0]


@pytest.mark.parametrize("exponent", [1.0, 1e2, 1e4, 1e6])
def test_24_narrow_highlight(exponent: float) -> None:
    # With x = tan(d) = 2^-10 the light at (2 x, 1 - x^2, 0), exactly, is 2 d off the vertical
    # on which the eye is, so n.h = cos d = (1 + x^2)^(-1/2).
    x = 2.0**-10
    shader = Phong(diffuse=(0, 0, 0), specular=(1, 1, 1), exponent=exponent)
    seen = radiance_along(
        (0, 2, 0), (0, -1, 0), (2 * x, 1 - x * x, 0), replace(FLOOR, shader=shader)
    )
    assert seen == pytest.approx(math.exp(-exponent / 2 * math.log1p(x * x)), rel=1e-12)


def test_25_exponent_zero() -> None:
    # (n.h)^0 = 1: the ball is ks where n.l > 0, 0 elsewhere, and both occur.
    ball = Sphere(shader=Phong(diffuse=(0, 0, 0), specular=(0.5, 0.25, 1), exponent=0))
    scene = scene_of(
        ball,
        camera=Camera(view_point=(0, 0, 5), proj_distance=4, view_width=3, view_height=3),
        size=(16, 16),
        lights=(5, 3, -1),
    )
    pixels = {tuple(pixel) for pixel in render(scene).reshape(-1, 3).tolist()}
    assert pixels == {(0, 0, 0), (0.5, 0.25, 1)}


@pytest.mark.parametrize("exponent", [0.0, 1.0, 10.0])
def test_26_light_straight_behind_the_limb(exponent: float) -> None:
    # The ray touches the ball at (0, 1, 0), where l = -v: no half vector, and n.l = 0, which
    # a rounded normal sees as a few EPS.
    ball = Sphere(shader=Phong(specular=(1, 1, 1), exponent=exponent))
    assert radiance_along((-2, 1, 0), (1, 0, 0), (2, 1, 0), ball) == pytest.approx(0, abs=4 * EPS)


def test_27_degenerate_cameras() -> None:
    with pytest.raises(SceneError, match=r"^view_up: must not be parallel to view_dir"):
        Camera(view_dir=(1, 2, 3), view_up=(-2, -4, -6))
    with pytest.raises(SceneError, match=r"^view_up: must not be parallel to proj_normal"):
        Camera(proj_normal=(0, 1, 1), view_up=(0, 3, 3))
    with pytest.raises(SceneError, match=r"^proj_normal: must not be perpendicular to view_dir"):
        Camera(view_dir=(0, 3, -4), proj_normal=(0, 4, 3), view_up=(1, 0, 0))


def test_28_nearly_orthographic() -> None:
    # From D = 1e6 the ray through (x, y) of the plane z = 0 makes the angle
    # f = atan(b / D) with the axis, b = |(x, y)|; by the sine rule the normal it meets makes
    # asin(D sin f) - f.  Lights far along x, y and z show the normal.
    D = 1e6
    scene = scene_of(
        BALL,
        camera=Camera(view_point=(0, 0, D), proj_distance=D, view_width=1.4, view_height=1.4),
        size=(7, 7),
        lights=colored((1e9, 0, 0), (0, 1e9, 0), (0, 0, 1e9)),
    )
    image = render(scene)
    for i, y in enumerate(np.linspace(0.6, -0.6, 7).tolist()):
        for j, x in enumerate(np.linspace(-0.6, 0.6, 7).tolist()):
            b = math.hypot(x, y)
            f = math.atan(b / D)
            angle = math.asin(D * math.sin(f)) - f
            n = (
                math.sin(angle) * x / b if b else 0.0,
                math.sin(angle) * y / b if b else 0.0,
                math.cos(angle),
            )
            # What the lights, 1e9 away, do not see of it: 1e-9 of |p|.
            assert image[i, j] == pytest.approx(np.maximum(n, 0), abs=2e-9)
