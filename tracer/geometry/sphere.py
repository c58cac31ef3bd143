"""Spheres: see `shape` for what the methods promise.

In this module, `sphere_index` numbers the spheres.  The *power* of the eye with respect to a sphere
is |centre - eye|^2 - radius^2: positive if the eye is outside, and 0 if it is on the sphere.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated as Shaped
from typing import ClassVar, NamedTuple

import numpy as np

from tracer.arrays import (
    Bools,
    Floats,
    Ints,
    Sides,
    Triple,
    dot,
    find,
    map_xyz,
    repeat_runs,
    scale,
    take,
)
from tracer.geometry.camera import CameraFrame
from tracer.geometry.numbering import get_object_range
from tracer.geometry.rounding import (
    MIN_POWER,
    ON,
    OUTSIDE,
    SQUARE_ROUNDING,
    UNIT_TOLERANCE,
    compute_hit_tolerance,
    determine_side,
)
from tracer.geometry.screen_bounds import ScreenBounds
from tracer.geometry.shape import NO_AXIS, Shape, SilhouetteEdges, TangentPlanes
from tracer.geometry.silhouette import compute_miss_angles
from tracer.scene.model import Sphere, Surfaces


class _Discs(NamedTuple):
    """The discs that planes through the eye cut from spheres.

    The rays of a row of the picture lie in such a plane.  A point in it has a rightward and a
    forward coordinate, relative to the eye.
    """

    center_right: Shaped[Floats, "n"]
    center_ahead: Shaped[Floats, "n"]
    squared_radius: Shaped[Floats, "n"]  # negative if the plane misses the sphere
    ray_ahead: Shaped[Floats, "n"]  # forward component of the directions of all rays in the plane


@dataclass(frozen=True, eq=False, kw_only=True)
class Spheres(Shape):
    """The spheres of a scene."""

    planar_axes: ClassVar = ()
    has_curved_face: ClassVar = True

    center: Shaped[Floats, "3 objects"]  # in scene axes
    radius: Shaped[Floats, "objects"]
    from_eye: Shaped[Triple, "objects"]  # vectors from the eye to the centres, in camera axes
    power: Shaped[Floats, "objects"]  # power of the eye with respect to the sphere

    @classmethod
    def from_surfaces(cls, frame: CameraFrame, surfaces: Surfaces) -> Spheres:
        table = surfaces.tables[Sphere]
        center, radius = table["center"].T.copy(), table["radius"]
        from_eye = frame.point_to_camera(table["center"])
        distance = np.sqrt(dot(from_eye, from_eye))
        eye_height = distance - radius
        # If the eye lies on a sphere, rounding errors must not move it off the sphere.
        is_eye_on_sphere = np.abs(eye_height) <= UNIT_TOLERANCE * radius
        power = np.where(is_eye_on_sphere, 0, eye_height * (distance + radius))
        return cls(
            frame=frame,
            objects=get_object_range(surfaces, Sphere),
            center=center,
            radius=radius,
            from_eye=from_eye,
            power=power,
            bounds=_find_screen_bounds(frame, from_eye, radius),
            is_eye_inside=power <= 0,
            curvature=1 / radius,
            coordinate_bound=np.abs(center).sum(axis=0) + radius,
        )

    def compute_bounding_boxes(
        self,
    ) -> tuple[Shaped[Floats, "3 objects"], Shaped[Floats, "3 objects"]]:
        return self.center - self.radius, self.center + self.radius

    # Intersections with rays from the eye.

    def find_x_range(
        self, object_index: Shaped[Ints, "n"], top: Shaped[Floats, "n"], height: float
    ) -> tuple[Shaped[Floats, "n"], Shaped[Floats, "n"]]:
        # If a ray of the band meets the sphere, then a ray through the centre line of the band
        # meets the sphere grown by the distance between the two rays.
        frame = self.frame
        sphere_index = self.objects.to_local(object_index)
        radius = self.radius[sphere_index]
        slope_margin = 0.5 * height * frame.pixel_height / frame.depth
        max_depth = np.maximum(self.from_eye[2][sphere_index] + radius, 0)
        grown_radius = radius + slope_margin * max_depth
        # The power of the eye is the same with respect to the disc in any plane through the eye.
        power = self.power[sphere_index] - (grown_radius - radius) * (grown_radius + radius)
        discs = self._cut_discs(sphere_index, grown_radius, frame.to_ray_y(top + height / 2))
        min_slope, max_slope = _find_slope_range(
            discs.center_right, discs.center_ahead, discs.squared_radius, power
        )
        left = frame.to_picture_x(min_slope * discs.ray_ahead)
        right = frame.to_picture_x(max_slope * discs.ray_ahead)
        return left, right

    def _cut_discs(
        self,
        sphere_index: Shaped[Ints, "n"],
        radius: Shaped[Floats, "n"],
        ray_y: Shaped[Floats, "n"],
    ) -> _Discs:
        """Compute the disc that the plane of all rays with the given `ray_y` cuts from each sphere.

        The spheres have the given radius, which may differ from `self.radius`.
        """
        right, down, ahead = take(self.from_eye, sphere_index)
        depth = self.frame.depth
        ray_ahead = np.sqrt(ray_y * ray_y + depth * depth)
        plane_distance = (down * depth - ahead * ray_y) / ray_ahead
        return _Discs(
            center_right=right,
            center_ahead=(down * ray_y + ahead * depth) / ray_ahead,
            squared_radius=(radius - plane_distance) * (radius + plane_distance),
            ray_ahead=ray_ahead,
        )

    def intersect(
        self,
        object_index: Shaped[Ints, "spans"],
        ray_y: Shaped[Floats, "spans"],
        ray_x: Shaped[Floats, "n"],
        ray_count: Shaped[Ints, "spans"] | None,
    ) -> tuple[Shaped[Floats, "n"], Shaped[Floats, "n"]]:
        """See `Shape.intersect`.

        The second result, `radial_dot`, is the absolute dot product of the direction of the ray and
        the vector from the centre to the hit.
        """
        sphere_index = self.objects.to_local(object_index)
        discs = self._cut_discs(sphere_index, self.radius[sphere_index], ray_y)
        depth = self.frame.depth
        squared_length = ray_x * ray_x + repeat_runs(ray_y * ray_y + depth * depth, ray_count)
        # The point t d of the ray is on the sphere with the centre c if |t d - c|^2 = radius^2.
        # With A = `squared_length`, B = `dot_product` and C = `power`, this is the equation
        # A t^2 - 2 B t + C = 0.  The nearer root is C / (B + sqrt(B^2 - A C)).  For precision, the
        # square root is computed from the disc in the plane of the span (Haines, Günther and
        # Akenine-Möller, Precision improvements for ray/sphere intersection, Ray Tracing Gems,
        # ch. 7).
        cross_product = repeat_runs(discs.center_right * discs.ray_ahead, ray_count)
        cross_product -= repeat_runs(discs.center_ahead, ray_count) * ray_x
        radial_dot = np.sqrt(
            squared_length * repeat_runs(discs.squared_radius, ray_count) - cross_product**2
        )
        dot_product = repeat_runs(discs.center_right, ray_count) * ray_x
        dot_product += repeat_runs(discs.center_ahead * discs.ray_ahead, ray_count)
        divisor = dot_product + radial_dot
        power = self.power[sphere_index]
        is_eye_outside_all = np.all(power > 0)
        power = repeat_runs(power, ray_count)
        t = power / divisor
        if not is_eye_outside_all:  # the farther root, in the form with less cancellation
            far_t = np.where(
                dot_product > 0, divisor / squared_length, power / (dot_product - radial_dot)
            )
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
    ) -> TangentPlanes:
        sphere_index = self.objects.to_local(object_index)
        # If the eye is inside, the normal that faces it points to the centre.
        side_sign = np.where(self.is_eye_inside[sphere_index], -1.0, 1.0)
        signed_curvature = repeat_runs(1 / (side_sign * self.radius[sphere_index]), run_length)
        centers = (repeat_runs(component[sphere_index], run_length) for component in self.from_eye)
        components = zip(to_hit, centers, strict=True)
        right, down, ahead = ((point - center) * signed_curvature for point, center in components)
        no_number = np.full(sphere_index.size, np.nan)
        return TangentPlanes(
            normal=(right, down, ahead),
            eye_height=radial_dot * np.abs(signed_curvature) * t,
            face_axis=np.full(sphere_index.size, NO_AXIS),
            normal_sign=no_number,
            face_position=no_number,
        )

    def are_rows_bounded_by_ends(self) -> bool:
        # From outside, the hits of a row lie on an arc of less than half a circle.
        return not self.is_eye_inside.any()

    # Tests of shadow segments.

    def measure_distance(
        self, object_index: Shaped[Ints, "n"], point: Shaped[Triple, "... #n"]
    ) -> Shaped[Floats, "... n"]:
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
        """See `Shape.occludes`.

        If the hit is on the sphere, its segment to the light starts on the eye's side of the
        surface.
        """
        sphere_index = self.objects.to_local(object_index)
        to_light = map_xyz(np.subtract, light, hit)
        to_center = map_xyz(np.subtract, take(self.center, sphere_index), hit)
        radius = self.radius[sphere_index]
        if growth is not None:
            radius = np.maximum(radius + growth, 0)
        # If both ends are outside, consider the point of the segment's line that is closest to the
        # centre.  The segment is blocked if this point is inside the sphere and between the ends.
        projection = dot(to_center, to_light)
        squared_length = dot(to_light, to_light)
        closest_t = projection / squared_length
        from_line = map_xyz(lambda center, light: center - closest_t * light, to_center, to_light)
        is_line_cut = dot(from_line, from_line) < radius * radius
        occludes: Bools = is_line_cut & (projection > 0) & (projection < squared_length)
        # If an end is on the surface or inside the sphere, the sides of both ends decide.
        hit_height = np.sqrt(dot(to_center, to_center)) - radius
        tolerance = compute_hit_tolerance(self.coordinate_bound[sphere_index], hit, self.frame.eye)
        hit_side = determine_side(hit_height, tolerance)
        touch_index = find((hit_side != OUTSIDE) | (light_side != OUTSIDE))
        if touch_index.size:
            occludes[touch_index] = _decide_by_sides(
                hit_side=hit_side[touch_index],
                light_side=light_side[touch_index],
                projection=projection[touch_index],
                squared_length=squared_length[touch_index],
                is_eye_inside=self.is_eye_inside[sphere_index[touch_index]],
            )
        return occludes

    def test_capsules(
        self,
        object_index: Shaped[Ints, "n"],
        axis_start: Shaped[Triple, "n"],
        axis_end: Shaped[Triple, "n"],
        capsule_radius: Shaped[Floats, "n"],
    ) -> tuple[Shaped[Bools, "n"], Shaped[Bools, "n"]]:
        sphere_index = self.objects.to_local(object_index)
        center, radius = take(self.center, sphere_index), self.radius[sphere_index]
        axis = map_xyz(np.subtract, axis_end, axis_start)
        to_center = map_xyz(np.subtract, center, axis_start)
        projection = dot(to_center, axis)
        squared_length = dot(axis, axis)
        squared_start_distance = dot(to_center, to_center)
        squared_end_distance = squared_start_distance - 2 * projection + squared_length
        # Distance of the centre from the line that contains the axis.
        squared_line_distance = squared_start_distance - projection * projection / squared_length
        # Bound on the rounding errors of squared distances.
        square_error = SQUARE_ROUNDING * squared_start_distance
        squared_outer_radius = (radius + capsule_radius) ** 2 + square_error
        squared_inner_radius = np.maximum(radius - capsule_radius, 0) ** 2 - square_error
        starts_outside = squared_start_distance > squared_outer_radius
        ends_outside = squared_end_distance > squared_outer_radius
        # Whether the centre projects to a point before the start of the axis, or past its end.
        is_before_start = projection < 0
        is_past_end = projection > squared_length
        contains_capsule = (
            np.maximum(squared_start_distance, squared_end_distance) < squared_inner_radius
        )
        # If the axis is a single point, `squared_line_distance` is NaN, and `blocks_all` is False.
        misses_line = squared_line_distance > squared_outer_radius
        cuts_line = squared_line_distance < squared_inner_radius
        misses = misses_line | (starts_outside & is_before_start) | (ends_outside & is_past_end)
        may_block = ~(misses | contains_capsule)
        blocks_all = starts_outside & ~(is_before_start | is_past_end) & cuts_line
        return may_block, blocks_all

    # Edges.

    def find_silhouettes(
        self,
        object_index: Shaped[Ints, "n"],
        viewpoint: Shaped[Floats, "3 n"],
        ray: Shaped[Triple, "#6 n"],
    ) -> SilhouetteEdges:
        sphere_index = self.objects.to_local(object_index)
        eye_to_viewpoint = self.frame.point_to_camera(viewpoint.T)
        center = map_xyz(np.subtract, take(self.from_eye, sphere_index), eye_to_viewpoint)
        miss_angle = compute_miss_angles(ray, center, self.radius[sphere_index])
        return SilhouetteEdges(item_index=np.arange(sphere_index.size), values=miss_angle)

    def compute_inverse_t(
        self, face_code: int, object_index: Shaped[Ints, "n"], ray: Shaped[Triple, "#m n"]
    ) -> Shaped[Floats, "m n"]:
        """See `Shape.compute_inverse_t`.

        A ray d meets the sphere with the centre C at t d, where 1 / t = k . d + sqrt((k . d)^2 -
        w d^2).  Here, k = C / P, w = 1 / P, and P is the power of the eye.  This is the near
        intersection or, if the eye is inside (P < 0), the far one.  For a ray that misses the
        sphere, the square root is left out.
        """
        sphere_index = self.objects.to_local(object_index)
        power, center = self.power[sphere_index], take(self.from_eye, sphere_index)
        squared_length = dot(ray, ray)
        k = map_xyz(lambda component: component / power, center)
        k_dot_ray = dot(k, ray)
        radicand = k_dot_ray**2 - 1 / power * squared_length
        inverse_t = k_dot_ray + np.sqrt(np.maximum(radicand, 0))
        if not power.all():
            # If the eye is on the sphere, the ray leaves it where 1 / t = d^2 / (2 C . d).
            inverse_t = np.where(power == 0, squared_length / (2 * dot(center, ray)), inverse_t)
        return inverse_t

    def compute_normals(
        self,
        object_index: Shaped[Ints, "n"],
        ray: Shaped[Triple, "#m n"],
        inverse_t: Shaped[Floats, "m n"],
    ) -> Shaped[Triple, "m n"]:
        # The result is the vector from the centre to the point t * ray, divided by t.
        center = take(self.from_eye, self.objects.to_local(object_index))
        return map_xyz(np.subtract, ray, scale(center, inverse_t))

    def compute_footprint_radii(
        self,
        object_index: Shaped[Ints, "runs"],
        run_length: Shaped[Ints, "runs"],
        cell_radius: Shaped[Floats, "n"],
        cosine: Shaped[Floats, "n"],
        cell_angle: float,
    ) -> Shaped[Floats, "n"]:
        # A strip of width r inside the silhouette of a sphere of radius R shows a part of the
        # sphere that extends sqrt(R^2 - (R - r)^2) in depth.  By Pythagoras, it is sqrt(2 r R)
        # wide.
        curvature = repeat_runs(self.curvature[self.objects.to_local(object_index)], run_length)
        max_width = np.sqrt(2 * cell_radius / curvature)
        return np.asarray(np.fmin(cell_radius / cosine, max_width))


def _decide_by_sides(
    hit_side: Shaped[Sides, "n"],
    light_side: Shaped[Sides, "n"],
    projection: Shaped[Floats, "n"],
    squared_length: Shaped[Floats, "n"],
    is_eye_inside: Shaped[Bools, "n"],
) -> Shaped[Bools, "n"]:
    """Decide whether spheres block segments of which an end is inside or on the sphere.

    Each segment leads from a hit to a light.

    Parameters
    ----------
    hit_side, light_side
        On which side of the sphere the ends of the segment are: `OUTSIDE`, `ON` or `INSIDE`.
    projection
        Dot product of the vectors from the hit to the centre of the sphere and to the light.
    squared_length
        Dot product of the vector from the hit to the light with itself.
    """
    # A hit on the surface lies on the eye's side.  From inside, the segment must not leave the
    # sphere; from outside, it must not enter the sphere.
    leaves_sphere = (projection < 0) | (light_side == OUTSIDE)
    blocks_from_surface = np.where(is_eye_inside, leaves_sphere, projection > 0)
    # A segment to a light on the surface is blocked if it arrives from inside.
    arrives_from_inside = projection < squared_length
    blocks_to_surface = (hit_side == OUTSIDE) & arrives_from_inside
    return np.select(
        [hit_side == ON, light_side == ON],
        [blocks_from_surface, blocks_to_surface],
        default=hit_side != light_side,
    )


def _find_screen_bounds(
    frame: CameraFrame, center: Shaped[Triple, "n"], radius: Shaped[Floats, "n"]
) -> ScreenBounds:
    """Compute the bounding rectangle of each sphere in the picture.

    The centres are vectors from the eye, in camera axes.
    """
    right, down, ahead = center
    squared_radius = radius * radius
    # Projected along an axis of the camera, a sphere is a disc.
    x_power = right * right + ahead * ahead - squared_radius
    y_power = down * down + ahead * ahead - squared_radius
    x_slopes = _find_slope_range(right, ahead, squared_radius, x_power)
    y_slopes = _find_slope_range(down, ahead, squared_radius, y_power)
    return ScreenBounds.from_slopes(frame, y_slopes, x_slopes)


def _find_slope_range(
    center_right: Shaped[Floats, "n"],
    center_ahead: Shaped[Floats, "n"],
    squared_radius: Shaped[Floats, "n"],
    power: Shaped[Floats, "n"],
) -> tuple[Shaped[Floats, "n"], Shaped[Floats, "n"]]:
    """Compute the smallest and the largest slope of rays that point ahead and meet each disc.

    The slope is right / ahead.  It is infinite if the ray points straight to the right or to the
    left.  It is NaN if `squared_radius` is negative or NaN, which means that there is no disc.
    `power` is the squared distance of the disc's centre from the eye, minus `squared_radius`.
    """
    # The rays with these slopes are the tangents from the eye.  Both make the same angle with the
    # direction of the centre: set to infinity if the eye is inside the disc, and to pi / 2 if the
    # eye is almost on its edge.
    squared_distance = center_right * center_right + center_ahead * center_ahead
    min_power = np.maximum(power - MIN_POWER * squared_distance, 0)
    half_angle = np.arctan2(np.sqrt(squared_radius), np.sqrt(min_power))
    center_angle = np.arctan2(center_right, center_ahead)
    half_angle[power < 0] = np.inf
    angle = np.array([center_angle - half_angle, center_angle + half_angle])
    angle = angle.clip(-np.pi / 2, np.pi / 2)
    # `np.tan` returns only 1.6e16 for pi / 2, but the slopes of rays may be larger.
    slope = np.where(abs(angle) >= np.pi / 2, np.copysign(np.inf, angle), np.tan(angle))
    return slope[0], slope[1]
