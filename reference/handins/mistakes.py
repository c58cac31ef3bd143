"""Read the table of mistakes from the page `mistakes.md`.

The page defines the right picture by formulas, and each mistake by the formulas that it replaces.
A formula is a Python expression for a value such as the radiance.  Reports follow the order of the
table: of mistakes with the same picture, the first in the table is named first.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from reference.handins.formulas import Formulas, compile_formula
from tracer import Scene, SurfaceRef

_PAGE = Path(__file__).with_name("mistakes.md")
FITTED = frozenset({"brightest", "fitted_factor", "fitted_ambient", "fitted_gamma",
                    "fitted_background"})  # fmt: skip
"""Formulas with one value for the whole picture, computed from all pixels."""
VARIANTS = ("shadow-own", "shadow-own-lobe")
"""Not mistakes: other ways to write a right tracer, which render some mistakes differently."""
BACKGROUND: tuple[str, ...] = ("background",)
"""The cause (tuple of keywords of mistakes) of a background that is not black."""
OVEREXPOSED = ("wrapped", "black-overexposed", "normalised-per-pixel", "clipped-per-light")
"""Mistakes that show only where radiance exceeds 1, which another mistake may bring about."""
ROUNDINGS = ("levels-truncated", "levels-256", "levels-up")
"""Mistakes by which levels are off by one."""


class Mistake(NamedTuple):
    """A mistake that a tracer may contain, as a row of the table of mistakes describes it.

    Attributes
    ----------
    text : str
        A sentence that states what is wrong.
    formulas : dict of str to callable
        The formulas, by their names, that replace those of the right picture.
    concerns_one_object : bool
        True if the mistake concerns one surface or one light of the scene, such as a surface that
        is missing.
    """

    text: str
    formulas: Formulas
    concerns_one_object: bool = False


def _table_rows() -> Iterator[list[str]]:
    """Yield the rows of all tables on the page `mistakes.md`.

    Each row is the list of its cells, without the backticks around names and formulas.  Headings of
    the tables are skipped.
    """
    for line in _PAGE.read_text(encoding="utf-8").splitlines():
        if line.startswith("| `"):
            yield [cell.strip(" `") for cell in line.strip("|").split("|")]


RIGHT: Formulas = {row[0]: compile_formula(row[1]) for row in _table_rows() if len(row) == 2}
"""The formulas of the right picture, in the order of computation."""
CAMERA = frozenset([*RIGHT][: [*RIGHT].index("samples")])
"""Names of the camera's formulas."""
_MISTAKES = [row for row in _table_rows() if len(row) == 3]


def parse_formulas(assignments: str) -> Formulas:
    """Convert assignments, such as ``x = column / width; y = row / height``, to functions.

    Returns
    -------
    dict of str to callable
        For each name on the left of an assignment, a function that computes the expression on the
        right.  Its parameters are the names in the expression.

    Raises
    ------
    SyntaxError
        If an expression is not Python.
    """
    pairs = (assignment.split(" = ", 1) for assignment in assignments.split("; "))
    return {name: compile_formula(expression) for name, expression in pairs}


def sample_position_formulas(x: float, y: float) -> Formulas:
    """Return the formulas that move the sample of each pixel away from the pixel's centre.

    Parameters
    ----------
    x, y : float
        Position of the sample in the pixel, from 0 at the left and upper edges to 1 at the right
        and lower edges.  The centre is (0.5, 0.5).

    Returns
    -------
    dict of str to callable
        The formulas `x` and `y`, which replace those of the right picture.
    """
    return parse_formulas(f"x = (column + {x}) / width - 0.5; y = 0.5 - (row + {y}) / height")


# Formulas that replace those of a scene if only a right picture is known.
OF_PICTURE = parse_formulas(
    "hit = shows_surface(picture, x, y, handin); radiance = interpolate_light(picture, x, y)"
)


def list_mistakes(scene: Scene) -> dict[str, Mistake]:
    """Return the mistakes that are possible with a scene.

    A row of the table whose text contains ``{surface}`` or ``{light}`` becomes one mistake for each
    surface or light of the scene.  Its number, from 0 as in the output of `tracer --pixel`,
    replaces ``{k}`` in the keyword and in the formulas.

    Returns
    -------
    dict of str to Mistake
        The mistakes by their keywords, such as "gamma-none", in the order of the table.
    """
    line_notes = [f" (line {light.line})" if light.line else "" for light in scene.lights]
    object_names = {
        "{surface}": [str(SurfaceRef.from_index(scene, k)) for k in range(len(scene.surfaces))],
        "{light}": [f"Light {k}{note}" for k, note in enumerate(line_notes)],
    }
    table = {}
    for kind, text, assignments in _MISTAKES:
        placeholder = next((word for word in object_names if word in text), "")
        for k, name in enumerate(object_names.get(placeholder, [""])):
            formulas = parse_formulas(assignments.replace("{k}", str(k)))
            mistake = Mistake(text.replace(placeholder, name), formulas, bool(placeholder))
            table[kind.replace("{k}", str(k))] = mistake
    return table
