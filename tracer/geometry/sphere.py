"""Spheres: intersections with rays from the eye, and tests of shadow segments.

`Spheres` and `Boxes` have the same methods and attributes.  All methods take indices of objects
among all objects of the scene (see `ObjectRange`).

Rays start at the eye.  A ray has the direction (ray_right, ray_down, depth) in camera axes:
`ray_right` changes along a row of the picture, `ray_down` from row to row, and `depth` is the same
for all rays (see `CameraFrame`).  The result for a pair of a ray and an object depends on this pair
only.  It is the same to the last bit whatever else the scene contains, and however pairs are
arranged in batches.

Infinities and NaN are valid intermediate results, so callers turn off floating-point warnings.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from tracer.arrays import Bools, Floats, Ints, Sides, Triple, dot, indices, map3, repeat_runs, take3
from tracer.geometry.camera import CameraFrame, ScreenBounds
from tracer.geometry.numbering import ObjectRange, sphere_range
from tracer.geometry.rounding import (
    LIGHT_TOLERANCE,
    MIN_POWER,
    ON,
    OUTSIDE,
    SQUARE_ROUNDING,
    UNIT_TOLERANCE,
    hit_tolerance,
    side_of_surface,
)
from tracer.scene.model import Surfaces

# Stands for the axis of a face (0, 1 or 2) at hits on spheres, which have no faces.
NO_FACE = 3


@dataclass(frozen=True, eq=False)
class Spheres:
    """The n spheres of a scene, prepared for the rays of one camera.

    Attributes
    ----------
    is_planar : bool
        Whether objects of this shape consist of planar faces.
    frame : CameraFrame
        The rays of the camera.
    objects : ObjectRange
        Indices of the spheres among all objects of the scene.
    center : (3, n) float array
        Centres, in scene axes.
    radius : (n,) float array
        Radii.
    from_eye : tuple of three (n,) float arrays
        Vectors from the eye to the centres, in camera axes.
    power : (n,) float array
        |centre - eye|^2 - radius^2 for each sphere: positive if the eye is outside, 0 if the eye
        is on the sphere.
    bounds : ScreenBounds
        Bounding rectangles of the spheres in the picture.
    is_eye_inside : (n,) bool array
        Whether the eye is inside the sphere, or on it.
    curvature : (n,) float array
        Curvature of the surface: 1 / radius; 0 for planar shapes.
    coordinate_size : (n,) float array
        Upper bound on |x| + |y| + |z| of all points of the object.  Rounding errors of points on
        the surface are proportional to it.
    """

    is_planar: ClassVar = False

    frame: CameraFrame
    objects: ObjectRange
    center: Floats
    radius: Floats
    from_eye: Triple
    power: Floats
    bounds: ScreenBounds
    is_eye_inside: Bools
    curvature: Floats
    coordinate_size: Floats

    @classmethod
    def from_surfaces(cls, frame: CameraFrame, surfaces: Surfaces) -> Spheres:
        """Extract a scene's spheres, and precompute the data for tracing camera rays.

        Parameters
        ----------
        frame : CameraFrame
            The rays of the camera.
        surfaces : Surfaces
            All surfaces of the scene.

        Returns
        -------
        spheres : Spheres
            All n spheres, with their bounding rectangles, and their positions relative to the eye.
        """
        center, radius = surfaces.center.T.copy(), surfaces.radius
        from_eye = frame.points_to_camera(surfaces.center)
        distance = np.sqrt(dot(from_eye, from_eye))
        eye_height = distance - radius
        # If the eye lies on a sphere, rounding errors must not move it off the sphere.
        is_eye_on_sphere = np.abs(eye_height) <= UNIT_TOLERANCE * radius
        power = np.where(is_eye_on_sphere, 0, eye_height * (distance + radius))
        (right, down, ahead), radius2 = from_eye, radius * radius
        slopes = (
            _tangent_slopes(sideways, ahead, radius2, sideways * sideways + ahead * ahead - radius2)
            for sideways in (down, right)
        )
        bounds = ScreenBounds.from_slopes(frame, *slopes)
        objects, coordinate_size = sphere_range(surfaces), np.abs(center).sum(axis=0) + radius
        eye_data = from_eye, power, bounds, power <= 0
        return cls(frame, objects, center, radius, *eye_data, 1 / radius, coordinate_size)

    def bounding_boxes(self) -> tuple[Floats, Floats]:
        """Compute the axis-aligned bounding boxes of all n objects, in scene axes.

        Returns
        -------
        low, high : (3, n) float arrays
            Smallest and largest coordinates of each object.
        """
        return self.center - self.radius, self.center + self.radius

    # Intersections with rays from the eye.

    def row_extent(self, object_index: Ints, row_y: Floats, height: float) -> tuple[Floats, Floats]:
        """Compute the columns that an object covers in a row, for n (object, row) pairs.

        Parameters
        ----------
        object_index : (n,) int array
            Index of each pair's object among all objects of the scene.
        row_y : (n,) float array
            Top edge of each pair's row, in pixels from the top of the picture.
        height : float
            Height of the rows, in pixels.  If it is 0, a row is a line, and the result is exact
            except for rounding errors.  Otherwise the result is conservative: it contains all
            positions at which any ray in the row meets the object.

        Returns
        -------
        left, right : (n,) float arrays
            Ends of the interval of columns, in pixels from the left edge of the picture.  If no
            ray in the row meets the object, left > right or both are NaN.
        """
        # At the sphere, every ray in the row is within a margin of the ray below or above it on the
        # row's centre line.  So if a ray in the row meets the sphere, the ray on the centre line
        # meets the sphere grown by this margin.
        frame, sphere_index = self.frame, self.objects.positions(object_index)
        radius = self.radius[sphere_index]
        slope_margin = 0.5 * height * frame.pixel_height / frame.depth
        max_depth = np.maximum(self.from_eye[2][sphere_index] + radius, 0)
        grown_radius = radius + slope_margin * max_depth
        power = self.power[sphere_index] - (grown_radius - radius) * (grown_radius + radius)
        ray_down = frame.ray_down(row_y + height / 2)
        discs = self._cut_discs(sphere_index, grown_radius, ray_down)
        ray_ahead, right, ahead, disc_radius2 = discs
        low_slope, high_slope = _tangent_slopes(right, ahead, disc_radius2, power)
        return frame.column_of(low_slope * ray_ahead), frame.column_of(high_slope * ray_ahead)

    def _cut_discs(
        self, sphere_index: Ints, radius: Floats, ray_down: Floats
    ) -> tuple[Floats, Floats, Floats, Floats]:
        """Compute the disc that a plane of rays cuts out of a sphere, for n (sphere, plane) pairs.

        A ray has the direction (ray_right, ray_down, depth), in camera axes.  All rays with the
        same `ray_down` lie in one plane through the eye.  This plane has two axes: to the right,
        along a row of the picture; and ahead, perpendicular to the row.

        Parameters
        ----------
        sphere_index : (n,) int array
            Index of each pair's sphere among all spheres.
        radius : (n,) float array
            Radius to use instead of the sphere's own radius.
        ray_down : (n,) float array
            Downward component of the rays in each plane.

        Returns
        -------
        ray_ahead : (n,) float array
            Forward component of the rays in each plane: sqrt(ray_down^2 + depth^2).
        right, ahead : (n,) float arrays
            Components, along the axes of the plane, of the vector from the eye to the centre of
            each disc.
        disc_radius2 : (n,) float array
            Squared radius of each disc; negative if the plane misses the sphere.
        """
        (right, down, forward), depth = take3(self.from_eye, sphere_index), self.frame.depth
        ray_ahead = np.sqrt(ray_down * ray_down + depth * depth)
        plane_distance = (down * depth - forward * ray_down) / ray_ahead
        ahead = (down * ray_down + forward * depth) / ray_ahead
        disc_radius2 = (radius - plane_distance) * (radius + plane_distance)
        return ray_ahead, right, ahead, disc_radius2

    def intersect(
        self, object_index: Ints, ray_down: Floats, ray_right: Floats, ray_count: Ints | None
    ) -> tuple[Floats, Floats]:
        """Compute the distances at which rays from the eye hit objects.

        A ray has the direction (ray_right, ray_down, depth), in camera axes.  Rays are given in
        spans: consecutive rays in one row of the picture, with the same `ray_down`, that are tested
        with the same object.  The rays of a row lie in a plane through the eye, and this plane cuts
        a disc out of a sphere.  Rays and discs are intersected in the plane.  The nearer root of
        A t^2 - 2 B t + C = 0 is computed in the stable form t = C / (B + sqrt(B^2 - A C)) (Haines,
        Günther and Akenine-Möller, Precision improvements for ray/sphere intersection, Ray Tracing
        Gems, ch. 7).

        Parameters
        ----------
        object_index : (spans,) int array
            Index of each span's object among all objects of the scene.
        ray_down : (spans,) float array
            Downward component of the rays in each span.
        ray_right : (n,) float array
            Rightward component of each ray, span by span.
        ray_count : (spans,) int array or None
            Number of rays in each span; None if each span has one ray.

        Returns
        -------
        t : (n,) float array
            Distance from the eye, in units of the length of the ray's direction; infinity if the
            ray misses the object.  If the eye is inside the object or on its surface, this is the
            distance at which the ray leaves the object.
        hit_data : (n,) array
            Argument for `tangent_planes`.  For spheres, this is |n . d| radius, where n is the unit
            normal and d is the ray's direction.  For boxes, it is an int8 code of the face.
        """
        sphere_index, depth = self.objects.positions(object_index), self.frame.depth
        discs = self._cut_discs(sphere_index, self.radius[sphere_index], ray_down)
        ray_ahead, right, ahead, disc_radius2 = discs
        length2 = repeat_runs(ray_down * ray_down + depth * depth, ray_count)
        length2 = ray_right * ray_right + length2
        # Cross product and dot product of the ray and the vector (right, ahead) to the disc centre.
        # In the quadratic equation, A is `length2`, B is the dot product, and C is `power`: the
        # squared distance of the eye from the sphere's centre, minus the squared radius.
        cross_product = repeat_runs(right * ray_ahead, ray_count)
        cross_product -= repeat_runs(ahead, ray_count) * ray_right
        sqrt_term = np.sqrt(length2 * repeat_runs(disc_radius2, ray_count) - cross_product**2)
        dot_product = repeat_runs(right, ray_count) * ray_right
        dot_product += repeat_runs(ahead * ray_ahead, ray_count)
        divisor = dot_product + sqrt_term
        power = self.power[sphere_index]
        is_eye_outside_all, power = np.all(power > 0), repeat_runs(power, ray_count)
        t = power / divisor
        if not is_eye_outside_all:  # the farther root, in the form with less cancellation
            far_t = np.where(dot_product > 0, divisor / length2, power / (dot_product - sqrt_term))
            t = np.where(power > 0, t, far_t)
        # t is NaN if there is no root, and negative if the sphere is behind the eye.
        return np.where(t > 0, t, np.inf), sqrt_term

    def tangent_planes(
        self, object_index: Ints, run_length: Ints, from_eye: Floats, t: Floats, hit_data: Floats
    ) -> tuple[Ints, Floats, Floats, Triple, Floats]:
        """Compute the tangent plane of the surface at each of n hits.

        Hits are given in runs: consecutive hits on the same face of the same object.

        Parameters
        ----------
        object_index : (runs,) int array
            Index of each run's object among all objects of the scene.
        run_length : (runs,) int array
            Number of hits in each run.
        from_eye : (3, n) float array
            Vectors from the eye to the hits, in camera axes.
        t, hit_data : (n,) arrays
            The results of `intersect` for the rays through the hits.

        Returns
        -------
        face_axis : (runs,) int array
            Axis to which the face is perpendicular: 0, 1 or 2; `NO_FACE` for spheres.
        sign : (runs,) float array
            1 if the normal of the face points up its axis, and -1 if it points down; for spheres,
            a meaningless 0-dimensional array.
        level : (runs,) float array
            Coordinate of the face along its axis, in scene axes; for spheres, a meaningless
            0-dimensional array.
        normal : tuple of three float arrays
            Unit normals that face the eye, in camera axes: (n,) for spheres, (runs,) for
            boxes.
        eye_height : float array
            Distance of the eye from the tangent plane: (n,) for spheres, (runs,) for boxes.
        """
        sphere_index = self.objects.positions(object_index)
        # If the eye is inside, the normal points to the centre, and its sign is negative.
        normal_sign = np.where(self.is_eye_inside[sphere_index], -1.0, 1.0)
        signed_curvature = repeat_runs(1 / (normal_sign * self.radius[sphere_index]), run_length)
        centers = (repeat_runs(component[sphere_index], run_length) for component in self.from_eye)
        components = zip(from_eye, centers, strict=True)
        right, down, ahead = ((hit - center) * signed_curvature for hit, center in components)
        face_axis, sign, level = np.full(sphere_index.size, NO_FACE), np.ones(()), np.zeros(())
        return face_axis, sign, level, (right, down, ahead), hit_data * np.abs(signed_curvature) * t

    # Tests of shadow segments: segments from hits to lights.

    def side_of_light(self, object_index: Ints, light: Triple) -> Sides:
        """Decide whether a light lies outside, on or inside an object, for n (object, light) pairs.

        Parameters
        ----------
        object_index : (n,) int array
            Index of each pair's object among all objects of the scene.
        light : tuple of three float arrays
            Coordinates x, y and z of each pair's light, in scene axes.  Their shape broadcasts
            with (n,).

        Returns
        -------
        side : int8 array
            `OUTSIDE`, `ON` (for spheres only) or `INSIDE`.  The array has the broadcast shape of
            (n,) and the lights.
        """
        tolerance = LIGHT_TOLERANCE * self.coordinate_size[self.objects.positions(object_index)]
        return side_of_surface(self.signed_distance(object_index, light), tolerance)

    def signed_distance(self, object_index: Ints, point: Triple) -> Floats:
        """Compute the signed distance of a point from an object, for n (object, point) pairs.

        Parameters
        ----------
        object_index : (n,) int array
            Index of each pair's object among all objects of the scene.
        point : tuple of three float arrays
            Coordinates x, y and z of each pair's point, in scene axes.  Their shape broadcasts
            with (n,).

        Returns
        -------
        distance : float array
            Distance of each point from the surface, negative inside.  For boxes, this is the
            largest signed distance from the planes of the six faces; for points outside, it may be
            less than the distance from the box.  The array has the broadcast shape of (n,) and the
            points.
        """
        sphere_index = self.objects.positions(object_index)
        to_center = map3(np.subtract, take3(self.center, sphere_index), point)
        return np.sqrt(dot(to_center, to_center)) - self.radius[sphere_index]

    def occludes(
        self,
        object_index: Ints,
        hit: Triple,
        light: Triple,
        side: Sides,
        growth: Floats | None = None,
    ) -> Bools:
        """Test, for n (object, segment) pairs, whether the object blocks the segment.

        Segments lead from hits to lights.  A segment is blocked if it crosses the surface of the
        object strictly between its own ends.  An end within the rounding error of the surface is
        treated as on the surface.  If a hit is on a sphere, the segment starts on the eye's side of
        the sphere.

        Parameters
        ----------
        object_index : (n,) int array
            Index of each pair's object among all objects of the scene.
        hit, light : tuples of three (n,) float arrays
            Coordinates x, y and z of the two ends of each segment, in scene axes.
        side : (n,) int8 array
            The side of the object's surface on which the light lies: `OUTSIDE`, `ON` or `INSIDE`,
            from `side_of_light`.
        growth : (n,) float array, optional
            Distance by which the object is grown before the test; negative to shrink it.  An object
            that shrinks to nothing blocks nothing.

        Returns
        -------
        blocked : (n,) bool array
            Whether the object blocks the segment.
        """
        sphere_index = self.objects.positions(object_index)
        to_light = map3(np.subtract, light, hit)
        to_center = map3(np.subtract, take3(self.center, sphere_index), hit)
        radius = self.radius[sphere_index]
        if growth is not None:
            radius = np.maximum(radius + growth, 0)
        # If both ends are outside, the segment is blocked if its line comes closest to the centre
        # between the ends and inside the sphere.
        projection, length2 = dot(to_center, to_light), dot(to_light, to_light)
        closest_t = projection / length2
        perpendicular = map3(lambda center, step: center - closest_t * step, to_center, to_light)
        is_line_cut = dot(perpendicular, perpendicular) < radius * radius
        blocked: Bools = is_line_cut & (projection > 0) & (projection < length2)
        hit_height = np.sqrt(dot(to_center, to_center)) - radius
        tolerance = hit_tolerance(self.coordinate_size[sphere_index], hit, self.frame.eye)
        hit_side = side_of_surface(hit_height, tolerance)
        # If an end is on the surface or inside the sphere, the sides of both ends decide.
        special_index = indices((hit_side != OUTSIDE) | (side != OUTSIDE))
        if special_index.size:
            hit_side, side = hit_side[special_index], side[special_index]
            projection, length2 = projection[special_index], length2[special_index]
            is_eye_inside = self.is_eye_inside[sphere_index[special_index]]
            leaves_sphere = (projection < 0) | (side == OUTSIDE)
            blocks_from_surface = np.where(is_eye_inside, leaves_sphere, projection > 0)
            blocks_to_surface = (hit_side == OUTSIDE) & (projection < length2)
            blocks_otherwise = np.where(side == ON, blocks_to_surface, hit_side != side)
            blocked[special_index] = np.where(hit_side == ON, blocks_from_surface, blocks_otherwise)
        return blocked

    def test_capsules(
        self, object_index: Ints, start: Triple, end: Triple, thickness: Floats
    ) -> tuple[Bools, Bools]:
        """Test whether an object may block some segments in a capsule, and whether it blocks all.

        A capsule consists of all points within a given distance of its axis, the segment from
        `start` to `end` (Haines and Wallace, Shaft culling, 1991).  It contains all segments from
        the ball around `start` to `end`.  Here, *segments* are these segments only.

        1. The object blocks no segment if it does not meet the capsule, or if the capsule lies
           entirely inside the object.
        2. The object blocks all segments if it contains a whole cross-section of the capsule, and
           the ball around `start` is outside the object.

        Both tests are conservative: rounding errors are on the safe side.

        Parameters
        ----------
        object_index : (n,) int array
            Index, among all objects of the scene, of the object to test with each capsule.
        start, end : tuples of three (n,) float arrays
            Coordinates x, y and z of the two ends of each capsule's axis, in scene axes.
        thickness : (n,) float array
            Radius of each capsule.

        Returns
        -------
        may_block : (n,) bool array
            False only if the object certainly blocks no segment.
        blocks_all : (n,) bool array
            True only if the object certainly blocks all segments.
        """
        sphere_index = self.objects.positions(object_index)
        center, radius = take3(self.center, sphere_index), self.radius[sphere_index]
        axis = map3(np.subtract, end, start)
        to_center = map3(np.subtract, center, start)
        projection, length2 = dot(to_center, axis), dot(axis, axis)
        start_distance2 = dot(to_center, to_center)
        end_distance2 = start_distance2 - 2 * projection + length2
        # Squared distance of the centre from the line that contains the axis.
        line_distance2 = start_distance2 - projection * projection / length2
        # Bound on the rounding errors of squared distances.
        square_error = SQUARE_ROUNDING * start_distance2
        outer_radius2 = (radius + thickness) ** 2 + square_error
        inner_radius2 = np.maximum(radius - thickness, 0) ** 2 - square_error
        starts_outside = start_distance2 > outer_radius2
        ends_outside = end_distance2 > outer_radius2
        # Whether the sphere's centre lies before the start of the axis, or past its end.
        is_before, is_past_end = projection < 0, projection > length2
        contains_capsule = np.maximum(start_distance2, end_distance2) < inner_radius2
        # If the axis is a single point, `line_distance2` is NaN, and `blocks_all` is False.
        is_off_line = line_distance2 > outer_radius2
        misses = is_off_line | (starts_outside & is_before) | (ends_outside & is_past_end)
        may_block = ~(misses | contains_capsule)
        blocks_all = starts_outside & ~(is_before | is_past_end) & (line_distance2 < inner_radius2)
        return may_block, blocks_all


def _tangent_slopes(
    right: Floats, ahead: Floats, disc_radius2: Floats, power: Floats
) -> tuple[Floats, Floats]:
    """Compute the slopes of the two rays from the origin that touch each of n discs in a plane.

    The slope of a ray in the direction (right, ahead) is right / ahead.

    Parameters
    ----------
    right, ahead : (n,) float arrays
        Coordinates of the centre of each disc.
    disc_radius2 : (n,) float array
        Squared radius of each disc; negative or NaN if there is no disc.
    power : (n,) float array
        right^2 + ahead^2 - disc_radius2 for each disc: negative if the origin is inside the disc.

    Returns
    -------
    low, high : (n,) float arrays
        A ray with ahead > 0 meets the disc if its slope is between these; NaN if there is no disc.
    """
    # The tangents make equal angles with the direction of the centre.  If the origin is inside the
    # disc, all rays meet the disc.  If it is within rounding errors of the border of the disc, half
    # of the rays meet the disc.
    power_bound = np.maximum(power - MIN_POWER * (right * right + ahead * ahead), 0)
    half_angle = np.arctan2(np.sqrt(disc_radius2), np.sqrt(power_bound))
    center_angle = np.arctan2(right, ahead)
    half_angle[power < 0] = np.inf
    angle = np.array([center_angle - half_angle, center_angle + half_angle])
    angle = angle.clip(-np.pi / 2, np.pi / 2)
    # The computed tangent of pi / 2 is 1.6e16, but the slopes of rays may be larger.
    low, high = np.where(abs(angle) < np.pi / 2, np.tan(angle), np.copysign(np.inf, angle))
    return low, high
