"""Compare the tracer with the oracle: random scenes, the project's scenes, and each guarantee.

The oracle is `reference.judges.plain` in decimal arithmetic; `test_closed_forms` tests it.  A pixel
is *certain* if tiny changes of its ray and of the radii do not change which surface it sees, nor
which lights reach this surface.  Pixels that are not certain are not compared.
"""

import math
from collections.abc import Iterable
from dataclasses import replace
from itertools import product
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from probe import random_direction, rgb_lights, scale_and_shift, scene_of
from random_scenes import FEW_OBJECTS, KINDS, random_scene, scenes
from scene_files import NAMES, scene_parameters, small_scene

from reference.command import SCENES, list_scene_files
from reference.judges import plain
from reference.measured.workloads import resize_picture
from tracer import Box, Camera, PointLight, Scene, Sphere, first_hits, load_scene, render
from tracer.arrays import Bools, Floats

# Changes that must not change what a certain pixel sees: shifts to the right and down, in pixels,
# and relative changes of all radii.  The shifts exceed the tracer's rounding errors, even from 10^8
# times as far as the objects are large.  The changes of radii separate surfaces that nearly
# coincide, such as a large sphere as the ground and a floor.
_PERTURBATIONS = ((1e-3, 0, 1e-12), (-5e-4, 9e-4, -1e-12), (-5e-4, -9e-4, 1e-12))


class Comparison(NamedTuple):
    """The n pixels of a picture, row by row, compared with the oracle.

    Attributes
    ----------
    seen : plain.TracedRays
        What each pixel sees, according to the oracle.
    error : (n,) float array
        Largest absolute error of the three channels.
    is_certain : (n,) bool array
        Whether the perturbed pixel sees the same surface, reached by the same lights.
    """

    seen: plain.TracedRays
    error: Floats
    is_certain: Bools

    def wrong(self, tolerance: float) -> str:
        """List the certain pixels whose error exceeds the tolerance; empty if there are none."""
        pixels = np.flatnonzero(self.is_certain & ~(self.error <= tolerance))
        return "\n".join(f"pixel {k}: {self.error[k]}, {self.seen.surface[k]}" for k in pixels)


def compare(scene: Scene, image: Floats | None = None) -> Comparison:
    """Compare an image of a scene with the oracle; without an image, compare the tracer's."""
    image = render(scene) if image is None else image
    y, x = np.indices((scene.height, scene.width)).reshape(2, -1) + 0.5
    seen = plain.trace(scene, x, y, arithmetic="decimal")
    is_certain = np.ones(x.size, dtype=bool)
    for right, down, growth in _PERTURBATIONS:
        surfaces = [
            replace(s, radius=s.radius * (1 + growth)) if isinstance(s, Sphere) else s
            for s in scene.surfaces
        ]
        perturbed = replace(scene, surfaces=surfaces)
        near = plain.trace(perturbed, x + right, y + down, arithmetic="decimal")
        is_certain &= (near.surface == seen.surface) & (near.is_lit == seen.is_lit).all(axis=0)
    error = np.abs(image.reshape(-1, 3) - seen.radiance).max(axis=1)
    return Comparison(seen, error, is_certain)


# Tolerances of radiance by kind of scene.  Rounding errors are multiplied by up to 10^4, because
# objects are seen from this many times their size, and by exponents of up to 60.  In "enormous"
# scenes, hits near a light have rounding errors of 2^24 EPS.  In "grazing" scenes, the eye is as
# close as 10^-9 to a floor, so hits are displaced along the floor.
TOLERANCES = dict.fromkeys(KINDS, 1e-8) | {"enormous": 1e-7, "grazing": 1e-4}


def assert_correct(scenes: Iterable[Scene], tolerance: float, min_certain: float = 0.95) -> None:
    """Assert that the errors of all certain pixels are at most the tolerance.

    `min_certain` is the minimum share of the pixels that must be certain.
    """
    certain = []
    for scene in scenes:
        comparison = compare(scene)
        assert not comparison.wrong(tolerance), scene
        assert np.isfinite(comparison.error).all()
        certain.append(comparison.is_certain.mean())
    assert np.mean(certain) >= min_certain


def test_an_error_is_found():
    scene = small_scene("four-spheres", 8, 6)
    image = render(scene)
    assert not compare(scene, image).wrong(1e-12)
    image[2, 3, 1] += 1e-6
    assert compare(scene, image).wrong(1e-8).startswith("pixel 19:")


def test_pixels_next_to_edges_and_nearly_coinciding_surfaces_are_not_certain():
    # The edge at x = 1 is this part of a pixel to the right of the centre of the pixel.
    plate = Box(min_pt=(0, 0, 0), max_pt=(1, 1, 0))
    for distance in (0.01, 0.0001):
        camera = Camera(view_point=(1 - distance, 0.5, 5), proj_distance=5)
        scene = scene_of(plate, camera=camera, size=(1, 1), lights=(0, 0, 9))
        assert compare(scene).is_certain.tolist() == [distance > 0.001]
    # The ground touches the floor at x = 0, and is 8e-6 below the floor at x = 1.
    floor = Box(min_pt=(-9, -2, -9), max_pt=(9, -1, 9))
    ground = Sphere(center=(0, -1 - 2.0**16, 0), radius=2.0**16)
    down = {"view_dir": (0, -1, 0), "view_up": (1, 0, 0), "view_width": 1e-4}
    for x in (0.0, 1.0):
        camera = Camera(view_point=(x + 1e-3, 1, 0), **down)
        scene = scene_of(floor, ground, camera=camera, size=(1, 1), lights=(0, 5, 0))
        assert compare(scene).is_certain.tolist() == [x > 0]


@pytest.mark.parametrize("scale", [1e-60, 1e60])
def test_the_oracle_sees_scenes_of_any_size(scale):
    scene = small_scene("one-sphere", 16, 12)
    exact = plain.render(scene, arithmetic="decimal")
    assert exact.max() > 0.5
    scaled = plain.render(scale_and_shift(scene, scale), arithmetic="decimal")
    np.testing.assert_allclose(scaled, exact, rtol=0, atol=1e-14)


@pytest.mark.parametrize("inside", [False, True])
def test_ties_of_two_faces_are_decided_alike_along_their_edge(inside):
    # The central column of pixels sees the edge between two faces.  No light reaches the face on
    # the first axis.
    box = Box(min_pt=(-1, -2, -1), max_pt=(0.5, 2, 1))
    eye, ahead, light = ((4, 6, 8), (-4, -6, -8), (0.4, 9, 9))
    if inside:
        # Light reaches all faces from inside; the two faces have different cosines.
        eye, ahead, light = (-0.5, 0, -1), (1, 0.3, 2), (0.499, 0, 0.5)
    camera = Camera(view_point=eye, view_dir=ahead, proj_distance=4)
    scene = scene_of(box, camera=camera, size=(25, 25), lights=light)
    x, y = np.full(15, 12.5), np.arange(5, 20) + 0.5
    first, last, left, right = (
        plain.trace(scene, x + shift, y, arithmetic="decimal", ties=ties).radiance[:, 0]
        for shift, ties in ((0, "first"), (0, "last"), (-0.01, "first"), (0.01, "first"))
    )
    np.testing.assert_allclose(first, left if inside else right, atol=0.02)
    np.testing.assert_allclose(last, right if inside else left, atol=0.02)
    assert (np.abs(first - last) > 0.1).sum() > 7


@pytest.mark.parametrize(
    "kind", [pytest.param(kind, marks=[pytest.mark.slow] * (kind == "crowd")) for kind in KINDS]
)
def test_random_scenes(kind):
    # A crowd has a thousand objects, so its pictures are smaller.
    size, count = ((3, 2), 2) if kind == "crowd" else ((13, 9), 3)
    scenes = [random_scene(kind, seed, *size) for seed in range(count)]
    # A light at the eye reaches all visible surfaces.
    at_eye = [PointLight(position=scenes[0].camera.view_point)]
    assert_correct([*scenes, replace(scenes[0], lights=at_eye)], TOLERANCES[kind])


@pytest.mark.parametrize("kind", FEW_OBJECTS)
@settings(max_examples=settings.default.max_examples // 5)
@given(data=st.data())
def test_any_random_scene(kind, data):
    scene = data.draw(scenes([kind], st.just(3), st.just(2)))
    assert not compare(scene).wrong(TOLERANCES[kind])


LARGE = {path.stem for path in list_scene_files() if len(load_scene(path).surfaces) > 100}


@pytest.mark.parametrize("name", scene_parameters(*{*NAMES} - LARGE))
def test_own_scenes(name):
    # Some scenes are seen from 1,700 times their size, which is nearly orthographic.
    scene = load_scene(SCENES / f"{name}.xml")
    scene = resize_picture(scene, *((16, 9) if len(scene.surfaces) > 20 else (48, 27)))
    exact = plain.render(scene, arithmetic="decimal")
    assert exact.max() > 0.1
    np.testing.assert_allclose(render(scene), exact, rtol=0, atol=1e-11)
    # Without exact arithmetic, `plain` decides wrongly where surfaces coincide.
    if name != "touching":
        np.testing.assert_allclose(plain.render(scene), exact, rtol=0, atol=1e-10)


@pytest.mark.usefixtures("pixels_are_split")
@pytest.mark.parametrize(("width", "height"), [(8, 40), (40, 8)])
def test_pictures_of_any_aspect(width, height):
    # Objects are in all parts of the picture, also in rows whose number exceeds the width.
    camera = Camera(view_point=(0, 0, 9), view_width=width / 40, view_height=height / 40)
    long_axis = (0, 1, 0) if height > width else (1, 0, 0)
    balls = [Sphere(center=np.multiply(k, long_axis), radius=0.3) for k in range(-4, 5)]
    scene = scene_of(*balls, camera=camera, size=(width, height), lights=(3, 4, 9))
    shown = {int(k) for k in first_hits(scene).surface.ravel()}
    assert shown == {*range(-1, 9)}
    assert_correct([scene], 1e-12, 0.9)
    # Antialiasing skips rows and columns without objects, but no others.
    assert render(scene, 4)[render(scene) > 0].min() > 0


# Scaling and shifting round the scene.  The oracle renders the rounded scene, as the tracer does.
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


def largest_error(scenes: Iterable[Scene]) -> float:
    """Compute the largest error of any pixel in scenes whose only object fills the picture.

    If the object is white and Lambertian, and a separate light shines in each channel, then the
    error of a channel is that of a component of the normal.
    """
    comparisons = [compare(scene) for scene in scenes]
    assert all((comparison.seen.surface == 0).all() for comparison in comparisons)
    return max(float(comparison.error.max()) for comparison in comparisons)


@pytest.mark.parametrize(
    ("distance", "offset", "bound"),
    [
        *((1e2, 0, 3e-13), (1e4, 0, 3e-11), (1e6, 0, 4e-9), (1e8, 0, 2e-7)),
        # Offsets round the scene; both pictures show the rounded scene.
        *((6, offset, 3e-14) for offset in (0, 1e2, 1e4, 1e6, 1e8)),
    ],
)
@pytest.mark.parametrize("radius", [1.0, 1e-3, 1e5, 1e-8, 1e8])
def test_distance_and_offset_over_radius(distance, offset, bound, radius):
    rng = np.random.default_rng(int(distance + offset))

    def ball() -> Scene:
        """Return a ball that fills a picture of 5 x 5 pixels, seen from a random direction."""
        direction, center = random_direction(rng), random_direction(rng) * offset * radius
        lights = [center + (random_direction(rng) * 3 - direction * 4) * radius for _ in range(3)]
        # Rays at the corners pass the centre at most at 0.7 sqrt(2) = 0.99 radii.  Closer to the
        # silhouette, the error of the normal grows by 1 / cosine for any rounded ray.
        size = 1.4 * radius * 5 / 4
        camera = Camera(view_point=center - direction * distance * radius,
                        view_dir=direction, view_up=random_direction(rng),
                        proj_distance=distance * radius, view_width=size,
                        view_height=size)  # fmt: skip
        surface = Sphere(center=center, radius=radius)
        return scene_of(surface, camera=camera, size=(5, 5), lights=rgb_lights(*lights))

    assert largest_error(ball() for _ in range(4)) <= bound


@pytest.mark.parametrize(("ratio", "height"), [*product((1e4, 1e6, 1e8), (1.0, 1e-3))])
def test_ground_radius_over_height(ratio, height):
    # The eye is at this height over the ground, and looks down by 20 to 70 degrees.  The lights are
    # one radius away from the hits, so only the normal affects the radiance.
    rng, radius = np.random.default_rng(int(ratio) + 2), ratio * height

    def ground() -> Scene:
        slope, turn = math.radians(rng.uniform(20, 70)), rng.uniform(0, 2 * math.pi)
        flat = math.cos(slope)
        ahead = (flat * math.cos(turn), -math.sin(slope), flat * math.sin(turn))
        camera = Camera(view_point=(0, height, 0), view_dir=ahead, view_width=0.3, view_height=0.3)
        lights = rgb_lights(*(random_direction(rng) * radius for _ in range(3)))
        surface = Sphere(center=(0, -radius, 0), radius=radius)
        return scene_of(surface, camera=camera, size=(5, 5), lights=lights)

    assert largest_error(ground() for _ in range(8)) <= 3e-9
