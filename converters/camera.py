"""Compute the window of a camera, and find the visible points of a scene.

The window is computed independently of the tracer's own camera, because pictures that are rendered
through it validate the tracer's camera.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from tracer import Camera, Scene, Surfaces, first_hits

__all__ = ["Floats", "Window", "bounding_box", "camera_window", "visible_points"]

Floats: TypeAlias = NDArray[np.float64]

# Numbers of rays along each side of the picture.  If fewer than _MIN_VISIBLE_POINTS rays hit a
# surface, the next number is tried.
_RAYS_PER_SIDE = 12, 48, 192
_MIN_VISIBLE_POINTS = 12


class Window(NamedTuple):
    """The window of a camera: the rectangle in space that the picture fills.

    Attributes
    ----------
    eye : (3,) float array
        Position of the eye.
    axes : (3, 3) float array
        Unit vectors in rows: to the right and down, along the window's edges, and ahead,
        perpendicular to the window.
    center : (3,) float array
        Vector from the eye to the window's centre, in components along the axes.
    width, height : float
        Size of the window.
    """

    eye: Floats
    axes: Floats
    center: Floats
    width: float
    height: float

    def points(self, x: Floats | float, y: Floats | float) -> Floats:
        """Compute vectors from the eye to points of the window.

        Parameters
        ----------
        x, y : float or (...) float array
            Positions in the window, from (0, 0) at the upper left to (1, 1) at the lower right
            corner.

        Returns
        -------
        vectors : (..., 3) float array
            The vectors, in the coordinate system of the scene.
        """
        right, down, ahead = self.axes
        offset_right = self.center[0] + (np.asarray(x)[..., None] - 0.5) * self.width
        offset_down = self.center[1] + (np.asarray(y)[..., None] - 0.5) * self.height
        vectors: Floats = offset_right * right + offset_down * down + self.center[2] * ahead
        return vectors


def camera_window(camera: Camera) -> Window:
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
        The eye, and the axes, centre and size of the rectangle.
    """
    direction = _normalize(camera.view_dir)
    normal = _normalize(camera.view_dir if camera.proj_normal is None else camera.proj_normal)
    ahead = normal if normal @ direction > 0 else -normal
    right = _normalize(np.cross(ahead, _normalize(camera.view_up)))
    axes = np.array([right, np.cross(ahead, right), ahead])
    center = axes @ direction * camera.proj_distance
    return Window(np.array(camera.view_point), axes, center, camera.view_width, camera.view_height)


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
    scaled = np.asarray(vector) / np.abs(vector).max()  # so that no square over- or underflows
    unit_vector: Floats = scaled / np.linalg.norm(scaled)
    return unit_vector


def bounding_box(surfaces: Surfaces) -> Floats:
    """Compute the axis-aligned bounding box of all surfaces of a scene.

    Parameters
    ----------
    surfaces : Surfaces
        The surfaces: spheres and boxes.

    Returns
    -------
    corners : (2, 3) float array
        The minimum coordinates in the first row, the maximum coordinates in the second.  All are 0
        if there are no surfaces.
    """
    radius = surfaces.radius[:, None]
    low = np.concatenate([surfaces.center - radius, surfaces.min_pt])
    high = np.concatenate([surfaces.center + radius, surfaces.max_pt])
    return np.array([low.min(axis=0), high.max(axis=0)]) if len(low) else np.zeros((2, 3))


def visible_points(scene: Scene) -> Floats:
    """Sample points of the visible surfaces of a scene.

    Rays are traced through a regular grid of positions in the picture.  The grid is refined up to
    two times, until at least `_MIN_VISIBLE_POINTS` rays hit a surface.

    Parameters
    ----------
    scene : Scene
        The scene, with its camera.

    Returns
    -------
    points : (n, 3) float array
        The points where the rays of the last grid hit surfaces; n = 0 if all rays miss.
    """
    for ray_count in _RAYS_PER_SIDE:
        y, x = (np.indices((ray_count, ray_count)).reshape(2, -1) + 0.5) / ray_count
        hits = first_hits(scene, x * scene.width, y * scene.height)
        points: Floats = hits.point[hits.surface >= 0]
        if len(points) >= _MIN_VISIBLE_POINTS:
            break
    return points
