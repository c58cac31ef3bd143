"""Axis-aligned boxes, as a `Shape`: where rays hit them, what they shade, and their outlines.

`slabs` computes where lines cross boxes, from the positions at which they cross the three pairs of
parallel faces.  `silhouette` finds the edges of the outline.  `shape` explains the common terms,
and describes all methods in full.  In this module, `box_index` numbers the boxes.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
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
    OUTSIDE,
    PLANE_ROUNDING,
    SURFACE_TOLERANCE,
    compute_hit_tolerance,
)
from tracer.geometry.screen_bounds import ScreenBounds
from tracer.geometry.shape import Shape, SilhouetteEdges
from tracer.geometry.silhouette import bound_variation, evaluate_box_edges, find_edge_planes
from tracer.geometry.slabs import (
    crosses_surface,
    intersect_slab,
    snap_to_faces,
    test_capsules_on_boxes,
)
from tracer.scene.model import Box, Surfaces


@dataclass(frozen=True, eq=False, kw_only=True)
class Boxes(Shape):
    """The boxes of a scene."""

    planar_axes: ClassVar = (0, 1, 2)
    has_curved_face: ClassVar = False

    # Corners with the smallest and with the largest coordinates, in scene axes.
    min_pt: Shaped[Floats, "3 objects"]
    max_pt: Shaped[Floats, "3 objects"]
    # Coefficients a, b and c of six planes through the eye: see `_find_bounding_planes`.
    planes: Shaped[Triple, "6 objects"]

    @classmethod
    def from_surfaces(cls, frame: CameraFrame, surfaces: Surfaces) -> Boxes:
        table = surfaces.tables[Box]
        min_pt, max_pt = table["min_pt"].T.copy(), table["max_pt"].T.copy()
        eye_to_low = min_pt - frame.eye[:, None]
        eye_to_high = max_pt - frame.eye[:, None]
        is_eye_inside = np.all((eye_to_low <= 0) & (eye_to_high >= 0), axis=0)
        return cls(
            frame=frame,
            objects=get_object_range(surfaces, Box),
            min_pt=min_pt,
            max_pt=max_pt,
            planes=_find_bounding_planes(frame, eye_to_low, eye_to_high, is_eye_inside),
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
        """Bound the x at which each box appears in a band (see `Shape.find_x_range`)."""
        frame, box_index = self.frame, self.objects.to_local(object_index)
        ray_y = frame.to_ray_y(top + height / 2)
        min_ray_x = np.full(box_index.size, -np.inf)
        max_ray_x = np.full(box_index.size, np.inf)
        # The margin allows for the other rays of the band and for rounding errors.
        margin = 0.5 * height * frame.pixel_height + PLANE_ROUNDING * frame.max_ray_size
        for plane_index in range(6):
            a, b, c = (coefficients[plane_index].take(box_index) for coefficients in self.planes)
            # A ray meets the box only if a * ray_x + b * ray_y + c >= 0.  Within the margin, the
            # last two terms have at most the sum `max_rest`.  So a * ray_x >= -max_rest.
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
        """Compute where rays from the eye hit boxes, and the code of the face that each ray hits.

        A ray in the plane of a face may hit the box (see `Shape.intersect`).
        """
        frame, box_index = self.frame, self.objects.to_local(object_index)
        slabs, face_codes = [], []
        for axis, component in enumerate(self.iterate_directions(ray_y, ray_x, ray_count)):
            low = repeat_runs(self.min_pt[axis, box_index] - frame.eye[axis], ray_count)
            high = repeat_runs(self.max_pt[axis, box_index] - frame.eye[axis], ray_count)
            slabs.append(intersect_slab(low, high, component, is_closed=True))
            # The code of the face that the ray hits, if it hits a face perpendicular to this axis.
            # The normal of a visible face points against the ray.
            face_codes.append((component < 0).view(np.int8) + np.int8(2 * axis))
        box = slabs[0].intersect(slabs[1]).intersect(slabs[2])
        is_hit = box.enter_t <= box.leave_t
        # The hit is where the ray enters the box or, if the eye is inside, where the ray leaves it.
        hit_t = box.enter_t
        slab_t = [slab.enter_t for slab in slabs]
        is_eye_inside = self.is_eye_inside[box_index]
        if is_eye_inside.any():
            is_eye_inside = repeat_runs(is_eye_inside, ray_count)
            is_hit |= is_eye_inside
            hit_t = np.where(is_eye_inside, box.leave_t, hit_t)
            slab_t = [np.where(is_eye_inside, slab.leave_t, slab.enter_t) for slab in slabs]
        # The face belongs to the slab that is entered (or left) at the hit.  A ray through an edge
        # or a corner hits the face of the first axis.
        face_code = np.where(slab_t[1] == hit_t, face_codes[1], face_codes[2])
        face_code = np.where(slab_t[0] == hit_t, face_codes[0], face_code)
        return np.where(is_hit & (hit_t > 0), hit_t, np.inf), face_code

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
        """Determine whether lights are `OUTSIDE` or `INSIDE` boxes.

        A light on a face counts as outside.
        """
        distance = self.measure_distance(object_index, light)
        return np.where(distance < 0, INSIDE, OUTSIDE).astype(np.int8)

    def measure_distance(
        self, object_index: Shaped[Ints, "n"], point: Shaped[Triple, "... #n"]
    ) -> Shaped[Floats, "... n"]:
        """Compute the largest of the signed distances of each point from the planes of six faces.

        A signed distance is negative on the inner side of the face.  Inside the box, the result is
        minus the depth of the point.  Outside, it is positive, and at most the distance to the box.
        """
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
        """Test whether each box blocks the segment from a hit to a light (see `Shape.occludes`).

        A segment in the plane of a face is not blocked.  Before the test, ends within rounding
        error of the plane of a face are moved onto it, so `light_side` is not needed.
        """
        low, high = self.get_corners(object_index)
        if growth is not None:
            low, high = map_xyz(lambda x: x - growth, low), map_xyz(lambda x: x + growth, high)
        coordinate_bound = self.coordinate_bound[self.objects.to_local(object_index)]
        tolerance = compute_hit_tolerance(coordinate_bound, hit, self.frame.eye)
        snapped_hit = snap_to_faces(hit, low, high, tolerance)
        snapped_light = snap_to_faces(light, low, high, LIGHT_TOLERANCE * coordinate_bound)
        occludes = crosses_surface(snapped_hit, snapped_light, low, high)
        if growth is not None:
            # A box that has shrunk to nothing blocks nothing.
            occludes &= (low[0] <= high[0]) & (low[1] <= high[1]) & (low[2] <= high[2])
        return occludes

    def test_capsules(
        self,
        object_index: Shaped[Ints, "n"],
        axis_start: Shaped[Triple, "n"],
        axis_end: Shaped[Triple, "n"],
        capsule_radius: Shaped[Floats, "n"],
    ) -> tuple[Shaped[Bools, "n"], Shaped[Bools, "n"]]:
        """Test whether each box blocks some, or all, segments in a capsule.

        See `Shape.test_capsules`.
        """
        # Allow for the distance by which `occludes` moves the ends of a segment.
        coordinate_bound = self.coordinate_bound[self.objects.to_local(object_index)]
        capsule_radius = capsule_radius + 2 * SURFACE_TOLERANCE * coordinate_bound
        low, high = self.get_corners(object_index)
        return test_capsules_on_boxes(low, high, axis_start, axis_end, capsule_radius)

    # Edges.

    def find_silhouettes(
        self,
        object_index: Shaped[Ints, "n"],
        viewpoint: Shaped[Floats, "3 n"],
        ray: Shaped[Triple, "#6 n"],
    ) -> SilhouetteEdges:
        """Find the edges of each box's outline that may cross a cell.

        The outline of a box has up to six edges (see `Shape.find_silhouettes`).
        """
        box_index = self.objects.to_local(object_index)
        to_low = self.min_pt[:, box_index] - viewpoint
        to_high = self.max_pt[:, box_index] - viewpoint
        normals = self.frame.rotate_to_camera(find_edge_planes(to_low, to_high))
        values = evaluate_box_edges(normals, ray)
        center_value = values[0]
        variation = bound_variation(values)
        may_be_zero = np.abs(center_value) <= variation
        # An edge ends where the edge function of a neighbouring edge becomes negative.  So an edge
        # crosses the cell only where no edge function of its box is negative.
        may_cross = may_be_zero & (center_value >= -variation).all(axis=0)
        # If there is no edge, its normal is 0, so its values do not vary.  If this holds for all
        # six edges, the viewpoint is in or on the box, so the outline is unknown: keep them.
        is_edge = variation > 0
        may_cross &= is_edge | ~is_edge.any(axis=0)
        return SilhouetteEdges(item_index=may_cross.nonzero()[1], values=values[:, may_cross])


def _find_bounding_planes(
    frame: CameraFrame,
    eye_to_low: Shaped[Floats, "3 n"],
    eye_to_high: Shaped[Floats, "3 n"],
    is_eye_inside: Shaped[Bools, "n"],
) -> Shaped[Triple, "6 n"]:
    """Find the six planes through the eye that bound the rays to each box.

    A ray with the direction (ray_x, ray_y, depth) meets a box only if a * ray_x + b * ray_y + c >=
    0 for its six planes.  The result contains a, b and c; they are 0 for planes that bound nothing.
    Arguments are vectors, in scene axes, from the eye to the corners with the smallest and with the
    largest coordinates.
    """
    normals = frame.rotate_to_camera(find_edge_planes(eye_to_low, eye_to_high))
    # If the eye is on a face, the plane of that face bounds the rays that enter the box.
    is_eye_on_face = is_eye_inside & (np.concatenate([eye_to_low, eye_to_high]) == 0)
    for normal_component, axis in zip(normals, frame.axes, strict=True):
        # The normals that point into the box: along the axes from `low`, against them from `high`.
        np.copyto(normal_component, np.append(axis, -axis)[:, None], where=is_eye_on_face)
    return normals[0], normals[1], normals[2] * frame.depth


def find_box_bounds(
    frame: CameraFrame, low: Shaped[Floats, "3 n"], high: Shaped[Floats, "3 n"]
) -> ScreenBounds:
    """Compute the bounding rectangle of each box in the picture.

    `low` and `high` are vectors, in scene axes, from the eye to the corners with the smallest and
    with the largest coordinates.  The rectangle is infinite if the box is partly behind the eye,
    and outside the picture if the box is entirely behind the eye.
    """
    corners = product((low[0], high[0]), (low[1], high[1]), (low[2], high[2]))
    x, y, z = np.array(list(corners)).swapaxes(0, 1)  # each has a row for each of the 8 corners
    right, down, depth = frame.rotate_to_camera((x, y, z))
    y_slopes = _find_slope_range(down, depth)
    x_slopes = _find_slope_range(right, depth)
    return ScreenBounds.from_slopes(frame, y_slopes, x_slopes)


def _find_slope_range(
    offset: Shaped[Floats, "8 n"], depth: Shaped[Floats, "8 n"]
) -> tuple[Shaped[Floats, "n"], Shaped[Floats, "n"]]:
    """Compute the smallest and the largest slope, offset / depth, of rays to the corners of boxes.

    They are -inf and inf if a box is partly behind the eye.  Both are -inf, which is outside every
    picture, if the whole box is behind the eye.
    """
    slope = offset / depth
    has_corner_behind = depth.min(axis=0) <= 0
    has_corner_ahead = depth.max(axis=0) >= 0
    min_slope = np.where(has_corner_behind, -np.inf, slope.min(axis=0))
    max_slope_if_behind = np.where(has_corner_ahead, np.inf, -np.inf)
    return min_slope, np.where(has_corner_behind, max_slope_if_behind, slope.max(axis=0))
