"""Spheres: intersections with rays from the eye, and tests of shadow segments.

`Boxes` has the same methods, which are documented here.  Their `object_index` numbers all objects
of the scene (see `ObjectRange`), while `sphere_index` numbers the spheres.

A ray starts at the eye and has the direction (ray_x, ray_y, depth) in camera axes (see
`CameraFrame`); the rays of one row of the picture have the same `ray_y`.  A *span* consists of rays
of one row that are tested with the same sphere.  A *shadow segment* leads from a hit to a light.
Points, and the ends of segments, are in scene axes.

The result for a pair of a ray and an object depends on this pair only.  It is the same to the last
bit whatever else the scene contains, and however pairs are arranged in batches.

Infinities and NaN are valid intermediate results, so callers turn off floating-point warnings.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated as Shaped
from typing import ClassVar, NamedTuple

import numpy as np

from tracer.arrays import Bools, Floats, Ints, Sides, Triple, dot, find, map_xyz, repeat_runs, take
from tracer.geometry.camera import CameraFrame, ScreenBounds
from tracer.geometry.numbering import ObjectRange, get_sphere_range
from tracer.geometry.rounding import (
    LIGHT_TOLERANCE,
    MIN_POWER,
    ON,
    OUTSIDE,
    SQUARE_ROUNDING,
    UNIT_TOLERANCE,
    compute_hit_tolerance,
    determine_side,
)
from tracer.scene.model import Surfaces

# Stands for the axis of a face (0, 1 or 2) at hits on spheres, which have no faces.
NO_FACE = 3


class _Discs(NamedTuple):
    """The discs that planes through the eye cut from spheres.

    A point in a plane has a rightward and a forward coordinate, relative to the eye.
    """

    center_right: Shaped[Floats, "n"]
    center_ahead: Shaped[Floats, "n"]
    radius2: Shaped[Floats, "n"]  # squared radius; negative if the plane misses the sphere
    ray_ahead: Shaped[Floats, "n"]  # forward component of rays in the plane


@dataclass(frozen=True, eq=False)
class Spheres:
    """The spheres of a scene, prepared for the rays of one camera."""

    is_planar: ClassVar = False  # whether objects of this shape consist of planar faces

    frame: CameraFrame
    objects: ObjectRange
    center: Shaped[Floats, "3 spheres"]  # in scene axes
    radius: Shaped[Floats, "spheres"]
    from_eye: Shaped[Triple, "spheres"]  # vectors from the eye to the centres, in camera axes
    # |centre - eye|^2 - radius^2: positive if the eye is outside, 0 if it is on the sphere.
    power: Shaped[Floats, "spheres"]
    bounds: ScreenBounds  # bounding rectangles in the picture
    is_eye_inside: Shaped[Bools, "spheres"]  # or on the surface
    curvature: Shaped[Floats, "spheres"]  # 1 / radius; 0 for planar shapes
    # Upper bound on |x| + |y| + |z| of all points of the object.  Rounding errors of points on the
    # surface are proportional to it.
    coordinate_bound: Shaped[Floats, "spheres"]

    @classmethod
    def from_surfaces(cls, frame: CameraFrame, surfaces: Surfaces) -> Spheres:
        """Extract the spheres of a scene, and precompute what rays of its camera need."""
        center, radius = surfaces.center.T.copy(), surfaces.radius
        from_eye = frame.point_to_camera(surfaces.center)
        distance = np.sqrt(dot(from_eye, from_eye))
        eye_height = distance - radius
        # If the eye lies on a sphere, rounding errors must not move it off the sphere.
        is_eye_on_sphere = np.abs(eye_height) <= UNIT_TOLERANCE * radius
        power = np.where(is_eye_on_sphere, 0, eye_height * (distance + radius))
        (right, down, ahead), radius2 = from_eye, radius * radius
        slopes = (
            _find_slope_range(offset, ahead, radius2, offset * offset + ahead * ahead - radius2)
            for offset in (down, right)
        )
        objects, coordinate_bound = get_sphere_range(surfaces), np.abs(center).sum(axis=0) + radius
        camera_data = from_eye, power, ScreenBounds.from_slopes(frame, *slopes), power <= 0
        return cls(frame, objects, center, radius, *camera_data, 1 / radius, coordinate_bound)

    def compute_bounding_boxes(
        self,
    ) -> tuple[Shaped[Floats, "3 spheres"], Shaped[Floats, "3 spheres"]]:
        """Compute the smallest and the largest coordinates of each sphere, in scene axes."""
        return self.center - self.radius, self.center + self.radius

    # Intersections with rays from the eye.

    def find_x_range(
        self, object_index: Shaped[Ints, "n"], top: Shaped[Floats, "n"], height: float
    ) -> tuple[Shaped[Floats, "n"], Shaped[Floats, "n"]]:
        """Find the smallest and largest x at which each sphere may appear in a row of the picture.

        The row of sphere i extends from y = top[i] to top[i] + height; with height 0, it is a line.
        Positions are in pixels from the upper left corner of the picture.  If the sphere does not
        appear in the row, then left > right or both are NaN.
        """
        # If a ray of the row meets the sphere, then a ray through the centre line of the row meets
        # the sphere grown by the distance between the two rays.
        frame, sphere_index = self.frame, self.objects.to_local(object_index)
        radius = self.radius[sphere_index]
        slope_margin = 0.5 * height * frame.pixel_height / frame.depth
        max_depth = np.maximum(self.from_eye[2][sphere_index] + radius, 0)
        grown_radius = radius + slope_margin * max_depth
        power = self.power[sphere_index] - (grown_radius - radius) * (grown_radius + radius)
        discs = self._cut_discs(sphere_index, grown_radius, frame.to_ray_y(top + height / 2))
        center_right, center_ahead, disc_radius2, ray_ahead = discs
        low_slope, high_slope = _find_slope_range(center_right, center_ahead, disc_radius2, power)
        return frame.to_picture_x(low_slope * ray_ahead), frame.to_picture_x(high_slope * ray_ahead)

    def _cut_discs(
        self,
        sphere_index: Shaped[Ints, "n"],
        radius: Shaped[Floats, "n"],
        ray_y: Shaped[Floats, "n"],
    ) -> _Discs:
        """Compute the disc that the plane of rays with this `ray_y` cuts from each sphere.

        The given radius replaces the sphere's own.
        """
        (center_right, down, forward), depth = take(self.from_eye, sphere_index), self.frame.depth
        ray_ahead = np.sqrt(ray_y * ray_y + depth * depth)
        plane_distance = (down * depth - forward * ray_y) / ray_ahead
        center_ahead = (down * ray_y + forward * depth) / ray_ahead
        disc_radius2 = (radius - plane_distance) * (radius + plane_distance)
        return _Discs(center_right, center_ahead, disc_radius2, ray_ahead)

    def intersect(
        self,
        object_index: Shaped[Ints, "spans"],
        ray_y: Shaped[Floats, "spans"],
        ray_x: Shaped[Floats, "n"],
        ray_count: Shaped[Ints, "spans"] | None,
    ) -> tuple[Shaped[Floats, "n"], Shaped[Floats, "n"]]:
        """Compute where rays from the eye hit spheres, span by span.

        Parameters
        ----------
        ray_count
            Number of rays in each span; None if each span has one ray.

        Returns
        -------
        t
            The ray hits the sphere at t times its direction; infinity if it misses.  If the eye is
            inside the sphere or on its surface, the hit is where the ray leaves.
        radial_dot
            Absolute dot product of the ray's direction and the vector from the centre to the hit.
        """
        sphere_index, depth = self.objects.to_local(object_index), self.frame.depth
        discs = self._cut_discs(sphere_index, self.radius[sphere_index], ray_y)
        center_right, center_ahead, disc_radius2, ray_ahead = discs
        length2 = repeat_runs(ray_y * ray_y + depth * depth, ray_count)
        length2 = ray_x * ray_x + length2
        # Solve A t^2 - 2 B t + C = 0 with A = `length2`, B = `dot_product` and C = `power`.  The
        # nearer root is C / (B + sqrt(B^2 - A C)).  For precision, the square root is computed from
        # the disc in the plane of the span (Haines, Günther and Akenine-Möller, Precision
        # improvements for ray/sphere intersection, Ray Tracing Gems, ch. 7).
        cross_product = repeat_runs(center_right * ray_ahead, ray_count)
        cross_product -= repeat_runs(center_ahead, ray_count) * ray_x
        radial_dot = np.sqrt(length2 * repeat_runs(disc_radius2, ray_count) - cross_product**2)
        dot_product = repeat_runs(center_right, ray_count) * ray_x
        dot_product += repeat_runs(center_ahead * ray_ahead, ray_count)
        divisor = dot_product + radial_dot
        power = self.power[sphere_index]
        is_eye_outside_all, power = np.all(power > 0), repeat_runs(power, ray_count)
        t = power / divisor
        if not is_eye_outside_all:  # the farther root, in the form with less cancellation
            far_t = np.where(dot_product > 0, divisor / length2, power / (dot_product - radial_dot))
            t = np.where(power > 0, t, far_t)
        # t is NaN if there is no root, and negative if the sphere is behind the eye.
        return np.where(t > 0, t, np.inf), radial_dot

    def compute_tangent_planes(
        self,
        object_index: Shaped[Ints, "runs"],
        run_length: Shaped[Ints, "runs"],
        to_hit: Shaped[Floats, "3 n"],
        t: Shaped[Floats, "n"],
        radial_dot: Shaped[Floats, "n"],
    ) -> tuple[
        Shaped[Ints, "runs"],
        Shaped[Floats, ""],
        Shaped[Floats, ""],
        Shaped[Triple, "n"],
        Shaped[Floats, "n"],
    ]:
        """Compute the last five fields of `ShapeHits`, which describe tangent planes at hits.

        A run consists of consecutive hits on the same sphere.  Pass the vectors from the eye to the
        hits, in camera axes, and the results of `intersect` for them.
        """
        sphere_index = self.objects.to_local(object_index)
        # If the eye is inside, the normal that faces it points to the centre.
        side_sign = np.where(self.is_eye_inside[sphere_index], -1.0, 1.0)
        signed_curvature = repeat_runs(1 / (side_sign * self.radius[sphere_index]), run_length)
        centers = (repeat_runs(component[sphere_index], run_length) for component in self.from_eye)
        components = zip(to_hit, centers, strict=True)
        right, down, ahead = ((point - center) * signed_curvature for point, center in components)
        face_axis = np.full(sphere_index.size, NO_FACE)
        eye_height = radial_dot * np.abs(signed_curvature) * t
        return face_axis, np.ones(()), np.zeros(()), (right, down, ahead), eye_height

    # Tests of shadow segments: segments from hits to lights.

    def find_light_side(
        self, object_index: Shaped[Ints, "n"], light: Shaped[Triple, "... #n"]
    ) -> Shaped[Sides, "... n"]:
        """Determine whether lights are `OUTSIDE`, `ON` or `INSIDE` spheres."""
        tolerance = LIGHT_TOLERANCE * self.coordinate_bound[self.objects.to_local(object_index)]
        return determine_side(self.measure_distance(object_index, light), tolerance)

    def measure_distance(
        self, object_index: Shaped[Ints, "n"], point: Shaped[Triple, "... #n"]
    ) -> Shaped[Floats, "... n"]:
        """Compute the distances of points from the surfaces of spheres; negative inside."""
        sphere_index = self.objects.to_local(object_index)
        to_center = map_xyz(np.subtract, take(self.center, sphere_index), point)
        return np.sqrt(dot(to_center, to_center)) - self.radius[sphere_index]

    def occludes(
        self,
        object_index: Shaped[Ints, "n"],
        hit: Shaped[Triple, "n"],
        light: Shaped[Triple, "n"],
        light_side: Shaped[Sides, "n"],
        growth: Shaped[Floats, "n"] | None = None,
    ) -> Shaped[Bools, "n"]:
        """Test whether each sphere blocks the segment from a hit to a light.

        A segment is blocked if it crosses the surface strictly between its ends.  Ends within
        rounding error of the surface count as on the surface.  If the hit is on the sphere, the
        segment starts on the eye's side of the surface.

        Parameters
        ----------
        light_side
            The result of `find_light_side`.
        growth
            Distance by which to grow the sphere before the test; negative to shrink it.  A sphere
            that shrinks to nothing blocks nothing.
        """
        sphere_index = self.objects.to_local(object_index)
        to_light = map_xyz(np.subtract, light, hit)
        to_center = map_xyz(np.subtract, take(self.center, sphere_index), hit)
        radius = self.radius[sphere_index]
        if growth is not None:
            radius = np.maximum(radius + growth, 0)
        # If both ends are outside, the segment is blocked if its line comes closest to the centre
        # inside the sphere and between the ends.
        projection, squared_length = dot(to_center, to_light), dot(to_light, to_light)
        closest_t = projection / squared_length
        from_line = map_xyz(lambda center, light: center - closest_t * light, to_center, to_light)
        is_line_cut = dot(from_line, from_line) < radius * radius
        occludes: Bools = is_line_cut & (projection > 0) & (projection < squared_length)
        hit_height = np.sqrt(dot(to_center, to_center)) - radius
        tolerance = compute_hit_tolerance(self.coordinate_bound[sphere_index], hit, self.frame.eye)
        hit_side = determine_side(hit_height, tolerance)
        # If an end is on the surface or inside the sphere, the sides of both ends decide.
        touch_index = find((hit_side != OUTSIDE) | (light_side != OUTSIDE))
        if touch_index.size:
            hit_side, light_side = hit_side[touch_index], light_side[touch_index]
            projection, squared_length = projection[touch_index], squared_length[touch_index]
            is_eye_inside = self.is_eye_inside[sphere_index[touch_index]]
            leaves_sphere = (projection < 0) | (light_side == OUTSIDE)
            blocks_from_surface = np.where(is_eye_inside, leaves_sphere, projection > 0)
            blocks_to_surface = (hit_side == OUTSIDE) & (projection < squared_length)
            blocks_elsewhere = np.where(light_side == ON, blocks_to_surface, hit_side != light_side)
            occludes[touch_index] = np.where(hit_side == ON, blocks_from_surface, blocks_elsewhere)
        return occludes

    def test_capsules(
        self,
        object_index: Shaped[Ints, "n"],
        axis_start: Shaped[Triple, "n"],
        axis_end: Shaped[Triple, "n"],
        capsule_radius: Shaped[Floats, "n"],
    ) -> tuple[Shaped[Bools, "n"], Shaped[Bools, "n"]]:
        """Test whether each sphere blocks some, or all, of the segments in a capsule.

        The segments start at most `capsule_radius` away from `axis_start`, and all end at
        `axis_end` (Haines and Wallace, Shaft culling, 1991).

        Returns
        -------
        may_block
            False only if the sphere certainly blocks no segment.
        blocks_all
            True only if the sphere certainly blocks all segments.
        """
        sphere_index = self.objects.to_local(object_index)
        center, radius = take(self.center, sphere_index), self.radius[sphere_index]
        axis = map_xyz(np.subtract, axis_end, axis_start)
        to_center = map_xyz(np.subtract, center, axis_start)
        projection, length2 = dot(to_center, axis), dot(axis, axis)
        start_distance2 = dot(to_center, to_center)
        end_distance2 = start_distance2 - 2 * projection + length2
        # Squared distance of the centre from the line that contains the axis.
        line_distance2 = start_distance2 - projection * projection / length2
        # Bound on the rounding errors of squared distances.
        square_error = SQUARE_ROUNDING * start_distance2
        outer_radius2 = (radius + capsule_radius) ** 2 + square_error
        inner_radius2 = np.maximum(radius - capsule_radius, 0) ** 2 - square_error
        starts_outside = start_distance2 > outer_radius2
        ends_outside = end_distance2 > outer_radius2
        # Whether the centre projects to a point before the start of the axis, or past its end.
        is_before_start, is_past_end = projection < 0, projection > length2
        contains_capsule = np.maximum(start_distance2, end_distance2) < inner_radius2
        # If the axis is a single point, `line_distance2` is NaN, and `blocks_all` is False.
        misses_line, cuts_line = line_distance2 > outer_radius2, line_distance2 < inner_radius2
        misses = misses_line | (starts_outside & is_before_start) | (ends_outside & is_past_end)
        may_block = ~(misses | contains_capsule)
        blocks_all = starts_outside & ~(is_before_start | is_past_end) & cuts_line
        return may_block, blocks_all


def _find_slope_range(
    center_right: Shaped[Floats, "n"],
    center_ahead: Shaped[Floats, "n"],
    disc_radius2: Shaped[Floats, "n"],
    power: Shaped[Floats, "n"],
) -> tuple[Shaped[Floats, "n"], Shaped[Floats, "n"]]:
    """Compute the slopes, right / ahead, of the two tangents from the origin to each disc.

    These are the smallest and the largest slope of rays that point ahead and meet the disc; NaN if
    there is no disc (`disc_radius2` < 0 or NaN).  `power` is the squared distance of the centre
    from the origin, minus `disc_radius2`: negative if the origin is inside the disc.
    """
    # Both tangents make the same angle with the direction of the centre.  This angle is set to
    # infinity if the origin is inside the disc, and to pi / 2 if it is almost on the disc's edge.
    center_distance2 = center_right * center_right + center_ahead * center_ahead
    min_power = np.maximum(power - MIN_POWER * center_distance2, 0)
    half_angle = np.arctan2(np.sqrt(disc_radius2), np.sqrt(min_power))
    center_angle = np.arctan2(center_right, center_ahead)
    half_angle[power < 0] = np.inf
    angle = np.array([center_angle - half_angle, center_angle + half_angle])
    angle = angle.clip(-np.pi / 2, np.pi / 2)
    # `np.tan` returns only 1.6e16 for pi / 2, but the slopes of rays may be larger.
    slope = np.where(abs(angle) < np.pi / 2, np.tan(angle), np.copysign(np.inf, angle))
    return slope[0], slope[1]
