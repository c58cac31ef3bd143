"""Build scenes for measurements, each of which stresses one part of the tracer.

Objects have random positions and sizes.  The random numbers depend only on the number of objects,
so equal arguments give equal scenes.  The y axis points up.  Each scene sets the size of its
picture in pixels, because times depend on it.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated as Shaped
from typing import TypeAlias

import numpy as np

from reference.judges.arrays import Floats
from tracer import Box, Camera, Lambertian, Phong, PointLight, Scene, Sphere, Surfaces

Vector: TypeAlias = tuple[float, float, float]

_LIGHT_INTENSITY = (0.6, 0.6, 0.6)

# The lower and upper corners of a floor that seems endless.
_ENDLESS_FLOOR = ((-1e5, -1.0, -1e5), (1e5, 0.0, 1e5))

# Object i has shader i, modulo the number of shaders.
_SHADERS = (
    Lambertian(diffuse=(0.9, 0.6, 0.3)),
    Lambertian(diffuse=(0.3, 0.6, 0.9)),
    Phong(diffuse=(0.2, 0.7, 0.3), specular=(0.6, 0.6, 0.6), exponent=40.0),
)


def build_crowd_scene(object_count: int, *, width: int = 640, height: int = 360) -> Scene:
    """Build a scene of small objects that float above a floor, in front of the camera.

    Half of the objects are spheres, and half are boxes.  `object_count` includes the floor.  The
    size of the objects decreases as their number grows, so that they always cover about the same
    fraction of the picture.  `width` and `height` are the size of the picture in pixels.
    """
    rng = np.random.default_rng(object_count)
    small_object_count = object_count - 1
    sphere_count = small_object_count // 2
    box_count = small_object_count - sphere_count
    center = rng.uniform(-1, 1, (small_object_count, 3)) * (4.5, 2.4, 2.0)
    radius = rng.uniform(0.5, 1.5, small_object_count) * 1.6 / np.sqrt(object_count)
    half_size = radius[sphere_count:, None] * rng.uniform(0.4, 0.8, (box_count, 3))
    camera = Camera(
        view_point=(0, 1, 9),
        view_dir=(0, -0.1, -1),
        proj_distance=9,
        view_width=9.6,
        view_height=5.4,
    )
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

    `object_count` does not include the floor.  The objects fill a volume of constant size.  Many
    are hidden behind others, and they cast shadows on each other and on the floor.
    """
    rng = np.random.default_rng(object_count)
    mean_radius = (0.5 / object_count) ** (1 / 3)
    center = rng.uniform((-8, mean_radius, -8), (8, 3 + mean_radius, 8), (object_count, 3))
    radius = mean_radius * rng.uniform(0.6, 1.3, object_count)
    sphere_count = object_count // 2
    box_center = center[sphere_count:]
    half_size = radius[sphere_count:, None]
    surfaces = _make_surfaces(
        center=center[:sphere_count],
        radius=radius[:sphere_count],
        min_pt=np.vstack([box_center - half_size, [(-60, -0.5, -60)]]),
        max_pt=np.vstack([box_center + half_size, [(60, 0, 60)]]),
    )
    camera = _make_camera((12, 9, 12), (-12, -8.5, -12))
    lights = _make_lights((5, 10, -4), (-7, 13, 8))
    return Scene(camera=camera, width=640, height=360, lights=lights, surfaces=surfaces)


def build_sun_scene(ball_count: int) -> Scene:
    """Build a scene of small balls on an endless floor, lit by a very distant light.

    The scene stresses the search for occluders: the light is so far away that all balls lie in
    almost the same direction from it.
    """
    rng = np.random.default_rng(ball_count)
    center = rng.uniform((-8, 0.1, -8), (8, 0.3, 8), (ball_count, 3))
    light = (5e4, 1e5, 2e4)
    return _build_ball_scene(center, _ENDLESS_FLOOR, light, radius=0.08, width=96, height=54)


def build_horizon_scene(ball_count: int) -> Scene:
    """Build a scene of balls on an endless floor, seen by an eye just above the floor.

    The scene stresses large differences in depth between neighbouring pixels.  The distances of the
    balls from the eye, along the z axis, are spread evenly on a logarithmic scale from 3 to 1,000.
    """
    rng = np.random.default_rng(ball_count)
    distance = np.exp(rng.uniform(np.log(3), np.log(1000), ball_count))
    x = rng.uniform(-1, 1, ball_count) * distance
    center = np.column_stack([x, np.full(ball_count, 0.2), 9 - distance])
    light = (50, 100, 20)
    scene = _build_ball_scene(center, _ENDLESS_FLOOR, light, radius=0.2, width=640, height=360)
    camera = replace(scene.camera, view_point=(0, 0.5, 9), view_dir=(0, -0.1, -1))
    return replace(scene, camera=camera)


def build_heap_scene(ball_count: int) -> Scene:
    """Build a scene of a heap of balls, which are all in the shadow of one large ball.

    The scene stresses shadow tests.  Many balls may shade each visible point, but testing the large
    ball would be enough.
    """
    rng = np.random.default_rng(ball_count)
    center = rng.uniform((-4, 0.1, -4), (4, 12, 4), (ball_count, 3))
    floor = (-30, -1, -30), (30, 0, 30)
    light = (1, 30, 2)
    scene = _build_ball_scene(center, floor, light, radius=0.4, width=640, height=360)
    camera = replace(scene.camera, view_point=(12, 9, 12), view_dir=(-12, -5, -12))
    large_ball = Sphere(center=(1, 25, 2), radius=10)
    surfaces = Surfaces.from_objects([*scene.surfaces, large_ball])
    return replace(scene, camera=camera, surfaces=surfaces)


def build_rods_scene(rod_count: int) -> Scene:
    """Build a scene of long thin rods above a floor.

    The scene stresses bounding rectangles: the rods are oblique in the picture, so their rectangles
    are much larger than the rods.
    """
    rng = np.random.default_rng(rod_count)
    center = rng.uniform((-5, 0.5, -5), (5, 7, 5), (rod_count, 3))
    half_size = np.full((rod_count, 3), 0.02)
    long_axis = rng.integers(0, 3, rod_count)
    half_size[np.arange(rod_count), long_axis] = 3
    surfaces = _make_surfaces(
        center=np.zeros((0, 3)),
        radius=np.zeros(0),
        min_pt=np.vstack([center - half_size, [(-60, -4, -60)]]),
        max_pt=np.vstack([center + half_size, [(60, -3, 60)]]),
    )
    camera = _make_camera((12, 12, 12), (-12, -9, -12), view_up=(1, 1, 0))
    lights = _make_lights((7, 10, -6), (-7, 13, 8))
    return Scene(camera=camera, width=640, height=360, lights=lights, surfaces=surfaces)


def build_dust_scene(ball_count: int) -> Scene:
    """Build a scene of a floor on which tiny balls cast shadows.

    The scene stresses shadows.  The balls are outside the picture, so only the floor is visible,
    and any ball may shade it.
    """
    rng = np.random.default_rng(ball_count)
    center = rng.uniform((-2.5, 12, -2.5), (2.5, 14, 2.5), (ball_count, 3))
    floor = (-30, -1, -30), (30, 0, 30)
    light = (1, 400, 2)
    return _build_ball_scene(center, floor, light, radius=0.02, width=48, height=27)


def build_dim_lights_scene(light_count: int) -> Scene:
    """Build a scene of a ball before a wall, lit by many lights whose intensities add up to 1.2.

    The scene stresses shadow edges: there are many, and each has little contrast.
    """
    position = np.random.default_rng(0).uniform((-9, -9, 9), (9, 9, 12), (light_count, 3))
    intensity = (1.2 / light_count,) * 3
    lights = [PointLight(position=each, intensity=intensity) for each in position]
    camera = Camera(view_point=(0, 0, 100), proj_distance=100, view_width=4, view_height=4)
    wall = Box(min_pt=(-9, -9, -2), max_pt=(9, 9, -1))
    ball = Sphere(radius=1, shader=Phong(diffuse=(0.5, 0.5, 0.5)))
    return Scene(camera=camera, width=24, height=24, lights=lights, surfaces=[wall, ball])


def build_small_ball_scene() -> Scene:
    """Build a scene of one ball, whose width is a thousandth of the width of the picture.

    The scene stresses the time that is spent on the background.
    """
    camera = Camera(view_point=(0, 0, 10), view_width=1.6, view_height=0.9)
    ball = Sphere(radius=0.008)
    lights = _make_lights((3, 4, 5))
    return Scene(camera=camera, width=2560, height=1440, lights=lights, surfaces=[ball])


def build_animation(scene: Scene, frame_count: int) -> list[Scene]:
    """Copy a scene for each frame of an animation, in which the eye moves away from the origin.

    The first frame equals `scene`.  In frame number i, counted from 0, the eye is 1 + i /
    `frame_count` times as far from the origin as in `scene`.
    """
    eye = np.array(scene.camera.view_point)
    frames = []
    for frame_index in range(frame_count):
        frame_eye = eye * (1 + frame_index / frame_count)
        frames.append(replace(scene, camera=replace(scene.camera, view_point=frame_eye)))
    return frames


def copy_with_picture_size(scene: Scene, width: int, height: int) -> Scene:
    """Return a copy of a scene with another size of the picture, in pixels, and square pixels.

    The height of the camera's window stays the same, and its width is adjusted.  So the picture may
    show more or less of the scene on the left and right.
    """
    camera = replace(scene.camera, view_width=scene.camera.view_height / height * width)
    return replace(scene, width=width, height=height, camera=camera)


def _build_ball_scene(
    center: Shaped[Floats, "n 3"],
    floor: tuple[Vector, Vector],
    light: Vector,
    *,
    radius: float,
    width: int,
    height: int,
) -> Scene:
    """Build a scene of equal balls above a floor, seen from above and lit by a white light.

    Parameters
    ----------
    center
        Centres of the balls.
    floor
        The lower and the upper corner of a box.
    light
        Position of the light.
    radius
        Radius of each ball.
    width, height
        Size of the picture in pixels.
    """
    surfaces = _make_surfaces(
        center=center,
        radius=np.full(len(center), radius),
        min_pt=np.array([floor[0]], dtype=np.float64),
        max_pt=np.array([floor[1]], dtype=np.float64),
    )
    camera = _make_camera((6, 6, 6), (-6, -6, -6))
    lights = [PointLight(position=light)]
    return Scene(camera=camera, width=width, height=height, lights=lights, surfaces=surfaces)


def _make_surfaces(
    center: Shaped[Floats, "spheres 3"],
    radius: Shaped[Floats, "spheres"],
    min_pt: Shaped[Floats, "boxes 3"],
    max_pt: Shaped[Floats, "boxes 3"],
) -> Surfaces:
    """Make spheres and boxes that use `_SHADERS` in turn."""
    return Surfaces(
        center=center,
        radius=radius,
        min_pt=min_pt,
        max_pt=max_pt,
        shader_index=np.arange(len(center) + len(min_pt)) % len(_SHADERS),
        shaders=_SHADERS,
    )


def _make_camera(view_point: Vector, view_dir: Vector, view_up: Vector = (0, 1, 0)) -> Camera:
    """Make a camera for pictures whose width is 16/9 of their height."""
    return Camera(
        view_point=view_point,
        view_dir=view_dir,
        view_up=view_up,
        view_width=1,
        view_height=0.5625,
    )


def _make_lights(*positions: Vector) -> list[PointLight]:
    """Make a grey light at each position."""
    return [PointLight(position=position, intensity=_LIGHT_INTENSITY) for position in positions]
