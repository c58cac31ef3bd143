"""Draw the README's pictures, all scenes and a large one of them: ``python -m reference.sheet``."""

from __future__ import annotations

from tracer.command.process import run

if __name__ == "__main__":
    run(__spec__.name)

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from reference.command import HERE, SCENES, need_scenes, own_scenes, parser
from tracer import Scene, load_scene, render, to_codes

__all__ = ["main", "sheet"]

_SAMPLES = 16
# A row holds five square pictures or three wide ones.
_WIDTH, _GAP, _LABEL = 960, 12, 22


def sheet(paths: Iterable[Path]) -> Image.Image:
    """All scenes on one sheet, each over its name: square ones first, then wide ones."""
    scenes = {path.stem: load_scene(path) for path in sorted(paths)}
    places, top = list[tuple[str, Image.Image, tuple[int, int]]](), 0
    for per_row in (5, 3):
        width = (_WIDTH - (per_row - 1) * _GAP) // per_row
        square = [name for name, s in scenes.items() if s.width == s.height]
        shown = square if per_row == 5 else [name for name in scenes if name not in square]
        for first in range(0, len(shown), per_row):
            row = {name: _drawn(scenes[name], width) for name in shown[first : first + per_row]}
            for k, (name, picture) in enumerate(row.items()):
                places.append((name, picture, (k * (width + _GAP), top)))
            top += max(picture.height for picture in row.values()) + _LABEL + _GAP
    image = Image.new("RGB", (_WIDTH, top - _GAP), (255, 255, 255))
    pen, font = ImageDraw.Draw(image), ImageFont.load_default(size=13)
    for name, picture, (x, y) in places:
        image.paste(picture, (x, y))
        pen.text((x, y + picture.height + 3), name, fill=(60, 60, 60), font=font)
    return image


def _drawn(scene: Scene, width: int) -> Image.Image:
    """The scene at another size, anti-aliased."""
    sized = replace(scene, width=width, height=round(scene.height * width / scene.width))
    return Image.fromarray(np.ascontiguousarray(to_codes(render(sized, _SAMPLES))))


def main() -> None:
    """Draw the README's pictures."""
    used = parser("reference.sheet", __doc__)
    used.parse_args()
    need_scenes(used)
    sunflower = _drawn(load_scene(SCENES / "sunflower.xml"), _WIDTH)
    for name, image in (("sheet.png", sheet(own_scenes())), ("sunflower.png", sunflower)):
        image.save(HERE / name, optimize=True)
        print(HERE / name)
