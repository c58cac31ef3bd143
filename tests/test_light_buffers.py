"""Light buffers: what is found around a ball includes what is found at any point of it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from random_objects import a_box, a_point, a_sphere, triple, unit_vectors, vector

from tracer import Camera, Lambertian, PointLight, Scene, Surfaces, render
from tracer.arrays import Floats
from tracer.shadow import grid as light_buffers
from tracer.shadow.grid import _PAIRS, LightBuffer, light_buffer_finder
from tracer.shadow.occluders import Candidates, occluders_of
from tracer.view.camera import raster_of
from tracer.view.view import view_of

WHITE = Lambertian()


def a_buffer(rng: np.random.Generator) -> tuple[Floats, LightBuffer]:
    """A light (3,) and the buffer around it, with some objects."""
    surfaces = Surfaces.of([*(a_sphere(rng) for _ in range(9)), *(a_box(rng) for _ in range(9))])
    camera = Camera(view_point=vector(a_point(rng)), view_dir=vector(unit_vectors(rng, 1)[0]))
    raster = raster_of(camera, 32, 32)
    light = a_point(rng)
    occluders = occluders_of(view_of(raster, surfaces), light[None, :])
    return light, light_buffer_finder(occluders).buffers[0]


@np.errstate(all="ignore")
def test_buffers_of_large_objects_stay_small() -> None:
    """Where thousands of objects overlap no cell is empty, however small it is."""
    rng = np.random.default_rng(1)
    center, light = rng.normal(size=(3000, 3)), np.array([[4.0, 5.0, 6.0]])
    surfaces = Surfaces(
        center=center, radius=np.ones(3000), sphere_shader=np.zeros(3000, int), shaders=[WHITE]
    )
    view = view_of(raster_of(Camera(view_point=(0, 0, 9)), 32, 32), surfaces)
    (buffer,) = light_buffer_finder(occluders_of(view, light)).buffers
    assert buffer.resolution < 100
    assert 3000 < buffer.listed.size < _PAIRS


@np.errstate(all="ignore")
@pytest.mark.parametrize(
    ("far", "ground"),
    [*((10.0**k, 1.0) for k in (7, 9, 11, 13, 20, 40)), (1e9, 6.4e6), (1.5e11, 6.4e6)],
)
def test_buffers_around_suns_list_little(far: float, ground: float) -> None:
    """However far away the light, it sees small objects beside each other."""
    rng = np.random.default_rng(1)
    center = rng.uniform(-1, 1, (1000, 3))
    radius = np.full(1000, 0.02)
    center[0], radius[0] = (0, -ground - 1, 0), ground
    surfaces = Surfaces(
        center=center, radius=radius, sphere_shader=np.zeros(1000, int), shaders=[WHITE]
    )
    view = view_of(raster_of(Camera(view_point=(0, 0, 9)), 32, 32), surfaces)
    lights = np.outer([1e3, far], [0.3, 0.8, 0.5])
    near, sun = light_buffer_finder(occluders_of(view, lights)).buffers
    assert sun.listed.size < 5 * near.listed.size
    for buffer in near, sun:
        assert np.diff(buffer.first).max() < 50


def test_candidates_are_handed_on_some_at_a_time(monkeypatch: pytest.MonkeyPatch) -> None:
    """A crowd in one cell of the light's: memory is not for all pairs at once."""
    center = np.random.default_rng(1).uniform(-2, 2, (300, 3))
    center[0] = (0, -6.4e6 - 2, 0)
    surfaces = Surfaces(
        center=center,
        radius=np.append(6.4e6, np.full(299, 0.2)),
        sphere_shader=np.zeros(300, int),
        shaders=[WHITE],
    )
    scene = Scene(
        camera=Camera(view_point=(0, 1, 6)),
        width=40,
        height=30,
        lights=[PointLight(position=(0.6e11, 1.2e11, 0.7e11))],
        surfaces=surfaces,
    )
    whole = render(scene, 16, processes=1)
    sizes = []
    by_kind = light_buffers.candidates_by_kind

    def counted(*args: Any, **kwargs: Any) -> Iterator[Candidates]:
        sizes.append(kwargs["point"].size)
        return by_kind(*args, **kwargs)

    monkeypatch.setattr(light_buffers, "_AT_ONCE", 1000)
    monkeypatch.setattr(light_buffers, "candidates_by_kind", counted)
    np.testing.assert_array_equal(render(scene, 16, processes=1), whole)
    assert 500 < max(sizes) <= 1000 < sum(sizes)


@np.errstate(all="ignore")
@settings(max_examples=20, deadline=None, derandomize=True)
@given(seed=st.integers(0, 2**32))
def test_cells_of_a_buffer_around_a_ball(seed: int) -> None:
    rng = np.random.default_rng(seed)
    light, buffer = a_buffer(rng)
    middle = np.array([a_point(rng) for _ in range(40)])
    middle[:10] = light + 1e-3 * middle[:10]
    middle[10] = light
    radius = rng.choice([0, 1e-9, 1e-3, 0.1, 1], size=40)
    distance, ball, cell, wide = buffer.around(triple(light - middle), radius)
    pairs = {pair: k for k, pair in enumerate(zip(ball.tolist(), cell.tolist(), strict=True))}
    for i in range(40):
        points = middle[i] + radius[i] * (1 - 1e-12) * unit_vectors(rng, 60)
        far, at, within = buffer.locate(triple(light - points))
        assert (far <= distance[i]).all()
        assert {(i, c) for c in at.tolist()} <= pairs.keys()
        # Bounds of objects are wider by a ten-thousandth: what meets the point meets the ball.
        wider = wide[[pairs[i, c] for c in at.tolist()]] - 3e-5
        assert not (wider > within).any()
