"""Read the table of mistakes from the page `mistakes.md`.

The page defines the right picture by formulas, and each mistake by the formulas that it replaces.
The order is that of reports: of mistakes with the same picture, the first is named first.
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
    """Yield the rows of all tables of the page, as cells without backticks."""
    for line in _PAGE.read_text(encoding="utf-8").splitlines():
        if line.startswith("| `"):
            yield [cell.strip(" `") for cell in line.strip("|").split("|")]


RIGHT: Formulas = {row[0]: formula(row[1]) for row in _rows() if len(row) == 2}
"""The formulas of the right picture, in the order of computation."""
CAMERA = frozenset([*RIGHT][: [*RIGHT].index("samples")])
"""Formulas of the camera."""
_MISTAKES = [row for row in _rows() if len(row) == 3]


def read(formulas: str) -> Formulas:
    """Convert the formulas of a mistake, such as ``x = column / width; y = row / height``."""
    pairs = (assignment.split(" = ", 1) for assignment in formulas.split("; "))
    return {name: formula(expression) for name, expression in pairs}


def offset(x: float, y: float) -> Formulas:
    """Return formulas that sample each pixel at (x, y) instead of its centre (0.5, 0.5)."""
    return read(f"x = (column + {x}) / width - 0.5; y = 0.5 - (row + {y}) / height")


# Formulas that replace those of a scene if only a right picture is known.
OF_PICTURE = read("hit = shown_in(picture, x, y, handin); radiance = light_in(picture, x, y)")


def mistakes_of(scene: Scene) -> dict[str, Mistake]:
    """Return the mistakes that are possible with a scene, by their keywords.

    A row of the table with ``{k}`` becomes one mistake for each light or surface of the scene; they
    are numbered from 0, as by `tracer --pixel`.
    """
    lines = [f" (line {light.line})" if light.line else "" for light in scene.lights]
    named = {
        "{surface}": [str(SurfaceRef.from_index(scene, k)) for k in range(len(scene.surfaces))],
        "{light}": [f"Light {k}{line}" for k, line in enumerate(lines)],
    }
    table = {}
    for kind, text, formulas in _MISTAKES:
        word = next((word for word in named if word in text), "")
        for k, name in enumerate(named.get(word, [""])):
            changes = read(formulas.replace("{k}", str(k)))
            mistake = Mistake(text.replace(word, name), changes, bool(word))
            table[kind.replace("{k}", str(k))] = mistake
    return table
