"""What may change in a scene, or in how it is rendered, without changing the picture."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from probe import EPS, scale_and_shift
from random_scenes import KINDS, random_scene

from tracer import Lambertian, Scene, render
from tracer.antialias import refine as antialias
from tracer.picture import render as render_module


def scenes_of(kind: str, samples: int) -> Iterator[Scene]:
    """Random scenes of a kind; only one, of a few pixels, with a thousand objects."""
    if kind == "crowd":
        return iter([random_scene(kind, 0, 11, 8)])
    return (
        random_scene(kind, seed, 31, 23) for seed in ((0, 1, 2, 18) if samples == 1 else (0, 18))
    )


def untied(kind: str, scene: Scene) -> bool:
    """Whether nobody sees the floor's inner side, which ties with what stands on it."""
    return kind not in ("touching", "duplicated") or not -1 <= scene.camera.view_point[1] <= 0


@pytest.mark.usefixtures("pixels_are_split")
@pytest.mark.parametrize("samples", [1, 16])
@pytest.mark.parametrize("kind", KINDS)
def test_the_picture_stays_the_same(kind, samples, monkeypatch):
    rng, shader = np.random.default_rng(1), Lambertian(diffuse=(0.9, 0.5, 0.1))
    scenes = [*scenes_of(kind, samples)]
    assert any(untied(kind, scene) for scene in scenes)
    for scene in scenes:
        image = render(scene, samples)
        # Powers of two commute with every rounding, as long as no square leaves the range.
        for power in (-200, -1, 40, 200):
            assert np.array_equal(render(scale_and_shift(scene, 2.0**power), samples), image), power
        twice = replace(scene, surfaces=[*scene.surfaces[:]] * 2)
        assert np.array_equal(render(twice, samples), image)
        # Three terms, all positive: two roundings each way.
        backward = replace(scene, lights=scene.lights[::-1])
        np.testing.assert_allclose(render(backward, samples), image, 4 * EPS, 1e-15 * (samples > 1))
        if samples == 1 and kind in ("scattered", "rooms", "enormous", "far"):
            # Where nothing coincides, the order of objects matters nothing even to colours.
            assert np.array_equal(render(replace(scene, surfaces=scene.surfaces[::-1])), image)
        if not untied(kind, scene):
            continue
        # Elsewhere exact ties go to the first: all have one shader.  Of edges in one place any may
        # be found first; the cells of a large tile are split and sampled some at a time.
        surfaces = [replace(surface, shader=shader) for surface in scene.surfaces]
        image = render(replace(scene, surfaces=surfaces), samples)
        order = rng.permutation(len(surfaces)).tolist()
        shuffled = replace(scene, surfaces=[surfaces[i] for i in order])
        assert np.array_equal(render(shuffled, samples), image)
        with monkeypatch.context() as parts:
            for tile, chunk in ((25, 200), (100, antialias._SAMPLES_PER_BATCH)):
                parts.setattr(render_module, "_MAX_TILE_SAMPLES", tile)
                parts.setattr(antialias, "_SAMPLES_PER_BATCH", chunk)
                assert np.array_equal(render(shuffled, samples), image)
