"""Write the scenes that have too many objects to write by hand: ``python -m reference.generate``.

They come out the same every time, and on every machine.
"""

from __future__ import annotations

from tracer.command.process import run

if __name__ == "__main__":
    run(__spec__.name)

import colorsys
import io
import math
import random
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from reference.command import SCENES, need_scenes, parser
from tracer import Box, Camera, Phong, PointLight, Scene, Sphere, save_scene

__all__ = ["main", "many_objects", "sunflower", "write"]


def _rounded(*values: float) -> list[float]:
    """Numbers with three decimals; adding 0 makes a rounded -0 plain 0."""
    return [round(value, 3) + 0 for value in values]


def _phong(color: Sequence[float], specular: float, exponent: float) -> Phong:
    return Phong(diffuse=_rounded(*color), specular=(specular,) * 3, exponent=exponent)


def many_objects(count: int = 500, seed: int = 1) -> Scene:
    """Make a cloud of small balls and boxes: every third is a box.

    `seed` is that of Python's Mersenne Twister.
    """
    shuffled = random.Random(seed)
    palette = [_phong(colorsys.hsv_to_rgb(k / 12, 0.72, 0.8), 0.3, 30) for k in range(12)]
    surfaces: list[Sphere | Box] = []
    for k in range(count):
        x, y, z = shuffled.gauss(0, 3.4), shuffled.gauss(0, 1.9), shuffled.uniform(-5, 3)
        size = 0.08 * 5 ** shuffled.random()
        if k % 3:
            shader, radius = shuffled.choice(palette), round(size, 3)
            surfaces.append(Sphere(center=_rounded(x, y, z), radius=radius, shader=shader))
        else:
            a, b, c = (size * shuffled.uniform(0.5, 1.2) for _ in range(3))
            low, high = _rounded(x - a, y - b, z - c), _rounded(x + a, y + b, z + c)
            surfaces.append(Box(min_pt=low, max_pt=high, shader=shuffled.choice(palette)))
    camera = Camera(view_point=(0, 0, 9), view_width=2.4, view_height=1.35)
    lights = [
        PointLight(position=(6, 9, 8), intensity=(0.75, 0.72, 0.66)),
        PointLight(position=(-9, 2, 5), intensity=(0.2, 0.26, 0.36)),
    ]
    return Scene(camera=camera, width=320, height=180, lights=lights, surfaces=surfaces)


def sunflower(count: int = 233) -> Scene:
    """Make balls in a sunflower's spiral on a dark ground.

    Seed k stands at the golden angle from the one before, at a distance that grows as the root of k
    (H. Vogel, Mathematical Biosciences 44, 1979).
    """
    ground = _phong((0.1, 0.11, 0.17), 0.12, 12)
    surfaces: list[Sphere | Box] = [Box(min_pt=(-60, -2, -60), max_pt=(60, 0, 60), shader=ground)]
    for k in range(1, count + 1):
        t, turn = k / count, k * math.pi * (3 - math.sqrt(5))
        radius = 0.16 + 0.27 * math.sin(math.pi * t**0.8) ** 1.5
        distance = 6.1 * math.sqrt(t)
        color = colorsys.hsv_to_rgb((0.13 - 0.38 * t**1.2) % 1, 0.85 - 0.2 * t, 0.9 - 0.25 * t)
        center = _rounded(distance * math.cos(turn), radius, distance * math.sin(turn))
        shader = _phong(color, 0.45, 60)
        surfaces.append(Sphere(center=center, radius=round(radius, 3), shader=shader))
    window: Any = {"proj_distance": 3, "view_width": 3.68, "view_height": 2.07}
    camera = Camera(view_point=(0, 7.6, 11), view_dir=(0, -8.25, -10.6), **window)
    lights = [
        PointLight(position=(9, 8, 3), intensity=(0.9, 0.76, 0.56)),
        PointLight(position=(-10, 6, 6), intensity=(0.14, 0.24, 0.5)),
        PointLight(position=(-4, 3, -14), intensity=(0.42, 0.28, 0.36)),
    ]
    return Scene(camera=camera, width=320, height=180, lights=lights, surfaces=surfaces)


_SUNFLOWER = """A sunflower of 233 balls, each turned from the one before by the golden angle,
     under a warm light, a cool one and a low one from behind"""


def write(folder: Path) -> list[Path]:
    """Write the scenes into a folder, each under a comment that says what it shows."""
    shown = {"500 small objects at random": many_objects(), _SUNFLOWER: sunflower()}
    paths = [folder / "many-objects.xml", folder / "sunflower.xml"]
    for path, (shows, scene) in zip(paths, shown.items(), strict=True):
        save_scene(scene, text := io.BytesIO())
        head = f"<!-- {shows} (python -m reference.generate). -->\n"
        path.write_bytes(head.encode() + text.getvalue())
    return paths


def main() -> None:
    """Write the scenes into ``scenes/``."""
    used = parser("reference.generate", __doc__)
    used.parse_args()
    need_scenes(used)
    print(*write(SCENES), sep="\n")
