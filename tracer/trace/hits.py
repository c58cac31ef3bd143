"""Hits: the points where rays from the eye meet surfaces.

Hits are grouped by the shape of the object that they lie on.  Within a group, they are divided into
runs: consecutive samples of one row that hit the same face of the same object.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tracer.arrays import Floats, Ints, Triple, dot, repeat_runs, take3
from tracer.trace.samples import Samples
from tracer.world.prepared_scene import PreparedScene, Shape


class ShapeHits(NamedTuple):
    """The n hits on objects of one shape, in runs.

    A run consists of consecutive hits in one row of samples, on the same face of the same object.

    Attributes
    ----------
    shape : Spheres or Boxes
        The objects on which the hits lie.
    interval : slice
        The positions of these hits among all hits of a `Hits`.
    sample : (n,) int array
        The sample whose ray meets the surface at each hit.
    run_length : (runs,) int array
        Number of hits in each run.
    run_object : (runs,) int array
        Index of the object of each run, among all objects.
    face, sign, level : arrays
        The face of each run: see `Spheres.tangent_planes`.
    normal : tuple of three float arrays
        Unit normals on the side of the eye, in the axes of the camera: (runs,) for planar shapes,
        otherwise (n,).  `per_hit` converts both to (n,).
    eye_height : float array
        Distance of the eye from the tangent plane: (runs,) for planar shapes, otherwise (n,).
    """

    shape: Shape
    interval: slice
    sample: Ints
    run_length: Ints
    run_object: Ints
    face: Ints
    sign: Floats
    level: Floats
    normal: Triple
    eye_height: Floats

    def repeat_runs(self, values: Any) -> Any:
        """Repeat the values (runs,) of runs, so that there is one value (n,) for each hit."""
        return repeat_runs(values, self.run_length)

    def per_hit(self, values: Floats) -> Floats:
        """Return values of `normal` or `eye_height`, or computed from them, for each hit (n,)."""
        return repeat_runs(values, self.run_length) if self.shape.is_planar else values

    def object_values(self, values: NDArray[Any]) -> Any:
        """Return, from values of all objects of the scene, the value (n,) of each hit's object."""
        return self.repeat_runs(values[self.run_object])

    def height_of(self, position: Floats, vector: Triple) -> Floats:
        """Compute the height of a point over the tangent plane at each hit.

        Parameters
        ----------
        position : (3,) float array
            The point, in the axes of the scene.
        vector : tuple of three (n,) float arrays
            Vectors from the hits to the point, in the axes of the camera.

        Returns
        -------
        height : (n,) float array
            Signed distances of the point from the tangent planes; positive on the side of the eye.
        """
        if self.shape.is_planar:
            # In the axes of the scene, a light in the plane of a face has height 0 exactly.
            return self.per_hit(self.sign * (position[self.face] - self.level))
        return dot(self.normal, vector)


class Hits(NamedTuple):
    """The n hits of samples, shape by shape and run by run.

    A run consists of consecutive hits in one row of samples, on the same face of the same object.

    Attributes
    ----------
    prepared : PreparedScene
        The scene.
    samples : Rows or Scattered
        The positions in the picture through which the rays pass.
    local : (3, n) float array
        Vectors from the eye to the hits, in the axes of the camera.
    groups : list of ShapeHits
        The hits on spheres, and the hits on boxes, if there are any.
    sample : (n,) int array
        The sample whose ray meets a surface at each hit.
    run_start : (runs + 1,) int array
        Index of the first hit of each run, through all groups; the last element is n.
    run_object : (runs,) int array
        Index of the object of each run, among all objects.
    """

    prepared: PreparedScene
    samples: Samples
    local: Floats
    groups: list[ShapeHits]
    sample: Ints
    run_start: Ints
    run_object: Ints

    @property
    def hit_object(self) -> Ints:
        """Index (n,) of the object on which each hit lies."""
        return self.run_object.repeat(np.diff(self.run_start))

    @property
    def distance(self) -> Floats:
        """Distance (n,) of each hit from the eye."""
        x, y, z = self.local
        return np.sqrt(dot((x, y, z), (x, y, z)))

    def points(self, index: Ints | slice) -> Triple:
        """Return the positions of hits, given by index, in the axes of the scene."""
        return self.prepared.frame.point_to_scene(take3(self.local, index))
