"""Axis-aligned boxes: intersections with rays from the eye, and tests of shadow segments.

`Boxes` has the same methods and attributes as `Spheres`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from tracer.arrays import (
    Bools,
    Floats,
    Ints,
    Sides,
    Triple,
    map3,
    repeat_runs,
    take3,
    take_2d,
)
from tracer.geometry.camera import CameraFrame, ScreenBounds
from tracer.geometry.numbering import ObjectRange, box_range
from tracer.geometry.rounding import (
    INSIDE,
    LIGHT_TOLERANCE,
    MIN_COMPONENT,
    OUTSIDE,
    PLANE_ROUNDING,
    SURFACE_TOLERANCE,
    hit_tolerance,
)
from tracer.geometry.silhouette import silhouette_planes
from tracer.scene.model import Surfaces


@dataclass(frozen=True, eq=False)
class Boxes:
    """The n boxes of a scene, prepared for the rays of one camera.

    Attributes
    ----------
    is_planar, frame, objects, bounds, is_eye_inside, curvature, coordinate_size
        As in `Spheres`.
    min_pt, max_pt : (3, n) float arrays
        Opposite corners, with the smallest and with the largest coordinates.
    planes : tuple of three (6, n) float arrays
        Slope, tilt and level of planes through the eye and the edges of each box's silhouette (see
        `silhouette_planes`).  The ray (s, g, depth) meets the box only if
        slope * s + tilt * g + level >= 0 for all six planes.
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
    coordinate_size: Floats

    @classmethod
    def from_surfaces(cls, frame: CameraFrame, surfaces: Surfaces) -> Boxes:
        """Prepare all boxes among the surfaces of a scene for the rays of a camera."""
        min_pt, max_pt = surfaces.min_pt.T.copy(), surfaces.max_pt.T.copy()
        low, high = (corner - frame.eye[:, None] for corner in (min_pt, max_pt))
        inside = np.all((low <= 0) & (high >= 0), axis=0)
        u, v, w = frame.vector_to_camera(silhouette_planes(low, high))
        # If the eye is on a face, the box is seen from inside, and only rays that go into the box
        # meet it.  The plane of the face then bounds the rays.
        on_face = inside & (np.concatenate([low, high]) == 0)
        for component, axis in zip((u, v, w), frame.axes, strict=True):
            np.copyto(component, np.append(axis, -axis)[:, None], where=on_face)
        size: Floats = np.maximum(np.abs(min_pt), np.abs(max_pt)).sum(axis=0)
        objects, planes = box_range(surfaces), (u, v, w * frame.depth)
        bounds, curvature = _screen_bounds(frame, low, high), np.zeros(inside.size)
        return cls(frame, objects, min_pt, max_pt, planes, bounds, inside, curvature, size)

    def bounding_boxes(self) -> tuple[Floats, Floats]:
        """Return the corners of the boxes, in the axes of the scene.

        Returns
        -------
        low, high : (3, n) float arrays
            For each box, the corners with the smallest and with the largest coordinates.
        """
        return self.min_pt, self.max_pt

    # Intersections with rays from the eye.

    def row_extent(self, object_index: Ints, rows: Floats, height: float) -> tuple[Floats, Floats]:
        """Compute where boxes begin and end in rows of the picture, for pairs of both.

        Parameters
        ----------
        object_index : (n,) int array
            The box of each pair, as an index among all objects of the scene.
        rows : (n,) float array
            The upper border of each row, in pixels from the top of the picture.
        height : float
            Height of the rows, in pixels; 0 if each row is a line.

        Returns
        -------
        left, right : (n,) float arrays
            Both ends, in pixels from the left border of the picture; left > right if the box does
            not reach the row.  They contain all positions at which a ray in the row meets the box.
        """
        frame, box = self.frame, self.objects.positions(object_index)
        g = frame.ray_g(rows + height / 2)
        low, high = np.full(g.size, -np.inf), np.full(g.size, np.inf)
        # Rounding errors may turn rays; the margin contains the turned rays, too.
        margin = 0.5 * height * frame.step_v + PLANE_ROUNDING * frame.max_ray_size
        for k in range(6):
            slope, tilt, level = (component[k].take(box) for component in self.planes)
            # Within the row, take the g for which the plane bounds least.
            at_row = tilt * g + np.abs(tilt) * margin + level
            # If the slope is 0, the bound is infinite: the plane admits all rays of the row, or
            # none.  The sum turns a slope of -0 into 0.
            bound = -at_row / (slope + 0.0)
            np.fmax(low, bound, out=low, where=slope >= 0)
            np.fmin(high, bound, out=high, where=slope < 0)
        return frame.column_of(low), frame.column_of(high)

    def intersect(
        self, object_index: Ints, g: Floats, s: Floats, ray_count: Ints | None
    ) -> tuple[Floats, Sides]:
        """Compute the distances at which rays meet boxes, and the faces that they meet.

        The method is that of slabs (Kay and Kajiya, Ray tracing complex scenes, 1986).  A slab is
        the space between two opposite faces.  Slabs are closed: a ray that lies in the plane of a
        face meets the box.  The face is that through which the ray enters the box; if the eye is
        inside the box or on it, the face is that through which the ray leaves the box.

        Parameters
        ----------
        object_index : (spans,) int array
            A span consists of consecutive rays in one row that are tested with the same box: the
            index of this box among all objects of the scene.
        g : (spans,) float array
            Second component of the rays in each span.
        s : (n,) float array
            First component of each ray.
        ray_count : (spans,) int array or None
            Number of rays in each span; None if each span has one ray.

        Returns
        -------
        t : (n,) float array
            Distance from the eye, in units of the length of the ray's direction (s, g, depth);
            infinity if the ray misses the box.
        detail : (n,) int8 array
            Twice the axis (0, 1 or 2) to which the face is perpendicular, plus 1 if the normal of
            the face points up this axis.
        """
        frame, box = self.frame, self.objects.positions(object_index)
        eye, (u, v, w), near, far, faces = frame.eye.tolist(), frame.axes.tolist(), [], [], []
        for k in range(3):
            d = s * u[k] + repeat_runs(g * v[k] + frame.depth * w[k], ray_count)
            low, high = self.min_pt[k, box] - eye[k], self.max_pt[k, box] - eye[k]
            is_above = high < 0
            if np.all(is_above | (low > 0)):
                # The eye is outside of all slabs, so it is known which plane is nearer.  A ray away
                # from the slab gets an exit before its entry, and so misses the box.
                planes = np.where(is_above, high, low), np.where(is_above, low, high)
                enter, leave = (repeat_runs(plane, ray_count) / d for plane in planes)
            else:
                enter, leave = _intersect_slab(
                    repeat_runs(low, ray_count), repeat_runs(high, ray_count), d, closed=True
                )
            near.append(enter)
            far.append(leave)
            # The normal of a visible face points against the ray.
            faces.append((d < 0).view(np.int8) + np.int8(2 * k))
        enter, leave = np.maximum(*near[:2]), np.minimum(*far[:2])
        enter, leave = np.maximum(enter, near[2]), np.minimum(leave, far[2])
        t, plane_t, meets = enter, near, enter <= leave
        inside = self.is_eye_inside[box]
        if inside.any():
            inside = repeat_runs(inside, ray_count)
            t, meets = np.where(inside, leave, t), meets | inside
            plane_t = [np.where(inside, b, a) for a, b in zip(near, far, strict=True)]
        # A ray through an edge or a corner meets the face of the first axis.
        face = np.where(plane_t[1] == t, faces[1], faces[2])
        face = np.where(plane_t[0] == t, faces[0], face)
        return np.where(meets & (t > 0), t, np.inf), face

    def tangent_planes(
        self, object_index: Ints, run_length: Ints, local: Floats, t: Floats, detail: Sides
    ) -> tuple[Ints, Floats, Floats, Triple, Floats]:
        """Compute the face, the normal and the tangent plane of runs of hits.

        A run consists of consecutive hits on the same face of the same box.

        Parameters
        ----------
        object_index : (runs,) int array
            The box of each run, as an index among all objects of the scene.
        run_length : (runs,) int array
            Number of hits in each run.
        local, t : (3, n) and (n,) float arrays
            Not used: the faces of boxes are planes.
        detail : (n,) int8 array
            Second result of `intersect` for each hit.

        Returns
        -------
        face : (runs,) int array
            Axis to which the face is perpendicular: 0, 1 or 2.
        sign : (runs,) float array
            1 if the normal of the face points up its axis, and -1 if it points down.
        level : (runs,) float array
            Coordinate of the face along its axis, in the axes of the scene.
        normal : tuple of three (runs,) float arrays
            Unit normals on the side of the eye, in the axes of the camera.
        eye_height : (runs,) float array
            Distance of the eye from the plane of the face.
        """
        box = self.objects.positions(object_index)
        run_detail = detail.take(run_length.cumsum() - run_length)
        face, sign = run_detail.astype(np.intp) >> 1, np.where(run_detail & 1, 1.0, -1.0)
        low, high = take_2d(self.min_pt, face, box), take_2d(self.max_pt, face, box)
        level = np.where(self.is_eye_inside[box] == (sign > 0), low, high)
        eye_height = sign * (self.frame.eye[face] - level)
        x, y, z = (np.asarray(sign * axis[face]) for axis in self.frame.axes)
        return face, sign, level, (x, y, z), eye_height

    # Tests of shadow segments: segments from hits to lights.

    def corners(self, object_index: Ints) -> tuple[Triple, Triple]:
        """Return the corners of boxes, given by index.

        Parameters
        ----------
        object_index : (n,) int array
            Indices of the boxes among all objects.

        Returns
        -------
        low, high : tuples of three (n,) float arrays
            The corners with the smallest and with the largest coordinates.
        """
        box = self.objects.positions(object_index)
        return take3(self.min_pt, box), take3(self.max_pt, box)

    def side_of_light(self, object_index: Ints, light: Triple) -> Sides:
        """Decide, for pairs of a box and a light, on which side of the surface the light lies.

        Parameters
        ----------
        object_index : (n,) int array
            The box of each pair, as an index among all objects of the scene.
        light : tuple of three float arrays
            Position of the light of each pair, in the axes of the scene.  The arrays may have any
            shape that broadcasts with (n,).

        Returns
        -------
        side : int8 array
            `INSIDE`, or `OUTSIDE` for lights on the surface as well, in the shape to which the
            arguments broadcast.
        """
        is_inside = self.signed_distance(object_index, light) < 0
        return np.where(is_inside, INSIDE, OUTSIDE).astype(np.int8)

    def signed_distance(self, object_index: Ints, point: Triple) -> Floats:
        """Compute the largest of the signed distances of a point from the planes of a box's faces.

        Parameters
        ----------
        object_index : (n,) int array
            The box of each pair of a box and a point, as an index among all objects of the scene.
        point : tuple of three float arrays
            The point of each pair, in the axes of the scene.  The arrays may have any shape that
            broadcasts with (n,).

        Returns
        -------
        distance : float array
            Negative inside the box; outside, at most the distance from the box.  Its shape is that
            to which the arguments broadcast.
        """
        low, high = self.corners(object_index)
        heights = *map3(np.subtract, low, point), *map3(np.subtract, point, high)
        return np.asarray(np.max(heights, axis=0))

    def occludes(
        self,
        object_index: Ints,
        hit: Triple,
        light: Triple,
        side: Sides,
        growth: Floats | None = None,
    ) -> Bools:
        """Test, pair by pair, whether a box blocks the open segment from a hit to a light.

        A segment is blocked if it crosses the surface strictly between its ends.  A segment that
        lies in the plane of a face is not blocked, but a flat box blocks segments that cross it.
        An end that lies within its tolerance of the plane of a face is moved onto this plane.

        Parameters
        ----------
        object_index : (n,) int array
            The box of each pair of a box and a segment, as an index among all objects.
        hit, light : tuples of three (n,) float arrays
            Both ends of each segment, in the axes of the scene.
        side : (n,) int8 array
            Not used: the positions of the lights suffice for boxes.
        growth : (n,) float array, optional
            Distance by which the box is grown on all sides before the test; a negative value
            shrinks the box.  A box that shrinks to nothing blocks nothing.

        Returns
        -------
        blocked : (n,) bool array
            Whether the box blocks the segment.
        """
        low, high = self.corners(object_index)
        if growth is not None:
            low, high = map3(lambda c: c - growth, low), map3(lambda c: c + growth, high)
        size = self.coordinate_size[self.objects.positions(object_index)]
        start = _snap_to_faces(hit, low, high, hit_tolerance(size, hit, self.frame.eye))
        end = _snap_to_faces(light, low, high, LIGHT_TOLERANCE * size)
        blocked = _crosses_surface(start, end, low, high)
        if growth is not None:
            blocked &= (low[0] <= high[0]) & (low[1] <= high[1]) & (low[2] <= high[2])
        return blocked

    def test_capsules(
        self, object_index: Ints, start: Triple, end: Triple, thickness: Floats
    ) -> tuple[Bools, Bools]:
        """Test, pair by pair, whether a box meets a capsule, and whether it cuts the capsule.

        A capsule consists of all points within a certain distance, the thickness, of a segment
        (Haines and Wallace, Shaft culling, 1991).  It contains all segments from a ball around its
        start to its end.  Both results are conservative: rounding errors never exclude a box that
        blocks a segment, and never let a box block all segments if it does not.

        Parameters
        ----------
        object_index : (n,) int array
            The box of each pair of a box and a capsule, as an index among all objects.
        start, end : tuples of three (n,) float arrays
            Both ends of the segment, in the axes of the scene.
        thickness : (n,) float array
            Radius of the capsule.

        Returns
        -------
        meets : (n,) bool array
            False if the box certainly blocks none of the segments.
        cuts : (n,) bool array
            True if the box certainly blocks all of the segments.
        """
        # A point that counts as on a face may be this far from the face.
        size = self.coordinate_size[self.objects.positions(object_index)]
        thickness = thickness + 2 * SURFACE_TOLERANCE * size
        # Positions along the segment, in units of its length, at which it enters and leaves two
        # boxes: the box grown by the thickness on all sides, and the box shrunk by it.
        enter, leave = np.array(-np.inf), np.array(np.inf)
        enter_shrunk, leave_shrunk = enter, leave
        for p, q, low, high in zip(start, end, *self.corners(object_index), strict=True):
            d, to_low, to_high = q - p, low - p, high - p
            if np.count_nonzero(d) < d.size:
                lengths = np.abs(to_low) + np.abs(to_high) + thickness
                d = d + (d == 0) * (MIN_COMPONENT * lengths)
            near, far = _intersect_slab(to_low, to_high, d)
            margin = thickness / np.abs(d)
            enter_shrunk = np.maximum(enter_shrunk, near + margin)
            leave_shrunk = np.minimum(leave_shrunk, far - margin)
            near -= margin
            far += margin
            enter, leave = np.maximum(enter, near), np.minimum(leave, far)
        contains_capsule = (enter_shrunk < 0) & (leave_shrunk > 1)
        meets = (enter <= leave) & (leave >= 0) & (enter <= 1) & ~contains_capsule
        cuts: Bools = (enter_shrunk < leave_shrunk) & (enter > 0) & (leave < 1)
        return meets, cuts


def _intersect_slab(
    low: Floats, high: Floats, d: Floats, *, closed: bool | None = None
) -> tuple[Floats, Floats]:
    """Compute where lines enter and leave slabs.  A slab is the space between two parallel planes.

    Parameters
    ----------
    low, high : (n,) float arrays
        Positions of the two planes relative to the start of the line, along the axis to which the
        planes are perpendicular.
    d : (n,) float array
        Component of the direction of the line along this axis.
    closed : bool, optional
        Whether a line that lies in one of the planes is inside the slab.  None if no component of
        `d` is 0.

    Returns
    -------
    enter, leave : (n,) float arrays
        Distances along the line, in units of the direction's length.  A line parallel to the planes
        enters at -inf and leaves at inf if it is inside the slab; otherwise it enters at inf and
        leaves at -inf.
    """
    a, b = low / d, high / d
    enter, leave = np.minimum(a, b), np.maximum(a, b)
    if closed is not None and np.count_nonzero(d) < d.size:
        is_parallel = d == 0
        is_inside = (low <= 0) & (high >= 0) if closed else (low < 0) & (high > 0)
        enter = np.where(is_parallel, np.where(is_inside, -np.inf, np.inf), enter)
        leave = np.where(is_parallel, np.where(is_inside, np.inf, -np.inf), leave)
    return enter, leave


def _crosses_surface(start: Triple, end: Triple, low: Triple, high: Triple) -> Bools:
    """Test, pair by pair, whether an open segment crosses the surface of a box.

    Parameters
    ----------
    start, end : tuples of three (n,) float arrays
        Both ends of each segment.
    low, high : tuples of three (n,) float arrays
        Opposite corners of each box.

    Returns
    -------
    crosses : (n,) bool array
        Whether the segment enters or leaves the box strictly between its ends.
    """
    enter, leave = np.array(-np.inf), np.array(np.inf)
    for p, q, a, b in zip(start, end, low, high, strict=True):
        near, far = _intersect_slab(a - p, b - p, q - p, closed=False)
        enter, leave = np.maximum(enter, near), np.minimum(leave, far)
    crosses: Bools = (enter <= leave) & (((enter > 0) & (enter < 1)) | ((leave > 0) & (leave < 1)))
    return crosses


def _snap_to_faces(point: Triple, low: Triple, high: Triple, tolerance: Floats) -> Triple:
    """Move points that count as on the planes of faces onto these planes.

    Parameters
    ----------
    point : tuple of three (n,) float arrays
        The point of each pair of a point and a box.
    low, high : tuples of three (n,) float arrays
        Opposite corners of the box of each pair.
    tolerance : (n,) float array
        Distance from a plane within which the point counts as on the plane.

    Returns
    -------
    snapped : tuple of three (n,) float arrays
        The points after the move.
    """

    def component(x: Floats, low: Floats, high: Floats) -> Floats:
        """Move one coordinate of each point."""
        on_low, on_high = np.abs(x - low) <= tolerance, np.abs(x - high) <= tolerance
        return np.where(on_low, low, np.where(on_high, high, x))

    return map3(component, point, low, high)


def _screen_bounds(frame: CameraFrame, low: Floats, high: Floats) -> ScreenBounds:
    """Compute the bounding rectangles of boxes in the picture from their corners.

    Parameters
    ----------
    frame : CameraFrame
        The rays of the camera.
    low, high : (3, n) float arrays
        Vectors from the eye to opposite corners of each box, in the axes of the scene.
    """
    # Corner i is at `high` along axis k if bit k of i is set, and otherwise at `low`.
    x, y, z = (np.array([(low, high)[i >> k & 1][k] for i in range(8)]) for k in range(3))
    x, y, z = frame.vector_to_camera((x, y, z))
    reaches_behind, reaches_ahead = z.min(axis=0) <= 0, z.max(axis=0) >= 0

    def slopes(corner: Floats) -> tuple[Floats, Floats]:
        """Return the minimum and the maximum of a component (8, n) of corners, divided by depth."""
        slope = corner / z
        minimum = np.where(reaches_behind, -np.inf, slope.min(axis=0))
        maximum_behind = np.where(reaches_ahead, np.inf, -np.inf)
        return minimum, np.where(reaches_behind, maximum_behind, slope.max(axis=0))

    return ScreenBounds.from_slopes(frame, slopes(y), slopes(x))
