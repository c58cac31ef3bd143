"""Antialiasing: is the picture at least as accurate as that of a uniform grid of samples?

The test scenes are the project's own, at a small size, and the hard scenes in `tests/scenes`.  Some
scenes have means that are known in closed form; the picture must agree with them.
"""

import math
from collections.abc import Iterable
from dataclasses import replace
from functools import cache
from itertools import product
from typing import Annotated as Shaped

import numpy as np
import pytest
from probe import Surface, record_calls, scene_of
from random_scenes import random_scene
from scene_files import HARD_SCENES, NAMES, hard_scenes, scene_parameters

from reference.command import SCENES
from reference.judges.certificate import certify
from reference.judges.sampling import compute_rms_error as rmse
from reference.judges.sampling import render_supersampled
from reference.measured.workloads import build_crowd_scene
from tracer import (
    Box,
    Camera,
    Lambertian,
    Phong,
    PointLight,
    Scene,
    Sphere,
    explain,
    first_hits,
    load_scene,
    render,
)
from tracer.antialias import refine
from tracer.antialias.cells import Cells
from tracer.antialias.lattice import PIXEL_CENTERS, Lattice
from tracer.antialias.smooth import CenterSamples, estimate_pixel_means, estimate_quarter_means
from tracer.arrays import Floats
from tracer.trace.radiance import compute_radiance_and_visibility
from tracer.world.prepared_scene import PreparedScene

# Maximum error of a reference picture, as certified.
CERTIFIED_ERROR = 1 / 1024

# Number of samples along each side of a pixel for reference pictures that cannot be certified.
REFERENCE_SIDE = 41

RED = Lambertian(diffuse=(1, 0, 0))
BALL = Sphere(radius=1, shader=Phong(diffuse=(0.5, 0.5, 0.5)))
WALL = Box(min_pt=(-9, -9, -2), max_pt=(9, 9, -1))


@cache
def uniform_grid(scene: Scene, per_side: int) -> Shaped[Floats, "height width 3"]:
    """Render a scene with a uniform grid of per_side x per_side samples in each pixel."""
    return render_supersampled(scene, per_side)


def reference_picture(scene: Scene) -> Shaped[Floats, "height width 3"]:
    """Compute the mean radiance of pixels (height, width, 3): certified, or by a fine grid."""
    try:
        certified = certify(scene, CERTIFIED_ERROR)
    except ValueError:  # for example if the eye is on a surface
        return uniform_grid(scene, REFERENCE_SIDE)
    # If the window is extremely far from the eye, the certificate's bounds stay wide.
    return certified.image if certified.error.max() < 0.05 else uniform_grid(scene, REFERENCE_SIDE)


def assert_no_worse_than_grid(
    scene: Scene, error_factor: float = 1, sample_counts: Iterable[int] = (4, 16, 64, 256)
) -> None:
    """Assert that pictures of a scene are at least as accurate as those of a uniform grid.

    The largest error may be `error_factor` times that of the grid; the RMSE must not be larger.
    """
    truth = reference_picture(scene)
    for samples in sample_counts:
        image, grid = render(scene, samples), uniform_grid(scene, math.isqrt(samples))
        largest, grid_largest = np.abs(image - truth).max(), np.abs(grid - truth).max()
        assert rmse(image, truth) <= rmse(grid, truth) + 1e-12, samples
        assert largest <= error_factor * grid_largest + 1e-12, samples


def view(*surfaces: Surface, pixels: int = 16, light=(0, 0, 10), **camera: object) -> Scene:
    """Build a scene that is seen from far away, along the z-axis.

    The picture has pixels x pixels pixels, and shows a square of width 4 of the plane z = 0.
    """
    window = {"proj_distance": 100, "view_width": 4, "view_height": 4}
    camera = Camera(view_point=(0, 0, 100), **window, **camera)
    return scene_of(*surfaces, camera=camera, size=(pixels, pixels), lights=light)


def load_small(name: str) -> Scene:
    """Load a scene of the project, and reduce its picture to a width of 64 pixels."""
    scene = load_scene(SCENES / f"{name}.xml")
    return replace(scene, width=64, height=round(64 * scene.height / scene.width))


@pytest.mark.parametrize(
    "name", scene_parameters("room", "highlights", "four-spheres", "one-box", "touching")
)
def test_no_worse_than_the_uniform_grid(name):
    assert_no_worse_than_grid(load_small(name))


@pytest.mark.slow
@pytest.mark.usefixtures("pixels_are_split")
@pytest.mark.parametrize("name", NAMES)
def test_split_pixels_are_no_worse_than_the_uniform_grid(name):
    # Without the fixture, lattices of samples would replace classification in some scenes, which
    # are full of silhouettes at this size.
    assert_no_worse_than_grid(load_small(name))
    if name in ("many-objects", "room", "two-boxes"):
        assert_no_worse_than_grid(load_small(name), sample_counts=(9, 25, 36, 49, 100))


def test_pictures_full_of_silhouettes_are_lattices():
    scene = build_crowd_scene(3000, width=96, height=54)
    points = Lattice.choose(4).list_points()
    image = render(scene, samples=16)
    # Every other row of pixels has the mirror image.
    for first_row, sign in ((0, 1), (1, -1)):
        offsets = zip(sign * points.real, points.imag, strict=True)
        mean = np.mean([render(scene, offset=offset) for offset in offsets], axis=0)
        assert np.abs(image - mean)[first_row::2].max() <= 1e-12


@pytest.mark.parametrize("max_silhouette_pairs", [-1.0, math.inf])
def test_an_offset_of_whole_pixels_moves_the_picture(max_silhouette_pairs, monkeypatch):
    monkeypatch.setattr(refine, "_MAX_PAIRS_PER_SAMPLE", max_silhouette_pairs)
    scene = build_crowd_scene(30, width=48, height=27)
    image, shifted = (render(scene, 16, offset=offset) for offset in ((0, 0), (3, 2)))
    assert image.std() > 0.05
    # The rays differ by rounding errors, which decide few hits.
    assert np.mean(np.abs(shifted[:-2, :-3] - image[2:, 3:]) > 1e-9) < 0.01


def boxes_seen_at_a_slope(slope: float) -> Scene:
    """Build a scene of small boxes, half of whose visible edges have about this slope."""
    rng = np.random.default_rng(0)
    centers = rng.uniform((-1.2, -1, -4.5), (1.2, 1, -3.5), (60, 3))
    boxes = [
        Box(min_pt=center - half, max_pt=center + half, shader=Lambertian(diffuse=color))
        for center, half in zip(centers, rng.uniform(0.02, 0.15, (60, 3)), strict=True)
        for color in [rng.uniform(0.2, 1, 3)]
    ]
    camera = Camera(view_up=(slope, 1, 0), view_width=0.6, view_height=0.4)
    return scene_of(*boxes, camera=camera, size=(24, 16), lights=(0, 3, 2))


@pytest.mark.parametrize("slope", [0, 1 / 2, 2 / 3, 3 / 4, 1 / 3, 3 / 2])
def test_edges_in_the_directions_of_lattices(slope, monkeypatch):
    monkeypatch.setattr(refine, "_MAX_PAIRS_PER_SAMPLE", -1.0)
    # For 49 samples or more, and the slope 1 / 2, the RMSE of the grid may be 2 % less.
    scene = boxes_seen_at_a_slope(slope)
    assert_no_worse_than_grid(scene, error_factor=1.5, sample_counts=(4, 9, 16, 25, 36))


@pytest.mark.parametrize("slope", [1 / 9, 1 / 8, 1 / 7])
def test_edges_that_are_almost_upright(slope, monkeypatch):
    # Of the two lattices of 65 points that a quarter turn maps onto itself, the other one, with a
    # step of 8 columns, has lines of this slope, and 0.8 to 0.95 times the error of the grid.
    monkeypatch.setattr(refine, "_MAX_PAIRS_PER_SAMPLE", -1.0)
    scene = boxes_seen_at_a_slope(slope)
    truth = reference_picture(scene)
    assert rmse(render(scene, 25), truth) < 0.55 * rmse(uniform_grid(scene, 5), truth)


def test_numbers_of_samples():
    # One sample is at the centre of the pixel.  If each pixel is divided into nine pixels, the
    # central one has the same centre.
    fine = render(view(BALL, pixels=48), samples=1)[1::3, 1::3]
    np.testing.assert_allclose(render(view(BALL), samples=1), fine, atol=1e-12)
    # Other numbers are rounded up to squares.
    assert np.array_equal(render(view(BALL), samples=5), render(view(BALL), samples=9))


@pytest.mark.usefixtures("pixels_are_split")
@pytest.mark.parametrize(
    "closed",
    [Box(min_pt=(-0.5, 0, -0.5), max_pt=(0.5, 1, 0.5)), Sphere(center=(0, 0.4, 0), radius=0.5)],
)
def test_a_light_in_a_closed_surface_lights_nothing_outside(closed):
    # Hits on the floor near the surface are inside of the surface grown by the footprint.
    camera = Camera(view_point=(3, 2.5, 4), view_dir=(-3, -2.2, -4), proj_distance=1.2,
                    view_width=1, view_height=0.75)  # fmt: skip
    floor = Box(min_pt=(-9, -1, -9), max_pt=(9, 0, 9))
    scene = scene_of(floor, closed, camera=camera, size=(120, 90), lights=(0, 0.5, 0))
    assert not render(scene, 16).any()


@pytest.mark.parametrize("slope", [-0.6, -0.3, 0.05, 0.4, 0.7])
def test_every_pixel_that_a_terminator_crosses_is_found(slope, monkeypatch):
    classifications, real_classify = [], refine.classify_cells

    def record_classification(*arguments):
        classifications.append(real_classify(*arguments))
        return classifications[-1]

    monkeypatch.setattr(refine, "classify_cells", record_classification)
    light = np.array([100, 100 * slope, -5])
    render(view(BALL, light=light), 4)
    cells, lines = classifications[0].cells, classifications[0].lines
    # n . l, with the vector l to the light, at the four corners of each pixel; NaN beside the ball.
    corners = [
        first_hits(view(BALL), cells.center_x + dx, cells.center_y + dy)
        for dx, dy in product((-0.5, 0.5), repeat=2)
    ]
    n_dot_l = np.array([(hits.normal * (light - hits.point)).sum(axis=1) for hits in corners])
    is_crossed = (n_dot_l > 1e-6).any(axis=0) & (n_dot_l < -1e-6).any(axis=0)
    is_crossed &= np.isfinite(n_dot_l).all(axis=0)
    assert is_crossed.sum() > 3
    assert {*np.flatnonzero(is_crossed & ~classifications[0].is_unresolved)} <= {*lines.cell_index}


@pytest.mark.parametrize(("name", "improvement"), [("one-sphere", 9), ("four-spheres", 14)])
def test_silhouettes_and_terminators_are_nearly_exact(name, improvement):
    # Both are computed in closed form, and so is the decrease of light towards them.
    scene = load_small(name)
    truth = certify(scene, CERTIFIED_ERROR).image
    assert rmse(render(scene, 16), truth) <= rmse(uniform_grid(scene, 4), truth) / improvement


@pytest.mark.usefixtures("pixels_are_split")
@pytest.mark.parametrize("seed", [18, 48, 52])
def test_no_radiance_is_negative(seed):
    # A point that represents a narrow region may have a negative weight.
    assert render(random_scene("crowd", seed, 24, 16), 4).min() >= 0


def test_quarters_of_cells():
    cells = Cells(
        width=1.0,
        samples_per_side=7,
        tolerance=0.1,
        center_x=np.array([0.5, 1.5, 2.5]),
        center_y=np.full(3, 0.5),
        pair_cell_index=np.array([0, 1, 2, 2]),
        pair_object_index=np.array([10, 11, 12, 13]),
    )
    quarters = cells.divide(np.array([2, 0]))
    assert (quarters.width, quarters.samples_per_side, quarters.tolerance) == (0.5, 4, 0.1)
    assert quarters.center_x.tolist() == [2.25, 2.75, 2.25, 2.75, 0.25, 0.75, 0.25, 0.75]
    assert quarters.center_y.tolist() == [0.25, 0.25, 0.75, 0.75] * 2
    pairs = zip(quarters.pair_cell_index.tolist(), quarters.pair_object_index.tolist(), strict=True)
    assert sorted(pairs) == sorted([*product(range(4), (12, 13)), *product(range(4, 8), (10,))])


def test_the_mean_beside_another_surface_is_not_corrected():
    # Radiance increases by 1 per pixel; the last two of five columns show another surface.
    column = np.tile(np.arange(5), 3)
    samples = CenterSamples(radiance=np.tile(column * 1.0, (3, 1)), id=1 * (column > 2))
    means = estimate_pixel_means(samples, width=5)
    assert np.array_equal(means.radiance.reshape(3, 3, 5)[:, 1, 1:-1], [[1, 2, 3]] * 3)
    assert np.array_equal(means.error.reshape(3, 5)[1, 1:-1], [0, 1 / 24, 1 / 24])


def test_the_error_of_quarters_is_half_of_what_their_cell_lacked():
    # The second cell shows another surface in one quarter: its error says nothing.
    cells = CenterSamples(radiance=np.zeros((3, 2)), id=np.zeros(2, dtype=int))
    quarters = CenterSamples(radiance=np.full((3, 8), 6.0), id=np.array([0, 0, 0, 0, 0, 1, 0, 0]))
    means = estimate_quarter_means(cells, np.full(2, np.nan), quarters, 0.1)
    assert np.array_equal(means.radiance, [[8] * 4 + [6] * 4] * 3)
    assert np.array_equal(means.error, [1] * 4 + [np.nan] * 4, equal_nan=True)


def test_quarters_with_lines_are_refined_although_samples_agree():
    # The horizon passes the centres of the middle row of pixels, and light falls off towards it.
    scene = load_scene(HARD_SCENES / "light-that-falls-off-towards-a-horizon-2.xml")
    view_height = scene.camera.view_height * 3 / 69
    camera = replace(scene.camera, view_width=1 / 30, view_height=view_height)
    scene = replace(scene, camera=camera, width=8, height=3)
    assert np.abs(render(scene, 64) - uniform_grid(scene, 201))[1].max() < 5e-5


def test_ids_are_equal_where_object_face_and_lights_are():
    slab = Box(min_pt=(-3, -2, -3), max_pt=(3, -1, 3))
    cube = Box(min_pt=(-1, -1, -1), max_pt=(1, 1, 1))
    lights = [PointLight(position=p) for p in ((2, 9, 1), (9, 5, 2), (3, 4, 9))]
    camera = Camera(view_point=(5, 4, 3), view_dir=(-5, -4, -3), view_width=1, view_height=0.75)
    ball = Sphere(center=(1, 0, 2), radius=0.7)
    scene = scene_of(ball, slab, cube, camera=camera, size=(16, 12), lights=lights)
    samples = PIXEL_CENTERS.place_in_pixels(slice(0, scene.height), slice(0, scene.width))
    with np.errstate(all="ignore"):  # as where pictures are rendered
        _, sample_id = compute_radiance_and_visibility(PreparedScene(scene), samples)
    id_of = {}
    for (y, x), pixel_id in np.ndenumerate(sample_id.reshape(scene.height, scene.width)):
        pixel = explain(scene, x, y)
        is_box = pixel.surface is not None and pixel.surface.kind == "Box"
        lights_visible = tuple(not light.occluders for light in pixel.lights)
        content = pixel.surface and (pixel.surface, is_box and pixel.normal, lights_visible)
        assert id_of.setdefault(content, pixel_id) == pixel_id
    assert len(set(id_of.values())) == len(id_of) > 9
    assert id_of[None] == -1


@pytest.mark.usefixtures("pixels_are_split")
@pytest.mark.parametrize("hard", hard_scenes("error factor"))
def test_hard_scenes_are_no_worse_than_the_uniform_grid(hard):
    assert_no_worse_than_grid(hard.scene, float(hard.fields["error factor"]), hard.samples)


@pytest.mark.usefixtures("pixels_are_split")
@pytest.mark.parametrize("hard", hard_scenes("largest error"))
def test_nearly_exact(hard):
    scene, largest_error = hard.scene, float(hard.fields["largest error"])
    truth = certify(scene, 1 / 16384)
    assert truth.image.max() > 50 * largest_error
    assert truth.error.max() <= largest_error
    for samples in hard.samples:
        assert np.abs(render(scene, samples) - truth.image).max() <= largest_error


def test_more_lights_than_bits_in_an_id(monkeypatch):
    # An id depends on the lights that reach the surface, also on the first of 66 lights.  The other
    # 65 are at one place, so that two lights give the same picture.
    ids = record_calls(monkeypatch, refine, "estimate_pixel_means", lambda center, width: center.id)
    first = PointLight(position=(3, 5, 4), intensity=(1 / 66,) * 3)
    other = replace(first, position=(0, 0, 0))
    wall = Box(min_pt=(-60, -60, -6), max_pt=(60, 60, -5))
    ball = Sphere(center=(0, 0, -4), radius=1.2, shader=RED)
    camera = Camera(view_width=1, view_height=1)
    scene_of_many = scene_of(wall, ball, camera=camera, size=(9, 9), lights=[first, *[other] * 65])
    scene_of_two = replace(scene_of_many, lights=[first, replace(other, intensity=(65 / 66,) * 3)])
    image = render(scene_of_many, 64)
    # The wall and the ball, each reached by the first light, and shaded from it.
    assert np.unique(np.concatenate(ids)).size == 4
    np.testing.assert_allclose(image, render(scene_of_two, 64), atol=1e-12)
    np.testing.assert_allclose(render(scene_of_many, 16), render(scene_of_two, 16), atol=1e-12)
    assert_no_worse_than_grid(scene_of_two, error_factor=2, sample_counts=(16, 64))
