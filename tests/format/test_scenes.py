"""The scenes of this project: readable, commented, and worth a look."""

from __future__ import annotations

import io
from pathlib import Path

import pytest

import tracer
from reference.command import own_scenes

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
