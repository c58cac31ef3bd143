"""A scene prepared for one camera: the data that all samples of a picture share.

A `PreparedScene` holds one array for each property of objects, such as their bounding rectangles in
the picture and their colours.  Lights are prepared in batches when they are first needed, and a
cache keeps the batches.  Threads may share a `PreparedScene`, because its arrays never change, and
a lock protects the cache.

The parameters and attributes named `scene` in `tracer.trace` and `tracer.antialias` are of this
class.
"""

from __future__ import annotations

from collections.abc import Iterator
from math import sqrt
from threading import Lock
from typing import Annotated as Shaped
from typing import NamedTuple

import numpy as np

from tracer.arrays import BATCH_SIZE, Bools, Floats, Ints, Sides, mark_run_starts
from tracer.geometry.box import Boxes
from tracer.geometry.camera import CameraFrame, compute_frame
from tracer.geometry.numbering import get_object_range
from tracer.geometry.rounding import POSITION_ROUNDING
from tracer.geometry.screen_bounds import ScreenBounds
from tracer.geometry.shape import Shape
from tracer.geometry.sphere import Spheres
from tracer.scene.model import Phong, Scene, Surfaces
from tracer.world.light_grid import LightGrid, build_light_grid

# All kinds of objects, in the order of `Surfaces.tables`.
SHAPES: tuple[type[Shape], ...] = (Spheres, Boxes)

# Maximum number of pairs of a sample and an object on its ray in one batch of samples.
_MAX_SAMPLE_PAIRS = 12 * BATCH_SIZE

# Maximum number of lights in one batch of lights.
_MAX_LIGHTS = 4

# Maximum number of pairs of a light and an object in one batch of lights.
_MAX_LIGHT_PAIRS = 4 * BATCH_SIZE

# Once the cache of light batches has at least this many bytes, no batches are added.  Batches that
# are not in the cache are prepared again and again, which takes less time than their shadows.
_MAX_CACHED_BYTES = 1 << 26

# Width of a packet (a group of neighbouring hits) relative to sqrt(pixels / objects), which is the
# width of each object if the picture is divided into equal squares, one for each object.  Tuned on
# six scenes of 4 to 1,000 objects: with half the width, rendering takes 1.13 times as long; with
# twice the width, between 0.98 and 1.06 times.
_PACKET_SCALE = 0.75

# Stands in for shaders that are not `Phong` when specular colours and exponents are collected in
# arrays.  Its specular colour is black, so it causes no highlights.
_NOT_GLOSSY = Phong(specular=(0.0, 0.0, 0.0), exponent=0.0)

# The hash of an object is the sum of its numbers, each times one of these factors.  There must be
# as many factors as an object of any kind has numbers.
_HASH_FACTORS = np.sqrt([2, 3, 5, 7, 11, 13, 17, 19])


class Lights(NamedTuple):
    """A batch of lights, with the data that shadow tests need."""

    position: Shaped[Floats, "lights 3"]  # in scene axes
    from_eye: Shaped[Floats, "lights 3"]  # vectors from the eye, in camera axes
    intensity: Shaped[Floats, "lights 3"]  # linear RGB
    side: Shaped[Sides, "lights objects"]  # whether the light is OUTSIDE, ON or INSIDE
    grid: LightGrid | None  # None if no object can be in shadow

    @property
    def near_position(self) -> Shaped[Floats, "lights 3"]:
        """Positions of the lights, where distant lights are moved closer, as in `grid`."""
        return self.position if self.grid is None else self.grid.light_position[:, :, 0].T

    @property
    def nbytes(self) -> int:
        """Total size, in bytes, of the arrays that grow with the number of objects."""
        fields: list[object] = [self.side]
        if self.grid is not None:
            fields += [*self.grid, *self.grid.cell_lists]
        return sum(field.nbytes for field in fields if isinstance(field, np.ndarray))


class PreparedScene:
    """A scene, and precomputed data for tracing rays of its camera through any samples.

    Parameters
    ----------
    scene
        The scene.
    offset
        Displacement of every ray to the right and down, in pixels.
    """

    surfaces: Surfaces
    frame: CameraFrame
    shapes: tuple[Shape, ...]  # the shapes with at least one object, in the order of `SHAPES`
    # Bounding rectangles in the picture.  The rectangle of a duplicate has top > bottom.
    bounds: ScreenBounds
    # Whether `Shape.are_rows_bounded_by_ends` holds for all shapes: then the first and the last of
    # consecutive hits in a row bound the hits between them.
    are_rows_bounded_by_ends: bool
    is_eye_inside: Shaped[Bools, "objects"]  # whether the eye is inside or on the object
    curvature: Shaped[Floats, "objects"]  # 1 / radius for spheres, and 0 for boxes
    # Whether the object equals an object earlier in the file.  A duplicate is never visible, and
    # its shadow equals the shadow of the earlier object.
    is_duplicate: Shaped[Bools, "objects"]
    # Upper bound on the mean number of objects on a ray, for the rays of any row of pixels.
    depth_complexity: float
    visible_pixels: tuple[slice, slice]  # rows and columns outside which no object is visible
    light_count: int
    diffuse: Shaped[Floats, "3 objects"]  # linear RGB
    specular: Shaped[Floats, "3 objects"]
    exponent: Shaped[Floats, "objects"]
    is_glossy: Shaped[Bools, "objects"]  # whether the object has highlights
    position_error: Shaped[Floats, "objects"]  # upper bound on rounding errors of points on it
    packet_width: float  # width, in pixels, of a packet (a group of neighbouring hits)

    def __init__(self, scene: Scene, offset: tuple[float, float] = (0.0, 0.0)) -> None:
        self.surfaces = scene.surfaces
        self.frame = compute_frame(scene.camera, scene.width, scene.height, offset)
        self._prepare_objects()
        self._prepare_shaders()
        self.light_count = len(scene.lights)
        self._lights = scene.lights
        self._cache = dict[int, Lights]()  # each key is the index of the first light in the batch
        self._lock = Lock()

    def _prepare_objects(self) -> None:
        """Set the attributes that depend on the positions and sizes of objects."""
        shapes = [shape.from_surfaces(self.frame, self.surfaces) for shape in SHAPES]
        self._all_shapes = shapes
        self.shapes = tuple(shape for shape in shapes if shape.objects.size)
        self.are_rows_bounded_by_ends = all(
            shape.are_rows_bounded_by_ends() for shape in self.shapes
        )
        self.is_eye_inside = np.concatenate([shape.is_eye_inside for shape in shapes])
        self.curvature = np.concatenate([shape.curvature for shape in shapes])
        coordinate_bound = np.concatenate([shape.coordinate_bound for shape in shapes])
        # A point on an object is computed from coordinates of the object and of the eye.
        max_coordinate_sum = coordinate_bound + np.abs(self.frame.eye).sum()
        self.position_error = POSITION_ROUNDING * max_coordinate_sum
        self.is_duplicate = _find_duplicates(self.surfaces)
        top, bottom, left, right = np.concatenate([shape.bounds for shape in shapes], axis=1)
        top = np.where(self.is_duplicate, np.inf, top)
        self.bounds = ScreenBounds(top=top, bottom=bottom, left=left, right=right)
        self.depth_complexity = self.bounds.compute_depth_complexity(self.frame)
        self.visible_pixels = self.bounds.find_visible_pixels(self.frame)
        self.packet_width = _choose_packet_width(self.frame, coordinate_bound.size)

    def _prepare_shaders(self) -> None:
        """Set the attributes that depend on the shaders of objects."""
        shaders, shader_index = self.surfaces.shaders, self.surfaces.shader_index
        glossy = [s if isinstance(s, Phong) else _NOT_GLOSSY for s in shaders]
        diffuse = np.array([shader.diffuse for shader in shaders]).reshape(-1, 3)
        specular = np.array([shader.specular for shader in glossy]).reshape(-1, 3)
        exponent = np.array([shader.exponent for shader in glossy], dtype=np.float64)
        self.diffuse = diffuse.T.take(shader_index, axis=1)
        self.specular = specular.T.take(shader_index, axis=1)
        self.exponent = exponent.take(shader_index)
        self.is_glossy = np.any(self.specular > 0, axis=0)

    def choose_batch_size(self, max_samples: int) -> int:
        """Choose how many samples, from 1 to `max_samples`, may be traced together.

        The more objects lie on each ray, the fewer samples fit into the memory of a batch.
        """
        memory_limit = int(_MAX_SAMPLE_PAIRS / max(self.depth_complexity, 1.0))
        return max(1, min(max_samples, memory_limit))

    def iterate_light_batches(self) -> Iterator[Lights]:
        """Yield all lights of the scene, in batches that are smaller if there are many objects."""
        object_count = max(self.curvature.size, 1)
        lights_per_batch = max(1, min(_MAX_LIGHTS, _MAX_LIGHT_PAIRS // object_count))
        for start in range(0, self.light_count, lights_per_batch):
            yield self._get_light_batch(slice(start, start + lights_per_batch))

    def _get_light_batch(self, light_slice: slice) -> Lights:
        """Return prepared lights from the cache.

        Lights that are not in the cache are prepared, and added unless the cache is full.  Threads
        share the result, so it must not be changed.
        """
        # With the lock, threads wait for a batch instead of preparing the same batch twice.
        with self._lock:
            if light_slice.start in self._cache:
                return self._cache[light_slice.start]
            if sum(lights.nbytes for lights in self._cache.values()) < _MAX_CACHED_BYTES:
                lights = self.prepare_lights(light_slice)
                self._cache[light_slice.start] = lights
                return lights
        return self.prepare_lights(light_slice)

    def prepare_lights(self, light_slice: slice = slice(None)) -> Lights:
        """Prepare some or all lights, in the order of the file, without using the cache."""
        lights = self._lights[light_slice]
        positions = np.array([light.position for light in lights]).reshape(-1, 3)
        x, y, z = positions.T[:, :, None]  # each has a row for each light, and one column
        shapes = self._all_shapes
        sides = [shape.find_light_side(shape.objects.list_indices(), (x, y, z)) for shape in shapes]
        boxes = [shape.compute_bounding_boxes() for shape in shapes]
        box_min, box_max = np.concatenate(boxes, axis=2)
        grid = build_light_grid(
            light_position=positions,
            box_min=box_min,
            box_max=box_max,
            position_error=self.position_error,
            is_visible=self.bounds.is_in_picture(self.frame),
            is_occluder=~self.is_duplicate,
        )
        return Lights(
            position=positions,
            from_eye=np.column_stack(self.frame.point_to_camera(positions)),
            intensity=np.array([light.intensity for light in lights]).reshape(-1, 3),
            side=np.concatenate(sides, axis=1),
            grid=grid,
        )


def _choose_packet_width(frame: CameraFrame, object_count: int) -> float:
    """Choose the width, in pixels, of packets (groups of neighbouring hits).

    It is proportional to the width that each object would have if equally large objects filled the
    picture.
    """
    # Packets lie along rows.  If pixels are taller than wide, packets are more pixels wide.  If
    # pixels are wider than tall, there are more packets instead.
    pixel_count = frame.width * frame.height * sqrt(frame.pixel_height / frame.pixel_width)
    return _PACKET_SCALE * sqrt(pixel_count / max(object_count, 1))


def _find_duplicates(surfaces: Surfaces) -> Shaped[Bools, "objects"]:
    """Find the objects that have the kind, position and size of an object earlier in the file."""
    is_duplicate = np.zeros(len(surfaces), dtype=np.bool_)
    for kind, columns in surfaces.tables.items():
        objects = get_object_range(surfaces, kind).slice
        if objects.stop - objects.start > 1:
            # A column of vectors becomes three rows, and a column of numbers one row.
            numbers = [row for column in columns.values() for row in np.atleast_2d(column.T)]
            is_duplicate[objects] = _mark_repeated(numbers, surfaces.file_index[objects])
    return is_duplicate


def _mark_repeated(
    numbers: list[Shaped[Floats, "n"]], file_index: Shaped[Ints, "n"]
) -> Shaped[Bools, "n"]:
    """Mark the objects whose numbers all equal those of an object with a smaller `file_index`.

    Each array in `numbers` has one number for each object.
    """
    # Sort by a hash, then by file order: equal objects become neighbours, the earliest first.
    factors = _HASH_FACTORS[: len(numbers)]
    hash_terms = [factor * row for factor, row in zip(factors, numbers, strict=True)]
    sorted_index = np.lexsort((file_index, np.sum(hash_terms, axis=0)))
    is_first = mark_run_starts(*(row[sorted_index] for row in numbers))
    is_repeated = np.empty(file_index.size, dtype=np.bool_)
    is_repeated[sorted_index] = ~is_first
    return is_repeated
