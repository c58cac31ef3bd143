"""Render a scene with a proof: every pixel's mean radiance lies within a given error.

    python -m reference.certify SCENE.xml --error 1/512 --judge PICTURE.png

writes the antialiased picture, and says how near it is to the true one: in linear radiance, and in
how many pixels the 8-bit codes are the only ones possible.  See `reference.judges.certificate`.
Exit status: 0; 1 if a judged picture has codes that are certainly wrong; 2 for wrong usage; 3 if
something cannot be read, certified or written.
"""

from __future__ import annotations

from tracer.command.process import run

if __name__ == "__main__":
    run(__spec__.name)

import argparse
import io
import sys
from collections.abc import Sequence
from contextlib import suppress
from fractions import Fraction
from pathlib import Path
from time import perf_counter

import numpy as np
from tqdm import tqdm

from reference.command import parser, forbid_overwriting_inputs
from reference.judges.certificate import Certificate, certify
from reference.pictures import UNREADABLE, read_picture, reason
from tracer import SceneFileError, load_scene, to_codes, write_png
from tracer.command.arguments import file_name
from tracer.command.process import print_line, print_result
from tracer.files import atomic_file
from tracer.messages import printable

# With `--codes`, pixels whose codes stay open lie within this of where the next code begins.
_ERROR, _ERROR_OF_CODES = Fraction(1, 128), Fraction(1, 65536)


def _error(text: str) -> Fraction:
    """Type of an argument that is a positive number or fraction."""
    with suppress(OverflowError, ValueError, ZeroDivisionError):
        if float(error := Fraction(text)) > 0:
            return error
    raise argparse.ArgumentTypeError(f"must be a number or fraction above 0, is {text!r}")


def _report(certificate: Certificate, error: Fraction, codes: bool) -> list[str]:
    """What is known of a picture, in lines."""
    off, certain = certificate.error, certificate.is_certain
    wide, of = off > float(error), f"of {off.size} pixels"
    lines = [
        f"{np.count_nonzero(~wide)} {of} are within {error}; all within {off.max():.2g}",
        f"{np.count_nonzero(certain)} {of} have certain codes, {certain.mean():.2%}",
    ]
    if left := np.count_nonzero(wide & ~(certain & codes)):
        lines.append(f"{left} pixels stayed wider than asked: edges graze each other there")
    return lines


def judgement(certificate: Certificate, codes: np.ndarray) -> tuple[int, str]:
    """How many codes (height, width, 3) of a picture are certainly wrong; and that in words."""
    low, high = (to_codes(m).astype(int) for m in (certificate.low, certificate.high))
    wrong = np.maximum(np.maximum(low - codes, codes - high), 0)
    count = int(np.count_nonzero(wrong))
    if not count:
        return 0, "no code is certainly wrong"
    row, column, channel = np.unravel_index(wrong.argmax(), wrong.shape)
    where = f"at {column},{row}, where {'RGB'[channel]} is {codes[row, column, channel]}"
    ends = sorted({low[row, column, channel], high[row, column, channel]})
    most = f"by up to {wrong.max()}, {where} and must be {' to '.join(map(str, ends))}"
    return count, f"{count} of {codes.size} codes are certainly wrong, {most}"


def bounds_chart(certificate: Certificate) -> bytes:
    """A PNG file that shows how wide each pixel's bounds are."""
    from reference.measured.charts import plt  # takes long to import

    rows, columns = certificate.error.shape
    size = 8.5, max(7 * rows / columns, 2) + 0.8
    figure, axes = plt.subplots(figsize=size, layout="constrained")
    axes.set_title("Mean radiance differs from the picture by no more than")
    axes.grid(False)
    shown = axes.imshow(np.maximum(certificate.error, 2.0**-24), cmap="viridis", norm="log")
    figure.colorbar(shown, ax=axes, shrink=0.8)
    figure.savefig(made := io.BytesIO(), format="png", dpi=120)
    plt.close(figure)
    return made.getvalue()


def main(argv: Sequence[str] | None = None) -> int:
    """Certify a scene's picture; return the exit status."""
    used = parser("reference.certify", __doc__)
    add = used.add_argument
    add("scene", type=file_name, metavar="SCENE.xml")
    text = f"how near each pixel's mean is to be ({_ERROR}, or {_ERROR_OF_CODES} with --codes)"
    add("--error", type=_error, metavar="E", help=text)
    text = "be content with a pixel as soon as its 8-bit code is the only one possible"
    add("--codes", action="store_true", help=text)
    text = "the picture to write (SCENE.xml.certified.png)"
    add("-o", "--output", type=file_name, metavar="OUT.png", help=text)
    text = "count this picture's codes that are certainly wrong"
    add("--judge", type=Path, metavar="PICTURE.png", help=text)
    add("--bounds", type=file_name, metavar="OUT.png", help="draw how wide the bounds are")
    given = used.parse_args(argv)
    output = given.output or f"{given.scene}.certified.png"
    targets = [Path(path) for path in (output, given.bounds) if path]
    forbid_overwriting_inputs(used, targets, [Path(given.scene), *filter(None, [given.judge])])
    if len(targets) == 2 and targets[0] == targets[1]:
        used.error("-o and --bounds: one file cannot be both")
    error, wrong = given.error or (_ERROR_OF_CODES if given.codes else _ERROR), 0
    where, what, start = given.scene, "read", perf_counter()
    try:
        scene = load_scene(given.scene)
        if given.judge:
            where = str(given.judge)
            judged, (width, height) = read_picture(given.judge).codes, (scene.width, scene.height)
            if judged.shape != (height, width, 3):
                size = f"{judged.shape[1]} x {judged.shape[0]}"
                raise ValueError(f"its size is {size}, the scene's {width} x {height}")
        where, what = given.scene, "certified"
        hidden = None if sys.stderr is None else not sys.stderr.isatty()
        with tqdm(total=100, unit="%", leave=False, disable=hidden) as bar:
            made = certify(
                scene, float(error), codes=given.codes, progress=lambda part: bar.update(100 * part)
            )
        lines, seconds = _report(made, error, given.codes), perf_counter() - start
        if given.judge:
            wrong, verdict = judgement(made, judged)
            lines.append(f"{given.judge}: {verdict}")
        where, what = output, "written"
        write_png(output, made.image)
        if given.bounds:
            where = given.bounds
            with atomic_file(given.bounds, b"\x89PNG\r\n\x1a\n") as file:
                file.write(bounds_chart(made))
        where, what = "standard output", "written"
        for line in [*lines, f"{output}: {made.cells} cells in {seconds:.2f} s"]:
            print_result(sys.stdout, printable(line))
    except SceneFileError as failure:
        print_line(sys.stderr, str(failure))
        return 3
    except (*UNREADABLE, RuntimeError) as failure:
        why = reason(failure, "make the image smaller")
        print_line(sys.stderr, printable(f"{where}: cannot be {what}: {why}"))
        return 3
    return 1 if wrong else 0
