"""A few points that the camera sees: enough to know where a scene is and how large.

Mitsuba computes in float32, so its accuracy depends on where a scene lies and how large it is; and
its point lights fall off, so their strength can be right at one distance only.
"""

from __future__ import annotations

from itertools import product

import numpy as np

from tracer.arrays import Floats
from tracer.camera import Raster, raster_of
from tracer.scene import Scene, Surfaces

__all__ = ["bounds", "nearest", "raster_direction", "visible_points", "window_point"]


def bounds(surfaces: Surfaces) -> Floats:
    """Corners (2, 3) of a box around all surfaces; the origin where there is none."""
    radius = surfaces.radius[:, None]
    low = np.concatenate([surfaces.center - radius, surfaces.min_pt])
    high = np.concatenate([surfaces.center + radius, surfaces.max_pt])
    return np.array([low.min(axis=0), high.max(axis=0)]) if len(low) else np.zeros((2, 3))


def visible_points(scene: Scene, grid: int = 12) -> Floats:
    """What `grid` x `grid` rays spread over the picture hit: points (n, 3), n <= grid^2."""
    raster = raster_of(scene.camera, grid, grid)
    found = []
    for column, row in product(np.arange(grid) + 0.5, repeat=2):
        direction = raster_direction(raster, column, row)
        t, _ = nearest(scene.surfaces, raster.eye, direction)
        if t < np.inf:
            found.append(raster.eye + t * direction)
    return np.array(found).reshape(-1, 3)


def raster_direction(raster: Raster, column: float, row: float) -> Floats:
    """Unit direction (3,) of the ray through a point of the picture, in pixels."""
    direction = window_point(raster, column, row)
    return direction / np.linalg.norm(direction)


def window_point(raster: Raster, column: float, row: float) -> Floats:
    """Vector (3,) from the eye to a point of the window, given in pixels of the picture."""
    across, down = raster.across(np.asarray(column)), raster.down(np.asarray(row))
    point: Floats = np.array([across, down, raster.depth]) @ raster.axes
    return point


def nearest(surfaces: Surfaces, origin: Floats, direction: Floats) -> tuple[float, int]:
    """Distance to the first surface along one ray, and its index in the file.

    Where the ray meets none, the distance is infinite and the index means nothing.
    """
    to_center = surfaces.center - origin
    along = to_center @ direction
    aside = to_center - along[:, None] * direction
    chord2 = surfaces.radius**2 - (aside * aside).sum(axis=1)
    half = np.sqrt(np.where(chord2 >= 0, chord2, np.nan))
    with np.errstate(divide="ignore", invalid="ignore"):
        slabs = (np.stack([surfaces.min_pt, surfaces.max_pt]) - origin) / direction
    enter, leave = slabs.min(axis=0).max(axis=1), slabs.max(axis=0).min(axis=1)
    slab_hits = np.where(enter <= leave, np.stack([enter, leave]), np.nan)
    ahead = np.concatenate([np.stack([along - half, along + half]), slab_hits], axis=1)
    t = np.where(ahead > 0, ahead, np.inf).min(axis=0)
    if not len(t):
        return np.inf, 0
    first = int(t.argmin())
    return float(t[first]), int(surfaces.file_index[first])
