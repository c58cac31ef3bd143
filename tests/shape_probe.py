"""Random scenes with objects of every kind, cylinders too, and rays to the objects of one kind."""

from dataclasses import replace
from random import Random
from typing import Any

import numpy as np
from cylinder import Cylinder, add_cylinders
from probe import scene_of

from tracer import Box, Camera, Lambertian, Phong, PointLight, Scene, Sphere
from tracer.arrays import Floats, Ints
from tracer.geometry.shape import Shape
from tracer.world.prepared_scene import PreparedScene


def random_scene(seed: int, size: tuple[int, int] = (60, 45)) -> Scene:
    """Build a scene of cylinders, balls and boxes on a floor, all in front of the eye."""
    random = Random(seed)

    def place(reach: float) -> tuple[float, float, float]:
        return random.uniform(-reach, reach), random.uniform(0, 2), random.uniform(-reach, reach)

    def color() -> tuple[float, float, float]:
        return random.random(), random.random(), random.random()

    def shader() -> Lambertian | Phong:
        matte = Lambertian(diffuse=color())
        return random.choice([matte, Phong(diffuse=color(), specular=(0.5,) * 3, exponent=20)])

    floor = Box(min_pt=(-9, -3, -9), max_pt=(9, -1, 9), shader=shader())
    corner = place(1.5)
    box = Box(min_pt=corner, max_pt=np.add(corner, (0.6, 0.5, 0.7)), shader=shader())
    ball = Sphere(center=place(1.5), radius=0.5, shader=shader())
    cylinders = [
        Cylinder(
            center=place(1.5),
            radius=random.uniform(0.2, 0.7),
            half_height=random.uniform(0.1, 0.9),
            shader=shader(),
        )
        for _ in range(3)
    ]
    eye = random.uniform(-3, 3), random.uniform(1, 5), 7.0
    camera = Camera(view_point=eye, view_dir=np.subtract((0, 0.7, 0), eye), proj_distance=1.6)
    lights = [
        PointLight(position=(x, 6, 4), intensity=(0.6,) * 3) for x in (-4, random.uniform(0, 5))
    ]
    scene = scene_of(floor, box, ball, camera=camera, size=size, lights=lights)
    return replace(scene, surfaces=add_cylinders(scene, *cylinders))


def prepare(shape_type: type[Shape], seed: int, **camera: Any) -> tuple[Shape, Ints]:
    """Prepare the objects of one kind in a random scene, and return their object indices.

    `camera` replaces arguments of the scene's `Camera`.
    """
    scene = random_scene(seed)
    prepared = PreparedScene(replace(scene, camera=replace(scene.camera, **camera)))
    (shape,) = (shape for shape in prepared.shapes if isinstance(shape, shape_type))
    return shape, shape.objects.list_indices()


def trace(shape: Shape, objects: Ints, seed: int) -> tuple[Floats, Floats, Floats, Any]:
    """Trace 300 random rays to each object: return ray_x, ray_y, t and `hit_data`, row by row."""
    rng = np.random.default_rng(seed)
    frame = shape.frame
    x, y = rng.uniform((0, 0), (frame.width, frame.height), (300, 2)).T
    ray_x, ray_y = (
        frame.to_ray_x(np.tile(x, objects.size)),
        frame.to_ray_y(np.tile(y, objects.size)),
    )
    return ray_x, ray_y, *shape.intersect(objects.repeat(300), ray_y, ray_x, None)
