"""Render pictures with many samples per pixel, and measure errors against reference pictures."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tracer import Scene, render


def compute_rms_error(image: NDArray[np.float64], reference_image: NDArray[np.float64]) -> float:
    """Compute the root mean square error of an image.

    Parameters
    ----------
    image, reference_image : (height, width, 3) float arrays
        The image, and the image to compare it with.

    Returns
    -------
    error : float
        The square root of the mean squared difference over all pixels and channels.
    """
    return float(np.sqrt(np.mean((image - reference_image) ** 2)))


def render_supersampled(scene: Scene, grid_side: int) -> NDArray[np.float64]:
    """Render a scene with a uniform grid of samples in each pixel.

    The samples are the pixels of a picture that is `grid_side` times as wide and high.

    Parameters
    ----------
    scene : Scene
        The scene.
    grid_side : int
        Number of samples along each side of a pixel's grid.

    Returns
    -------
    image : (height, width, 3) float array
        Mean linear RGB radiance of the samples in each pixel.
    """
    samples = render(replace(scene, width=scene.width * grid_side, height=scene.height * grid_side))
    samples_by_pixel = samples.reshape(scene.height, grid_side, scene.width, grid_side, 3)
    return np.asarray(samples_by_pixel.mean(axis=(1, 3)))
