"""The contract of a shape: the operations that the tracer needs for all objects of one kind.

Each kind of surface has a subclass of `Shape`, whose methods say only what differs from this
contract.  The other modules name no subclass, except for the list `SHAPES` in `prepared_scene`.
`Shape` itself computes the tangent planes and the edges of planar faces, because it knows them from
their axes and the bounding boxes.

A ray starts at the eye and has the direction (ray_x, ray_y, depth) in camera axes (see
`CameraFrame`).  All rays of a row of the picture have the same `ray_y`.  A *span* consists of rays
of one row that are tested with the same object.  A *run* consists of consecutive hits on the same
face of the same object.  A *shadow segment* leads from a hit to a light.  Points, and the ends of
segments, are in scene axes.  `object_index` numbers all objects of the scene (see `ObjectRange`).

An object has planar faces, each perpendicular to an axis of the scene, or one curved face, or both.
The *face code* of a planar face is 2 * axis, plus 1 if the normal that faces the eye points in the
positive direction of the axis.  The code of a curved face is `CURVED_FACE`.

What other modules rely on, and `tests/accuracy/test_shape_contract.py` checks:

- Objects are convex.  So an object never shades its own points that face a light, and it covers a
  pixel if it covers the pixel's upper and lower edges.
- What is computed for a ray and an object depends on these two only.  It is the same to the last
  bit whatever else the scene contains, and however the work is divided into batches.
- If faces of two objects lie in the same plane, a ray meets them at the same t to the last bit, so
  the order of the file decides which of them is visible.
- No formula contains a power of a length above the fourth: coordinates may be as large as 1e75.
- Infinities and NaN are valid intermediate results, so callers turn off floating-point warnings.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated as Shaped
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tracer.arrays import Bools, Floats, Ints, Sides, Triple, dot, find, repeat_runs, take_2d
from tracer.geometry.camera import CameraFrame
from tracer.geometry.numbering import ObjectRange
from tracer.geometry.rounding import LIGHT_TOLERANCE, determine_side
from tracer.geometry.screen_bounds import ScreenBounds
from tracer.scene.model import Surfaces

# Stands for the axis of a planar face (0, 1 or 2) at hits on curved faces.
NO_AXIS = 3

CURVED_FACE = 2 * NO_AXIS

# Footprints on a plane are divided by the cosine at the far end of the cell, which tends to 0 at
# the horizon.  At least this fraction of the cosine at the hit is used, so footprints are finite.
_MIN_COSINE_RATIO = 1e-3


class TangentPlanes(NamedTuple):
    """The planes that touch the surface at hits.

    If the shape has a curved face, there is one plane for each hit, otherwise one for each run.
    """

    normal: Shaped[Triple, "planes"]  # unit normals that face the eye, in camera axes
    eye_height: Shaped[Floats, "planes"]  # distance of the eye from the plane
    face_axis: Shaped[Ints, "runs"]  # axis perpendicular to the face; `NO_AXIS` if it is curved
    # Direction of the face's normal along this axis (1 or -1), and coordinate of the face on the
    # axis; any numbers for curved faces.
    normal_sign: Shaped[Floats, "runs"]
    face_position: Shaped[Floats, "runs"]


class SilhouetteEdges(NamedTuple):
    """Edges of outlines, each with the values of its edge function for six rays."""

    # The edge belongs to the object object_index[item_index], where `object_index` is the argument.
    item_index: Shaped[Ints, "edges"]
    values: Shaped[Floats, "6 edges"]


class FaceHits(NamedTuple):
    """Points where rays meet the planes of faces, which all have one face code."""

    face_code: int
    # The face belongs to the object object_index[item_index], where `object_index` is the argument.
    item_index: Shaped[Ints, "k"]
    # The ray meets the plane at t times the vector from the eye to the hit; t is negative if the
    # plane is behind the eye.
    t: Shaped[Floats, "k"]
    footprint_radius: Shaped[Floats, "k"]  # radius of the part of the plane that the cell shows


@dataclass(frozen=True, eq=False, kw_only=True)
class Shape(ABC):
    """All objects of one kind, prepared for the rays of one camera."""

    planar_axes: ClassVar[tuple[int, ...]]  # axes to which the planar faces are perpendicular
    has_curved_face: ClassVar[bool]

    frame: CameraFrame
    objects: ObjectRange
    bounds: ScreenBounds  # bounding rectangles in the picture
    is_eye_inside: Shaped[Bools, "objects"]  # whether the eye is inside or on the object
    curvature: Shaped[Floats, "objects"]  # maximum curvature: 1 / radius, or 0 if all is planar
    # Upper bound on |x| + |y| + |z| of all points of the object.  Rounding errors of points on the
    # surface are proportional to it.
    coordinate_bound: Shaped[Floats, "objects"]

    @property
    def has_planar_faces(self) -> bool:
        return bool(self.planar_axes)

    @classmethod
    @abstractmethod
    def from_surfaces(cls, frame: CameraFrame, surfaces: Surfaces) -> Shape:
        """Extract the objects of a scene, and precompute what rays of its camera need."""

    @abstractmethod
    def compute_bounding_boxes(
        self,
    ) -> tuple[Shaped[Floats, "3 objects"], Shaped[Floats, "3 objects"]]:
        """Compute the smallest and the largest coordinates of each object, in scene axes.

        Planar faces are exactly at these coordinates.
        """

    def get_face_position(
        self,
        object_index: Shaped[Ints, "n"],
        axis: Shaped[Ints, "n"] | int,
        normal_sign: Shaped[Floats, "n"] | float,
    ) -> Shaped[Floats, "n"]:
        """Look up the coordinate, along an axis, of the planar face that is perpendicular to it.

        The sign, 1 or -1, is the direction along the axis of the normal that faces the eye.
        """
        index = self.objects.to_local(object_index)
        low, high = (take_2d(corner, axis, index) for corner in self.compute_bounding_boxes())
        return np.where(self.is_eye_inside[index] == (normal_sign > 0), low, high)

    # Intersections with rays from the eye.

    @abstractmethod
    def find_x_range(
        self, object_index: Shaped[Ints, "n"], top: Shaped[Floats, "n"], height: float
    ) -> tuple[Shaped[Floats, "n"], Shaped[Floats, "n"]]:
        """Find the smallest and largest x at which each object may appear in a band of the picture.

        The band of object i extends from y = top[i] to top[i] + height.  Positions are in pixels
        from the upper left corner of the picture.  If the object does not appear in the band, then
        left > right or both are NaN.

        With height 0, the band is a line.  Then the result must be exact, except for rounding
        errors, because antialiasing concludes that the object covers what lies between.
        """

    @abstractmethod
    def intersect(
        self,
        object_index: Shaped[Ints, "spans"],
        ray_y: Shaped[Floats, "spans"],
        ray_x: Shaped[Floats, "n"],
        ray_count: Shaped[Ints, "spans"] | None,
    ) -> tuple[Shaped[Floats, "n"], Shaped[NDArray[Any], "n"]]:
        """Compute where rays from the eye hit objects, span by span.

        The rays of a span have consecutive elements in `ray_x`, and the same object and `ray_y`.

        Parameters
        ----------
        ray_count
            Number of rays in each span; None if each span has one ray.

        Returns
        -------
        t
            The ray hits the object at t times its direction; infinity if it misses.  If the eye is
            inside the object or on its surface, the hit is where the ray leaves.
        hit_data
            If objects have planar faces, the code of the face that is hit; otherwise any number
            that `compute_tangent_planes` needs.
        """

    def iterate_directions(
        self,
        ray_y: Shaped[Floats, "spans"],
        ray_x: Shaped[Floats, "n"],
        ray_count: Shaped[Ints, "spans"] | None,
    ) -> Iterator[Shaped[Floats, "n"]]:
        """Yield the x, then the y and then the z components of rays, in scene axes.

        The rays are given span by span (see `intersect`).
        """
        # In scene axes, the direction is ray_x * right + ray_y * down + depth * ahead, where right,
        # down and ahead are the camera's axes.  The last two terms are the same in a span.
        for right, down, ahead in self.frame.axes.T.tolist():
            span_term = ray_y * down + self.frame.depth * ahead
            yield ray_x * right + repeat_runs(span_term, ray_count)

    def compute_tangent_planes(
        self,
        object_index: Shaped[Ints, "runs"],
        run_length: Shaped[Ints, "runs"],
        to_hit: Shaped[Floats, "3 n"],
        t: Shaped[Floats, "n"],
        hit_data: Shaped[NDArray[Any], "n"],
    ) -> TangentPlanes:
        """Compute the plane that touches the surface at each hit, for hits on planar faces.

        The hits are given run by run: a run consists of consecutive hits on one face.  A subclass
        with a curved face replaces the normal and the height of the eye at hits on it.

        Parameters
        ----------
        run_length
            Number of hits in each run.
        to_hit
            Vectors from the eye to the hits, in camera axes.
        t, hit_data
            The results of `intersect`.
        """
        first_hit = run_length.cumsum() - run_length
        face_code = hit_data.take(first_hit)
        face_axis = face_code.astype(np.intp) >> 1
        normal_sign = np.where(face_code & 1, 1.0, -1.0)
        plane_axis = np.minimum(face_axis, 2)  # for curved faces, any axis will do
        face_position = self.get_face_position(object_index, plane_axis, normal_sign)
        right, down, ahead = (
            np.asarray(normal_sign * axis[plane_axis]) for axis in self.frame.axes
        )
        return TangentPlanes(
            normal=(right, down, ahead),
            eye_height=normal_sign * (self.frame.eye[plane_axis] - face_position),
            face_axis=face_axis,
            normal_sign=normal_sign,
            face_position=face_position,
        )

    def are_rows_bounded_by_ends(self) -> bool:
        """Test whether the first and the last hit of a row bound the hits between them.

        If the result is True, the following holds for any hits on one face that are consecutive in
        one row of the picture.  The sphere whose diameter leads from the first of these hits to the
        last contains all of them.
        """
        return False

    # Tests of shadow segments.

    def find_light_side(
        self, object_index: Shaped[Ints, "n"], light: Shaped[Triple, "... #n"]
    ) -> Shaped[Sides, "... n"]:
        """Determine whether lights are `OUTSIDE`, `ON` or `INSIDE` objects."""
        tolerance = LIGHT_TOLERANCE * self.coordinate_bound[self.objects.to_local(object_index)]
        return determine_side(self.measure_distance(object_index, light), tolerance)

    @abstractmethod
    def measure_distance(
        self, object_index: Shaped[Ints, "n"], point: Shaped[Triple, "... #n"]
    ) -> Shaped[Floats, "... n"]:
        """Compute the distances of points from the surfaces of objects; negative inside.

        Outside, the result may be less than the distance, but is positive.
        """

    @abstractmethod
    def occludes(
        self,
        object_index: Shaped[Ints, "n"],
        hit: Shaped[Triple, "n"],
        light: Shaped[Triple, "n"],
        light_side: Shaped[Sides, "n"],
        growth: Shaped[Floats, "n"] | None = None,
    ) -> Shaped[Bools, "n"]:
        """Test whether each object blocks the segment from a hit to a light.

        A segment is blocked if it crosses the surface strictly between its ends.  Ends within
        rounding error of the surface count as on the surface.

        Parameters
        ----------
        light_side
            The result of `find_light_side`.
        growth
            Distance by which to grow the object before the test; negative to shrink it.  The side
            of the light stays the same.  An object that shrinks to nothing blocks nothing if the
            light is outside the unchanged object.
        """

    def test_capsules(
        self,
        object_index: Shaped[Ints, "n"],
        axis_start: Shaped[Triple, "n"],
        axis_end: Shaped[Triple, "n"],
        capsule_radius: Shaped[Floats, "n"],
    ) -> tuple[Shaped[Bools, "n"], Shaped[Bools, "n"]]:
        """Test whether each object blocks some, or all, of the shadow segments in a capsule.

        The segments start at most `capsule_radius` away from `axis_start`, and all end at
        `axis_end` (Haines and Wallace, Shaft culling, 1991).  Without an override, nothing is
        certain, and callers test every segment with `occludes`.

        Returns
        -------
        may_block
            False only if the object certainly blocks no segment.
        blocks_all
            True only if the object certainly blocks all segments.
        """
        may_block = np.ones(object_index.size, dtype=np.bool_)
        blocks_all = np.zeros(object_index.size, dtype=np.bool_)
        return may_block, blocks_all

    # Edges.  A cell is a pixel or a square part of a pixel, and six rays pass through six of its
    # points: see `silhouette`.

    @abstractmethod
    def find_silhouettes(
        self,
        object_index: Shaped[Ints, "n"],
        viewpoint: Shaped[Floats, "3 n"],
        ray: Shaped[Triple, "#6 n"],
    ) -> SilhouetteEdges:
        """Find the edges of each object's outline, seen from a viewpoint, that may cross a cell.

        The viewpoint is in scene axes.  From there, six rays in camera axes lead to the six points
        of the cell.  The edge function of an edge is zero where a ray touches the edge.  All values
        are 0 or NaN if the viewpoint is inside the object.
        """

    def compute_inverse_t(
        self, face_code: int, object_index: Shaped[Ints, "n"], ray: Shaped[Triple, "#m n"]
    ) -> Shaped[Floats, "m n"]:
        """Compute 1 / t of rays from the eye, where t * ray is on a face of each object.

        The face is extended beyond its rim: a planar face to the whole plane.  A subclass with a
        curved face overrides this method for it; where the ray misses this face, the result is any
        smooth continuation.
        """
        axis, normal_sign = _decode_face(face_code)
        offset = self.get_face_position(object_index, axis, normal_sign) - self.frame.eye[axis]
        inverse_t: Floats = self.frame.project_onto_axis(ray, axis) / offset
        return inverse_t

    def compute_normals(
        self,
        object_index: Shaped[Ints, "n"],
        ray: Shaped[Triple, "#m n"],
        inverse_t: Shaped[Floats, "m n"],
    ) -> Shaped[Triple, "m n"]:
        """Compute outward normals where rays from the eye hit the curved face.

        The normals are in camera axes, and are not normalised.  `ray` is passed to
        `compute_inverse_t`, which returns `inverse_t`.  Only shapes with a curved face need it.
        """
        raise NotImplementedError

    def find_near_faces(
        self,
        object_index: Shaped[Ints, "runs"],
        run_length: Shaped[Ints, "runs"],
        face_axis: Shaped[Ints, "runs"],
        to_hit: Shaped[Floats, "3 n"],
        max_distance: Shaped[Floats, "n"],
    ) -> Iterator[tuple[int, Shaped[Ints, "k"]]]:
        """Find the hits that are near another face of their object, for each planar face.

        Yields the code of the other face, and the indices of hits near it.  Such a hit is less than
        `max_distance` away from the plane of the face, and the face may be visible.  If objects
        also have a curved face, the subclass adds the hits near it.

        Parameters
        ----------
        run_length
            Number of hits in each run of consecutive hits on one face.
        face_axis
            Axis perpendicular to the face on which the hits of the run lie.
        to_hit
            Vectors from the eye to the hits, in camera axes.
        """
        is_eye_inside = self.is_eye_inside[self.objects.to_local(object_index)]
        for axis in self.planar_axes:
            is_other_axis = face_axis != axis
            if not is_other_axis.any():
                continue
            # Offsets are coordinates along the axis, relative to the eye.
            hit_offset = self.frame.project_onto_axis((to_hit[0], to_hit[1], to_hit[2]), axis)
            for face_code in (2 * axis, 2 * axis + 1):
                normal_sign = _decode_face(face_code)[1]
                position = self.get_face_position(object_index, axis, normal_sign)
                offset = position - self.frame.eye[axis]
                is_visible = is_eye_inside | (normal_sign * offset < 0)
                is_near = np.abs(hit_offset - repeat_runs(offset, run_length)) < max_distance
                yield face_code, find(is_near & repeat_runs(is_visible & is_other_axis, run_length))

    def intersect_other_faces(
        self, object_index: Shaped[Ints, "n"], to_hit: Shaped[Triple, "n"], cell_angle: float
    ) -> Iterator[FaceHits]:
        """Yield where the ray through each hit meets the planes of the object's planar faces.

        Of two parallel faces, only the one whose normal points against the ray counts, because the
        other is not visible.  So the results contain the face that is hit, and all faces that the
        ray just misses.  `to_hit` are the vectors from the eye to the hits, in camera axes.
        `cell_angle` is the angle that half the diagonal of a cell subtends at the eye.
        """
        distance = np.sqrt(dot(to_hit, to_hit))
        for axis in self.planar_axes:
            # Offsets are coordinates along the axis, relative to the eye.
            hit_offset = self.frame.project_onto_axis(to_hit, axis)
            # The normal of a visible face points against the ray.
            for face_code in (2 * axis, 2 * axis + 1):
                normal_sign = _decode_face(face_code)[1]
                item_index = find((hit_offset <= 0) == (normal_sign > 0))
                item_offset = hit_offset[item_index]
                position = self.get_face_position(object_index[item_index], axis, normal_sign)
                # The point t * to_hit has the offset t * item_offset, which is that of the face.
                t = (position - self.frame.eye[axis]) / item_offset
                depth = t * to_hit[2][item_index]
                cell_radius = depth * cell_angle
                cosine = np.abs(item_offset) / distance[item_index]
                yield FaceHits(
                    face_code=face_code,
                    item_index=item_index,
                    t=t,
                    footprint_radius=compute_footprint_radii(cell_radius, cosine, cell_angle),
                )


def _decode_face(face_code: int) -> tuple[int, float]:
    """Return the axis of a planar face, and the direction along it (1 or -1) of the normal."""
    return face_code >> 1, 1.0 if face_code & 1 else -1.0


def compute_footprint_radii(
    cell_radius: Shaped[Floats, "n"], cosine: Shaped[Floats, "n"], cell_angle: float
) -> Shaped[Floats, "n"]:
    """Compute the radius of the part of a surface that is visible in a cell, around each hit.

    The surface counts as planar: near the silhouettes of curved surfaces, the radius is too large,
    which was measured to change no error and no time.

    Parameters
    ----------
    cell_radius
        Radius of the circle around the cell at the depth of the hit.
    cosine
        Cosine of the angle between the normal and the direction to the eye.
    cell_angle
        Angle that half the diagonal of the cell subtends at the eye, in radians.
    """
    # At the far end of the cell, the cosine is smaller by at most `cell_angle`.
    return cell_radius / (cosine * np.maximum(1 - cell_angle / cosine, _MIN_COSINE_RATIO))
