"""Changes of a scene, or of how it is rendered, that change no picture."""

from dataclasses import replace

import numpy as np
import pytest
from probe import EPS, scale_and_shift
from random_scenes import KINDS, random_scene

from tracer import Lambertian, Scene, render
from tracer.antialias import refine
from tracer.picture import tiles
from tracer.picture.render_job import RenderJob

pytestmark = [
    pytest.mark.usefixtures("pixels_are_split"),
    pytest.mark.parametrize("kind", KINDS),
    pytest.mark.parametrize("samples", [1, 16]),
]


def random_scenes_of(kind: str, samples: int) -> list[Scene]:
    """Return random scenes of a kind: only one, of few pixels, if it has a thousand objects."""
    if kind == "crowd":
        return [random_scene(kind, 0, 11, 8)]
    seeds = (0, 1, 2, 18) if samples == 1 else (0, 18)
    return [random_scene(kind, seed, 31, 23) for seed in seeds]


def test_scale(kind, samples):
    for scene in random_scenes_of(kind, samples):
        image = render(scene, samples)
        # Multiplication by a power of two is exact, as long as no square leaves the range.
        for power in (-200, -1, 40, 200):
            assert np.array_equal(render(scale_and_shift(scene, 2.0**power), samples), image), power


def test_duplicates(kind, samples):
    for scene in random_scenes_of(kind, samples):
        duplicated = replace(scene, surfaces=[*scene.surfaces] * 2)
        assert np.array_equal(render(duplicated, samples), render(scene, samples))


def test_order_of_lights(kind, samples):
    for scene in random_scenes_of(kind, samples):
        reversed_lights = replace(scene, lights=scene.lights[::-1])
        # A sum of three positive terms has two rounding errors in either order.
        np.testing.assert_allclose(
            render(reversed_lights, samples),
            render(scene, samples),
            rtol=4 * EPS,
            atol=1e-15 * (samples > 1),
        )


def may_have_ties(kind: str, scene: Scene) -> bool:
    """Return whether the inner side of the floor may be visible, with objects that stand on it."""
    return kind in ("touching", "duplicated") and -1 <= scene.camera.view_point[1] <= 0


def test_order_of_surfaces_and_size_of_batches(kind, samples, monkeypatch):
    # If surfaces are at the same distance, the first in the file is visible.  So that the order
    # does not matter, all surfaces get one shader here.
    rng, shader = np.random.default_rng(1), Lambertian(diffuse=(0.9, 0.5, 0.1))
    scenes = [scene for scene in random_scenes_of(kind, samples) if not may_have_ties(kind, scene)]
    assert scenes
    for scene in scenes:
        surfaces = [replace(surface, shader=shader) for surface in scene.surfaces]
        image = render(replace(scene, surfaces=surfaces), samples)
        order = rng.permutation(len(surfaces)).tolist()
        shuffled = replace(scene, surfaces=[surfaces[i] for i in order])
        assert np.array_equal(render(shuffled, samples), image)
        with monkeypatch.context() as context:
            for tile_size, batch_size in ((15, 200), (20, refine._SAMPLES_PER_BATCH)):
                context.setattr(tiles, "_MAX_TILE_SAMPLES", tile_size)
                assert len(RenderJob(shuffled, samples).work.divide(None)) > 1
                context.setattr(refine, "_SAMPLES_PER_BATCH", batch_size)
                assert np.array_equal(render(shuffled, samples), image)
