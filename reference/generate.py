"""Write the generated scenes: ``python -m reference.generate``.

Two scenes of ``scenes/`` have too many objects to write by hand.  Both come
out the same every time, and on every machine.
"""

from __future__ import annotations

import colorsys
import math
import random
from collections.abc import Iterable, Iterator, Sequence

from reference.command import SCENES, need_scenes, parser, run
from tracer.arrays import Vector

__all__ = ["main", "many_objects", "sunflower"]


def many_objects(count: int = 500, seed: int = 1) -> str:
    """A cloud of small balls and boxes, as XML.

    Parameters
    ----------
    count : int
        How many objects; every third is a box.
    seed : int
        Of Python's Mersenne Twister.
    """
    shuffled = random.Random(seed)
    palette = [f"hue{k}" for k in range(12)]
    lines = [
        *_head(
            f"{count} small objects at random (python -m reference.generate, seed {seed}).",
            eye=(0, 0, 9),
            direction=(0, 0, -1),
            window=(1, 2.4, 1.35),
        ),
        *_light((6, 9, 8), (0.75, 0.72, 0.66)),
        *_light((-9, 2, 5), (0.2, 0.26, 0.36)),
        *(
            line
            for k, name in enumerate(palette)
            for line in _phong(name, colorsys.hsv_to_rgb(k / len(palette), 0.72, 0.8), 0.3, 30)
        ),
    ]
    for k in range(count):
        at = (shuffled.gauss(0, 3.4), shuffled.gauss(0, 1.9), shuffled.uniform(-5, 3))
        size = 0.08 * 5 ** shuffled.random()
        if k % 3:
            lines += _sphere(shuffled.choice(palette), at, size)
        else:
            sides = [size * shuffled.uniform(0.5, 1.2) for _ in range(3)]
            lines += _box(shuffled.choice(palette), at, sides)
    return "\n".join([*lines, "</scene>", ""])


def sunflower(count: int = 233) -> str:
    """Balls in a sunflower's spiral on a dark ground, as XML.

    Seed k stands at the golden angle from the one before, at a distance that
    grows as the root of k (H. Vogel, Mathematical Biosciences 44, 1979).
    """
    lines = [
        *_head(
            f"A sunflower of {count} balls, each turned from the one before by the golden\n"
            "     angle, under a warm light, a cool one and a low one from behind"
            " (python -m reference.generate).",
            eye=(0, 7.6, 11),
            direction=(0, -8.25, -10.6),
            window=(3, 3.68, 2.07),
        ),
        *_light((9, 8, 3), (0.9, 0.76, 0.56)),
        *_light((-10, 6, 6), (0.14, 0.24, 0.5)),
        *_light((-4, 3, -14), (0.42, 0.28, 0.36)),
        *_phong("ground", (0.1, 0.11, 0.17), 0.12, 12),
        *_box("ground", (0, -1, 0), (60, 1, 60)),
    ]
    golden = math.pi * (3 - math.sqrt(5))
    for k in range(1, count + 1):
        t = k / count
        radius = 0.16 + 0.27 * math.sin(math.pi * t**0.8) ** 1.5
        distance, turn = 6.1 * math.sqrt(t), k * golden
        color = colorsys.hsv_to_rgb((0.13 - 0.38 * t**1.2) % 1, 0.85 - 0.2 * t, 0.9 - 0.25 * t)
        name = f"seed{k}"
        at = (distance * math.cos(turn), radius, distance * math.sin(turn))
        lines += _phong(name, color, 0.45, 60)
        lines += _sphere(name, at, radius)
    return "\n".join([*lines, "</scene>", ""])


def _head(comment: str, eye: Vector, direction: Vector, window: Vector) -> Iterator[str]:
    distance, width, height = window
    yield f"<!-- {comment} -->"
    yield "<scene>"
    yield "    <camera>"
    yield f"        <viewPoint>{_text(eye)}</viewPoint>"
    yield f"        <viewDir>{_text(direction)}</viewDir>"
    yield f"        <projDistance>{distance:g}</projDistance>"
    yield f"        <viewWidth>{width:g}</viewWidth>"
    yield f"        <viewHeight>{height:g}</viewHeight>"
    yield "    </camera>"
    yield "    <image>320 180</image>"


def _light(position: Vector, intensity: Vector) -> Iterator[str]:
    yield (
        f"    <light><position>{_text(position)}</position>"
        f"<intensity>{_text(intensity)}</intensity></light>"
    )


def _phong(name: str, diffuse: Vector, specular: float, exponent: float) -> Iterator[str]:
    yield (
        f'    <shader name="{name}" type="Phong"><diffuseColor>{_text(diffuse)}</diffuseColor>'
        f"<specularColor>{_text([specular] * 3)}</specularColor>"
        f"<exponent>{exponent:g}</exponent></shader>"
    )


def _sphere(shader: str, center: Vector, radius: float) -> Iterator[str]:
    yield (
        f'    <surface type="Sphere"><shader ref="{shader}"/>'
        f"<center>{_text(center)}</center><radius>{radius:.3f}</radius></surface>"
    )


def _box(shader: str, center: Vector, half: Sequence[float]) -> Iterator[str]:
    low = [c - h for c, h in zip(center, half, strict=True)]
    high = [c + h for c, h in zip(center, half, strict=True)]
    yield (
        f'    <surface type="Box"><shader ref="{shader}"/>'
        f"<minPt>{_text(low)}</minPt><maxPt>{_text(high)}</maxPt></surface>"
    )


def _text(values: Iterable[float]) -> str:
    """Numbers with three decimals, none of them superfluous."""
    # Adding 0 makes a rounded -0 plain 0.
    return " ".join(f"{round(value, 3) + 0:g}" for value in values)


def main() -> None:
    """Write the scenes into ``scenes/``."""
    used = parser("reference.generate", __doc__)
    used.parse_args()
    need_scenes(used)
    for name, text in (("many-objects", many_objects()), ("sunflower", sunflower())):
        path = SCENES / f"{name}.xml"
        path.write_text(text, encoding="utf-8", newline="\n")
        print(path)


if __name__ == "__main__":
    run(main)
