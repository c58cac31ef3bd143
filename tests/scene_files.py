"""Scenes of this project, small, and scenes that tests write."""

from pathlib import Path

import pytest

from reference.command import SCENES, own_scenes
from reference.measured.workloads import resized
from tracer import Scene, load_scene

NAMES = [path.stem for path in own_scenes()]


def names(*quick: str) -> list:
    """The project's scenes as parameters of a test, of which all others are slow."""
    return [pytest.param(m, marks=[pytest.mark.slow] * (m not in quick)) for m in NAMES]


def small(name: str, width: int = 48, height: int = 27) -> Scene:
    """A scene of this project in so few pixels."""
    return resized(load_scene(SCENES / f"{name}.xml"), width, height)


def overflowing(scene: Path) -> Path:
    """A scene like another, whose radiance is more than float32 holds."""
    light = "<light><position>3 5 4</position></light>"
    text = scene.read_text(encoding="utf-8").replace(".25 .5 .85", "3e38 0 0")
    bright = scene.with_name("bright.xml")
    bright.write_text(text.replace("<image>", 3 * light + "<image>"), encoding="utf-8")
    return bright
