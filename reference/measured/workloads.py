"""Scenes made to measure: N small objects, and a scene in other pixels."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from tracer import Camera, Lambertian, Phong, PointLight, Scene, Surfaces

_DIM = (0.6, 0.6, 0.6)
_SHADERS = (
    Lambertian(diffuse=(0.9, 0.6, 0.3)),
    Lambertian(diffuse=(0.3, 0.6, 0.9)),
    Phong(diffuse=(0.2, 0.7, 0.3), specular=(0.6, 0.6, 0.6), exponent=40.0),
)


def crowd(count: int, *, width: int = 640, height: int = 360) -> Scene:
    """Make a floor and `count` - 1 small objects, half spheres and half boxes, under two lights.

    Together the objects cover about as much of the picture whatever their number.
    """
    rng = np.random.default_rng(count)
    n = count - 1
    center = rng.uniform(-1, 1, (n, 3)) * (4.5, 2.4, 2.0)
    size = rng.uniform(0.5, 1.5, n) * 1.6 / np.sqrt(count)
    spheres = n // 2
    half = size[spheres:, None] * rng.uniform(0.4, 0.8, (n - spheres, 3))
    window: Any = {"proj_distance": 9, "view_width": 9.6, "view_height": 5.4}
    return Scene(
        camera=Camera(view_point=(0, 1, 9), view_dir=(0, -0.1, -1), **window),
        width=width,
        height=height,
        lights=[PointLight(position=at, intensity=_DIM) for at in ((6, 8, 7), (-7, 6, 5))],
        surfaces=Surfaces(
            center=center[:spheres],
            radius=size[:spheres],
            min_pt=np.vstack([center[spheres:] - half, [(-50, -3, -50)]]),
            max_pt=np.vstack([center[spheres:] + half, [(50, -2.5, 50)]]),
            shader_index=np.append(np.arange(spheres), np.arange(n - spheres + 1)) % len(_SHADERS),
            shaders=_SHADERS,
        ),
    )


def field(count: int) -> Scene:
    """Make `count` small objects, half spheres and half boxes, over a floor that they shade."""
    rng = np.random.default_rng(count)
    size = (0.5 / count) ** (1 / 3)
    center = rng.uniform((-8, size, -8), (8, 3 + size, 8), (count, 3))
    radius, spheres = size * rng.uniform(0.6, 1.3, count), count // 2
    boxes, half = center[spheres:], radius[spheres:, None]
    window: Any = {"view_width": 1, "view_height": 0.5625}
    return Scene(
        camera=Camera(view_point=(12, 9, 12), view_dir=(-12, -8.5, -12), **window),
        width=640,
        height=360,
        lights=[PointLight(position=at, intensity=_DIM) for at in ((5, 10, -4), (-7, 13, 8))],
        surfaces=Surfaces(
            center=center[:spheres],
            radius=radius[:spheres],
            min_pt=np.vstack([boxes - half, [(-60, -0.5, -60)]]),
            max_pt=np.vstack([boxes + half, [(60, 0, 60)]]),
            shader_index=np.arange(count + 1) % len(_SHADERS),
            shaders=_SHADERS,
        ),
    )


def resized(scene: Scene, width: int, height: int) -> Scene:
    """Show the same in other pixels; the window grows sideways to keep them square."""
    camera = replace(scene.camera, view_width=scene.camera.view_height / height * width)
    return replace(scene, width=width, height=height, camera=camera)
