"""Highlights narrower than a pixel, of a light that is much nearer than the eye."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from probe import scene_of

from tracer import Box, Camera, Phong, PointLight, render


@pytest.mark.parametrize("right", [0.0, 0.005])
def test_a_highlight_narrower_than_a_pixel(right: float) -> None:
    """Of a fraction of its width: directions to the light turn within one, not to the eye."""
    mirror = Phong(diffuse=(0, 0, 0), specular=(1, 1, 1), exponent=1e4)
    floor = Box(min_pt=(-9, -1, -9), max_pt=(9, 0, 9), shader=mirror)
    down = {"view_point": (0, 5, 0), "view_dir": (0, -1, 0), "view_up": (0, 0, -1)}
    camera = Camera(**down, proj_distance=5, view_width=0.36, view_height=0.36)
    light = PointLight(position=(right + 0.004, 0.2, 0.007))
    scene = scene_of(floor, camera=camera, size=(12, 12), lights=[light])
    fine = render(replace(scene, width=12 * 32, height=12 * 32))
    mean = fine.reshape(12, 32, 12, 32, 3).mean(axis=(1, 3))
    assert mean.max() > 0.08
    assert np.abs(render(scene, samples=64) - mean).max() < 2e-4
