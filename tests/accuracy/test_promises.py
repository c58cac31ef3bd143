"""What float64 promises, each promise held at its boundary, with the oracle as judge.

Normals are seen through radiance: white Lambertian objects, a light in each
channel, so that a channel's error is that of the normal.  Impact parameters
stay below 0.99 radii: nearer the limb the normal of *any* rounded ray errs by
1 / cosine.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np
import pytest
from judge import judge
from probe import a_direction, colored, moved, scene_of, vector
from random_scenes import random_scene

from tracer import Camera, Scene, Sphere


def balls(
    rng: np.random.Generator, distance: float, radius: float, offset: float, count: int
) -> Iterator[Scene]:
    """Balls that fill a picture of 5 x 5, seen from random directions."""
    for _ in range(count):
        direction, center = a_direction(rng), a_direction(rng) * offset
        lights = [center + a_direction(rng) * 3 * radius - direction * 4 * radius for _ in range(3)]
        # Rays at the corners pass at 0.7 sqrt(2) = 0.99 radii, at most.
        size = 1.4 * radius * 5 / 4
        yield scene_of(
            Sphere(center=vector(center), radius=radius),
            camera=Camera(
                view_point=vector(center - direction * distance),
                view_dir=vector(direction),
                view_up=vector(a_direction(rng)),
                proj_distance=distance,
                view_width=size,
                view_height=size,
            ),
            size=(5, 5),
            lights=colored(*(vector(light) for light in lights)),
        )


def worst(scenes: Iterable[Scene]) -> float:
    """Largest error over scenes; every pixel must show the one object."""
    judged = [judge(scene) for scene in scenes]
    assert all((one.seen.surface == 0).all() for one in judged)
    return max(float(one.error.max()) for one in judged)


@pytest.mark.parametrize(
    ("ratio", "promise"), [(1e2, 3e-13), (1e4, 3e-11), (1e6, 4e-9), (1e8, 2e-7)]
)
@pytest.mark.parametrize("radius", [1.0, 1e-3, 1e5])
def test_distance_over_radius(ratio: float, promise: float, radius: float) -> None:
    rng = np.random.default_rng(int(ratio))
    assert worst(balls(rng, ratio * radius, radius, 0.0, 5)) <= promise


@pytest.mark.parametrize("ratio", [1e2, 1e4, 1e6, 1e8])
@pytest.mark.parametrize("radius", [1.0, 1e-3, 1e5])
def test_offset_over_radius(ratio: float, radius: float) -> None:
    # Offsets round the scene, not what is made of it.
    rng = np.random.default_rng(int(ratio) + 1)
    assert worst(balls(rng, 6 * radius, radius, ratio * radius, 5)) <= 3e-14


@pytest.mark.parametrize("ratio", [1e4, 1e6, 1e8])
@pytest.mark.parametrize("height", [1.0, 1e-3])
def test_ground_radius_over_height(ratio: float, height: float) -> None:
    # The eye is at this height over the ground, and looks at it from 20 to 70 degrees above;
    # the lights are as far from what it sees as the radius is, so the normal alone counts.
    rng = np.random.default_rng(int(ratio) + 2)
    radius = ratio * height

    def scenes() -> Iterator[Scene]:
        for _ in range(8):
            slope, turn = math.radians(rng.uniform(20, 70)), rng.uniform(0, 2 * math.pi)
            flat = math.cos(slope)
            yield scene_of(
                Sphere(center=(0, -radius, 0), radius=radius),
                camera=Camera(
                    view_point=(0, height, 0),
                    view_dir=(flat * math.cos(turn), -math.sin(slope), flat * math.sin(turn)),
                    view_width=0.3,
                    view_height=0.3,
                ),
                size=(5, 5),
                lights=colored(*(vector(a_direction(rng) * radius) for _ in range(3))),
            )

    assert worst(scenes()) <= 3e-9


@pytest.mark.parametrize("scale", [1e-8, 1e-4, 1e4, 1e8])
def test_whole_scene_scaled(scale: float) -> None:
    # Decimal scales round the scene; the oracle judges the rounded one.
    rng = np.random.default_rng(4)
    assert worst(moved(scene, scale) for scene in balls(rng, 6.0, 1.0, 0.0, 8)) <= 2e-14


def scattered_or_touching() -> Iterator[Scene]:
    """Two scenes of each kind."""
    for seed in range(2):
        yield random_scene("scattered", seed)
        yield random_scene("touching", seed)


def assert_same_decisions(scenes: Iterable[Scene]) -> None:
    """The tracer sees what the oracle sees, lit by the lights that it says, wherever that is sure.

    Each light has a channel, and each object its own share of it.
    """
    sure = []
    for scene in scenes:
        lights = tuple(colored(*(light.position for light in scene.lights)))
        judged = judge(replace(scene, lights=lights))
        assert not judged.wrong(1e-4)
        sure.append(judged.sure.mean())
    assert np.mean(sure) > 0.98


@pytest.mark.parametrize(
    ("scale", "offset"), [(1.0, 0.0), (1e8, 0.0), (1e-8, 1e6), (1e8, 1e6), (1.0, 1e8), (1e-8, 1e8)]
)
def test_decisions_scaled_and_shifted(scale: float, offset: float) -> None:
    shift = (offset * scale,) * 3
    assert_same_decisions(moved(scene, scale, shift) for scene in scattered_or_touching())


@pytest.mark.parametrize("distance", [1e4, 1e6, 1e8])
def test_decisions_from_afar(distance: float) -> None:
    def from_afar(scene: Scene) -> Scene:
        direction = np.array(scene.camera.view_dir)
        camera = Camera(
            view_point=vector(direction * -distance),
            view_dir=vector(direction),
            view_up=scene.camera.view_up,
            proj_distance=distance,
            view_width=4,
            view_height=3,
        )
        return replace(scene, camera=camera)

    assert_same_decisions(map(from_afar, scattered_or_touching()))
