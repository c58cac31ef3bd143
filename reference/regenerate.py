"""Render the stored pictures in this folder again: ``python -m reference.regenerate``.

The tracer renders `sheet.png`, which shows every scene, and `sunflower.png`, which shows one scene
in a larger picture.

Mitsuba renders `mitsuba/NAME.exr`, a picture of each scene in linear RGB, `WIDTH` pixels wide, with
one sample per pixel.  The scene is converted in the exact flavour (see `converters.flavours`), so
the picture should equal the tracer's.  `mitsuba/manifest.json` says how all were rendered.

Another processor rounds differently.  So a stored picture is kept if the new one differs from it
only by rounding.
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
from itertools import starmap
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

# Height of `sunflower.png` in pixels.
_LARGE_PICTURE_HEIGHT = 540

# Lengths in pixels on the sheet, which shows each picture above its name.
_SHEET_WIDTH = 960
_PICTURE_HEIGHT = 175
_PICTURE_GAP = 12
_NAME_HEIGHT = 22
_NAME_GAP = 3  # between a picture and its name
_NAME_FONT_SIZE = 13

# Mitsuba's radiance is rounded to multiples of this number, which makes the files smaller.  The
# number is far below every tolerance.
_RADIANCE_STEP = 2.0**-20

# Rounding can change an 8-bit code by one level.
_MAX_CODE_DIFFERENCE = 1


def load_small_scene(path: Path) -> Scene:
    """Load a scene file, and scale the size of its picture to a width of `WIDTH` pixels."""
    scene = load_scene(path)
    return replace(scene, width=WIDTH, height=max(1, round(WIDTH * scene.height / scene.width)))


def hash_scene_file(path: Path) -> str:
    """Compute the SHA-256 hash of a scene file, as hexadecimal digits."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def read_stored_picture(name: str) -> Shaped[Floats, "height width 3"]:
    """Read Mitsuba's stored picture of the scene in the file `name`.xml, in linear RGB."""
    ensure_variant()
    return np.array(mi.Bitmap(str(MITSUBA_FOLDER / f"{name}.exr")), dtype=np.float64)


def render_sheet(paths: Iterable[Path]) -> Image.Image:
    """Render each scene in a small picture above its name, and arrange them in rows.

    The narrowest pictures come first.
    """
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
    """Render a scene, antialiased, in a picture of the given height in pixels."""
    resized_scene = replace(scene, width=round(scene.width * height / scene.height), height=height)
    return Image.fromarray(to_codes(render(resized_scene, _SAMPLES_PER_PIXEL)))


def _store_image(path: Path, image: Image.Image) -> None:
    """Write a PNG file, unless the file exists and its codes differ by rounding only."""
    if path.exists():
        stored_codes = np.asarray(Image.open(path), dtype=int)
        codes = np.asarray(image, dtype=int)
        has_same_size = stored_codes.shape == codes.shape
        if has_same_size and np.abs(stored_codes - codes).max() <= _MAX_CODE_DIFFERENCE:
            return
    image.save(path, optimize=True)


def _matches_stored_picture(name: str, image: Shaped[Floats, "height width 3"]) -> bool:
    """Test whether Mitsuba's stored picture of a scene differs from `image` only by rounding.

    The result is False if no picture is stored.  A few pixels may differ more, because rounding may
    decide which surface they show.  `name` is the name of the scene file without the suffix.
    """
    if not (MITSUBA_FOLDER / f"{name}.exr").exists():
        return False
    stored_image = read_stored_picture(name)
    if stored_image.shape != image.shape:
        return False
    is_different = np.abs(stored_image - image).max(axis=2) > EXACT.difference
    return bool(is_different.mean() <= MAX_EDGE_SHARE)


def main() -> None:
    """Render all stored pictures again, and store those that have changed."""
    make_parser("reference.regenerate").parse_args()
    _store_image(REFERENCE_FOLDER / "sheet.png", render_sheet(list_scene_files()))
    large_picture = _render_image(load_scene(SCENES / "sunflower.xml"), _LARGE_PICTURE_HEIGHT)
    _store_image(REFERENCE_FOLDER / "sunflower.png", large_picture)
    _store_mitsuba_pictures()


def _store_mitsuba_pictures() -> None:
    """Render all scenes with Mitsuba, and replace the stored pictures and `manifest.json`.

    All files are kept if no scene file and no picture has changed.  Otherwise all are replaced, so
    that the manifest describes all pictures.
    """
    images = {path.stem: render_with_mitsuba(load_small_scene(path)) for path in list_scene_files()}
    manifest = _describe_mitsuba_pictures()
    manifest_path = MITSUBA_FOLDER / "manifest.json"
    stored_text = manifest_path.read_text("utf-8") if manifest_path.exists() else "{}"
    are_same_scenes = json.loads(stored_text).get("scenes") == manifest["scenes"]
    if are_same_scenes and all(starmap(_matches_stored_picture, images.items())):
        return
    for name, image in images.items():
        rounded_image = np.round(image / _RADIANCE_STEP) * _RADIANCE_STEP
        write_exr(MITSUBA_FOLDER / f"{name}.exr", rounded_image)
    manifest_path.write_text(json.dumps(manifest, indent=2) + "\n", "utf-8")


def _describe_mitsuba_pictures() -> dict[str, object]:
    """Return the contents of `manifest.json` for pictures that Mitsuba renders now.

    They are the versions of the software, the settings, and a hash of each scene file.
    """
    return {
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
