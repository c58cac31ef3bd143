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
from reference.handins.class_page import class_page, make_pair
from reference.handins.diagnosis import AGREEING, Solution, worst_pixel
from reference.handins.folders import HandIn, list_hand_ins, match_hand_ins
from reference.handins.results import (
    Result,
    format_csv,
    format_json,
    format_text,
    with_common_causes_first,
)
from reference.handins.workers import map_in_workers
from reference.page import Pair
from reference.pictures import UNREADABLE, Codes, Picture, read_picture
from tracer import load_scene
from tracer.command.arguments import file_name, is_folder
from tracer.command.failure import Failure, errors_as_failure
from tracer.command.process import print_line, print_result
from tracer.command.progress import track
from tracer.files import atomic_file
from tracer.messages import printable

# Exit status if some pictures cannot be compared.
_FAILED = 3
# Number of pixels in a band of rows: figures are computed band by band.
_PIXELS_PER_BAND = 500_000


def tolerance(text: str) -> float:
    """Convert a command-line option's argument to a number of at least 0.

    If the text is not a number, the message of argparse contains the name of this function.

    Raises
    ------
    argparse.ArgumentTypeError
        If the number is negative or NaN.
    ValueError
        If the text is not a number.
    """
    if not (value := float(text)) >= 0:
        raise argparse.ArgumentTypeError(f"must be 0 or more, is {text}")
    return value


def _parse(arguments: Sequence[str] | None) -> tuple[argparse.Namespace, list[HandIn]]:
    """Parse the command line, and find the hand-ins with their reference pictures.

    Parameters
    ----------
    arguments : sequence of str or None
        The command's arguments; by default (None), those of this process.

    Returns
    -------
    options : Namespace
        The options.  In addition, `is_class` is true if the first argument is a folder, and
        `folder` is that folder, or the folder of the picture.
    hand_ins : list of HandIn
        The pictures that were handed in, and those that are missing.

    Raises
    ------
    SystemExit
        For wrong usage, with status 2 after a message.
    Failure
        If a file does not exist.
    """
    command_parser = make_parser("reference.compare")
    add, exit_with = command_parser.add_argument, command_parser.error
    add("a", metavar="HAND-IN", type=Path, help="the picture in question, or a folder")
    add("b", metavar="RIGHT", type=Path, help="a scene file, a picture, or a folder of these")
    add("--ssim", type=tolerance, metavar="S", help="minimum SSIM that is tolerated")
    add("--max", type=tolerance, metavar="M", help="maximum linear difference that is tolerated")
    where = "write a comparison picture: a file, or a folder, which may end in /"
    add("-o", "--output", type=file_name, metavar="PATH", help=where)
    add("--html", type=file_name, metavar="OUT.html", help="write one page that shows all of them")
    output_format = command_parser.add_mutually_exclusive_group()
    output_format.add_argument(
        "--json", action="store_true", help="print a list with an object per picture"
    )
    output_format.add_argument("--csv", action="store_true", help="print the same as a table")
    options = command_parser.parse_args(arguments)
    for path in (options.a, options.b):
        if not path.exists():
            raise Failure(str(path), "does not exist", status=_FAILED)
    options.is_class = options.a.is_dir()
    options.folder = options.a if options.is_class else options.a.parent
    pictures = list_hand_ins(options.a) if options.is_class else [options.a]
    if options.a.suffix.lower() == ".xml" or (not pictures and [*options.a.glob("*.xml")]):
        exit_with(printable(f"{options.a}: a hand-in is a picture; give it first, then the scene"))
    if not pictures:
        exit_with(printable(f"{options.a}: contains no pictures"))
    if options.is_class and options.output and not is_folder(options.output):
        wrong = f"-o {options.output}: several pictures need a folder; end it in {os.sep}"
        exit_with(printable(wrong))
    hand_ins = [
        hand_in._replace(output=_output_path(options, hand_in.picture))
        for hand_in in match_hand_ins(pictures, options.folder, options.b)
    ]
    outputs = [hand_in.output for hand_in in hand_ins] + [options.html and Path(options.html)]
    references = (hand_in.right for hand_in in hand_ins if hand_in.right)
    forbid_overwriting_inputs(command_parser, filter(None, outputs), (*pictures, *references))
    return options, hand_ins


def _output_path(options: argparse.Namespace, picture: Path | None) -> Path | None:
    """Return the path for the picture that shows a hand-in beside its reference picture.

    Parameters
    ----------
    options : Namespace
        The options of the command.
    picture : Path or None
        The picture that was handed in; None if it is missing.

    Returns
    -------
    Path or None
        Different for each picture of a class.  None if the picture is missing, or if the option -o
        is not given.
    """
    if picture is None or not options.output:
        return None
    if not options.is_class and not is_folder(options.output):
        return Path(options.output)
    path = picture.relative_to(options.folder)
    return Path(options.output, path.with_name(f"{path.name}.compare.png"))


def main(arguments: Sequence[str] | None = None) -> int:
    """Compare hand-ins with their references, print the results, and return the exit status.

    If the options request it, an HTML page and comparison pictures are written, too.

    Parameters
    ----------
    arguments : sequence of str, optional
        The arguments of the command; by default, those of this process.

    Returns
    -------
    int
        0 if all pictures agree; 1 if some differ or are missing; 3 if some cannot be compared.

    Raises
    ------
    SystemExit
        For wrong usage, with status 2.
    Failure
        If a file does not exist or cannot be written.
    """
    options, hand_ins = _parse(arguments)
    # Hand-ins of one scene follow one another: what is computed for the scene serves all of them.
    jobs = sorted(hand_ins, key=lambda hand_in: str(hand_in.right))
    compared = map_in_workers(partial(compare_hand_in, options), jobs, result_of_lost_worker)
    results_and_pairs = sorted(track(compared, len(jobs), "pictures"), key=_sort_key)
    results = with_common_causes_first([result for result, _ in results_and_pairs])
    if options.html:
        pairs = {str(result.picture): pair for result, pair in results_and_pairs if pair}
        html = class_page(results, pairs, options.folder)
        path = Path(options.html)
        with errors_as_failure(path, "written", "choose another with --html", status=_FAILED):
            path.parent.mkdir(parents=True, exist_ok=True)
            with atomic_file(path, b"<!doctype html>") as file:
                file.write(html.encode(errors="backslashreplace"))
    is_any_unread = any(result.verdict == "unread" for result in results)
    if options.json or options.csv:
        text = (format_json if options.json else format_csv)(results)
    else:
        text = format_text(results, as_list=options.is_class)
    if is_any_unread and not (options.is_class or options.json or options.csv):
        print_line(sys.stderr, text)
    else:
        with errors_as_failure("standard output", "written", status=_FAILED):
            print_result(sys.stdout, text)
    return _FAILED if is_any_unread else int(not all(result.agrees for result in results))


def _sort_key(result_and_pair: tuple[Result, Pair | None]) -> tuple[bool, str, str]:
    """Return a key that sorts results: first pictures by their paths, then missing ones.

    Missing pictures are ordered by student; those without a known student come last.

    Parameters
    ----------
    result_and_pair : tuple of Result and Pair
        A result, and the pair of pictures for the page or None; only the result is used.

    Returns
    -------
    tuple of bool, str and str
        Whether the picture is missing; its path, or else the student's name; the scene's name.
    """
    result = result_and_pair[0]
    return not result.picture, result.picture or result.student or "~", result.scene


@lru_cache(maxsize=1)
def _load_solution(path: Path) -> tuple[Solution, str]:
    """Load the reference with which hand-ins are compared: a scene or a picture.

    Only the result of the last call is cached.

    Parameters
    ----------
    path : Path
        A scene file, whose name ends in .xml, or a picture.

    Returns
    -------
    solution : Solution
        The reference picture or scene; its method `diagnose` finds the mistake in a hand-in.
    note : str
        What the file format of a reference picture has changed, such as "is a JPEG, which changes
        levels: …"; empty for a scene, or if nothing has changed.

    Raises
    ------
    Failure
        If the file cannot be read, or is not a valid scene.
    """
    with errors_as_failure(path, "read", status=_FAILED, error_types=UNREADABLE):
        if path.suffix.lower() == ".xml":
            return Solution(load_scene(path), shlex.quote(str(path))), ""
        picture = read_picture(path)
        return Solution(picture), picture.note


def result_of_lost_worker(hand_in: HandIn) -> tuple[Result, None]:
    """Return the result for a hand-in if the process that compared it has ended early.

    Returns
    -------
    tuple of Result and None
        A result with an error; there is no pair of pictures to show.
    """
    return _failed(hand_in, "cannot be compared: its process was ended; is there enough memory?")


def _failed(hand_in: HandIn, reason: str) -> tuple[Result, None]:
    """Return the result for a hand-in that is missing or could not be compared.

    Parameters
    ----------
    hand_in : HandIn
        The picture that was handed in, or a missing one.
    reason : str
        Why it could not be compared, as a predicate that follows its path.

    Returns
    -------
    tuple of Result and None
        A result with an error; there is no pair of pictures to show.
    """
    path = hand_in.picture or hand_in.right
    if hand_in.picture is None and hand_in.student:
        path = Path(hand_in.student, hand_in.scene)
    return _new_result(hand_in)._replace(error=str(Failure(str(path), reason))), None


def _new_result(hand_in: HandIn) -> Result:
    """Return a result with the student, scene and files of a hand-in, but without a diagnosis."""
    picture, right = (str(path) if path else None for path in (hand_in.picture, hand_in.right))
    return Result(hand_in.student, hand_in.scene, picture, right)


def compare_hand_in(options: argparse.Namespace, hand_in: HandIn) -> tuple[Result, Pair | None]:
    """Compare a picture that was handed in with its reference; errors become results.

    Parameters
    ----------
    options : Namespace
        The options of the command.
    hand_in : HandIn
        The paths of the picture and of its reference, which is a picture or a scene file.

    Returns
    -------
    result : Result
        The diagnosis and figures.  If the picture is missing or cannot be compared, the result
        states why instead.
    pair : Pair or None
        Both pictures, for the HTML page.  None if no page is requested, if the sizes differ, or if
        the picture cannot be compared.
    """
    if hand_in.error or not (hand_in.picture and hand_in.right):
        return _failed(hand_in, hand_in.error)
    try:
        with errors_as_failure(hand_in.picture, "read", status=_FAILED, error_types=UNREADABLE):
            picture = read_picture(hand_in.picture)
        solution, note = _load_solution(hand_in.right)
        remedy = "compare a part"
        with errors_as_failure(hand_in.picture, "compared", memory_remedy=remedy, status=_FAILED):
            return _compare_with(solution, note, options, hand_in, picture)
    except Failure as failure:
        return _new_result(hand_in)._replace(error=str(failure)), None
    except Exception as bug:
        error = f"{type(bug).__name__}: {bug}"
        return _failed(hand_in, f"cannot be compared: {error}; this is a bug, please report it")


def _linear_figures(first: Codes, second: Codes) -> tuple[float, float, float]:
    """Measure the difference between two pictures in linear light.

    The pictures are divided into bands of rows to limit memory use, because the arrays of a band
    take about 100 bytes per pixel.

    Parameters
    ----------
    first, second : (h, w, 3) uint8 arrays
        The pictures' 8-bit codes.

    Returns
    -------
    ssim : float
        Structural similarity; 1 for equal pictures.
    rmse, maximum : float
        Root mean square and maximum of the difference, over all pixels and channels.
    """
    (height, width, _), margin = first.shape, SSIM_WINDOW - 1
    band_height = max(1, _PIXELS_PER_BAND // width)
    # Number of rows at which a structural-similarity window can begin.
    window_rows = max(1, height - margin)
    ssim, sum_of_squares, maximum = 0.0, 0.0, 0.0
    for start in range(0, window_rows, band_height):
        rows = slice(start, start + band_height + margin)
        band = measure_differences(decode_to_linear(first[rows]), decode_to_linear(second[rows]))
        ssim += band.ssim * min(band_height, window_rows - start) / window_rows
        maximum = max(maximum, band.max)
    for start in range(0, height, band_height):
        rows = slice(start, start + band_height)
        difference = decode_to_linear(first[rows]) - decode_to_linear(second[rows])
        sum_of_squares += float((difference**2).sum())
    return ssim, float(np.sqrt(sum_of_squares / first.size)), maximum


def _compare_with(
    solution: Solution, note: str, options: argparse.Namespace, hand_in: HandIn, picture: Picture
) -> tuple[Result, Pair | None]:
    """Compare a picture with its reference; if requested, write a picture that shows both.

    For a class, comparison pictures are written only for hand-ins that differ.

    Parameters
    ----------
    solution : Solution
        The reference picture.
    note : str
        What the file format of the reference picture has changed; empty if nothing.
    options : Namespace
        The options of the command.
    hand_in : HandIn
        The paths of the two pictures, and the path of the comparison picture to write.
    picture : Picture
        The contents of the file that was handed in.

    Returns
    -------
    result : Result
        The diagnosis and, unless the sizes differ, the figures.
    pair : Pair or None
        Both pictures, for the HTML page.  None if no page is requested, or if the sizes differ.

    Raises
    ------
    Failure
        If the file cannot be written.
    """
    diagnosis, reference_codes = solution.diagnose(picture), solution.codes
    names = ("It", picture.note), (str(hand_in.right and hand_in.right.name), note)
    notes = [f"{name} {text}" for name, text in names if text and diagnosis.kind != "identical"]
    diagnosis = diagnosis.preceded_by(" ".join(notes))
    result, pair = _new_result(hand_in)._replace(diagnosis=diagnosis), None
    if picture.codes.shape != reference_codes.shape:
        return result, None
    ssim, rmse, maximum = _linear_figures(picture.codes, reference_codes)
    agrees = diagnosis.kind in AGREEING
    if options.ssim is not None or options.max is not None:
        agrees = (options.max is None or maximum <= options.max) and (
            options.ssim is None or ssim >= options.ssim
        )
    result = result._replace(
        agrees=agrees, ssim=ssim, rmse=rmse, max=maximum,
        differing=int((picture.codes != reference_codes).any(axis=2).sum()),
        worst=worst_pixel(picture.codes, reference_codes),
    )  # fmt: skip
    if options.html:
        pair = make_pair(result, picture.codes, reference_codes)
    output = hand_in.output
    if output is not None and not (options.is_class and agrees):
        labels = [printable(path.name) for path in (hand_in.picture, hand_in.right) if path]
        with errors_as_failure(
            output, "written", "choose another with -o", status=_FAILED, error_types=(ValueError,)
        ):
            output.parent.mkdir(parents=True, exist_ok=True)
            write_comparison(
                output,
                decode_to_linear(picture.codes),
                decode_to_linear(reference_codes),
                (labels[0], labels[1]),
            )
        result = result._replace(comparison=str(output))
    return result, pair
