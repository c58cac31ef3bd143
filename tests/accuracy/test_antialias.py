"""Many samples a pixel: no worse than a uniform grid on any scene of the project.

What lies between the centres of pixels is found, and edges, limbs and shadows whose place is known
in closed form have their share of a pixel.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from probe import scene_of
from uniform_grid import no_worse_than_the_uniform_grid, uniform

from reference.command import own_scenes
from reference.workloads import crowd
from tracer import Box, Camera, Lambertian, Phong, Scene, Sphere, load_scene, render
from tracer.antialias import refine as antialias
from tracer.antialias.lattice import Lattice

SCENES = own_scenes()
SLOW = {"two-boxes", "sunflower", "sticks-axonometric", "sticks-orthographic", "sticks-perspective"}


def small(path: Path) -> Scene:
    """A scene of the project, 64 pixels wide."""
    scene = load_scene(path)
    width = 64
    return replace(scene, width=width, height=round(width * scene.height / scene.width))


@pytest.mark.parametrize(
    "path",
    [pytest.param(m, marks=[pytest.mark.slow] * (m.stem in SLOW), id=m.stem) for m in SCENES],
)
def test_no_worse_than_the_uniform_grid(path: Path) -> None:
    no_worse_than_the_uniform_grid(small(path))


@pytest.mark.slow
@pytest.mark.usefixtures("pixels_are_split")
@pytest.mark.parametrize("path", SCENES, ids=lambda path: path.stem)
def test_splitting_pixels_is_no_worse_than_the_uniform_grid(path: Path) -> None:
    # So small, some of them are so full of outlines that they would be made of lattices.
    no_worse_than_the_uniform_grid(small(path))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["many-objects", "room", "two-boxes"])
def test_other_squares_than_powers_of_four(name: str) -> None:
    scene = small(SCENES[0].parent / f"{name}.xml")
    no_worse_than_the_uniform_grid(scene, numbers=(9, 25, 36, 49, 100))


def test_pictures_full_of_outlines_are_lattices() -> None:
    scene = crowd(3000, width=96, height=54)
    x, y = Lattice.of(4).points()
    image = render(scene, samples=16)
    # Every other row of pixels has the mirror image.
    for first, sign in ((0, 1), (1, -1)):
        offsets = zip(sign * x, y, strict=True)
        mean = np.mean([render(scene, offset=offset, processes=1) for offset in offsets], axis=0)
        assert np.abs(image - mean)[first::2].max() <= 1e-12


@pytest.mark.parametrize("dense", [False, True])
def test_an_offset_of_whole_pixels_moves_the_picture(
    dense: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(antialias, "dense", lambda *_: dense)
    scene = crowd(30, width=48, height=27)
    image, moved = (render(scene, 16, offset=offset) for offset in ((0, 0), (3, 2)))
    assert image.std() > 0.05
    # The rays are the same but for rounding, which decides next to nothing.
    assert np.mean(np.abs(moved[:-2, :-3] - image[2:, 3:]) > 1e-9) < 0.01


@pytest.mark.parametrize("slope", [0, 1 / 2, 2 / 3, 3 / 4, 1 / 3, 3 / 2])
def test_lattices_of_edges_in_their_own_directions(
    slope: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(antialias, "_DENSE", -1.0)
    rng = np.random.default_rng(0)
    centers, halves = rng.uniform((-1.2, -1, -4.5), (1.2, 1, -3.5), (60, 3)), (0.02, 0.15)
    boxes = [
        Box(
            min_pt=center - half,
            max_pt=center + half,
            shader=Lambertian(diffuse=rng.uniform(0.2, 1, 3)),
        )
        for center, half in zip(centers, rng.uniform(*halves, (60, 3)), strict=True)
    ]
    scene = scene_of(
        *boxes,
        camera=Camera(view_up=(slope, 1, 0), view_width=0.6, view_height=0.4),
        size=(24, 16),
        lights=(0, 3, 2),
    )
    # With 49 samples or more, and a slope of 1 / 2, the grid may be closer by some 2 %.
    no_worse_than_the_uniform_grid(scene, times=1.5, numbers=(4, 9, 16, 25, 36))


BALL = Sphere(radius=1, shader=Phong(diffuse=(0.5, 0.5, 0.5)))


def view(
    *surfaces: Sphere | Box, light: tuple[float, float, float] = (0, 0, 10), pixels: int = 16
) -> Scene:
    """So many pixels a side, all together of size 4 on the plane z = 0, seen from far away."""
    return scene_of(
        *surfaces,
        camera=Camera(view_point=(0, 0, 100), proj_distance=100, view_width=4, view_height=4),
        size=(pixels, pixels),
        lights=light,
    )


def test_one_sample_is_the_centre() -> None:
    # Of three by three pixels in the place of each, the middle one has the same centre.
    fine = render(view(BALL, pixels=48), samples=1)[1::3, 1::3]
    np.testing.assert_allclose(render(view(BALL), samples=1), fine, atol=1e-12)


def test_other_numbers_are_rounded_up_to_squares() -> None:
    scene = view(BALL)
    assert np.array_equal(render(scene, samples=5), render(scene, samples=9))


@pytest.mark.parametrize(("radius", "samples"), [(0.02, 1024), (0.05, 256), (0.1, 256)])
def test_objects_between_pixel_centres(radius: float, samples: int) -> None:
    # Centred on a corner of four pixels: no pixel's centre, 1/8 away, sees it.
    scene = view(Sphere(center=(0.5, 0.5, 0), radius=radius))
    assert not render(scene).any()
    assert (render(scene, samples=256) > 0).any(axis=2).sum() == 4
    image = render(scene, samples=samples)
    # A Lambertian disc under a light from the front shines with 2/3 on average; its four
    # quarters are spread over pixels of area 1/16.
    assert image[..., 0].sum() / 16 == pytest.approx(2 / 3 * np.pi * radius**2, rel=0.05)


def test_straight_edges_are_exact() -> None:
    # One edge to a pixel, at a slope or upright: its share of the pixel is known in closed form.
    wall = Box(min_pt=(-9, -9, -1), max_pt=(0.3, 9, 0))
    image = render(view(wall, pixels=64), samples=16)
    # The eye is 100 away and the wall in the plane of the picture: 0.3 is 4/5 into column 36.
    assert image[:, 36] == pytest.approx(0.8 * image[:, 35], abs=0.01)


def test_where_two_edges_cross_is_exact() -> None:
    # The corner of a wall: both edges divide the pixel that holds it, however few the samples.
    wall = Box(min_pt=(-9, -9, -1), max_pt=(0.3, 0.17, 0))
    scene = view(wall)
    scene = replace(scene, camera=replace(scene.camera, view_up=(0.3, 1, 0)))
    for samples in (4, 16):
        assert render(scene, samples=samples) == pytest.approx(uniform(scene, 101), abs=1e-3)


@pytest.mark.parametrize("height", [0.37, 0.8125])
def test_a_level_horizon_is_exact(height: float) -> None:
    # The edge of a floor that begins behind the eye, level to the last bit: the light is so
    # far above it that only the background is dark.
    floor = Box(min_pt=(-99, -2, -10), max_pt=(99, -1, 100))
    window = Camera(view_width=4, view_height=4, proj_distance=8)
    scene = replace(view(floor, light=(0, 1e6, 0), pixels=64), camera=window)
    # The eye is 1 over the floor, which ends 10 ahead: 0.8 below the eye on a window 8 ahead,
    # raised until so much of row 32, 1/16 high, is floor.
    up = (1 - height) / 16 - 0.8
    window = replace(window, view_dir=(0, up / 8, -1), proj_normal=(0, 0, 1))
    image = render(replace(scene, camera=window), samples=16)
    # On the slant the window is a little nearer than it is told to be.
    assert image[32] == pytest.approx(height * image[33], abs=0.02)


@pytest.mark.parametrize("occluder", ["sphere", "box"])
@pytest.mark.parametrize("receiver", ["plane", "ball"])
def test_shadows_between_pixel_centres(occluder: str, receiver: str) -> None:
    # An object halfway to the light throws a shadow twice its size around a pixel corner.
    at, size = (0.25, 0.25, 5.0), 0.02
    ground: Sphere | Box = Box(min_pt=(-9, -9, -1), max_pt=(9, 9, 0))
    if receiver == "ball":
        ground = Sphere(center=(0, 0, -50), radius=50)
    small_one: Sphere | Box = Sphere(center=at, radius=size)
    if occluder == "box":
        low, high = (tuple(x + sign * size for x in at) for sign in (-1, 1))
        small_one = Box(min_pt=low, max_pt=high)  # type: ignore[arg-type]
    with_it, without = view(ground, small_one), view(ground)
    darker = render(without, samples=64) - render(with_it, samples=64)
    shadow = darker[5:7, 9:11]  # around (0.5, 0.5), where the shadow falls
    # Each of the four pixels loses a quarter of the shadow: a disc of radius 0.04, or more.
    assert (shadow > 0.5 * (np.pi * 0.04**2 / 4) * 16).all()
    assert np.array_equal(render(without)[5:7, 9:11], render(with_it)[5:7, 9:11])


@pytest.mark.parametrize(("name", "better"), [("one-sphere", 13), ("four-spheres", 18)])
def test_limbs_and_terminators_are_nearly_exact(name: str, better: float) -> None:
    # Both are known in closed form, with how light falls off towards them.
    scene = small(SCENES[0].parent / f"{name}.xml")
    converged = uniform(scene, 41)
    rmse, grid_rmse = (
        np.sqrt(((image - converged) ** 2).mean())
        for image in (render(scene, samples=16), uniform(scene, 4))
    )
    assert rmse <= grid_rmse / better


@pytest.mark.usefixtures("pixels_are_split")
def test_where_two_boxes_meet_is_exact() -> None:
    # A wall that leans out of another: no edge of either, but a straight line between them.
    back = Box(min_pt=(-9, -9, -9), max_pt=(0.3, 9, 0))
    red = Lambertian(diffuse=(1, 0, 0))
    side = Box(min_pt=(-9, -9, -9), max_pt=(9, 9, -1), shader=red)
    camera = Camera(
        view_point=(6, 0, 8),
        view_dir=(-6, 0, -8),
        view_up=(0.3, 1, 0),
        view_width=0.2,
        view_height=0.2,
    )
    scene = scene_of(back, side, camera=camera, size=(9, 9), lights=(40, 0, 30))
    np.testing.assert_allclose(render(scene, samples=16), uniform(scene, 201), atol=5e-4)


def test_tip_of_one_object_in_another() -> None:
    # A ball that comes a little way through a slab: a cap smaller than a pixel, at a corner.
    red = Phong(diffuse=(1, 0, 0))
    slab = Box(min_pt=(-9, -9, -5), max_pt=(9, 9, 0))
    cap = Sphere(center=(0.5, 0.5, -0.9999), radius=1, shader=red)
    assert (render(view(slab, cap))[..., 1] > 0).all()
    less = render(view(slab), samples=4096) - render(view(slab, cap), samples=4096)
    # The cap's radius is sqrt(2 * 0.0001).
    assert (less[5:7, 9:11, 1] > 0.5 * (np.pi * 0.0002 / 4) * 16).all()


def test_narrow_highlight() -> None:
    # A spot of some 0.03 around (0.15, 0.1), in pixels of 1/4.
    ball = Sphere(shader=Phong(diffuse=(0, 0, 0), specular=(1, 1, 1), exponent=2000))
    scene = view(ball, light=(0.3, 0.2, 100))
    grid = uniform(scene, 8)
    assert np.abs(render(scene, samples=64) - grid).max() <= 0.02 * grid.max()
