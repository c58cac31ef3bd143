"""Draw the README's pictures, all scenes and a large one of them: ``python -m reference.sheet``."""

from __future__ import annotations

from tracer.command.process import run

if __name__ == "__main__":
    run(__spec__.name)

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

from PIL import Image, ImageDraw, ImageFont

from reference.command import HERE, SCENES, own_scenes, parser
from tracer import Scene, load_scene, render, to_codes

_SAMPLES = 16
_WIDTH, _HEIGHT, _GAP, _LABEL = 960, 175, 12, 22


def sheet(paths: Iterable[Path]) -> Image.Image:
    """All scenes on one sheet, each over its name, the narrowest first."""
    image = Image.new("RGB", (_WIDTH, 10_000), "white")
    pen, font = ImageDraw.Draw(image), ImageFont.load_default(size=13)
    x = y = 0
    drawn = [(_drawn(load_scene(path), _HEIGHT), path.stem) for path in paths]
    for picture, name in sorted(drawn, key=lambda each: each[0].width):
        if x + picture.width > _WIDTH:
            x, y = 0, y + _HEIGHT + _LABEL + _GAP
        image.paste(picture, (x, y))
        pen.text((x, y + _HEIGHT + 3), name, fill=(60, 60, 60), font=font)
        x += picture.width + _GAP
    return image.crop((0, 0, _WIDTH, y + _HEIGHT + _LABEL))


def _drawn(scene: Scene, height: int) -> Image.Image:
    """The scene at another size, anti-aliased."""
    sized = replace(scene, width=round(scene.width * height / scene.height), height=height)
    return Image.fromarray(to_codes(render(sized, _SAMPLES)))


def main() -> None:
    """Draw the README's pictures."""
    parser("reference.sheet", __doc__).parse_args()
    sunflower = _drawn(load_scene(SCENES / "sunflower.xml"), 540)
    for name, image in (("sheet.png", sheet(own_scenes())), ("sunflower.png", sunflower)):
        image.save(HERE / name, optimize=True)
        print(HERE / name)
