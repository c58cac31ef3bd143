"""Memory is kept from band to band, and from picture to picture."""

from __future__ import annotations

import platform
import resource

import pytest
from probe import scene_of

from tracer import Box, Camera, Phong, Sphere, render


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="other C libraries do as they do")
@pytest.mark.parametrize("samples", [1, 4])
def test_a_second_picture_needs_no_fresh_pages(samples):
    # Smooth and bright all over, and as large as a few bands of split pixels.
    ball = Sphere(center=(0, -6, -2), radius=6.5, shader=Phong(specular=(0.5, 0.5, 0.5)))
    floor = Box(min_pt=(-50, -1, -50), max_pt=(50, 0, 50))
    camera = Camera(view_point=(0, 2, 6), view_dir=(0, -0.6, -1), view_width=0.4, view_height=0.2)
    scene = scene_of(ball, floor, camera=camera, size=(1024, 768), lights=(3, 5, 4))
    for _ in range(2):
        render(scene, samples=samples)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    image = render(scene, samples=samples)
    faults = resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before
    # Memory for the picture itself may be fresh, whether in large pages or in small ones.
    assert faults * resource.getpagesize() < 2 * image.nbytes
