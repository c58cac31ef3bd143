"""A class in one page: by student and by scene, with each picture beside the right one."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from reference import page as pages
from reference.figures import Floats, amplified
from reference.handins.results import Result, count_of
from reference.page import Cell, Pair, pair, png
from reference.pictures import Codes

_LEGEND = (
    "The difference is shown amplified, in linear light: orange where the hand-in is brighter, blue"
    " where it is darker.  A ring marks the pixel that differs most."
)


def pair_of(result: Result, codes: tuple[Codes, Codes], light: tuple[Floats, Floats]) -> Pair:
    """A hand-in and the right picture, of one size."""
    return pair(
        *codes,
        *amplified(*light),
        name=str(result.picture),
        good=result.agrees,
        word=result.word,
        left="hand-in",
        right="right",
        thumbnail=png(codes[0], thumbnail=True),
        notes=[str(result.diagnosis)],
        worst=result.worst if result.differing else None,
        figures=[
            ("kind", result.kind), ("SSIM", f"{result.ssim:.6f}"), ("RMSE", f"{result.rmse:.2e}"),
            ("largest difference", f"{result.max:.2e}"), ("pixels that differ", result.differing),
        ],
    )  # fmt: skip


def student_of(picture: str, folder: Path, scene: str) -> str:
    """Who handed a picture in: the folders it is in, and what stands before `_NAME`."""
    path = Path(picture)
    above = path.parent.relative_to(folder) if path.is_relative_to(folder) else Path()
    before = path.name[: path.name.lower().rfind(scene)].rstrip("_") if scene else ""
    return "/".join(part for part in (*above.parts, before) if part) or folder.name


def _cell(result: Result, pair: Pair | None, link: int | None) -> Cell:
    """The verdict, or the first cause of those that draw the hand-in."""
    text, cause = result.word, (result.kind or "").partition("|")[0]
    if text == "differs" and cause != "unknown":
        text = cause.replace("+", " + ")
    return Cell(text, link, result.agrees, pair["thumbnail"] if pair else None)


def class_page(results: Sequence[Result], pairs: dict[str, Pair], folder: Path) -> str:
    """The page as HTML; `pairs` by the names of pictures, `folder` holds all of these."""
    cells: dict[str, dict[str, list[Cell]]] = {}
    links = {name: k for k, name in enumerate(pairs)}
    for result in results:
        if result.picture and result.right:
            name, scene = result.picture, Path(result.right).stem
            student = cells.setdefault(student_of(name, folder, scene.lower()), {})
            student.setdefault(scene, []).append(_cell(result, pairs.get(name), links.get(name)))
    scenes = sorted(set().union(*cells.values()))  # handed in by anybody
    nothing = [Cell("nothing", good=False)]
    nobodys = [str(result.right) for result in results if not result.picture]
    faults = [f"Nobody has handed in {', '.join(nobodys)}."] if nobodys else []
    rows = [[[Cell(student)], *(of.get(scene, nothing) for scene in scenes)]
            for student, of in sorted(cells.items())]  # fmt: skip
    return pages.page(
        title=f"Hand-ins in {folder}",
        lead=f"{len(cells)} students, {len(scenes) + len(nobodys)} scenes.",
        verdict=f"{count_of(results)}.",
        good=all(result.agrees for result in results),
        overview="By student and by scene",
        head=["student", *scenes],
        rows=rows,
        pairs=[pair | {"name": os.path.relpath(name, folder)} for name, pair in pairs.items()],
        legend=_LEGEND,
        faults=faults + [result.error or f"{result.picture}: {result.diagnosis}"
                         for result in results if result.picture not in {None, *pairs}],
    )  # fmt: skip
