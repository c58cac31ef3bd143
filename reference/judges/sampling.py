"""Pictures that are the means of many samples, and their differences from reference pictures."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tracer import Scene, render


def root_mean_square_error(
    image: NDArray[np.float64], reference_image: NDArray[np.float64]
) -> float:
    """Compute the root mean square error of an image.

    Parameters
    ----------
    image, reference_image : (height, width, 3) float arrays
        The image, and the image with which it is compared.

    Returns
    -------
    error : float
        The root of the mean square difference over all pixels and channels.
    """
    return float(np.sqrt(np.mean((image - reference_image) ** 2)))


def render_supersampled(scene: Scene, side: int) -> NDArray[np.float64]:
    """Render a scene with a uniform grid of samples in each pixel.

    The samples are the pixels of a picture that is `side` times as wide and high, which takes
    24 * side**2 bytes of memory per pixel of the result.

    Parameters
    ----------
    scene : Scene
        The scene.
    side : int
        Number of samples along each side of a pixel.

    Returns
    -------
    image : (height, width, 3) float array
        Mean linear RGB radiance of the samples in each pixel.
    """
    samples = render(replace(scene, width=scene.width * side, height=scene.height * side))
    pixels = samples.reshape(scene.height, side, scene.width, side, 3)
    return np.asarray(pixels.mean(axis=(1, 3)))
