"""Render a scene with a proof: every pixel's mean radiance is within a given error.

    python -m reference.certify SCENE.xml --error 1/512 --judge PICTURE.png

writes an antialiased picture, and states how close it is to the exact one: in linear radiance, and
by the number of pixels in which no other 8-bit codes are possible.  For the method see
`reference.judges.certificate`.

Exit status: 0, or 1 if a judged picture has codes that are certainly wrong, 2 for wrong usage, 3 if
a file cannot be read, certified or written.
"""

from __future__ import annotations

from tracer.command.process import run

if __name__ == "__main__":
    run(__spec__.name)

import argparse
import sys
from collections.abc import Sequence
from contextlib import suppress
from fractions import Fraction
from functools import partial
from pathlib import Path
from time import perf_counter

import numpy as np

from reference.command import forbid_overwriting_inputs, make_parser
from reference.judges.certificate import Certificate, certify
from reference.pictures import UNREADABLE, Codes, read_picture
from tracer import Scene, load_scene, to_codes, write_png
from tracer.command.arguments import file_name
from tracer.command.failure import Failure, errors_as_failure
from tracer.command.process import print_result
from tracer.command.progress import Progress
from tracer.messages import printable

# Permitted errors of a pixel's mean radiance, if --error is not given: without and with --codes.
# With --codes, only pixels stay uncertain whose radiance is this close to where the code changes.
_DEFAULT_ERROR, _DEFAULT_ERROR_OF_CODES = Fraction(1, 128), Fraction(1, 65536)

# Exit status if a file cannot be read, certified or written.
_FAILED_STATUS = 3


def main(argv: Sequence[str] | None = None) -> int:
    """Certify a scene's picture as the command line says, and return the exit status.

    Raises
    ------
    Failure
        If a file cannot be read, certified or written.
    """
    command_parser = _parser()
    arguments = command_parser.parse_args(argv)
    path, output = arguments.scene, arguments.output or f"{arguments.scene}.certified.png"
    inputs = [Path(file) for file in (path, arguments.judge) if file]
    forbid_overwriting_inputs(command_parser, [Path(output)], inputs)
    error = arguments.error or (_DEFAULT_ERROR_OF_CODES if arguments.codes else _DEFAULT_ERROR)
    failing = partial(errors_as_failure, status=_FAILED_STATUS)
    with failing(path, "read", memory_remedy="split the scene"):
        scene = load_scene(path)
    judged = _read_codes(arguments.judge, scene) if arguments.judge else None
    start = perf_counter()
    with (
        failing(path, "certified", errors=(ValueError, RuntimeError)),
        Progress(1, "pictures") as bar,
    ):
        certificate = certify(scene, float(error), codes=arguments.codes, progress=bar.update)
    lines, wrong_count = _summary(certificate, error, arguments.codes), 0
    seconds = perf_counter() - start
    if judged is not None:
        wrong_count, verdict = judgement(certificate, judged)
        lines.append(f"{arguments.judge}: {verdict}")
    lines.append(f"{output}: {certificate.cell_count} cells in {seconds:.2f} s")
    with failing(output, "written", "choose another with -o"):
        write_png(output, certificate.image)
    with failing("standard output", "written"):
        print_result(sys.stdout, "\n".join(map(printable, lines)))
    return 1 if wrong_count else 0


def _parser() -> argparse.ArgumentParser:
    """Make the parser of the command line."""
    command_parser = make_parser("reference.certify")
    add = command_parser.add_argument
    add("scene", type=file_name, metavar="SCENE.xml", help="the scene file")
    default = f"{_DEFAULT_ERROR}; {_DEFAULT_ERROR_OF_CODES} with --codes"
    text = f"permitted error of a pixel's mean radiance ({default})"
    add("--error", type=_error, metavar="E", help=text)
    text = "also accept a pixel as soon as only one 8-bit code per channel is possible"
    add("--codes", action="store_true", help=text)
    text = "the picture to write (SCENE.xml.certified.png)"
    add("-o", "--output", type=file_name, metavar="OUT.png", help=text)
    text = "a picture of the scene, whose certainly wrong 8-bit codes are counted"
    add("--judge", type=file_name, metavar="PICTURE.png", help=text)
    return command_parser


def _error(text: str) -> Fraction:
    """Parse an argument that is a positive number or fraction."""
    with suppress(OverflowError, ValueError, ZeroDivisionError):
        if float(error := Fraction(text)) > 0:
            return error
    raise argparse.ArgumentTypeError(f"must be a number or fraction above 0, is {text!r}")


def _read_codes(path: str, scene: Scene) -> Codes:
    """Read the 8-bit codes (height, width, 3) of a picture of a scene.

    Raises
    ------
    Failure
        If the picture cannot be read, or its size differs from that of the scene's picture.
    """
    with errors_as_failure(path, "read", status=_FAILED_STATUS, errors=UNREADABLE):
        codes = read_picture(Path(path)).codes
    height, width, _ = codes.shape
    if (width, height) != (scene.width, scene.height):
        sizes = f"its size is {width} x {height}, the scene's {scene.width} x {scene.height}"
        raise Failure(
            path, f"cannot be judged: {sizes}", "choose a picture of that size", _FAILED_STATUS
        )
    return codes


def _summary(certificate: Certificate, error: Fraction, codes: bool) -> list[str]:
    """State what is certain about a picture, in two or three lines.

    Parameters
    ----------
    certificate : Certificate
        The picture, with its bounds.
    error : Fraction
        The permitted error.
    codes : bool
        Whether pixels with certain codes may exceed the permitted error.
    """
    is_wide, is_certain = certificate.error > float(error), certificate.is_certain
    pixels = f"of {is_wide.size} pixels"
    lines = [
        f"{np.count_nonzero(~is_wide)} {pixels} are within {error};"
        f" all within {certificate.error.max():.2g}",
        f"{np.count_nonzero(is_certain)} {pixels} have certain codes, {is_certain.mean():.2%}",
    ]
    if exceeding := np.count_nonzero(is_wide & ~(is_certain & codes)):
        lines.append(f"{exceeding} pixels exceed the permitted error: edges touch each other there")
    return lines


def judgement(certificate: Certificate, codes: Codes) -> tuple[int, str]:
    """Count the codes of a picture that are certainly wrong.

    Parameters
    ----------
    certificate : Certificate
        Bounds on each pixel of the scene.
    codes : (height, width, 3) uint8 array
        8-bit codes of a picture of the scene.

    Returns
    -------
    count : int
        Number of codes outside the bounds.
    verdict : str
        The same in words, with the worst of them.
    """
    low, high = (to_codes(bound).astype(int) for bound in (certificate.low, certificate.high))
    excess = np.maximum(np.maximum(low - codes, codes - high), 0)
    count = int(np.count_nonzero(excess))
    if not count:
        return 0, "no code is certainly wrong"
    row, column, channel = worst = np.unravel_index(excess.argmax(), excess.shape)
    ends = sorted({low[worst], high[worst]})
    position = f"at {column},{row}, where {'RGB'[channel]} is {codes[worst]}"
    wanted = f"must be {' to '.join(map(str, ends))}"
    verdict = f"{count} of {codes.size} codes are certainly wrong, by up to {excess.max()}"
    return count, f"{verdict}, {position} and {wanted}"
