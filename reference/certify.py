"""Render a scene with a proof: every pixel's mean radiance is within a given error.

    python -m reference.certify SCENE.xml --error 1/512 --judge PICTURE.png

writes an antialiased picture, and states how close it is to the exact one: the largest error of the
linear radiance, and the number of pixels for which no other 8-bit codes are possible.  For the
method see `reference.judges.certificate`.

Exit status: 0, or 1 if a judged picture has codes that are certainly wrong, 2 for wrong usage, 3 if
a file cannot be read, certified or written.
"""

from __future__ import annotations

from tracer.command.process import run

if __name__ == "__main__":
    run(__spec__.name)  # before the other imports: see tracer/command/process.py

import argparse
import sys
from collections.abc import Sequence
from contextlib import suppress
from fractions import Fraction
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import Annotated as Shaped
from typing import NamedTuple

import numpy as np

from reference.command import FAILED_STATUS, forbid_overwriting_inputs, make_parser
from reference.judges.certificate import Certificate, certify
from reference.pictures import Codes, read_picture
from tracer import Scene, load_scene, to_codes, write_png
from tracer.command.arguments import CommandParser, check_path
from tracer.command.failure import Failure, errors_as_failure
from tracer.command.process import print_or_raise
from tracer.command.progress import Progress
from tracer.messages import make_printable

# Largest permitted error in a pixel's mean radiance, if --error is not given.
_DEFAULT_ERROR = Fraction(1, 128)


def main(argv: Sequence[str] | None = None) -> int:
    """Render a scene with proven error bounds, write the picture, and print what is proven.

    Parameters
    ----------
    argv : sequence of str, optional
        The command-line arguments; by default, the arguments of this process.

    Returns
    -------
    exit_status : int
        1 if the picture given with `--judge` has 8-bit codes that are certainly wrong, otherwise 0.

    Raises
    ------
    Failure
        If a file cannot be read or written, or the scene cannot be certified.
    SystemExit
        If the arguments are wrong.
    """
    command_parser = _make_command_parser()
    arguments = command_parser.parse_args(argv)
    scene_path: str = arguments.scene
    output_path = arguments.output or f"{scene_path}.certified.png"
    input_paths = [Path(file) for file in (scene_path, arguments.judge) if file]
    forbid_overwriting_inputs(command_parser, [Path(output_path)], input_paths)
    convert_errors = partial(errors_as_failure, exit_status=FAILED_STATUS)
    with convert_errors(scene_path, "read", memory_remedy="split the scene"):
        scene = load_scene(scene_path)
    judged_codes = _read_codes(arguments.judge, scene) if arguments.judge else None
    start_time = perf_counter()
    with (
        convert_errors(scene_path, "certified", error_types=(ValueError, RuntimeError)),
        Progress(1, "pictures") as progress,
    ):
        certificate = certify(scene, float(arguments.error), progress.update)
    seconds = perf_counter() - start_time
    lines = _summarize_certificate(certificate, arguments.error)
    wrong_code_count = 0
    if judged_codes is not None:
        wrong_code_count, verdict = count_wrong_codes(certificate, judged_codes)
        lines.append(f"{arguments.judge}: {verdict}")
    lines.append(f"{output_path}: {certificate.cell_count} cells in {seconds:.2f} s")
    with convert_errors(output_path, "written", "choose another with -o"):
        write_png(output_path, certificate.image)
    with convert_errors("standard output", "written"):
        print_or_raise(sys.stdout, "\n".join(map(make_printable, lines)))
    return 1 if wrong_code_count else 0


def _make_command_parser() -> CommandParser:
    command_parser = make_parser("reference.certify")
    add_argument = command_parser.add_argument
    add_argument("scene", type=check_path, metavar="SCENE.xml", help="the scene file")
    add_argument(
        "--error",
        type=_parse_positive_fraction,
        default=_DEFAULT_ERROR,
        metavar="E",
        help=f"permitted error of a pixel's mean radiance ({_DEFAULT_ERROR})",
    )
    help_text = "the picture to write (SCENE.xml.certified.png)"
    add_argument("-o", "--output", type=check_path, metavar="OUT.png", help=help_text)
    help_text = "count the 8-bit codes that are certainly wrong in this picture of the scene"
    add_argument("--judge", type=check_path, metavar="PICTURE.png", help=help_text)
    return command_parser


def _parse_positive_fraction(argument: str) -> Fraction:
    """Parse a command-line argument as a positive number or fraction, such as 1/128.

    Raise ArgumentTypeError if it is not one.
    """
    with suppress(OverflowError, ValueError, ZeroDivisionError):
        if float(fraction := Fraction(argument)) > 0:
            return fraction
    raise argparse.ArgumentTypeError(f"must be a positive number or fraction, not {argument!r}")


def _read_codes(path: str, scene: Scene) -> Shaped[Codes, "height width 3"]:
    """Read the 8-bit codes of a picture of a scene.

    Raise Failure if the file cannot be read, or if the picture's size is not the scene's.
    """
    codes = read_picture(Path(path)).codes
    height, width, _ = codes.shape
    if (width, height) != (scene.width, scene.height):
        mismatch = f"its size is {width} x {height}, the scene's {scene.width} x {scene.height}"
        remedy = "choose a picture of that size"
        raise Failure(path, f"cannot be judged: {mismatch}", remedy, FAILED_STATUS)
    return codes


def _summarize_certificate(certificate: Certificate, permitted_error: Fraction) -> list[str]:
    """Summarise what a certificate proves about a picture, in two or three lines."""
    pixel_count = certificate.error.size
    imprecise_pixel_count = np.count_nonzero(certificate.error > float(permitted_error))
    certain_pixel_count = np.count_nonzero(certificate.is_certain)
    lines = [
        f"{pixel_count - imprecise_pixel_count} of {pixel_count} pixels are within"
        f" {permitted_error}; all are within {certificate.error.max():.2g}",
        f"8-bit codes are certain in {certain_pixel_count} of {pixel_count} pixels,"
        f" {certain_pixel_count / pixel_count:.2%}",
    ]
    if imprecise_pixel_count:
        reason = "because edges touch there"
        lines.append(f"{imprecise_pixel_count} pixels have larger error bounds, {reason}")
    return lines


class Judgement(NamedTuple):
    """What a certificate proves about the codes of another picture."""

    wrong_count: int
    verdict: str  # states the number, and describes the code that is farthest out of bounds


def count_wrong_codes(
    certificate: Certificate, codes: Shaped[Codes, "height width 3"]
) -> Judgement:
    """Count the 8-bit codes of a picture that no radiance within the certified bounds has.

    The picture must have the size of the certified one.
    """
    lowest_codes = to_codes(certificate.low).astype(int)
    highest_codes = to_codes(certificate.high).astype(int)
    # By how many levels a code is below the lowest or above the highest that is possible.
    deviation = np.maximum(np.maximum(lowest_codes - codes, codes - highest_codes), 0)
    wrong_count = int(np.count_nonzero(deviation))
    if not wrong_count:
        return Judgement(wrong_count=0, verdict="no code is certainly wrong")
    worst_index = np.unravel_index(deviation.argmax(), deviation.shape)
    row, column, channel = worst_index
    position = f"at {column},{row}, where {'RGB'[channel]} is {codes[worst_index]}"
    # One number if both limits are equal.
    code_limits = sorted({lowest_codes[worst_index], highest_codes[worst_index]})
    requirement = f"must be {' to '.join(map(str, code_limits))}"
    verdict = f"{wrong_count} of {codes.size} codes are certainly wrong, by up to {deviation.max()}"
    return Judgement(wrong_count=wrong_count, verdict=f"{verdict}, {position} and {requirement}")
