"""The cost of shadows: far lights, large grounds and crowds in one place take no more tests."""

from __future__ import annotations

from typing import Any
from unittest.mock import patch

import numpy as np
import pytest
from probe import scene_of

from tracer import Box, Camera, Lambertian, PointLight, Scene, Sphere, Surfaces, render
from tracer.antialias import classify
from tracer.arrays import Floats, Ints
from tracer.shadow import grid
from tracer.shadow.occluders import Occluders
from tracer.shadow.occlusion import shadow_edges
from tracer.shapes.sphere import Spheres
from tracer.view.view import Visible


def candidates(scene: Scene) -> int:
    """How many pairs of a packet and an occluder the grid finds for a picture."""
    found, query = [], grid.LightGrid.query

    def counted(*arguments: Any) -> Any:
        for light, packet, occluder in query(*arguments):
            found.append(light.size)
            yield light, packet, occluder

    with patch.object(grid.LightGrid, "query", counted):
        render(scene, processes=1)
    return sum(found)


def under(light: tuple[float, float, float], center: Floats, radius: Floats) -> Scene:
    """Spheres before a camera."""
    return Scene(
        camera=Camera(view_point=(0, 0, 9), proj_distance=4),
        width=60,
        height=60,
        lights=[PointLight(position=light)],
        surfaces=Surfaces(
            center=center,
            radius=radius,
            sphere_shader=np.zeros(radius.size, int),
            shaders=[Lambertian()],
        ),
    )


@pytest.mark.parametrize(
    ("far", "ground"),
    [*((10.0**k, 1.0) for k in (7, 9, 11, 13, 20, 40)), (1e9, 6.4e6), (1.5e11, 6.4e6)],
)
def test_suns_and_planets_cost_no_more(far: float, ground: float) -> None:
    """However far away the light and however large the ground: small objects lie side by side."""
    rng = np.random.default_rng(1)
    center, radius = rng.uniform(-1, 1, (1000, 3)), np.full(1000, 0.02)
    center[0], radius[0] = (0, -ground - 1, 0), ground
    assert 0 < candidates(under((0.3 * far, 0.8 * far, 0.5 * far), center, radius)) < 5 * 60 * 60


def test_candidates_are_found_some_at_a_time(monkeypatch: pytest.MonkeyPatch) -> None:
    """A crowd in one cell of the light's: memory is not for all pairs at once."""
    center = np.random.default_rng(1).uniform(-2, 2, (300, 3))
    scene = under((6e40, 1e41, 7e40), center, np.full(300, 0.2))
    whole = render(scene, 16, processes=1)
    sizes, query = [], grid.LightGrid.query

    def counted(*arguments: Any) -> Any:
        for found in query(*arguments):
            sizes.append(found[0].size)
            yield found

    monkeypatch.setattr(grid, "_AT_ONCE", 1000)
    monkeypatch.setattr(grid.LightGrid, "query", counted)
    np.testing.assert_array_equal(render(scene, 16, processes=1), whole)
    assert 100 < max(sizes) <= 1000 < sum(sizes)


@pytest.mark.usefixtures("pixels_are_split")
def test_what_is_seen_towards_a_horizon_costs_no_more_than_elsewhere() -> None:
    # What a pixel sees there is larger than all else: every object may shade some of it.
    rng = np.random.default_rng(0)
    floor = Box(min_pt=(-1e6, -1, -1e6), max_pt=(1e6, 0, 1e6))
    balls = [
        Sphere(center=(x, 0.1, z), radius=0.1)
        for x, z in rng.uniform((-20, -60), (20, -2), (200, 2)).tolist()
    ]
    scene = scene_of(
        floor,
        *balls,
        camera=Camera(view_point=(0, 1, 5), view_dir=(0, -0.1, -1)),
        size=(64, 64),
        lights=(30, 40, 20),
    )
    asked = tried = 0

    def edges(occluders: Occluders, hits: Visible, *rest: Any) -> Any:
        nonlocal asked, tried
        asked += hits.p.shape[1]
        occludes = Spheres.occludes

        def counted(self: Any, eye: Any, owner: Ints, *others: Any) -> Any:
            nonlocal tried
            tried += owner.size
            return occludes(self, eye, owner, *others)

        with patch.object(Spheres, "occludes", counted):
            return shadow_edges(occluders, hits, *rest)

    with patch.object(classify, "shadow_edges", edges):
        render(scene, samples=4, processes=1)
    assert 0 < tried < 20 * asked
