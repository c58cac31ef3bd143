"""A few points that the camera sees: enough to know where a scene is and how large.

Mitsuba computes in float32, so its accuracy depends on where a scene lies and how large it is; and
its point lights fall off, so their strength can be right at one distance only.
"""

from __future__ import annotations

import numpy as np

from tracer.antialias.lattice import CENTRES
from tracer.arrays import Floats
from tracer.scene.model import Scene, Surfaces
from tracer.view.camera import Raster, raster_of
from tracer.view.view import view_of
from tracer.view.visibility import visible

__all__ = ["bounds", "visible_points", "window_point"]

# Rays across the picture and down: the next finer grid is used where one hits too little.
_GRIDS = 12, 48, 192


def bounds(surfaces: Surfaces) -> Floats:
    """Corners (2, 3) of a box around all surfaces; the origin where there is none."""
    radius = surfaces.radius[:, None]
    low = np.concatenate([surfaces.center - radius, surfaces.min_pt])
    high = np.concatenate([surfaces.center + radius, surfaces.max_pt])
    return np.array([low.min(axis=0), high.max(axis=0)]) if len(low) else np.zeros((2, 3))


@np.errstate(all="ignore")
def visible_points(scene: Scene) -> Floats:
    """What rays spread evenly over the picture hit: points (n, 3), a dozen or more if they can."""
    points = np.zeros((0, 3))
    for grid in _GRIDS:
        view = view_of(raster_of(scene.camera, grid, grid), scene.surfaces)
        hits = visible(view, CENTRES.samples(slice(0, grid), slice(0, grid)))
        points = np.stack(hits.points(slice(None)), axis=1)
        if len(points) >= _GRIDS[0]:
            break
    return points


def window_point(raster: Raster, column: float, row: float) -> Floats:
    """Vector (3,) from the eye to a point of the window, given in pixels of the picture."""
    across, down = raster.across(np.asarray(column)), raster.down(np.asarray(row))
    point: Floats = np.array([across, down, raster.depth]) @ raster.axes
    return point
