"""What may cast shadows, and the lights."""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tracer.arrays import Bools, Floats, each, pick
from tracer.shadow.grid import SLACK, LightGrid, light_grid
from tracer.view.view import View

__all__ = ["Occluders", "occluders_of"]

# Pixels across a packet, as a part of the side of the square of pixels that each object has if all
# share the picture evenly.
_PART = 0.75


class Occluders(NamedTuple):
    """All objects, spheres first, as what may cast shadows, and the lights.

    Attributes
    ----------
    view : View
    lights : (lights, 3)
    side : (lights, n)
        Where each light is to each object: `OUTSIDE` or `INSIDE`, of spheres also `ON`.
    near_light : (lights, n)
        Whether each light may be so near to each object that `Spheres.touches` holds for it.
    slack : (n,)
        More than rounding can displace a point on each object.
    grid : LightGrid, or None if nothing can be shaded
    across : float
        How many pixels packets may have across.
    """

    view: View
    lights: Floats
    side: NDArray[np.int8]
    near_light: Bools
    slack: Floats
    grid: LightGrid | None
    across: float


def occluders_of(view: View, lights: Floats) -> Occluders:
    """Gather spheres and boxes, and lights (n, 3)."""
    shapes, raster = (view.spheres, view.boxes), view.raster
    slack = SLACK * (np.concatenate([shape.size for shape in shapes]) + np.abs(raster.eye).sum())
    # A row for each light, a column for each object.
    point = each(lambda m: m[:, None], pick(lights.T, slice(None)))
    around = slack + SLACK * np.abs(lights).sum(axis=1)[:, None]
    both = [(shape, shape.first + np.arange(shape.count)) for shape in shapes]
    # Packets lie along rows: more pixels across make them longer, more rows only more numerous.
    pixels = raster.width * raster.height * sqrt(raster.step_v / raster.step_u)
    return Occluders(
        view=view,
        lights=lights,
        side=np.concatenate([shape.side(own, point) for shape, own in both], axis=1),
        near_light=np.concatenate(
            [shape.touches(own, point, around[:, own]) for shape, own in both], axis=1
        ),
        slack=slack,
        grid=light_grid(
            lights, view.surfaces, slack, view.frames.in_picture(raster), ~view.repeated
        ),
        across=_PART * sqrt(pixels / max(slack.size, 1)),
    )
