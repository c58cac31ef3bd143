"""The true picture of a scene: many samples in every pixel, traced one by one, and kept."""

from __future__ import annotations

import hashlib
import io
import math
import warnings
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

import tracer
from reference.command import built
from tracer import Scene, SceneWarning, render, save_scene

__all__ = ["Truth", "supersampled", "truth_side"]

# About how many pixels of a picture the error is measured over, and samples rendered at once.
_PIXELS, _STRIP = 1 << 15, 1 << 22


def truth_side(quick: bool) -> int:
    """Samples a side of the pixel that count as the truth; odd, like no method's."""
    return 17 if quick else 129


def supersampled(
    scene: Scene, side: int, row: int = 0, count: int | None = None
) -> NDArray[np.float64]:
    """Average `side` x `side` samples spread evenly over every pixel, by brute force.

    They are the pixels of a picture `side` times as large, rendered at one sample a pixel, strip
    by strip: of the whole picture, or of `count` rows from `row` on.
    """
    strips, camera, end = [], scene.camera, scene.height if count is None else row + count
    rows = max(1, _STRIP // (scene.width * side**2))
    for top in range(row, end, rows):
        height = min(rows, end - top)
        window = replace(camera, view_height=camera.view_height * height / scene.height)
        large = replace(scene, width=scene.width * side, height=height * side, camera=window)
        below = (top + height / 2 - scene.height / 2) * side
        with warnings.catch_warnings():  # a strip may well be black
            warnings.simplefilter("ignore", SceneWarning)
            image = render(large, offset=(0, below))
        strips.append(image.reshape(height, side, scene.width, side, 3).mean(axis=(1, 3)))
    return np.concatenate(strips)


@cache
def _code() -> bytes:
    """A hash of the tracer's code, which decides what samples are."""
    paths = sorted(Path(tracer.__file__).parent.rglob("*.py"))
    return hashlib.sha256(b"".join(path.read_bytes() for path in paths)).digest()


class Truth(NamedTuple):
    """Some rows of a converged picture."""

    rows: slice
    radiance: NDArray[np.float64]

    @classmethod
    def of(cls, scene: Scene, side: int) -> Truth:
        """Sample rows, or read them where the same code has sampled them before."""
        apart = math.ceil(scene.width * scene.height / _PIXELS)
        rows = slice(apart // 2, None, apart)
        save_scene(scene, text := io.BytesIO())
        key = hashlib.sha256(f"{side} {rows}".encode() + text.getvalue() + _code()).hexdigest()
        path = built(f"truth-{key[:16]}.npy")
        if not path.exists():
            picture = [supersampled(scene, side, y, 1) for y in range(scene.height)[rows]]
            np.save(path, np.concatenate(picture))
        return cls(rows, np.load(path))

    def error(self, image: NDArray[np.float64]) -> float:
        """Root mean square of the difference."""
        return float(np.sqrt(np.mean((image[self.rows] - self.radiance) ** 2)))
