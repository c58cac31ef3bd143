"""The table of mistakes, as the page `mistakes.md` lists them: which formulas each replaces.

General ones come before special ones: of those that draw the same, they are named in this order.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from reference.handins.formulas import Formulas, formula
from tracer import Scene, SurfaceRef

_PAGE = Path(__file__).with_name("mistakes.md")
FITTED = frozenset({"brightest", "fitted_factor", "fitted_ambient", "fitted_gamma",
                    "fitted_background"})  # fmt: skip
"""Formulas with one value for the whole picture, computed from all pixels."""
VARIANTS = ("shadow-own", "shadow-own-lobe")
"""Not mistakes: other ways to write a right tracer, which render some mistakes differently."""
BACKGROUND: tuple[str, ...] = ("background",)
OVEREXPOSED = ("wrapped", "black-overexposed", "normalised-per-pixel", "clipped-per-light")
"""Mistakes that show only where light is beyond 1, which another mistake may bring about."""
ROUNDINGS = ("levels-truncated", "levels-256", "levels-up")
"""Mistakes by which levels are off by one."""


class Mistake(NamedTuple):
    """A mistake of the table.

    Attributes
    ----------
    text : str
        A sentence on what is wrong.
    formulas : dict
        The formulas that replace those of the right picture.
    is_numbered : bool
        Whether this is the mistake of a single surface or light, of those that the scene has.
    """

    text: str
    formulas: Formulas
    is_numbered: bool = False


def _rows() -> Iterator[list[str]]:
    """The cells of all tables of the page, less their heads; code without its backticks."""
    for line in _PAGE.read_text(encoding="utf-8").splitlines():
        if line.startswith("| `"):
            yield [cell.strip(" `") for cell in line.strip("|").split("|")]


RIGHT: Formulas = {row[0]: formula(row[1]) for row in _rows() if len(row) == 2}
"""The right picture, in the order of computation."""
CAMERA = frozenset([*RIGHT][: [*RIGHT].index("samples")])
"""Formulas of the camera."""
_MISTAKES = [row for row in _rows() if len(row) == 3]


def read(formulas: str) -> Formulas:
    """Read what a mistake changes, as in `x = column / width; y = row / height`."""
    pairs = (part.split(" = ", 1) for part in formulas.split("; "))
    return {name: formula(expression) for name, expression in pairs}


def offset(x: float, y: float) -> Formulas:
    """Samples at (x, y) of each pixel, in place of its centre (0.5, 0.5)."""
    return read(f"x = (column + {x}) / width - 0.5; y = 0.5 - (row + {y}) / height")


# Where the right picture is given in place of a scene, its light is looked up.
OF_PICTURE = read("hit = shown_in(picture, x, y, handin); radiance = light_in(picture, x, y)")


def mistakes_of(scene: Scene) -> dict[str, Mistake]:
    """The table for a scene: what stands for any light or surface, {k}, is there for each of them.

    They are numbered from 0, as `tracer --pixel` does.
    """
    lines = [f" (line {light.line})" if light.line else "" for light in scene.lights]
    named = {
        "{surface}": [str(SurfaceRef.from_index(scene, k)) for k in range(len(scene.surfaces))],
        "{light}": [f"Light {k}{line}" for k, line in enumerate(lines)],
    }
    found = {}
    for kind, text, formulas in _MISTAKES:
        word = next((word for word in named if word in text), "")
        for k, name in enumerate(named.get(word, [""])):
            changes = read(formulas.replace("{k}", str(k)))
            one = Mistake(text.replace(word, name), changes, bool(word))
            found[kind.replace("{k}", str(k))] = one
    return found
