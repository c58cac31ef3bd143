"""The library: types of arguments, invalid arguments, PNG data, and first hits."""

import io
from dataclasses import replace
from typing import Any, get_type_hints

import numpy as np
import pytest
from probe import Surface, scene_of
from random_scenes import random_scene

import tracer
from tracer import (
    Box,
    Camera,
    FirstHits,
    Lambertian,
    PointLight,
    Scene,
    Sphere,
    first_hits,
    render,
    to_png,
    write_png,
)
from tracer.trace import first_hits as first_hits_module


def build_scene(width: int = 40, height: int = 30, **camera: Any) -> Scene:
    """Build a scene of a sphere under a light, with the given arguments of the camera."""
    sphere = Sphere(center=(0, 0, -3))
    return scene_of(sphere, camera=Camera(**camera), size=(width, height), lights=(3, 4, 5))


@pytest.mark.parametrize("name", [name for name in tracer.__all__ if name != "Shader"])
def test_type_hints_can_be_evaluated(name):
    value = getattr(tracer, name)
    assert isinstance(get_type_hints(value), dict)
    if isinstance(value, type):
        assert isinstance(get_type_hints(value.__init__), dict)


@pytest.mark.parametrize("kind", [np.int8, np.int16, np.uint64, np.int64, np.array])
def test_sizes_may_be_integers_of_any_kind(kind):
    scene = build_scene(kind(100), kind(90))
    assert (type(scene.width), type(scene.height)) == (int, int)
    image = render(scene, 4)
    assert np.array_equal(image, render(build_scene(100, 90), 4))
    assert np.array_equal(image, render(scene, kind(4)))
    assert type(build_scene(True, 2).width) is int


@pytest.mark.parametrize(
    "view_dir", [(0, 1e-200, -1), (1e-200, 0, -1), (0, 1e-300, -1e300), (0, 3e-320, -1e-320)]
)
def test_underflow_raises_no_error(view_dir):
    scene = build_scene(view_dir=view_dir)
    image = render(scene)
    with np.errstate(all="raise"):
        assert build_scene(view_dir=view_dir) == scene
        assert np.array_equal(render(scene), image)


def test_an_offset_may_be_any_two_numbers():
    image = render(build_scene(), offset=(0.5, 1))
    for offset in ([0.5, 1], np.array([0.5, 1]), (np.float32(0.5), np.int8(1))):
        assert np.array_equal(render(build_scene(), offset=offset), image)  # type: ignore[arg-type]


def test_an_offset_is_in_pixels_although_they_are_not_square():
    scene = build_scene(20, 16, view_width=2, view_height=0.4)
    image, shifted = render(scene), render(scene, offset=(3, 2))
    assert len(np.unique(image)) > 20
    np.testing.assert_allclose(shifted[:-2, :-3], image[2:, 3:], rtol=0, atol=1e-12)


def test_png_data_of_a_scene():
    scene, file = build_scene(), io.BytesIO()
    write_png(file, render(scene, 4))
    assert to_png(scene, 4) == file.getvalue() != to_png(scene)


SPHERE = Sphere(center=(0, 0, -5), radius=2)
WALL = Box(min_pt=(-50, -50, -12), max_pt=(50, 50, -10))


def view(*surfaces: Surface) -> Scene:
    """Build a scene with 4 x 4 pixels, and a window of 2 x 2 at a distance of 1."""
    window = Camera(view_width=2, view_height=2)
    return scene_of(*surfaces, camera=window, size=(4, 4), lights=(3, 5, 4))


def test_first_hits_in_closed_form():
    # The rays pass through the centre of the picture, in the direction (.5, -.5, -1), which misses
    # the sphere, and through two positions outside the picture.  If two surfaces are equal, the
    # first one in the file is hit.
    hits = first_hits(view(WALL, SPHERE, WALL, SPHERE), [2, 3, 2, -2], [2, 3, -2, 2])
    assert hits.surface.tolist() == [1, 0, 0, 0]
    wall_distances = 10 * np.sqrt([1.5, 5, 5])
    np.testing.assert_allclose(hits.distance, [3, *wall_distances], rtol=1e-15)
    points = [(0, 0, -3), (5, -5, -10), (0, 20, -10), (-20, 0, -10)]
    np.testing.assert_allclose(hits.point, points, atol=1e-14)
    np.testing.assert_allclose(hits.normal, [(0, 0, 1)] * 4, atol=1e-15)
    # From inside, normals also point towards the eye.
    for surface in (Sphere(radius=3), Box(min_pt=(-3, -3, -3), max_pt=(3, 3, 3))):
        inside = first_hits(view(surface), [2], [2])
        np.testing.assert_allclose(inside.point, [(0, 0, -3)], atol=1e-15)
        np.testing.assert_allclose(inside.normal, [(0, 0, 1)], atol=1e-15)
    # A short distance to a sphere from inside is accurate; `power` is 1 - |eye|^2.
    z = 2.0**-20 - 1
    close = replace(view(Sphere()), camera=Camera(view_point=(0, 0, z), view_width=2))
    cosine, power = np.sqrt([1, 0.8, 0.5]), (1 + z) * (1 - z)
    expected = power / (np.hypot(z * cosine, np.sqrt(power)) - z * cosine)
    distance = first_hits(close, [2, 3, 4], [2, 2, 2]).distance
    np.testing.assert_allclose(distance, expected, rtol=1e-15)


def test_normals_of_boxes_are_exact_for_an_oblique_camera():
    camera = Camera(view_point=(3, 4, 5), view_dir=(-3, -4, -5), proj_distance=7)
    box = Box(min_pt=(-1, -1, -1), max_pt=(1, 1, 1))
    hits = first_hits(scene_of(box, camera=camera, size=(20, 20), lights=[]))
    normals = {tuple(normal) for normal in hits.normal[hits.surface == 0].tolist()}
    assert normals == {(1, 0, 0), (0, 1, 0), (0, 0, 1)}


def test_rays_without_a_hit_and_shapes_of_results():
    hits = first_hits(view(SPHERE), [0.5, 2], [0.5, 2])
    assert hits.surface.tolist() == [-1, 0]
    assert hits.distance[0] == np.inf
    assert np.isnan([hits.point[0], hits.normal[0]]).all()
    no_positions = first_hits(view(SPHERE), [], [])
    assert (no_positions.surface.shape, no_positions.normal.shape) == ((0,), (0, 3))
    row, column = np.mgrid[0:3, 0:2] + 0.5
    picture, one = first_hits(view(SPHERE), column, row), first_hits(view(SPHERE), 1.5, 2.5)
    assert (picture.distance.shape, picture.point.shape) == ((3, 2), (3, 2, 3))
    assert (one.surface.shape, one.normal.shape) == ((), (3,))
    assert one.distance == picture.distance[2, 1]


def test_first_hits_do_not_depend_on_the_size_of_batches(monkeypatch):
    x, y = np.random.default_rng(2).uniform(0, 60, (2, 500))
    scene = random_scene("crowd", 3, 60, 60)
    hits = first_hits(scene, x, y)
    monkeypatch.setattr(first_hits_module, "_RAYS_PER_BATCH", 70)
    assert_same_hits(first_hits(scene, x, y), hits)
    assert np.unique(hits.surface).size > 5


def assert_same_hits(first: FirstHits, second: FirstHits) -> None:
    """Assert that all arrays of first hits are equal, to the last bit."""
    for name, array in vars(first).items():
        np.testing.assert_array_equal(array, getattr(second, name))


def test_first_hits_of_a_whole_picture():
    scene = random_scene("rooms", 7, 23, 31)
    picture = first_hits(scene)
    assert (picture.surface.shape, picture.normal.shape) == ((31, 23), (31, 23, 3))
    row, column = np.indices((31, 23)) + 0.5
    assert_same_hits(picture, first_hits(scene, column, row))


@pytest.mark.parametrize("far", [1e7, 2.0**53, 1e20, 1e200, 1e308])
def test_positions_far_outside_do_not_change_other_hits(far):
    scene = random_scene("rooms", 7, 40, 30)
    x, y = np.random.default_rng(4).uniform(0, 30, (2, 300))
    alone = first_hits(scene, x, y)
    assert np.unique(alone.surface).size > 3
    corners = np.array([(far, 1.5), (-far, 2.5), (1.5, far), (2.5, -far), (far, far), (-far, far)])
    for others in (corners[:2], corners[2:4], corners):
        together = first_hits(scene, *np.append(others.T, [x, y], axis=1))
        several = FirstHits(*(array[len(others) :] for array in vars(together).values()))
        assert_same_hits(several, alone)
        for index, (far_x, far_y) in enumerate(others):
            one = FirstHits(*(array[index] for array in vars(together).values()))
            assert_same_hits(one, first_hits(scene, far_x, far_y))


@pytest.mark.parametrize("kind", ["nested", "duplicated", "crowd"])
def test_first_hits_are_those_of_the_picture(kind):
    # A light at the eye reaches every visible point.  Green divided by red is the surface's index.
    scene = random_scene(kind, 3, 60, 40)
    surfaces = [
        replace(surface, shader=Lambertian(diffuse=(1, i, 0)))
        for i, surface in enumerate(scene.surfaces)
    ]
    lights = [PointLight(position=scene.camera.view_point)]
    scene = replace(scene, surfaces=surfaces, lights=lights)
    row, column = np.random.default_rng(1).permutation(np.indices((40, 60)).reshape(2, -1), axis=1)
    red, green, _ = render(scene)[row, column].T
    is_lit = red > 0
    assert is_lit.sum() > 100
    hits = first_hits(scene, column + 0.5, row + 0.5)
    np.testing.assert_allclose(green[is_lit] / red[is_lit], hits.surface[is_lit])


def test_a_ball_smaller_than_a_pixel_is_visible_in_any_pixel():
    camera = Camera(view_width=2, view_height=2)
    for row, column in np.ndindex(4, 4):
        ball = Sphere(center=(2 * column - 3, 3 - 2 * row, -4), radius=0.2)
        image = render(scene_of(ball, camera=camera, size=(4, 4), lights=(0, 0, 0)))
        assert np.argwhere(image.any(axis=2)).tolist() == [[row, column]]
