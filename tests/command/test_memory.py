"""Memory is kept from tile to tile and from picture to picture, and is bounded."""

from __future__ import annotations

import pickle
import platform
import resource
import subprocess
import sys
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from probe import scene_of

from tracer import Box, Camera, Phong, PointLight, Sphere, render


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


RENDER = "import pickle, sys, tracer; tracer.render(*pickle.load(sys.stdin.buffer))"

# A process starts out with its parent's peak: one that is small stands between.
WATCH = """
import resource, subprocess, sys
subprocess.run(sys.argv[1:], check=True)
print(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss)
"""


def heavy() -> Iterator[Any]:
    """Scenes, and numbers of samples, with many pairs of a light and a sample."""
    rng = np.random.default_rng(0)
    lamps = [PointLight(position=p, intensity=(1e-3,) * 3) for p in rng.normal(0, 9, (3000, 3))]
    for count, samples in ((3000, 1), (500, 4)):
        scene = scene_of(Sphere(center=(0, 0, -3)), size=(200, 200), lights=lamps[:count])
        yield pytest.param(scene, samples, id=f"{count} lights")


@pytest.mark.parametrize(("scene", "samples"), [*heavy()])
def test_memory_is_bounded(scene, samples):
    command = [sys.executable, "-c", WATCH, sys.executable, "-c", RENDER]
    given = pickle.dumps((scene, samples))
    ran = subprocess.run(command, input=given, capture_output=True, check=True, timeout=300)
    # In kibibytes on Linux, in bytes on macOS.
    assert int(ran.stdout) * (1 if sys.platform == "darwin" else 1024) < 250e6
