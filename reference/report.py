"""Render scenes with the tracer and with Mitsuba, and write one HTML page that shows both.

    python -m reference.report [SCENE.xml ...]

The page holds everything it shows, the difference, the figures and the times among it: it opens
from a file, and asks neither a server nor the network for anything.  Exit status: 0 if all agree,
1 if not, 2 for wrong usage.
"""

from __future__ import annotations

from tracer.command.process import run

if __name__ == "__main__":
    run(__spec__.name)

import base64
import io
import itertools
import sys
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from jinja2 import Environment
from numpy.typing import NDArray
from PIL import Image
from tqdm import tqdm

from converters.to_mitsuba import TROUBLE, told
from converters.variant import use
from reference.check import MAX_DIFFERENCE, CheckResult, check
from reference.command import BUILD, HERE, need_scenes, own_scenes, parser, spare_inputs
from reference.figures import amplified
from reference.measurements import measured_on
from tracer import to_codes
from tracer.command.arguments import file_name, is_folder
from tracer.command.process import print_line
from tracer.files import atomic_file
from tracer.messages import printable

__all__ = ["main", "page"]

# What a report is called in a folder, and how each begins, as the template does.
_NAME, _HTML = "report.html", b"<!doctype html>"
TEMPLATE = HERE / "report-template.html"
CHARTS = {
    "Accuracy against time": HERE / "speed_accuracy.svg",
    "Where methods fail": HERE / "stability.svg",
}
_MASKED = 0.3


def page(
    results: Sequence[CheckResult],
    comments: Mapping[str, str],
    charts: Iterable[tuple[str, bytes]] = (),
    unread: Sequence[str] = (),
) -> str:
    """The report as HTML, with a comment on each result by its name.

    `charts` are titles and SVGs; `unread` says what is wrong with scenes that were not compared.
    """
    environment = Environment(autoescape=True, trim_blocks=True)
    environment.filters |= {"codes": to_codes, "data": _data, "difference": _difference}
    environment.filters |= {"png": _png, "time": _time}
    template = environment.from_string(TEMPLATE.read_text(encoding="utf-8"))
    found = {"results": results, "comments": comments, "charts": charts, "unread": unread}
    return template.render(found, tolerance=f"{MAX_DIFFERENCE:g}", machine=measured_on())


def _difference(result: CheckResult) -> tuple[NDArray[np.uint8], str]:
    """The difference as 8-bit codes, masked pixels in grey; and how it is amplified."""
    kept = np.where(result.mask[:, :, None], result.tracer, result.reference)
    image, gain = amplified(result.tracer, kept)
    image[result.mask] = _MASKED
    shown = f"difference × {gain:,.10g}" if gain else "no difference"
    return np.round(255 * image).astype(np.uint8), shown


def _time(seconds: float) -> str:
    return f"{1000 * seconds:.3g} ms" if seconds < 1 else f"{seconds:.2f} s"


def _png(codes: NDArray[np.uint8]) -> str:
    data = io.BytesIO()
    Image.fromarray(np.ascontiguousarray(codes)).save(data, format="PNG", optimize=True)
    return _data(data.getvalue(), "png")


def _data(content: bytes, kind: str) -> str:
    """A picture as an address that holds it."""
    return f"data:image/{kind};base64,{base64.b64encode(content).decode()}"


def _comment(path: Path) -> str:
    """The comment at the head of a scene file, before the first part of the scene, on one line."""
    with path.open("rb") as file:
        first = itertools.islice(ET.iterparse(file, ("comment", "start")), 2)
        texts = [element.text or "" for event, element in first if event == "comment"]
    return " ".join("".join(texts[:1]).split())


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns 1 where a scene cannot be read or a tolerance is broken."""
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
    if not options.scenes:
        need_scenes(used)
    paths = sorted({*(options.scenes or own_scenes())})
    output = Path(options.output, _NAME if is_folder(options.output) else "")
    spare_inputs(used, (output,), (*paths, TEMPLATE, *CHARTS.values()))
    try:
        use(options.variant)
    except ImportError as error:
        print_line(sys.stderr, printable(f"Mitsuba cannot run: {error}"))
        return 1
    # Scenes of one name are told apart by their paths.
    alike = len({path.stem for path in paths}) < len(paths)
    results, comments, unread = [], {}, []
    for path in tqdm(paths, unit="scene", disable=sys.stderr is None or None):
        name = printable(str(path) if alike else path.stem)
        try:
            results.append(replace(check(path, options.variant), name=name))
            comments[name] = _comment(path)
        except (*TROUBLE, OSError) as error:
            unread.append(told(path, error))
            print_line(sys.stderr, unread[-1])
    charts = [(title, path.read_bytes()) for title, path in CHARTS.items() if path.exists()]
    text = page(results, comments, charts, unread)
    try:
        output.parent.mkdir(parents=True, exist_ok=True)
        with atomic_file(output, _HTML) as file:
            file.write(text.encode())
    except OSError as error:
        reason = error.strerror or error
        print_line(sys.stderr, printable(f"{output}: cannot be written: {reason}"))
        return 1
    print_line(sys.stdout, printable(str(output)))
    return int(bool(unread) or any(result.faults for result in results))
