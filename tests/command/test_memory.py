"""Memory is kept from tile to tile and from picture to picture, and is bounded."""

import gc
import pickle
import platform
import resource
import sys

import numpy as np
import pytest
from probe import scene_of
from running import peak_memory

from tracer import Box, Camera, Phong, PointLight, Sphere, render
from tracer.world.prepared_scene import PreparedScene


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="other C libraries do as they do")
@pytest.mark.parametrize("samples", [1, 4])
def test_a_second_picture_needs_no_fresh_pages(samples):
    # Smooth and bright all over, and as large as a few tiles of split pixels.
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


@pytest.mark.parametrize("samples", [1, 4])
def test_what_a_picture_took_is_free_at_once(samples):
    """Not only when Python looks for cycles, many pictures later."""
    scene = scene_of(Sphere(center=(0, 0, -3)), size=(40, 30), lights=(3, 4, 5))

    def prepared() -> int:
        return sum(isinstance(thing, PreparedScene) for thing in gc.get_objects())

    gc.collect()
    before = prepared()
    gc.disable()
    try:
        render(scene, samples)
        assert prepared() == before
    finally:
        gc.enable()


RENDER = "import pickle, sys, tracer; tracer.render(*pickle.load(sys.stdin.buffer))"


@pytest.mark.parametrize(("lights", "samples"), [(3000, 1), (500, 4)])
def test_memory_is_bounded(lights, samples):
    """However many pairs of a light and a sample there are."""
    places = np.random.default_rng(0).normal(0, 9, (lights, 3))
    lamps = [PointLight(position=place, intensity=(1e-3,) * 3) for place in places]
    scene = scene_of(Sphere(center=(0, 0, -3)), size=(200, 200), lights=lamps)
    given = pickle.dumps((scene, samples))
    assert peak_memory(sys.executable, "-c", RENDER, given=given) < 250
