"""The cost of shadows: far lights, large grounds and crowds in one place take no more tests."""

from contextlib import contextmanager
from unittest.mock import patch

import numpy as np
import pytest
from probe import Vector, scene_of

from tracer import Box, Camera, PointLight, Scene, Sphere, render
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
    # A crowd in one cell of the light's, and a ground from which ways to it are in many: memory is
    # not for all pairs at once.
    scene = balls_under((0.1, 3, 0.2), 300, 0.1, Sphere(center=(0, -1e6, 0), radius=1e6 - 1))
    whole, visited, cells = render(scene, 16), [], light_grid._cells

    def noted(*arguments):
        for found in cells(*arguments):
            visited.append(found[0].size)
            yield found

    monkeypatch.setattr(light_grid, "_cells", noted)
    monkeypatch.setattr(light_grid, "_PAIRS_AT_ONCE", 1000)
    monkeypatch.setattr(light_grid, "_CELLS_AT_ONCE", 1000)
    with candidates_noted() as sizes:
        np.testing.assert_array_equal(render(scene, 16), whole)
    for some in (sizes, visited):
        assert 100 < max(some) <= 1000 < sum(some)


@pytest.mark.usefixtures("pixels_are_split")
@pytest.mark.parametrize("up", [1e-75, 1e-60, 1.0])
@pytest.mark.parametrize("high", [1e-75, 1e-60, 0.5])
def test_no_packet_is_without_end(up, high, monkeypatch):
    # At the limits of the format a pixel sees a floor over 1e150 times its own width; cells of the
    # grid that such packets reach would be no numbers if they were infinite.
    radii, query = [], light_grid.LightGrid.query

    def noted(self, middle, radius, *rest):
        radii.append(radius)
        return query(self, middle, radius, *rest)

    monkeypatch.setattr(light_grid.LightGrid, "query", noted)
    floor, far = Box(min_pt=(-1e75, -1, -1e75), max_pt=(1e75, 0, 1e75)), (0, 1e75, -9e74)
    ball = Sphere(center=(0, 0.5, -3), radius=0.5)
    camera = Camera(view_point=(0, up, 0), view_width=1, view_height=high)
    lights = [PointLight(position=position) for position in (far, (3, 5, 4))]
    render(scene_of(floor, ball, camera=camera, size=(9, 8), lights=lights), 16)
    assert np.isfinite(np.concatenate(radii)).all()


@pytest.mark.usefixtures("pixels_are_split")
def test_what_is_seen_towards_a_horizon_costs_no_more_than_elsewhere(monkeypatch):
    # What a pixel sees there is larger than all else: every object may shade some of it.
    # 0.8 tests a pixel; where layers of depth are octaves 5, without layers 20.
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
    assert 0 < sum(tried) < 64 * 64
