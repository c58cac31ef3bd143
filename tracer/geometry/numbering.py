"""Numbering of objects: all objects of a scene have indices together, shape by shape.

The spheres come first, then the boxes, each in the order of their arrays in `Surfaces`.  Only this
module depends on that order; other modules use an `ObjectRange` to relate indices to shapes.

Everywhere in the tracer, `object_index` is an index among all objects of the scene.
"""

from __future__ import annotations

from typing import Annotated as Shaped
from typing import NamedTuple

import numpy as np

from tracer.arrays import Bools, Ints
from tracer.scene.model import Surfaces


class ObjectRange(NamedTuple):
    """The consecutive indices of the objects of one shape, among all objects of the scene."""

    start: int
    size: int

    @property
    def slice(self) -> slice:
        """Slice of these objects in an array of all objects."""
        return slice(self.start, self.start + self.size)

    def list_indices(self) -> Shaped[Ints, "size"]:
        return np.arange(self.start, self.start + self.size)

    def contains(self, object_index: Shaped[Ints, "n"]) -> Shaped[Bools, "n"]:
        return (object_index >= self.start) & (object_index < self.start + self.size)

    def to_local(self, object_index: Shaped[Ints, "n"]) -> Shaped[Ints, "n"]:
        """Convert indices of objects of this shape to indices among them.

        The result may be `object_index` itself.
        """
        return object_index - self.start if self.start else object_index


def get_sphere_range(surfaces: Surfaces) -> ObjectRange:
    return ObjectRange(0, len(surfaces.radius))


def get_box_range(surfaces: Surfaces) -> ObjectRange:
    return ObjectRange(len(surfaces.radius), len(surfaces.min_pt))
