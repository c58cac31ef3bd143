"""Scenes that consist of a few surfaces; the arguments with which functions are called."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tracer import Box, Camera, PointLight, Scene, Sphere
from tracer.arrays import Floats

Vector = tuple[float, float, float]
Surface = Sphere | Box

EPS = float(np.finfo(np.float64).eps)


def scene_of(
    *surfaces: Surface,
    camera: Camera | None = None,
    size: tuple[int, int],
    lights: list[PointLight] | Vector,
) -> Scene:
    """Return a scene.

    Parameters
    ----------
    size : (int, int)
        Columns and rows of the picture.
    lights : list of PointLight, or vector
        A vector stands for one white light at this position.
    """
    lights = lights if isinstance(lights, list) else [PointLight(position=lights)]
    width, height = size
    return Scene(
        camera=camera or Camera(), width=width, height=height, lights=lights, surfaces=surfaces
    )


def close_up(*surfaces: Surface, light: Vector = (3, 4, 5), **camera: object) -> Scene:
    """Return a scene of surfaces near the origin, seen from (0, 0, 5)."""
    view = Camera(view_point=(0, 0, 5), view_width=0.3, view_height=0.3, **camera)
    return scene_of(*surfaces, camera=view, size=(24, 24), lights=light)


def random_direction(rng: np.random.Generator) -> Floats:
    """Return a random unit vector (3,)."""
    v = rng.normal(size=3)
    return np.asarray(v / np.linalg.norm(v))


def rgb_lights(*positions: Vector) -> list[PointLight]:
    """Return a red, a green and a blue light: each contributes to one channel."""
    return [
        PointLight(position=position, intensity=color)
        for position, color in zip(positions, np.eye(3)[: len(positions)], strict=True)
    ]


def scale_and_shift(scene: Scene, scale: float, shift: Vector = (0.0, 0.0, 0.0)) -> Scene:
    """Return a scene in which all lengths are scaled, then all points shifted.

    Its picture is the same, except for rounding.
    """

    def point(v: Vector) -> Vector:
        return v[0] * scale + shift[0], v[1] * scale + shift[1], v[2] * scale + shift[2]

    camera = scene.camera
    names = "proj_distance", "view_width", "view_height"
    lengths = {name: getattr(camera, name) * scale for name in names}
    return replace(
        scene,
        camera=replace(camera, view_point=point(camera.view_point), **lengths),
        lights=[replace(light, position=point(light.position)) for light in scene.lights],
        surfaces=[
            replace(surface, center=point(surface.center), radius=surface.radius * scale)
            if isinstance(surface, Sphere)
            else replace(surface, min_pt=point(surface.min_pt), max_pt=point(surface.max_pt))
            for surface in scene.surfaces
        ],
    )


def record_calls(
    monkeypatch: pytest.MonkeyPatch, owner: object, name: str, summary: Callable[..., Any]
) -> list[Any]:
    """Return a list to which each later call of a function appends `summary(*arguments)`."""
    summaries: list[Any] = []
    real = getattr(owner, name)

    def called(*arguments: Any) -> Any:
        summaries.append(summary(*arguments))
        return real(*arguments)

    monkeypatch.setattr(owner, name, called)
    return summaries
