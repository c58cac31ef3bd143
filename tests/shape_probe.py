"""Random scenes with objects of every kind, cylinders too, and rays to the objects of one kind."""

from dataclasses import replace
from random import Random
from typing import Any, NamedTuple

import numpy as np
from cylinder import Cylinder, add_cylinders
from probe import scene_of

from tracer import Box, Camera, Lambertian, Phong, PointLight, Scene, Sphere, Surfaces
from tracer.arrays import Floats, Ints, Triple, find, map_xyz
from tracer.geometry.shape import CURVED_FACE, Shape, TangentPlanes
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


def scale_scene(scene: Scene, factor: float) -> Scene:
    """Scale all lengths of a scene, whose surfaces may be cylinders, and remove its lights."""
    surfaces = scene.surfaces
    tables = {
        kind: {name: column * factor for name, column in columns.items()}
        for kind, columns in surfaces.tables.items()
    }
    camera = scene.camera
    lengths = {
        name: getattr(camera, name) * factor
        for name in ("proj_distance", "view_width", "view_height")
    }
    scaled = Surfaces.from_tables(
        tables,
        shader_index=surfaces.shader_index,
        file_index=surfaces.file_index,
        shaders=surfaces.shaders,
        line=surfaces.line,
    )
    eye = tuple(factor * x for x in camera.view_point)
    return replace(
        scene, camera=replace(camera, view_point=eye, **lengths), lights=[], surfaces=scaled
    )


def prepare(shape_type: type[Shape], seed: int, **camera: Any) -> tuple[Shape, Ints]:
    """Prepare the objects of one kind in a random scene, and return their object indices.

    `camera` replaces arguments of the scene's `Camera`.
    """
    scene = random_scene(seed)
    prepared = PreparedScene(replace(scene, camera=replace(scene.camera, **camera)))
    (shape,) = (shape for shape in prepared.shapes if isinstance(shape, shape_type))
    return shape, shape.objects.list_indices()


def trace(shape: Shape, objects: Ints, seed: int) -> tuple[Floats, Floats, Floats, Any]:
    """Trace the same 300 random rays to each object: return ray_x, ray_y, t and the face codes.

    Each array has 300 elements for the first object, then for the second, and so on.
    """
    rng = np.random.default_rng(seed)
    frame = shape.frame
    x, y = rng.uniform((0, 0), (frame.width, frame.height), (300, 2)).T
    ray_x = frame.to_ray_x(np.tile(x, objects.size))
    ray_y = frame.to_ray_y(np.tile(y, objects.size))
    return ray_x, ray_y, *shape.intersect(objects.repeat(300), ray_y, ray_x, None)


class Hits(NamedTuple):
    """Hits of random rays on objects of one shape, each in a run of its own."""

    shape: Shape
    object_index: Ints
    ray: Triple
    to_hit: Triple
    t: Floats
    planes: TangentPlanes
    face_code: Any
    tolerance: float  # of positions

    @property
    def points(self) -> Triple:
        return self.shape.frame.point_to_scene(self.to_hit)


def find_hits(shape_type: type[Shape], seed: int) -> Hits:
    """Trace random rays to the objects of one kind in a random scene, and return all hits."""
    shape, objects = prepare(shape_type, seed)
    ray_x, ray_y, t, hit_data = trace(shape, objects, seed)
    hits = find(t < np.inf)
    object_index, t, hit_data = objects.repeat(300)[hits], t[hits], hit_data[hits]
    ray = ray_x[hits], ray_y[hits], np.full(t.size, shape.frame.depth)
    to_hit = map_xyz(lambda component: t * component, ray)
    run_length = np.ones(t.size, dtype=np.intp)
    return Hits(
        shape=shape,
        object_index=object_index,
        ray=ray,
        to_hit=to_hit,
        t=t,
        planes=shape.compute_tangent_planes(
            object_index, run_length, np.array(to_hit), t, hit_data
        ),
        face_code=hit_data if shape.has_planar_faces else np.full(t.size, CURVED_FACE),
        tolerance=1e-12 * (shape.coordinate_bound.max() + np.abs(shape.frame.eye).sum()),
    )


class Segments(NamedTuple):
    """Segments near objects of one shape, in scene axes: 400 for each object."""

    object_index: Ints
    start: Triple
    end: Triple
    object_width: Floats  # width along x of the object of each segment


def random_segments(shape: Shape, seed: int) -> Segments:
    """Choose segments whose ends are often in the object, and seldom far away."""
    rng = np.random.default_rng(seed)
    low, high = (corner.repeat(400, axis=1) for corner in shape.compute_bounding_boxes())
    center = (low + high) / 2
    size = high - low
    start = center + rng.normal(size=low.shape) * size
    end = center + rng.normal(size=low.shape) * size
    return Segments(
        object_index=shape.objects.list_indices().repeat(400),
        start=(start[0], start[1], start[2]),
        end=(end[0], end[1], end[2]),
        object_width=size[0],
    )
