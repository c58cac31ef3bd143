"""Render the stored pictures in this folder again: ``python -m reference.regenerate``.

`mitsuba/NAME.exr` are Mitsuba's pictures in the exact flavour of the converter: linear RGB, `WIDTH`
pixels wide, one sample per pixel.  `mitsuba/manifest.json` describes how they were rendered.
`sheet.png` shows every scene, and `sunflower.png` one scene in a larger picture, both rendered by
the tracer.
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
from converters.rendering import render_with_mitsuba, write_exr
from converters.variant import ensure_variant, mi, use_variant
from reference.command import REFERENCE_FOLDER, SCENES, list_scene_files, make_parser
from tracer import Scene, load_scene, render, to_codes

MITSUBA_FOLDER = REFERENCE_FOLDER / "mitsuba"
WIDTH = 160
"""Width of Mitsuba's pictures in pixels."""

# Samples per pixel in the tracer's pictures, and the height of the large one.
_SAMPLES_PER_PIXEL, _LARGE_HEIGHT = 16, 540

# Lengths in pixels: the width of the sheet, the height of its pictures, the gaps between them, the
# height of the names below them, and the size of the names' font.
_SHEET_WIDTH, _PICTURE_HEIGHT, _GAP, _NAME_HEIGHT, _NAME_SIZE = 960, 175, 12, 22, 13

# Stored radiance is rounded to multiples of this number.  That is far below every tolerance, and
# makes the files smaller.
_RADIANCE_STEP = 2.0**-20


def load_small_scene(path: Path) -> Scene:
    """Load a scene file, and set the width of its picture to 160 pixels (`WIDTH`).

    The aspect ratio stays the same, apart from rounding.
    """
    scene = load_scene(path)
    return replace(scene, width=WIDTH, height=max(1, round(WIDTH * scene.height / scene.width)))


def hash_scene_file(path: Path) -> str:
    """Compute the SHA-256 hash of a scene file, as hexadecimal digits."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def read_stored_picture(name: str) -> Floats:
    """Read Mitsuba's stored picture of a scene.

    Parameters
    ----------
    name : str
        Name of the scene file without its suffix.

    Returns
    -------
    image : (height, width, 3) float array
        Linear RGB radiance; the width is `WIDTH`.
    """
    ensure_variant()
    return np.array(mi.Bitmap(str(MITSUBA_FOLDER / f"{name}.exr")), dtype=np.float64)


def render_sheet(paths: Iterable[Path]) -> Image.Image:
    """Render an overview of scenes: rows of small pictures, each above the name of its scene.

    Parameters
    ----------
    paths : iterable of Path
        The scene files, in any order.

    Returns
    -------
    sheet : Image
        The overview, with the narrowest pictures first.
    """
    pictures = {path.stem: _render_image(load_scene(path), _PICTURE_HEIGHT) for path in paths}
    row_height = _PICTURE_HEIGHT + _NAME_HEIGHT + _GAP
    sheet = Image.new("RGB", (_SHEET_WIDTH, row_height * len(pictures)), "white")
    drawing, font = ImageDraw.Draw(sheet), ImageFont.load_default(size=_NAME_SIZE)
    x = y = 0
    for name, picture in sorted(pictures.items(), key=lambda item: item[1].width):
        if x + picture.width > _SHEET_WIDTH:
            x, y = 0, y + row_height
        sheet.paste(picture, (x, y))
        drawing.text((x, y + _PICTURE_HEIGHT + 3), name, fill=(60, 60, 60), font=font)
        x += picture.width + _GAP
    return sheet.crop((0, 0, _SHEET_WIDTH, y + row_height - _GAP))


def _render_image(scene: Scene, height: int) -> Image.Image:
    """Render a scene at a given height in pixels, with 16 samples per pixel."""
    resized_scene = replace(scene, width=round(scene.width * height / scene.height), height=height)
    return Image.fromarray(to_codes(render(resized_scene, _SAMPLES_PER_PIXEL)))


def main() -> None:
    """Render all stored pictures again, and record in `manifest.json` how they were rendered."""
    make_parser("reference.regenerate").parse_args()
    render_sheet(list_scene_files()).save(REFERENCE_FOLDER / "sheet.png", optimize=True)
    large_picture = _render_image(load_scene(SCENES / "sunflower.xml"), _LARGE_HEIGHT)
    large_picture.save(REFERENCE_FOLDER / "sunflower.png", optimize=True)
    for path in list_scene_files():
        image = render_with_mitsuba(load_small_scene(path))
        rounded_image = np.round(image / _RADIANCE_STEP) * _RADIANCE_STEP
        write_exr(MITSUBA_FOLDER / f"{path.stem}.exr", rounded_image)
    manifest = {
        "command": "python -m reference.regenerate",
        "mitsuba": version("mitsuba"),
        "drjit": version("drjit"),
        "python": platform.python_version(),
        "machine": f"{platform.system()} {platform.machine()}",
        "variant": use_variant().variant,
        "samples": 1,
        "width": WIDTH,
        "scenes": {path.stem: {"sha256": hash_scene_file(path)} for path in list_scene_files()},
    }
    (MITSUBA_FOLDER / "manifest.json").write_text(json.dumps(manifest, indent=2) + "\n", "utf-8")
