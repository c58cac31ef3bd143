"""The camera's rays: one pencil from the eye, row by row.

In the camera's own axes (u to the right, v down, w ahead) the ray through the
point (x, y) of the picture, in pixels from its upper left corner, has the
direction (s, g, depth) =

    ( shift_u + (x - width / 2) step_u,  shift_v + (y - height / 2) step_v,  depth ).

Along a pixel row only the first component changes.
"""

from __future__ import annotations

from math import ceil
from typing import NamedTuple

import numpy as np

from tracer.arrays import Bools, Floats, Ints, Triple, cross, dot
from tracer.scene.model import Camera, unit

# How many times as deep as wide the parts of a packet may lie.
_LAYER = 4


class CameraFrame(NamedTuple):
    """The picture's rays: the eye, its axes, and the step from pixel to pixel.

    Attributes
    ----------
    eye : (3,)
    axes : (3, 3)
        Rows u (right), v (down) and w (ahead): orthonormal.
    shift_u, shift_v, depth : float
        The window's centre seen from the eye, along the axes; depth > 0.
    step_u, step_v : float
        Size of a pixel on the window.
    width, height : int
    """

    eye: Floats
    axes: Floats
    shift_u: float
    shift_v: float
    depth: float
    step_u: float
    step_v: float
    width: int
    height: int

    def to_camera(self, points: Floats) -> Triple:
        """Points (n, 3) of the scene in the camera's axes, as seen from the eye."""
        x, y, z = (points - self.eye).T
        return self.vector_to_camera((x, y, z))

    def vector_to_camera(self, vector: Triple) -> Triple:
        """Turn a vector from the scene's axes into the camera's."""
        u, v, w = (dot(vector, (a, b, c)) for a, b, c in self.axes.tolist())
        return u, v, w

    def vector_to_scene(self, vector: Triple) -> Triple:
        """Turn a vector from the camera's axes into the scene's."""
        x, y, z = (self.scene_component(vector, axis) for axis in range(3))
        return x, y, z

    def point_to_scene(self, point: Triple) -> Triple:
        """Inverse of `to_camera`: points in the scene's coordinates, from their triple."""
        x, y, z = self.eye.tolist()
        p = self.vector_to_scene(point)
        return x + p[0], y + p[1], z + p[2]

    def scene_component(self, vector: Triple, axis: int) -> Floats:
        """One component, along an axis of the scene, of a vector in the camera's axes."""
        u, v, w = self.axes[:, axis].tolist()
        return dot(vector, (u, v, w))

    def across(self, x: Floats) -> Floats:
        """First component of the direction, at x pixels from the left."""
        return self.shift_u + (x - self.width / 2) * self.step_u

    def down(self, y: Floats) -> Floats:
        """Second component of the direction, at y pixels from the top."""
        return self.shift_v + (y - self.height / 2) * self.step_v

    def column(self, s: Floats) -> Floats:
        """Inverse of `across`."""
        return (s - self.shift_u) / self.step_u + self.width / 2

    def row(self, g: Floats) -> Floats:
        """Inverse of `down`."""
        return (g - self.shift_v) / self.step_v + self.height / 2

    def layer(self, ahead: Floats, pixels: float) -> Ints:
        """Number layers of depth, each some times as deep there as so many pixels are wide.

        Towards a horizon neighbours in the picture are far apart: layers keep packets small.
        """
        part = min(_LAYER * pixels * self.step_u / self.depth, 1.0)
        # The bits of a number are nearly its logarithm; of twice a number, they are 2^52 more.
        return ahead.view(np.int64) // max(1, int(2**52 * part))

    @property
    def longest(self) -> float:
        """More than |s| + |g| + depth of any ray in the picture."""
        shift = abs(self.shift_u) + abs(self.shift_v) + self.depth
        return shift + self.width * self.step_u + self.height * self.step_v


def camera_frame(
    camera: Camera, width: int, height: int, offset: tuple[float, float] = (0.0, 0.0)
) -> CameraFrame:
    """The rays of a camera (Shirley, Fundamentals of Computer Graphics, 2nd ed., 10.2).

    `offset`: how many pixels every sample is moved to the right and down.
    """
    ahead = unit(camera.view_dir)
    w = unit(camera.normal)
    if w @ ahead > 0:
        w = -w
    u = unit(_cross(unit(camera.view_up), w))
    v = _cross(w, u)
    center = camera.proj_distance * ahead
    step_u, step_v = camera.view_width / width, camera.view_height / height
    # Shirley's v points up and his w backwards: a CameraFrame's are their opposites.
    return CameraFrame(
        eye=np.array(camera.view_point),
        axes=np.array([u, -v, -w]),
        shift_u=float(center @ u) + offset[0] * step_u,
        shift_v=-float(center @ v) + offset[1] * step_v,
        depth=-float(center @ w),
        step_u=step_u,
        step_v=step_v,
        width=width,
        height=height,
    )


def _cross(a: Floats, b: Floats) -> Floats:
    """Cross product (3,) of two vectors: for so few, np.cross takes ten times as long."""
    return np.array(cross(a.tolist(), b.tolist()))


class ScreenBounds(NamedTuple):
    """Bounding rectangles of objects in the picture.

    Attributes
    ----------
    top, bottom, left, right : (n,)
        In pixels; off the picture, or upside down, for what is not in view.
    """

    top: Floats
    bottom: Floats
    left: Floats
    right: Floats

    @classmethod
    def between(
        cls, frame: CameraFrame, down: tuple[Floats, Floats], right: tuple[Floats, Floats]
    ) -> ScreenBounds:
        """From the least and greatest slopes of rays, v / w and u / w in the camera's axes."""
        rows = (frame.row(m * frame.depth) for m in down)
        return cls(*rows, *(frame.column(m * frame.depth) for m in right))

    def take(self, index: Bools | slice) -> ScreenBounds:
        """Some of them."""
        return ScreenBounds(*(m[index] for m in self))

    def in_picture(self, frame: CameraFrame) -> Bools:
        """Objects (n,) that may be seen if nothing hides them."""
        seen: Bools = (self.top <= frame.height + 1) & (self.bottom >= -1)
        return seen & (self.left <= frame.width + 1) & (self.right >= -1)

    def window(self, frame: CameraFrame) -> tuple[slice, slice]:
        """Rows and columns of the picture outside of which nothing is seen."""
        seen = self.take(self.in_picture(frame))

        def between(low: Floats, high: Floats, size: int) -> slice:
            first, last = low.min(initial=np.inf) - 1, high.max(initial=-np.inf) + 1
            return slice(int(np.clip(first, 0, size)), ceil(np.clip(last, 0, size)))

        return (
            between(seen.top, seen.bottom, frame.height),
            between(seen.left, seen.right, frame.width),
        )

    def depth_complexity(self, frame: CameraFrame) -> float:
        """Bound on how many objects lie behind a pixel, on average over the fullest row."""
        seen, width = self.take(self.in_picture(frame)), frame.width
        wide = np.clip(seen.right + 1, 0, width) - np.clip(seen.left - 1, 0, width)
        # Downwards from row to row, each object adds its width where it begins.
        order = np.append(seen.top - 1, seen.bottom + 1).argsort()
        return float(np.append(wide, -wide)[order].cumsum().max(initial=0) / width)

    def silhouette_density(self, frame: CameraFrame) -> float:
        """Mean number of (ordered) pairs of silhouettes in a pixel, if these lay at random."""
        top, bottom = (m.clip(0, frame.height) for m in (self.top, self.bottom))
        # A silhouette about as wide as it is high runs through some 4 * height pixels.
        share = 4 * np.maximum(bottom - top, 0) / (frame.width * frame.height)
        return float(share.sum() ** 2 - (share**2).sum())
