"""Scenes to measure: with any number of objects, and with any size of the picture."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from tracer import Camera, Lambertian, Phong, PointLight, Scene, Surfaces

_LIGHT_INTENSITY = (0.6, 0.6, 0.6)
_SHADERS = (
    Lambertian(diffuse=(0.9, 0.6, 0.3)),
    Lambertian(diffuse=(0.3, 0.6, 0.9)),
    Phong(diffuse=(0.2, 0.7, 0.3), specular=(0.6, 0.6, 0.6), exponent=40.0),
)


def crowd(count: int, *, width: int = 640, height: int = 360) -> Scene:
    """Make a scene of a floor and `count` - 1 small objects that hover in front of the camera.

    Half of them are spheres, and half boxes; two lights shine on them.  Together they cover about
    the same part of the picture for any number.

    Parameters
    ----------
    count : int
        Number of objects.
    width, height : int
        Size of the picture in pixels.
    """
    rng = np.random.default_rng(count)
    n = count - 1
    center = rng.uniform(-1, 1, (n, 3)) * (4.5, 2.4, 2.0)
    size = rng.uniform(0.5, 1.5, n) * 1.6 / np.sqrt(count)
    spheres = n // 2
    half = size[spheres:, None] * rng.uniform(0.4, 0.8, (n - spheres, 3))
    window: Any = {"proj_distance": 9, "view_width": 9.6, "view_height": 5.4}
    camera = Camera(view_point=(0, 1, 9), view_dir=(0, -0.1, -1), **window)
    surfaces = Surfaces(
        center=center[:spheres],
        radius=size[:spheres],
        min_pt=np.vstack([center[spheres:] - half, [(-50, -3, -50)]]),
        max_pt=np.vstack([center[spheres:] + half, [(50, -2.5, 50)]]),
        shader_index=np.append(np.arange(spheres), np.arange(n - spheres + 1)) % len(_SHADERS),
        shaders=_SHADERS,
    )
    lights = _lights((6, 8, 7), (-7, 6, 5))
    return Scene(camera=camera, width=width, height=height, lights=lights, surfaces=surfaces)


def field(count: int) -> Scene:
    """Make a scene of `count` small objects above a floor, half of them spheres and half boxes.

    The objects fill a volume of constant size, so that many are hidden behind others, and they
    cast shadows on each other and on the floor.
    """
    rng = np.random.default_rng(count)
    size = (0.5 / count) ** (1 / 3)
    center = rng.uniform((-8, size, -8), (8, 3 + size, 8), (count, 3))
    radius, spheres = size * rng.uniform(0.6, 1.3, count), count // 2
    boxes, half = center[spheres:], radius[spheres:, None]
    window: Any = {"view_width": 1, "view_height": 0.5625}
    camera = Camera(view_point=(12, 9, 12), view_dir=(-12, -8.5, -12), **window)
    surfaces = Surfaces(
        center=center[:spheres],
        radius=radius[:spheres],
        min_pt=np.vstack([boxes - half, [(-60, -0.5, -60)]]),
        max_pt=np.vstack([boxes + half, [(60, 0, 60)]]),
        shader_index=np.arange(count + 1) % len(_SHADERS),
        shaders=_SHADERS,
    )
    lights = _lights((5, 10, -4), (-7, 13, 8))
    return Scene(camera=camera, width=640, height=360, lights=lights, surfaces=surfaces)


def _lights(*positions: tuple[float, float, float]) -> list[PointLight]:
    """Make one light at each position."""
    return [PointLight(position=position, intensity=_LIGHT_INTENSITY) for position in positions]


def resized(scene: Scene, width: int, height: int) -> Scene:
    """Return the scene with another number of pixels, which are square.

    The height of the window stays the same, so the picture shows more or less at the sides.

    Parameters
    ----------
    scene : Scene
        The scene.
    width, height : int
        Size of the new picture in pixels.
    """
    camera = replace(scene.camera, view_width=scene.camera.view_height / height * width)
    return replace(scene, width=width, height=height, camera=camera)
