"""What may change in a scene, or in how it is rendered, without changing the picture."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np
import pytest
from judge import judge
from numpy.typing import NDArray
from probe import EPS, moved
from random_scenes import KINDS, random_scene

from tracer import Box, Lambertian, PointLight, Scene, Sphere, render
from tracer.antialias import refine as antialias
from tracer.picture import bands


def scenes_of(kind: str, count: int) -> Iterator[Scene]:
    """Random scenes of a kind; only one, of a few pixels, with a thousand objects."""
    if kind == "crowd":
        return iter([random_scene(kind, 0, 11, 8)])
    return (random_scene(kind, seed, 31, 23) for seed in range(count))


@pytest.mark.parametrize("kind", KINDS)
def test_scaled_by_a_power_of_two(kind: str) -> None:
    # Powers of two commute with every rounding, as long as no square leaves the range.
    for scene in scenes_of(kind, 3):
        image = render(scene)
        for power in (-200, -40, -1, 3, 40, 200):
            assert np.array_equal(render(moved(scene, 2.0**power)), image)


@pytest.mark.parametrize("kind", KINDS)
def test_antialiased_and_scaled_by_a_power_of_two(
    kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(antialias, "dense", lambda *_: False)
    for scene in scenes_of(kind, 2):
        image = render(scene, samples=16)
        for power in (-200, 40, 200):
            assert np.array_equal(render(moved(scene, 2.0**power), samples=16), image)


@pytest.mark.parametrize("kind", ["scattered", "touching", "nested", "rooms", "walled"])
@pytest.mark.parametrize("shift", [(1e6, -1e6, 1e6), (0, 1e6, 0)])
def test_shifted(kind: str, shift: tuple[float, float, float]) -> None:
    # The shift rounds the scene itself, so the oracle judges the one that is rendered.
    for seed in range(3):
        judged = judge(moved(random_scene(kind, seed, width=7, height=5), 1, shift))
        assert not judged.wrong(3e-14)
        assert judged.sure.mean() > 0.9


def untied(kind: str, scenes: Iterable[Scene]) -> list[Scene]:
    """Those in which nobody sees the floor's inner side, which ties with what stands on it."""
    ties = kind in ("touching", "duplicated")
    some = [m for m in scenes if not (ties and -1 <= m.camera.view_point[1] <= 0)]
    assert some
    return some


def in_order(scene: Scene, order: NDArray[np.intp]) -> Scene:
    """The same objects in some order, all of one shader: exact ties go to the first."""
    shader = Lambertian(diffuse=(0.9, 0.5, 0.1))
    surfaces = [replace(scene.surfaces[i], shader=shader) for i in order.tolist()]
    return replace(scene, surfaces=surfaces)


@pytest.mark.parametrize("kind", KINDS)
def test_objects_in_another_order(kind: str) -> None:
    rng = np.random.default_rng(1)
    for scene in untied(kind, scenes_of(kind, 5)):
        image = render(in_order(scene, np.arange(len(scene.surfaces))))
        assert np.array_equal(render(in_order(scene, rng.permutation(len(scene.surfaces)))), image)


@pytest.mark.parametrize("kind", ["scattered", "rooms", "enormous", "far"])
def test_shaders_follow_their_objects(kind: str) -> None:
    # Where nothing coincides, the order matters nothing even to colours.
    for scene in scenes_of(kind, 4):
        backward = replace(scene, surfaces=scene.surfaces[::-1])
        assert np.array_equal(render(backward), render(scene))


def test_first_of_equals_is_seen() -> None:
    # Coplanar faces and equal balls: the exact tie goes to the first in the file.
    red, green = Lambertian(diffuse=(1, 0, 0)), Lambertian(diffuse=(0, 1, 0))
    for a, b in (
        (Sphere(shader=red), Sphere(shader=green)),
        (
            Box(min_pt=(-2, -2, -3), max_pt=(2, 2, 1), shader=red),
            Box(min_pt=(-2, -2, -1), max_pt=(2, 2, 1), shader=green),
        ),
    ):
        scene = random_scene("scattered", 0)
        camera = replace(scene.camera, view_point=(0, 0, 9), view_dir=(0, 0, -1), proj_normal=None)
        scene = replace(scene, camera=camera, lights=(PointLight(position=(0, 0, 9)),))
        first = render(replace(scene, surfaces=[a, b]))
        second = render(replace(scene, surfaces=[b, a]))
        assert first.any()
        assert np.array_equal(first, second[:, :, [1, 0, 2]])
        assert not first[:, :, 1].any()


@pytest.mark.parametrize("kind", KINDS)
def test_lights_in_another_order(kind: str) -> None:
    for scene in scenes_of(kind, 4):
        backward = render(replace(scene, lights=scene.lights[::-1]))
        # Three terms, all positive: two roundings each way.
        np.testing.assert_allclose(backward, render(scene), rtol=4 * EPS, atol=0)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(("samples", "tile"), [(1, 1), (1, 40), (9, 100)])
def test_cut_into_tiles_for_processes(
    kind: str, samples: int, tile: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = random_scene(kind, 5, *((5, 4) if tile == 1 else (15, 11)))
    image = render(scene, samples, processes=1)
    monkeypatch.setattr(bands, "_TILE_SAMPLES", tile)
    monkeypatch.setattr(bands, "processors", lambda: 3)
    for processes in (1, 3):
        assert np.array_equal(render(scene, samples, processes=processes), image)


@pytest.mark.usefixtures("pixels_are_split")
@pytest.mark.parametrize("kind", KINDS)
def test_antialiased_in_another_order_and_in_tiles(
    kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Of edges in one place any may be found first.
    rng = np.random.default_rng(1)
    size = (12, 8) if kind == "crowd" else (36, 24)
    for scene in untied(kind, (random_scene(kind, seed, *size) for seed in (0, 18))):
        image = render(in_order(scene, np.arange(len(scene.surfaces))), 16, processes=1)
        shuffled = in_order(scene, rng.permutation(len(scene.surfaces)))
        assert np.array_equal(render(shuffled, 16, processes=1), image)
        with monkeypatch.context() as small:
            small.setattr(bands, "_TILE_SAMPLES", 25)
            assert np.array_equal(render(shuffled, 16, processes=1), image)


@pytest.mark.usefixtures("pixels_are_split")
def test_chunks(monkeypatch: pytest.MonkeyPatch) -> None:
    # The cells of a large band are split and sampled some at a time.
    for seed in range(3):
        scene = random_scene("scattered", seed, 36, 24)
        image = render(scene, 16, processes=1)
        with monkeypatch.context() as chunks:
            chunks.setattr(antialias, "_CHUNK", 200)
            assert np.array_equal(render(scene, 16, processes=1), image)
