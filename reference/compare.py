"""Compare pictures with the right ones, and report the mistakes in them.

    python -m reference.compare HAND-IN.png SCENE.xml
    python -m reference.compare HAND-INS/ SCENES/

RIGHT is a scene file, which is rendered, a picture, or a folder of these.  A mistake is reported if
the scene, rendered with this mistake, gives the picture that was handed in; if there is none, the
nearest mistake, and where the pictures differ.  With a picture in place of a scene, only some
mistakes of the camera and of the encoding are known.  All pictures in a folder and its subfolders
are compared with the scenes of their names: NAME.png, NAME.xml.png, ID_NAME.png and NAME-ID.png
with NAME.xml.
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
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import suppress
from functools import lru_cache, partial
from pathlib import Path

from reference.command import FAILED_STATUS, forbid_overwriting_inputs, make_parser
from reference.figures import compare_codes, write_comparison
from reference.handins.class_page import make_pair, render_class_page
from reference.handins.diagnosis import AGREEING, Solution, find_worst_pixel
from reference.handins.folders import HandIn, list_hand_ins, match_hand_ins
from reference.handins.results import (
    Result,
    format_csv,
    format_json,
    format_text,
    with_common_causes_first,
)
from reference.handins.workers import map_in_workers
from reference.page import Pair, write_page
from reference.pictures import read_picture
from tracer import load_scene
from tracer.command.arguments import OUTPUT_REMEDY, is_folder, parse_path
from tracer.command.failure import Failure, errors_as_failure
from tracer.command.process import print_result
from tracer.command.progress import Progress, track
from tracer.messages import printable

# Time between updates of the progress bar of a single comparison.
_REFRESH_SECONDS = 0.5
# Why a hand-in is not compared if its worker dies.
_LOST = "cannot be compared: its process was ended; is there enough memory?"


def parse_tolerance(text: str) -> float:
    """Convert a command-line argument to a number of at least 0.

    Raises
    ------
    argparse.ArgumentTypeError
        If the text is not a number, or the number is negative or NaN.
    """
    with suppress(ValueError):
        if (number := float(text)) >= 0:
            return number
    raise argparse.ArgumentTypeError(f"must be 0 or more, not {text}")


def _parse_command_line(arguments: Sequence[str] | None) -> tuple[argparse.Namespace, list[HandIn]]:
    """Parse the command line, and find the reference picture or scene of each hand-in.

    Parameters
    ----------
    arguments : sequence of str or None
        The command-line arguments; None for those of this process.

    Returns
    -------
    options : Namespace
        The options.  In addition, `is_class` is True if the first argument is a folder, and
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
    add("--ssim", type=parse_tolerance, metavar="S", help="smallest SSIM to accept")
    add("--max", type=parse_tolerance, metavar="M", help="largest linear difference to accept")
    output_help = "write a comparison picture: a file, or a folder, which may end in /"
    add("-o", "--output", type=parse_path, metavar="PATH", help=output_help)
    add("--html", type=parse_path, metavar="OUT.html", help="write one page that shows all of them")
    formats = command_parser.add_mutually_exclusive_group()
    add_format = partial(formats.add_argument, action="store_const", dest="format_results")
    add_format("--json", const=format_json, help="print a list with an object per picture")
    add_format("--csv", const=format_csv, help="print the same as a table")
    options = command_parser.parse_args(arguments)
    for path in (options.a, options.b):
        if not path.exists():
            raise Failure(str(path), "does not exist", status=FAILED_STATUS)
    options.is_class = options.a.is_dir()
    options.folder = options.a if options.is_class else options.a.parent
    pictures = list_hand_ins(options.a) if options.is_class else [options.a]
    if options.a.suffix.lower() == ".xml" or (not pictures and [*options.a.glob("*.xml")]):
        exit_with(printable(f"{options.a}: a hand-in is a picture; give it first, then the scene"))
    if not pictures:
        exit_with(printable(f"{options.a}: contains no pictures"))
    if options.is_class and options.output and not is_folder(options.output):
        problem = "several pictures need a folder; end it in"
        exit_with(printable(f"-o {options.output}: {problem} {os.sep}"))
    hand_ins = match_hand_ins(pictures, options.a, options.b)
    outputs = [_comparison_path(options, picture) for picture in pictures if options.output]
    outputs += [Path(options.html)] if options.html else []
    references = (hand_in.reference for hand_in in hand_ins if hand_in.reference)
    forbid_overwriting_inputs(command_parser, outputs, (*pictures, *references))
    return options, hand_ins


def _comparison_path(options: argparse.Namespace, picture_path: Path) -> Path:
    """Return the path of the comparison picture, which shows a hand-in beside its reference.

    Parameters
    ----------
    options : Namespace
        The command-line options, with -o (`output`).
    picture_path : Path
        The picture that was handed in.

    Returns
    -------
    path : Path
        The file that -o names; or, if -o names a folder, a file in that folder, which is different
        for each picture of a class.
    """
    if not is_folder(options.output):
        return Path(options.output)
    relative_path = picture_path.relative_to(options.folder)
    return Path(options.output, relative_path.with_name(f"{picture_path.name}.compare.png"))


def main(arguments: Sequence[str] | None = None) -> int:
    """Compare pictures that were handed in with their references, and print the results.

    If the options request it, an HTML page and comparison pictures are written, too.

    Parameters
    ----------
    arguments : sequence of str, optional
        The command-line arguments; by default those of this process.

    Returns
    -------
    status : int
        0 if all pictures agree; 1 if some differ or are missing; 3 if some cannot be compared.

    Raises
    ------
    SystemExit
        For wrong usage, with status 2.
    Failure
        If a file does not exist or cannot be written, or if a single picture cannot be compared.
    """
    options, hand_ins = _parse_command_line(arguments)
    # Hand-ins of one scene follow one another: what is computed for the scene serves all of them.
    jobs = sorted(hand_ins, key=lambda hand_in: str(hand_in.reference))
    if len(jobs) == 1:
        results_and_pairs = [_compare_with_progress_bar(options, jobs[0])]
    else:
        compare = partial(compare_hand_in, options)
        compared = map_in_workers(compare, jobs, lambda job: compare(job._replace(error=_LOST)))
        results_and_pairs = sorted(track(compared, len(jobs), "pictures"), key=_sort_key)
    results = with_common_causes_first([result for result, _ in results_and_pairs])
    if options.html:
        pairs = {str(result.picture): pair for result, pair in results_and_pairs if pair}
        page = render_class_page(results, pairs, options.folder)
        write_page(Path(options.html), page, "choose another with --html", FAILED_STATUS)
    if results[0].error and not (options.is_class or options.format_results):
        raise Failure("", results[0].error, status=FAILED_STATUS)
    format_results = options.format_results or partial(format_text, as_list=options.is_class)
    with errors_as_failure("standard output", "written", status=FAILED_STATUS):
        print_result(sys.stdout, format_results(results))
    if any(result.verdict == "unread" for result in results):
        return FAILED_STATUS
    return int(not all(result.agrees for result in results))


def _compare_with_progress_bar(
    options: argparse.Namespace, hand_in: HandIn
) -> tuple[Result, Pair | None]:
    """Compare one picture, and show the elapsed time in a progress bar after the first second.

    Parameters
    ----------
    options : Namespace
        The command-line options.
    hand_in : HandIn
        The paths of the picture and of its reference.

    Returns
    -------
    result : Result
        The diagnosis and the figures, or an error, as `compare_hand_in` returns it.
    pair : dict or None
        Both pictures, as the HTML page needs them; None without a page.
    """
    with Progress(1, "pictures") as bar, ThreadPoolExecutor(1) as executor:
        future = executor.submit(compare_hand_in, options, hand_in)
        while not wait([future], _REFRESH_SECONDS).done:
            bar.update(0)
        return future.result()


def _sort_key(result_and_pair: tuple[Result, Pair | None]) -> tuple[bool, str, str]:
    """Return a key that sorts results: pictures by their paths, then missing ones by student.

    Scenes without any picture come last.

    Parameters
    ----------
    result_and_pair : tuple of Result and Pair
        The result of comparing a picture, and the pair of pictures for the HTML page or None.  Only
        the result is used.

    Returns
    -------
    is_missing : bool
        Whether no picture was handed in.
    name : str
        The path of the picture, or else the student's name.
    scene : str
        The scene's name.
    """
    result = result_and_pair[0]
    return not result.picture, result.picture or result.student or "~", result.scene


@lru_cache(maxsize=1)
def _load_solution(path: Path) -> Solution:
    """Load a reference, with which hand-ins are compared: a scene or a picture.

    A second call with the same path returns the same object, unless another path came in between.

    Parameters
    ----------
    path : Path
        A scene file, whose name ends in .xml, or a picture.

    Returns
    -------
    solution : Solution
        The reference, whose method `diagnose` finds the mistakes in a hand-in.

    Raises
    ------
    Failure
        If the file cannot be read, or is not a valid scene.
    """
    if path.suffix.lower() != ".xml":
        return Solution(read_picture(path))
    with errors_as_failure(path, "read"):
        return Solution(load_scene(path), shlex.quote(str(path)))


def compare_hand_in(options: argparse.Namespace, hand_in: HandIn) -> tuple[Result, Pair | None]:
    """Compare a picture that was handed in with its reference; return errors instead of raising.

    Parameters
    ----------
    options : Namespace
        The command-line options.
    hand_in : HandIn
        The paths of the picture and of its reference, which is a picture or a scene file.

    Returns
    -------
    result : Result
        The diagnosis and the figures.  If the picture is missing or cannot be compared, the result
        contains the reason instead, as its `error`.
    pair : dict or None
        Both pictures, as the HTML page needs them.  None if no page is requested, if the sizes
        differ, or if the picture cannot be compared.
    """
    paths = hand_in.picture, hand_in.reference
    picture_name, reference_name = (str(path) if path else None for path in paths)
    result = Result(hand_in.student, hand_in.scene, picture_name, reference_name)
    missing_name = Path(hand_in.student, hand_in.scene) if hand_in.student else reference_name
    where = picture_name or str(missing_name)
    try:
        if hand_in.error or not (hand_in.picture and hand_in.reference):
            raise Failure(where, hand_in.error)
        with errors_as_failure(where, "compared", memory_remedy="compare a part"):
            return _compare_files(options, hand_in.picture, hand_in.reference, result)
    except Failure as failure:
        return result._replace(error=str(failure)), None
    except Exception as bug:
        cause = f"{type(bug).__name__}: {bug}; this is a bug, please report it"
        return result._replace(error=str(Failure(where, f"cannot be compared: {cause}"))), None


def _compare_files(
    options: argparse.Namespace, picture_path: Path, reference_path: Path, result: Result
) -> tuple[Result, Pair | None]:
    """Compare a picture with its reference; if requested, write a comparison picture.

    The comparison picture shows both side by side.  In a class, it is written only for pictures
    that differ.

    Parameters
    ----------
    options : Namespace
        The command-line options.
    picture_path : Path
        The picture that was handed in.
    reference_path : Path
        The reference: a picture or a scene file.
    result : Result
        The names of the student, of the scene and of both files.

    Returns
    -------
    result : Result
        A copy of `result` with the diagnosis and, unless the sizes differ, the figures.
    pair : dict or None
        Both pictures, as the HTML page needs them.  None if no page is requested, or if the sizes
        differ.

    Raises
    ------
    Failure
        If a file cannot be read or written.
    """
    picture, solution = read_picture(picture_path), _load_solution(reference_path)
    diagnosis = solution.diagnose(picture)
    notes = ("It", picture.note), (reference_path.name, solution.picture.note)
    sentences = [f"{name} {note}" for name, note in notes if note and diagnosis.kind != "identical"]
    result = result._replace(diagnosis=diagnosis.preceded_by(" ".join(sentences)))
    if picture.codes.shape != solution.codes.shape:
        return result, None
    ssim, rmse, maximum, difference = compare_codes(picture.codes, solution.codes)
    agrees = diagnosis.kind in AGREEING
    if options.ssim is not None or options.max is not None:
        agrees = (options.max is None or maximum <= options.max) and (
            options.ssim is None or ssim >= options.ssim
        )
    result = result._replace(
        agrees=agrees, ssim=ssim, rmse=rmse, max=maximum,
        differing=int((picture.codes != solution.codes).any(axis=2).sum()),
        worst=find_worst_pixel(picture.codes, solution.codes),
    )  # fmt: skip
    pair = make_pair(result, picture.codes, solution.codes, difference) if options.html else None
    if options.output and not (options.is_class and agrees):
        output = _comparison_path(options, picture_path)
        labels = printable(picture_path.name), printable(reference_path.name)
        with errors_as_failure(output, "written", OUTPUT_REMEDY, error_types=(ValueError,)):
            output.parent.mkdir(parents=True, exist_ok=True)
            write_comparison(output, (picture.codes, solution.codes), difference, labels)
        result = result._replace(comparison=str(output))
    return result, pair
