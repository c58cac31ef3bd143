"""The camera as the scene file describes it, and what it sees: shares no code with the tracer.

The tracer's own camera is judged by pictures that are made with this one.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from tracer import Camera, Scene, Surfaces

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


@np.errstate(all="ignore")
def visible_points(scene: Scene) -> Floats:
    """Points (n, 3) that rays spread evenly over the picture hit: a dozen or more if they can."""
    window = window_of(scene.camera)
    points = np.zeros((0, 3))
    for grid in _GRIDS:
        places = (np.arange(grid) + 0.5) / grid
        points = np.concatenate([_hit_in_row(scene.surfaces, window, places, y) for y in places])
        if len(points) >= _GRIDS[0]:
            break
    return points


def _hit_in_row(surfaces: Surfaces, window: Window, x: Floats, y: float) -> Floats:
    """Points (n, 3) that the rays through a row of the window hit first."""
    d = window.points(x, y)
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    # These rays lie in one plane; what it misses, none of them meets.
    normal = _unit(np.cross(window.axes[0], d[0]))
    center, low, high = (
        points - window.eye for points in (surfaces.center, surfaces.min_pt, surfaces.max_pt)
    )
    balls = np.abs(center @ normal) <= surfaces.radius * 1.001
    boxes = np.abs((low + high) @ normal) <= (high - low) @ np.abs(normal) * 1.001
    center, radius = center[balls], surfaces.radius[balls]
    distance = np.linalg.norm(center, axis=1)
    outside = (distance - radius) * (distance + radius)
    middle = d @ center.T
    root = np.sqrt(middle**2 - outside)  # no number where the ray misses
    spheres = np.where(outside > 0, middle - root, middle + root)
    a, b = low[boxes] / d[:, None], high[boxes] / d[:, None]
    enters, leaves = np.minimum(a, b).max(axis=2), np.maximum(a, b).min(axis=2)
    slabs = np.where(enters <= leaves, np.where(enters > 0, enters, leaves), np.nan)
    t = np.concatenate([spheres, slabs], axis=1)
    t = np.where(t > 0, t, np.inf).min(axis=1, initial=np.inf)
    points: Floats = window.eye + (t[:, None] * d)[np.isfinite(t)]
    return points
