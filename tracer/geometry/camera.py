"""The camera: one ray for each position in the picture, all from the eye.

The camera has its own axes, which point to the right, down and ahead.  In these axes, the ray
through the position (x, y) of the picture, in pixels from the upper left corner, has the direction
(ray_x, ray_y, depth) with

    ray_x = center_right + (x - width / 2) pixel_width,
    ray_y = center_down + (y - height / 2) pixel_height.

So only `ray_x` changes along a row of the picture.  The *window* is the rectangle in the scene on
which the pixels lie.  Positions and lengths in the picture are in pixels; x points right, y down.
"""

from __future__ import annotations

from typing import Annotated as Shaped
from typing import NamedTuple

import numpy as np

from tracer.arrays import Floats, Triple, dot
from tracer.scene.model import Camera, normalize


class CameraFrame(NamedTuple):
    """The rays of a camera: the eye, the axes, and the step from pixel to pixel."""

    eye: Shaped[Floats, "3"]  # in scene axes
    # Unit vectors to the right (row 0), down (row 1) and ahead (row 2), in scene axes.
    axes: Shaped[Floats, "3 3"]
    # Components to the right, down and ahead of the vector from the eye to the window's center.
    center_right: float
    center_down: float
    depth: float  # positive
    # Size of a pixel on the window, in the scene's unit of length.
    pixel_width: float
    pixel_height: float
    # Size of the picture, in pixels.
    width: int
    height: int

    def point_to_camera(self, points: Shaped[Floats, "n 3"]) -> Shaped[Triple, "n"]:
        """Convert positions in the scene to vectors from the eye, in camera axes."""
        x, y, z = (points - self.eye).T
        return self.rotate_to_camera((x, y, z))

    def rotate_to_camera(self, vectors: Shaped[Triple, "... n"]) -> Shaped[Triple, "... n"]:
        """Rotate vectors from scene axes to camera axes."""
        right, down, ahead = (dot(vectors, (x, y, z)) for x, y, z in self.axes.tolist())
        return right, down, ahead

    def rotate_to_scene(self, vectors: Shaped[Triple, "... n"]) -> Shaped[Triple, "... n"]:
        """Rotate vectors from camera axes to scene axes."""
        x, y, z = (self.project_onto_axis(vectors, axis) for axis in range(3))
        return x, y, z

    def point_to_scene(self, from_eye: Shaped[Triple, "... n"]) -> Shaped[Triple, "... n"]:
        """Convert vectors from the eye, in camera axes, to positions in the scene."""
        eye_x, eye_y, eye_z = self.eye.tolist()
        x, y, z = self.rotate_to_scene(from_eye)
        return eye_x + x, eye_y + y, eye_z + z

    def project_onto_axis(
        self, vectors: Shaped[Triple, "... n"], axis: int
    ) -> Shaped[Floats, "... n"]:
        """Convert vectors from camera axes to scene axes, but compute only one component.

        The axis of the scene is 0 for x, 1 for y and 2 for z.
        """
        right, down, ahead = self.axes[:, axis].tolist()
        return dot(vectors, (right, down, ahead))

    def to_ray_x(self, x: Shaped[Floats, "..."]) -> Shaped[Floats, "..."]:
        """Compute the rightward component of the ray through each x in the picture, in pixels."""
        return self.center_right + (x - self.width / 2) * self.pixel_width

    def to_ray_y(self, y: Shaped[Floats, "..."]) -> Shaped[Floats, "..."]:
        """Compute the downward component of the ray through each y in the picture, in pixels."""
        return self.center_down + (y - self.height / 2) * self.pixel_height

    def to_picture_x(self, ray_x: Shaped[Floats, "..."]) -> Shaped[Floats, "..."]:
        """Compute the x in the picture, in pixels, of rays with these rightward components."""
        return (ray_x - self.center_right) / self.pixel_width + self.width / 2

    def to_picture_y(self, ray_y: Shaped[Floats, "..."]) -> Shaped[Floats, "..."]:
        """Compute the y in the picture, in pixels, of rays with these downward components."""
        return (ray_y - self.center_down) / self.pixel_height + self.height / 2

    @property
    def max_ray_size(self) -> float:
        """Upper bound on |ray_x| + |ray_y| + depth for the rays through the picture."""
        center_size = abs(self.center_right) + abs(self.center_down) + self.depth
        return center_size + self.width * self.pixel_width + self.height * self.pixel_height


def compute_frame(
    camera: Camera, width: int, height: int, offset: tuple[float, float] = (0.0, 0.0)
) -> CameraFrame:
    """Compute the rays of a camera for a picture that is `width` x `height` pixels large.

    Every ray is shifted by `offset` to the right and down, in pixels.  The formulas are those of
    Shirley, Fundamentals of Computer Graphics, 2nd ed., 10.2.
    """
    view_direction = normalize(camera.view_dir)
    # Shirley's axes point right, up and back; those of a CameraFrame point right, down and ahead.
    # The normal of the window may point either way in the scene file.
    back = normalize(camera.normal)
    if back @ view_direction > 0:
        back = -back
    right = normalize(_cross(normalize(camera.view_up), back))
    up = _cross(back, right)
    window_center = camera.proj_distance * view_direction
    pixel_width = camera.view_width / width
    pixel_height = camera.view_height / height
    return CameraFrame(
        eye=np.array(camera.view_point),
        axes=np.array([right, -up, -back]),
        center_right=float(window_center @ right) + offset[0] * pixel_width,
        center_down=-float(window_center @ up) + offset[1] * pixel_height,
        depth=-float(window_center @ back),
        pixel_width=pixel_width,
        pixel_height=pixel_height,
        width=width,
        height=height,
    )


def _cross(a: Shaped[Floats, "3"], b: Shaped[Floats, "3"]) -> Shaped[Floats, "3"]:
    """Compute the cross product a x b.  For a single vector, np.cross takes ten times as long."""
    a_x, a_y, a_z = a.tolist()
    b_x, b_y, b_z = b.tolist()
    return np.array([a_y * b_z - a_z * b_y, a_z * b_x - a_x * b_z, a_x * b_y - a_y * b_x])
