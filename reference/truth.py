"""The true picture of a scene: many samples in every pixel, traced one by one, and kept."""

from __future__ import annotations

import hashlib
import math
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from reference.command import built
from reference.workloads import to_xml
from tracer import Scene
from tracer.arrays import Floats
from tracer.picture.rendering import render_each
from tracer.scene.schema import MAX_PIXELS

__all__ = ["Truth", "supersampled", "truth_side"]

# About how many pixels of a picture the error is measured over.
_PIXELS = 1 << 15


def truth_side(quick: bool) -> int:
    """Samples a side of the pixel that count as the truth; odd, like no method's."""
    return 17 if quick else 129


def supersampled(
    scene: Scene,
    side: int,
    offset: tuple[float, float] = (0.0, 0.0),
    *,
    processes: int | None = None,
) -> Floats:
    """`side` x `side` samples spread evenly over every pixel, by brute force.

    They are the pixels of a picture `side` times as large, rendered at one
    sample a pixel and averaged; of several smaller ones, where that is too large.
    `offset` and `processes`: see `tracer.render`.
    """
    width, height = scene.width, scene.height
    apart = 1
    while width * height * (side // apart) ** 2 > MAX_PIXELS:
        apart *= 2
    if side % apart:
        raise ValueError(f"{side} x {side} samples cannot be split into parts of {apart}")
    step = side // apart
    large = replace(scene, width=width * step, height=height * step)
    total = np.zeros((height, width, 3))

    def sums_across(band: Floats) -> Floats:
        sums: Floats = band.reshape(len(band), width, step, 3).sum(axis=2)
        return sums

    shifts = ((np.arange(apart) + 0.5) / apart - 0.5).tolist()
    for dx, dy in product(shifts, shifts):
        moved = (dx + step * offset[0], dy + step * offset[1])
        top = 0
        for sums in render_each(large, sums_across, processes=processes, offset=moved):
            np.add.at(total, (top + np.arange(len(sums))) // step, sums)
            top += len(sums)
    return total / side**2


@dataclass(frozen=True, slots=True)
class Truth:
    """Some rows of a converged picture."""

    rows: slice
    radiance: Floats

    @classmethod
    def of(cls, scene: Scene, side: int) -> Truth:
        """`supersampled` rows, kept in the build folder for the next time."""
        apart = math.ceil(scene.width * scene.height / _PIXELS)
        rows = slice(apart // 2, None, apart)
        name = hashlib.sha256(f"{side} {rows} {to_xml(scene)}".encode()).hexdigest()[:16]
        path = built(f"truth-{name}.npy")
        if not path.exists():
            window = replace(scene.camera, view_height=scene.camera.view_height / scene.height)
            row = replace(scene, height=1, camera=window)
            middle = (scene.height - 1) / 2
            picture = [
                supersampled(row, side, offset=(0.0, y - middle)) for y in range(scene.height)[rows]
            ]
            np.save(path, np.concatenate(picture))
        return cls(rows, np.load(path))

    def error(self, image: Floats) -> float:
        """Root mean square of the difference."""
        return float(np.sqrt(np.mean((image[self.rows] - self.radiance) ** 2)))
