"""First hits as the library reports them: closed forms, and the same surfaces as in the picture."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from probe import scene_of
from random_scenes import random_scene

from tracer import Box, Camera, Lambertian, PointLight, Scene, Sphere, first_hits, render

BALL = Sphere(center=(0, 0, -5), radius=2)
WALL = Box(min_pt=(-50, -50, -12), max_pt=(50, 50, -10))
CAMERA = Camera(view_point=(0, 0, 0), view_dir=(0, 0, -1), view_width=2, view_height=2)


def seen_by(*surfaces: Sphere | Box, camera: Camera = CAMERA) -> Scene:
    return scene_of(*surfaces, camera=camera, size=(4, 4), lights=(3, 5, 4))


def test_closed_forms() -> None:
    # The window is 2 wide at a distance of 1, so pixels are .5: positions on the axis, a ray
    # (.5, -.5, -1) past the ball, and one that leaves the picture.
    hits = first_hits(seen_by(WALL, BALL), [2, 3, 2], [2, 3, -2])
    assert hits.surface.tolist() == [1, 0, 0]
    np.testing.assert_allclose(hits.distance, [3, 10 * np.sqrt(1.5), 10 * np.sqrt(5)], rtol=1e-15)
    np.testing.assert_allclose(hits.point, [(0, 0, -3), (5, -5, -10), (0, 20, -10)], atol=1e-14)
    np.testing.assert_allclose(hits.normal[0], (0, 0, 1), atol=1e-15)
    assert hits.normal[1:].tolist() == [[0, 0, 1], [0, 0, 1]]


def test_nothing_is_hit() -> None:
    hits = first_hits(seen_by(BALL), [0.5, 2], [0.5, 2])
    assert hits.surface.tolist() == [-1, 0]
    assert hits.distance[0] == np.inf
    assert np.isnan(hits.point[0]).all()
    assert np.isnan(hits.normal[0]).all()
    nowhere = first_hits(seen_by(BALL), [], [])
    assert nowhere.surface.shape == (0,)
    assert nowhere.normal.shape == (0, 3)


def test_normals_look_towards_the_eye() -> None:
    for surface in (Sphere(radius=3), Box(min_pt=(-3, -3, -3), max_pt=(3, 3, 3))):
        inside = first_hits(seen_by(surface), [2], [2])
        np.testing.assert_allclose(inside.point[0], (0, 0, -3), atol=1e-15)
        np.testing.assert_allclose(inside.normal[0], (0, 0, 1), atol=1e-15)


def test_of_equal_surfaces_the_first_in_the_file() -> None:
    for surfaces in ((BALL, WALL, BALL), (WALL, BALL, WALL, BALL)):
        first = [surfaces.index(BALL), surfaces.index(WALL)]
        assert first_hits(seen_by(*surfaces), [2, 3.5], [2, 3.5]).surface.tolist() == first


@pytest.mark.parametrize(
    ("x", "y"), [([1], [1, 2]), (1, 1), ([[1]], [[1]]), ([np.nan], [1]), ([1], [np.inf])]
)
def test_positions_that_are_refused(x: list[float], y: list[float]) -> None:
    with pytest.raises(ValueError, match="x and y must be"):
        first_hits(seen_by(BALL), x, y)


def painted(scene: Scene) -> Scene:
    """The scene lit from the eye, with a colour for each surface: green over red is its index."""
    surfaces = [
        replace(surface, shader=Lambertian(diffuse=(1, i, 0)))
        for i, surface in enumerate(scene.surfaces)
    ]
    light = PointLight(position=scene.camera.view_point)
    return replace(scene, surfaces=surfaces, lights=[light])


@pytest.mark.parametrize("kind", ["nested", "duplicated", "crowd"])
def test_the_same_surfaces_as_in_the_picture(kind: str) -> None:
    scene = painted(random_scene(kind, 3, 60, 40))
    image = render(scene)
    row, column = np.indices(image.shape[:2]).reshape(2, -1)
    shuffled = np.random.default_rng(1).permutation(row.size)
    row, column = row[shuffled], column[shuffled]
    hits = first_hits(scene, column + 0.5, row + 0.5)
    red, green, _ = image[row, column].T
    lit = red > 0
    assert lit.sum() > 100
    np.testing.assert_allclose(green[lit] / red[lit], hits.surface[lit])
