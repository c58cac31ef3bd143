"""Show results on HTML pages: a table by student and scene, and all pictures.

A *hand-in*, or submitted picture, is one that a student handed in; the *reference picture* is what
it should be.
"""

from __future__ import annotations

import os
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated as Shaped
from typing import NamedTuple

import numpy as np
from PIL import Image

from reference.figures import Differences, amplify_difference
from reference.handins.results import UNREAD, Result, list_mistake_counts, summarize_counts
from reference.page import Cell, Pair, encode_png, prepare_pair, render_page
from reference.pictures import Codes

_LEGEND = (
    "The difference is shown amplified, in linear light: orange where the hand-in is brighter, blue"
    " where it is darker.  A ring marks the pixel that differs most."
)


class _Table(NamedTuple):
    """The overview table of a page."""

    scenes: list[str]
    rows: list[list[list[Cell]]]  # for each student and column, the contents of a cell


def make_pair(
    result: Result,
    submitted_codes: Shaped[Codes, "h w 3"],
    reference_codes: Shaped[Codes, "h2 w2 3"],
    difference: Shaped[Differences, "h w"] | None,
) -> Pair:
    """Prepare a submitted picture and its reference picture for display on a page.

    `difference` is in linear light, and positive where the submitted picture is brighter.  It is
    None if the pictures have different sizes.  In its place, the page then shows the reference
    picture, stretched to the size of the submitted picture.
    """
    diagnosis = result.diagnosis
    size = f"{reference_codes.shape[1]} × {reference_codes.shape[0]}"
    if difference is None:
        height, width, _ = submitted_codes.shape
        image = Image.fromarray(reference_codes).resize((width, height), Image.Resampling.NEAREST)
        reference_codes = np.asarray(image)
        difference_codes, gain = reference_codes, 0.0
    else:
        difference_codes, gain = amplify_difference(difference)
    figures = [("kind", diagnosis and diagnosis.kind), ("hint", diagnosis and diagnosis.hint)]
    if result.ssim is not None:
        figures += [
            ("SSIM", f"{result.ssim:.6f}"),
            ("RMSE", f"{result.rmse:.2e}"),
            ("largest difference", f"{result.max:.2e}"),
            ("pixels that differ", f"{result.differing:,}"),
        ]
    pair = prepare_pair(
        submitted_codes,
        reference_codes,
        difference_codes,
        gain,
        name=str(result.picture),
        is_good=result.agrees,
        verdict=result.verdict,
        left_name="hand-in",
        right_name="right",
        thumbnail=encode_png(submitted_codes, as_thumbnail=True),
        notes=[str(diagnosis)],
        worst_pixel=result.worst if result.differing else None,
        figures=[(name, value) for name, value in figures if value],
    )
    if difference is None:
        pair["difference_caption"] = f"the right picture, {size}, stretched"
    return pair


def render_class_page(results: Sequence[Result], pairs: dict[str, Pair], folder: Path) -> str:
    """Render a page on a class: a table, the number of students with each mistake, and pictures.

    Parameters
    ----------
    results
        The results for all submitted and missing pictures.
    pairs
        The results of `make_pair`, by the path of the submitted picture.
    folder
        The folder of the class.  The page shows paths relative to it.
    """
    table = _make_table(results, pairs)
    students = {result.student for result in results if result.student}
    student_count = _format_number(len(students), "student")
    return _render_page(
        results,
        pairs,
        folder,
        table,
        title=f"Hand-ins in {folder.resolve().name}",
        introduction=f"{student_count}, {_format_number(len(table.scenes), 'scene')}.",
        counts=list_mistake_counts(results),
    )


def render_student_pages(
    results: Sequence[Result], pairs: dict[str, Pair], folder: Path
) -> dict[str, str]:
    """Render pages that each show one student's pictures and name no other student.

    The arguments are those of `render_class_page`.  The keys of the result are students' names.
    """
    pages = {}
    for student in sorted({result.student for result in results if result.student}):
        own_results = [result for result in results if result.student == student]
        paths = {result.picture for result in own_results}
        own_pairs = {path: pair for path, pair in pairs.items() if path in paths}
        table = _make_table(own_results, own_pairs)
        pages[student] = _render_page(
            own_results,
            own_pairs,
            folder,
            table,
            title=f"Pictures of {student}",
            introduction=f"{_format_number(len(table.scenes), 'scene')}.",
            counts=[],
        )
    return pages


def _format_number(count: int, noun: str) -> str:
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"


def _make_table(results: Sequence[Result], pairs: dict[str, Pair]) -> _Table:
    """Make the table: a row per student, with a cell per scene for its pictures' verdicts."""
    pair_index = {path: index for index, path in enumerate(pairs)}
    cells: dict[str, dict[str, list[Cell]]] = defaultdict(lambda: defaultdict(list))
    correct_scenes: dict[str, set[str]] = defaultdict(set)
    unmatched_names: dict[str, list[str]] = defaultdict(list)
    for result in results:
        if result.student and result.picture and not result.scene:
            unmatched_names[result.student].append(Path(result.picture).name)
    for result in results:
        if not (result.student and result.scene):
            continue
        path = result.picture or ""
        cell = Cell(
            text=_summarize(result, unmatched_names[result.student]),
            link=pair_index.get(path),
            is_good=result.agrees,
            thumbnail=pairs[path]["thumbnail"] if path in pairs else None,
        )
        cells[result.student][result.scene].append(cell)
        if result.agrees:
            correct_scenes[result.student].add(result.scene)
    # A student of whose files none is matched has no cell, but a row.
    students = sorted({*cells, *unmatched_names})
    scenes = sorted({scene for cells_by_scene in cells.values() for scene in cells_by_scene})
    rows = [
        [
            [Cell(text=student)],
            [Cell(text=f"{len(correct_scenes[student])} of {len(scenes)}")],
            *(cells[student].get(scene, []) for scene in scenes),
        ]
        for student in students
    ]
    return _Table(scenes=scenes, rows=rows)


def _summarize(result: Result, unmatched_names: Sequence[str]) -> str:
    """Say in a few words what is wrong with a picture.

    `unmatched_names` are the names of the student's files that match no scene.  If the picture is
    missing, it may be one of these files under another name.
    """
    if result.diagnosis and not result.agrees:
        return result.diagnosis.summary or result.diagnosis.first_cause_text
    if not result.picture and unmatched_names:
        return f"not matched: {', '.join(unmatched_names)}"
    return "cannot be compared" if result.verdict == UNREAD else result.verdict


def _render_page(
    results: Sequence[Result],
    pairs: dict[str, Pair],
    folder: Path,
    table: _Table,
    *,
    title: str,
    introduction: str,
    counts: Sequence[str],
) -> str:
    """Render a page with the given table, pairs, and counts of mistakes."""

    def shorten_paths(result: Result, text: str) -> str:
        """Make the hand-in's path in a text relative, and shorten the reference's to its name."""
        if result.picture:
            text = text.replace(result.picture, os.path.relpath(result.picture, folder))
        return text.replace(result.right, Path(result.right).name) if result.right else text

    shown_pairs = []
    # Paragraphs on the files that were not compared, or whose pictures are not on the page.
    notes = list[str]()
    for result in results:
        path = result.picture or ""
        if path in pairs:
            pair_notes = [shorten_paths(result, note) for note in pairs[path]["notes"]]
            name = os.path.relpath(path, folder)
            shown_pairs.append(pairs[path] | {"name": name, "notes": pair_notes})
        elif result.diagnosis:
            notes.append(shorten_paths(result, f"{path}: {result.diagnosis}"))
        elif result.error and (path or not result.student):
            notes.append(shorten_paths(result, result.error))
    return render_page(
        title=title,
        introduction=introduction,
        verdict=f"{summarize_counts(results)}.",
        is_good=all(result.agrees for result in results),
        table_name="By student and by scene",
        column_titles=["student", "right", *table.scenes],
        rows=table.rows,
        pairs=shown_pairs,
        legend=_LEGEND,
        sections=[("Mistakes", counts), ("Not compared", notes)],
        is_class=True,
    )
