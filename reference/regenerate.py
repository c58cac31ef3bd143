"""Render the stored pictures in this folder again: ``python -m reference.regenerate``.

Each `mitsuba/NAME.exr` is Mitsuba's picture of a scene in the exact flavour of the converter:
linear RGB, `WIDTH` pixels wide, one sample per pixel.  `mitsuba/manifest.json` says how the
pictures were rendered.
`sheet.png` shows every scene, and `sunflower.png` one scene in a larger picture.  The tracer
renders both.  A stored picture is not replaced by one that differs only by rounding, as pictures do
that are rendered on another processor.
"""

from __future__ import annotations

from tracer.command.process import run

if __name__ == "__main__":
    run(__spec__.name)  # before the other imports: see tracer/command/process.py

import hashlib
import json
import platform
from collections.abc import Iterable
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import Annotated as Shaped

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from converters.camera import Floats
from converters.rendering import render_with_mitsuba, write_exr
from converters.variant import ensure_variant, mi, use_variant
from reference.check import EXACT, MAX_EDGE_SHARE
from reference.command import REFERENCE_FOLDER, SCENES, list_scene_files, make_parser
from tracer import Scene, load_scene, render, to_codes

MITSUBA_FOLDER = REFERENCE_FOLDER / "mitsuba"
WIDTH = 160
"""Width of Mitsuba's pictures in pixels."""

# Samples per pixel in the tracer's pictures.
_SAMPLES_PER_PIXEL = 16

# Lengths in pixels.  All but the first belong to the sheet, which shows pictures above their names.
_LARGE_PICTURE_HEIGHT = 540
_SHEET_WIDTH = 960
_PICTURE_HEIGHT = 175
_PICTURE_GAP = 12
_NAME_HEIGHT = 22
_NAME_GAP = 3  # between a picture and its name
_NAME_FONT_SIZE = 13

# Stored radiance is rounded to multiples of this number.  That is far below every tolerance, and
# makes the files smaller.
_RADIANCE_STEP = 2.0**-20

# On another processor, the last bits of radiance differ, which can change a code by one level.
_MAX_CODE_DIFFERENCE = 1


def load_small_scene(path: Path) -> Scene:
    """Load a scene file, and set the width of its picture to `WIDTH`.

    The aspect ratio stays the same, apart from rounding.
    """
    scene = load_scene(path)
    return replace(scene, width=WIDTH, height=max(1, round(WIDTH * scene.height / scene.width)))


def hash_scene_file(path: Path) -> str:
    """Compute the SHA-256 hash of a scene file, as hexadecimal digits."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def read_stored_picture(name: str) -> Shaped[Floats, "height width 3"]:
    """Read Mitsuba's stored picture of a scene, by the name of its file without the suffix."""
    ensure_variant()
    return np.array(mi.Bitmap(str(MITSUBA_FOLDER / f"{name}.exr")), dtype=np.float64)


def render_sheet(paths: Iterable[Path]) -> Image.Image:
    """Render rows of small pictures, each above the name of its scene, the narrowest first."""
    pictures = {path.stem: _render_image(load_scene(path), _PICTURE_HEIGHT) for path in paths}
    row_height = _PICTURE_HEIGHT + _NAME_HEIGHT + _PICTURE_GAP
    sheet = Image.new("RGB", (_SHEET_WIDTH, row_height * len(pictures)), "white")
    drawing = ImageDraw.Draw(sheet)
    font = ImageFont.load_default(size=_NAME_FONT_SIZE)
    x = y = 0
    for name, picture in sorted(pictures.items(), key=lambda item: item[1].width):
        if x + picture.width > _SHEET_WIDTH:
            x = 0
            y += row_height
        sheet.paste(picture, (x, y))
        drawing.text((x, y + _PICTURE_HEIGHT + _NAME_GAP), name, fill=(60, 60, 60), font=font)
        x += picture.width + _PICTURE_GAP
    return sheet.crop((0, 0, _SHEET_WIDTH, y + row_height - _PICTURE_GAP))


def _render_image(scene: Scene, height: int) -> Image.Image:
    """Render a scene, antialiased, at a given height in pixels."""
    resized_scene = replace(scene, width=round(scene.width * height / scene.height), height=height)
    return Image.fromarray(to_codes(render(resized_scene, _SAMPLES_PER_PIXEL)))


def _store_image(path: Path, image: Image.Image) -> None:
    """Write a PNG file, unless the stored one differs only by rounding."""
    if path.exists():
        stored_codes = np.asarray(Image.open(path), dtype=int)
        codes = np.asarray(image, dtype=int)
        has_same_size = stored_codes.shape == codes.shape
        if has_same_size and np.abs(stored_codes - codes).max() <= _MAX_CODE_DIFFERENCE:
            return
    image.save(path, optimize=True)


def _is_stored(name: str, image: Shaped[Floats, "height width 3"]) -> bool:
    """Test whether Mitsuba's stored picture of a scene exists and differs only by rounding.

    `name` is that of the scene file without the suffix.  A few pixels may differ more, because
    rounding may decide which surface they show.
    """
    if not (MITSUBA_FOLDER / f"{name}.exr").exists():
        return False
    stored_image = read_stored_picture(name)
    if stored_image.shape != image.shape:
        return False
    is_different = np.abs(stored_image - image).max(axis=2) > EXACT.difference
    return bool(is_different.mean() <= MAX_EDGE_SHARE)


def main() -> None:
    """Render all stored pictures again, and record in `manifest.json` how they were rendered.

    Mitsuba's pictures are replaced together, so that the manifest describes all of them.
    """
    make_parser("reference.regenerate").parse_args()
    _store_image(REFERENCE_FOLDER / "sheet.png", render_sheet(list_scene_files()))
    large_picture = _render_image(load_scene(SCENES / "sunflower.xml"), _LARGE_PICTURE_HEIGHT)
    _store_image(REFERENCE_FOLDER / "sunflower.png", large_picture)
    images = {path.stem: render_with_mitsuba(load_small_scene(path)) for path in list_scene_files()}
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
    manifest_path = MITSUBA_FOLDER / "manifest.json"
    stored_text = manifest_path.read_text("utf-8") if manifest_path.exists() else "{}"
    are_same_scenes = json.loads(stored_text).get("scenes") == manifest["scenes"]
    if are_same_scenes and all(_is_stored(name, image) for name, image in images.items()):
        return
    for name, image in images.items():
        rounded_image = np.round(image / _RADIANCE_STEP) * _RADIANCE_STEP
        write_exr(MITSUBA_FOLDER / f"{name}.exr", rounded_image)
    manifest_path.write_text(json.dumps(manifest, indent=2) + "\n", "utf-8")
