"""Scenes to measure: with any number of objects, and with any size of the picture."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from tracer import Camera, Lambertian, Phong, PointLight, Scene, Surfaces

_LIGHT_INTENSITY = (0.6, 0.6, 0.6)

# Shaders of the objects, in turn.
_SHADERS = (
    Lambertian(diffuse=(0.9, 0.6, 0.3)),
    Lambertian(diffuse=(0.3, 0.6, 0.9)),
    Phong(diffuse=(0.2, 0.7, 0.3), specular=(0.6, 0.6, 0.6), exponent=40.0),
)


def crowd(object_count: int, *, width: int = 640, height: int = 360) -> Scene:
    """Build a scene of small objects that float above a floor, in front of the camera.

    Half of the objects are spheres, the others are boxes, one of which is the floor.  The fraction
    of the picture that they cover hardly depends on their number.  Equal arguments give equal
    scenes.
    """
    rng = np.random.default_rng(object_count)
    small_object_count = object_count - 1
    sphere_count = small_object_count // 2
    box_count = small_object_count - sphere_count
    center = rng.uniform(-1, 1, (small_object_count, 3)) * (4.5, 2.4, 2.0)
    radius = rng.uniform(0.5, 1.5, small_object_count) * 1.6 / np.sqrt(object_count)
    half_size = radius[sphere_count:, None] * rng.uniform(0.4, 0.8, (box_count, 3))
    window: Any = {"proj_distance": 9, "view_width": 9.6, "view_height": 5.4}
    camera = Camera(view_point=(0, 1, 9), view_dir=(0, -0.1, -1), **window)
    surfaces = Surfaces(
        center=center[:sphere_count],
        radius=radius[:sphere_count],
        min_pt=np.vstack([center[sphere_count:] - half_size, [(-50, -3, -50)]]),
        max_pt=np.vstack([center[sphere_count:] + half_size, [(50, -2.5, 50)]]),
        shader_index=np.append(np.arange(sphere_count), np.arange(box_count + 1)) % len(_SHADERS),
        shaders=_SHADERS,
    )
    lights = _make_lights((6, 8, 7), (-7, 6, 5))
    return Scene(camera=camera, width=width, height=height, lights=lights, surfaces=surfaces)


def build_field_scene(object_count: int) -> Scene:
    """Build a scene of small objects above a floor, half of them spheres and half boxes.

    The objects fill a volume of constant size.  Many are hidden behind others, and they cast
    shadows on each other and on the floor, which `object_count` does not count.  The picture has
    640 x 360 pixels.  Equal arguments give equal scenes.
    """
    rng = np.random.default_rng(object_count)
    mean_radius = (0.5 / object_count) ** (1 / 3)
    center = rng.uniform((-8, mean_radius, -8), (8, 3 + mean_radius, 8), (object_count, 3))
    radius = mean_radius * rng.uniform(0.6, 1.3, object_count)
    sphere_count = object_count // 2
    box_center, half_size = center[sphere_count:], radius[sphere_count:, None]
    window: Any = {"view_width": 1, "view_height": 0.5625}
    camera = Camera(view_point=(12, 9, 12), view_dir=(-12, -8.5, -12), **window)
    surfaces = Surfaces(
        center=center[:sphere_count],
        radius=radius[:sphere_count],
        min_pt=np.vstack([box_center - half_size, [(-60, -0.5, -60)]]),
        max_pt=np.vstack([box_center + half_size, [(60, 0, 60)]]),
        shader_index=np.arange(object_count + 1) % len(_SHADERS),
        shaders=_SHADERS,
    )
    lights = _make_lights((5, 10, -4), (-7, 13, 8))
    return Scene(camera=camera, width=640, height=360, lights=lights, surfaces=surfaces)


def _make_lights(*positions: tuple[float, float, float]) -> list[PointLight]:
    return [PointLight(position=position, intensity=_LIGHT_INTENSITY) for position in positions]


def copy_with_picture_size(scene: Scene, width: int, height: int) -> Scene:
    """Return a copy of a scene with a different picture size and square pixels.

    The height of the camera's window stays the same, and its width is adjusted, so the picture may
    show more or less of the scene on the left and right.
    """
    camera = replace(scene.camera, view_width=scene.camera.view_height / height * width)
    return replace(scene, width=width, height=height, camera=camera)
