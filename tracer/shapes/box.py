"""Axis-aligned boxes: what the eye sees of them, and which shadow segments they block.

`Boxes` answers the same questions as `Spheres`, which documents them.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from tracer.arrays import (
    Bools,
    Floats,
    Index,
    Ints,
    Triple,
    columns,
    each,
    entries,
    indices,
    pick,
    select,
)
from tracer.scene.model import Surfaces
from tracer.shapes.rounding import (
    INSIDE,
    NEARLY_PARALLEL,
    OUTSIDE,
    PLANE_ROUNDING,
    SURFACE_TOLERANCE,
    tolerance_at,
)
from tracer.shapes.silhouette import box_corners, silhouette_planes
from tracer.view.camera import LEAST_SLOPE, Frames, Raster, Spans

# Slopes (`Spheres.slope`) count as at most so steep.
_MOST_SLOPE = 8192.0


@dataclass(frozen=True, eq=False)
class Boxes:
    """All boxes of a scene, and how the eye sees them.

    Attributes
    ----------
    flat, first, frames, eye_inside, slope
        See `Spheres`.
    min_pt, max_pt : (n, 3)
    planes : three (6, n)
        Planes through the eye and the edges of silhouettes (`silhouette_planes`): slope, tilt and
        level of  slope * s + tilt * g + level >= 0  inside, with the ray (s, g, depth).
    slack : (6, n)
        By how much rounding may change that, for rays that meet the box.
    """

    flat: ClassVar = True

    first: int
    min_pt: Floats
    max_pt: Floats
    frames: Frames
    planes: Triple
    slack: Floats
    eye_inside: Bools
    slope: Floats

    @classmethod
    def of(cls, raster: Raster, surfaces: Surfaces) -> Boxes:
        """Prepare the boxes of a scene to be seen."""
        low, high, eye = surfaces.min_pt, surfaces.max_pt, raster.eye
        corners = raster.vector_to_camera(box_corners(low, high, eye))
        inside: Bools = np.all((low <= eye) & (eye <= high), axis=1)
        frames = _frames(raster, corners)
        planes, slack = _planes_in_view(raster, frames, corners, low, high, inside)
        slope = _slopes(low - eye, high - eye, inside)
        first = surfaces.sphere_count
        return cls(first, low, high, frames, planes, slack, inside, slope)

    @property
    def count(self) -> int:
        """Number of boxes."""
        return len(self.min_pt)

    @property
    def whole(self) -> Bools:
        """See `Spheres.whole`: not where the eye is too near an edge."""
        missing = ~np.any([m != 0 for m in self.planes], axis=0)
        # Flat boxes have edges of no length, which are none.
        solid = (self.min_pt < self.max_pt).all(axis=1)
        beside = np.isinf(self.frames.left)
        whole: Bools = ~(missing.any(axis=0) & ~missing.all(axis=0) & beside & solid)
        return whole

    @property
    def curvature(self) -> Floats:
        """See `Spheres.curvature`."""
        return np.zeros(self.count)

    @cached_property
    def size(self) -> Floats:
        """See `Spheres.size`."""
        size: Floats = np.maximum(np.abs(self.min_pt), np.abs(self.max_pt)).sum(axis=1)
        return size

    # What the eye sees.

    def spans(self, raster: Raster, rows: Floats, height: float = 0.0, pad: float = 0.0) -> Spans:
        """See `Spheres.spans`."""
        box, row = self.frames.rows(raster, rows, height, pad)
        g = raster.down(rows)[row]
        low, high = np.full(g.size, -np.inf), np.full(g.size, np.inf)
        for k in range(6):
            slope, tilt, level = (m[k][box] for m in self.planes)
            tilted = tilt * g
            if height:
                # On whichever line of the row more is inside.
                tilted += np.maximum(tilt * (height * raster.step_v), 0)
            # With slope 0 (or -0, hence the sum) the bound is infinite: all of the row, or none.
            bound = -(tilted + level + self.slack[k][box]) / (slope + 0.0)
            np.fmax(low, bound, out=low, where=slope >= 0)
            np.fmin(high, bound, out=high, where=slope < 0)
        left = np.maximum(self.frames.left[box], raster.column(low))
        right = np.minimum(self.frames.right[box], raster.column(high))
        return Spans.clipped(box + self.first, row, left, right, pad, raster.width)

    def hit(
        self, raster: Raster, owner: Index, g: Floats, s: Floats, span: Ints | slice
    ) -> tuple[Floats, NDArray[np.int8]]:
        """See `Spheres.hit`; of the face twice the axis, plus 1 if it looks up that axis.

        Slabs (Kay and Kajiya 1986); the face is that of the entry (of the exit, with the eye
        inside).  Slabs are closed: a ray lying in a face meets the box.
        """
        box, eye, (u, v, w) = owner - self.first, raster.eye.tolist(), raster.axes.tolist()
        near, far, faces = [], [], []
        for k in range(3):
            d = s * u[k] + select(g * v[k] + raster.depth * w[k], span)
            low, high = (select(m[box, k] - eye[k], span) for m in (self.min_pt, self.max_pt))
            enter, leave = _slab(low, high, d, closed=True)
            near.append(enter)
            far.append(leave)
            # The face that is seen looks against the ray.
            faces.append((d < 0).view(np.int8) + np.int8(2 * k))
        enter, leave = np.maximum(*near[:2]), np.minimum(*far[:2])
        enter, leave = np.maximum(enter, near[2]), np.minimum(leave, far[2])
        t, face = np.where(enter <= leave, enter, np.inf), _first_face(enter, near, faces)
        inside = select(self.eye_inside[box], span)
        if inside.any():
            t = np.where(inside, leave, t)
            face = np.where(inside, _first_face(leave, far, faces), face)
        t[~(t > 0)] = np.inf
        return t, face

    def surface(
        self,
        raster: Raster,
        owner: Index,
        span: Ints | slice,
        p: Floats,
        t: Floats,
        detail: NDArray[np.int8],
    ) -> tuple[Index, Floats, Floats, Triple, Floats]:
        """See `Spheres.surface`."""
        face = detail.astype(np.intp) >> 1
        sign = np.where(detail & 1, 1.0, -1.0)
        own = select(owner - self.first, span)
        low, high = entries(self.min_pt, own, face), entries(self.max_pt, own, face)
        level = np.where(self.eye_inside[own] == (sign > 0), low, high)
        height = sign * (raster.eye[face] - level)
        x, y, z = (np.asarray(sign * axis[face]) for axis in raster.axes)
        return face, sign, level, (x, y, z), height

    # What blocks light.

    def holds(self, owner: Ints) -> Bools:
        """See `Spheres.holds`."""
        return owner >= self.first

    def corners(self, owner: Ints) -> tuple[Triple, Triple]:
        """Lower and upper corners of some boxes."""
        box = owner - self.first
        return columns(self.min_pt, box), columns(self.max_pt, box)

    def side(self, owner: Ints, point: Triple) -> NDArray[np.int8]:
        """See `Spheres.side`."""
        low, high = self.corners(owner)
        between = [(a < p) & (p < b) for a, p, b in zip(low, point, high, strict=True)]
        return np.where(np.all(between, axis=0), INSIDE, OUTSIDE).astype(np.int8)

    def gap(self, owner: Ints, point: Triple) -> Floats:
        """See `Spheres.gap`."""
        low, high = self.corners(owner)
        sides = *each(np.subtract, low, point), *each(np.subtract, point, high)
        return np.asarray(np.max(sides, axis=0))

    def touches(self, owner: Ints, middle: Triple, reach: Floats) -> Bools:
        """See `Spheres.touches`."""
        touches = np.zeros((), dtype=np.bool_)
        for m, low, high in zip(middle, *self.corners(owner), strict=True):
            # The distance from the nearer of the two planes.
            offset = np.abs(m - 0.5 * (low + high))
            offset -= 0.5 * (high - low)
            touches = touches | (np.abs(offset, out=offset) <= reach)
        return touches

    def occludes(
        self,
        eye: Floats,
        owner: Ints,
        p: Triple,
        light: Triple,
        closely: Bools,
        grown: Floats | None = None,
    ) -> Bools:
        """See `Spheres.occludes`.

        Slabs are open: a segment in a face is not blocked; a flat plate blocks.  An end on a
        face's plane is moved onto it.
        """
        low, high = self.corners(owner)
        if grown is not None:
            low, high = each(lambda c: c - grown, low), each(lambda c: c + grown, high)
        blocked = _crosses(p, light, low, high)
        at = indices(closely)
        if at.size:
            owner, p, light = owner[at], pick(p, at), pick(light, at)
            size = self.size[owner - self.first]
            near = tolerance_at(p, eye, size)
            near_light = np.maximum(near, tolerance_at(light, None, size))
            near_light = np.where(self.side(owner, light) == INSIDE, near, near_light)
            some = pick(low, at), pick(high, at)
            blocked[at] = _crosses(_snap(p, *some, near), _snap(light, *some, near_light), *some)
        if grown is not None:
            blocked &= (low[0] <= high[0]) & (low[1] <= high[1]) & (low[2] <= high[2])
        return blocked

    def capsules(
        self, owner: Ints, start: Triple, end: Triple, thickness: Floats
    ) -> tuple[Bools, Bools]:
        """See `Spheres.capsules`."""
        # What span as on a face may be so far off it.
        thickness = thickness + 2 * SURFACE_TOLERANCE * self.size[owner - self.first]
        # Parts of the segment in a box grown by the thickness on all sides, and in one shrunk.
        enter, leave = np.array(-np.inf), np.array(np.inf)
        enter_inner, leave_inner = enter, leave
        for p, q, low, high in zip(start, end, *self.corners(owner), strict=True):
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
    across.  A line parallel to the planes is between them for ever, or never; one that lies in a
    plane is if the slab is `closed`.  None: no line is parallel.
    """
    a, b = low / d, high / d
    enter, leave = np.minimum(a, b), np.maximum(a, b)
    if closed is not None and np.count_nonzero(d) < d.size:
        parallel = d == 0
        between = (low <= 0) & (high >= 0) if closed else (low < 0) & (high > 0)
        enter = np.where(parallel, np.where(between, -np.inf, np.inf), enter)
        leave = np.where(parallel, np.where(between, np.inf, -np.inf), leave)
    return enter, leave


def _first_face(t: Floats, times: list[Floats], faces: list[NDArray[np.int8]]) -> NDArray[np.int8]:
    """Faces met at `t`: through an edge or a corner, that of the first axis span."""
    return np.where(times[0] == t, faces[0], np.where(times[1] == t, faces[1], faces[2]))


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

    return each(component, p, low, high)


def _slopes(low: Floats, high: Floats, inside: Bools) -> Floats:
    """`Spheres.slope`, from the eye's height over faces and the distance of their farthest corner.

    `low`, `high` (n, 3): the corners seen from the eye, `inside` some boxes (n,).
    """
    farthest = np.sqrt(np.maximum(low * low, high * high).sum(axis=1))
    heights = np.where(inside[:, None], np.minimum(-low, high), np.maximum(low, -high))
    least = np.min(heights, axis=1, initial=np.inf, where=heights > 0)
    return np.asarray(np.clip(farthest / least, LEAST_SLOPE, _MOST_SLOPE))


def _frames(raster: Raster, corners: Triple) -> Frames:
    """Bounds of boxes, given their corners (8, n) in the camera's axes."""
    x, y, z = corners
    behind, ahead, ends = z.min(axis=0) <= 0, z.max(axis=0) >= 0, []
    for corner, place in ((y, raster.row), (x, raster.column)):
        slope = corner / z
        low = np.where(behind, -np.inf, slope.min(axis=0))
        high = np.where(behind, np.where(ahead, np.inf, -np.inf), slope.max(axis=0))
        ends += [place(low * raster.depth), place(high * raster.depth)]
    return Frames(*ends)


def _planes_in_view(
    raster: Raster, frames: Frames, corners: Triple, low: Floats, high: Floats, inside: Bools
) -> tuple[Triple, Floats]:
    """`Boxes.planes` and `Boxes.slack`; `inside`: the boxes (n,) that the eye is in."""
    planes, (rounding, beside) = silhouette_planes(corners, raster.eye, low, high)
    slope, tilt, level = planes
    # A box is seen from inside on its side of the faces that the eye is on.
    for box in indices(inside).tolist():
        faces = [(k, 1.0) for k in range(3) if low[box, k] == raster.eye[k]]
        faces += [(k, -1.0) for k in range(3) if high[box, k] == raster.eye[k]]
        if not faces:
            continue
        for number in range(6):
            k, sign = faces[number % len(faces)]
            for plane, axis in zip(planes, raster.axes, strict=True):
                plane[number, box] = sign * axis[k]
            rounding[number, box] = beside[number, box] = 0
    rounding += PLANE_ROUNDING * (np.abs(slope) + np.abs(tilt) + np.abs(level))
    level *= raster.depth
    longest = raster.longest()
    return planes, rounding * longest + beside * np.minimum(frames.extent(raster), longest)
