"""Build scenes of a few surfaces, and record the arguments of function calls."""

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
    """Build a scene; three numbers as `lights` are the position of a single white light."""
    lights = lights if isinstance(lights, list) else [PointLight(position=lights)]
    width, height = size
    return Scene(
        camera=camera or Camera(), width=width, height=height, lights=lights, surfaces=surfaces
    )


def sphere_scene(width: int = 300, height: int = 200) -> Scene:
    """Build a scene of a sphere, visible in all of the picture but its corners, and two lights."""
    camera = Camera(view_point=(0, 0, 4), proj_distance=4, view_width=2.2, view_height=2.2)
    lights = [PointLight(position=(1, 2, 3)), PointLight(position=(3, 2, 3))]
    return scene_of(Sphere(), camera=camera, size=(width, height), lights=lights)


def close_up(*surfaces: Surface, light: Vector = (3, 4, 5), **camera: object) -> Scene:
    """Build a scene that shows surfaces near the origin from (0, 0, 5), through a narrow window.

    The picture has 24 x 24 pixels, and the only light is white.  `camera` has other arguments of
    `Camera`.
    """
    view = Camera(view_point=(0, 0, 5), view_width=0.3, view_height=0.3, **camera)
    return scene_of(*surfaces, camera=view, size=(24, 24), lights=light)


def random_direction(rng: np.random.Generator) -> Floats:
    """Return a random unit vector (3,); all directions are equally likely."""
    vector = rng.normal(size=3)
    return np.asarray(vector / np.linalg.norm(vector))


def rgb_lights(*positions: Vector) -> list[PointLight]:
    """Return one to three lights, a red, a green and a blue one, each for one colour channel."""
    return [
        PointLight(position=position, intensity=color)
        for position, color in zip(positions, np.eye(3)[: len(positions)], strict=True)
    ]


def scale_and_shift(scene: Scene, scale: float, shift: Vector = (0.0, 0.0, 0.0)) -> Scene:
    """Scale all lengths of a scene, then shift all positions; return the new scene.

    Its picture is that of the scene, except for rounding.
    """

    def move(point: Vector) -> Vector:
        """Scale and shift a point."""
        x, y, z = (scale * coordinate + step for coordinate, step in zip(point, shift, strict=True))
        return x, y, z

    def move_surface(surface: Surface) -> Surface:
        """Scale and shift a sphere or a box."""
        if isinstance(surface, Sphere):
            return replace(surface, center=move(surface.center), radius=surface.radius * scale)
        return replace(surface, min_pt=move(surface.min_pt), max_pt=move(surface.max_pt))

    camera = scene.camera
    names = "proj_distance", "view_width", "view_height"
    lengths = {name: getattr(camera, name) * scale for name in names}
    return replace(
        scene,
        camera=replace(camera, view_point=move(camera.view_point), **lengths),
        lights=[replace(light, position=move(light.position)) for light in scene.lights],
        surfaces=[move_surface(surface) for surface in scene.surfaces],
    )


def record_calls(
    monkeypatch: pytest.MonkeyPatch, owner: object, name: str, summary: Callable[..., Any]
) -> list[Any]:
    """Record a summary of the arguments whenever a function is called, until the test ends.

    The function is an attribute of a module or class, `owner`.  After each call, the list that is
    returned has one more element: what `summary` returns for the positional arguments of the call.
    """
    summaries: list[Any] = []
    function = getattr(owner, name)

    def record(*arguments: Any) -> Any:
        """Record a summary of the arguments, call the original function, and return its result."""
        summaries.append(summary(*arguments))
        return function(*arguments)

    monkeypatch.setattr(owner, name, record)
    return summaries
