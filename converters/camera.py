"""The camera as the scene file describes it, and the part of the scene that it sees.

The tracer's own camera is judged by pictures that are made with this one: they share no code.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from tracer import Camera, Scene, Surfaces, first_hits

__all__ = ["Floats", "Window", "bounds", "visible_points", "window_of"]

Floats: TypeAlias = NDArray[np.float64]

# Rays across the picture and down: the next finer grid is used where one hits too little.
_GRIDS = 12, 48, 192


class Window(NamedTuple):
    """A window seen from the eye.

    `axes` (3, 3) are unit vectors to the right and down along its edges, and ahead through it;
    `center` (3,) leads from the eye to its middle, along these.
    """

    eye: Floats
    axes: Floats
    center: Floats
    width: float
    height: float

    def points(self, x: Floats | float, y: Floats | float) -> Floats:
        """Vectors (..., 3) from the eye to points of the window: 0, 0 is its upper left corner."""
        right, down, ahead = self.axes
        across = self.center[0] + (np.asarray(x)[..., None] - 0.5) * self.width
        below = self.center[1] + (np.asarray(y)[..., None] - 0.5) * self.height
        vectors: Floats = across * right + below * down + self.center[2] * ahead
        return vectors


def window_of(camera: Camera) -> Window:
    """The window of a camera (Shirley, Fundamentals of Computer Graphics, 2nd ed., 10.2)."""
    direction = _unit(camera.view_dir)
    normal = _unit(camera.view_dir if camera.proj_normal is None else camera.proj_normal)
    ahead = normal if normal @ direction > 0 else -normal
    right = _unit(np.cross(ahead, _unit(camera.view_up)))
    axes = np.array([right, np.cross(ahead, right), ahead])
    center = axes @ direction * camera.proj_distance
    return Window(np.array(camera.view_point), axes, center, camera.view_width, camera.view_height)


def _unit(vector: Sequence[float] | Floats) -> Floats:
    """Unit vector (3,); scaled first, so that no square over- or underflows."""
    scaled = np.asarray(vector) / np.abs(vector).max()
    unit: Floats = scaled / np.linalg.norm(scaled)
    return unit


def bounds(surfaces: Surfaces) -> Floats:
    """Corners (2, 3) of a box around all surfaces; the origin where there is none."""
    radius = surfaces.radius[:, None]
    low = np.concatenate([surfaces.center - radius, surfaces.min_pt])
    high = np.concatenate([surfaces.center + radius, surfaces.max_pt])
    return np.array([low.min(axis=0), high.max(axis=0)]) if len(low) else np.zeros((2, 3))


def visible_points(scene: Scene) -> Floats:
    """Points (n, 3) that rays spread evenly over the picture hit: a dozen or more if they can.

    They tell how large a scene is and where, which changes no picture.
    """
    for grid in _GRIDS:
        y, x = (np.indices((grid, grid)).reshape(2, -1) + 0.5) / grid
        found = first_hits(scene, x * scene.width, y * scene.height)
        points: Floats = found.point[found.surface >= 0]
        if len(points) >= _GRIDS[0]:
            break
    return points
