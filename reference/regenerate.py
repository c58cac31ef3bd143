"""Mitsuba's pictures of every scene: ``python -m reference.regenerate``.

Writes ``reference/mitsuba/NAME.exr``, linear RGB, `WIDTH` pixels wide, at one sample a pixel in the
exact flavour of the converter, and a manifest that tells how they were made.
"""

from __future__ import annotations

from tracer.command.process import run

if __name__ == "__main__":
    run(__spec__.name)

import hashlib
import json
import platform
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path

import numpy as np

from converters.camera import Floats
from converters.rendering import render_mitsuba, write_exr
from converters.variant import ensure, mi, use
from reference.command import HERE, own_scenes, parser
from tracer import Scene, load_scene

FOLDER = HERE / "mitsuba"
WIDTH = 160

# Stored radiance is rounded to steps of 1e-6: below every tolerance, and the files compress better.
_STEP = 2.0**-20


def load_small(path: Path) -> Scene:
    """A scene file, its picture made `WIDTH` pixels wide."""
    scene = load_scene(path)
    return replace(scene, width=WIDTH, height=max(1, round(WIDTH * scene.height / scene.width)))


def scene_hash(path: Path) -> str:
    """SHA-256 of a scene file."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def stored(name: str) -> Floats:
    """The stored picture of a scene, (h, w, 3), linear."""
    ensure()
    return np.array(mi.Bitmap(str(FOLDER / f"{name}.exr")), dtype=np.float64)


def main() -> None:
    """Render every scene again."""
    parser("reference.regenerate", __doc__).parse_args()
    for path in own_scenes():
        image = render_mitsuba(load_small(path))
        write_exr(FOLDER / f"{path.stem}.exr", np.round(image / _STEP) * _STEP)
        print(f"{path.stem}.exr")
    made = {
        "command": "python -m reference.regenerate",
        "mitsuba": version("mitsuba"),
        "drjit": version("drjit"),
        "python": platform.python_version(),
        "machine": f"{platform.system()} {platform.machine()}",
        "variant": use().variant,
        "samples": 1,
        "width": WIDTH,
        "scenes": {path.stem: {"sha256": scene_hash(path)} for path in own_scenes()},
    }
    (FOLDER / "manifest.json").write_text(json.dumps(made, indent=2) + "\n", "utf-8")
