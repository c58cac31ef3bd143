"""Pictures that every system must render, Windows and macOS too.

This file needs only pytest and Pillow.  `python tests/command/test_systems.py` stores the codes
again.
"""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

import tracer

ROOT = Path(tracer.__file__).parents[1]
SCENES = sorted(p for p in (ROOT / "scenes").glob("*.xml") if ".mitsuba." not in p.name)
NAMES = "highlights", "room", "sticks-perspective"
STORED = Path(__file__).with_name("codes.png")
"""Pictures of three scenes, 96 x 54 pixels each, one below the other."""


def render_codes() -> NDArray[np.uint8]:
    """Render the three scenes on this system, and return their 8-bit codes as in `STORED`."""
    scenes = (tracer.load_scene(ROOT / "scenes" / f"{name}.xml") for name in NAMES)
    sized = (replace(scene, width=96, height=54) for scene in scenes)
    return np.concatenate([tracer.to_codes(tracer.render(scene)) for scene in sized])


def test_two_processes_render_all_scenes(tmp_path):
    """The second process is a fork of the first on Linux only."""
    command = [sys.executable, "-m", "tracer", *map(str, SCENES), "-o", f"{tmp_path}/pictures/"]
    options = ["--size", "320x180", "--processes", "2", "--quiet"]
    process = subprocess.run([*command, *options], capture_output=True, text=True, timeout=300)
    assert (process.returncode, process.stdout, process.stderr) == (0, "", "")
    for path in SCENES:
        scene = replace(tracer.load_scene(path), width=320, height=180)
        with Image.open(tmp_path / "pictures" / f"{path.name}.png") as picture:
            assert (np.asarray(picture) == tracer.to_codes(tracer.render(scene))).all()


def test_a_picture_is_replaced(tmp_path):
    for value in (0.0, 1.0):
        tracer.write_png(tmp_path / "picture.png", np.full((1, 1, 3), value))
    with Image.open(tmp_path / "picture.png") as picture:
        assert picture.getpixel((0, 0)) == (255, 255, 255)
    assert len(list(tmp_path.iterdir())) == 1


def test_codes_are_those_of_other_systems():
    """Roundings of exp and log may differ in the last place between systems."""
    with Image.open(STORED) as picture:
        difference = np.abs(np.asarray(picture).astype(int) - render_codes()).max(axis=2)
    assert difference.shape == (3 * 54, 96)
    assert (difference > 0).sum() <= 3
    assert difference.max() <= 1


if __name__ == "__main__":
    Image.fromarray(render_codes()).save(STORED)
