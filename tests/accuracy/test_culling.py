"""Culling changes no bit of a picture: all pairs of rays and objects give the same."""

from __future__ import annotations

import math
from dataclasses import replace
from time import process_time
from unittest.mock import patch

import numpy as np
import pytest
from brute_force import brute_force
from hypothesis import given, settings
from hypothesis import strategies as st
from probe import scene_of
from random_scenes import KINDS, random_scene

from tracer import Box, Camera, Lambertian, PointLight, Scene, Sphere, render
from tracer.arrays import Floats
from tracer.light import lighting
from tracer.picture import bands
from tracer.view.camera import raster_of
from tracer.view.samples import Samples, Scattered
from tracer.view.view import View, Visible, view_of


def assert_same(scene: Scene) -> None:
    """Hold the tracer's picture against that of all pairs.

    Made in all ways that there are: with large packets, single points and short packets; objects
    one by one, and together; samples in rows, and scattered.
    """
    expected = brute_force(scene)
    for few, part, large in ((1e9, 0.5, 100), (0, 1e-9, 1e9), (0, 0.2, 1e9)):
        with (
            patch("tracer.shadow.occluders._FEW", few),
            patch("tracer.shadow.occluders._PART", part),
            patch("tracer.view.visibility._LARGE", large),
        ):
            images = render(scene), scattered(scene)
        for image in images:
            different = np.argwhere((image != expected).any(axis=2)).tolist()
            assert not different, (
                f"{len(different)} pixels differ; at row {different[0][0]}, column"
                f" {different[0][1]} {image[tuple(different[0])]} is not"
                f" {expected[tuple(different[0])]}"
            )


@np.errstate(all="ignore")
def scattered(scene: Scene) -> Floats:
    """A picture from samples that are scattered in pixels up to eight times as large."""
    # Powers of two change no bit of a ray.
    times = math.gcd(scene.width, scene.height, 8)
    width, height = scene.width // times, scene.height // times
    coarse = replace(scene, width=width, height=height)
    view = view_of(raster_of(coarse.camera, width, height), coarse.surfaces)
    x, y = ((0.5 + np.arange(n)) / times for n in (scene.width, scene.height))
    samples, order = Scattered.of(np.tile(x, y.size), np.repeat(y, x.size))
    radiance = np.empty((3, order.size))
    radiance[:, order] = lighting.radiance_at(lighting.lighting_of(coarse, view), samples)
    return np.moveaxis(radiance.reshape(3, y.size, x.size), 0, 2)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    ("width", "height"), [(23, 31), pytest.param(160, 120, marks=pytest.mark.slow)]
)
def test_random_scenes(kind: str, width: int, height: int) -> None:
    for seed in range(1 if kind == "crowd" else 8):
        assert_same(random_scene(kind, seed, width, height))


@pytest.mark.parametrize(
    ("kind", "seed", "width", "height"),
    [
        ("touching", 167, 31, 23),  # a row of pixels in the plane of a face, seen obliquely
        ("scattered", 170, 160, 120),  # a shadow that ends just beside a row's last sample
        ("walled", 129, 160, 120),  # the same at the first
        ("walled", 191, 160, 120),  # a box flat along two axes
        ("far", 24, 60, 44),  # two faces in one row, at less than a right angle to each other
        ("enormous", 1632556525, 61, 37),  # a row in the plane of a face with an edge 10^6 as long
    ],
)
def test_scenes_that_once_differed(kind: str, seed: int, width: int, height: int) -> None:
    assert_same(random_scene(kind, seed, width, height))


@pytest.mark.slow
@settings(max_examples=60, deadline=None, derandomize=True)
@given(
    kind=st.sampled_from([kind for kind in KINDS if kind != "crowd"]),
    seed=st.integers(1000, 2**32),
    width=st.integers(1, 200),
    height=st.integers(1, 100),
)
def test_any_scene(kind: str, seed: int, width: int, height: int) -> None:
    assert_same(random_scene(kind, seed, width, height))


CAMERA = Camera(view_point=(0, 1, 6), view_dir=(0, -0.125, -1), view_width=1.5, view_height=1.5)
FLOOR = Box(min_pt=(-8, -1, -8), max_pt=(8, 0, 8), shader=Lambertian(diffuse=(1, 0.5, 0.25)))
BALL = Sphere(center=(0, 1, 0))
CUBE = Box(min_pt=(-1, 0, -1), max_pt=(1, 2, 1))


def scene(
    *surfaces: Sphere | Box, light: tuple[float, float, float] = (3, 5, 4), camera: Camera = CAMERA
) -> Scene:
    return scene_of(*surfaces, camera=camera, size=(120, 120), lights=light)


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_zoomed_in_on_an_edge(kind: str) -> None:
    # Again and again on the first pixel that differs from its neighbour: an outline or the
    # edge of a shadow, in the end 10^7 times as large.
    for seed in range(1 if kind == "crowd" else 4):
        scene = random_scene(kind, seed, 160, 120)
        for _ in range(6):
            image = render(scene)
            assert_same(scene)
            jumps = np.abs(np.diff(image.sum(axis=2), axis=1))
            row, column = np.unravel_index(jumps.argmax(), jumps.shape)
            raster = raster_of(scene.camera, scene.width, scene.height)
            x, y = np.array([column + 1.0]), np.array([row + 0.5])
            local = np.array([raster.across(x)[0], raster.down(y)[0], raster.depth])
            u, v, w = (local @ raster.axes).tolist()
            camera = replace(
                scene.camera,
                view_dir=(u, v, w),
                proj_normal=scene.camera.normal,
                proj_distance=math.hypot(u, v, w),
                view_width=scene.camera.view_width / 16,
                view_height=scene.camera.view_height / 16,
            )
            scene = replace(scene, camera=camera)


def test_a_row_of_rays_along_an_edge() -> None:
    # In the plane of the eye and the box's upper edge: an exact tie, and the box is closed.
    camera = Camera(view_point=(-1, 1, 1), view_dir=(0, -1, -2), view_width=2, view_height=4 / 3)
    box = Box(min_pt=(-3, -1, 0), max_pt=(-2, 0.5, 1))
    scene = scene_of(box, camera=camera, size=(29, 19), lights=(3, 5, 0))
    image = render(scene)
    assert np.array_equal(image, brute_force(scene))
    assert image[9, 0].any()


def test_an_arc_of_more_than_half_a_circle() -> None:
    # Seen from inside a ball, near its wall: the ball on the chord holds least of the arc.
    for eye, toward, other, light in (
        ((0.5, -0.72, 0.37), (-0.6, 0.4, -0.7), (-0.3, -0.4, 0.6), (0.3, -0.4, 0.3)),
        ((0.15, -0.85, -0.39), (-0.2, 0.5, 1.2), (0.5, -0.5, 0), (-0.4, 0.4, -0.4)),
    ):
        camera = Camera(
            view_point=eye, view_dir=toward, view_up=(0.3, 1, 0.2), view_width=12, view_height=2
        )
        walled = scene(Sphere(), Sphere(center=other, radius=0.1), light=light, camera=camera)
        assert_same(replace(walled, width=30, height=8))


def test_many_plates_behind_each_other(monkeypatch: pytest.MonkeyPatch) -> None:
    # They are taken a few rows at a time: memory is for pairs of samples and objects.
    plates = [Box(min_pt=(-9, -9, -k / 10 - 2), max_pt=(9, 9, -k / 10 - 2)) for k in range(60)]
    scene = scene_of(*plates, size=(40, 30), lights=(0, 2, 0))
    most, visible = 0, lighting.visible

    def counted(view: View, samples: Samples) -> Visible:
        nonlocal most
        most = max(most, samples.size)
        return visible(view, samples)

    monkeypatch.setattr(lighting, "visible", counted)
    monkeypatch.setattr(bands, "_TILE_SAMPLES", 40 * 30)
    image = render(scene, processes=1)
    assert 0 < most <= 40 * 30 * 8 / 60
    assert np.array_equal(image, brute_force(scene))


def test_a_hundred_equal_surfaces_take_no_longer_than_one() -> None:
    red, ball = (replace(BALL, shader=Lambertian(diffuse=(1, g, 0))) for g in (0, 1))
    one, many = scene(FLOOR, red), scene(FLOOR, red, *[ball, FLOOR] * 100)
    images, seconds = [], []
    for some in (one, many):
        begin = process_time()
        images.append(render(some, 16, processes=1))
        seconds.append(process_time() - begin)
    assert np.array_equal(*images)
    assert seconds[1] < 5 * seconds[0] + 0.5


def test_no_objects_and_no_lights() -> None:
    for empty in (scene(), replace(scene(FLOOR, BALL), lights=())):
        assert_same(empty)
        assert not render(empty).any()


@pytest.mark.parametrize("other", [BALL, CUBE])
@pytest.mark.parametrize(
    "light",
    [
        (0, 1, 0),  # at the centre
        (0.5, 1.25, 0.25),  # inside
        (0, 2, 0),  # on the top, or on the ball
        (0, 0, 0),  # where it touches the floor
        (1, 1, 0),  # on a side
        (0, 2 + 1e-12, 0),  # just above
        (0, 2 - 1e-12, 0),  # just below
        (0, 5, 0),  # straight over
        (0, 1e-9, 3),  # grazing the floor
        (2, -1, 0),  # on the floor's lower face
        (0, 1e8, 0),
        (0, 1, 6),  # at the eye
    ],
)
def test_light_at_odd_places(other: Sphere | Box, light: tuple[float, float, float]) -> None:
    assert_same(scene(FLOOR, other, light=light))


def test_a_light_on_a_face_but_for_rounding() -> None:
    # What shines up from a table is not inside it because 0.3 is less than 0.1 + 0.2.
    table = Box(min_pt=(-1, 0, -1), max_pt=(1, 0.1 + 0.2, 1))
    ball = Sphere(center=(0, 0.9, 0), radius=0.5)
    below = scene(table, ball, light=(0, 0.3, 0))
    assert_same(below)
    assert render(below).any()


@pytest.mark.parametrize("other", [BALL, CUBE])
@pytest.mark.parametrize(
    "eye",
    [
        (0, 1, 0),  # at the centre
        (0.5, 1.25, 0.25),  # inside
        (0, 2, 0),  # on the top, or on the ball
        (0, 2, 5),  # in the plane of the top
        (0, 0, 5),  # in the floor's face
        (0, 1e-9, 5),  # grazing it
        (0, 1, -5),  # with all of it behind
        (0, 1, 1 + 1e-9),  # just before it
        (1e5, 1e5, 1e5),
    ],
)
@pytest.mark.parametrize("oblique", [None, (1, 1, 2)])
def test_eye_at_odd_places(
    other: Sphere | Box, eye: tuple[float, float, float], oblique: tuple[float, float, float] | None
) -> None:
    toward = (-eye[0], -eye[1], -eye[2]) if eye[0] > 1 else (0, 0, -1)
    camera = replace(CAMERA, view_point=eye, view_dir=toward, proj_normal=oblique)
    camera = replace(camera, view_width=1e-4, view_height=1e-4) if eye[0] > 1 else camera
    assert_same(scene(FLOOR, other, camera=camera))


@pytest.mark.parametrize(
    "hair",
    [
        Box(min_pt=(-2, 1, -1), max_pt=(2, 1, -1)),  # a needle
        Box(min_pt=(0, 1, 0), max_pt=(0, 1, 0)),  # a point
        Box(min_pt=(-1, 1, -1), max_pt=(1, 1, 1)),  # a sheet
        Box(min_pt=(-1, 1, -1), max_pt=(1, 1 + 1e-12, 1)),
        Sphere(center=(0, 1, 0), radius=1e-12),
        Sphere(center=(0, 1, 0), radius=0.004),
        Sphere(center=(0, -(2.0**30), 0), radius=2.0**30 + 0.5),
        Box(min_pt=(-1e9, 4, -1e9), max_pt=(1e9, 1e9, 1e9)),
        # So large that the light and all points count as on its faces.
        Box(min_pt=(-1e14, 4, -1e14), max_pt=(1e14, 4.5, 1e14)),
    ],
)
@pytest.mark.parametrize("light", [(3, 5, 4), (0, 3, 0), (-2.5, 1, 0)])
def test_thin_tiny_and_enormous(hair: Sphere | Box, light: tuple[float, float, float]) -> None:
    assert_same(scene(FLOOR, BALL, hair, light=light))
    assert_same(scene(hair, FLOOR, light=light))


@pytest.mark.parametrize("thickness", [0, 1])
@pytest.mark.parametrize("size", [1e18, 1e30, 1e75])
def test_a_floor_without_end(size: float, thickness: float) -> None:
    # Its corners are so far away that, along the camera's axes, they do not tell the eye's height.
    def picture_of(size: float) -> Scene:
        floor = Box(min_pt=(-size, -thickness, -size), max_pt=(size, 0, size))
        camera = replace(CAMERA, view_point=(0, 1, 0), view_dir=(0.3, -0.2, -1))
        return scene(floor, Sphere(center=(0, 0.5, -3), radius=0.5), camera=camera)

    assert_same(picture_of(size))
    assert np.array_equal(render(picture_of(size)), render(picture_of(1e6)))


@pytest.mark.parametrize("size", [1.0, 2.0**27, 2.0**60])
def test_light_straight_over_an_enormous_floor(size: float) -> None:
    # Straight up, the inverse of the direction is infinite, or nearly so.
    floor = Box(min_pt=(-10 * size, -size, -10 * size), max_pt=(10 * size, 0, 10 * size))
    beam = Box(min_pt=(3 * size, 2 * size, -size), max_pt=(5 * size, 2.5 * size, size))
    camera = Camera(
        view_point=(0, 20 * size, 0), view_dir=(0, -1, 0), view_up=(0, 0, 1), view_width=2
    )
    assert_same(scene(floor, beam, light=(0, 10 * size, 0), camera=camera))


def test_a_ball_that_touches_the_eye_from_behind_is_not_seen() -> None:
    camera = Camera(view_point=(0.1, 0.2, 0.3), view_width=3, view_height=3)
    wall = Box(min_pt=(-9, -9, -9), max_pt=(9, 9, -8))
    alone = scene(wall, light=(0.1, 5, 0), camera=camera)
    for radius in (0.1, 0.2, 0.3, 0.7, 1.1):
        ball = Sphere(center=(0.1, 0.2, 0.3 + radius), radius=radius)
        both = scene(wall, ball, light=(0.1, 5, 0), camera=camera)
        np.testing.assert_array_equal(render(both), render(alone))


def test_a_far_box_through_an_oblique_window() -> None:
    # The ends of an edge are seen in almost the same direction, along none of the camera's axes.
    eye = (3e7, 5e7, 8e7)
    camera = Camera(
        view_point=eye,
        view_dir=(-3, -5, -8),
        proj_normal=(1, 5, 6),
        proj_distance=1e8,
        view_width=4,
        view_height=4,
    )
    assert_same(scene(CUBE, light=eye, camera=camera))


def test_a_light_at_the_horizon_of_an_enormous_ball() -> None:
    # A carpet lies on it but for rounding; it is seen so large that balls around points are tiny.
    ground = Sphere(center=(0, -1e8, 0), radius=1e8)
    carpet = Box(min_pt=(-12, -1, -12), max_pt=(12, 1e-6, 12))
    camera = Camera(view_point=(0, 1, 0), view_dir=(-5, -1, 0), view_width=1e-8, view_height=1e-8)
    assert_same(scene(ground, carpet, light=(1000, 2e-5, 0), camera=camera))


@pytest.mark.parametrize("far", [1e10, 1e13, 1e15, 1e20, 1e40])
@pytest.mark.parametrize("direction", [(1, 2, 1.5), (1, 1, 0), (0, 1, 0)])
def test_a_sun(far: float, direction: tuple[float, float, float]) -> None:
    """Its own rounding, much larger than the scene, is none of the points that it lights."""
    suns = [[PointLight(position=tuple(c * f for c in direction))] for f in (1e6, far)]
    near, sun = (
        scene_of(
            Box(min_pt=(-6, -1, -6), max_pt=(6, 0, 6)),
            Box(min_pt=(-1, 0, -1), max_pt=(0, 1, 0)),
            Box(min_pt=(0.5, 0, 0), max_pt=(1.1, 0.6, 0.6)),
            Sphere(center=(-1.5, 0.5, 1), radius=0.5),
            Sphere(center=(-0.5, 1.3, -0.5), radius=0.3),
            camera=Camera(view_point=(3, 4, 8), view_dir=(-3, -4, -8)),
            size=(40, 40),
            lights=lights,
        )
        for lights in suns
    )
    assert_same(sun)
    np.testing.assert_allclose(render(sun), render(near), rtol=0, atol=1e-5)


@pytest.mark.parametrize("large_first", [True, False])
def test_the_first_of_equal_surfaces_is_seen_whatever_their_sizes(large_first: bool) -> None:
    # One fills the picture, and is looked for in samples of its own.
    floor = Box(min_pt=(-9, -1, -9), max_pt=(9, 0, 9), shader=Lambertian(diffuse=(1, 0, 0)))
    plate = Box(min_pt=(-1, -0.5, -1), max_pt=(1, 0, 1), shader=Lambertian(diffuse=(0, 1, 0)))
    camera = Camera(view_point=(0, 8, 0), view_dir=(0, -1, 0), view_up=(0, 0, -1))
    both = [floor, plate] if large_first else [plate, floor]
    seen = replace(scene(*both, light=(0, 8, 0), camera=camera), width=200, height=200)
    assert render(seen)[100, 100].argmax() == (0 if large_first else 1)
