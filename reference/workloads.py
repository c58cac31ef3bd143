"""Scenes made to measure: N objects, small ones or long rods, and copies of a scene."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from tracer import Camera, Lambertian, Phong, PointLight, Scene, Surfaces
from tracer.arrays import Vector

__all__ = ["CROWDS", "Crowd", "afresh", "calm", "crowd", "lit_by", "resized", "rods", "to_xml"]

Crowd: TypeAlias = Literal["spread", "corner", "cone", "eye amid", "light amid"]

CROWDS: dict[Crowd, str] = {
    "spread": "all over the picture",
    "corner": "all in one corner of the picture",
    "cone": "all in a cone of 2 degrees around one light",
    "eye amid": "the eye amid the objects",
    "light amid": "a light amid the objects",
}

_SHADERS = (
    Lambertian(diffuse=(0.9, 0.6, 0.3)),
    Lambertian(diffuse=(0.3, 0.6, 0.9)),
    Phong(diffuse=(0.2, 0.7, 0.3), specular=(0.6, 0.6, 0.6), exponent=40.0),
)


def _lights(*positions: Vector) -> tuple[PointLight, ...]:
    return tuple(PointLight(position=at, intensity=(0.6, 0.6, 0.6)) for at in positions)


def crowd(count: int, kind: Crowd = "spread", *, width: int = 640, height: int = 360) -> Scene:
    """A floor and `count` - 1 small objects, half spheres and half boxes, under two lights.

    Together the objects cover about as much of the picture whatever their number.
    """
    rng = np.random.default_rng(count)
    n = count - 1
    center = rng.uniform(-1, 1, (n, 3)) * (4.5, 2.4, 2.0)
    size = rng.uniform(0.5, 1.5, n) * 1.6 / np.sqrt(count)
    eye, lights = (0.0, 1.0, 9.0), [(6.0, 8.0, 7.0), (-7.0, 6.0, 5.0)]
    if kind == "corner":
        center, size = center / 10 + (-3.9, 2.0, 0.0), size / 10
    elif kind == "cone":
        # Along the way from the light to the middle, as far from its axis as the cone allows.
        along = rng.uniform(0.3, 1.0, n)
        spread = np.radians(2) * along * np.linalg.norm(lights[0])
        center = np.array(lights[0]) * (1 - along)[:, None] + center / 5 * spread[:, None]
        size = size / 5 * spread
    elif kind == "eye amid":
        eye = (0.0, 0.0, 0.0)
    elif kind == "light amid":
        lights[0] = (0.0, 0.0, 0.0)
    if kind in ("eye amid", "light amid"):
        # What would enclose the eye or the light is moved outwards.
        distance = np.linalg.norm(center, axis=1)
        center *= np.maximum(1, 2 * size / distance)[:, None]
    spheres = n // 2
    half = size[spheres:, None] * rng.uniform(0.4, 0.8, (n - spheres, 3))
    return Scene(
        camera=Camera(
            view_point=eye,
            view_dir=(0.0, -0.1, -1.0),
            proj_distance=9.0,
            view_width=9.6,
            view_height=5.4,
        ),
        width=width,
        height=height,
        lights=_lights(*lights),
        surfaces=Surfaces(
            center=center[:spheres],
            radius=size[:spheres],
            sphere_shader=np.arange(spheres) % len(_SHADERS),
            min_pt=np.vstack([center[spheres:] - half, [(-50.0, -3.0, -50.0)]]),
            max_pt=np.vstack([center[spheres:] + half, [(50.0, -2.5, 50.0)]]),
            box_shader=np.arange(n - spheres + 1) % len(_SHADERS),
            shaders=_SHADERS,
        ),
    )


def rods(count: int, *, width: int = 640, height: int = 360) -> Scene:
    """A floor and `count` long thin boxes, along all three axes, under two lights."""
    rng = np.random.default_rng(count)
    center = rng.uniform(-3, 3, (count, 3))
    half = np.full((count, 3), 0.01)
    half[np.arange(count), rng.integers(0, 3, count)] = rng.uniform(0.3, 1, count)
    return Scene(
        camera=Camera(
            view_point=(0.0, 2.0, 12.0),
            view_dir=(0.0, -0.2, -1.0),
            proj_distance=12.0,
            view_width=14.4,
            view_height=8.1,
        ),
        width=width,
        height=height,
        lights=_lights((5.0, 8.0, 9.0), (-6.0, 7.0, 3.0)),
        surfaces=Surfaces(
            min_pt=np.vstack([center - half, [(-10.0, -4.0, -10.0)]]),
            max_pt=np.vstack([center + half, [(10.0, -3.5, 10.0)]]),
            box_shader=np.arange(count + 1) % len(_SHADERS),
            shaders=_SHADERS,
        ),
    )


def calm(*, width: int, height: int) -> dict[str, Scene]:
    """Pictures of one smooth surface under two lights, all over."""
    view = Camera(
        view_point=(0.0, 2.0, 6.0), view_dir=(0.0, -0.6, -1.0), view_width=0.4, view_height=0.225
    )
    floor = Surfaces(
        min_pt=[(-50.0, -1.0, -50.0)],
        max_pt=[(50.0, 0.0, 50.0)],
        box_shader=[0],
        shaders=_SHADERS[:1],
    )
    ball = Surfaces(
        center=[(0.0, -6.0, -2.0)], radius=[6.5], sphere_shader=[0], shaders=_SHADERS[2:]
    )
    lights = _lights((3.0, 5.0, 4.0), (-4.0, 6.0, 2.0))
    return {
        name: Scene(camera=view, width=width, height=height, lights=lights, surfaces=surfaces)
        for name, surfaces in (("a floor", floor), ("the side of a shiny ball", ball))
    }


def resized(scene: Scene, width: int, height: int) -> Scene:
    """The same view in other pixels; the window grows sideways to keep them square."""
    camera = scene.camera
    pixel = camera.view_height / height
    return replace(
        scene, width=width, height=height, camera=replace(camera, view_width=pixel * width)
    )


def lit_by(scene: Scene, count: int) -> Scene:
    """The same scene under `count` lights, spread over the sky."""
    turn = np.arange(count) * np.pi * (3 - np.sqrt(5))
    y = np.linspace(8, 3, count)
    lights = tuple(
        PointLight(position=(9 * np.cos(a), h, 9 * np.sin(a)), intensity=(1 / count,) * 3)
        for a, h in zip(turn.tolist(), y.tolist(), strict=True)
    )
    return replace(scene, lights=lights)


def afresh(scene: Scene, k: int) -> Scene:
    """A copy that shares no array with `scene`; its eye is moved by k 1e-5 window widths."""
    camera, surfaces = scene.camera, scene.surfaces
    x, y, z = camera.view_point
    return replace(
        scene,
        camera=replace(camera, view_point=(x + k * 1e-5 * camera.view_width, y, z)),
        # These copy what they are given.
        surfaces=Surfaces(**vars(surfaces)),
    )


def to_xml(scene: Scene) -> str:
    """A scene in the tracer's own format."""
    camera, s = scene.camera, scene.surfaces

    def numbers(values: ArrayLike) -> str:
        return " ".join(map(repr, np.asarray(values, dtype=np.float64).tolist()))

    surfaces = [""] * len(s)
    for index, center, radius, shader in zip(
        s.sphere_index.tolist(), s.center, s.radius.tolist(), s.sphere_shader.tolist(), strict=True
    ):
        surfaces[index] = (
            f'<surface type="Sphere"><shader ref="s{shader}"/><center>{numbers(center)}</center>'
            f"<radius>{radius!r}</radius></surface>"
        )
    for index, low, high, shader in zip(
        s.box_index.tolist(), s.min_pt, s.max_pt, s.box_shader.tolist(), strict=True
    ):
        surfaces[index] = (
            f'<surface type="Box"><shader ref="s{shader}"/><minPt>{numbers(low)}</minPt>'
            f"<maxPt>{numbers(high)}</maxPt></surface>"
        )
    shaders = []
    for k, look in enumerate(s.shaders):
        inner = f"<diffuseColor>{numbers(look.diffuse)}</diffuseColor>"
        if isinstance(look, Phong):
            inner += (
                f"<specularColor>{numbers(look.specular)}</specularColor>"
                f"<exponent>{look.exponent!r}</exponent>"
            )
        shaders.append(f'<shader type="{type(look).__name__}" name="s{k}">{inner}</shader>')
    normal = numbers(camera.normal)
    return "\n".join(
        [
            "<scene>",
            f"<camera><viewPoint>{numbers(camera.view_point)}</viewPoint>",
            f"<viewDir>{numbers(camera.view_dir)}</viewDir>",
            f"<viewUp>{numbers(camera.view_up)}</viewUp><projNormal>{normal}</projNormal>",
            f"<projDistance>{camera.proj_distance!r}</projDistance>",
            f"<viewWidth>{camera.view_width!r}</viewWidth>",
            f"<viewHeight>{camera.view_height!r}</viewHeight></camera>",
            f"<image>{scene.width} {scene.height}</image>",
            *(
                f"<light><position>{numbers(light.position)}</position>"
                f"<intensity>{numbers(light.intensity)}</intensity></light>"
                for light in scene.lights
            ),
            *shaders,
            *surfaces,
            "</scene>",
        ]
    )
