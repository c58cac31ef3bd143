"""Shadows and their edges as looks find them: as they are sample by sample and by all pairs.

Each look is checked while a picture is rendered.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
import pytest
from probe import scene_of
from random_scenes import KINDS, random_scene

from tracer import Box, Camera, Sphere, render
from tracer.arrays import Bools, Floats
from tracer.shadow.occluders import Candidates, Occluders, ShadowEdges, candidates_by_kind
from tracer.shadow.occlusion import Shadows
from tracer.shapes.rounding import INSIDE
from tracer.view.hits import Hits


@pytest.mark.usefixtures("pixels_are_split")
@pytest.mark.parametrize("kind", KINDS)
def test_what_is_looked_at_is_as_dark_as_what_is_not(
    kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    looks, edges = 0, Shadows.edges

    def compared(self: Shadows, hits: Hits, facing: Bools, footprint: Floats) -> Any:
        nonlocal looks
        looks += 1
        blocked, found = edges(self, hits, facing, footprint)
        assert np.array_equal(blocked[facing], self.blocked(hits, facing)[facing])
        return blocked, found

    monkeypatch.setattr(Shadows, "edges", compared)
    for seed in range(6):
        render(random_scene(kind, seed, 60, 40), samples=16, processes=1)
    assert looks


class Everything(NamedTuple):
    """A `Finder` of all pairs of points and objects."""

    occluders: Occluders

    def candidates(
        self, hits: Hits, facing: Bools, _: Bools, footprint: Floats | None = None
    ) -> Iterator[Candidates]:
        """See `Finder.candidates`."""
        own, points = hits.own, hits.points(slice(None))
        others = own[:, None] != np.arange(self.occluders.size.size)
        for light, asked in enumerate(facing):
            point, occluder = np.nonzero(asked[:, None] & others)
            yield from candidates_by_kind(
                self.occluders, own, points, point, light, occluder, footprint
            )


def listed(found: ShadowEdges) -> set[tuple[int, int, int]]:
    """Points, lights and objects."""
    return set(
        zip(found.point.tolist(), found.light.tolist(), found.occluder.tolist(), strict=True)
    )


def may_shade(finder: Any, light: int, own: int, occluder: int) -> bool:
    """Whether an object may keep a light from some of another, as far as stretches know."""
    key = light * len(finder.occluders.size) + own
    return any(
        occluder in lists.listed[lists.first[key] : lists.first[key + 1]] for lists in finder.lists
    )


@pytest.mark.usefixtures("pixels_are_split", "all_by_stretches")
@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind != "crowd"])
def test_looks_list_what_all_pairs_would(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    looks, edges = 0, Shadows.edges

    def compared(self: Shadows, hits: Hits, facing: Bools, footprint: Floats) -> Any:
        nonlocal looks
        blocked, found = edges(self, hits, facing, footprint)
        if hits.own.size:
            looks += 1
            every: Any = Everything(self.occluders)
            all_blocked, expected = edges(self._replace(finder=every), hits, facing, footprint)
            assert np.array_equal(blocked[facing], all_blocked[facing])
            assert np.array_equal(found.dark[facing], expected.dark[facing])
            assert listed(found) <= listed(expected)
            for point, light, occluder in listed(expected) - listed(found):
                # A ball or box around a light and all points shades none of them; and some objects
                # cannot shade what is seen of others.
                around = self.occluders.side[light, occluder] == INSIDE
                assert around or not may_shade(self.finder, light, hits.own[point], occluder)
        return blocked, found

    monkeypatch.setattr(Shadows, "edges", compared)
    for seed in range(4):
        render(random_scene(kind, seed, 48, 32), samples=16, processes=1)
    assert looks


@pytest.mark.usefixtures("pixels_are_split", "either_finder")
def test_what_is_seen_towards_a_horizon_is_asked_for_no_more_than_elsewhere(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
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
    asked = found = 0
    edges, pairs = Shadows.edges, Candidates.pairs

    def counted(self: Shadows, hits: Hits, facing: Bools, footprint: Floats) -> Any:
        nonlocal asked
        asked += hits.own.size
        return edges(self, hits, facing, footprint)

    def tried(self: Candidates) -> Any:
        nonlocal found
        found += int(self.balls.length.sum())
        return pairs(self)

    monkeypatch.setattr(Shadows, "edges", counted)
    monkeypatch.setattr(Candidates, "pairs", tried)
    render(scene, samples=4, processes=1)
    assert 0 < found < 10 * asked
