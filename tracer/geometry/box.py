"""Axis-aligned boxes: intersections with rays from the eye, and tests of shadow segments.

`Boxes` has the same methods and attributes as `Spheres`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from tracer.arrays import Bools, Floats, Ints, Sides, Triple, map_xyz, repeat_runs, take, take_2d
from tracer.geometry.camera import CameraFrame, ScreenBounds
from tracer.geometry.numbering import ObjectRange, get_box_range
from tracer.geometry.rounding import (
    INSIDE,
    LIGHT_TOLERANCE,
    MIN_COMPONENT,
    OUTSIDE,
    PLANE_ROUNDING,
    SURFACE_TOLERANCE,
    compute_hit_tolerance,
)
from tracer.geometry.silhouette import find_edge_planes
from tracer.scene.model import Surfaces


@dataclass(frozen=True, eq=False)
class Boxes:
    """The n boxes of a scene, prepared for the rays of one camera.

    Attributes
    ----------
    is_planar, frame, objects, bounds, is_eye_inside, curvature, coordinate_bound
        As in `Spheres`.
    min_pt, max_pt : (3, n) float arrays
        Corners with the smallest and with the largest coordinates x, y and z.
    planes : tuple of three (6, n) float arrays
        Coefficients a, b and c of six planes for each box, through the eye and silhouette edges.  A
        ray with the direction (ray_x, ray_y, depth) meets the box only if
        a * ray_x + b * ray_y + c >= 0 for all six planes.
    """

    is_planar: ClassVar = True

    frame: CameraFrame
    objects: ObjectRange
    min_pt: Floats
    max_pt: Floats
    planes: Triple
    bounds: ScreenBounds
    is_eye_inside: Bools
    curvature: Floats
    coordinate_bound: Floats

    @classmethod
    def from_surfaces(cls, frame: CameraFrame, surfaces: Surfaces) -> Boxes:
        """Extract the boxes of a scene, and precompute the data for tracing camera rays.

        Parameters
        ----------
        frame : CameraFrame
            The camera.
        surfaces : Surfaces
            All surfaces of the scene.

        Returns
        -------
        boxes : Boxes
            All n boxes, with the planes through their silhouette edges, and bounding rectangles.
        """
        min_pt, max_pt = surfaces.min_pt.T.copy(), surfaces.max_pt.T.copy()
        eye_to_low, eye_to_high = (corner - frame.eye[:, None] for corner in (min_pt, max_pt))
        is_eye_inside = np.all((eye_to_low <= 0) & (eye_to_high >= 0), axis=0)
        normals = frame.rotate_to_camera(find_edge_planes(eye_to_low, eye_to_high))
        # If the eye is on a face, the plane of that face bounds the rays that enter the box.
        is_eye_on_face = is_eye_inside & (np.concatenate([eye_to_low, eye_to_high]) == 0)
        for normal_component, axis in zip(normals, frame.axes, strict=True):
            np.copyto(normal_component, np.append(axis, -axis)[:, None], where=is_eye_on_face)
        coordinate_bound: Floats = np.maximum(np.abs(min_pt), np.abs(max_pt)).sum(axis=0)
        objects, curvature = get_box_range(surfaces), np.zeros(is_eye_inside.size)
        planes = normals[0], normals[1], normals[2] * frame.depth
        bounds = _find_screen_bounds(frame, eye_to_low, eye_to_high)
        camera_data = planes, bounds, is_eye_inside, curvature
        return cls(frame, objects, min_pt, max_pt, *camera_data, coordinate_bound)

    def compute_bounding_boxes(self) -> tuple[Floats, Floats]:
        """Return two opposite corners of each of the n boxes, in scene axes.

        Returns
        -------
        low, high : (3, n) float arrays
            Smallest and largest coordinates of each box.
        """
        return self.min_pt, self.max_pt

    # Intersections with rays from the eye.

    def find_x_range(self, object_index: Ints, top: Floats, height: float) -> tuple[Floats, Floats]:
        """Bound the x coordinates at which each of n boxes may appear in a row of the picture.

        Parameters
        ----------
        object_index : (n,) int array
            Index of each box among all objects of the scene.
        top : (n,) float array
            Top edge of the row for each box, in pixels from the top of the picture.
        height : float
            Height of the rows, in pixels; 0 for horizontal lines across the picture.

        Returns
        -------
        left, right : (n,) float arrays
            Smallest and largest x coordinates at which the box may appear in the row, in pixels
            from the left edge of the picture.  If left > right, the box does not appear in the row.
        """
        frame, box_index = self.frame, self.objects.to_local(object_index)
        ray_y = frame.to_ray_y(top + height / 2)
        min_ray_x, max_ray_x = np.full(box_index.size, -np.inf), np.full(box_index.size, np.inf)
        # The margin allows for the other rays of the row and for rounding errors.
        margin = 0.5 * height * frame.pixel_height + PLANE_ROUNDING * frame.max_ray_size
        for plane_index in range(6):
            a, b, c = (coefficients[plane_index].take(box_index) for coefficients in self.planes)
            # A ray meets the box only if a * ray_x + b * ray_y + c >= 0.  Compute the bound
            # on `ray_x` for the largest value of the last two terms in the row.
            max_rest = b * ray_y + np.abs(b) * margin + c
            # If a is 0, the bound is infinite.  Adding 0 turns -0 into 0.
            bound = -max_rest / (a + 0.0)
            np.fmax(min_ray_x, bound, out=min_ray_x, where=a >= 0)
            np.fmin(max_ray_x, bound, out=max_ray_x, where=a < 0)
        return frame.to_picture_x(min_ray_x), frame.to_picture_x(max_ray_x)

    def intersect(
        self, object_index: Ints, ray_y: Floats, ray_x: Floats, ray_count: Ints | None
    ) -> tuple[Floats, Sides]:
        """Compute where rays from the eye hit boxes, and which faces they hit.

        The method is that of slabs (Kay and Kajiya, Ray tracing complex scenes, 1986).  A slab is
        the space between the planes of two opposite faces.  A ray that lies in one of these planes
        counts as inside the slab.

        A ray has the direction (ray_x, ray_y, depth), in camera axes.  The rays of one
        row that are tested with the same box form a span.

        Parameters
        ----------
        object_index : (spans,) int array
            Index of the box of each span, among all objects of the scene.
        ray_y : (spans,) float array
            Downward component of the rays in each span.
        ray_x : (n,) float array
            Rightward component of each ray, span by span.
        ray_count : (spans,) int array or None
            Number of rays in each span; None if each span has one ray.

        Returns
        -------
        t : (n,) float array
            Each ray hits the box at t times its direction; t is infinity if the ray misses.  If the
            eye is inside the box or on its surface, the hit is where the ray leaves the box.
        face_code : (n,) int8 array
            Code of the face that is hit: twice the axis (0, 1 or 2) of its normal, plus 1 if the
            normal towards the eye points in the positive direction of the axis.
        """
        frame, box_index = self.frame, self.objects.to_local(object_index)
        enter_ts, leave_ts, face_codes = [], [], []
        for axis in range(3):
            axis_right, axis_down, axis_ahead = frame.axes[:, axis].tolist()
            span_term = ray_y * axis_down + frame.depth * axis_ahead
            direction = ray_x * axis_right + repeat_runs(span_term, ray_count)
            low = self.min_pt[axis, box_index] - frame.eye[axis]
            high = self.max_pt[axis, box_index] - frame.eye[axis]
            low, high = repeat_runs(low, ray_count), repeat_runs(high, ray_count)
            enter_t, leave_t = _intersect_slab(low, high, direction, is_closed=True)
            enter_ts.append(enter_t)
            leave_ts.append(leave_t)
            # The normal of a visible face points against the ray.
            face_codes.append((direction < 0).view(np.int8) + np.int8(2 * axis))
        enter_t, leave_t = np.maximum(*enter_ts[:2]), np.minimum(*leave_ts[:2])
        enter_t, leave_t = np.maximum(enter_t, enter_ts[2]), np.minimum(leave_t, leave_ts[2])
        t, face_ts, is_hit = enter_t, enter_ts, enter_t <= leave_t
        is_eye_inside = self.is_eye_inside[box_index]
        if is_eye_inside.any():
            is_eye_inside = repeat_runs(is_eye_inside, ray_count)
            t, is_hit = np.where(is_eye_inside, leave_t, t), is_hit | is_eye_inside
            face_ts = [
                np.where(is_eye_inside, leave_t, enter_t)
                for enter_t, leave_t in zip(enter_ts, leave_ts, strict=True)
            ]
        # A ray through an edge or a corner hits the face of the first axis.
        face_code = np.where(face_ts[1] == t, face_codes[1], face_codes[2])
        face_code = np.where(face_ts[0] == t, face_codes[0], face_code)
        return np.where(is_hit & (t > 0), t, np.inf), face_code

    def compute_tangent_planes(
        self, object_index: Ints, run_length: Ints, to_hit: Floats, t: Floats, face_code: Sides
    ) -> tuple[Ints, Floats, Floats, Triple, Floats]:
        """Compute the plane of the face on which each run of hits lies.

        A run consists of consecutive hits on the same face of the same box.

        Parameters
        ----------
        object_index : (runs,) int array
            Index of each run's box among all objects of the scene.
        run_length : (runs,) int array
            Number of hits in each run.
        to_hit, t : (3, n) and (n,) float arrays
            Ignored: only `Spheres.compute_tangent_planes` uses them.
        face_code : (n,) int8 array
            Code of the face that is hit: twice the axis of its normal, plus 1 if the normal towards
            the eye points in the positive direction of the axis.

        Returns
        -------
        face_axis : (runs,) int array
            Axis to which the face is perpendicular: 0, 1 or 2.
        normal_sign : (runs,) float array
            1 if the normal points in the positive direction of this axis, otherwise -1.
        face_position : (runs,) float array
            Coordinate of the face along this axis, in scene axes.
        normal : tuple of three (runs,) float arrays
            Unit normals that face the eye, in camera axes.
        eye_height : (runs,) float array
            Distance of the eye from the plane of the face.
        """
        box_index = self.objects.to_local(object_index)
        run_face_code = face_code.take(run_length.cumsum() - run_length)
        face_axis = run_face_code.astype(np.intp) >> 1
        normal_sign = np.where(run_face_code & 1, 1.0, -1.0)
        low, high = (take_2d(corner, face_axis, box_index) for corner in (self.min_pt, self.max_pt))
        face_position = np.where(self.is_eye_inside[box_index] == (normal_sign > 0), low, high)
        eye_height = normal_sign * (self.frame.eye[face_axis] - face_position)
        right, down, ahead = (np.asarray(normal_sign * axis[face_axis]) for axis in self.frame.axes)
        return face_axis, normal_sign, face_position, (right, down, ahead), eye_height

    # Tests of shadow segments: segments from hits to lights.

    def get_corners(self, object_index: Ints) -> tuple[Triple, Triple]:
        """Look up two opposite corners of each given box.

        Parameters
        ----------
        object_index : (n,) int array
            Index of each box, among all objects of the scene.

        Returns
        -------
        low, high : tuples of three (n,) float arrays
            Smallest and largest coordinates x, y and z of each box, in scene axes.
        """
        box_index = self.objects.to_local(object_index)
        return take(self.min_pt, box_index), take(self.max_pt, box_index)

    def find_light_side(self, object_index: Ints, light: Triple) -> Sides:
        """Determine whether lights are outside or inside n boxes.

        Parameters
        ----------
        object_index : (n,) int array
            Index of each box among all objects of the scene.
        light : tuple of three float arrays
            Coordinates x, y and z of the lights, in scene axes, broadcastable with (n,).

        Returns
        -------
        side : int8 array
            `INSIDE` if the light is inside the box; `OUTSIDE` if it is outside or on the surface.
            The shape is that of `object_index` and the lights, broadcast together.
        """
        distance = self.measure_distance(object_index, light)
        return np.where(distance < 0, INSIDE, OUTSIDE).astype(np.int8)

    def measure_distance(self, object_index: Ints, point: Triple) -> Floats:
        """Compute the signed distances of points from n boxes.

        Parameters
        ----------
        object_index : (n,) int array
            Index of each box among all objects of the scene.
        point : tuple of three float arrays
            Coordinates x, y and z of the points, in scene axes, broadcastable with (n,).

        Returns
        -------
        distance : float array
            Largest signed distance from the planes of the six faces; negative inside the box.  The
            shape is that of `object_index` and the points, broadcast together.
        """
        low, high = self.get_corners(object_index)
        plane_distances = *map_xyz(np.subtract, low, point), *map_xyz(np.subtract, point, high)
        return np.asarray(np.max(plane_distances, axis=0))

    def occludes(
        self,
        object_index: Ints,
        hit: Triple,
        light: Triple,
        light_side: Sides,
        growth: Floats | None = None,
    ) -> Bools:
        """Test whether each of n boxes blocks the segment from a hit to a light.

        A segment is blocked if it crosses the surface of the box strictly between its ends.  A
        segment in the plane of a face is not blocked.  Before the test, ends within rounding error
        of such a plane are moved onto the plane.

        Parameters
        ----------
        object_index : (n,) int array
            Index of each box among all objects of the scene.
        hit, light : tuples of three (n,) float arrays
            Coordinates x, y and z of the two ends of each segment, in scene axes.
        light_side : (n,) int8 array
            Ignored: only `Spheres.occludes` uses it.
        growth : (n,) float array, optional
            Distance by which the box is grown on all sides before the test; negative to shrink it.
            A box that shrinks to nothing blocks nothing.

        Returns
        -------
        occludes : (n,) bool array
            Whether the box blocks the segment.
        """
        low, high = self.get_corners(object_index)
        if growth is not None:
            low, high = map_xyz(lambda x: x - growth, low), map_xyz(lambda x: x + growth, high)
        coordinate_bound = self.coordinate_bound[self.objects.to_local(object_index)]
        tolerance = compute_hit_tolerance(coordinate_bound, hit, self.frame.eye)
        snapped_hit = _snap_to_faces(hit, low, high, tolerance)
        snapped_light = _snap_to_faces(light, low, high, LIGHT_TOLERANCE * coordinate_bound)
        occludes = _crosses_surface(snapped_hit, snapped_light, low, high)
        if growth is not None:
            occludes &= (low[0] <= high[0]) & (low[1] <= high[1]) & (low[2] <= high[2])
        return occludes

    def test_capsules(
        self, object_index: Ints, axis_start: Triple, axis_end: Triple, capsule_radius: Floats
    ) -> tuple[Bools, Bools]:
        """Test whether each of n boxes blocks some or all of the segments in a capsule.

        The segments start at most `capsule_radius` away from the point `axis_start`, and all lead
        to the point `axis_end` (Haines and Wallace, Shaft culling, 1991).

        Parameters
        ----------
        object_index : (n,) int array
            Index, among all objects of the scene, of the box to test with each capsule.
        axis_start, axis_end : tuples of three (n,) float arrays
            Coordinates x, y and z of the two ends of each capsule's axis, in scene axes.
        capsule_radius : (n,) float array
            Radius of each capsule: the maximum distance of its points from its axis.

        Returns
        -------
        may_block : (n,) bool array
            Whether the box may block a segment: false only if it certainly blocks none.
        blocks_all : (n,) bool array
            Whether the box blocks all segments: true only if this is certain.
        """
        # Allow for the distance by which `occludes` moves the ends of a segment.
        coordinate_bound = self.coordinate_bound[self.objects.to_local(object_index)]
        capsule_radius = capsule_radius + 2 * SURFACE_TOLERANCE * coordinate_bound
        # Positions on the axis, from 0 to 1, at which it enters and leaves the box grown by the
        # radius of the capsule, and the box shrunk by it.
        enter_t, leave_t = shrunk_enter_t, shrunk_leave_t = np.array(-np.inf), np.array(np.inf)
        low, high = self.get_corners(object_index)
        # Coordinate i is x in the first pass, then y, then z.
        for start_i, end_i, low_i, high_i in zip(axis_start, axis_end, low, high, strict=True):
            direction, to_low, to_high = end_i - start_i, low_i - start_i, high_i - start_i
            if np.count_nonzero(direction) < direction.size:
                length_scale = np.abs(to_low) + np.abs(to_high) + capsule_radius
                direction = direction + (direction == 0) * (MIN_COMPONENT * length_scale)
            near_t, far_t = _intersect_slab(to_low, to_high, direction)
            margin = capsule_radius / np.abs(direction)
            shrunk_enter_t = np.maximum(shrunk_enter_t, near_t + margin)
            shrunk_leave_t = np.minimum(shrunk_leave_t, far_t - margin)
            near_t -= margin
            far_t += margin
            enter_t, leave_t = np.maximum(enter_t, near_t), np.minimum(leave_t, far_t)
        contains_capsule = (shrunk_enter_t < 0) & (shrunk_leave_t > 1)
        may_block = (enter_t <= leave_t) & (leave_t >= 0) & (enter_t <= 1) & ~contains_capsule
        blocks_all: Bools = (shrunk_enter_t < shrunk_leave_t) & (enter_t > 0) & (leave_t < 1)
        return may_block, blocks_all


def _intersect_slab(
    low: Floats, high: Floats, direction: Floats, *, is_closed: bool = False
) -> tuple[Floats, Floats]:
    """Compute where each of n lines enters and leaves a slab, the space between parallel planes.

    Parameters
    ----------
    low, high : (n,) float arrays
        Coordinates of the two planes along their normal, relative to the start of the line.
    direction : (n,) float array
        Component of the line's direction along this normal.
    is_closed : bool
        Whether a line that lies in one of the planes counts as inside the slab.

    Returns
    -------
    enter_t, leave_t : (n,) float arrays
        Positions along the line, as multiples of its direction.  A line parallel to the slab enters
        at -inf and leaves at inf if it is inside; otherwise it enters at inf and leaves at -inf.
    """
    low_t, high_t = low / direction, high / direction
    enter_t, leave_t = np.minimum(low_t, high_t), np.maximum(low_t, high_t)
    if np.count_nonzero(direction) < direction.size:
        is_parallel = direction == 0
        is_inside = (low <= 0) & (high >= 0) if is_closed else (low < 0) & (high > 0)
        enter_t = np.where(is_parallel, np.where(is_inside, -np.inf, np.inf), enter_t)
        leave_t = np.where(is_parallel, np.where(is_inside, np.inf, -np.inf), leave_t)
    return enter_t, leave_t


def _crosses_surface(start: Triple, end: Triple, low: Triple, high: Triple) -> Bools:
    """Test whether each of n segments crosses the surface of a box.

    Parameters
    ----------
    start, end : tuples of three (n,) float arrays
        Coordinates x, y and z of the two ends of each segment.
    low, high : tuples of three (n,) float arrays
        Smallest and largest coordinates x, y and z of the box for each segment.

    Returns
    -------
    crosses_surface : (n,) bool array
        Whether the segment enters or leaves the box strictly between the segment's ends.
    """
    enter_t, leave_t = np.array(-np.inf), np.array(np.inf)
    # Coordinate i is x in the first pass, then y, then z.
    for start_i, end_i, low_i, high_i in zip(start, end, low, high, strict=True):
        near_t, far_t = _intersect_slab(low_i - start_i, high_i - start_i, end_i - start_i)
        enter_t, leave_t = np.maximum(enter_t, near_t), np.minimum(leave_t, far_t)
    is_within_segment = ((enter_t > 0) & (enter_t < 1)) | ((leave_t > 0) & (leave_t < 1))
    crosses_surface: Bools = (enter_t <= leave_t) & is_within_segment
    return crosses_surface


def _snap_to_faces(point: Triple, low: Triple, high: Triple, tolerance: Floats) -> Triple:
    """Move points that are close to the plane of a box face onto this plane.

    Parameters
    ----------
    point : tuple of three (n,) float arrays
        Coordinates x, y and z of the points.
    low, high : tuples of three (n,) float arrays
        Smallest and largest coordinates x, y and z of the box for each point.
    tolerance : (n,) float array
        Maximum distance by which each point is moved along an axis.

    Returns
    -------
    snapped_point : tuple of three (n,) float arrays
        The new coordinates.  Coordinates farther than the tolerance from every face are unchanged.
    """

    def snap_coordinate(x: Floats, low_x: Floats, high_x: Floats) -> Floats:
        """Replace x by `low_x` or `high_x` where the difference is within the tolerance."""
        is_on_low, is_on_high = np.abs(x - low_x) <= tolerance, np.abs(x - high_x) <= tolerance
        return np.where(is_on_low, low_x, np.where(is_on_high, high_x, x))

    return map_xyz(snap_coordinate, point, low, high)


def _find_screen_bounds(frame: CameraFrame, low: Floats, high: Floats) -> ScreenBounds:
    """Compute a bounding rectangle in the picture for each of n boxes.

    Parameters
    ----------
    frame : CameraFrame
        The camera.
    low, high : (3, n) float arrays
        Vectors from the eye to opposite corners of each box, in scene axes.

    Returns
    -------
    bounds : ScreenBounds
        The rectangle of each box: infinite if the box is partly behind the eye, and empty if it is
        entirely behind the eye.
    """
    # Bit `axis` of i is 1 if corner i has the coordinate `high` along this axis, and 0 for `low`.
    x, y, z = (np.array([(low, high)[i >> axis & 1][axis] for i in range(8)]) for axis in range(3))
    right, down, depth = frame.rotate_to_camera((x, y, z))
    has_corner_behind, has_corner_ahead = depth.min(axis=0) <= 0, depth.max(axis=0) >= 0

    def find_slope_range(offset: Floats) -> tuple[Floats, Floats]:
        """Return the smallest and the largest slope among the eight corners of each box.

        The slope of a corner is its offset to the right of the eye (or down), divided by its depth.
        The range is -inf to inf for a box partly behind the eye.  For a box entirely behind the
        eye, it is -inf to -inf, which is outside every picture.
        """
        slope = offset / depth
        min_slope = np.where(has_corner_behind, -np.inf, slope.min(axis=0))
        max_slope_if_behind = np.where(has_corner_ahead, np.inf, -np.inf)
        return min_slope, np.where(has_corner_behind, max_slope_if_behind, slope.max(axis=0))

    return ScreenBounds.from_slopes(frame, find_slope_range(down), find_slope_range(right))
