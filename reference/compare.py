"""Compare pictures with the right ones, and say what is wrong with them.

    python -m reference.compare HAND-IN.png SCENE.xml
    python -m reference.compare HAND-INS/ SCENES/

RIGHT is a scene file, which is rendered, a picture, or a folder of these.  The mistake is reported
with which the scene renders as the very hand-in; if there is none, the nearest, and where the
pictures differ.  With a picture in place of a scene, only some mistakes of the camera and of the
encoding are known.  All pictures in a folder and its subfolders are compared with the scenes of
their names: NAME.png, NAME.xml.png, ID_NAME.png and NAME-ID.png with NAME.xml.
Exit status: 0 if all agree, or are within the tolerances; 1 if some do not, or are missing; 2 for
wrong usage; 3 if some cannot be compared.
"""

from __future__ import annotations

from tracer.command.process import run

if __name__ == "__main__":
    run(__spec__.name)

import argparse
import os
import shlex
import sys
from collections.abc import Sequence
from functools import lru_cache, partial
from pathlib import Path

import numpy as np

from reference.command import forbid_overwriting_inputs, make_parser
from reference.figures import SSIM_WINDOW, decode_to_linear, measure_differences, write_comparison
from reference.handins.class_page import class_page, pair_of
from reference.handins.diagnosis import AGREEING, Solution, worst_pixel
from reference.handins.folders import HandIn, hand_ins, match
from reference.handins.results import Result, csv_of, json_of, text_of, with_common_causes_first
from reference.handins.workers import start_workers
from reference.page import Pair
from reference.pictures import UNREADABLE, Codes, Picture, read_picture
from tracer import load_scene
from tracer.command.arguments import file_name, is_folder
from tracer.command.failure import Failure, errors_as_failure
from tracer.command.process import print_line, print_result
from tracer.command.progress import track
from tracer.files import atomic_file
from tracer.messages import printable

_FAILED = 3
# Number of pixels in a band of rows: figures are computed band by band.
_PIXELS_PER_BAND = 500_000


def tolerance(text: str) -> float:
    """Convert the argument of an option; argparse uses this function's name in its message."""
    if not (value := float(text)) >= 0:
        raise argparse.ArgumentTypeError(f"must be 0 or more, is {text}")
    return value


def _parse(arguments: Sequence[str] | None) -> tuple[argparse.Namespace, list[HandIn]]:
    """Parse the command line.

    Returns
    -------
    options : Namespace
        The options, with `many`: whether the hand-ins are a folder's; and the `folder`.
    matched : list of HandIn
        The hand-ins, and the missing ones.
    """
    command_parser = make_parser("reference.compare")
    add, error = command_parser.add_argument, command_parser.error
    add("a", metavar="HAND-IN", type=Path, help="the picture in question, or a folder")
    add("b", metavar="RIGHT", type=Path, help="a scene file, a picture, or a folder of these")
    add("--ssim", type=tolerance, metavar="S", help="minimum SSIM that is tolerated")
    add("--max", type=tolerance, metavar="M", help="maximum linear difference that is tolerated")
    where = "write a comparison picture: a file, or a folder, which may end in /"
    add("-o", "--output", type=file_name, metavar="PATH", help=where)
    add("--html", type=file_name, metavar="OUT.html", help="write one page that shows all of them")
    form = command_parser.add_mutually_exclusive_group()
    form.add_argument("--json", action="store_true", help="print a list with an object per picture")
    form.add_argument("--csv", action="store_true", help="print the same as a table")
    options = command_parser.parse_args(arguments)
    for path in (options.a, options.b):
        if not path.exists():
            raise Failure(str(path), "does not exist", status=_FAILED)
    options.many = options.a.is_dir()
    options.folder = options.a if options.many else options.a.parent
    pictures = hand_ins(options.a) if options.many else [options.a]
    if options.a.suffix.lower() == ".xml" or (not pictures and [*options.a.glob("*.xml")]):
        error(printable(f"{options.a}: a hand-in is a picture; give it first, then the scene"))
    if not pictures:
        error(printable(f"{options.a}: contains no pictures"))
    if options.many and options.output and not is_folder(options.output):
        wrong = f"-o {options.output}: several pictures need a folder; end it in {os.sep}"
        error(printable(wrong))
    matched = [one._replace(output=_output(options, one.picture) if options.output else None)
               for one in match(pictures, options.folder, options.b)]  # fmt: skip
    outputs = [one.output for one in matched] + [options.html and Path(options.html)]
    rights = (one.right for one in matched if one.right)
    forbid_overwriting_inputs(command_parser, filter(None, outputs), (*pictures, *rights))
    return options, matched


def _output(options: argparse.Namespace, picture: Path | None) -> Path | None:
    """Return where the comparison of a picture is written; each has another place."""
    if picture is None or (not options.many and not is_folder(options.output)):
        return picture and Path(options.output)
    path = picture.relative_to(options.folder)
    return Path(options.output, path.with_name(f"{path.name}.compare.png"))


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line, and return the exit status."""
    options, matched = _parse(arguments)
    # Hand-ins of one scene follow one another: what is computed for the scene serves all of them.
    jobs = sorted(matched, key=lambda one: str(one.right))
    judged = start_workers(partial(judge, options), jobs, lost)
    judged_pairs = sorted(track(judged, len(jobs), "pictures"), key=_sort_key)
    results = with_common_causes_first([result for result, _ in judged_pairs])
    if options.html:
        pairs = {str(result.picture): pair for result, pair in judged_pairs if pair}
        text = class_page(results, pairs, options.folder)
        page = Path(options.html)
        with errors_as_failure(page, "written", "choose another with --html", status=_FAILED):
            page.parent.mkdir(parents=True, exist_ok=True)
            with atomic_file(page, b"<!doctype html>") as file:
                file.write(text.encode(errors="backslashreplace"))
    unread = any(result.word == "unread" for result in results)
    if options.json or options.csv:
        text = (json_of if options.json else csv_of)(results)
    else:
        text = text_of(results, many=options.many)
    if unread and not (options.many or options.json or options.csv):
        print_line(sys.stderr, text)
    else:
        with errors_as_failure("standard output", "written", status=_FAILED):
            print_result(sys.stdout, text)
    return _FAILED if unread else int(not all(result.agrees for result in results))


def _sort_key(one: tuple[Result, Pair | None]) -> tuple[bool, str, str]:
    """Return the key by which results are sorted: pictures by name, then what is missing."""
    result = one[0]
    return not result.picture, result.picture or result.student or "~", result.scene


@lru_cache(maxsize=1)
def _solution(path: Path) -> tuple[Solution, str]:
    """Return the right picture of a file, and a note on what its format changes."""
    with errors_as_failure(path, "read", status=_FAILED, error_types=UNREADABLE):
        if path.suffix.lower() == ".xml":
            return Solution(load_scene(path), shlex.quote(str(path))), ""
        picture = read_picture(path)
        return Solution(picture), picture.note


def lost(hand_in: HandIn) -> tuple[Result, None]:
    """Return the result of a picture whose worker died."""
    return _failed(hand_in, "cannot be compared: its process was ended; is there enough memory?")


def _failed(hand_in: HandIn, what: str) -> tuple[Result, None]:
    where = hand_in.picture or hand_in.right
    if hand_in.picture is None and hand_in.student:
        where = Path(hand_in.student, hand_in.scene)
    return _result(hand_in)._replace(error=str(Failure(str(where), what))), None


def _result(hand_in: HandIn) -> Result:
    picture, right = (str(path) if path else None for path in (hand_in.picture, hand_in.right))
    return Result(hand_in.student, hand_in.scene, picture, right)


def judge(options: argparse.Namespace, hand_in: HandIn) -> tuple[Result, Pair | None]:
    """Compare a picture with the right one.

    Returns
    -------
    result : Result
        If the picture cannot be compared, the result states why.
    pair : Pair or None
        Both pictures, if a page is requested and the sizes are the same.
    """
    if hand_in.error or not (hand_in.picture and hand_in.right):
        return _failed(hand_in, hand_in.error)
    try:
        with errors_as_failure(hand_in.picture, "read", status=_FAILED, error_types=UNREADABLE):
            picture = read_picture(hand_in.picture)
        solution, note = _solution(hand_in.right)
        remedy = "compare a part"
        with errors_as_failure(hand_in.picture, "compared", memory_remedy=remedy, status=_FAILED):
            return _compared(options, hand_in, picture, solution, note)
    except Failure as failure:
        return _result(hand_in)._replace(error=str(failure)), None
    except Exception as bug:
        what = f"{type(bug).__name__}: {bug}"
        return _failed(hand_in, f"cannot be compared: {what}; this is a bug, please report it")


def _figures(a: Codes, b: Codes) -> tuple[float, float, float]:
    """Return SSIM, RMSE and the maximum difference in linear light, of codes of one shape.

    They are computed band by band, because their arrays take about 100 bytes per pixel.  `windows`
    is the number of rows at which SSIM's window lies inside the picture.
    """
    (height, width, _), margin = a.shape, SSIM_WINDOW - 1
    step = max(1, _PIXELS_PER_BAND // width)
    ssim, squares, largest, windows = 0.0, 0.0, 0.0, max(1, height - margin)
    for start in range(0, windows, step):
        rows = slice(start, start + step + margin)
        band = measure_differences(decode_to_linear(a[rows]), decode_to_linear(b[rows]))
        ssim += band.ssim * min(step, windows - start) / windows
        largest = max(largest, band.max)
    for start in range(0, height, step):
        rows = slice(start, start + step)
        squares += float(((decode_to_linear(a[rows]) - decode_to_linear(b[rows])) ** 2).sum())
    return ssim, float(np.sqrt(squares / a.size)), largest


def _compared(
    options: argparse.Namespace, hand_in: HandIn, picture: Picture, solution: Solution, note: str
) -> tuple[Result, Pair | None]:
    """Compare a picture that was read with a solution; `note` is about the solution's format.

    If there are several hand-ins, a comparison is written only for those that differ.
    """
    diagnosis, right = solution.diagnose(picture), solution.codes
    names = ("It", picture.note), (str(hand_in.right and hand_in.right.name), note)
    notes = [f"{name} {text}" for name, text in names if text and diagnosis.kind != "identical"]
    diagnosis = diagnosis.preceded_by(" ".join(notes))
    result, pair = _result(hand_in)._replace(diagnosis=diagnosis), None
    if picture.codes.shape != right.shape:
        return result, None
    ssim, rmse, largest = _figures(picture.codes, right)
    agrees = diagnosis.kind in AGREEING
    if options.ssim is not None or options.max is not None:
        agrees = (options.max is None or largest <= options.max) and (
            options.ssim is None or ssim >= options.ssim
        )
    result = result._replace(
        agrees=agrees, ssim=ssim, rmse=rmse, max=largest,
        differing=int((picture.codes != right).any(axis=2).sum()),
        worst=worst_pixel(picture.codes, right),
    )  # fmt: skip
    if options.html:
        pair = pair_of(result, picture.codes, right)
    output = hand_in.output
    if output is not None and not (options.many and agrees):
        labels = [printable(path.name) for path in (hand_in.picture, hand_in.right) if path]
        with errors_as_failure(
            output, "written", "choose another with -o", status=_FAILED, error_types=(ValueError,)
        ):
            output.parent.mkdir(parents=True, exist_ok=True)
            write_comparison(
                output,
                decode_to_linear(picture.codes),
                decode_to_linear(right),
                (labels[0], labels[1]),
            )
        result = result._replace(comparison=str(output))
    return result, pair
