"""Many samples a pixel: no worse than a uniform grid on any scene of the project.

What lies between the centres of pixels is found, and edges, silhouettes and shadows whose place is
known in closed form have their share of a pixel.
"""

import math
from dataclasses import replace

import numpy as np
import pytest
from probe import Surface, scene_of
from random_scenes import random_scene
from scene_files import NAMES, names
from uniform_grid import TRUE, no_worse_than_the_uniform_grid, uniform

from reference.command import SCENES
from reference.judges.true_picture import rmse, true_picture
from reference.measured.workloads import crowd
from tracer import Box, Camera, Lambertian, Phong, PointLight, Scene, Sphere, load_scene, render
from tracer.antialias import refine as antialias
from tracer.antialias.lattice import Lattice
from tracer.trace import visibility


def small(name: str) -> Scene:
    """A scene of the project, 64 pixels wide."""
    scene = load_scene(SCENES / f"{name}.xml")
    return replace(scene, width=64, height=round(64 * scene.height / scene.width))


@pytest.mark.parametrize("name", names("room", "highlights", "four-spheres", "one-box", "touching"))
def test_no_worse_than_the_uniform_grid(name):
    no_worse_than_the_uniform_grid(small(name))


@pytest.mark.slow
@pytest.mark.usefixtures("pixels_are_split")
@pytest.mark.parametrize("name", NAMES)
def test_split_pixels_are_no_worse_than_the_uniform_grid(name):
    # So small, some of them are so full of outlines that they would be made of lattices; and other
    # squares than powers of four.
    no_worse_than_the_uniform_grid(small(name))
    if name in ("many-objects", "room", "two-boxes"):
        no_worse_than_the_uniform_grid(small(name), numbers=(9, 25, 36, 49, 100))


def test_pictures_full_of_outlines_are_lattices():
    scene = crowd(3000, width=96, height=54)
    points = Lattice.of(4).points()
    image = render(scene, samples=16)
    # Every other row of pixels has the mirror image.
    for first, sign in ((0, 1), (1, -1)):
        offsets = zip(sign * points.real, points.imag, strict=True)
        mean = np.mean([render(scene, offset=offset) for offset in offsets], axis=0)
        assert np.abs(image - mean)[first::2].max() <= 1e-12


@pytest.mark.parametrize("supersample", [-1.0, math.inf])
def test_an_offset_of_whole_pixels_moves_the_picture(supersample, monkeypatch):
    monkeypatch.setattr(antialias, "_SUPERSAMPLE", supersample)
    scene = crowd(30, width=48, height=27)
    image, moved = (render(scene, 16, offset=offset) for offset in ((0, 0), (3, 2)))
    assert image.std() > 0.05
    # The rays are the same but for rounding, which decides next to nothing.
    assert np.mean(np.abs(moved[:-2, :-3] - image[2:, 3:]) > 1e-9) < 0.01


@pytest.mark.parametrize("slope", [0, 1 / 2, 2 / 3, 3 / 4, 1 / 3, 3 / 2])
def test_lattices_of_edges_in_their_own_directions(slope, monkeypatch):
    monkeypatch.setattr(antialias, "_SUPERSAMPLE", -1.0)
    rng = np.random.default_rng(0)
    middles, halves = rng.uniform((-1.2, -1, -4.5), (1.2, 1, -3.5), (60, 3)), (0.02, 0.15)
    boxes = [
        Box(min_pt=at - half, max_pt=at + half, shader=Lambertian(diffuse=rng.uniform(0.2, 1, 3)))
        for at, half in zip(middles, rng.uniform(*halves, (60, 3)), strict=True)
    ]
    camera = Camera(view_up=(slope, 1, 0), view_width=0.6, view_height=0.4)
    scene = scene_of(*boxes, camera=camera, size=(24, 16), lights=(0, 3, 2))
    # With 49 samples or more, and a slope of 1 / 2, the grid may be closer by some 2 %.
    no_worse_than_the_uniform_grid(scene, times=1.5, numbers=(4, 9, 16, 25, 36))


BALL = Sphere(radius=1, shader=Phong(diffuse=(0.5, 0.5, 0.5)))


def view(*surfaces: Surface, pixels: int = 16) -> Scene:
    """So many pixels a side, all together of size 4 on the plane z = 0, seen from far away."""
    camera = Camera(view_point=(0, 0, 100), proj_distance=100, view_width=4, view_height=4)
    return scene_of(*surfaces, camera=camera, size=(pixels, pixels), lights=(0, 0, 10))


def test_numbers_of_samples():
    # One is the centre: of three by three pixels in the place of each, the middle one has the same.
    fine = render(view(BALL, pixels=48), samples=1)[1::3, 1::3]
    np.testing.assert_allclose(render(view(BALL), samples=1), fine, atol=1e-12)
    # Others are rounded up to squares.
    assert np.array_equal(render(view(BALL), samples=5), render(view(BALL), samples=9))


@pytest.mark.usefixtures("pixels_are_split")
@pytest.mark.parametrize(
    "closed",
    [
        Box(min_pt=(-0.5, 0, -0.5), max_pt=(0.5, 1, 0.5)),
        Sphere(center=(0, 0.4, 0), radius=0.5),
    ],
)
def test_a_light_that_is_shut_in_lights_nothing_outside(closed):
    # Points on the floor as near to it as a pixel is wide are inside what is that much larger.
    floor = Box(min_pt=(-9, -0.1, -9), max_pt=(9, 0, 9))
    camera = Camera(
        view_point=(3, 2.5, 4), view_dir=(-3, -2.2, -4), proj_distance=1.2, view_height=0.75
    )
    scene = scene_of(floor, closed, camera=camera, size=(120, 90), lights=(0, 0.5, 0))
    assert not render(scene, 16).any()


@pytest.mark.parametrize(("name", "better"), [("one-sphere", 9), ("four-spheres", 14)])
def test_silhouettes_and_terminators_are_nearly_exact(name, better):
    # Both are known in closed form, with how light falls off towards them.
    scene = small(name)
    truth = true_picture(scene, TRUE).image
    ours, grid = (rmse(image, truth) for image in (render(scene, 16), uniform(scene, 4)))
    assert ours <= grid / better


def test_pixels_full_of_dim_shadows_are_sampled(monkeypatch):
    # The edges of forty lights everywhere: to split pixels would take many times the samples.
    counts, candidates = [], visibility._candidates
    at = np.random.default_rng(0).uniform((-9, -9, 9), (9, 9, 12), (40, 3))
    lights = [PointLight(position=position, intensity=(0.03,) * 3) for position in at]
    wall = Box(min_pt=(-9, -9, -9), max_pt=(9, 9, -1))
    scene = replace(view(wall, BALL, pixels=24), lights=lights)

    def noted(prepared, samples):
        counts.append(samples.size)
        return candidates(prepared, samples)

    monkeypatch.setattr(visibility, "_candidates", noted)
    render(scene, 16)
    assert sum(counts) < 4 * 16 * 24 * 24
    no_worse_than_the_uniform_grid(scene, times=1.5, numbers=(4, 16))


@pytest.mark.usefixtures("pixels_are_split")
@pytest.mark.parametrize("seed", [1, 16, 18])
def test_no_radiance_is_negative(seed):
    # What stands for a sliver of a pixel may weigh less than nothing.
    assert render(random_scene("crowd", seed, 24, 16), 4).min() >= 0


def test_crowded_pixels_are_divided_as_well(monkeypatch):
    real = antialias.classify

    def crowded(*cells):
        found = real(*cells)
        return found._replace(crowded=np.ones_like(found.crowded))

    monkeypatch.setattr(antialias, "classify", crowded)
    # Of the tenth column the wall covers 0.33.
    image = render(view(Box(min_pt=(-9, -9, -9), max_pt=(0.25 + 0.33 * 0.25, 9, 0))), 16)[..., 0]
    np.testing.assert_allclose(image[:, 9] / image[:, 8], 0.33, atol=1e-3)


def test_a_picture_of_unresolved_pixels_is_sampled(monkeypatch):
    # To split them all would take four times the samples.
    counts, classify, candidates = [], antialias.classify, visibility._candidates

    def unresolved(*cells):
        found = classify(*cells)
        return found._replace(unresolved=np.ones_like(found.unresolved))

    def noted(prepared, samples):
        counts.append(samples.size)
        return candidates(prepared, samples)

    monkeypatch.setattr(antialias, "classify", unresolved)
    monkeypatch.setattr(visibility, "_candidates", noted)
    image = render(view(BALL, pixels=16), 64)
    assert sum(counts) < 1.2 * 16 * 16 * 65
    np.testing.assert_allclose(image, uniform(view(BALL, pixels=16), 32), atol=0.02)
