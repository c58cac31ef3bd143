"""Compute the window of a camera, and find the visible points of a scene.

The *window* of a camera is the rectangle in space that the picture fills.  It is computed here
independently of the tracer, because pictures that Mitsuba renders with it validate the tracer.

All coordinates are in the axes of the scene unless a comment says otherwise.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated as Shaped
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from tracer import Camera, Scene, Surfaces, first_hits

Floats: TypeAlias = NDArray[np.float64]

# Numbers of rays along each side of the picture, in grids that are tried in turn until enough rays
# hit a surface.
_RAYS_PER_SIDE = 12, 48, 192

# Minimum number of rays of a grid that must hit a surface.
_MIN_VISIBLE_POINTS = 12


class Window(NamedTuple):
    """The window of a camera, and the position of the eye, through which all rays pass."""

    eye: Shaped[Floats, "3"]
    # Unit vectors in rows: right and down along the edges of the window, and forward, which is
    # perpendicular to the window and points away from the eye.
    axes: Shaped[Floats, "3 3"]
    offset: Shaped[Floats, "3"]  # from the eye to the window's centre, in components along `axes`
    width: float  # width and height are in the scene's unit of length
    height: float

    def compute_vectors_from_eye(
        self, x: Shaped[Floats | float, "..."], y: Shaped[Floats | float, "..."]
    ) -> Shaped[Floats, "... 3"]:
        """Compute vectors from the eye to points of the window, in the axes of the scene.

        A point is given by its position in the window: `x` is 0 at the left edge and 1 at the right
        edge, and `y` is 0 at the upper edge and 1 at the lower edge.
        """
        right, down, forward = self.axes
        offset_right = self.offset[0] + (np.asarray(x)[..., None] - 0.5) * self.width
        offset_down = self.offset[1] + (np.asarray(y)[..., None] - 0.5) * self.height
        vectors: Floats = offset_right * right + offset_down * down + self.offset[2] * forward
        return vectors


def compute_window(camera: Camera) -> Window:
    """Compute the window of a camera (Shirley, Fundamentals of Computer Graphics, 2nd ed., 10.2).

    The window is perpendicular to the camera's `proj_normal`, or to `view_dir` if `proj_normal` is
    None.
    """
    view_direction = _normalize(camera.view_dir)
    normal = _normalize(camera.view_dir if camera.proj_normal is None else camera.proj_normal)
    forward = normal if normal @ view_direction > 0 else -normal
    right = _normalize(np.cross(forward, _normalize(camera.view_up)))
    axes = np.array([right, np.cross(forward, right), forward])
    offset = axes @ view_direction * camera.proj_distance
    return Window(
        eye=np.array(camera.view_point),
        axes=axes,
        offset=offset,
        width=camera.view_width,
        height=camera.view_height,
    )


def _normalize(vector: Sequence[float] | Shaped[Floats, "3"]) -> Shaped[Floats, "3"]:
    """Scale a vector to length 1.  It must not be the zero vector."""
    # The largest component becomes 1, so the sum of squares neither overflows nor underflows.
    scaled_vector = np.asarray(vector) / np.abs(vector).max()
    unit_vector: Floats = scaled_vector / np.linalg.norm(scaled_vector)
    return unit_vector


def compute_bounding_box(surfaces: Surfaces) -> Shaped[Floats, "2 3"]:
    """Compute the smallest box that contains all surfaces, with edges along the axes.

    Row 0 of the result is its lower corner, and row 1 its upper corner.  Both are 0 if there are no
    surfaces.
    """
    if not len(surfaces):
        return np.zeros((2, 3))
    radii = surfaces.radius[:, None]
    min_points = np.concatenate([surfaces.center - radii, surfaces.min_pt])
    max_points = np.concatenate([surfaces.center + radii, surfaces.max_pt])
    return np.array([min_points.min(axis=0), max_points.max(axis=0)])


def sample_visible_points(scene: Scene) -> Shaped[Floats, "n 3"]:
    """Find points on the visible surfaces of a scene by tracing a regular grid of rays.

    The rays are spread evenly over the picture.  Finer and finer grids (`_RAYS_PER_SIDE`) are tried
    until at least `_MIN_VISIBLE_POINTS` rays hit a surface.  If fewer rays of the last grid do, the
    result has fewer points, or none.
    """
    for rays_per_side in _RAYS_PER_SIDE:
        y, x = (np.indices((rays_per_side, rays_per_side)).reshape(2, -1) + 0.5) / rays_per_side
        hits = first_hits(scene, x * scene.width, y * scene.height)
        points: Floats = hits.point[hits.surface >= 0]
        if len(points) >= _MIN_VISIBLE_POINTS:
            break
    return points
