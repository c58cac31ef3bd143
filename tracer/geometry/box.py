"""Axis-aligned boxes: what the eye sees of them, and which shadow segments they block.

`Boxes` answers the same questions as `Spheres`, which documents them.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
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
from tracer.geometry.rounding import (
    INSIDE,
    LIGHT_TOLERANCE,
    NEARLY_PARALLEL,
    OUTSIDE,
    PLANE_ROUNDING,
    SURFACE_TOLERANCE,
    hit_tolerance,
)
from tracer.geometry.silhouette import silhouette_planes
from tracer.scene.model import Surfaces


@dataclass(frozen=True, eq=False)
class Boxes:
    """All boxes of a scene, and how the eye sees them.

    Attributes
    ----------
    flat, first, bounds, eye_inside
        See `Spheres`.
    min_pt, max_pt : (3, n)
    planes : three (6, n)
        Planes through the eye and the edges of silhouettes (`silhouette_planes`): slope, tilt and
        level of  slope * s + tilt * g + level >= 0  inside, with the ray (s, g, depth).
    """

    flat: ClassVar = True

    first: int
    min_pt: Floats
    max_pt: Floats
    bounds: ScreenBounds
    planes: Triple
    eye_inside: Bools

    @classmethod
    def of(cls, frame: CameraFrame, surfaces: Surfaces) -> Boxes:
        """Prepare the boxes of a scene to be seen."""
        min_pt, max_pt = surfaces.min_pt.T.copy(), surfaces.max_pt.T.copy()
        low, high = (m - frame.eye[:, None] for m in (min_pt, max_pt))
        inside = np.all((low <= 0) & (high >= 0), axis=0)
        u, v, w = frame.vector_to_camera(silhouette_planes(low, high))
        # From inside, a box is seen on its side of the faces that the eye is on.
        on = inside & (np.concatenate([low, high]) == 0)
        for plane, axis in zip((u, v, w), frame.axes, strict=True):
            np.copyto(plane, np.append(axis, -axis)[:, None], where=on)
        planes = u, v, w * frame.depth
        bounds, first = _screen_bounds(frame, low, high), surfaces.sphere_count
        return cls(first, min_pt, max_pt, bounds, planes, inside)

    @property
    def count(self) -> int:
        """Number of boxes."""
        return len(self.eye_inside)

    @cached_property
    def size(self) -> Floats:
        """See `Spheres.size`."""
        size: Floats = np.maximum(np.abs(self.min_pt), np.abs(self.max_pt)).sum(axis=0)
        return size

    # What the eye sees.

    def row_extent(
        self, frame: CameraFrame, obj: Ints, rows: Floats, height: float
    ) -> tuple[Floats, Floats]:
        """See `Spheres.row_extent`."""
        box, g = obj - self.first, frame.down(rows + height / 2)
        low, high = np.full(g.size, -np.inf), np.full(g.size, np.inf)
        # Rays that rounding may turn are in the row as well.
        half = 0.5 * height * frame.step_v + PLANE_ROUNDING * frame.longest
        for k in range(6):
            slope, tilt, level = (m[k].take(box) for m in self.planes)
            # On whichever side of the row more is inside.
            inside = tilt * g + np.abs(tilt) * half + level
            # With slope 0 (or -0, hence the sum) the bound is infinite: all of the row, or none.
            bound = -inside / (slope + 0.0)
            np.fmax(low, bound, out=low, where=slope >= 0)
            np.fmin(high, bound, out=high, where=slope < 0)
        return frame.column(low), frame.column(high)

    def hit(
        self, frame: CameraFrame, obj: Ints, g: Floats, s: Floats, counts: Ints | None
    ) -> tuple[Floats, Sides]:
        """See `Spheres.hit`; of the face twice the axis, plus 1 if it looks up that axis.

        Slabs (Kay and Kajiya 1986); the face is that of the entry (of the exit, with the eye
        inside).  Slabs are closed: a ray lying in a face meets the box.
        """
        box, eye, (u, v, w) = obj - self.first, frame.eye.tolist(), frame.axes.tolist()
        near, far, faces = [], [], []
        for k in range(3):
            d = s * u[k] + repeat_runs(g * v[k] + frame.depth * w[k], counts)
            low, high = self.min_pt[k, box] - eye[k], self.max_pt[k, box] - eye[k]
            above = high < 0
            if np.all(above | (low > 0)):
                # The nearer plane is known; a ray away from it would leave before it enters.
                planes = np.where(above, high, low), np.where(above, low, high)
                enter, leave = (repeat_runs(m, counts) / d for m in planes)
            else:
                enter, leave = _slab(
                    repeat_runs(low, counts), repeat_runs(high, counts), d, closed=True
                )
            near.append(enter)
            far.append(leave)
            # The face that is seen looks against the ray.
            faces.append((d < 0).view(np.int8) + np.int8(2 * k))
        enter, leave = np.maximum(*near[:2]), np.minimum(*far[:2])
        enter, leave = np.maximum(enter, near[2]), np.minimum(leave, far[2])
        t, place, meets = enter, near, enter <= leave
        inside = self.eye_inside[box]
        if inside.any():
            inside = repeat_runs(inside, counts)
            t, meets = np.where(inside, leave, t), meets | inside
            place = [np.where(inside, b, a) for a, b in zip(near, far, strict=True)]
        # Through an edge or a corner, the face of the first axis.
        face = np.where(place[1] == t, faces[1], faces[2])
        face = np.where(place[0] == t, faces[0], face)
        return np.where(meets & (t > 0), t, np.inf), face

    def surface(
        self, frame: CameraFrame, obj: Ints, counts: Ints, p: Floats, t: Floats, detail: Sides
    ) -> tuple[Ints, Floats, Floats, Triple, Floats]:
        """See `Spheres.surface`."""
        box, detail = obj - self.first, detail.take(counts.cumsum() - counts)
        face, sign = detail.astype(np.intp) >> 1, np.where(detail & 1, 1.0, -1.0)
        low, high = take_2d(self.min_pt, face, box), take_2d(self.max_pt, face, box)
        level = np.where(self.eye_inside[box] == (sign > 0), low, high)
        height = sign * (frame.eye[face] - level)
        x, y, z = (np.asarray(sign * axis[face]) for axis in frame.axes)
        return face, sign, level, (x, y, z), height

    # What blocks light.

    def corners(self, obj: Ints) -> tuple[Triple, Triple]:
        """Lower and upper corners of some boxes."""
        box = obj - self.first
        return take3(self.min_pt, box), take3(self.max_pt, box)

    def side(self, obj: Ints, point: Triple) -> Sides:
        """See `Spheres.side`."""
        return np.where(self.signed_distance(obj, point) < 0, INSIDE, OUTSIDE).astype(np.int8)

    def signed_distance(self, obj: Ints, point: Triple) -> Floats:
        """See `Spheres.signed_distance`."""
        low, high = self.corners(obj)
        heights = *map3(np.subtract, low, point), *map3(np.subtract, point, high)
        return np.asarray(np.max(heights, axis=0))

    def occludes(
        self,
        eye: Floats,
        obj: Ints,
        p: Triple,
        light: Triple,
        light_side: Sides,
        offset: Floats | None = None,
    ) -> Bools:
        """See `Spheres.occludes`.

        Slabs are open: a segment in a face is not blocked; a flat plate blocks.  An end on a
        face's plane is moved onto it.
        """
        low, high = self.corners(obj)
        if offset is not None:
            low, high = map3(lambda c: c - offset, low), map3(lambda c: c + offset, high)
        size = self.size[obj - self.first]
        start = _snap(p, low, high, hit_tolerance(size, p, eye))
        end = _snap(light, low, high, LIGHT_TOLERANCE * size)
        blocked = _crosses(start, end, low, high)
        if offset is not None:
            blocked &= (low[0] <= high[0]) & (low[1] <= high[1]) & (low[2] <= high[2])
        return blocked

    def capsules(
        self, obj: Ints, start: Triple, end: Triple, thickness: Floats
    ) -> tuple[Bools, Bools]:
        """See `Spheres.capsules`."""
        # Points treated as on a face may be this far off it.
        thickness = thickness + 2 * SURFACE_TOLERANCE * self.size[obj - self.first]
        # Parts of the segment in a box grown by the thickness on all sides, and in one shrunk.
        enter, leave = np.array(-np.inf), np.array(np.inf)
        enter_inner, leave_inner = enter, leave
        for p, q, low, high in zip(start, end, *self.corners(obj), strict=True):
            d, below, above = q - p, low - p, high - p
            if np.count_nonzero(d) < d.size:
                lengths = np.abs(below) + np.abs(above) + thickness
                d = d + (d == 0) * (NEARLY_PARALLEL * lengths)
            near, far = _slab(below, above, d)
            margin = thickness / np.abs(d)
            enter_inner = np.maximum(enter_inner, near + margin)
            leave_inner = np.minimum(leave_inner, far - margin)
            near -= margin
            far += margin
            enter, leave = np.maximum(enter, near), np.minimum(leave, far)
        around = (enter_inner < 0) & (leave_inner > 1)
        meets = (enter <= leave) & (leave >= 0) & (enter <= 1) & ~around
        cuts: Bools = (enter_inner < leave_inner) & (enter > 0) & (leave < 1)
        return meets, cuts


def _slab(
    low: Floats, high: Floats, d: Floats, *, closed: bool | None = None
) -> tuple[Floats, Floats]:
    """Places where lines enter and leave the slab between two planes, in units of `d`.

    `low`, `high`: the planes' places seen from the lines' origins; `d`: the lines' component
    across.  Parallel lines are in it for ever or never; in a plane, for ever if `closed`, never if
    not; None: there are none.
    """
    a, b = low / d, high / d
    enter, leave = np.minimum(a, b), np.maximum(a, b)
    if closed is not None and np.count_nonzero(d) < d.size:
        parallel = d == 0
        between = (low <= 0) & (high >= 0) if closed else (low < 0) & (high > 0)
        enter = np.where(parallel, np.where(between, -np.inf, np.inf), enter)
        leave = np.where(parallel, np.where(between, np.inf, -np.inf), leave)
    return enter, leave


def _crosses(p: Triple, light: Triple, low: Triple, high: Triple) -> Bools:
    """Test whether open segments cross the surfaces of boxes."""
    enter, leave = np.array(-np.inf), np.array(np.inf)
    for start, end, a, b in zip(p, light, low, high, strict=True):
        near, far = _slab(a - start, b - start, end - start, closed=False)
        enter, leave = np.maximum(enter, near), np.minimum(leave, far)
    crosses: Bools = (enter <= leave) & (((enter > 0) & (enter < 1)) | ((leave > 0) & (leave < 1)))
    return crosses


def _snap(p: Triple, low: Triple, high: Triple, tolerance: Floats) -> Triple:
    """Move points onto planes of faces that they are on but for rounding."""

    def component(x: Floats, low: Floats, high: Floats) -> Floats:
        on_low, on_high = np.abs(x - low) <= tolerance, np.abs(x - high) <= tolerance
        return np.where(on_low, low, np.where(on_high, high, x))

    return map3(component, p, low, high)


def _screen_bounds(frame: CameraFrame, low: Floats, high: Floats) -> ScreenBounds:
    """Bounds of boxes, given their corners as seen from the eye, in the scene's axes."""
    # Corner i is high along axis k where bit k of i is set.
    x, y, z = (np.array([(low, high)[i >> k & 1][k] for i in range(8)]) for k in range(3))
    x, y, z = frame.vector_to_camera((x, y, z))
    behind, ahead = z.min(axis=0) <= 0, z.max(axis=0) >= 0

    def slopes(corner: Floats) -> tuple[Floats, Floats]:
        slope = corner / z
        least = np.where(behind, -np.inf, slope.min(axis=0))
        return least, np.where(behind, np.where(ahead, np.inf, -np.inf), slope.max(axis=0))

    return ScreenBounds.between(frame, slopes(y), slopes(x))
