"""Axis-aligned boxes: see `shape` for what the methods promise.

In this module, `box_index` numbers the boxes.  A *slab* is the space between the planes of two
opposite faces (Kay and Kajiya, Ray tracing complex scenes, 1986).
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
    map_xyz,
    repeat_runs,
    take,
)
from tracer.geometry.camera import CameraFrame
from tracer.geometry.numbering import get_object_range
from tracer.geometry.rounding import (
    INSIDE,
    LIGHT_TOLERANCE,
    MIN_COMPONENT,
    OUTSIDE,
    PLANE_ROUNDING,
    SURFACE_TOLERANCE,
    compute_hit_tolerance,
)
from tracer.geometry.screen_bounds import ScreenBounds
from tracer.geometry.shape import Shape, SilhouetteEdges
from tracer.geometry.silhouette import bound_variation, evaluate_box_edges, find_edge_planes
from tracer.scene.model import Box, Surfaces


@dataclass(frozen=True, eq=False, kw_only=True)
class Boxes(Shape):
    """The boxes of a scene."""

    planar_axes: ClassVar = (0, 1, 2)
    has_curved_face: ClassVar = False

    # Corners with the smallest and with the largest coordinates, in scene axes.
    min_pt: Shaped[Floats, "3 objects"]
    max_pt: Shaped[Floats, "3 objects"]
    # Coefficients a, b and c of six planes for each box, through the eye and silhouette edges.  A
    # ray meets the box only if a * ray_x + b * ray_y + c >= 0 for all six planes.
    planes: Shaped[Triple, "6 objects"]

    @classmethod
    def from_surfaces(cls, frame: CameraFrame, surfaces: Surfaces) -> Boxes:
        table = surfaces.tables[Box]
        min_pt, max_pt = table["min_pt"].T.copy(), table["max_pt"].T.copy()
        eye_to_low = min_pt - frame.eye[:, None]
        eye_to_high = max_pt - frame.eye[:, None]
        is_eye_inside = np.all((eye_to_low <= 0) & (eye_to_high >= 0), axis=0)
        normals = frame.rotate_to_camera(find_edge_planes(eye_to_low, eye_to_high))
        # If the eye is on a face, the plane of that face bounds the rays that enter the box.
        is_eye_on_face = is_eye_inside & (np.concatenate([eye_to_low, eye_to_high]) == 0)
        for normal_component, axis in zip(normals, frame.axes, strict=True):
            np.copyto(normal_component, np.append(axis, -axis)[:, None], where=is_eye_on_face)
        return cls(
            frame=frame,
            objects=get_object_range(surfaces, Box),
            min_pt=min_pt,
            max_pt=max_pt,
            planes=(normals[0], normals[1], normals[2] * frame.depth),
            bounds=find_box_bounds(frame, eye_to_low, eye_to_high),
            is_eye_inside=is_eye_inside,
            curvature=np.zeros(is_eye_inside.size),
            coordinate_bound=np.maximum(np.abs(min_pt), np.abs(max_pt)).sum(axis=0),
        )

    def compute_bounding_boxes(
        self,
    ) -> tuple[Shaped[Floats, "3 objects"], Shaped[Floats, "3 objects"]]:
        return self.min_pt, self.max_pt

    # Intersections with rays from the eye.

    def find_x_range(
        self, object_index: Shaped[Ints, "n"], top: Shaped[Floats, "n"], height: float
    ) -> tuple[Shaped[Floats, "n"], Shaped[Floats, "n"]]:
        frame, box_index = self.frame, self.objects.to_local(object_index)
        ray_y = frame.to_ray_y(top + height / 2)
        min_ray_x = np.full(box_index.size, -np.inf)
        max_ray_x = np.full(box_index.size, np.inf)
        # The margin allows for the other rays of the band and for rounding errors.
        margin = 0.5 * height * frame.pixel_height + PLANE_ROUNDING * frame.max_ray_size
        for plane_index in range(6):
            a, b, c = (coefficients[plane_index].take(box_index) for coefficients in self.planes)
            # A ray meets the box only if a * ray_x + b * ray_y + c >= 0.  Compute the bound
            # on `ray_x` for the largest value of the last two terms in the band.
            max_rest = b * ray_y + np.abs(b) * margin + c
            # If a is 0, the bound is infinite.  Adding 0 turns -0 into 0.
            bound = -max_rest / (a + 0.0)
            np.fmax(min_ray_x, bound, out=min_ray_x, where=a >= 0)
            np.fmin(max_ray_x, bound, out=max_ray_x, where=a < 0)
        return frame.to_picture_x(min_ray_x), frame.to_picture_x(max_ray_x)

    def intersect(
        self,
        object_index: Shaped[Ints, "spans"],
        ray_y: Shaped[Floats, "spans"],
        ray_x: Shaped[Floats, "n"],
        ray_count: Shaped[Ints, "spans"] | None,
    ) -> tuple[Shaped[Floats, "n"], Shaped[Sides, "n"]]:
        """See `Shape.intersect`.  A ray in the plane of a face is inside the slab of this face."""
        frame, box_index = self.frame, self.objects.to_local(object_index)
        # Where each ray enters and leaves the slabs of x, y and z, and the face that it may hit.
        slab_enter_t, slab_leave_t, slab_face_code = [], [], []
        for axis, direction in enumerate(self.iterate_directions(ray_y, ray_x, ray_count)):
            low = self.min_pt[axis, box_index] - frame.eye[axis]
            high = self.max_pt[axis, box_index] - frame.eye[axis]
            low, high = repeat_runs(low, ray_count), repeat_runs(high, ray_count)
            near_t, far_t = _intersect_slab(low, high, direction, is_closed=True)
            slab_enter_t.append(near_t)
            slab_leave_t.append(far_t)
            # The normal of a visible face points against the ray.
            slab_face_code.append((direction < 0).view(np.int8) + np.int8(2 * axis))
        enter_t = np.maximum(np.maximum(slab_enter_t[0], slab_enter_t[1]), slab_enter_t[2])
        leave_t = np.minimum(np.minimum(slab_leave_t[0], slab_leave_t[1]), slab_leave_t[2])
        is_hit = enter_t <= leave_t
        t, slab_t = enter_t, slab_enter_t
        is_eye_inside = self.is_eye_inside[box_index]
        if is_eye_inside.any():
            is_eye_inside = repeat_runs(is_eye_inside, ray_count)
            is_hit |= is_eye_inside
            t = np.where(is_eye_inside, leave_t, enter_t)
            slab_t = [
                np.where(is_eye_inside, far_t, near_t)
                for near_t, far_t in zip(slab_enter_t, slab_leave_t, strict=True)
            ]
        # A ray through an edge or a corner hits the face of the first axis.
        face_code = np.where(slab_t[1] == t, slab_face_code[1], slab_face_code[2])
        face_code = np.where(slab_t[0] == t, slab_face_code[0], face_code)
        return np.where(is_hit & (t > 0), t, np.inf), face_code

    def are_rows_bounded_by_ends(self) -> bool:
        return True  # the hits of a row on one face lie on a straight line

    # Tests of shadow segments.

    def get_corners(
        self, object_index: Shaped[Ints, "n"]
    ) -> tuple[Shaped[Triple, "n"], Shaped[Triple, "n"]]:
        """Look up the corners with the smallest and with the largest coordinates of each box."""
        box_index = self.objects.to_local(object_index)
        return take(self.min_pt, box_index), take(self.max_pt, box_index)

    def find_light_side(
        self, object_index: Shaped[Ints, "n"], light: Shaped[Triple, "... #n"]
    ) -> Shaped[Sides, "... n"]:
        """See `Shape.find_light_side`.  A light on a face counts as outside."""
        distance = self.measure_distance(object_index, light)
        return np.where(distance < 0, INSIDE, OUTSIDE).astype(np.int8)

    def measure_distance(
        self, object_index: Shaped[Ints, "n"], point: Shaped[Triple, "... #n"]
    ) -> Shaped[Floats, "... n"]:
        """Compute the largest signed distances of points from the planes of the six faces."""
        low, high = self.get_corners(object_index)
        plane_distances = *map_xyz(np.subtract, low, point), *map_xyz(np.subtract, point, high)
        return np.asarray(np.max(plane_distances, axis=0))

    def occludes(
        self,
        object_index: Shaped[Ints, "n"],
        hit: Shaped[Triple, "n"],
        light: Shaped[Triple, "n"],
        light_side: Shaped[Sides, "n"],
        growth: Shaped[Floats, "n"] | None = None,
    ) -> Shaped[Bools, "n"]:
        """See `Shape.occludes`.  A segment in the plane of a face is not blocked.

        Before the test, ends within rounding error of the plane of a face are moved onto it.
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
        self,
        object_index: Shaped[Ints, "n"],
        axis_start: Shaped[Triple, "n"],
        axis_end: Shaped[Triple, "n"],
        capsule_radius: Shaped[Floats, "n"],
    ) -> tuple[Shaped[Bools, "n"], Shaped[Bools, "n"]]:
        # Allow for the distance by which `occludes` moves the ends of a segment.
        coordinate_bound = self.coordinate_bound[self.objects.to_local(object_index)]
        capsule_radius = capsule_radius + 2 * SURFACE_TOLERANCE * coordinate_bound
        # Positions on the axis, from 0 to 1, at which it enters and leaves the box grown by the
        # radius of the capsule, and the box shrunk by it.
        enter_t = shrunk_enter_t = np.array(-np.inf)
        leave_t = shrunk_leave_t = np.array(np.inf)
        low, high = self.get_corners(object_index)
        # Coordinate i is x in the first pass, then y, then z.
        for start_i, end_i, low_i, high_i in zip(axis_start, axis_end, low, high, strict=True):
            direction = end_i - start_i
            to_low, to_high = low_i - start_i, high_i - start_i
            if np.count_nonzero(direction) < direction.size:
                length_scale = np.abs(to_low) + np.abs(to_high) + capsule_radius
                direction = direction + (direction == 0) * (MIN_COMPONENT * length_scale)
            near_t, far_t = _intersect_slab(to_low, to_high, direction)
            margin = capsule_radius / np.abs(direction)
            shrunk_enter_t = np.maximum(shrunk_enter_t, near_t + margin)
            shrunk_leave_t = np.minimum(shrunk_leave_t, far_t - margin)
            near_t -= margin
            far_t += margin
            enter_t = np.maximum(enter_t, near_t)
            leave_t = np.minimum(leave_t, far_t)
        contains_capsule = (shrunk_enter_t < 0) & (shrunk_leave_t > 1)
        may_block = (enter_t <= leave_t) & (leave_t >= 0) & (enter_t <= 1) & ~contains_capsule
        blocks_all: Bools = (shrunk_enter_t < shrunk_leave_t) & (enter_t > 0) & (leave_t < 1)
        return may_block, blocks_all

    # Edges.

    def find_silhouettes(
        self,
        object_index: Shaped[Ints, "n"],
        viewpoint: Shaped[Floats, "3 n"],
        ray: Shaped[Triple, "#6 n"],
    ) -> SilhouetteEdges:
        """See `Shape.find_silhouettes`.  The outline of a box has up to six edges."""
        box_index = self.objects.to_local(object_index)
        to_low = self.min_pt[:, box_index] - viewpoint
        to_high = self.max_pt[:, box_index] - viewpoint
        normals = self.frame.rotate_to_camera(find_edge_planes(to_low, to_high))
        values = evaluate_box_edges(normals, ray)
        variation = bound_variation(values)
        center_value = values[0]
        # An edge of the outline ends where the value for a neighbouring edge becomes negative.
        may_cross = (np.abs(center_value) <= variation) & (center_value >= -variation).all(axis=0)
        # A normal of 0 stands for no edge.  But if all six are 0, the viewpoint is in the box or on
        # its surface, so the outline is unknown.
        may_cross &= (variation > 0) | ~(variation > 0).any(axis=0)
        return SilhouetteEdges(item_index=may_cross.nonzero()[1], values=values[:, may_cross])


def _intersect_slab(
    low: Shaped[Floats, "n"],
    high: Shaped[Floats, "n"],
    direction: Shaped[Floats, "n"],
    *,
    is_closed: bool = False,
) -> tuple[Shaped[Floats, "n"], Shaped[Floats, "n"]]:
    """Compute where lines enter and leave slabs, as multiples of each line's direction.

    A line parallel to the slab enters at -inf and leaves at inf if it is inside; otherwise it
    enters at inf and leaves at -inf.

    Parameters
    ----------
    low, high
        Coordinates of the two planes along their normal, relative to the start of the line.
    direction
        Component of the line's direction along this normal.
    is_closed
        Whether a line that lies in one of the planes counts as inside the slab.
    """
    low_t, high_t = low / direction, high / direction
    enter_t, leave_t = np.minimum(low_t, high_t), np.maximum(low_t, high_t)
    if np.count_nonzero(direction) < direction.size:
        is_parallel = direction == 0
        is_inside = (low <= 0) & (high >= 0) if is_closed else (low < 0) & (high > 0)
        enter_t = np.where(is_parallel, np.where(is_inside, -np.inf, np.inf), enter_t)
        leave_t = np.where(is_parallel, np.where(is_inside, np.inf, -np.inf), leave_t)
    return enter_t, leave_t


def _crosses_surface(
    start: Shaped[Triple, "n"],
    end: Shaped[Triple, "n"],
    low: Shaped[Triple, "n"],
    high: Shaped[Triple, "n"],
) -> Shaped[Bools, "n"]:
    """Test whether segments enter or leave boxes strictly between the segments' ends."""
    enter_t, leave_t = np.array(-np.inf), np.array(np.inf)
    # Coordinate i is x in the first pass, then y, then z.
    for start_i, end_i, low_i, high_i in zip(start, end, low, high, strict=True):
        near_t, far_t = _intersect_slab(low_i - start_i, high_i - start_i, end_i - start_i)
        enter_t, leave_t = np.maximum(enter_t, near_t), np.minimum(leave_t, far_t)
    is_within_segment = ((enter_t > 0) & (enter_t < 1)) | ((leave_t > 0) & (leave_t < 1))
    crosses_surface: Bools = (enter_t <= leave_t) & is_within_segment
    return crosses_surface


def _snap_to_faces(
    point: Shaped[Triple, "n"],
    low: Shaped[Triple, "n"],
    high: Shaped[Triple, "n"],
    tolerance: Shaped[Floats, "n"],
) -> Shaped[Triple, "n"]:
    """Move points that are at most `tolerance` away from the plane of a face onto this plane."""

    def snap_coordinate(
        x: Shaped[Floats, "n"], low_x: Shaped[Floats, "n"], high_x: Shaped[Floats, "n"]
    ) -> Shaped[Floats, "n"]:
        is_on_low = np.abs(x - low_x) <= tolerance
        is_on_high = np.abs(x - high_x) <= tolerance
        return np.where(is_on_low, low_x, np.where(is_on_high, high_x, x))

    return map_xyz(snap_coordinate, point, low, high)


def find_box_bounds(
    frame: CameraFrame, low: Shaped[Floats, "3 n"], high: Shaped[Floats, "3 n"]
) -> ScreenBounds:
    """Compute the bounding rectangle of each box in the picture.

    `low` and `high` are vectors, in scene axes, from the eye to the corners with the smallest and
    with the largest coordinates.  The rectangle is infinite if the box is partly behind the eye,
    and outside the picture if the box is entirely behind the eye.
    """
    # Bit `axis` of i is 1 if corner i has the coordinate `high` along this axis, and 0 for `low`.
    x, y, z = (np.array([(low, high)[i >> axis & 1][axis] for i in range(8)]) for axis in range(3))
    right, down, depth = frame.rotate_to_camera((x, y, z))
    has_corner_behind, has_corner_ahead = depth.min(axis=0) <= 0, depth.max(axis=0) >= 0

    def find_slope_range(
        offset: Shaped[Floats, "8 n"],
    ) -> tuple[Shaped[Floats, "n"], Shaped[Floats, "n"]]:
        slope = offset / depth
        min_slope = np.where(has_corner_behind, -np.inf, slope.min(axis=0))
        # A box entirely behind the eye has the range -inf to -inf, which is outside every picture.
        max_slope_if_behind = np.where(has_corner_ahead, np.inf, -np.inf)
        return min_slope, np.where(has_corner_behind, max_slope_if_behind, slope.max(axis=0))

    return ScreenBounds.from_slopes(frame, find_slope_range(down), find_slope_range(right))
