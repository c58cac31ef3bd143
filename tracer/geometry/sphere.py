"""Spheres, as a `Shape`: where rays hit them, what they shade, and their outlines.

`discs` contains the geometry in planes through the eye, and `balls` tests whether spheres block
segments.  `shape` explains the common terms, and describes all methods in full.  In this module,
`sphere_index` numbers the spheres.  The *power* of the eye with respect to a sphere is
|center - eye|^2 - radius^2: positive if the eye is outside, and 0 if it is on the sphere.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated as Shaped
from typing import ClassVar

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
from tracer.geometry.balls import decide_by_sides, test_capsules_on_balls
from tracer.geometry.camera import CameraFrame
from tracer.geometry.discs import cut_discs, find_slope_range
from tracer.geometry.numbering import get_object_range
from tracer.geometry.rounding import (
    OUTSIDE,
    UNIT_TOLERANCE,
    compute_hit_tolerance,
    determine_side,
)
from tracer.geometry.screen_bounds import ScreenBounds
from tracer.geometry.shape import NO_AXIS, Shape, SilhouetteEdges, TangentPlanes
from tracer.geometry.silhouette import compute_miss_angles
from tracer.scene.model import Sphere, Surfaces


@dataclass(frozen=True, eq=False, kw_only=True)
class Spheres(Shape):
    """The spheres of a scene."""

    planar_axes: ClassVar = ()
    has_curved_face: ClassVar = True

    center: Shaped[Floats, "3 objects"]  # in scene axes
    radius: Shaped[Floats, "objects"]
    from_eye: Shaped[Triple, "objects"]  # vectors from the eye to the centers, in camera axes
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
        """Bound the x at which each sphere appears in a band (see `Shape.find_x_range`).

        If the sphere does not appear in its band, both bounds are NaN.
        """
        # If a ray of the band meets the sphere, then a ray through the center line of the band
        # meets the sphere grown by the distance between the two rays.
        frame = self.frame
        sphere_index = self.objects.to_local(object_index)
        center, radius = take(self.from_eye, sphere_index), self.radius[sphere_index]
        slope_margin = 0.5 * height * frame.pixel_height / frame.depth
        max_depth = np.maximum(center[2] + radius, 0)
        grown_radius = radius + slope_margin * max_depth
        # The power of the eye is the same with respect to the disc in any plane through the eye.
        power = self.power[sphere_index] - (grown_radius - radius) * (grown_radius + radius)
        discs = cut_discs(frame, center, grown_radius, frame.to_ray_y(top + height / 2))
        min_slope, max_slope = find_slope_range(
            discs.center_right, discs.center_ahead, discs.squared_radius, power
        )
        left = frame.to_picture_x(min_slope * discs.ray_ahead)
        right = frame.to_picture_x(max_slope * discs.ray_ahead)
        return left, right

    def intersect(
        self,
        object_index: Shaped[Ints, "spans"],
        ray_y: Shaped[Floats, "spans"],
        ray_x: Shaped[Floats, "n"],
        ray_count: Shaped[Ints, "spans"] | None,
    ) -> tuple[Shaped[Floats, "n"], Shaped[Floats, "n"]]:
        """Compute where rays from the eye hit spheres (see `Shape.intersect`).

        The second result, `radial_dot`, is the absolute dot product of the direction of the ray and
        the vector from the center to the hit; it is NaN if the ray misses.
        """
        sphere_index = self.objects.to_local(object_index)
        center, radius = take(self.from_eye, sphere_index), self.radius[sphere_index]
        discs = cut_discs(self.frame, center, radius, ray_y)
        depth = self.frame.depth
        squared_length = ray_x * ray_x + repeat_runs(ray_y * ray_y + depth * depth, ray_count)
        # The point t d of the ray is on the sphere with the center c if |t d - c|^2 = radius^2.
        # With A = `squared_length`, B = `dot_product` and C = `power`, this is the equation
        # A t^2 - 2 B t + C = 0.  The nearer root is C / (B + sqrt(B^2 - A C)).  The square root is
        # |A t - B| = |d . (t d - c)|, so it is also `radial_dot`.
        # For precision, it is computed in the plane of the span, where B^2 - A C = A r^2 - X^2 with
        # the radius r of the disc, and the cross product X of its center and d (Haines, Günther and
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
        """Compute the plane that touches the sphere at each hit.

        `t` and `radial_dot` are the results of `intersect` (see `Shape.compute_tangent_planes`).
        """
        sphere_index = self.objects.to_local(object_index)
        # If the eye is inside, the normal that faces it points to the center.
        side_sign = np.where(self.is_eye_inside[sphere_index], -1.0, 1.0)
        signed_curvature = repeat_runs(1 / (side_sign * self.radius[sphere_index]), run_length)
        centers = (repeat_runs(component[sphere_index], run_length) for component in self.from_eye)
        components = zip(to_hit, centers, strict=True)
        right, down, ahead = ((point - center) * signed_curvature for point, center in components)
        no_number = np.full(sphere_index.size, np.nan)
        return TangentPlanes(
            normal=(right, down, ahead),
            # This is |normal . to_hit|, because `to_hit` is t times the direction of the ray.
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
        """Compute the distance of each point from the surface; negative inside."""
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
        """Test whether each sphere blocks the segment from a hit to a light (see `Shape.occludes`).

        If the hit is on the sphere, its segment starts on the eye's side of the surface.
        """
        sphere_index = self.objects.to_local(object_index)
        to_light = map_xyz(np.subtract, light, hit)
        to_center = map_xyz(np.subtract, take(self.center, sphere_index), hit)
        radius = self.radius[sphere_index]
        if growth is not None:
            radius = np.maximum(radius + growth, 0)
        # If both ends are outside, consider the point of the segment's line that is closest to the
        # center.  The segment is blocked if this point is inside the sphere and between the ends.
        # On the line, `closest_t` is 0 at the hit and 1 at the light.
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
            occludes[touch_index] = decide_by_sides(
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
        """Test whether each sphere blocks some, or all, segments in a capsule.

        See `Shape.test_capsules`.
        """
        sphere_index = self.objects.to_local(object_index)
        center, radius = take(self.center, sphere_index), self.radius[sphere_index]
        return test_capsules_on_balls(center, radius, axis_start, axis_end, capsule_radius)

    # Edges.

    def find_silhouettes(
        self,
        object_index: Shaped[Ints, "n"],
        viewpoint: Shaped[Floats, "3 n"],
        ray: Shaped[Triple, "#6 n"],
    ) -> SilhouetteEdges:
        """Find the outline of each sphere, seen from a viewpoint, as one edge.

        The values are angles by which rays miss the sphere (see `Shape.find_silhouettes`).
        """
        sphere_index = self.objects.to_local(object_index)
        eye_to_viewpoint = self.frame.point_to_camera(viewpoint.T)
        center = map_xyz(np.subtract, take(self.from_eye, sphere_index), eye_to_viewpoint)
        miss_angle = compute_miss_angles(ray, center, self.radius[sphere_index])
        return SilhouetteEdges(item_index=np.arange(sphere_index.size), values=miss_angle)

    def compute_inverse_t(
        self, face_code: int, object_index: Shaped[Ints, "n"], ray: Shaped[Triple, "#m n"]
    ) -> Shaped[Floats, "m n"]:
        """Compute 1 / t of rays from the eye, where t * ray is on each sphere.

        It is the near intersection or, if the eye is inside, the far one (see
        `Shape.compute_inverse_t`).
        """
        # The point t d is on the sphere with the center C if t^2 d^2 - 2 t C . d + P = 0, where P
        # is the power of the eye.  With u = 1 / t, this is P u^2 - 2 u C . d + d^2 = 0.  A root is
        # u = k . d + sqrt((k . d)^2 - d^2 / P) with k = C / P.  It is the near intersection, or the
        # far one if P < 0.  If the ray misses, the square root is left out.
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
        """Compute outward normals where rays hit spheres (see `Shape.compute_normals`)."""
        # The result is the vector from the center to the point t * ray, divided by t.
        center = take(self.from_eye, self.objects.to_local(object_index))
        return map_xyz(np.subtract, ray, scale(center, inverse_t))


def _find_screen_bounds(
    frame: CameraFrame, center: Shaped[Triple, "n"], radius: Shaped[Floats, "n"]
) -> ScreenBounds:
    """Compute the bounding rectangle of each sphere in the picture.

    The centers are vectors from the eye, in camera axes.
    """
    right, down, ahead = center
    squared_radius = radius * radius
    # Projected along an axis of the camera, a sphere is a disc.  These are the powers of the eye
    # with respect to the discs.
    x_power = right * right + ahead * ahead - squared_radius
    y_power = down * down + ahead * ahead - squared_radius
    x_slopes = find_slope_range(right, ahead, squared_radius, x_power)
    y_slopes = find_slope_range(down, ahead, squared_radius, y_power)
    return ScreenBounds.from_slopes(frame, y_slopes, x_slopes)
