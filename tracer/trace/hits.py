"""Hits: the points where rays from the eye meet surfaces.

Hits are grouped by the shape of the object that they lie on.  Within a group, they are divided into
runs: consecutive samples of one row that hit the same face of the same object.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tracer.arrays import Floats, Ints, Triple, dot, map_xyz, repeat_runs, take
from tracer.trace.samples import Samples
from tracer.world.prepared_scene import PreparedScene, Shape


class ShapeHits(NamedTuple):
    """All n hits on objects of one shape, divided into runs.

    A hit is the point where the ray through a sample meets a surface.  A run consists of
    consecutive hits in one row of samples, on the same face of the same object.

    Attributes
    ----------
    shape : Spheres or Boxes
        The objects on which the hits lie.
    interval : slice
        The slice of these hits among all hits of a `Hits`.
    sample_index : (n,) int array
        Index of each hit's sample.
    run_length : (runs,) int array
        Number of hits in each run.
    run_object : (runs,) int array
        Index of the object of each run, among all objects.
    face_axis : (runs,) int array
        Axis to which each run's face is perpendicular: 0, 1 or 2; `NO_FACE` for spheres.
    normal_sign, face_position : (runs,) float arrays
        For boxes, the direction of each face's normal along this axis (1 or -1), and the coordinate
        of the face along this axis; meaningless for spheres.
    normal : tuple of three float arrays
        Unit normals that face the eye, in camera axes: (runs,) for planar shapes, otherwise
        (n,).  `expand_to_hits` converts either to (n,).
    eye_height : float array
        Distance of the eye from the tangent plane: (runs,) for planar shapes, otherwise (n,).
    """

    shape: Shape
    interval: slice
    sample_index: Ints
    run_length: Ints
    run_object: Ints
    face_axis: Ints
    normal_sign: Floats
    face_position: Floats
    normal: Triple
    eye_height: Floats

    def repeat_runs(self, run_values: Any) -> Any:
        """Repeat the value of each run for all hits of the run.

        A run consists of consecutive hits on the same face of the same object.

        Parameters
        ----------
        run_values : (runs,) array
            The value of each run.

        Returns
        -------
        hit_values : (n,) array
            For each hit, the value of its run.
        """
        return repeat_runs(run_values, self.run_length)

    def expand_to_hits(self, plane_values: Floats) -> Floats:
        """Look up the value of the tangent plane at each of n hits.

        Parameters
        ----------
        plane_values : (runs,) or (n,) float array
            The value of each tangent plane.  If the shape is planar, there is one plane for each
            run of hits; otherwise, there is one for each hit.

        Returns
        -------
        hit_values : (n,) float array
            The value of each hit's tangent plane.
        """
        return self.repeat_runs(plane_values) if self.shape.is_planar else plane_values

    def compute_height(self, point: Floats, to_point: Triple) -> Floats:
        """Compute the height of a point above the tangent plane at each of n hits.

        Parameters
        ----------
        point : (3,) float array
            The point, in scene axes.
        to_point : tuple of three (n,) float arrays
            Vectors from the hits to the point, in camera axes.

        Returns
        -------
        height : (n,) float array
            Signed distance of the point from each tangent plane; positive on the side of the eye.
        """
        if not self.shape.is_planar:
            return dot(self.normal, to_point)
        # In scene axes, a point in the plane of a face has a height of exactly 0.
        return self.expand_to_hits(self.normal_sign * (point[self.face_axis] - self.face_position))


class Hits(NamedTuple):
    """All n hits of samples, shape by shape and run by run.

    A hit is the point where the ray through a sample meets a surface.  A run consists of
    consecutive hits in one row of samples, on the same face of the same object.

    Attributes
    ----------
    scene : PreparedScene
        The scene.
    samples : Rows or Scattered
        The positions in the picture through which the rays pass.
    from_eye : (3, n) float array
        Vectors from the eye to the hits, in camera axes.
    groups : list of ShapeHits
        The hits on spheres, and the hits on boxes, if there are any.
    sample_index : (n,) int array
        Index of each hit's sample.
    run_start : (runs + 1,) int array
        Index of the first hit of each run, in all groups; the last element is n.
    run_object : (runs,) int array
        Index of the object of each run, among all objects.
    """

    scene: PreparedScene
    samples: Samples
    from_eye: Floats
    groups: list[ShapeHits]
    sample_index: Ints
    run_start: Ints
    run_object: Ints

    @property
    def hit_object(self) -> Ints:
        """Index (n,) of the object on which each hit lies, among all objects of the scene."""
        return self.run_object.repeat(np.diff(self.run_start))

    @property
    def face_axis(self) -> Ints:
        """Axis (n,) to which the face at each hit is perpendicular; `NO_FACE` for spheres."""
        group_axes = [group.repeat_runs(group.face_axis) for group in self.groups]
        return np.concatenate([np.zeros(0, dtype=np.intp), *group_axes])

    @property
    def eye_height(self) -> Floats:
        """Distance (n,) of the eye from the tangent plane of the surface at each hit."""
        return np.concatenate([group.expand_to_hits(group.eye_height) for group in self.groups])

    @property
    def normal(self) -> Triple:
        """Components (n,) of the unit normals that face the eye, in camera axes."""
        group_normals = [map_xyz(group.expand_to_hits, group.normal) for group in self.groups]
        x, y, z = map(np.concatenate, zip(*group_normals, strict=True))
        return x, y, z

    @property
    def distance(self) -> Floats:
        """Distance (n,) of each hit from the eye, in the scene's unit of length."""
        x, y, z = self.from_eye
        return np.sqrt(dot((x, y, z), (x, y, z)))

    def get_object_values(self, values: NDArray[Any]) -> Any:
        """Look up a value of the object on which each of n hits lies.

        Parameters
        ----------
        values : (objects,) array
            One value for each object of the scene.

        Returns
        -------
        hit_values : (n,) array
            The value of each hit's object.
        """
        return values[self.run_object].repeat(np.diff(self.run_start))

    def get_points(self, hit_index: Ints | slice) -> Triple:
        """Return the positions of selected hits in scene coordinates.

        Parameters
        ----------
        hit_index : (k,) int array or slice
            Indices of the hits to select.

        Returns
        -------
        point : tuple of three (k,) float arrays
            Coordinates x, y and z of the hits.
        """
        return self.scene.frame.point_to_scene(take(self.from_eye, hit_index))
