"""What float64 promises, each promise held at its boundary, with the oracle as judge.

Normals are seen through radiance: white Lambertian objects, a light in each
channel, so that a channel's error is that of the normal.  Impact parameters
stay below 0.99 radii: nearer the limb the normal of *any* rounded ray errs by
1 / cosine.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from probe import colored, moved, scene_of
from random_objects import a_direction, vector
from random_scenes import random_scene

from reference.oracle import Oracle, Verdict
from tracer import Camera, Scene, Sphere, render


def errors(scene: Scene) -> list[tuple[float, Verdict]]:
    """Per pixel the largest error, and the oracle's verdict."""
    image = render(scene)
    return [
        (float(np.abs(image[i, j] - verdict.radiance).max()), verdict)
        for i, row in enumerate(Oracle(scene).picture())
        for j, verdict in enumerate(row)
    ]


def balls(
    rng: np.random.Generator, distance: float, radius: float, offset: float, count: int
) -> Iterator[Scene]:
    """Balls that fill a picture of 5 x 5, seen from random directions."""
    for _ in range(count):
        direction, center = a_direction(rng), a_direction(rng) * offset
        eye = center - direction * distance
        lights = [center + a_direction(rng) * 3 * radius - direction * 4 * radius for _ in range(3)]
        # Rays at the corners pass at 0.7 sqrt(2) = 0.99 radii, at most.
        size = 1.4 * radius * 5 / 4
        yield scene_of(
            Sphere(center=vector(center), radius=radius),
            camera=Camera(
                view_point=vector(eye),
                view_dir=vector(direction),
                view_up=vector(a_direction(rng)),
                proj_distance=distance,
                view_width=size,
                view_height=size,
            ),
            size=(5, 5),
            lights=colored(*(vector(light) for light in lights)),
        )


def worst(scenes: Iterator[Scene]) -> float:
    """Largest error over scenes; every pixel must show the one object."""
    largest = 0.0
    for scene in scenes:
        for error, verdict in errors(scene):
            assert verdict.surface == 0
            largest = max(largest, error)
    return largest


@pytest.mark.parametrize(
    ("ratio", "promise"), [(1e2, 3e-13), (1e4, 3e-11), (1e6, 4e-9), (1e8, 2e-7)]
)
@pytest.mark.parametrize("radius", [1.0, 1e-3, 1e5])
def test_distance_over_radius(ratio: float, promise: float, radius: float) -> None:
    rng = np.random.default_rng(int(ratio))
    assert worst(balls(rng, ratio * radius, radius, 0.0, 16)) <= promise


@pytest.mark.parametrize("ratio", [1e2, 1e4, 1e6, 1e8])
@pytest.mark.parametrize("radius", [1.0, 1e-3, 1e5])
def test_offset_over_radius(ratio: float, radius: float) -> None:
    # Offsets round the scene, not what is made of it.
    rng = np.random.default_rng(int(ratio) + 1)
    assert worst(balls(rng, 6 * radius, radius, ratio * radius, 16)) <= 3e-14


@pytest.mark.parametrize(("ratio", "promise"), [(1e4, 3e-9), (1e6, 3e-9), (1e8, 3e-9)])
@pytest.mark.parametrize("height", [1.0, 1e-3])
def test_ground_radius_over_height(ratio: float, promise: float, height: float) -> None:
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
                    proj_distance=1,
                    view_width=0.3,
                    view_height=0.3,
                ),
                size=(5, 5),
                lights=colored(*(vector(a_direction(rng) * radius) for _ in range(3))),
            )

    assert worst(scenes()) <= promise


@pytest.mark.parametrize("scale", [1e-8, 1e-4, 1e4, 1e8])
def test_whole_scene_scaled(scale: float) -> None:
    # Decimal scales round the scene; the oracle judges the rounded one.
    rng = np.random.default_rng(4)
    scenes = (moved(scene, scale) for scene in balls(rng, 6.0, 1.0, 0.0, 8))
    assert worst(scenes) <= 2e-14


def assert_same_decisions(scenes: Iterator[Scene]) -> None:
    """Outside of ties the tracer sees what the oracle sees, lit by the lights that it says.

    Each light has a channel, and each object its own share of it; a tie is a
    margin of a few hundred roundings of the lengths involved.
    """
    ties = decided = 0
    for scene in scenes:
        lights = tuple(colored(*(light.position for light in scene.lights)))
        for error, verdict in errors(replace(scene, lights=lights)):
            if verdict.margin < 1e-12:
                ties += 1
            else:
                decided += 1
                assert error < 1e-4, verdict
    assert decided > 0
    assert ties < 0.02 * decided


@pytest.mark.parametrize("scale", [1e-8, 1.0, 1e8])
@pytest.mark.parametrize("offset", [0.0, 1e6, 1e8])
def test_decisions_scaled_and_shifted(scale: float, offset: float) -> None:
    assert_same_decisions(
        moved(random_scene(kind, seed), scale, (offset * scale,) * 3)
        for seed in range(3)
        for kind in ("scattered", "touching")
    )


@pytest.mark.parametrize("distance", [1e4, 1e6, 1e8])
def test_decisions_from_afar(distance: float) -> None:
    def scenes() -> Iterator[Scene]:
        for seed in range(3):
            for kind in ("scattered", "touching"):
                scene = random_scene(kind, seed)
                direction = np.array(scene.camera.view_dir)
                camera = Camera(
                    view_point=vector(direction * -distance),
                    view_dir=vector(direction),
                    view_up=scene.camera.view_up,
                    proj_distance=distance,
                    view_width=4,
                    view_height=3,
                )
                yield replace(scene, camera=camera)

    assert_same_decisions(scenes())
