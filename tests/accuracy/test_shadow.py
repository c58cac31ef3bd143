"""Shadows: the search finds all that brute force finds, whatever packets it asks for."""

from __future__ import annotations

from typing import Any
from unittest.mock import patch

import numpy as np
import pytest
from probe import scene_of
from random_scenes import KINDS, random_scene

from tracer import Box, Camera, Lambertian, PointLight, Scene, Sphere, Surfaces, render
from tracer.antialias import classify
from tracer.antialias.lattice import CENTRES
from tracer.arrays import Bools, Floats, Ints, columns, each, pick
from tracer.shadow import grid
from tracer.shadow.occluders import Occluders, occluders_of
from tracer.shadow.occlusion import occlusion, shadow_edges
from tracer.shapes.rounding import INSIDE, ON
from tracer.shapes.sphere import Spheres
from tracer.view.camera import raster_of
from tracer.view.hits import Visible
from tracer.view.samples import Scattered
from tracer.view.view import view_of
from tracer.view.visibility import visible

PACKETS = (1, 4, 24)


def prepared(scene: Scene, scattered: bool) -> tuple[Occluders, Visible]:
    """Occluders of a scene, and what its pixels' centres see."""
    view = view_of(raster_of(scene.camera, scene.width, scene.height), scene.surfaces)
    lights = np.array([light.position for light in scene.lights]).reshape(-1, 3)
    samples: Any = CENTRES.samples(slice(0, scene.height), slice(0, scene.width))
    if scattered:
        samples, _ = Scattered.of(*samples.positions())
    return occluders_of(view, lights), visible(view, samples)


def all_pairs(hits: Visible, light: Floats, grown: Floats | None = None) -> tuple[Bools, Ints]:
    """Whether objects (points, n) block light, by the shapes' own exact tests; and the points."""
    view, count = hits.view, hits.p.shape[1]
    answers = []
    for shape in view.shapes:
        owner, point = (m.ravel() for m in np.indices((shape.count, count)))
        block = shape.occludes(
            view.raster.eye,
            owner + shape.first,
            hits.points(point),
            columns(np.broadcast_to(light, (point.size, 3)), slice(None)),
            np.ones(point.size, dtype=np.bool_),
            None if grown is None else grown[point],
        )
        answers.append(block.reshape(shape.count, count).T)
    others = hits.own[:, None] != np.arange(len(view.surfaces))
    return np.concatenate(answers, axis=1) & others, others


def a_footprint(hits: Visible, seed: int) -> Floats:
    """Random distances (n,), some of which are 0, in proportion to that of the point."""
    rng = np.random.default_rng(seed)
    return np.asarray(rng.choice([0, 1e-4, 1e-2, 0.3], hits.p.shape[1]) * hits.p[2])


@np.errstate(all="ignore")
@pytest.mark.parametrize("scattered", [False, True])
@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind != "crowd"])
def test_edges_of_shadows_are_found(kind: str, scattered: bool) -> None:
    for seed in range(6):
        scene = random_scene(kind, seed, 24, 16)
        occluders, hits = prepared(scene, scattered)
        if len(scene.surfaces) < 2:
            continue
        frontlit = np.random.default_rng(seed).random((len(scene.lights), hits.p.shape[1])) < 0.8
        reach = a_footprint(hits, seed)
        for packet in PACKETS:
            some = occluders._replace(packet=packet)
            blocked, found = shadow_edges(some, hits, frontlit, reach)
            assert np.array_equal(blocked[frontlit], occlusion(some, hits, frontlit)[frontlit])
            for number, light in enumerate(occluders.lights):
                itself, others = all_pairs(hits, light)
                grown, shrunk = (all_pairs(hits, light, sign * reach)[0] for sign in (1, -1))
                gap = np.concatenate(
                    [
                        shape.gap(shape.first + np.arange(shape.count), each(np.asarray, (*light,)))
                        for shape in hits.view.shapes
                    ]
                )
                shrunk &= itself & (occluders.side[number] != ON)
                near = grown | itself | (others & (np.abs(gap) <= reach[:, None]))
                umbra = shrunk.any(axis=1)
                edges = near & ~shrunk & (frontlit[number] & ~umbra)[:, None]
                here = found.light == number
                listed = np.zeros_like(edges)
                listed[found.point[here], found.occluder[here]] = True
                assert np.count_nonzero(listed) == np.count_nonzero(here)
                assert not (listed & ~edges).any()
                # What is left out shades nothing near, or where no light comes, or holds light and
                # points and shades none.
                around = occluders.side[number] == INSIDE
                point, occluder = np.nonzero(edges & ~listed & ~around)
                assert not shades_nearby(hits, light, reach, point, occluder).any()


def shades_nearby(
    hits: Visible, light: Floats, reach: Floats, point: Ints, occluder: Ints
) -> Bools:
    """Whether occluders (m,) block light from some places within `reach` of points (m,).

    Not where light comes to none of these places.
    """
    rng, count = np.random.default_rng(0), point.size
    blocks, lit = np.zeros((2, count), dtype=np.bool_)
    for _ in range(30):
        offset = rng.normal(size=(count, 3))
        offset *= (rng.random(count) * reach[point] / np.linalg.norm(offset, axis=1))[:, None]
        place = each(np.add, hits.points(point), columns(offset, slice(None)))
        dark = np.zeros(count, dtype=np.bool_)
        for shape in hits.view.shapes:
            owner, at = (m.ravel() for m in np.indices((shape.count, count)))
            owner += shape.first
            end = columns(np.broadcast_to(light, (at.size, 3)), slice(None))
            close = np.ones(at.size, dtype=np.bool_)
            block = shape.occludes(hits.view.raster.eye, owner, pick(place, at), end, close)
            block &= owner != hits.own[point[at]]
            np.logical_or.at(dark, at, block)
            np.logical_or.at(blocks, at, block & (owner == occluder[at]))
        lit |= ~dark
    return blocks & lit


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


@np.errstate(all="ignore")
def test_large_objects_fill_few_cells() -> None:
    """Where thousands of objects overlap no cell is empty, however small it is."""
    center = np.random.default_rng(1).normal(size=(3000, 3))
    occluders, _ = prepared(under((4, 5, 6), center, np.ones(3000)), False)
    assert occluders.grid
    assert 3000 < occluders.grid.listed.size < 1 << 22


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
