"""Read the table of known mistakes from the page `mistakes.md`.

The page defines the reference picture by *formulas*, and each mistake by the formulas that it
replaces.  A formula is a Python expression for a value such as the radiance; `Formulas` are
compiled ones by name.  Reports name mistakes with the same picture in the order of the table.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from reference.handins.formulas import Formulas, compile_formula
from tracer import Scene, SurfaceRef

_PAGE = Path(__file__).with_name("mistakes.md")
VARIANTS = ("shadow-own", "shadow-own-lobe", "normals-not-turned")
"""Other correct ways to write a tracer, with which some mistakes look different."""
BACKGROUND: tuple[str, ...] = ("background",)
"""The cause (a tuple of keywords of mistakes) of a background that is not black."""
ALWAYS_PAIRED = ("wrapped", "black-overexposed", "normalised-per-pixel", "clipped-per-light")
"""Mistakes that are tried in all pairs, although alone they may show nothing.

They show only where the radiance exceeds 1, perhaps because of another mistake.
"""
ROUNDINGS = ("levels-truncated", "levels-256", "levels-up")
"""Mistakes that change levels by one."""


class Mistake(NamedTuple):
    """A mistake that a tracer may contain, as described by a row of the table of mistakes."""

    # A placeholder such as ``{fitted_gamma}`` stands for the value of a formula.
    sentence: str
    formulas: Formulas  # those that it replaces
    concerns_one_object: bool = False  # true for a missing surface or light, for example


def _read_table_rows() -> Iterator[list[str]]:
    """Yield the cells of each row of the page's tables, without headings and backticks."""
    for line in _PAGE.read_text(encoding="utf-8").splitlines():
        if line.startswith("| `"):
            yield [cell.strip(" `") for cell in line.strip("|").split("|")]


REFERENCE_FORMULAS: Formulas = {
    row[0]: compile_formula(row[1]) for row in _read_table_rows() if len(row) == 2
}
"""The formulas of the reference picture, in the order of computation."""
CAMERA_FORMULAS = frozenset([*REFERENCE_FORMULAS][: [*REFERENCE_FORMULAS].index("samples")])
"""Names of the camera's formulas."""
WHOLE_PICTURE_FORMULAS = {k for k in REFERENCE_FORMULAS if k.startswith("fitted_")} | {"brightest"}
"""Names of formulas with one value for the whole picture, computed from all pixels."""
_MISTAKES = [row for row in _read_table_rows() if len(row) == 3]


def parse_formulas(assignments: str) -> Formulas:
    """Compile assignments such as ``x = column / width; y = row / height``.

    Raise SyntaxError if an expression is not valid Python.
    """
    names_and_expressions = (assignment.split(" = ", 1) for assignment in assignments.split("; "))
    return {name: compile_formula(expression) for name, expression in names_and_expressions}


def make_sample_formulas(dx: float, dy: float) -> Formulas:
    """Make the formulas "x" and "y" that place one sample at a given position in each pixel.

    `dx` and `dy` are the sample's distances from the left and upper edges of the pixel, relative to
    the pixel's width and height.
    """
    return parse_formulas(f"x = (column + {dx}) / width - 0.5; y = 0.5 - (row + {dy}) / height")


# Formulas that replace those of a scene if only the reference picture is known.
PICTURE_FORMULAS = parse_formulas(
    "hit = guess_hits(picture, x, y, submitted_codes); radiance = interpolate_light(picture, x, y)"
)


def list_mistakes(scene: Scene) -> dict[str, Mistake]:
    """List the mistakes that a tracer may make when it renders a scene, by keyword.

    A row of `_MISTAKES` with ``{surface}``, ``{light}`` or ``{face}`` in its sentence is repeated
    for each surface, light or face of a box, whose index replaces ``{k}`` in the row.  The mistakes
    are in the order of the table; a keyword is such as "gamma-none".
    """
    line_notes = [f" (line {light.line})" if light.line else "" for light in scene.lights]
    names_by_placeholder = {
        "{surface}": [str(SurfaceRef.from_index(scene, k)) for k in range(len(scene.surfaces))],
        "{light}": [f"Light {index}{note}" for index, note in enumerate(line_notes)],
        "{face}": [f"face at {corner}'s {axis}" for axis in "xyz" for corner in ("minPt", "maxPt")],
    }
    mistakes = {}
    for keyword, sentence, assignments in _MISTAKES:
        placeholder = next((key for key in names_by_placeholder if key in sentence), "")
        for index, name in enumerate(names_by_placeholder.get(placeholder, [""])):
            formulas = parse_formulas(assignments.replace("{k}", str(index)))
            mistake = Mistake(sentence.replace(placeholder, name), formulas, bool(placeholder))
            mistakes[keyword.replace("{k}", str(index))] = mistake
    return mistakes
