"""A kind of surface that only the tests know: upright cylinders, which have a curved face and caps.

It shows that the contract in `tracer.geometry.shape` is complete: no other module of the tracer
knows cylinders.  A cylinder in a plain renderer is compared with it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np

from reference.judges import plain
from tracer import Lambertian, Scene, Shader
from tracer.arrays import Bools, Floats, Ints, Sides, Triple, dot, find, map_xyz, repeat_runs
from tracer.geometry.box import _find_screen_bounds
from tracer.geometry.camera import CameraFrame
from tracer.geometry.numbering import get_object_range
from tracer.geometry.rounding import LIGHT_TOLERANCE, compute_hit_tolerance, determine_side
from tracer.geometry.shape import CURVED_FACE, NO_AXIS, Shape, SilhouetteEdges, TangentPlanes
from tracer.geometry.silhouette import bound_variation
from tracer.scene import schema
from tracer.scene.model import Surfaces
from tracer.scene.schema import Validated, tag_field

# Face codes of the two caps, by the sign of the normal that faces the eye.
CAPS = {2: -1.0, 3: 1.0}


@dataclass(frozen=True, slots=True, kw_only=True)
class Cylinder(Validated):
    """A cylinder whose axis is parallel to the y-axis."""

    center: Any = field(metadata=tag_field(schema.POINT, "center"))
    radius: float = field(metadata=tag_field(schema.LENGTH, "radius"))
    half_height: float = field(metadata=tag_field(schema.LENGTH, "halfHeight"))
    shader: Shader = field(default_factory=Lambertian)
    line: int | None = None

    @property
    def extent(self) -> Floats:
        return np.array([self.radius, self.half_height, self.radius])

    # The bounding box, from which the plain renderer knows the cylinder.
    @property
    def min_pt(self) -> Floats:
        return np.asarray(self.center - self.extent)

    @property
    def max_pt(self) -> Floats:
        return np.asarray(self.center + self.extent)


def add_cylinders(scene: Scene, *cylinders: Cylinder) -> Surfaces:
    """Return the surfaces of a scene and cylinders, which come last in the file."""
    old, count = scene.surfaces, len(scene.surfaces)
    names = "center", "radius", "half_height"
    table = {name: [getattr(each, name) for each in cylinders] for name in names}
    new_index = np.arange(len(cylinders))
    return Surfaces.from_tables(
        old.tables | {Cylinder: table},
        shader_index=np.append(old.shader_index, len(old.shaders) + new_index),
        file_index=np.append(old.file_index, count + new_index),
        shaders=(*old.shaders, *(each.shader for each in cylinders)),
        line=np.zeros(count + len(cylinders)),
    )


@dataclass(frozen=True, eq=False, kw_only=True)
class Cylinders(Shape):
    has_planar_faces: ClassVar = True
    has_curved_face: ClassVar = True

    center: Floats
    radius: Floats
    half_height: Floats
    from_eye: Floats  # (3, n), in scene axes

    @classmethod
    def from_surfaces(cls, frame: CameraFrame, surfaces: Surfaces) -> Cylinders:
        table = surfaces.tables[Cylinder]
        center, radius, half_height = (
            table["center"].T.copy(),
            table["radius"],
            table["half_height"],
        )
        from_eye, extent = center - frame.eye[:, None], np.array([radius, half_height, radius])
        is_eye_inside = np.hypot(from_eye[0], from_eye[2]) <= radius
        return cls(
            frame=frame,
            objects=get_object_range(surfaces, Cylinder),
            center=center,
            radius=radius,
            half_height=half_height,
            from_eye=from_eye,
            bounds=_find_screen_bounds(frame, from_eye - extent, from_eye + extent),
            is_eye_inside=is_eye_inside & (np.abs(from_eye[1]) <= half_height),
            curvature=1 / radius,
            coordinate_bound=(np.abs(center) + extent).sum(axis=0),
        )

    def compute_bounding_boxes(self) -> tuple[Floats, Floats]:
        extent = np.array([self.radius, self.half_height, self.radius])
        return self.center - extent, self.center + extent

    def _get_caps(self, index: Ints) -> tuple[Floats, Floats]:
        """Return y of the lower and the upper cap, relative to the eye."""
        (_, y, _), half_height = self.center[:, index], self.half_height[index]
        return y - half_height - self.frame.eye[1], y + half_height - self.frame.eye[1]

    def find_x_range(self, object_index: Ints, top: Floats, height: float) -> tuple[Floats, Floats]:
        index, frame = self.objects.to_local(object_index), self.frame
        if height:  # any bounds are allowed
            left, right = np.full((2, index.size), ([-np.inf], [np.inf]))
            return left, right
        (cx, _, cz), radius2 = self.from_eye[:, index], self.radius[index] ** 2
        low, high = self._get_caps(index)
        # A ray of the row has the direction a + x b.  Each condition is a quadratic equation for x.
        ray_y = frame.to_ray_y(top)
        a = frame.rotate_to_scene((np.zeros(top.size), ray_y, np.full(top.size, frame.depth)))
        b = frame.axes[0]
        side = _square(cx * a[2] - cz * a[0], cx * b[2] - cz * b[0])
        side -= radius2 * (_square(a[0], b[0]) + _square(a[2], b[2]))
        candidates = []
        for x in _solve(side):
            d = map_xyz(lambda u, v, x=x: u + x * v, a, (b[0], b[1], b[2]))
            t = (cx * d[0] + cz * d[2]) / (d[0] ** 2 + d[2] ** 2)
            candidates.append((x, (low <= t * d[1]) & (t * d[1] <= high) & (t > 0)))
        for y in (low, high):
            rim = _square(y * a[0] - cx * a[1], y * b[0] - cx * b[1])
            rim += _square(y * a[2] - cz * a[1], y * b[2] - cz * b[1])
            rim -= radius2 * _square(a[1], b[1])
            candidates += [(x, y / (a[1] + x * b[1]) > 0) for x in _solve(rim)]
        is_inside = self.is_eye_inside[index]
        left = np.min([np.where(is_valid, x, np.inf) for x, is_valid in candidates], axis=0)
        right = np.max([np.where(is_valid, x, -np.inf) for x, is_valid in candidates], axis=0)
        left, right = np.where(is_inside, -np.inf, left), np.where(is_inside, np.inf, right)
        return frame.to_picture_x(left), frame.to_picture_x(right)

    def intersect(
        self, object_index: Ints, ray_y: Floats, ray_x: Floats, ray_count: Ints | None
    ) -> tuple[Floats, Sides]:
        frame, index = self.frame, self.objects.to_local(object_index)
        right, down, ahead = frame.axes
        direction = tuple(
            ray_x * right[axis]
            + repeat_runs(ray_y * down[axis] + frame.depth * ahead[axis], ray_count)
            for axis in range(3)
        )
        index = repeat_runs(index, ray_count)
        spans = _find_spans(
            self.from_eye[:, index], direction, self.radius[index], self._get_caps(index)
        )
        (side_enter, side_leave), (cap_enter, cap_leave) = spans
        is_inside = self.is_eye_inside[index]
        enter, leave = np.maximum(side_enter, cap_enter), np.minimum(side_leave, cap_leave)
        t = np.where(is_inside, leave, enter)
        is_cap = t == np.where(is_inside, cap_leave, cap_enter)
        face_code = np.where(is_cap, np.where(direction[1] < 0, 3, 2), CURVED_FACE).astype(np.int8)
        return np.where(((enter <= leave) | is_inside) & (t > 0), t, np.inf), face_code

    def compute_tangent_planes(
        self, object_index: Ints, run_length: Ints, to_hit: Floats, t: Floats, face_code: Sides
    ) -> TangentPlanes:
        index = self.objects.to_local(object_index)
        run_code = face_code[run_length.cumsum() - run_length].astype(np.intp)
        is_cap, sign = run_code != CURVED_FACE, np.where(run_code == 3, 1.0, -1.0)
        side = np.where(self.is_eye_inside[index], -1.0, 1.0)
        low, high = self._get_caps(index)
        position = np.where(sign * side > 0, high, low) + self.frame.eye[1]
        hit_index, hit_sign, hit_cap = (each.repeat(run_length) for each in (index, sign, is_cap))
        x, _, z = self.frame.rotate_to_scene((to_hit[0], to_hit[1], to_hit[2]))
        cx, _, cz = self.from_eye[:, hit_index]
        scale = side.repeat(run_length) / self.radius[hit_index]
        normal = (x - cx) * scale, np.zeros(x.size), (z - cz) * scale
        normal = map_xyz(lambda u, v: np.where(hit_cap, v, u), normal, (0 * x, hit_sign, 0 * z))
        normal = self.frame.rotate_to_camera(normal)
        return TangentPlanes(
            normal=normal,
            eye_height=-dot(normal, (to_hit[0], to_hit[1], to_hit[2])),
            face_axis=np.where(is_cap, 1, NO_AXIS),
            normal_sign=np.where(is_cap, sign, np.nan),
            face_position=np.where(is_cap, position, np.nan),
        )

    def find_light_side(self, object_index: Ints, light: Triple) -> Sides:
        tolerance = LIGHT_TOLERANCE * self.coordinate_bound[self.objects.to_local(object_index)]
        return determine_side(self.measure_distance(object_index, light), tolerance)

    def measure_distance(self, object_index: Ints, point: Triple) -> Floats:
        index = self.objects.to_local(object_index)
        x, y, z = (p - c for p, c in zip(point, self.center[:, index], strict=True))
        return np.maximum(np.hypot(x, z) - self.radius[index], np.abs(y) - self.half_height[index])

    def occludes(
        self,
        object_index: Ints,
        hit: Triple,
        light: Triple,
        light_side: Sides,
        growth: Floats | None = None,
    ) -> Bools:
        index = self.objects.to_local(object_index)
        tolerance = compute_hit_tolerance(self.coordinate_bound[index], hit, self.frame.eye)
        enter, leave, is_real = self._cross(index, hit, light, 0.0 if growth is None else growth)
        margin = tolerance / np.sqrt(dot(*[map_xyz(np.subtract, light, hit)] * 2))
        is_between = [(t > margin) & (t < 1 - margin) for t in (enter, leave)]
        return is_real & (enter <= leave) & (is_between[0] | is_between[1])

    def test_capsules(
        self, object_index: Ints, axis_start: Triple, axis_end: Triple, capsule_radius: Floats
    ) -> tuple[Bools, Bools]:
        enter, leave, _ = self._cross(
            self.objects.to_local(object_index), axis_start, axis_end, capsule_radius
        )
        return (enter <= leave) & (leave >= 0) & (enter <= 1), np.zeros(enter.size, dtype=np.bool_)

    def _cross(
        self, index: Ints, start: Triple, end: Triple, growth: Floats | float
    ) -> tuple[Floats, Floats, Bools]:
        """Return where segments enter and leave grown cylinders, and which of these exist."""
        center = self.center[:, index] - np.array(start)
        radius, half_height = self.radius[index] + growth, self.half_height[index] + growth
        caps = center[1] - half_height, center[1] + half_height
        (side_enter, side_leave), (cap_enter, cap_leave) = _find_spans(
            center, map_xyz(np.subtract, end, start), radius, caps
        )
        is_real = (radius > 0) & (half_height > 0)
        return np.maximum(side_enter, cap_enter), np.minimum(side_leave, cap_leave), is_real

    def find_silhouettes(
        self, object_index: Ints, viewpoint: Floats, ray: Triple
    ) -> SilhouetteEdges:
        index, (dx, dy, dz) = self.objects.to_local(object_index), self.frame.rotate_to_scene(ray)
        (cx, cy, cz), radius = self.center[:, index] - viewpoint, self.radius[index]
        # Vertical edges: the angles between the ray and the tangents, seen from above.
        angle = np.arctan2(cx * dz - cz * dx, cx * dx + cz * dz)
        half_angle = np.arcsin(radius / np.hypot(cx, cz))
        values = [angle - half_angle, angle + half_angle]
        values += [
            (y * dx - cx * dy) ** 2 + (y * dz - cz * dy) ** 2 - (radius * dy) ** 2
            for y in (cy - self.half_height[index], cy + self.half_height[index])
        ]
        values = np.stack(np.broadcast_arrays(*values), axis=1)
        may_cross = ~(np.abs(values[0]) > bound_variation(values))
        is_above = (np.hypot(cx, cz) <= radius) & (np.abs(cy) > self.half_height[index])
        may_cross[:2] &= ~is_above
        return SilhouetteEdges(item_index=may_cross.nonzero()[1], values=values[:, may_cross])

    def compute_inverse_t(self, face_code: int, object_index: Ints, ray: Triple) -> Floats:
        index, (dx, dy, dz) = self.objects.to_local(object_index), self.frame.rotate_to_scene(ray)
        if face_code in CAPS:
            outward = np.where(self.is_eye_inside[index], -1, 1) * CAPS[face_code]
            low, high = self._get_caps(index)
            return dy / np.where(outward > 0, high, low)
        (cx, _, cz), radius = self.from_eye[:, index], self.radius[index]
        power = cx * cx + cz * cz - radius * radius
        k_d = (cx * dx + cz * dz) / power
        return k_d + np.sqrt(np.maximum(k_d**2 - (dx * dx + dz * dz) / power, 0))

    def compute_normals(self, object_index: Ints, ray: Triple, inverse_t: Floats) -> Triple:
        cx, _, cz = self.from_eye[:, self.objects.to_local(object_index)]
        dx, _, dz = self.frame.rotate_to_scene(ray)
        x, z = dx - cx * inverse_t, dz - cz * inverse_t
        return self.frame.rotate_to_camera((x, np.zeros(x.shape), z))

    def find_near_faces(
        self,
        object_index: Ints,
        run_length: Ints,
        face_axis: Ints,
        to_hit: Floats,
        max_distance: Floats,
    ) -> Iterator[tuple[int, Ints]]:
        index = self.objects.to_local(object_index).repeat(run_length)
        x, y, z = self.frame.rotate_to_scene((to_hit[0], to_hit[1], to_hit[2]))
        (cx, _, cz), is_side = self.from_eye[:, index], (face_axis == NO_AXIS).repeat(run_length)
        low, high = self._get_caps(index)
        is_inside = self.is_eye_inside[index]
        for face_code, sign in CAPS.items():
            cap = np.where(is_inside == (sign > 0), low, high)
            is_visible = is_inside | (sign * cap < 0)
            yield face_code, find(is_side & is_visible & (np.abs(y - cap) < max_distance))
        distance = np.abs(np.hypot(x - cx, z - cz) - self.radius[index])
        is_visible = is_inside | (np.hypot(cx, cz) > self.radius[index])
        yield CURVED_FACE, find(~is_side & is_visible & (distance < max_distance))


def _square(u: Floats, v: Floats) -> Floats:
    """Return the coefficients of the polynomial (u + x v)^2 = c + 2 b x + a x^2: c, b and a."""
    return np.array(np.broadcast_arrays(u * u, u * v, v * v))


def _solve(polynomial: Floats) -> tuple[Floats, Floats]:
    """Return the two roots of c + 2 b x + a x^2; NaN if there are none."""
    # Without this step, the eighth power of a length would overflow.
    c, b, a = polynomial / np.abs(polynomial).max(axis=0)
    q = -(b + np.copysign(np.sqrt(b * b - a * c), b))
    return q / a, c / q


def _find_spans(
    center: Floats, direction: Triple, radius: Floats, caps: tuple[Floats, Floats]
) -> list[tuple[Floats, Floats]]:
    """Return where rays enter and leave the infinite cylinders, and the slabs between the caps."""
    (cx, _, cz), (dx, dy, dz) = center, direction
    length2, projection = dx * dx + dz * dz, cx * dx + cz * dz
    root = np.sqrt(length2 * radius**2 - (cx * dz - cz * dx) ** 2)
    t_caps = caps[0] / dy, caps[1] / dy
    return [
        ((projection - root) / length2, (projection + root) / length2),
        (np.minimum(*t_caps), np.maximum(*t_caps)),
    ]


class PlainTracer(plain._PlainTracer):
    """The plain renderer, which knows each cylinder by its bounding box, with their formulas."""

    def compute_signed_distance(self, surface_index: int, points: Any) -> Any:
        if not isinstance(self.surfaces[surface_index], Cylinder):
            return super().compute_signed_distance(surface_index, points)
        center, extent = self.get_cylinder(surface_index)
        x, y, z = points - center
        return np.maximum(np.hypot(x, z) - extent[0], np.abs(y) - extent[1])

    def get_cylinder(self, surface_index: int) -> tuple[Any, Any]:
        low, high = self.shapes[surface_index]
        return (low + high) / 2, (high - low) / 2

    def intersect(self, surface_index: int, origin: Any, direction: Any, is_closed: bool) -> Any:
        near, far = super().intersect(surface_index, origin, direction, is_closed)
        if not isinstance(self.surfaces[surface_index], Cylinder):
            return near, far
        center, extent = self.get_cylinder(surface_index)
        (px, _, pz), (dx, _, dz) = origin - center, direction
        a, b, c = dx * dx + dz * dz, px * dx + pz * dz, px * px + pz * pz - extent[0] ** 2
        root = np.sqrt(b * b - a * c)
        return np.maximum(near, (-b - root) / a), np.minimum(far, (-b + root) / a)

    def project_onto_surface(self, surface_index: int, points: Any, direction: Any) -> Any:
        if not isinstance(self.surfaces[surface_index], Cylinder):
            return super().project_onto_surface(surface_index, points, direction)
        center, extent = self.get_cylinder(surface_index)
        x, y, z = (points - center) / extent
        side = np.array([x, 0 * y, z]) / np.hypot(x, z)
        is_side = np.hypot(x, z) - 1 > np.abs(y) - 1
        normals = np.where(is_side, side, np.array([0 * x, np.sign(y), 0 * z]))
        return points, -normals if self.is_eye_inside[surface_index] else normals
