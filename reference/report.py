"""All scenes, the tracer's pictures beside Mitsuba's: ``python -m reference.report``.

Writes one HTML page that holds everything it shows: it opens from a file, and
asks neither a server nor the network for anything.
"""

from __future__ import annotations

import argparse
import base64
import html
import io
import sys
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from tqdm import tqdm

from converters.to_mitsuba import TROUBLE, told
from converters.variant import use
from reference.check import MAX_DIFFERENCE, CheckResult, check
from reference.command import BUILD, HERE, need_scenes, own_scenes, run, spare_inputs
from reference.compare import amplified
from reference.tables import measured_on
from tracer.commands import atomic_file, file_name, is_folder, print_line, printable
from tracer.picture.png import to_codes

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
    comments: dict[str, str],
    charts: Iterable[tuple[str, bytes]] = (),
    unread: Sequence[str] = (),
) -> str:
    """The report as HTML.

    Parameters
    ----------
    results : sequence of CheckResult
        One for each scene.
    comments : dict
        What each scene shows, by its name.
    charts : iterable of (str, bytes)
        Title and SVG of each.
    unread : sequence of str
        What is wrong with each scene that could not be compared.
    """
    template = TEMPLATE.read_text(encoding="utf-8")
    parts = {
        "<!-- summary -->": _summary(results, unread),
        "<!-- table -->": _table(results),
        "<!-- scenes -->": "\n".join(
            _scene(r, number, comments.get(r.name, "")) for number, r in enumerate(results)
        ),
        "<!-- charts -->": "\n".join(_chart(title, svg) for title, svg in charts),
    }
    for marker, part in parts.items():
        template = template.replace(marker, part)
    return template


def _summary(results: Sequence[CheckResult], unread: Sequence[str]) -> str:
    agree = sum(not result.faults for result in results)
    variants = ", ".join(sorted({result.variant for result in results}))
    verdict = (
        '<strong class="good">All agree.</strong>'
        if agree == len(results) > 0 and not unread
        else f'<strong class="bad">{agree} agree.</strong>'
    )
    scenes = f"{len(results)} scene{'s' * (len(results) != 1)}"
    lines = [
        f"<p>{scenes}, sampled at the pixels' centres by both renderers and compared"
        " in linear light: away from edges they may differ by at most"
        f" {MAX_DIFFERENCE:g}. {verdict}</p>",
        *(f'<p class="bad">Not compared: {_lines(fault)}</p>' for fault in unread),
        f'<p class="soft">Mitsuba {html.escape(variants)}; {html.escape(measured_on())}</p>',
    ]
    return "\n".join(lines)


def _table(results: Sequence[CheckResult]) -> str:
    head = "".join(
        f'<th scope="col">{title}</th>'
        for title in (
            "scene",
            "verdict",
            "SSIM",
            "largest difference",
            "masked",
            "tracer\u2019s time",
            "Mitsuba\u2019s",
        )
    )
    rows = "\n".join(
        f'<tr><td><a href="#scene-{number}">{_name(r)}</a></td><td>{_verdict(r)}</td>'
        f"<td>{r.figures.ssim:.6f}</td><td>{r.figures.max:.1e}</td>"
        f"<td>{r.mask.mean():.2%}</td><td>{_time(r.tracer_seconds)}</td>"
        f"<td>{_time(r.mitsuba_seconds)}</td></tr>"
        for number, r in enumerate(results)
    )
    return (
        f'<div class="scroll"><table><thead><tr>{head}</tr></thead>\n'
        f"<tbody>\n{rows}\n</tbody></table></div>"
    )


def _scene(result: CheckResult, number: int, comment: str) -> str:
    """One row: the two pictures, their difference, the controls and the figures."""
    height, width = result.mask.shape
    name, f = _name(result), result.figures
    difference, gain = _difference(result)
    values = {
        "SSIM": f"{f.ssim:.6f}",
        "largest difference": f"{f.max:.2e}",
        "99.9th percentile": f"{f.p999:.2e}",
        "RMSE": f"{f.rmse:.2e}",
        "median": f"{f.median:.2e}",
        "pixels over 1e-3": f"{f.over}",
        "masked pixels": f"{f.masked}",
        "tracer\u2019s time": _time(result.tracer_seconds),
        f"Mitsuba\u2019s ({result.variant})": _time(result.mitsuba_seconds),
    }
    notes = [("bad", f"Out of tolerance: {fault}.") for fault in result.faults]
    if result.remark:
        notes.append(("soft", f"{result.remark[0].upper()}{result.remark[1:]}."))
    shown = f"difference × {gain:,.10g}" if gain else "no difference"
    return f"""
<section class="scene" id="scene-{number}" data-width="{width}" data-height="{height}">
<div class="head"><h2>{name}</h2><span>{_verdict(result)}</span>
<span class="soft">{width} × {height}</span></div>
<p class="soft">{html.escape(comment)}</p>
<div class="pictures">
<figure>
<div class="panel" tabindex="0" role="group" style="aspect-ratio: {width} / {height}"
 aria-label="{name}: tracer and Mitsuba" aria-keyshortcuts="+ - 0 F">
<div class="layer tracer">{_image(result.tracer, f"{result.name} by the tracer")}</div>
<div class="layer mitsuba">{_image(result.mitsuba, f"{result.name} by Mitsuba")}</div>
<div class="seam"></div>
</div>
<figcaption><span>tracer</span><span>Mitsuba</span></figcaption>
</figure>
<figure>
<div class="panel" tabindex="0" role="group" style="aspect-ratio: {width} / {height}"
 aria-label="{name}: {shown}" aria-keyshortcuts="+ - 0 F">
<div class="layer">{_picture(difference, f"{result.name}: {shown}")}</div>
</div>
<figcaption><span>{shown}</span></figcaption>
</figure>
</div>
<div class="controls">
<label>tracer <input type="range" min="0" max="100" value="50" aria-label="{name}: how much is the\
 tracer's"> Mitsuba</label>
<button type="button" class="flicker" aria-pressed="false">Flicker</button>
<span><button type="button" class="out" aria-label="Zoom out">−</button>
<button type="button" class="in" aria-label="Zoom in">+</button>
<button type="button" class="all">All</button> <span class="scale">1×</span></span>
<span class="readout" role="status"></span>
</div>
<dl>{"".join(f"<div><dt>{key}</dt><dd>{value}</dd></div>" for key, value in values.items())}</dl>
{"".join(f'<p class="{look}">{html.escape(note)}</p>' for look, note in notes)}
</section>"""


def _difference(result: CheckResult) -> tuple[NDArray[np.uint8], float]:
    """The difference as 8-bit codes, amplified; masked pixels in grey."""
    kept = np.where(result.mask[:, :, None], result.tracer, result.reference)
    image, gain = amplified(result.tracer, kept)
    image[result.mask] = _MASKED
    return np.round(255 * image).astype(np.uint8), gain


def _chart(title: str, svg: bytes) -> str:
    source = f"data:image/svg+xml;base64,{base64.b64encode(svg).decode()}"
    title = html.escape(title)
    return f'<section class="chart"><h2>{title}</h2><img src="{source}" alt="{title}"></section>'


def _name(result: CheckResult) -> str:
    return html.escape(result.name, quote=True)


def _verdict(result: CheckResult) -> str:
    return (
        '<span class="bad">✗ differs</span>'
        if result.faults
        else '<span class="good">✓ agrees</span>'
    )


def _time(seconds: float) -> str:
    return f"{1000 * seconds:.3g} ms" if seconds < 1 else f"{seconds:.2f} s"


def _image(light: NDArray[np.float64], alt: str) -> str:
    return _picture(to_codes(light), alt)


def _picture(codes: NDArray[np.uint8], alt: str) -> str:
    data = io.BytesIO()
    Image.fromarray(np.ascontiguousarray(codes)).save(data, format="PNG", optimize=True)
    source = f"data:image/png;base64,{base64.b64encode(data.getvalue()).decode()}"
    return f'<img src="{source}" alt="{html.escape(alt, quote=True)}" draggable="false">'


def _lines(text: str) -> str:
    return html.escape(text).replace("\n", "<br>")


def _comment(path: Path) -> str:
    """The comment at the head of a scene file, before the first part of the scene, on one line."""
    with path.open("rb") as file:
        for number, (event, element) in enumerate(ET.iterparse(file, ("comment", "start"))):
            if event == "comment":
                return " ".join((element.text or "").split())
            if number:
                break
    return ""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns 1 where a scene cannot be read or a tolerance is broken."""
    parser = argparse.ArgumentParser(
        prog="python -m reference.report",
        description="Render scenes with the tracer and with Mitsuba, and write one HTML page that"
        " shows both, the difference, the figures and the times.",
        epilog="Exit status: 0 if all agree, 1 if not, 2 for wrong usage.",
    )
    parser.add_argument("scenes", nargs="*", type=Path, metavar="SCENE.xml", help="(all scenes/)")
    parser.add_argument(
        "-o",
        "--output",
        type=file_name,
        metavar="PATH",
        default=str(BUILD / _NAME),
        help="the page to write, or a folder for it (%(default)s)",
    )
    parser.add_argument("--variant", help="Mitsuba's variant (the fastest that works here)")
    options = parser.parse_args(arguments)
    if not options.scenes:
        need_scenes(parser)
    paths = sorted({*(options.scenes or own_scenes())})
    output = Path(options.output, _NAME if is_folder(options.output) else "")
    spare_inputs(parser, (output,), (*paths, TEMPLATE, *CHARTS.values()))
    try:
        use(options.variant)
    except ImportError as error:
        print_line(sys.stderr, printable(f"Mitsuba cannot run: {error}"))
        return 1
    # Scenes of one name are told apart by their paths.
    alike = len({path.stem for path in paths}) < len(paths)
    results, comments, unread = [], {}, []
    # None: no bar where there is no terminal.
    for path in tqdm(paths, unit="scene", disable=sys.stderr is None or None):
        try:
            name = printable(str(path) if alike else path.stem)
            result = replace(check(path, options.variant), name=name)
            comments[name] = _comment(path)
            results.append(result)
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


if __name__ == "__main__":
    run(main)
