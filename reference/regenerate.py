"""Draw the pictures in this folder again: ``python -m reference.regenerate``.

Mitsuba's, ``mitsuba/NAME.exr``, are linear RGB, `WIDTH` pixels wide, at one sample a pixel in the
exact flavour of the converter; a manifest tells how they were made.  `sheet.png` shows every scene,
`sunflower.png` a large one.
"""

from __future__ import annotations

from tracer.command.process import run

if __name__ == "__main__":
    run(__spec__.name)

import hashlib
import json
import platform
from collections.abc import Iterable
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from converters.camera import Floats
from converters.rendering import render_mitsuba, write_exr
from converters.variant import ensure, mi, use
from reference.command import HERE, SCENES, own_scenes, parser
from tracer import Scene, load_scene, render, to_codes

FOLDER = HERE / "mitsuba"
WIDTH = 160

_SAMPLES = 16
_SHEET, _HEIGHT, _GAP, _LABEL = 960, 175, 12, 22

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


def sheet(paths: Iterable[Path]) -> Image.Image:
    """All scenes on one sheet, each over its name, the narrowest first."""
    image = Image.new("RGB", (_SHEET, 10_000), "white")
    pen, font = ImageDraw.Draw(image), ImageFont.load_default(size=13)
    x = y = 0
    drawn = [(_drawn(load_scene(path), _HEIGHT), path.stem) for path in paths]
    for picture, name in sorted(drawn, key=lambda each: each[0].width):
        if x + picture.width > _SHEET:
            x, y = 0, y + _HEIGHT + _LABEL + _GAP
        image.paste(picture, (x, y))
        pen.text((x, y + _HEIGHT + 3), name, fill=(60, 60, 60), font=font)
        x += picture.width + _GAP
    return image.crop((0, 0, _SHEET, y + _HEIGHT + _LABEL))


def _drawn(scene: Scene, height: int) -> Image.Image:
    """The scene at another size, anti-aliased."""
    sized = replace(scene, width=round(scene.width * height / scene.height), height=height)
    return Image.fromarray(to_codes(render(sized, _SAMPLES)))


def main() -> None:
    """Render every scene again, and draw the README's pictures."""
    parser("reference.regenerate", __doc__).parse_args()
    sheet(own_scenes()).save(HERE / "sheet.png", optimize=True)
    sunflower = _drawn(load_scene(SCENES / "sunflower.xml"), 540)
    sunflower.save(HERE / "sunflower.png", optimize=True)
    for path in own_scenes():
        image = render_mitsuba(load_small(path))
        write_exr(FOLDER / f"{path.stem}.exr", np.round(image / _STEP) * _STEP)
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
