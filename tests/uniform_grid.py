"""The uniform grid: samples in rows and columns, which antialiasing is held against."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache
from unittest import mock

import numpy as np

from tracer import Scene, render, rendering
from tracer.arrays import Floats
from tracer.rendering import render_bands


@cache
def uniform(scene: Scene, per_side: int) -> Floats:
    """The mean of a grid of samples in every pixel: a picture as many times as large.

    Kept for the next test: nothing that antialiasing does, or leaves out there, changes it.
    """
    width, height = per_side * scene.width, per_side * scene.height
    # A few of its rows at a time.
    rows = per_side * max(1, 50_000 // (per_side * width))
    fine = replace(scene, width=width, height=height)
    with mock.patch.object(rendering, "_BAND_SAMPLES", rows * width):
        bands = render_bands(fine, threads=1)
        return np.concatenate(
            [b.reshape(-1, per_side, scene.width, per_side, 3).mean(axis=(1, 3)) for b in bands]
        )


def no_worse_than_the_uniform_grid(
    scene: Scene, times: float = 1, numbers: tuple[int, ...] = (4, 16, 64, 256)
) -> None:
    """RMSE no larger, and the largest error no more than so many times as large."""
    converged = uniform(scene, 41)
    for samples in numbers:
        image, grid = render(scene, samples=samples), uniform(scene, math.isqrt(samples))
        rmse, grid_rmse = (np.sqrt(((x - converged) ** 2).mean()) for x in (image, grid))
        assert rmse <= grid_rmse + 1e-12, samples
        most, grid_most = (np.abs(x - converged).max() for x in (image, grid))
        assert most <= times * grid_most + 1e-12, samples
