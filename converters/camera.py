"""Compute the window of a camera, and find the visible points of a scene.

The window is computed independently of the tracer's own camera, because it serves to validate that
camera.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from tracer import Camera, Scene, Surfaces, first_hits

Floats: TypeAlias = NDArray[np.float64]

# Numbers of rays along each side of the picture: the next one is tried if fewer than
# _MIN_VISIBLE_POINTS rays hit a surface.
_RAYS_PER_SIDE = 12, 48, 192
_MIN_VISIBLE_POINTS = 12


class Window(NamedTuple):
    """The window of a camera: the rectangle in space that the picture fills.

    Attributes
    ----------
    eye : (3,) float array
        Position of the eye.
    axes : (3, 3) float array
        Unit vectors in rows: right and down, along the window's edges, and forward, perpendicular
        to the window.
    offset : (3,) float array
        Vector from the eye to the window's centre, in components along the axes.
    width, height : float
        Size of the window.
    """

    eye: Floats
    axes: Floats
    offset: Floats
    width: float
    height: float

    def compute_vectors_from_eye(self, x: Floats | float, y: Floats | float) -> Floats:
        """Compute the vectors from the eye to points in the window.

        Parameters
        ----------
        x, y : float or (...) float array
            Positions in the window, from (0, 0) in the upper left corner to (1, 1) in the lower
            right corner.

        Returns
        -------
        vectors : (..., 3) float array
            The vectors, in the coordinate system of the scene.
        """
        right, down, forward = self.axes
        offset_right = self.offset[0] + (np.asarray(x)[..., None] - 0.5) * self.width
        offset_down = self.offset[1] + (np.asarray(y)[..., None] - 0.5) * self.height
        vectors: Floats = offset_right * right + offset_down * down + self.offset[2] * forward
        return vectors


def compute_window(camera: Camera) -> Window:
    """Compute the window of a camera: the rectangle in space that the picture fills.

    The formulas are those of Shirley, Fundamentals of Computer Graphics, 2nd ed., 10.2.

    Parameters
    ----------
    camera : Camera
        The camera.  The window is perpendicular to `proj_normal`, or to `view_dir` if `proj_normal`
        is None.

    Returns
    -------
    window : Window
        The position of the eye, and the axes, offset and size of the window.
    """
    view_direction = _normalize(camera.view_dir)
    normal = _normalize(camera.view_dir if camera.proj_normal is None else camera.proj_normal)
    forward = normal if normal @ view_direction > 0 else -normal
    right = _normalize(np.cross(forward, _normalize(camera.view_up)))
    axes = np.array([right, np.cross(forward, right), forward])
    offset = axes @ view_direction * camera.proj_distance
    return Window(np.array(camera.view_point), axes, offset, camera.view_width, camera.view_height)


def _normalize(vector: Sequence[float] | Floats) -> Floats:
    """Scale a vector to length 1, without overflow or underflow.

    Parameters
    ----------
    vector : sequence of three floats, or (3,) float array
        Any vector except the zero vector.

    Returns
    -------
    unit_vector : (3,) float array
        The unit vector with the same direction.
    """
    scaled_vector = np.asarray(vector) / np.abs(vector).max()  # no square overflows or underflows
    unit_vector: Floats = scaled_vector / np.linalg.norm(scaled_vector)
    return unit_vector


def compute_bounding_box(surfaces: Surfaces) -> Floats:
    """Compute the axis-aligned bounding box of all surfaces of a scene.

    Parameters
    ----------
    surfaces : Surfaces
        The surfaces: spheres and boxes.

    Returns
    -------
    corners : (2, 3) float array
        The minimum coordinates in the first row, and the maximum coordinates in the second.  If
        there are no surfaces, all coordinates are 0.
    """
    radii = surfaces.radius[:, None]
    min_points = np.concatenate([surfaces.center - radii, surfaces.min_pt])
    max_points = np.concatenate([surfaces.center + radii, surfaces.max_pt])
    return np.array([min_points.min(0), max_points.max(0)]) if len(surfaces) else np.zeros((2, 3))


def sample_visible_points(scene: Scene) -> Floats:
    """Find points on the visible surfaces of a scene, by tracing a regular grid of rays.

    If fewer than 12 rays (`_MIN_VISIBLE_POINTS`) hit a surface, a finer grid is tried.  At most
    three grids are tried.

    Parameters
    ----------
    scene : Scene
        The scene, with its camera.

    Returns
    -------
    points : (n, 3) float array
        The points where rays of the last grid hit surfaces.  If all rays miss, n is 0.
    """
    for rays_per_side in _RAYS_PER_SIDE:
        y, x = (np.indices((rays_per_side, rays_per_side)).reshape(2, -1) + 0.5) / rays_per_side
        hits = first_hits(scene, x * scene.width, y * scene.height)
        points: Floats = hits.point[hits.surface >= 0]
        if len(points) >= _MIN_VISIBLE_POINTS:
            break
    return points
