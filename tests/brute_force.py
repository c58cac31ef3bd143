"""The tracer without its culling: every ray against every object, one object at a time.

It replaces all that decides which pairs to test, and nothing else: the same shapes in the same
arithmetic, so that its picture must be the same to the last bit.
"""

from unittest.mock import patch

import numpy as np

from tracer import Scene, render
from tracer.arrays import Bools, Floats, Ints
from tracer.trace.hits import Hits
from tracer.world.prepared_scene import PreparedScene, Shape


def brute_force(scene: Scene) -> Floats:
    """The picture (height, width, 3) of a scene, by all pairs."""
    with (
        patch("tracer.trace.samples.spans", _all_rows),
        patch("tracer.trace.radiance.occlusion", _all_occluders),
    ):
        return render(scene)


def _all_rows(
    shape: Shape, prepared: PreparedScene, rows: Floats, columns: tuple[float, float], **_: float
) -> tuple[Ints, Ints, Floats, Floats]:
    """Every object covers every row."""
    row, obj = np.indices((rows.size, shape.count)).reshape(2, -1)
    left, right = np.full((row.size, 2), columns).T
    return obj + shape.first, row, left, right


@np.errstate(all="ignore")
def _all_occluders(hits: Hits, frontlit: Bools) -> Bools:
    """See `occlusion`: every object may come between."""
    blocked, own, prepared = np.zeros_like(frontlit), hits.hit_object, hits.prepared
    for light, lit, dark in zip(prepared.lights, frontlit, blocked, strict=True):
        for shape in prepared.shapes:
            for obj in range(shape.first, shape.first + shape.count):
                at = np.flatnonzero(lit & ~dark & (own != obj))
                end = tuple(np.full((3, at.size), light[:, None]))
                every, eye, p = np.full(at.size, obj), prepared.frame.eye, hits.points(at)
                dark[at] = shape.occludes(eye, every, p, end, shape.side(every, end))
    return blocked
