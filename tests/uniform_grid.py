"""The uniform grid: samples in rows and columns, which antialiasing is held against."""

import math
from functools import cache

import numpy as np

from reference.judges.true_picture import rmse, supersampled, true_picture
from tracer import Scene, render
from tracer.arrays import Floats

TRUE = 1 / 1024
"""The certified error of pictures that others are held against."""


@cache
def uniform(scene: Scene, per_side: int) -> Floats:
    """The mean of a grid of samples in every pixel, by this process alone.

    Kept for the next test: nothing that antialiasing does, or leaves out there, changes it.
    """
    return supersampled(scene, per_side)


def true_means(scene: Scene) -> Floats:
    """The means of pixels as certified; where that cannot be, of a fine grid."""
    try:
        known = true_picture(scene, TRUE)
    except ValueError:  # as with the eye on a surface
        return uniform(scene, 41)
    # Through a lens too long for certificates all stays unknown.
    return (
        known.image if np.ptp([known.low, known.high], axis=0).max() < 0.1 else uniform(scene, 41)
    )


def no_worse_than_the_uniform_grid(
    scene: Scene, times: float = 1, numbers: tuple[int, ...] = (4, 16, 64, 256)
) -> None:
    """RMSE no larger, and the largest error no more than so many times as large."""
    truth = true_means(scene)
    for samples in numbers:
        image, grid = render(scene, samples), uniform(scene, math.isqrt(samples))
        assert rmse(image, truth) <= rmse(grid, truth) + 1e-12, samples
        assert np.abs(image - truth).max() <= times * np.abs(grid - truth).max() + 1e-12, samples
