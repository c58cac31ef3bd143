"""A kind of surface that only the tests know: upright cylinders, which have a curved face and caps.

`Cylinders` proves that the contract in `tracer.geometry.shape` is complete, because no module of
the tracer knows cylinders.  `PlainTracer` teaches them to the plain renderer, as a comparison.

A point is on the curved face if its distance from the axis, in the plane of x and z, is the radius.
It is on a cap if its y is that of the lower or of the upper end.  In the formulas, (cx, cz) is the
axis, and (dx, dy, dz) is the direction of a ray.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, ClassVar, NamedTuple

import numpy as np

from reference.judges import plain
from tracer import Lambertian, Scene, Shader
from tracer.arrays import Bools, Floats, Ints, Sides, Triple, dot, find, map_xyz, repeat_runs, take
from tracer.geometry.box import find_box_bounds
from tracer.geometry.camera import CameraFrame
from tracer.geometry.numbering import get_object_range
from tracer.geometry.rounding import compute_hit_tolerance
from tracer.geometry.shape import CURVED_FACE, NO_AXIS, Shape, SilhouetteEdges, TangentPlanes
from tracer.geometry.silhouette import bound_variation
from tracer.scene import schema
from tracer.scene.model import Surfaces
from tracer.scene.schema import Validated, tag_field


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

    # Corners of the bounding box, which is all that the plain renderer keeps of the cylinder.
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


class _Row(NamedTuple):
    """The rays through a row of the picture, one row for each of n objects, in scene axes.

    The ray at x has the direction start + x step, where x is `ray_x`.
    """

    start: Triple
    step: Floats  # (3,)

    def compute_direction(self, x: Floats) -> Triple:
        dx, dy, dz = (a + x * b for a, b in zip(self.start, self.step, strict=True))
        return dx, dy, dz


@dataclass(frozen=True, eq=False, kw_only=True)
class Cylinders(Shape):
    """The cylinders of a scene.  Vectors have the axes of the scene.

    `Shape` has the contract of each public method.
    """

    planar_axes: ClassVar = (1,)
    has_curved_face: ClassVar = True

    center: Floats
    radius: Floats
    from_eye: Floats  # (3, n) vectors to the centers
    # Corners of the bounding boxes.  Their y coordinates are those of the caps.
    min_pt: Floats
    max_pt: Floats

    @classmethod
    def from_surfaces(cls, frame: CameraFrame, surfaces: Surfaces) -> Cylinders:
        table = surfaces.tables[Cylinder]
        center, radius = table["center"].T.copy(), table["radius"]
        extent = np.array([radius, table["half_height"], radius])
        from_eye = center - frame.eye[:, None]
        is_between_caps = np.abs(from_eye[1]) <= extent[1]
        return cls(
            frame=frame,
            objects=get_object_range(surfaces, Cylinder),
            center=center,
            radius=radius,
            from_eye=from_eye,
            min_pt=center - extent,
            max_pt=center + extent,
            bounds=find_box_bounds(frame, from_eye - extent, from_eye + extent),
            is_eye_inside=is_between_caps & (np.hypot(from_eye[0], from_eye[2]) <= radius),
            curvature=1 / radius,
            coordinate_bound=(np.abs(center) + extent).sum(axis=0),
        )

    def compute_bounding_boxes(self) -> tuple[Floats, Floats]:
        return self.min_pt, self.max_pt

    def _get_caps(self, index: Ints, origin_y: Floats | float) -> tuple[Floats, Floats]:
        """Return the y coordinates of the lower and the upper cap, relative to an origin."""
        return self.min_pt[1, index] - origin_y, self.max_pt[1, index] - origin_y

    def find_x_range(self, object_index: Ints, top: Floats, height: float) -> tuple[Floats, Floats]:
        """Find the smallest and the largest x in the picture at which each cylinder may appear.

        The band of the picture from `top` to top + `height` is searched.  If the height is not 0,
        the result is from minus infinity to infinity, because any bounds are allowed.
        """
        index, frame = self.objects.to_local(object_index), self.frame
        if height:
            return np.full(index.size, -np.inf), np.full(index.size, np.inf)
        ray_y = frame.to_ray_y(top)
        start = frame.rotate_to_scene((np.zeros(top.size), ray_y, np.full(top.size, frame.depth)))
        row = _Row(start=start, step=frame.axes[0])
        ends = [*self._find_tangent_rays(index, row), *self._find_rim_rays(index, row)]
        x, is_visible = zip(*ends, strict=True)
        is_inside = self.is_eye_inside[index]
        left = np.where(is_visible, x, np.where(is_inside, -np.inf, np.inf)).min(axis=0)
        right = np.where(is_visible, x, np.where(is_inside, np.inf, -np.inf)).max(axis=0)
        return frame.to_picture_x(left), frame.to_picture_x(right)

    def _find_tangent_rays(self, index: Ints, row: _Row) -> Iterator[tuple[Floats, Bools]]:
        """Yield x of both rays of each row that touch the curved face, extended without end.

        Yield with each x whether the ray touches the face between the caps and ahead of the eye.
        """
        (cx, _, cz), squared_radius = self.from_eye[:, index], self.radius[index] ** 2
        low, high = self._get_caps(index, self.frame.eye[1])
        # Seen from above, the distance of the ray from the axis is the radius:
        # (cx dz - cz dx)^2 = radius^2 (dx^2 + dz^2).
        (ax, _, az), (bx, _, bz) = row
        polynomial = _square(cx * az - cz * ax, cx * bz - cz * bx)
        polynomial -= squared_radius * (_square(ax, bx) + _square(az, bz))
        for x in _solve(polynomial):
            dx, dy, dz = row.compute_direction(x)
            t = (cx * dx + cz * dz) / (dx * dx + dz * dz)
            yield x, (low <= t * dy) & (t * dy <= high) & (t > 0)

    def _find_rim_rays(self, index: Ints, row: _Row) -> Iterator[tuple[Floats, Bools]]:
        """Yield x of the two rays of each row that meet the rim of the lower, then the upper cap.

        Yield with each x whether the ray meets the rim ahead of the eye.
        """
        (cx, _, cz), squared_radius = self.from_eye[:, index], self.radius[index] ** 2
        (ax, ay, az), (bx, by, bz) = row
        for y in self._get_caps(index, self.frame.eye[1]):
            # The ray meets the plane of the cap at t = y / dy, at a distance of one radius from the
            # axis: (y dx - cx dy)^2 + (y dz - cz dy)^2 = radius^2 dy^2.
            polynomial = _square(y * ax - cx * ay, y * bx - cx * by)
            polynomial += _square(y * az - cz * ay, y * bz - cz * by)
            polynomial -= squared_radius * _square(ay, by)
            for x in _solve(polynomial):
                yield x, y / row.compute_direction(x)[1] > 0

    def intersect(
        self, object_index: Ints, ray_y: Floats, ray_x: Floats, ray_count: Ints | None
    ) -> tuple[Floats, Sides]:
        """Return, for each ray, t of its hit (infinity if it misses), and the code of the face.

        A cylinder is hit where the ray enters it or, if the eye is inside, where the ray leaves it.
        """
        index = repeat_runs(self.objects.to_local(object_index), ray_count)
        x, y, z = self.iterate_directions(ray_y, ray_x, ray_count)
        caps = self._get_caps(index, self.frame.eye[1])
        enter, leave = _cross_faces(self.from_eye[:, index], (x, y, z), self.radius[index], caps)
        is_inside = self.is_eye_inside[index]
        is_hit = (enter.max(axis=0) <= leave.min(axis=0)) | is_inside
        t = np.where(is_inside, leave.min(axis=0), enter.max(axis=0))
        is_cap = t == np.where(is_inside, leave[1], enter[1])
        face_code = np.where(is_cap, np.where(y < 0, 3, 2), CURVED_FACE).astype(np.int8)
        return np.where(is_hit & (t > 0), t, np.inf), face_code

    def compute_tangent_planes(
        self, object_index: Ints, run_length: Ints, to_hit: Floats, t: Floats, face_code: Sides
    ) -> TangentPlanes:
        """Return the planes that touch the cylinders at hits, on caps and on curved faces."""
        planes = super().compute_tangent_planes(object_index, run_length, to_hit, t, face_code)
        ray = to_hit[0], to_hit[1], to_hit[2]
        side = self.compute_normals(object_index.repeat(run_length), ray, np.ones(t.size))
        index = self.objects.to_local(object_index)
        scale = (np.where(self.is_eye_inside[index], -1, 1) / self.radius[index]).repeat(run_length)
        is_cap = face_code != CURVED_FACE
        cap = map_xyz(lambda component: component.repeat(run_length), planes.normal)
        normal = map_xyz(lambda u, v: np.where(is_cap, u, scale * v), cap, side)
        return planes._replace(normal=normal, eye_height=-dot(normal, ray))

    def measure_distance(self, object_index: Ints, point: Triple) -> Floats:
        """Return the distance of each point from a cylinder: negative inside, 0 on the surface.

        It is the largest of the signed distances from the curved face and the planes of the caps.
        """
        index = self.objects.to_local(object_index)
        x, _, z = map_xyz(np.subtract, point, take(self.center, index))
        low, high = self._get_caps(index, point[1])
        return np.maximum(np.hypot(x, z) - self.radius[index], np.maximum(low, -high))

    def occludes(
        self,
        object_index: Ints,
        hit: Triple,
        light: Triple,
        light_side: Sides,
        growth: Floats | None = None,
    ) -> Bools:
        """Test whether each cylinder, grown by `growth`, blocks the segment from a hit to a light.

        It does so if the segment enters or leaves it strictly between its ends.
        """
        index = self.objects.to_local(object_index)
        tolerance = compute_hit_tolerance(self.coordinate_bound[index], hit, self.frame.eye)
        low, high = self._get_caps(index, hit[1])
        radius = self.radius[index]
        if growth is not None:
            low, high, radius = low - growth, high + growth, radius + growth
        to_light = map_xyz(np.subtract, light, hit)
        center = self.center[:, index] - np.array(hit)
        enter_ts, leave_ts = _cross_faces(center, to_light, radius, (low, high))
        enter, leave = enter_ts.max(axis=0), leave_ts.min(axis=0)
        margin = tolerance / np.sqrt(dot(to_light, to_light))
        is_between = [(t > margin) & (t < 1 - margin) for t in (enter, leave)]
        return (radius > 0) & (low < high) & (enter <= leave) & (is_between[0] | is_between[1])

    def find_silhouettes(
        self, object_index: Ints, viewpoint: Floats, ray: Triple
    ) -> SilhouetteEdges:
        """Return the edges of outlines, seen from viewpoints, that rays may touch.

        They are two vertical lines on the curved face, and the two rims.
        """
        index, (dx, dy, dz) = self.objects.to_local(object_index), self.frame.rotate_to_scene(ray)
        (cx, _, cz), radius = self.center[:, index] - viewpoint, self.radius[index]
        low, high = self._get_caps(index, viewpoint[1])
        # Vertical edges: the angles between the ray and the tangents, seen from above.
        angle = np.arctan2(cx * dz - cz * dx, cx * dx + cz * dz)
        half_angle = np.arcsin(radius / np.hypot(cx, cz))
        rims = [
            (y * dx - cx * dy) ** 2 + (y * dz - cz * dy) ** 2 - (radius * dy) ** 2
            for y in (low, high)
        ]
        edges = np.broadcast_arrays(angle - half_angle, angle + half_angle, *rims)
        values = np.stack(edges, axis=1)
        may_cross = ~(np.abs(values[0]) > bound_variation(values))
        # From above or below, the rims are the outline.
        may_cross[:2] &= ~((np.hypot(cx, cz) <= radius) & ((low > 0) | (high < 0)))
        return SilhouetteEdges(item_index=may_cross.nonzero()[1], values=values[:, may_cross])

    def compute_inverse_t(self, face_code: int, object_index: Ints, ray: Triple) -> Floats:
        """Return 1 / t of rays from the eye, where t * ray is on the face with a code.

        Seen from above, the curved face is a circle, which the ray meets at the roots of
        t^2 (dx^2 + dz^2) - 2 t (cx dx + cz dz) + cx^2 + cz^2 - radius^2 = 0.
        """
        if face_code != CURVED_FACE:
            return super().compute_inverse_t(face_code, object_index, ray)
        index, (dx, _, dz) = self.objects.to_local(object_index), self.frame.rotate_to_scene(ray)
        (cx, _, cz), radius = self.from_eye[:, index], self.radius[index]
        power = cx * cx + cz * cz - radius * radius
        k_d = (cx * dx + cz * dz) / power
        return k_d + np.sqrt(np.maximum(k_d**2 - (dx * dx + dz * dz) / power, 0))

    def compute_normals(self, object_index: Ints, ray: Triple, inverse_t: Floats) -> Triple:
        """Return outward normals of any length, in camera axes, where rays hit the curved face.

        At t d, the normal is the vector from the axis, t d - c, here divided by t.
        """
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
        """Yield the codes of faces, each with the indices of the hits near this face.

        The curved face is near a hit on a cap if its distance is less than `max_distance`, and the
        eye can see it.
        """
        arguments = object_index, run_length, face_axis, to_hit, max_distance
        yield from super().find_near_faces(*arguments)
        index = self.objects.to_local(object_index).repeat(run_length)
        (cx, _, cz), radius = self.from_eye[:, index], self.radius[index]
        x, _, z = self.frame.rotate_to_scene((to_hit[0], to_hit[1], to_hit[2]))
        is_cap = (face_axis != NO_AXIS).repeat(run_length)
        is_visible = self.is_eye_inside[index] | (np.hypot(cx, cz) > radius)
        is_near = np.abs(np.hypot(x - cx, z - cz) - radius) < max_distance
        yield CURVED_FACE, find(is_cap & is_visible & is_near)


def _square(u: Floats, v: Floats) -> Floats:
    """Return the coefficients of the polynomial (u + x v)^2 = c + 2 b x + a x^2: c, b and a."""
    return np.array(np.broadcast_arrays(u * u, u * v, v * v))


def _solve(polynomial: Floats) -> tuple[Floats, Floats]:
    """Return the two roots of c + 2 b x + a x^2; NaN if there are none."""
    # Without this step, the eighth power of a length would overflow.
    c, b, a = polynomial / np.abs(polynomial).max(axis=0)
    q = -(b + np.copysign(np.sqrt(b * b - a * c), b))
    return q / a, c / q


def _cross_faces(
    center: Floats, direction: Triple, radius: Floats, caps: tuple[Floats, Floats]
) -> tuple[Floats, Floats]:
    """Return t at which rays enter, and t at which they leave, each in two rows.

    Row 0 is of the cylinder without caps, and row 1 of the slab between the caps.  Positions are
    relative to the start of each ray.  If a ray misses the cylinder without caps, t is NaN.
    """
    cx, _, cz = center
    dx, dy, dz = direction
    squared_length = dx * dx + dz * dz
    projection = cx * dx + cz * dz
    root = np.sqrt(squared_length * radius**2 - (cx * dz - cz * dx) ** 2)
    side_enter = (projection - root) / squared_length
    side_leave = (projection + root) / squared_length
    low_t, high_t = caps[0] / dy, caps[1] / dy
    enter = np.array([side_enter, np.minimum(low_t, high_t)])
    return enter, np.array([side_leave, np.maximum(low_t, high_t)])


class PlainTracer(plain._PlainTracer):
    """The plain renderer with the formulas of cylinders, which it knows by their bounding boxes."""

    def compute_signed_distance(self, surface_index: int, points: Any) -> Any:
        if not isinstance(self.surfaces[surface_index], Cylinder):
            return super().compute_signed_distance(surface_index, points)
        center, extent = self.get_cylinder(surface_index)
        x, y, z = points - center
        return np.maximum(np.hypot(x, z) - extent[0], np.abs(y) - extent[1])

    def get_cylinder(self, surface_index: int) -> tuple[Any, Any]:
        """Return the centre of a cylinder, and half the size of its bounding box."""
        low, high = self.shapes[surface_index]
        return (low + high) / 2, (high - low) / 2

    def intersect(self, surface_index: int, origin: Any, direction: Any, is_closed: bool) -> Any:
        near, far = super().intersect(surface_index, origin, direction, is_closed)
        if not isinstance(self.surfaces[surface_index], Cylinder):
            return near, far
        center, extent = self.get_cylinder(surface_index)
        px, _, pz = origin - center
        dx, _, dz = direction
        # Seen from above, the ray meets the circle where a t^2 + 2 b t + c = 0.
        a = dx * dx + dz * dz
        b = px * dx + pz * dz
        c = px * px + pz * pz - extent[0] ** 2
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
