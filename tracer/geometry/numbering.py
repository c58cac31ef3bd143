"""Numbering of objects: all objects of a scene have indices together, shape by shape.

The spheres come first, then the boxes, each in the order of their arrays in `Surfaces`.  Only this
module depends on that order; other modules use an `ObjectRange` to relate indices to shapes.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tracer.arrays import Bools, Ints
from tracer.scene.model import Surfaces


class ObjectRange(NamedTuple):
    """The consecutive indices of the objects of one shape.

    Attributes
    ----------
    start : int
        Index of the first object of the shape, among all objects of the scene.
    size : int
        Number of objects of the shape.
    """

    start: int
    size: int

    @property
    def slice(self) -> slice:
        """The slice that selects the objects of the shape from an array of all objects."""
        return slice(self.start, self.start + self.size)

    def list_indices(self) -> Ints:
        """List the indices of all objects of the shape.

        Returns
        -------
        object_index : (size,) int array
            Indices among all objects of the scene, in ascending order.
        """
        return np.arange(self.start, self.start + self.size)

    def contains(self, object_index: Ints) -> Bools:
        """Test which indices belong to objects of this shape.

        Parameters
        ----------
        object_index : (n,) int array
            Index of each object among all objects of the scene.

        Returns
        -------
        is_contained : (n,) bool array
            Whether the object has this shape.
        """
        return (object_index >= self.start) & (object_index < self.start + self.size)

    def to_local(self, object_index: Ints) -> Ints:
        """Convert indices among all objects to indices among the objects of this shape.

        Parameters
        ----------
        object_index : (n,) int array
            Indices among all objects of the scene.  The objects must have this shape.

        Returns
        -------
        local_index : (n,) int array
            Indices among the objects of this shape.  The result may be `object_index` itself.
        """
        return object_index - self.start if self.start else object_index


def get_sphere_range(surfaces: Surfaces) -> ObjectRange:
    """Return the indices of a scene's spheres.

    Parameters
    ----------
    surfaces : Surfaces
        All surfaces of the scene.

    Returns
    -------
    sphere_range : ObjectRange
        Indices among all objects of the scene.  They start at 0: spheres come before boxes.
    """
    return ObjectRange(0, len(surfaces.radius))


def get_box_range(surfaces: Surfaces) -> ObjectRange:
    """Return the indices of a scene's boxes.

    Parameters
    ----------
    surfaces : Surfaces
        All surfaces of the scene.

    Returns
    -------
    box_range : ObjectRange
        Indices among all objects of the scene.  They start after the last sphere.
    """
    return ObjectRange(len(surfaces.radius), len(surfaces.min_pt))
