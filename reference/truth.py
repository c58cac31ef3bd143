"""The true picture of a scene: many samples in every pixel, traced one by one, and kept."""

from __future__ import annotations

import hashlib
import math
from dataclasses import dataclass, replace

import numpy as np

from reference.command import built
from reference.workloads import to_xml
from tracer import Scene, render
from tracer.arrays import Floats

__all__ = ["Truth", "supersampled", "truth_side"]

# About how many pixels of a picture the error is measured over.
_PIXELS = 1 << 15

# Samples that are rendered at once.
_STRIP = 1 << 22


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

    They are the pixels of a picture `side` times as large, rendered at one sample a pixel and
    averaged, strip by strip.  `offset` and `processes`: see `tracer.render`.
    """
    strips, camera = [], scene.camera
    rows = max(1, _STRIP // (scene.width * side**2))
    for top in range(0, scene.height, rows):
        height = min(rows, scene.height - top)
        window = replace(camera, view_height=camera.view_height * height / scene.height)
        large = replace(scene, width=scene.width * side, height=height * side, camera=window)
        below = offset[1] + top + height / 2 - scene.height / 2
        image = render(large, processes=processes, offset=(offset[0] * side, below * side))
        strips.append(image.reshape(height, side, scene.width, side, 3).mean(axis=(1, 3)))
    return np.concatenate(strips)


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
