"""A few points that the camera sees: enough to know where a scene is and how large.

Mitsuba computes in float32, so where a scene lies and how large it is decides how well it comes
out; and its point lights fall off, so their strength can be right at one depth only.
"""

from __future__ import annotations

from itertools import product

import numpy as np

from tracer.camera import raster_of
from tracer.scene import Floats, Scene, Surfaces

__all__ = ["bounds", "visible_points"]


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
        direction = np.array([raster.across(column), raster.down(row), raster.depth]) @ raster.axes
        direction /= np.linalg.norm(direction)
        t = _nearest(scene.surfaces, raster.eye, direction)
        if np.isfinite(t):
            found.append(raster.eye + t * direction)
    return np.array(found).reshape(-1, 3)


def _nearest(surfaces: Surfaces, origin: Floats, direction: Floats) -> float:
    """Distance to the first surface along one ray; infinite if there is none."""
    to_center = surfaces.center - origin
    along = to_center @ direction
    aside = to_center - along[:, None] * direction
    chord2 = surfaces.radius**2 - (aside * aside).sum(axis=1)
    half = np.sqrt(np.where(chord2 >= 0, chord2, np.nan))
    with np.errstate(divide="ignore", invalid="ignore"):
        slabs = (np.stack([surfaces.min_pt, surfaces.max_pt]) - origin) / direction
    enter, leave = slabs.min(axis=0).max(axis=1), slabs.max(axis=0).min(axis=1)
    leave = np.where(enter <= leave, leave, np.nan)
    t = np.concatenate([along - half, along + half, enter, leave])
    return float(np.min(t, initial=np.inf, where=t > 0))
