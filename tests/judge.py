"""The oracle, `reference.judges.plain` in decimals, asked about pictures of the tracer."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from reference.judges.plain import Seen, trace
from tracer import Scene, Sphere, render
from tracer.arrays import Bools, Floats

# Right and down, in pixels: far more than the tracer's rounding, even from 10^8 times as far as
# things are large.  And of radii, which parts what nearly coincides, such as a ground and a floor.
_HAIRS = ((1e-3, 0, 1e-12), (-5e-4, 9e-4, -1e-12), (-5e-4, -9e-4, 1e-12))


class Judged(NamedTuple):
    """All pixels of a picture, row by row."""

    seen: Seen
    error: Floats
    """(n,): the tracer's largest, among the three channels."""
    sure: Bools
    """(n,): whether the same is seen, by the same lights, a hair to each side, and grown by one."""

    def wrong(self, tolerance: float) -> str:
        """Name the sure pixels in which the tracer errs by more; empty if there are none."""
        pixels = np.flatnonzero(self.sure & ~(self.error <= tolerance))
        return "\n".join(f"pixel {k}: {self.error[k]}, {self.seen.surface[k]}" for k in pixels)


def judge(scene: Scene, image: Floats | None = None) -> Judged:
    """Judge the tracer's picture of a scene, or another."""
    image = render(scene) if image is None else image
    y, x = np.indices((scene.height, scene.width)).reshape(2, -1) + 0.5
    seen = trace(scene, x, y, arithmetic="decimal")
    sure = np.ones(x.size, dtype=bool)
    for right, down, more in _HAIRS:
        surfaces = [
            replace(s, radius=s.radius * (1 + more)) if isinstance(s, Sphere) else s
            for s in scene.surfaces
        ]
        grown = replace(scene, surfaces=surfaces)
        near = trace(grown, x + right, y + down, arithmetic="decimal")
        sure &= (near.surface == seen.surface) & (near.lit == seen.lit).all(axis=0)
    error = np.abs(image.reshape(-1, 3) - seen.radiance).max(axis=1)
    return Judged(seen, error, sure)
