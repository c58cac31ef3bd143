"""What divides the surface that a pixel sees, and what does not."""

from __future__ import annotations

import numpy as np
import pytest

from tracer import Camera, PointLight, Scene, Sphere, render
from tracer.antialias.boundaries import Patches, near_lights
from tracer.arrays import Ints
from tracer.light.lighting import Incoming


def test_light_that_a_hollow_ball_keeps_out_begins_nowhere_on_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    lights = [PointLight(position=(20, 0, 0)), PointLight(position=(0, 4, -1))]
    room = Sphere(radius=5)
    scene = Scene(camera=Camera(), width=60, height=60, lights=lights, surfaces=[room])
    asked: list[int] = []
    near = Patches._near_terminator

    def noted(self: Patches, light: Incoming) -> tuple[Ints, Ints]:
        number, at = near(self, light)
        asked.append(light.n_dot_l.shape[1])
        assert not np.any(number == 0)
        return number, at

    monkeypatch.setattr(Patches, "_near_terminator", noted)
    assert render(scene, samples=16, processes=1).any()
    assert sum(asked) >= 60 * 60


def test_points_that_see_more_than_a_tenth_of_the_way_to_a_light() -> None:
    length2 = np.array([[1.0, 100.0, 1e4, 1.0], [1e4, 100.0, 1e4, 1e4]])
    light = Incoming(np.ones((2, 4)), length2, np.ones((2, 4)))
    footprint = np.array([0.2, 0.2, 20.0, 0.05])
    assert near_lights(light, footprint).tolist() == [0, 2]
    assert near_lights(light, footprint / 10).tolist() == []
