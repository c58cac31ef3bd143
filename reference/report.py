"""Render scenes with the tracer and with Mitsuba, and write one HTML page that shows both.

    python -m reference.report [SCENE.xml ...]

The page contains everything that it shows: the pictures, their differences, figures and times.  It
opens from a file, without a server or a network.

Exit status: 0 if all scenes agree, 1 if one differs or cannot be compared, 2 for wrong usage or if
Mitsuba cannot run, 3 if one is undecided and none is worse (see `reference.check`).
"""

from __future__ import annotations

from tracer.command.process import run

if __name__ == "__main__":
    run(__spec__.name)  # before the other imports: see tracer/command/process.py

import itertools
import sys
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from converters.to_mitsuba import set_up_mitsuba
from reference.check import AGREES, EXACT, CheckResult, check_file, choose_exit_status
from reference.command import (
    BUILD,
    REFERENCE_FOLDER,
    forbid_overwriting_inputs,
    list_scene_files,
    make_parser,
)
from reference.figures import (
    LARGE_DIFFERENCE_TEXT,
    PERCENTILE,
    amplify_difference,
    get_largest_difference,
)
from reference.measured.measurements import describe_origin
from reference.page import TEMPLATE, Cell, Pair, prepare_pair, render_page, write_page
from tracer import to_codes
from tracer.command.arguments import CommandParser, check_path, is_folder
from tracer.command.failure import Failure, errors_as_failure
from tracer.command.process import FAILED, MISUSED, attempt, print_line
from tracer.command.progress import track
from tracer.messages import make_printable

# Name of the page in a folder.
_PAGE_NAME = "report.html"
CHARTS = {
    "Accuracy against time": REFERENCE_FOLDER / "speed_accuracy.svg",
    "Where methods fail": REFERENCE_FOLDER / "stability.svg",
}
# 8-bit code of excluded pixels, in all channels, in the picture of the difference.
_EXCLUDED_CODE = 76
_TITLES = "scene", "verdict", "SSIM", "largest difference", "excluded", "tracer's time", "Mitsuba's"
_DIFFERENCE_LEGEND = (
    "The difference is amplified: orange where the tracer is brighter, blue where it is darker."
    " Grey pixels are excluded, because an edge is too close to their centre for float32, or"
    " because surfaces coincide."
)


class ComparedScene(NamedTuple):
    """A scene with the comparison of its two pictures."""

    result: CheckResult
    comment: str  # the first comment of the scene file, which describes the scene


def render_report(
    scenes: Sequence[ComparedScene],
    charts: Iterable[tuple[str, bytes]] = (),
    failures: Sequence[str] = (),
) -> str:
    """Render an HTML page that compares the tracer's pictures with Mitsuba's, scene by scene.

    Parameters
    ----------
    charts
        Charts to show at the end: their titles, and the contents of their SVG files.
    failures
        Messages about scenes that could not be compared.
    """
    results = [scene.result for scene in scenes]
    scene_count = len(results)
    agreeing_count = sum(result.verdict == AGREES for result in results)
    all_agree = 0 < agreeing_count == scene_count and not failures
    variants = ", ".join(sorted({result.mitsuba.variant for result in results}))
    return render_page(
        title="Pencil tracer and Mitsuba 3, scene by scene",
        introduction=f"{scene_count} scene{'s' * (scene_count != 1)}, rendered by both with one"
        " sample at the centre of each pixel and compared in linear light. Away from edges, pixels"
        f" may differ by at most {EXACT.difference:g}.",
        verdict="All agree." if all_agree else f"{agreeing_count} agree.",
        is_good=all_agree,
        table_name="All scenes",
        column_titles=_TITLES,
        rows=[_format_overview_row(index, result) for index, result in enumerate(results)],
        pairs=[_prepare_scene_pair(*scene) for scene in scenes],
        legend=_DIFFERENCE_LEGEND,
        source=f"Mitsuba {variants}; {describe_origin()}",
        faults=[f"Not compared: {failure}" for failure in failures],
        charts=charts,
    )


def _format_overview_row(pair_index: int, result: CheckResult) -> list[list[Cell]]:
    """Format the comparison of one scene as a row of the overview, which links to its pair."""
    verdict = Cell(result.verdict, is_good=result.verdict == AGREES)
    excluded_share = f"{result.is_excluded.mean():.2%}"
    metric_texts = f"{result.metrics.ssim:.6f}", f"{result.metrics.max:.1e}", excluded_share
    times = _format_time(result.tracer_seconds), _format_time(result.mitsuba.seconds)
    cells = Cell(result.name, pair_index), verdict, *map(Cell, metric_texts + times)
    return [[cell] for cell in cells]


def _prepare_scene_pair(result: CheckResult, comment: str) -> Pair:
    """Prepare a compared scene for the HTML page."""
    is_excluded, metrics = result.is_excluded, result.metrics
    is_good = result.verdict == AGREES
    mitsuba_image = np.where(is_excluded[:, :, None], result.tracer_image, result.mitsuba.image)
    difference = get_largest_difference(result.tracer_image - mitsuba_image)
    difference_codes, gain = amplify_difference(difference)
    difference_codes[is_excluded] = _EXCLUDED_CODE
    remarks = [f"{remark[0].upper()}{remark[1:]}." for remark in result.remarks]
    return prepare_pair(
        to_codes(result.tracer_image),
        to_codes(result.mitsuba.image),
        difference_codes,
        gain,
        name=result.name, is_good=is_good, verdict=result.verdict,
        left_name="tracer", right_name="Mitsuba",
        comment=comment,
        faults=[] if is_good else remarks,
        notes=remarks if is_good else [],
        figures=(
            ("SSIM", f"{metrics.ssim:.6f}"), ("largest difference", f"{metrics.max:.2e}"),
            (f"{PERCENTILE}th percentile", f"{metrics.percentile:.2e}"),
            ("RMSE", f"{metrics.rmse:.2e}"), ("median", f"{metrics.median:.2e}"),
            (f"pixels over {LARGE_DIFFERENCE_TEXT}", metrics.differing_count),
            ("edge pixels excluded", result.differs_at_edge.sum()),
            ("ties excluded", result.is_tie.sum()),
            ("tracer's time", _format_time(result.tracer_seconds)),
            (f"Mitsuba's ({result.mitsuba.variant})", _format_time(result.mitsuba.seconds)),
        ),
    )  # fmt: skip


def _format_time(seconds: float) -> str:
    """Format a time: in milliseconds if it is below one second, otherwise in seconds."""
    return f"{1000 * seconds:.3g} ms" if seconds < 1 else f"{seconds:.2f} s"


def _read_comment(path: Path) -> str:
    """Read the first comment before the root of a scene file, as one line; "" if there is none."""
    with path.open("rb") as file:
        first_events = itertools.islice(ET.iterparse(file, ("comment", "start")), 2)
        comments = [element.text or "" for event, element in first_events if event == "comment"]
    return " ".join("".join(comments[:1]).split())


def main(argv: Sequence[str] | None = None) -> int:
    """Compare the scenes named on the command line, and write the report.

    Parameters
    ----------
    argv : sequence of str, optional
        The command-line arguments; by default, the arguments of this process.

    Returns
    -------
    exit_status : int
        0, 1 or 3, as the docstring of this module says.

    Raises
    ------
    Failure
        If Mitsuba cannot run (exit status 2), or the page cannot be written.
    SystemExit
        If the arguments are wrong.
    """
    command_parser = _make_command_parser()
    arguments = command_parser.parse_args(argv)
    paths = sorted({*(arguments.scenes or list_scene_files())})
    output = arguments.output or str(BUILD / _PAGE_NAME)
    page_path = Path(output, _PAGE_NAME if is_folder(output) else "")
    forbid_overwriting_inputs(command_parser, [page_path], (*paths, TEMPLATE, *CHARTS.values()))
    set_up_mitsuba(arguments.variant, exit_status=MISUSED)
    scenes, failures = _compare_scenes(paths, arguments.variant)
    # Charts appear only on a page that shows none but the project's own scenes.
    shows_charts = {*paths} <= {*list_scene_files()}
    charts = [(title, path.read_bytes()) for title, path in CHARTS.items() if shows_charts]
    write_page(page_path, render_report(scenes, charts, failures))
    print_line(sys.stdout, make_printable(str(page_path)))
    return FAILED if failures else choose_exit_status(scene.result for scene in scenes)


def _make_command_parser() -> CommandParser:
    command_parser = make_parser("reference.report")
    add_argument = command_parser.add_argument
    help_text = "scene files (all in scenes/)"
    add_argument("scenes", nargs="*", type=Path, metavar="SCENE.xml", help=help_text)
    help_text = "the page to write, or a folder in which to write it (build/report.html)"
    add_argument("-o", "--output", type=check_path, metavar="PATH", help=help_text)
    add_argument("--variant", help="Mitsuba's variant (the fastest that works here)")
    return command_parser


def _compare_scenes(
    paths: Sequence[Path], variant: str | None
) -> tuple[list[ComparedScene], list[str]]:
    """Compare the pictures of scenes; return the compared scenes, and messages about the others.

    The messages are also printed.  `variant` is the name of Mitsuba's variant; None stands for the
    fastest.
    """
    names_are_unique = len({path.stem for path in paths}) == len(paths)
    scenes = []
    failures = []
    for path in track(paths, len(paths), "scenes"):
        name = make_printable(path.stem if names_are_unique else str(path))
        outcome = attempt(_compare_scene, path, name, variant)
        if isinstance(outcome, Failure):
            failures.append(str(outcome))
        else:
            scenes.append(outcome)
    return scenes, failures


def _compare_scene(path: Path, name: str, variant: str | None) -> ComparedScene:
    """Compare the pictures of a scene file.

    `name` is the scene's name on the page.  Raise Failure if the scene cannot be read or compared.
    """
    result = replace(check_file(path, variant), name=name)
    with errors_as_failure(path, "read"):
        return ComparedScene(result=result, comment=_read_comment(path))
