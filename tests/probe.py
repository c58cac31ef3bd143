"""Scenes made of a few objects, moved and scaled; notes of calls."""

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
    """Surfaces in a picture of so many columns and rows; a bare position is of one white light."""
    some = lights if isinstance(lights, list) else [PointLight(position=lights)]
    width, height = size
    return Scene(
        camera=camera or Camera(), width=width, height=height, lights=some, surfaces=surfaces
    )


def close_up(*surfaces: Surface, light: Vector = (3, 4, 5), **camera: object) -> Scene:
    """Surfaces before a camera at (0, 0, 5)."""
    view = Camera(view_point=(0, 0, 5), view_width=0.3, view_height=0.3, **camera)
    return scene_of(*surfaces, camera=view, size=(24, 24), lights=light)


def a_direction(rng: np.random.Generator) -> Floats:
    """A unit vector (3,)."""
    v = rng.normal(size=3)
    return np.asarray(v / np.linalg.norm(v))


def colored(*positions: Vector) -> list[PointLight]:
    """A red, a green and a blue light: each shows in its own channel."""
    return [
        PointLight(position=position, intensity=color)
        for position, color in zip(positions, np.eye(3)[: len(positions)], strict=True)
    ]


def moved(scene: Scene, scale: float, shift: Vector = (0.0, 0.0, 0.0)) -> Scene:
    """The whole scene scaled, then shifted: the picture stays the same."""

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


def noted(
    monkeypatch: pytest.MonkeyPatch, owner: object, name: str, note: Callable[..., Any]
) -> list[Any]:
    """What `note` makes of the arguments of each call of a function, from now on."""
    notes: list[Any] = []
    real = getattr(owner, name)

    def called(*arguments: Any) -> Any:
        notes.append(note(*arguments))
        return real(*arguments)

    monkeypatch.setattr(owner, name, called)
    return notes
