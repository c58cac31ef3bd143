"""Show the results of a class on one HTML page: a table by student and scene, and all pictures.

A *hand-in*, or submitted picture, is one that a student handed in; the *reference picture* is what
it should be.
"""

from __future__ import annotations

import os
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path

from reference.figures import Differences, amplify_difference
from reference.handins.results import Result, list_mistake_counts, summarize_counts
from reference.page import Cell, Pair, encode_png, prepare_pair, render_page
from reference.pictures import Codes

_LEGEND = (
    "The difference is shown amplified, in linear light: orange where the hand-in is brighter, blue"
    " where it is darker.  A ring marks the pixel that differs most."
)


def make_pair(
    result: Result, submitted_codes: Codes, reference_codes: Codes, difference: Differences
) -> Pair:
    """Prepare a submitted picture and its reference picture for display on an HTML page.

    Parameters
    ----------
    result : Result
        The result of comparing the two pictures.
    submitted_codes, reference_codes : (h, w, 3) uint8 arrays
        8-bit codes of the submitted picture and of the reference picture.
    difference : (h, w) float32 array
        Difference of each pixel in linear light, positive if the submitted picture is brighter.

    Returns
    -------
    Pair
        The two pictures and their difference, a thumbnail, the diagnosis and the metrics.
    """
    diagnosis = result.diagnosis
    return prepare_pair(
        submitted_codes, reference_codes, *amplify_difference(difference), name=str(result.picture),
        is_good=result.agrees, verdict=result.verdict, left_name="hand-in", right_name="right",
        thumbnail=encode_png(submitted_codes, as_thumbnail=True), notes=[str(diagnosis)],
        worst_pixel=result.worst if result.differing else None,
        figures=[
            ("kind", diagnosis and diagnosis.kind),
            ("hint", (diagnosis and diagnosis.hint) or "none"),
            ("SSIM", f"{result.ssim:.6f}"), ("RMSE", f"{result.rmse:.2e}"),
            ("largest difference", f"{result.max:.2e}"), ("pixels that differ", result.differing),
        ],
    )  # fmt: skip


def render_class_page(results: Sequence[Result], pairs: dict[str, Pair], folder: Path) -> str:
    """Render an HTML page that shows the results of a class of students.

    The page contains a table by student and scene, each submitted picture next to its reference
    picture, the number of pictures with each mistake, and the errors of files not compared.

    Parameters
    ----------
    results : sequence of Result
        All results of the class, including results for missing pictures.
    pairs : dict of str to Pair
        The results of `make_pair`, by the path of the submitted picture.
    folder : Path
        Folder of the class.  The page shows paths relative to this folder.

    Returns
    -------
    str
        The page as HTML.
    """
    pair_index = {path: index for index, path in enumerate(pairs)}
    cells: dict[str, dict[str, list[Cell]]] = defaultdict(lambda: defaultdict(list))
    correct_scenes: dict[str, set[str]] = defaultdict(set)
    # Paragraphs on the files that were not compared, or whose pictures are not on the page.
    notes = list[str]()
    for result in results:
        path, diagnosis = result.picture or "", result.diagnosis
        if result.student and result.scene:
            text = diagnosis.first_cause_text if diagnosis and not result.agrees else result.verdict
            thumbnail = pairs[path]["thumbnail"] if path in pairs else None
            cell = Cell(text, pair_index.get(path), result.agrees, thumbnail)
            cells[result.student][result.scene].append(cell)
            correct_scenes[result.student].update([result.scene] if result.agrees else [])
        if diagnosis and path not in pairs:
            notes.append(f"{path}: {diagnosis}")
        elif result.error and (path or not result.student):
            notes.append(result.error)
    scenes = sorted({scene for cells_by_scene in cells.values() for scene in cells_by_scene})
    rows = [[[Cell(student)], [Cell(f"{len(correct_scenes[student])} of {len(scenes)}")],
             *(cells[student].get(scene, []) for scene in scenes)]
            for student in sorted(cells)]  # fmt: skip
    return render_page(
        title=f"Hand-ins in {folder}",
        introduction=f"{len(cells)} students, {len(scenes)} scenes.",
        verdict=f"{summarize_counts(results)}.",
        is_good=all(result.agrees for result in results),
        table_name="By student and by scene",
        column_titles=["student", "right", *scenes],
        rows=rows,
        pairs=[pair | {"name": os.path.relpath(path, folder)} for path, pair in pairs.items()],
        legend=_LEGEND,
        notes=[*list_mistake_counts(results), *notes],
        hide_good_pairs=True,
    )
