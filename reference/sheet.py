"""Draw the README's pictures: ``python -m reference.sheet``.

Writes ``sheet.png``, a picture of every scene of ``scenes/``, and
``sunflower.png``, a large picture of one of them, into this folder.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

import tracer
from reference.command import HERE, SCENES, need_scenes, own_scenes, parser, run

__all__ = ["main", "sheet"]

_SAMPLES = 16
# A row holds five square pictures or three wide ones.
_WIDTH, _GAP, _LABEL = 960, 12, 22
_PAPER, _INK = (255, 255, 255), (60, 60, 60)


def sheet(paths: Iterable[Path]) -> Image.Image:
    """All scenes on one sheet, each over its name: square ones first, then wide ones."""
    scenes = [(path.stem, tracer.load_scene(path)) for path in sorted(paths)]
    rows: list[list[Image.Image]] = []
    for per_row in (5, 3):
        width = (_WIDTH - (per_row - 1) * _GAP) // per_row
        tiles = [
            _tile(name, scene, width)
            for name, scene in scenes
            if (scene.width == scene.height) == (per_row == 5)
        ]
        rows += [tiles[k : k + per_row] for k in range(0, len(tiles), per_row)]
    heights = [max(tile.height for tile in row) for row in rows]
    height = sum(heights) + _GAP * (len(rows) - 1)
    image = Image.new("RGB", (_WIDTH, height), _PAPER)
    top = 0
    for row, tallest in zip(rows, heights, strict=True):
        for k, tile in enumerate(row):
            image.paste(tile, (k * (tile.width + _GAP), top))
        top += tallest + _GAP
    return image


def _tile(name: str, scene: tracer.Scene, width: int) -> Image.Image:
    picture = _drawn(scene, width)
    tile = Image.new("RGB", (width, picture.height + _LABEL), _PAPER)
    tile.paste(picture)
    font = ImageFont.load_default(size=13)
    ImageDraw.Draw(tile).text((0, picture.height + 3), name, fill=_INK, font=font)
    return tile


def _drawn(scene: tracer.Scene, width: int) -> Image.Image:
    """The scene at another size, anti-aliased."""
    height = round(scene.height * width / scene.width)
    sized = dataclasses.replace(scene, width=width, height=height)
    return Image.fromarray(np.ascontiguousarray(tracer.to_codes(tracer.render(sized, _SAMPLES))))


def main() -> None:
    """Draw the README's pictures."""
    used = parser("reference.sheet", __doc__)
    used.parse_args()
    need_scenes(used)
    sunflower = _drawn(tracer.load_scene(SCENES / "sunflower.xml"), _WIDTH)
    for name, image in (("sheet.png", sheet(own_scenes())), ("sunflower.png", sunflower)):
        image.save(HERE / name, optimize=True)
        print(HERE / name)


if __name__ == "__main__":
    run(main)
