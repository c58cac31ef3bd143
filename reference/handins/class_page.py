"""The results of a class on one page: by student and by scene, with all pairs of pictures."""

from __future__ import annotations

import os
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path

from reference.figures import amplify_difference, decode_to_linear
from reference.handins.results import Result, mistake_lines, summarize_counts
from reference.page import Cell, Pair, encode_png, prepare_pair, render_page
from reference.pictures import Codes

_LEGEND = (
    "The difference is shown amplified, in linear light: orange where the hand-in is brighter, blue"
    " where it is darker.  A ring marks the pixel that differs most."
)


def make_pair(result: Result, handin: Codes, right: Codes) -> Pair:
    """Return what an HTML page shows of a hand-in: both pictures, their difference and figures.

    Parameters
    ----------
    result : Result
        The result of comparing the two pictures.
    handin, right : (h, w, 3) uint8 arrays
        Codes of the picture that was handed in, and of the right picture.
    """
    diagnosis = result.diagnosis
    return prepare_pair(
        handin,
        right,
        *amplify_difference(decode_to_linear(handin), decode_to_linear(right)),
        name=str(result.picture),
        good=result.agrees,
        word=result.verdict,
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


def _make_cell(result: Result, pair: Pair | None, pair_index: int | None) -> Cell:
    """Return the table cell for one result; rows are students, and columns are scenes.

    Its text is the verdict, or, for a picture that differs, the sentences of the first cause.

    Parameters
    ----------
    result : Result
        The result of a comparison.
    pair : Pair or None
        The pair of pictures on the page, if there is one; the cell shows its thumbnail.
    pair_index : int or None
        Index of the pair on the page; the cell links to this pair.
    """
    text = result.verdict
    if result.diagnosis and text == "differs":
        text = result.diagnosis.first
    return Cell(text, pair_index, result.agrees, pair["thumbnail"] if pair else None)


def class_page(results: Sequence[Result], pairs: dict[str, Pair], folder: Path) -> str:
    """Return a page, as HTML, that shows the results of a class.

    It has a table by student and by scene, the pairs of pictures, the number of pictures with each
    mistake, and what could not be compared.

    Parameters
    ----------
    results : sequence of Result
        All results of the class.
    pairs : dict of str to Pair
        The pairs of pictures to show, by the path of the picture that was handed in.
    folder : Path
        Folder of the class.  The page shows the paths of pictures relative to it.
    """
    index_of = {path: k for k, path in enumerate(pairs)}
    cells: dict[str, dict[str, list[Cell]]] = defaultdict(lambda: defaultdict(list))
    right_scenes: dict[str, set[str]] = defaultdict(set)
    for result in results:
        if result.student and result.scene:
            path, student = result.picture or "", result.student
            cell = _make_cell(result, pairs.get(path), index_of.get(path))
            cells[student][result.scene].append(cell)
            right_scenes[student].update([result.scene] if result.agrees else [])
    scenes = sorted({scene for cells_of_scenes in cells.values() for scene in cells_of_scenes})
    rows = [[[Cell(student)], [Cell(f"{len(right_scenes[student])} of {len(scenes)}")],
             *(cells[student].get(scene, []) for scene in scenes)]
            for student in sorted(cells)]  # fmt: skip
    notes = [f"{result.picture}: {result.diagnosis}" for result in results
             if result.diagnosis and result.picture not in pairs]  # fmt: skip
    errors = [result.error for result in results if result.error and not (
        result.student and result.scene and not result.picture)]  # fmt: skip
    return render_page(
        title=f"Hand-ins in {folder}",
        lead=f"{len(cells)} students, {len(scenes)} scenes.",
        verdict=f"{summarize_counts(results)}.",
        good=all(result.agrees for result in results),
        overview="By student and by scene",
        head=["student", "right", *scenes],
        rows=rows,
        pairs=[pair | {"name": os.path.relpath(path, folder)} for path, pair in pairs.items()],
        legend=_LEGEND,
        below=[*mistake_lines(results), *notes, *errors],
        is_folded=True,
    )
