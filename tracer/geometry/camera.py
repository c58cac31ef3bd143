"""The camera: one ray for each position in the picture, all from the eye.

The camera has its own axes, which point to the right, down and ahead.  In these axes, the ray
through the position (x, y) of the picture, in pixels from the upper left corner, has the direction
(ray_x, ray_y, depth) with

    ray_x = center_right + (x - width / 2) pixel_width,
    ray_y = center_down + (y - height / 2) pixel_height.

So only `ray_x` changes along a row of the picture.  The *window* is the rectangle in the scene that
the picture shows.  Positions and lengths in the picture are in pixels; x points right, y down.
"""

from __future__ import annotations

from math import ceil
from typing import Annotated as Shaped
from typing import NamedTuple

import numpy as np

from tracer.arrays import Bools, Floats, Ints, Triple, dot
from tracer.scene.model import Camera, normalize

# Thickness of a layer of depth, as a multiple of the width of a packet at this depth: see
# `CameraFrame.assign_layer`.  Tuned on six scenes of 4 to 1,000 objects: with half of it, rendering
# takes 1.03 to 1.06 times as long.
_LAYER_ASPECT = 4

# The bits of a positive float, read as an integer, increase by this much when the float doubles.
_BITS_PER_OCTAVE = 2**52


class CameraFrame(NamedTuple):
    """The rays of a camera: the eye, the axes, and the step from pixel to pixel."""

    eye: Shaped[Floats, "3"]  # in scene axes
    # Unit vectors to the right (row 0), down (row 1) and ahead (row 2), in scene axes.
    axes: Shaped[Floats, "3 3"]
    # Components to the right, down and ahead of the vector from the eye to the window's centre.
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
        """Compute the components, along one axis of the scene, of vectors in camera axes.

        The axis is 0 for x, 1 for y and 2 for z.
        """
        right, down, ahead = self.axes[:, axis].tolist()
        return dot(vectors, (right, down, ahead))

    def to_ray_x(self, x: Shaped[Floats, "..."]) -> Shaped[Floats, "..."]:
        return self.center_right + (x - self.width / 2) * self.pixel_width

    def to_ray_y(self, y: Shaped[Floats, "..."]) -> Shaped[Floats, "..."]:
        return self.center_down + (y - self.height / 2) * self.pixel_height

    def to_picture_x(self, ray_x: Shaped[Floats, "..."]) -> Shaped[Floats, "..."]:
        """Invert `to_ray_x`."""
        return (ray_x - self.center_right) / self.pixel_width + self.width / 2

    def to_picture_y(self, ray_y: Shaped[Floats, "..."]) -> Shaped[Floats, "..."]:
        """Invert `to_ray_y`."""
        return (ray_y - self.center_down) / self.pixel_height + self.height / 2

    def assign_layer(self, depth: Shaped[Floats, "n"], packet_width: float) -> Shaped[Ints, "n"]:
        """Assign each positive depth to a layer; layers farther from the eye have larger numbers.

        Hits that are neighbours in the picture form packets, which are `packet_width` pixels wide.
        Such hits may be far apart in the scene, so a packet contains only hits in the same layer.
        The thickness of a layer is `_LAYER_ASPECT` times the width of a packet at that depth.
        """
        relative_thickness = min(_LAYER_ASPECT * packet_width * self.pixel_width / self.depth, 1.0)
        # Layers should have equal ratios of their farthest to their nearest depth, so their numbers
        # should grow with the logarithm of the depth.  Instead of the logarithm, which is slower,
        # take the bits of the float, read as an integer: exponent bits, then mantissa bits.  They
        # grow by `_BITS_PER_OCTAVE` whenever the depth doubles, and linearly in between.
        return depth.view(np.int64) // max(1, int(_BITS_PER_OCTAVE * relative_thickness))

    @property
    def max_ray_size(self) -> float:
        """Upper bound on |ray_x| + |ray_y| + depth for the directions of all camera rays."""
        center_size = abs(self.center_right) + abs(self.center_down) + self.depth
        return center_size + self.width * self.pixel_width + self.height * self.pixel_height


def compute_frame(
    camera: Camera, width: int, height: int, offset: tuple[float, float] = (0.0, 0.0)
) -> CameraFrame:
    """Compute the eye, the axes and the pixel grid that determine a camera's rays.

    Every ray is shifted by `offset` to the right and down, in pixels.  The formulas are those of
    Shirley, Fundamentals of Computer Graphics, 2nd ed., 10.2.
    """
    view_direction = normalize(camera.view_dir)
    # Shirley's axes point right, up and back; those of a CameraFrame point right, down and ahead.
    back = normalize(camera.normal)
    if back @ view_direction > 0:
        back = -back
    right = normalize(np.cross(normalize(camera.view_up), back))
    up = np.cross(back, right)
    window_center = camera.proj_distance * view_direction
    pixel_width, pixel_height = camera.view_width / width, camera.view_height / height
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


class ScreenBounds(NamedTuple):
    """Bounding rectangles of n objects in the picture.

    The rectangle of an object that is not visible is outside the picture, or top > bottom.
    """

    top: Shaped[Floats, "n"]
    bottom: Shaped[Floats, "n"]
    left: Shaped[Floats, "n"]
    right: Shaped[Floats, "n"]

    @classmethod
    def from_slopes(
        cls,
        frame: CameraFrame,
        y_slopes: tuple[Shaped[Floats, "n"], Shaped[Floats, "n"]],
        x_slopes: tuple[Shaped[Floats, "n"], Shaped[Floats, "n"]],
    ) -> ScreenBounds:
        """Compute the rectangles from the smallest and largest slopes of rays that meet objects.

        The slope of a ray is ray_y / depth (y slope) or ray_x / depth (x slope).
        """
        top, bottom = (frame.to_picture_y(slope * frame.depth) for slope in y_slopes)
        left, right = (frame.to_picture_x(slope * frame.depth) for slope in x_slopes)
        return cls(top=top, bottom=bottom, left=left, right=right)

    def select(self, selection: Shaped[Bools, "n"] | slice) -> ScreenBounds:
        """Select rectangles by mask or slice."""
        return ScreenBounds._make(side[selection] for side in self)

    def is_in_picture(self, frame: CameraFrame) -> Shaped[Bools, "n"]:
        """Test whether each rectangle overlaps the picture: False for objects surely not visible.

        The picture is enlarged by one pixel on each side, as a margin for rounding errors.
        Occlusion by other objects is ignored.
        """
        is_in_rows = (self.top <= frame.height + 1) & (self.bottom >= -1)
        is_in_columns = (self.left <= frame.width + 1) & (self.right >= -1)
        is_in_picture: Bools = is_in_rows & is_in_columns
        return is_in_picture

    def find_visible_pixels(self, frame: CameraFrame) -> tuple[slice, slice]:
        """Find the rows and columns of pixels that contain all visible objects; may be empty."""
        visible = self.select(self.is_in_picture(frame))
        rows = _find_covered_pixels(visible.top, visible.bottom, frame.height)
        columns = _find_covered_pixels(visible.left, visible.right, frame.width)
        return rows, columns

    def compute_depth_complexity(self, frame: CameraFrame) -> float:
        """Compute an upper bound on the mean number of objects per ray in any row of pixels.

        Objects behind other objects count, too.
        """
        bounds = self.select(self.is_in_picture(frame))
        width = frame.width
        covered_width = np.clip(bounds.right + 1, 0, width) - np.clip(bounds.left - 1, 0, width)
        # From row to row, add the widths of objects that begin and subtract those that end.
        order = np.append(bounds.top - 1, bounds.bottom + 1).argsort()
        width_change = np.append(covered_width, -covered_width)[order]
        return float(width_change.cumsum().max(initial=0) / width)

    def estimate_silhouette_pairs(self, frame: CameraFrame) -> float:
        """Estimate how many pairs of silhouettes cross the same pixel, on average.

        The pairs (i, j) and (j, i) both count.  Objects are assumed to be as tall as they are wide,
        and to lie at random positions.
        """
        top, bottom = (side.clip(0, frame.height) for side in (self.top, self.bottom))
        # A silhouette that is as tall as it is wide crosses about 4 * height pixels.
        crossing_probability = 4 * np.maximum(bottom - top, 0) / (frame.width * frame.height)
        return float(crossing_probability.sum() ** 2 - (crossing_probability**2).sum())


def _find_covered_pixels(
    starts: Shaped[Floats, "n"], stops: Shaped[Floats, "n"], pixel_count: int
) -> slice:
    """Return a slice of the pixels 0 to pixel_count - 1 that covers all intervals, with a margin.

    Interval i extends from starts[i] to stops[i].
    """
    # A margin of one pixel at each end allows for rounding errors.
    start, stop = starts.min(initial=np.inf) - 1, stops.max(initial=-np.inf) + 1
    return slice(int(np.clip(start, 0, pixel_count)), ceil(np.clip(stop, 0, pixel_count)))
