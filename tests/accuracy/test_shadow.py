"""The cost of shadows: far lights, large grounds and crowds in one place take no more tests."""

from contextlib import contextmanager
from unittest.mock import patch

import numpy as np
import pytest
from probe import Vector, scene_of

from tracer import Box, Camera, Scene, Sphere, render
from tracer.geometry.sphere import Spheres
from tracer.world import light_grid


@contextmanager
def candidates_noted():
    """Context with the numbers of pairs of a packet and an occluder that the grid finds at once."""
    sizes, query = [], light_grid.LightGrid.query

    def noted(*arguments):
        for found in query(*arguments):
            sizes.append(found[0].size)
            yield found

    with patch.object(light_grid.LightGrid, "query", noted):
        yield sizes


def balls_under(light: Vector, count: int, radius: float, *others: Sphere) -> Scene:
    """Balls side by side."""
    rng = np.random.default_rng(1)
    balls = [Sphere(center=c, radius=radius) for c in rng.uniform(-1, 1, (count, 3)).tolist()]
    camera = Camera(view_point=(0, 0, 9), proj_distance=4)
    return scene_of(*balls, *others, camera=camera, size=(60, 60), lights=light)


@pytest.mark.parametrize(
    ("far", "ground"),
    [*((10.0**k, 1.0) for k in (7, 9, 11, 13, 20, 40)), (1e9, 6.4e6), (1.5e11, 6.4e6)],
)
def test_suns_and_planets_cost_no_more(far, ground):
    light = (0.3 * far, 0.8 * far, 0.5 * far)
    planet = Sphere(center=(0, -ground - 1, 0), radius=ground)
    with candidates_noted() as sizes:
        render(balls_under(light, 1000, 0.02, planet))
    assert 0 < sum(sizes) < 5 * 60 * 60


def test_candidates_are_found_some_at_a_time(monkeypatch):
    # A crowd in one cell of the light's: memory is not for all pairs at once.
    scene = balls_under((6e40, 1e41, 7e40), 300, 0.1)
    whole = render(scene, 16)
    monkeypatch.setattr(light_grid, "_PAIRS_AT_ONCE", 1000)
    with candidates_noted() as sizes:
        np.testing.assert_array_equal(render(scene, 16), whole)
    assert 100 < max(sizes) <= 1000 < sum(sizes)


@pytest.mark.usefixtures("pixels_are_split")
def test_what_is_seen_towards_a_horizon_costs_no_more_than_elsewhere(monkeypatch):
    # What a pixel sees there is larger than all else: every object may shade some of it.
    # 20,946 tests at rows of three points, 5.1 a pixel; without borders in depth 20 a pixel.
    rng = np.random.default_rng(0)
    floor = Box(min_pt=(-1e6, -1, -1e6), max_pt=(1e6, 0, 1e6))
    at = rng.uniform((-20, -60), (20, -2), (200, 2)).tolist()
    balls = [Sphere(center=(x, 0.1, z), radius=0.1) for x, z in at]
    camera = Camera(view_point=(0, 1, 5), view_dir=(0, -0.1, -1))
    scene = scene_of(floor, *balls, camera=camera, size=(64, 64), lights=(30, 40, 20))
    tried, occludes = [], Spheres.occludes

    def counted(self, eye, owner, *rest):
        tried.append(owner.size)
        return occludes(self, eye, owner, *rest)

    monkeypatch.setattr(Spheres, "occludes", counted)
    render(scene, samples=4)
    assert 0 < sum(tried) < 6 * 64 * 64
