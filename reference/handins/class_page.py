"""The results of a class on one page: by student and by scene, with all pairs of pictures."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from reference.figures import amplify_difference, decode_to_linear
from reference.handins.results import Result, count_of, mistake_counts
from reference.page import Cell, Pair, encode_png, prepare_pair, render_page
from reference.pictures import Codes

_LEGEND = (
    "The difference is shown amplified, in linear light: orange where the hand-in is brighter, blue"
    " where it is darker.  A ring marks the pixel that differs most."
)


def pair_of(result: Result, handin: Codes, right: Codes) -> Pair:
    """Return the pair of a hand-in and the right picture, which have the same size."""
    diagnosis = result.diagnosis
    return prepare_pair(
        handin,
        right,
        *amplify_difference(decode_to_linear(handin), decode_to_linear(right)),
        name=str(result.picture),
        good=result.agrees,
        word=result.word,
        left="hand-in",
        right="right",
        thumbnail=encode_png(handin, thumbnail=True),
        notes=[str(diagnosis)],
        worst=result.worst if result.differing else None,
        figures=[
            ("kind", diagnosis and diagnosis.kind),
            ("hint", (diagnosis and diagnosis.hint) or "none"),
            ("SSIM", f"{result.ssim:.6f}"), ("RMSE", f"{result.rmse:.2e}"),
            ("largest difference", f"{result.max:.2e}"), ("pixels that differ", result.differing),
        ],
    )  # fmt: skip


def _cell(result: Result, shown: Pair | None, link: int | None) -> Cell:
    """Return the cell of the overview: the verdict, or the first cause in words."""
    text = result.word
    if result.diagnosis and text == "differs":
        text = result.diagnosis.first
    return Cell(text, link, result.agrees, shown["thumbnail"] if shown else None)


def class_page(results: Sequence[Result], pairs: dict[str, Pair], folder: Path) -> str:
    """Return the page as HTML.

    Parameters
    ----------
    results : sequence of Result
        All results of the class.
    pairs : dict of str to Pair
        Pairs by the pictures' names.
    folder : Path
        Folder that contains all pictures.
    """
    links = {name: k for k, name in enumerate(pairs)}
    cells: dict[str, dict[str, list[Cell]]] = {}
    right: dict[str, set[str]] = {}
    for result in results:
        if result.student and result.scene:
            name, student = result.picture or "", result.student
            cell = _cell(result, pairs.get(name), links.get(name))
            cells.setdefault(student, {}).setdefault(result.scene, []).append(cell)
            right.setdefault(student, set()).update([result.scene] if result.agrees else [])
    scenes = sorted({scene for row in cells.values() for scene in row})
    rows = [[[Cell(student)], [Cell(f"{len(right[student])} of {len(scenes)}")],
             *(row.get(scene, []) for scene in scenes)]
            for student, row in sorted(cells.items())]  # fmt: skip
    notes = [f"{result.picture}: {result.diagnosis}" for result in results
             if result.diagnosis and result.picture not in pairs]  # fmt: skip
    errors = [result.error for result in results if result.error and not (
        result.student and result.scene and not result.picture)]  # fmt: skip
    return render_page(
        title=f"Hand-ins in {folder}",
        lead=f"{len(cells)} students, {len(scenes)} scenes.",
        verdict=f"{count_of(results)}.",
        good=all(result.agrees for result in results),
        overview="By student and by scene",
        head=["student", "right", *scenes],
        rows=rows,
        pairs=[shown | {"name": os.path.relpath(name, folder)} for name, shown in pairs.items()],
        legend=_LEGEND,
        below=[*mistake_counts(results), *notes, *errors],
        is_folded=True,
    )
