"""Compare the tracer with the oracle: random scenes, the project's scenes, and each guarantee.

The oracle is `reference.judges.plain` in decimal arithmetic; `test_closed_forms` tests it.  A pixel
is *certain* if tiny changes of its ray and of all radii change neither the visible surface nor the
lights that reach it.  Pixels that are not certain are not compared.
"""

import math
from collections.abc import Iterable
from dataclasses import replace
from itertools import product
from random import Random
from typing import Annotated as Shaped
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from probe import random_direction, rgb_lights, scale_and_shift, scene_of
from random_scenes import FEW_OBJECTS, KINDS, build_scene, random_scene, scenes
from scene_files import NAMES, scene_parameters, small_scene

from reference.command import SCENES, list_scene_files
from reference.judges import plain
from reference.measured.workloads import copy_with_picture_size
from tracer import Box, Camera, PointLight, Scene, Sphere, first_hits, load_scene, render
from tracer.arrays import Bools, Floats

# Perturbations that do not affect a certain pixel: shifts to the right and down, in pixels, and
# relative changes of all radii.  The shifts exceed the tracer's rounding errors, even at a distance
# of 10^8 times the size of the objects.  The changes of radii separate surfaces that nearly
# coincide, such as a floor and a large sphere as the ground.  The smallest change keeps the eye
# outside such a sphere, even if the eye is only 10^-9 above the floor.
_PERTURBATIONS = ((1e-3, 0, 1e-12), (-5e-4, 9e-4, -1e-12), (-5e-4, -9e-4, 1e-15))


class Comparison(NamedTuple):
    """The n pixels of a picture, row by row, compared with the oracle."""

    exact_rays: plain.TracedRays  # of the oracle
    error: Shaped[Floats, "n"]  # largest absolute error of the three channels
    is_certain: Shaped[Bools, "n"]

    def describe_wrong_pixels(self, tolerance: float) -> str:
        """Describe the certain pixels whose error exceeds a tolerance, one per line."""
        index = np.flatnonzero(self.is_certain & ~(self.error <= tolerance))
        surface_index = self.exact_rays.surface_index
        return "\n".join(f"pixel {i}: {self.error[i]}, {surface_index[i]}" for i in index)


def compare(scene: Scene, image: Shaped[Floats, "height width 3"] | None = None) -> Comparison:
    """Compare an image of a scene, by default the tracer's, with the oracle."""
    image = render(scene) if image is None else image
    y, x = np.indices((scene.height, scene.width)).reshape(2, -1) + 0.5
    exact_rays = plain.trace(scene, x, y, arithmetic="decimal")
    is_certain = np.ones(x.size, dtype=bool)
    for right, down, growth in _PERTURBATIONS:
        surfaces = [
            replace(each, radius=each.radius * (1 + growth)) if isinstance(each, Sphere) else each
            for each in scene.surfaces
        ]
        perturbed_scene = replace(scene, surfaces=surfaces)
        perturbed_rays = plain.trace(perturbed_scene, x + right, y + down, arithmetic="decimal")
        has_same_lights = (perturbed_rays.is_lit == exact_rays.is_lit).all(axis=0)
        is_certain &= (perturbed_rays.surface_index == exact_rays.surface_index) & has_same_lights
    error = np.abs(image.reshape(-1, 3) - exact_rays.radiance).max(axis=1)
    return Comparison(exact_rays=exact_rays, error=error, is_certain=is_certain)


# Tolerances of radiance by kind of scene.  Rounding errors are multiplied by up to 10^4, because
# objects are this many times their size away, and by exponents of up to 60.  In "enormous" scenes,
# hits near a light have rounding errors of 2^24 EPS.  In "grazing" scenes, the eye is only 10^-9
# above a floor, so hits are displaced along the floor.
TOLERANCES = dict.fromkeys(KINDS, 1e-8) | {"enormous": 1e-7, "grazing": 1e-4}


def assert_correct(scenes: Iterable[Scene], tolerance: float, min_certain: float = 0.95) -> None:
    """Assert that the errors of all certain pixels are at most the tolerance.

    Also assert that the fraction of certain pixels is at least `min_certain`.
    """
    certain_fractions = []
    for scene in scenes:
        comparison = compare(scene)
        assert not comparison.describe_wrong_pixels(tolerance), scene
        assert np.isfinite(comparison.error).all()
        certain_fractions.append(comparison.is_certain.mean())
    assert np.mean(certain_fractions) >= min_certain


def test_an_error_is_found():
    scene = small_scene("four-spheres", 8, 6)
    image = render(scene)
    assert not compare(scene, image).describe_wrong_pixels(1e-12)
    image[2, 3, 1] += 1e-6
    assert compare(scene, image).describe_wrong_pixels(1e-8).startswith("pixel 19:")


def test_pixels_next_to_edges_and_nearly_coinciding_surfaces_are_not_certain():
    # The edge at x = 1 is at this distance, in pixels, to the right of the pixel's centre.
    plate = Box(min_pt=(0, 0, 0), max_pt=(1, 1, 0))
    for distance in (0.01, 0.0001):
        camera = Camera(view_point=(1 - distance, 0.5, 5), proj_distance=5)
        scene = scene_of(plate, camera=camera, size=(1, 1), lights=(0, 0, 9))
        assert compare(scene).is_certain.tolist() == [distance > 0.001]
    # The ground touches the floor at x = 0, and is 8e-6 below the floor at x = 1.  From 2e-9 above
    # the floor, a relative change of the radius by 1e-12 would put the eye inside the ground, where
    # it would see only the floor.
    floor = Box(min_pt=(-9, -2, -9), max_pt=(9, -1, 9))
    ground = Sphere(center=(0, -1 - 2.0**16, 0), radius=2.0**16)
    for eye, is_certain in (((0, 1, 0), False), ((1, 1, 0), True), ((0, 2e-9 - 1, 0), False)):
        camera = Camera(view_point=eye, view_dir=(0, -1, 0), view_up=(1, 0, 0), view_width=1e-4)
        scene = scene_of(floor, ground, camera=camera, size=(1, 1), lights=eye)
        assert compare(scene).is_certain.tolist() == [is_certain]


@pytest.mark.parametrize("scale", [1e-60, 1e60])
def test_the_oracle_renders_scenes_of_any_size(scale):
    scene = small_scene("one-sphere", 16, 12)
    exact_image = plain.render(scene, arithmetic="decimal")
    assert exact_image.max() > 0.5
    scaled_image = plain.render(scale_and_shift(scene, scale), arithmetic="decimal")
    np.testing.assert_allclose(scaled_image, exact_image, rtol=0, atol=1e-14)


@pytest.mark.parametrize("is_inside", [False, True])
def test_ties_of_two_faces_are_decided_alike_along_their_edge(is_inside):
    # The central column of pixels shows the edge between two faces.  No light reaches the face on
    # the first axis.
    box = Box(min_pt=(-1, -2, -1), max_pt=(0.5, 2, 1))
    eye, ahead, light = ((4, 6, 8), (-4, -6, -8), (0.4, 9, 9))
    if is_inside:
        # Light reaches all faces from inside; the two faces have different cosines.
        eye, ahead, light = (-0.5, 0, -1), (1, 0.3, 2), (0.499, 0, 0.5)
    camera = Camera(view_point=eye, view_dir=ahead, proj_distance=4)
    scene = scene_of(box, camera=camera, size=(25, 25), lights=light)
    x, y = np.full(15, 12.5), np.arange(5, 20) + 0.5
    first_red, last_red, left_red, right_red = (
        plain.trace(scene, x + shift, y, arithmetic="decimal", ties=ties).radiance[:, 0]
        for shift, ties in ((0, "first"), (0, "last"), (-0.01, "first"), (0.01, "first"))
    )
    np.testing.assert_allclose(first_red, left_red if is_inside else right_red, atol=0.02)
    np.testing.assert_allclose(last_red, right_red if is_inside else left_red, atol=0.02)
    assert (np.abs(first_red - last_red) > 0.1).sum() > 7


@pytest.mark.parametrize(
    "kind", [pytest.param(kind, marks=[pytest.mark.slow] * (kind == "crowd")) for kind in KINDS]
)
def test_random_scenes(kind):
    # A crowd has a thousand objects, so its pictures are smaller.
    size, scene_count = ((3, 2), 2) if kind == "crowd" else ((13, 9), 3)
    scenes = [random_scene(kind, seed, *size) for seed in range(scene_count)]
    # A light at the eye reaches all visible surfaces.
    eye_lights = [PointLight(position=scenes[0].camera.view_point)]
    assert_correct([*scenes, replace(scenes[0], lights=eye_lights)], TOLERANCES[kind])


@pytest.mark.parametrize("kind", FEW_OBJECTS)
@pytest.mark.parametrize("fraction", [0, 0.3, 0.5, 1])
def test_equal_random_numbers_define_a_scene(monkeypatch, kind, fraction):
    # Hypothesis reduces random numbers until many are equal.
    monkeypatch.setattr(Random, "randint", lambda _, low, high: low + int(fraction * (high - low)))
    assert not compare(build_scene(kind, Random(0), 3, 2)).describe_wrong_pixels(TOLERANCES[kind])


@pytest.mark.parametrize("kind", FEW_OBJECTS)
@settings(max_examples=settings.default.max_examples // 5)
@given(data=st.data())
def test_any_random_scene(kind, data):
    scene = data.draw(scenes([kind], st.just(3), st.just(2)))
    assert not compare(scene).describe_wrong_pixels(TOLERANCES[kind])


LARGE_SCENES = {path.stem for path in list_scene_files() if len(load_scene(path).surfaces) > 100}


@pytest.mark.parametrize("name", scene_parameters(*{*NAMES} - LARGE_SCENES))
def test_own_scenes(name):
    # Some cameras are nearly orthographic: their distance is 1,700 times the size of the scene.
    scene = load_scene(SCENES / f"{name}.xml")
    scene = copy_with_picture_size(scene, *((16, 9) if len(scene.surfaces) > 20 else (48, 27)))
    exact_image = plain.render(scene, arithmetic="decimal")
    assert exact_image.max() > 0.1
    np.testing.assert_allclose(render(scene), exact_image, rtol=0, atol=1e-11)
    # In float64, `plain` makes wrong decisions where surfaces coincide.
    if name != "touching":
        np.testing.assert_allclose(plain.render(scene), exact_image, rtol=0, atol=1e-10)


@pytest.mark.usefixtures("pixels_are_split")
@pytest.mark.parametrize(("width", "height"), [(8, 40), (40, 8)])
def test_pictures_of_any_aspect(width, height):
    # There are objects everywhere in the picture, even in rows whose index exceeds the width.
    camera = Camera(view_point=(0, 0, 9), view_width=width / 40, view_height=height / 40)
    long_axis = (0, 1, 0) if height > width else (1, 0, 0)
    spheres = [Sphere(center=np.multiply(i, long_axis), radius=0.3) for i in range(-4, 5)]
    scene = scene_of(*spheres, camera=camera, size=(width, height), lights=(3, 4, 9))
    assert {*first_hits(scene).surface.ravel()} == {*range(-1, 9)}
    assert_correct([scene], 1e-12, 0.9)
    # Antialiasing skips rows and columns without objects, but no others.
    assert render(scene, 4)[render(scene) > 0].min() > 0


# Scaling and shifting rounds the scene's numbers.  The oracle renders the rounded scene, too.
@pytest.mark.parametrize("kind", ["scattered", "touching", "nested", "rooms", "walled"])
@pytest.mark.parametrize(
    ("scale", "offset"),
    [
        *((1, offset) for offset in ((1e6, -1e6, 1e6), (0, 1e6, 0), (1e8,) * 3)),
        *((1e8, offset) for offset in ((0,) * 3, (1e6,) * 3)),
        *((1e-8, offset) for offset in ((1e6,) * 3, (1e8,) * 3)),
    ],
)
def test_scaled_and_shifted(kind, scale, offset):
    shift = np.array(offset) * scale
    scenes = (random_scene(kind, seed, 7, 5) for seed in range(2))
    assert_correct((scale_and_shift(scene, scale, shift) for scene in scenes), 3e-14, 0.9)


@pytest.mark.parametrize("distance", [1e4, 1e6, 1e8])
def test_decisions_from_afar(distance):
    scenes = [random_scene(kind, seed) for kind in ("scattered", "touching") for seed in (1, 2)]
    for i, scene in enumerate(scenes):
        direction = np.array(scene.camera.view_dir)
        camera = Camera(view_point=direction * -distance, view_dir=direction,
                        view_up=scene.camera.view_up, proj_distance=distance, view_width=4,
                        view_height=3)  # fmt: skip
        scenes[i] = replace(scene, camera=camera)
    assert_correct(scenes, 1e-4, 0.98)


def find_largest_error(scenes: Iterable[Scene]) -> float:
    """Compute the largest error of any pixel in scenes whose only object fills the picture.

    If the object is white and Lambertian, and each channel has a separate light, then the error of
    a channel is the error of one component of the normal.
    """
    comparisons = [compare(scene) for scene in scenes]
    assert all((comparison.exact_rays.surface_index == 0).all() for comparison in comparisons)
    return max(float(comparison.error.max()) for comparison in comparisons)


@pytest.mark.parametrize(
    ("distance", "offset", "bound"),
    [
        *((1e2, 0, 3e-13), (1e4, 0, 3e-11), (1e6, 0, 4e-9), (1e8, 0, 2e-7)),
        # An offset rounds the scene's numbers; both pictures show the rounded scene.
        *((6, offset, 3e-14) for offset in (0, 1e2, 1e4, 1e6, 1e8)),
    ],
)
@pytest.mark.parametrize("radius", [1.0, 1e-3, 1e5, 1e-8, 1e8])
def test_distance_and_offset_over_radius(distance, offset, bound, radius):
    rng = np.random.default_rng(int(distance + offset))

    def make_sphere_scene() -> Scene:
        """Make a scene with a sphere that fills 5 x 5 pixels, seen from a random direction."""
        direction, center = random_direction(rng), random_direction(rng) * offset * radius
        lights = [center + (random_direction(rng) * 3 - direction * 4) * radius for _ in range(3)]
        # Rays at the corners pass the centre at a distance of at most 0.7 sqrt(2) = 0.99 radii.
        # Closer to the silhouette, the rounding error of any ray causes an error of the normal that
        # grows by 1 / cosine.
        size = 1.4 * radius * 5 / 4
        camera = Camera(view_point=center - direction * distance * radius, view_dir=direction,
                        view_up=random_direction(rng), proj_distance=distance * radius,
                        view_width=size, view_height=size)  # fmt: skip
        surface = Sphere(center=center, radius=radius)
        return scene_of(surface, camera=camera, size=(5, 5), lights=rgb_lights(*lights))

    assert find_largest_error(make_sphere_scene() for _ in range(4)) <= bound


@pytest.mark.parametrize(("ratio", "height"), [*product((1e4, 1e6, 1e8), (1.0, 1e-3))])
def test_ground_radius_over_height(ratio, height):
    # The eye is at this height above the ground, and looks down at an angle of 20 to 70 degrees.
    # The lights are one radius away from the ground, so only the normal affects the radiance.
    rng, radius = np.random.default_rng(int(ratio) + 2), ratio * height

    def make_ground_scene() -> Scene:
        pitch, heading = math.radians(rng.uniform(20, 70)), rng.uniform(0, 2 * math.pi)
        horizontal = math.cos(pitch)
        ahead = (horizontal * math.cos(heading), -math.sin(pitch), horizontal * math.sin(heading))
        camera = Camera(view_point=(0, height, 0), view_dir=ahead, view_width=0.3, view_height=0.3)
        lights = rgb_lights(*(random_direction(rng) * radius for _ in range(3)))
        surface = Sphere(center=(0, -radius, 0), radius=radius)
        return scene_of(surface, camera=camera, size=(5, 5), lights=lights)

    assert find_largest_error(make_ground_scene() for _ in range(8)) <= 3e-9
