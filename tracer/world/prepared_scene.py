"""A scene as one camera sees it: what all samples of a picture share."""

from __future__ import annotations

from collections.abc import Iterator
from math import sqrt
from typing import NamedTuple, TypeAlias

import numpy as np

from tracer.arrays import BATCH_SIZE, Bools, Floats, Sides, changes
from tracer.geometry.box import Boxes
from tracer.geometry.camera import CameraFrame, ScreenBounds
from tracer.geometry.sphere import Spheres
from tracer.scene.model import Phong, Scene, Surfaces
from tracer.world.light_grid import POSITION_ERROR, LightGrid, light_grid

Shape: TypeAlias = Spheres | Boxes
"""All objects of one kind; see `Spheres` for what they answer."""

# Maximum number of pairs of a sample and an object on its ray in one batch of samples; maximum
# number of lights, and of pairs of a light and an object, in one batch of lights.
_MAX_SAMPLE_PAIRS, _MAX_LIGHTS, _MAX_LIGHT_PAIRS = 12 * BATCH_SIZE, 4, 4 * BATCH_SIZE

# Maximum memory, in bytes, for prepared lights that are kept for the next batch of samples.
_MAX_CACHED_BYTES = 1 << 26

# Pixels across a packet, as a part of the side of the square of pixels that each object has if all
# share the picture evenly.
_PART = 0.75


class Lights(NamedTuple):
    """Some lights of a scene, prepared for its surfaces.

    Attributes
    ----------
    position, local, intensity : (lights, 3)
        In the scene's axes, and in the camera's as seen from the eye; linear RGB.
    side : (lights, n)
        The side of each object that each light is on: see `Spheres.side`.
    grid : LightGrid
        Lists of objects by direction from each light; None if nothing can be shaded.
    """

    position: Floats
    local: Floats
    intensity: Floats
    side: Sides
    grid: LightGrid | None

    @property
    def nbytes(self) -> int:
        """Memory that they take."""
        arrays = [self.side, *(self.grid or ())]
        return sum(m.nbytes for m in arrays if isinstance(m, np.ndarray))


class PreparedScene:
    """A scene prepared for one camera; objects are numbered together, spheres first.

    Attributes
    ----------
    frame, spheres, boxes
    file_index, shader_index : (n,)
        See `Surfaces`.
    bounds, eye_inside
        As in `Spheres`, of all n objects.
    curvature : (n,)
        One over the radius; 0 for planes.
    repeated : (n,)
        Whether an object equals one that is earlier in the file: it is never seen, and shades
        nothing more.
    depth_complexity : float
        How many objects at most lie behind a sample, on average over any row.
    window : (slice, slice)
        Rows and columns of the picture outside of which nothing is seen.
    light_count : int
    diffuse, specular : (3, n)
    exponent : (n,)
    glossy : (n,)
        Whether an object has highlights at all.
    position_error : (n,)
        More than rounding can displace a point on each object.
    packet_pixels : float
        How many pixels packets may have across.
    """

    def __init__(self, scene: Scene, frame: CameraFrame) -> None:
        surfaces = scene.surfaces
        spheres, boxes = Spheres.of(frame, surfaces), Boxes.of(frame, surfaces)
        self.surfaces, self.frame, self.spheres, self.boxes = surfaces, frame, spheres, boxes
        self.repeated = _repeated(surfaces)
        bounds = ScreenBounds(*map(np.append, spheres.bounds, boxes.bounds))
        self.bounds = bounds._replace(top=np.where(self.repeated, np.inf, bounds.top))
        self.eye_inside = np.append(spheres.eye_inside, boxes.eye_inside)
        self.curvature = np.append(1 / spheres.radius, np.zeros(boxes.count))
        self.depth_complexity = self.bounds.depth_complexity(frame)
        self.window = self.bounds.window(frame)
        self._lights, self.light_count = scene.lights, len(scene.lights)
        colors = [
            (*s.diffuse, *((*s.specular, s.exponent) if isinstance(s, Phong) else (0, 0, 0, 0)))
            for s in surfaces.shaders
        ]
        table = np.array(colors).reshape(-1, 7).T.take(surfaces.shader_index, axis=1)
        self.diffuse, self.specular, self.exponent = table[:3], table[3:6], table[6]
        self.glossy = np.any(table[3:6] > 0, axis=0)
        size = np.append(spheres.size, boxes.size)
        self.position_error = POSITION_ERROR * (size + np.abs(frame.eye).sum())
        # Packets lie along rows: more pixels across make them longer, more rows only more numerous.
        pixels = frame.width * frame.height * sqrt(frame.step_v / frame.step_u)
        self.packet_pixels = _PART * sqrt(pixels / max(size.size, 1))
        self._kept = list[Lights]()

    @property
    def shapes(self) -> tuple[Shape, ...]:
        """The kinds of objects that there are."""
        both: tuple[Shape, ...] = self.spheres, self.boxes
        return tuple(shape for shape in both if shape.count)

    def at_once(self, samples: int) -> int:
        """Up to so many samples, or as many as memory allows at a time."""
        return max(1, min(samples, int(_MAX_SAMPLE_PAIRS / max(self.depth_complexity, 1.0))))

    @property
    def light_batches(self) -> Iterator[Lights]:
        """All lights, as many at a time as memory allows."""
        step = max(1, min(_MAX_LIGHTS, _MAX_LIGHT_PAIRS // max(self.curvature.size, 1)))
        for number, start in enumerate(range(0, self.light_count, step)):
            if number < len(self._kept):
                yield self._kept[number]
                continue
            batch = self.lights(slice(start, start + step))
            # Preparing the others again takes less time than most of what they are prepared for.
            if sum(kept.nbytes for kept in self._kept) < _MAX_CACHED_BYTES:
                self._kept.append(batch)
            yield batch

    def lights(self, part: slice = slice(None)) -> Lights:
        """Prepare some of the lights, or all."""
        lights = self._lights[part]
        position = np.array([light.position for light in lights]).reshape(-1, 3)
        x, y, z = position.T[:, :, None]
        sides = [
            shape.side(shape.first + np.arange(shape.count), (x, y, z))
            for shape in (self.spheres, self.boxes)
        ]
        lit = self.bounds.in_picture(self.frame)
        return Lights(
            position=position,
            local=np.column_stack(self.frame.to_camera(position)),
            intensity=np.array([light.intensity for light in lights]).reshape(-1, 3),
            side=np.concatenate(sides, axis=1),
            grid=light_grid(position, self.surfaces, self.position_error, lit, ~self.repeated),
        )


def _repeated(surfaces: Surfaces) -> Bools:
    """See `PreparedScene.repeated`."""
    radius, ends = surfaces.radius, [*surfaces.min_pt.T, *surfaces.max_pt.T]
    spheres = [*surfaces.center.T, radius, radius, radius + np.inf]  # no box ends there
    numbers = np.concatenate([spheres, ends], axis=1)
    # By one number that hardly any others share: equal objects then follow each other.
    number = (np.sqrt([[2], [3], [5], [7], [11]]) * numbers[:5]).sum(axis=0)
    order = np.lexsort((surfaces.file_index, number))
    repeated = np.empty(order.size, dtype=np.bool_)
    repeated[order] = ~changes(*numbers[:, order])
    return repeated
