"""The tracer against the oracle: random scenes, the project's own, and each promise at its bound.

Of the oracle itself: `test_closed_forms`.
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
from scene_files import NAMES, names, small

from reference.command import SCENES, own_scenes
from reference.judges import plain
from reference.measured.workloads import resized
from tracer import Box, Camera, PointLight, Scene, Sphere, first_hits, load_scene, render
from tracer.arrays import Bools, Floats

# Right and down, in pixels: far more than the tracer's rounding, even from 10^8 times as far as
# things are large.  And of radii, which parts what nearly coincides, such as a ground and a floor.
_HAIRS = ((1e-3, 0, 1e-12), (-5e-4, 9e-4, -1e-12), (-5e-4, -9e-4, 1e-12))


class Judged(NamedTuple):
    """All pixels of a picture, row by row."""

    seen: plain.Seen
    error: Floats
    """(n,): the tracer's largest, among the three channels."""
    sure: Bools
    """(n,): whether the same is seen, by the same lights, a hair to each side, and grown by one."""

    def wrong(self, tolerance: float) -> str:
        """Name the sure pixels in which the tracer errs by more; empty if there are none."""
        pixels = np.flatnonzero(self.sure & ~(self.error <= tolerance))
        return "\n".join(f"pixel {k}: {self.error[k]}, {self.seen.surface[k]}" for k in pixels)


def judge(scene: Scene, image: Floats | None = None) -> Judged:
    """Judge the tracer's picture of a scene, or another."""
    image = render(scene) if image is None else image
    y, x = np.indices((scene.height, scene.width)).reshape(2, -1) + 0.5
    seen = plain.trace(scene, x, y, arithmetic="decimal")
    sure = np.ones(x.size, dtype=bool)
    for right, down, more in _HAIRS:
        surfaces = [
            replace(s, radius=s.radius * (1 + more)) if isinstance(s, Sphere) else s
            for s in scene.surfaces
        ]
        grown = replace(scene, surfaces=surfaces)
        near = plain.trace(grown, x + right, y + down, arithmetic="decimal")
        sure &= (near.surface == seen.surface) & (near.lit == seen.lit).all(axis=0)
    error = np.abs(image.reshape(-1, 3) - seen.radiance).max(axis=1)
    return Judged(seen, error, sure)


# The tracer's rounding, times 10^4 lengths seen from afar, times exponents of 60; a light near the
# ground sees points rounded by 2^24 EPS; an eye at 10^-9 over a floor has its points further along.
RADIANCE = dict.fromkeys(KINDS, 1e-8) | {"enormous": 1e-7, "grazing": 1e-4}


def hold(scenes: Iterable[Scene], tolerance: float, sure: float = 0.95) -> None:
    """Hold pictures against the oracle, which must be sure of so large a share of their pixels."""
    shares = []
    for scene in scenes:
        judged = judge(scene)
        assert not judged.wrong(tolerance), scene
        assert np.isfinite(judged.error).all()
        shares.append(judged.sure.mean())
    assert np.mean(shares) >= sure


def test_an_error_is_found():
    scene = small("four-spheres", 8, 6)
    image = render(scene)
    assert not judge(scene, image).wrong(1e-12)
    image[2, 3, 1] += 1e-6
    assert judge(scene, image).wrong(1e-8).startswith("pixel 19:")


def test_a_pixel_is_sure_unless_an_edge_is_a_hair_away_or_surfaces_nearly_coincide():
    # The cube's edge, at x = 1, is that part of a pixel right of the middle of the picture.
    cube = Box(min_pt=(0, 0, 0), max_pt=(1, 1, 0))
    for off in (0.01, 0.0001):
        camera = Camera(view_point=(1 - off, 0.5, 5), proj_distance=5)
        scene = scene_of(cube, camera=camera, size=(1, 1), lights=(0, 0, 9))
        assert judge(scene).sure.tolist() == [off > 0.001]
    # A ground that touches the plane of the floor at x = 0, and is 8e-6 below it at x = 1.
    floor = Box(min_pt=(-9, -2, -9), max_pt=(9, -1, 9))
    ground = Sphere(center=(0, -1 - 2.0**16, 0), radius=2.0**16)
    down = {"view_dir": (0, -1, 0), "view_up": (1, 0, 0), "view_width": 1e-4}
    for x in (0.0, 1.0):
        camera = Camera(view_point=(x + 1e-3, 1, 0), **down)
        scene = scene_of(floor, ground, camera=camera, size=(1, 1), lights=(0, 5, 0))
        assert judge(scene).sure.tolist() == [x > 0]


@pytest.mark.parametrize("scale", [1e-60, 1e60])
def test_the_oracle_sees_scenes_of_any_size(scale):
    scene = small("one-sphere", 16, 12)
    exact = plain.render(scene, arithmetic="decimal")
    assert exact.max() > 0.5
    scaled = plain.render(scale_and_shift(scene, scale), arithmetic="decimal")
    np.testing.assert_allclose(scaled, exact, rtol=0, atol=1e-14)


@pytest.mark.parametrize("inside", [False, True])
def test_faces_that_tie_are_decided_alike_along_their_edge(inside):
    """The middle column sees the edge of two faces, and no light reaches that of the first axis."""
    box = Box(min_pt=(-1, -2, -1), max_pt=(0.5, 2, 1))
    eye, ahead, light = ((4, 6, 8), (-4, -6, -8), (0.4, 9, 9))
    if inside:
        # All that is inside is lit; the two faces as their slopes to the light are.
        eye, ahead, light = (-0.5, 0, -1), (1, 0.3, 2), (0.499, 0, 0.5)
    camera = Camera(view_point=eye, view_dir=ahead, proj_distance=4)
    scene = scene_of(box, camera=camera, size=(25, 25), lights=light)
    x, y = np.full(15, 12.5), np.arange(5, 20) + 0.5
    first, last, left, right = (
        plain.trace(scene, x + aside, y, arithmetic="decimal", ties=ties).radiance[:, 0]
        for aside, ties in ((0, "first"), (0, "last"), (-0.01, "first"), (0.01, "first"))
    )
    np.testing.assert_allclose(first, left if inside else right, atol=0.02)
    np.testing.assert_allclose(last, right if inside else left, atol=0.02)
    assert (np.abs(first - last) > 0.1).sum() > 7


@pytest.mark.parametrize(
    "kind", [pytest.param(kind, marks=[pytest.mark.slow] * (kind == "crowd")) for kind in KINDS]
)
def test_random_scenes(kind):
    # Of a thousand objects, few pixels; and one scene more by a light at the eye, which shows all
    # that is seen.
    size, count = ((3, 2), 2) if kind == "crowd" else ((13, 9), 3)
    several = [random_scene(kind, seed, *size) for seed in range(count)]
    at_eye = [PointLight(position=several[0].camera.view_point)]
    hold([*several, replace(several[0], lights=at_eye)], RADIANCE[kind])


@pytest.mark.parametrize("kind", FEW_OBJECTS)
@settings(max_examples=settings.default.max_examples // 5)
@given(data=st.data())
def test_any_random_scene(kind, data):
    scene = data.draw(scenes([kind], st.just(3), st.just(2)))
    assert not judge(scene).wrong(RADIANCE[kind])


LARGE = {path.stem for path in own_scenes() if len(load_scene(path).surfaces) > 100}


@pytest.mark.parametrize("name", names(*{*NAMES} - LARGE))
def test_own_scenes(name):
    # Nearly orthographic scenes are seen from 1,700 times their size.
    scene = load_scene(SCENES / f"{name}.xml")
    scene = resized(scene, *((16, 9) if len(scene.surfaces) > 20 else (48, 27)))
    exact = plain.render(scene, arithmetic="decimal")
    assert exact.max() > 0.1
    np.testing.assert_allclose(render(scene), exact, rtol=0, atol=1e-11)
    # Floats alone do not decide what coincides.
    if name != "touching":
        np.testing.assert_allclose(plain.render(scene), exact, rtol=0, atol=1e-10)


@pytest.mark.parametrize(("width", "height"), [(8, 40), (40, 8)])
def test_pictures_of_any_aspect(width, height):
    # Objects in all parts of the picture, also in rows after the last column's number.
    camera = Camera(view_point=(0, 0, 9), view_width=width / 40, view_height=height / 40)
    long_axis = (0, 1, 0) if height > width else (1, 0, 0)
    balls = [Sphere(center=np.multiply(k, long_axis), radius=0.3) for k in range(-4, 5)]
    scene = scene_of(*balls, camera=camera, size=(width, height), lights=(3, 4, 9))
    shown = {int(k) for k in first_hits(scene).surface.ravel()}
    assert shown == {*range(-1, 9)}
    hold([scene], 1e-12, 0.9)


# The oracle judges the scene that is rendered, which scale and shift have rounded.
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
    several = (random_scene(kind, seed, 7, 5) for seed in range(2))
    hold((scale_and_shift(scene, scale, shift) for scene in several), 3e-14, 0.9)


@pytest.mark.parametrize("distance", [1e4, 1e6, 1e8])
def test_decisions_from_afar(distance):
    several = [random_scene(kind, seed) for kind in ("scattered", "touching") for seed in (1, 2)]
    for i, scene in enumerate(several):
        direction = np.array(scene.camera.view_dir)
        camera = Camera(view_point=direction * -distance, view_dir=direction,
                        view_up=scene.camera.view_up, proj_distance=distance, view_width=4,
                        view_height=3)  # fmt: skip
        several[i] = replace(scene, camera=camera)
    hold(several, 1e-4, 0.98)


def worst(scenes: Iterable[Scene]) -> float:
    """Largest error over scenes; every pixel must show the one object.

    White Lambertian objects under a light in each channel: a channel's error is that of the normal.
    """
    judged = [judge(scene) for scene in scenes]
    assert all((one.seen.surface == 0).all() for one in judged)
    return max(float(one.error.max()) for one in judged)


@pytest.mark.parametrize(
    ("distance", "offset", "promise"),
    [
        *((1e2, 0, 3e-13), (1e4, 0, 3e-11), (1e6, 0, 4e-9), (1e8, 0, 2e-7)),
        # Offsets round the scene, not what is made of it.
        *((6, offset, 3e-14) for offset in (0, 1e2, 1e4, 1e6, 1e8)),
    ],
)
@pytest.mark.parametrize("radius", [1.0, 1e-3, 1e5, 1e-8, 1e8])
def test_distance_and_offset_over_radius(distance, offset, promise, radius):
    rng = np.random.default_rng(int(distance + offset))

    def ball() -> Scene:
        """A ball that fills a picture of 5 x 5, seen from a random direction."""
        direction, center = random_direction(rng), random_direction(rng) * offset * radius
        lights = [center + (random_direction(rng) * 3 - direction * 4) * radius for _ in range(3)]
        # Rays at the corners pass at 0.7 sqrt(2) = 0.99 radii, at most: nearer the silhouette the
        # normal of any rounded ray errs by 1 / cosine.
        size = 1.4 * radius * 5 / 4
        camera = Camera(view_point=center - direction * distance * radius,
                        view_dir=direction, view_up=random_direction(rng),
                        proj_distance=distance * radius, view_width=size,
                        view_height=size)  # fmt: skip
        surface = Sphere(center=center, radius=radius)
        return scene_of(surface, camera=camera, size=(5, 5), lights=rgb_lights(*lights))

    assert worst(ball() for _ in range(4)) <= promise


@pytest.mark.parametrize(("ratio", "height"), [*product((1e4, 1e6, 1e8), (1.0, 1e-3))])
def test_ground_radius_over_height(ratio, height):
    # The eye is at this height over the ground, and looks at it from 20 to 70 degrees above;
    # the lights are as far from what it sees as the radius is, so the normal alone counts.
    rng, radius = np.random.default_rng(int(ratio) + 2), ratio * height

    def ground() -> Scene:
        slope, turn = math.radians(rng.uniform(20, 70)), rng.uniform(0, 2 * math.pi)
        flat = math.cos(slope)
        ahead = (flat * math.cos(turn), -math.sin(slope), flat * math.sin(turn))
        camera = Camera(view_point=(0, height, 0), view_dir=ahead, view_width=0.3, view_height=0.3)
        lights = rgb_lights(*(random_direction(rng) * radius for _ in range(3)))
        surface = Sphere(center=(0, -radius, 0), radius=radius)
        return scene_of(surface, camera=camera, size=(5, 5), lights=lights)

    assert worst(ground() for _ in range(8)) <= 3e-9
