"""Hits: the points where rays from the eye meet surfaces.

Hits are grouped by the shape (spheres or boxes) of the object that they lie on.  Within a group,
they are divided into *runs*: consecutive hits in one row of samples, on the same face of the same
object.  A flat face has one tangent plane for each run, and a curved face one for each hit.
"""

from __future__ import annotations

from typing import Annotated as Shaped
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tracer.arrays import Floats, Ints, Triple, dot, map_xyz, repeat_runs, take
from tracer.geometry.shape import NO_AXIS, Shape, TangentPlanes
from tracer.trace.samples import Samples
from tracer.world.prepared_scene import PreparedScene


class ShapeHits(NamedTuple):
    """All n hits on objects of one shape, divided into runs."""

    shape: Shape
    interval: slice  # the indices of these hits in the arrays of `Hits`
    sample_index: Shaped[Ints, "n"]
    run_length: Shaped[Ints, "runs"]  # number of hits
    run_object: Shaped[Ints, "runs"]  # object index
    planes: TangentPlanes

    def repeat_runs(self, run_values: Shaped[NDArray[Any], "runs"]) -> Any:
        """Repeat the value of each run (of consecutive hits on one face) for all its hits."""
        return repeat_runs(run_values, self.run_length)

    def expand_to_hits(self, plane_values: Shaped[Floats, "planes"]) -> Shaped[Floats, "n"]:
        """Return the value that belongs to the tangent plane at each hit.

        If the shape has a curved face, the arrays in `planes` have one value for each hit.
        Otherwise they have one value for each run of consecutive hits on one face.
        """
        return plane_values if self.shape.has_curved_face else self.repeat_runs(plane_values)

    def compute_height(
        self, point: Shaped[Floats, "3"], to_point: Shaped[Triple, "n"]
    ) -> Shaped[Floats, "n"]:
        """Compute the height of a point above the tangent plane at each hit.

        The height is positive on the side of the eye.  The position `point` is in scene axes, and
        is used for planar faces.  The vectors `to_point` lead from the hits to the point, in camera
        axes, and are used for curved faces.
        """
        planes = self.planes
        if not self.shape.has_planar_faces:
            return dot(planes.normal, to_point)
        # In scene axes, a point in the plane of a face has a height of exactly 0.  For curved
        # faces, the axis is clipped; these heights are replaced below.
        coordinate = point.take(planes.face_axis, mode="clip")
        height: Floats = self.repeat_runs(planes.normal_sign * (coordinate - planes.face_position))
        if not self.shape.has_curved_face:
            return height
        is_curved = self.repeat_runs(planes.face_axis == NO_AXIS)
        return np.where(is_curved, dot(planes.normal, to_point), height)


class Hits(NamedTuple):
    """The n hits of rays through samples, shape by shape and run by run."""

    scene: PreparedScene
    samples: Samples
    from_eye: Shaped[Floats, "3 n"]  # vectors from the eye to the hits, in camera axes
    groups: list[ShapeHits]
    sample_index: Shaped[Ints, "n"]
    run_start: Shaped[Ints, "runs+1"]  # index of the first hit of each run; the last element is n
    run_object: Shaped[Ints, "runs"]  # object index

    @property
    def hit_object(self) -> Shaped[Ints, "n"]:
        """Object index of each hit."""
        return self.run_object.repeat(np.diff(self.run_start))

    @property
    def face_axis(self) -> Shaped[Ints, "n"]:
        """Axis to which the face at each hit is perpendicular; `NO_AXIS` if it is curved."""
        group_axes = [group.repeat_runs(group.planes.face_axis) for group in self.groups]
        return np.concatenate([np.zeros(0, dtype=np.intp), *group_axes])

    @property
    def eye_height(self) -> Shaped[Floats, "n"]:
        """Distance of the eye from the tangent plane at each hit."""
        group_heights = [group.expand_to_hits(group.planes.eye_height) for group in self.groups]
        return np.concatenate([np.zeros(0), *group_heights])

    @property
    def normal(self) -> Shaped[Triple, "n"]:
        """Unit normals that face the eye, in camera axes."""
        group_normals = [
            map_xyz(group.expand_to_hits, group.planes.normal) for group in self.groups
        ]
        x, y, z = np.concatenate(group_normals, axis=1)
        return x, y, z

    @property
    def distance(self) -> Shaped[Floats, "n"]:
        """Distance of each hit from the eye, in the scene's unit of length."""
        x, y, z = self.from_eye
        return np.sqrt(dot((x, y, z), (x, y, z)))

    def get_object_values(self, values: Shaped[NDArray[Any], "objects"]) -> Any:
        """Return, as a new array, the value of the object that each hit lies on."""
        return values[self.run_object].repeat(np.diff(self.run_start))

    def get_points(self, hit_index: Shaped[Ints, "k"] | slice) -> Shaped[Triple, "k"]:
        """Return the positions of selected hits, in scene axes."""
        return self.scene.frame.point_to_scene(take(self.from_eye, hit_index))
