"""Compute the window of a camera, and find the visible points of a scene.

The window is computed independently of the tracer's own camera, because it serves to validate that
camera.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated as Shaped
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from tracer import Camera, Scene, Surfaces, first_hits

Floats: TypeAlias = NDArray[np.float64]

# Numbers of rays along each side of the picture, which are tried in this order.
_RAYS_PER_SIDE = 12, 48, 192

# If fewer rays than this hit a surface, the next number is tried.
_MIN_VISIBLE_POINTS = 12


class Window(NamedTuple):
    """The *window* of a camera: the rectangle in space that the picture fills."""

    eye: Shaped[Floats, "3"]
    # Unit vectors in rows: right and down along the edges of the window, and forward, from the eye
    # towards the window and perpendicular to it.
    axes: Shaped[Floats, "3 3"]
    offset: Shaped[Floats, "3"]  # from the eye to the window's centre, in components along `axes`
    width: float
    height: float

    def compute_vectors_from_eye(
        self, x: Shaped[Floats | float, "..."], y: Shaped[Floats | float, "..."]
    ) -> Shaped[Floats, "... 3"]:
        """Compute the vectors, in scene axes, from the eye to points in the window.

        `x` and `y` run from (0, 0) in the upper left corner to (1, 1) in the lower right corner.
        """
        right, down, forward = self.axes
        offset_right = self.offset[0] + (np.asarray(x)[..., None] - 0.5) * self.width
        offset_down = self.offset[1] + (np.asarray(y)[..., None] - 0.5) * self.height
        vectors: Floats = offset_right * right + offset_down * down + self.offset[2] * forward
        return vectors


def compute_window(camera: Camera) -> Window:
    """Compute the window of a camera.

    It is perpendicular to `proj_normal`, or to `view_dir` if `proj_normal` is None.  The formulas
    are those of Shirley, Fundamentals of Computer Graphics, 2nd ed., 10.2.
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
    """Scale a vector, not the zero vector, to length 1, without overflow or underflow."""
    scaled_vector = np.asarray(vector) / np.abs(vector).max()  # no square overflows or underflows
    unit_vector: Floats = scaled_vector / np.linalg.norm(scaled_vector)
    return unit_vector


def compute_bounding_box(surfaces: Surfaces) -> Shaped[Floats, "2 3"]:
    """Compute the minimum (row 0) and maximum coordinates (row 1) of all surfaces.

    They are 0 if there are no surfaces.
    """
    if not len(surfaces):
        return np.zeros((2, 3))
    radii = surfaces.radius[:, None]
    min_points = np.concatenate([surfaces.center - radii, surfaces.min_pt])
    max_points = np.concatenate([surfaces.center + radii, surfaces.max_pt])
    return np.array([min_points.min(axis=0), max_points.max(axis=0)])


def sample_visible_points(scene: Scene) -> Shaped[Floats, "n 3"]:
    """Find points on the visible surfaces of a scene, by tracing a regular grid of rays.

    The first grid of `_RAYS_PER_SIDE` is used in which `_MIN_VISIBLE_POINTS` rays hit a surface, or
    else the last one.  There, perhaps no ray hits a surface; then the result is empty.
    """
    for rays_per_side in _RAYS_PER_SIDE:
        y, x = (np.indices((rays_per_side, rays_per_side)).reshape(2, -1) + 0.5) / rays_per_side
        hits = first_hits(scene, x * scene.width, y * scene.height)
        points: Floats = hits.point[hits.surface >= 0]
        if len(points) >= _MIN_VISIBLE_POINTS:
            break
    return points
