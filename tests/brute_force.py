"""The tracer without its culling: every ray against every object, one object at a time.

It replaces all that decides which pairs to test, and nothing else: the same shapes in the same
arithmetic, so that its picture must be the same to the last bit.
"""

from unittest.mock import patch

import numpy as np

from tracer import Scene, render
from tracer.arrays import Bools, Floats, Ints
from tracer.shadow.occluders import Occluders
from tracer.view.view import Shape, View, Visible


def brute_force(scene: Scene) -> Floats:
    """The picture (height, width, 3) of a scene, by all pairs."""
    with (
        patch("tracer.view.samples.spans", _all_rows),
        patch("tracer.light.lighting.occlusion", _all_occluders),
    ):
        return render(scene, processes=1)


def _all_rows(
    shape: Shape, view: View, rows: Floats, columns: tuple[float, float], **_: float
) -> tuple[Ints, Ints, Floats, Floats]:
    """Every object covers every row."""
    row, owner = np.indices((rows.size, shape.count)).reshape(2, -1)
    left, right = np.full((row.size, 2), columns).T
    return owner + shape.first, row, left, right


@np.errstate(all="ignore")
def _all_occluders(occluders: Occluders, hits: Visible, frontlit: Bools) -> Bools:
    """See `occlusion`: every object may come between."""
    blocked, own = np.zeros_like(frontlit), hits.own
    for light, lit, dark in zip(occluders.lights, frontlit, blocked, strict=True):
        for shape in occluders.view.shapes:
            for owner in range(shape.first, shape.first + shape.count):
                at = np.flatnonzero(lit & ~dark & (own != owner))
                end = tuple(np.full((3, at.size), light[:, None]))
                every, closely = np.full(at.size, owner), np.ones(at.size, dtype=bool)
                eye, p = occluders.view.raster.eye, hits.points(at)
                dark[at] = shape.occludes(eye, every, p, end, closely)
    return blocked
