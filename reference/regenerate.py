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
from collections.abc import Sequence
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from converters.camera import Floats
from converters.rendering import render_mitsuba, write_exr
from converters.variant import ensure, mi, use
from reference.command import HERE, need_scenes, own_scenes, parser
from tracer import Scene, load_scene

__all__ = ["FOLDER", "WIDTH", "load_small", "main", "manifest", "scene_hash", "stored"]

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


def manifest(folder: Path = FOLDER) -> dict[str, Any]:
    """How the stored pictures were made."""
    return dict(json.loads((folder / "manifest.json").read_text(encoding="utf-8")))


def stored(name: str, folder: Path = FOLDER) -> Floats:
    """The stored picture of a scene, (h, w, 3), linear; FileNotFoundError if there is none."""
    path = folder / f"{name}.exr"
    if not path.is_file():
        raise FileNotFoundError(f"{path} is missing; python -m reference.regenerate makes it")
    ensure()
    return np.array(mi.Bitmap(str(path)), dtype=np.float64)


def main(arguments: Sequence[str] | None = None) -> int:
    """Render every scene again; returns 0."""
    used = parser("reference.regenerate", __doc__)
    used.add_argument("--variant", help="Mitsuba's variant (default: the fastest that works)")
    used.add_argument("-o", "--output", type=Path, default=FOLDER, help="folder to write to")
    options = used.parse_args(arguments)
    need_scenes(used)
    choice = use(options.variant)
    options.output.mkdir(parents=True, exist_ok=True)
    for path in own_scenes():
        image = render_mitsuba(load_small(path), variant=choice.variant)
        write_exr(options.output / f"{path.stem}.exr", np.round(image / _STEP) * _STEP)
        print(f"{path.stem}.exr")
    made = {
        "command": "python -m reference.regenerate",
        "mitsuba": version("mitsuba"),
        "drjit": version("drjit"),
        "python": platform.python_version(),
        "machine": f"{platform.system()} {platform.machine()}",
        "variant": choice.variant,
        "samples": 1,
        "width": WIDTH,
        "scenes": {path.stem: {"sha256": scene_hash(path)} for path in own_scenes()},
    }
    (options.output / "manifest.json").write_text(json.dumps(made, indent=2) + "\n", "utf-8")
    return 0
