"""Render pictures with many samples per pixel, and measure errors against reference pictures."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated as Shaped

import numpy as np

from reference.judges.arrays import Floats
from tracer import Scene, render


def compute_rms_error(
    image: Shaped[Floats, "height width 3"], reference_image: Shaped[Floats, "height width 3"]
) -> float:
    """Compute the root mean square error of an image over all pixels and channels."""
    return float(np.sqrt(np.mean((image - reference_image) ** 2)))


def render_supersampled(scene: Scene, grid_side: int) -> Shaped[Floats, "height width 3"]:
    """Render a scene with a uniform grid of `grid_side` times `grid_side` samples in each pixel.

    The samples are the pixels of a picture that is `grid_side` times as wide and high.
    """
    width, height = scene.width, scene.height
    samples = render(replace(scene, width=width * grid_side, height=height * grid_side))
    samples_by_pixel = samples.reshape(height, grid_side, width, grid_side, 3)
    return np.asarray(samples_by_pixel.mean(axis=(1, 3)))
