"""The scenes of this project: readable, commented, and what they say."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pytest

import tracer
from reference.command import SCENES, own_scenes

PATHS = own_scenes()


def test_what_is_converted_beside_them_is_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("reference.command.SCENES", tmp_path)
    for name in ("room.xml", "room.mitsuba.xml", "ball.xml"):
        (tmp_path / name).touch()
    assert [path.name for path in own_scenes()] == ["ball.xml", "room.xml"]


@pytest.mark.parametrize("path", PATHS, ids=lambda path: path.stem)
def test_says_what_it_shows_and_shows_something(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    assert text.startswith("<!-- ")
    assert text.index("-->") > 40
    scene = tracer.load_scene(path)
    tracer.save_scene(scene, file := io.BytesIO())
    file.seek(0)
    assert tracer.load_scene(file) == scene
    image = tracer.render(scene)
    seen = image.any(axis=2)
    # Neither an empty picture nor one that is burnt out.
    assert seen.mean() > 0.1
    assert (image[seen].min(axis=1) > 1).mean() < 0.05


STICKS = ("sticks-perspective", "sticks-axonometric", "sticks-orthographic", "sticks-shifted")


@pytest.mark.parametrize("name", STICKS)
def test_cubes_of_sticks_differ_in_camera_and_lights_only(name: str) -> None:
    scene, first = (tracer.load_scene(SCENES / f"{n}.xml") for n in (name, STICKS[0]))
    assert len(scene.surfaces) == 21
    assert list(scene.surfaces) == list(first.surfaces)
    assert len(scene.lights) == 3
    assert [light.position for light in scene.lights].count(scene.camera.view_point) == 1


def test_touching_scene_touches_exactly() -> None:
    """Coordinates are dyadic, so contacts and coincidences are exact."""
    surfaces = tracer.load_scene(SCENES / "touching.xml").surfaces
    balls = np.column_stack([surfaces.center, surfaces.radius])
    assert len(np.unique(balls, axis=0)) == len(balls) - 1
    assert (surfaces.min_pt == surfaces.max_pt).any(axis=1).sum() == 1
    apart = np.linalg.norm(surfaces.center[:, None] - surfaces.center, axis=2)
    assert (apart == surfaces.radius[:, None] + surfaces.radius).sum() == 4
