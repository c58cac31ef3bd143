"""Render scenes with the tracer and with Mitsuba, and write one HTML page that shows both.

    python -m reference.report [SCENE.xml ...]

The page holds everything it shows, the difference, the figures and the times among it: it opens
from a file, and asks neither a server nor the network for anything.  Exit status: 0 if all agree,
1 if one differs or cannot be compared, 2 for wrong usage or where Mitsuba cannot run, 3 if one is
undecided and none is worse (see `reference.check`).
"""

from __future__ import annotations

from tracer.command.process import run

if __name__ == "__main__":
    run(__spec__.name)

import itertools
import sys
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from tqdm import tqdm

from converters.to_mitsuba import TROUBLE, describe_error
from converters.variant import use
from reference import page as pages
from reference.check import EXACT, CheckResult, check, worst_status
from reference.command import BUILD, HERE, forbid_overwriting_inputs, own_scenes, parser
from reference.figures import amplified
from reference.measured.measurements import measured_on
from reference.page import TEMPLATE, Cell, Pair
from tracer import to_codes
from tracer.command.arguments import file_name, is_folder
from tracer.command.process import FAILED, MISUSED, print_line
from tracer.files import atomic_file
from tracer.messages import printable

# What a report is called in a folder, and how each begins, as the template does.
_NAME, _HTML = "report.html", b"<!doctype html>"
CHARTS = {
    "Accuracy against time": HERE / "speed_accuracy.svg",
    "Where methods fail": HERE / "stability.svg",
}
_LEFT_OUT = 0.3
_HEAD = ("scene", "verdict", "SSIM", "largest difference", "left out", "tracer's time", "Mitsuba's")


def page(
    results: Sequence[CheckResult],
    comments: Mapping[str, str],
    charts: Iterable[tuple[str, bytes]] = (),
    unread: Sequence[str] = (),
) -> str:
    """The report as HTML, with a comment on each result by its name.

    `charts` are titles and SVGs; `unread` says what is wrong with scenes that were not compared.
    """
    count, agree = len(results), sum(result.verdict == "agrees" for result in results)
    good = bool(results) and agree == count and not unread
    variants = ", ".join(sorted({result.variant for result in results}))
    return pages.page(
        title="Pencil tracer and Mitsuba 3, scene by scene",
        lead=f"{count} scene{'s' * (count != 1)}, sampled at the pixels' centres by both renderers"
        " and compared in linear light: away from edges they may differ by at most"
        f" {EXACT.difference:g}.",
        verdict="All agree." if good else f"{agree} agree.",
        good=good,
        overview="All scenes",
        head=_HEAD,
        rows=[_row(k, result) for k, result in enumerate(results)],
        pairs=[_pair(result, comments.get(result.name, "")) for result in results],
        legend="The difference is shown amplified: orange where the tracer is brighter, blue where"
        " it is darker, grey where a pixel is left out: an edge lies so near its centre that"
        " float32 cannot decide, or surfaces tie.",
        source=f"Mitsuba {variants}; {measured_on()}",
        faults=[f"Not compared: {fault}" for fault in unread],
        charts=charts,
    )


def _row(index: int, result: CheckResult) -> list[list[Cell]]:
    """A line of the overview."""
    f, left_out = result.figures, f"{result.left_out.mean():.2%}"
    texts = f"{f.ssim:.6f}", f"{f.max:.1e}", left_out
    times = _time(result.tracer_seconds), _time(result.mitsuba_seconds)
    verdict = Cell(result.verdict, good=result.verdict == "agrees")
    cells = Cell(result.name, link=index), verdict, *map(Cell, (*texts, *times))
    return [[cell] for cell in cells]


def _pair(result: CheckResult, comment: str) -> Pair:
    """The pictures and their difference, grey where pixels are left out."""
    left_out, f, good = result.left_out, result.figures, result.verdict == "agrees"
    kept = np.where(left_out[:, :, None], result.tracer, result.mitsuba)
    difference, gain = amplified(result.tracer, kept)
    difference[left_out] = _LEFT_OUT
    remarks = [f"{remark[0].upper()}{remark[1:]}." for remark in result.remarks]
    return Pair.of(
        to_codes(result.tracer),
        to_codes(result.mitsuba),
        difference,
        gain,
        name=result.name,
        good=good,
        word=result.verdict,
        left="tracer",
        right="Mitsuba",
        comment=comment,
        faults=[] if good else remarks,
        notes=remarks if good else [],
        figures=(
            ("SSIM", f"{f.ssim:.6f}"), ("largest difference", f"{f.max:.2e}"),
            ("99.9th percentile", f"{f.p999:.2e}"), ("RMSE", f"{f.rmse:.2e}"),
            ("median", f"{f.median:.2e}"), ("pixels over 1e-3", f.over),
            ("edge pixels left out", result.edges.sum()), ("ties left out", result.ties.sum()),
            ("tracer's time", _time(result.tracer_seconds)),
            (f"Mitsuba's ({result.variant})", _time(result.mitsuba_seconds)),
        ),
    )  # fmt: skip


def _time(seconds: float) -> str:
    return f"{1000 * seconds:.3g} ms" if seconds < 1 else f"{seconds:.2f} s"


def _comment(path: Path) -> str:
    """The comment at the head of a scene file, before the first part of the scene, on one line."""
    with path.open("rb") as file:
        first = itertools.islice(ET.iterparse(file, ("comment", "start")), 2)
        texts = [element.text or "" for event, element in first if event == "comment"]
    return " ".join("".join(texts[:1]).split())


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit status."""
    used = parser("reference.report", __doc__)
    used.add_argument("scenes", nargs="*", type=Path, metavar="SCENE.xml", help="(all scenes/)")
    used.add_argument(
        "-o",
        "--output",
        type=file_name,
        metavar="PATH",
        help="the page, or a folder for it (build/report.html)",
    )
    used.set_defaults(output=str(BUILD / _NAME))
    used.add_argument("--variant", help="Mitsuba's variant (the fastest that works here)")
    options = used.parse_args(arguments)
    paths = sorted({*(options.scenes or own_scenes())})
    output = Path(options.output, _NAME if is_folder(options.output) else "")
    forbid_overwriting_inputs(used, (output,), (*paths, TEMPLATE, *CHARTS.values()))
    try:
        use(options.variant)
    except ImportError as error:
        print_line(sys.stderr, printable(f"Mitsuba cannot run: {error}"))
        return MISUSED
    # Scenes of one name are told apart by their paths.
    alike = len({path.stem for path in paths}) < len(paths)
    results, comments, unread = [], {}, []
    for path in tqdm(paths, unit="scene", disable=sys.stderr is None or None):
        name = printable(str(path) if alike else path.stem)
        try:
            results.append(replace(check(path, options.variant), name=name))
            comments[name] = _comment(path)
        except (*TROUBLE, OSError) as error:
            unread.append(describe_error(path, error))
            print_line(sys.stderr, unread[-1])
    # The project's charts belong to its own scenes.
    own = {*paths} <= {*own_scenes()}
    charts = [(title, path.read_bytes()) for title, path in CHARTS.items() if own and path.exists()]
    text = page(results, comments, charts, unread)
    try:
        output.parent.mkdir(parents=True, exist_ok=True)
        with atomic_file(output, _HTML) as file:
            file.write(text.encode())
    except OSError as error:
        reason = error.strerror or error
        print_line(sys.stderr, printable(f"{output}: cannot be written: {reason}"))
        return FAILED
    print_line(sys.stdout, printable(str(output)))
    return FAILED if unread else worst_status(results)
