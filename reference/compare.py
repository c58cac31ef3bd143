"""Compare pictures with the right ones, and report the mistakes in them.

    python -m reference.compare HAND-IN.png SCENE.xml
    python -m reference.compare HAND-INS/ SCENES/

RIGHT is a scene file, which is rendered, a picture, or a folder of these.  A mistake is reported if
rendering the scene with this mistake reproduces the hand-in.  If no mistake does, the report names
the nearest one, and states where the pictures differ.  If RIGHT is a picture, only some mistakes of
the camera and of the encoding can be found.  All pictures in a folder and its subfolders are
compared with the scenes of the same name: NAME.png, NAME.xml.png, ID_NAME.png and NAME-ID.png with
NAME.xml.
Exit status: 0 if all agree, or are within the tolerances; 1 if some differ or are missing; 2 for
wrong usage; 3 if some cannot be compared.
"""

from __future__ import annotations

from tracer.command.process import run

if __name__ == "__main__":
    run(__spec__.name)  # before the other imports: see tracer/command/process.py

import argparse
import os
import shlex
import sys
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from functools import lru_cache, partial
from pathlib import Path
from threading import Event
from typing import Annotated as Shaped

import numpy as np

from reference.command import FAILED_STATUS, forbid_overwriting_inputs, make_parser
from reference.figures import compare_codes, write_comparison
from reference.handins.class_page import make_pair, render_class_page, render_student_pages
from reference.handins.diagnosis import (
    AGREEING_KINDS,
    UNKNOWN,
    Reference,
    find_worst_pixel,
    make_verdict,
)
from reference.handins.folders import HandIn, list_hand_ins, list_references, match_hand_ins
from reference.handins.results import Result, format_csv, format_json, format_text, sort_causes
from reference.handins.workers import map_in_workers
from reference.page import Pair, write_page
from reference.pictures import Codes, read_picture
from tracer import load_scene
from tracer.command.arguments import OUTPUT_REMEDY, check_path, is_folder
from tracer.command.failure import Failure, errors_as_failure
from tracer.command.process import print_or_raise
from tracer.command.progress import Progress, track
from tracer.messages import make_printable

# Time between updates of the progress bar of a single comparison.
_REFRESH_SECONDS = 0.5
# The error of a hand-in whose worker process has died.
_WORKER_DIED = "cannot be compared: its process was ended; is there enough memory?"


def parse_tolerance(argument: str) -> float:
    """Convert a command-line argument to a non-negative number; raise ArgumentTypeError if not."""
    with suppress(ValueError):
        if (tolerance := float(argument)) >= 0:
            return tolerance
    raise argparse.ArgumentTypeError(f"must be 0 or more, not {argument}")


def _parse_ssim(argument: str) -> float:
    """Convert a command-line argument to an SSIM; raise ArgumentTypeError if it is none."""
    with suppress(ValueError):
        if 0 <= (ssim := float(argument)) <= 1:
            return ssim
    raise argparse.ArgumentTypeError(f"must be from 0 to 1, not {argument}")


def _read_class_list(path: Path) -> list[str]:
    """Read the names of students, one a line; empty lines are skipped."""
    with errors_as_failure(path, "read", exit_status=FAILED_STATUS, error_types=(ValueError,)):
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    return [name for line in lines if (name := line.strip())]


def _parse_command_line(arguments: Sequence[str] | None) -> tuple[argparse.Namespace, list[HandIn]]:
    """Parse the command line, and match each hand-in with its reference picture or scene.

    The options have two more attributes: `is_class` is True if the first argument is a folder, and
    `folder` is that folder, or the folder of the single picture.

    If the arguments are wrong, print a message and exit with status 2.  Raise Failure if a file
    does not exist, or if the class list cannot be read.
    """
    command_parser = make_parser("reference.compare")
    add_argument, report_error = command_parser.add_argument, command_parser.error
    add_argument("hand_in", metavar="HAND-IN", type=Path, help="the picture to check, or a folder")
    add_argument("reference", metavar="RIGHT", type=Path, help="a scene, a picture, or a folder")
    add_argument("--ssim", type=_parse_ssim, metavar="S", help="minimum SSIM")
    add_argument("--max", type=parse_tolerance, metavar="M", help="maximum linear difference")
    output_help = "write a comparison picture: a file, or a folder, which may end in /"
    add_argument("-o", "--output", type=check_path, metavar="PATH", help=output_help)
    html_help = "write a page of all pictures; a folder also gets a page for each student"
    add_argument("--html", type=check_path, metavar="OUT.html", help=html_help)
    students_help = "a class list, one name a line: who is missing"
    add_argument("--students", type=Path, metavar="NAMES.txt", help=students_help)
    formats = command_parser.add_mutually_exclusive_group()
    add_format = partial(formats.add_argument, action="store_const", dest="format_results")
    add_format("--json", const=format_json, help="print a list with one object per picture")
    add_format("--csv", const=format_csv, help="print the same as a table")
    options = command_parser.parse_args(arguments)
    input_path, reference_path = options.hand_in, options.reference
    for path in (input_path, reference_path):
        if not path.exists():
            raise Failure(str(path), "does not exist", exit_status=FAILED_STATUS)
    options.is_class = input_path.is_dir()
    options.folder = input_path if options.is_class else input_path.parent
    picture_paths = list_hand_ins(input_path) if options.is_class else [input_path]
    if input_path.suffix.lower() == ".xml" or (not picture_paths and [*input_path.glob("*.xml")]):
        report_error(
            make_printable(f"{input_path}: a hand-in is a picture; put it before the scene")
        )
    if not picture_paths:
        report_error(make_printable(f"{input_path}: contains no pictures"))
    if options.is_class and options.output and not is_folder(options.output):
        problem = f"several pictures need a folder; end it in {os.sep}"
        report_error(make_printable(f"-o {options.output}: {problem}"))
    names = _read_class_list(options.students) if options.students else []
    hand_ins = match_hand_ins(picture_paths, input_path, reference_path, names)
    outputs = [_choose_comparison_path(options, path) for path in picture_paths if options.output]
    outputs += [_get_page_path(options)] if options.html else []
    reference_files = (hand_in.reference for hand_in in hand_ins if hand_in.reference)
    forbid_overwriting_inputs(command_parser, outputs, (*picture_paths, *reference_files))
    return options, hand_ins


def _get_page_path(options: argparse.Namespace) -> Path:
    """Return the path of the page of all pictures: the one given, or `index.html` in a folder."""
    path = Path(options.html)
    return path / "index.html" if is_folder(options.html) else path


def _choose_comparison_path(options: argparse.Namespace, picture_path: Path) -> Path:
    """Choose the path of the comparison picture for a submitted picture.

    It is the path given with -o; or, if that is a folder, a path in it that is unique.
    """
    if not is_folder(options.output):
        return Path(options.output)
    relative_path = picture_path.relative_to(options.folder)
    return Path(options.output, relative_path.with_name(f"{picture_path.name}.compare.png"))


def main(arguments: Sequence[str] | None = None) -> int:
    """Compare submitted pictures with their references, and print the results.

    Depending on the options, also write an HTML page and comparison pictures.

    Parameters
    ----------
    arguments : sequence of str, optional
        The command-line arguments; by default, the arguments of this process.

    Returns
    -------
    exit_status : int
        0 if all pictures agree; 3 if some cannot be compared; 1 if some only differ or are missing.

    Raises
    ------
    SystemExit
        If the arguments are wrong; the exit status is 2.
    Failure
        If a file does not exist or cannot be written, or if the only picture cannot be compared.
    """
    options, hand_ins = _parse_command_line(arguments)
    # Sort by reference, so that consecutive hand-ins can use the same cached reference.
    hand_ins = sorted(hand_ins, key=lambda hand_in: str(hand_in.reference))
    if len(hand_ins) == 1:
        results_and_pairs = [_compare_with_progress_bar(options, hand_ins[0])]
    else:
        compare = partial(compare_hand_in, options)
        comparisons = map_in_workers(
            compare, hand_ins, lambda hand_in: compare(hand_in._replace(error=_WORKER_DIED))
        )
        results_and_pairs = sorted(track(comparisons, len(hand_ins), "pictures"), key=_get_sort_key)
    results = sort_causes([result for result, _ in results_and_pairs])
    if options.html:
        pairs = {str(result.picture): pair for result, pair in results_and_pairs if pair}
        _write_pages(options, results, pairs)
    if results[0].error and not (options.is_class or options.format_results):
        raise Failure("", results[0].error, exit_status=FAILED_STATUS)
    format_results = options.format_results or partial(format_text, is_class=options.is_class)
    with errors_as_failure("standard output", "written", exit_status=FAILED_STATUS):
        print_or_raise(sys.stdout, format_results(results))
    if any(result.verdict == "unread" for result in results):
        return FAILED_STATUS
    return int(not all(result.agrees for result in results))


def _write_pages(
    options: argparse.Namespace, results: Sequence[Result], pairs: dict[str, Pair]
) -> None:
    """Write the page of all pictures and, in a folder, `students/NAME.html` for each student."""
    page_path = _get_page_path(options)
    pages = {page_path: render_class_page(results, pairs, options.folder)}
    if is_folder(options.html):
        for student, page in render_student_pages(results, pairs, options.folder).items():
            # Names from a class list may contain slashes.
            pages[page_path.parent / "students" / f"{student.replace('/', '-')}.html"] = page
    for path, html in pages.items():
        write_page(path, html, "choose another with --html", FAILED_STATUS)


def _compare_with_progress_bar(
    options: argparse.Namespace, hand_in: HandIn
) -> tuple[Result, Pair | None]:
    """Compare one picture with its reference, showing a progress bar after the first second."""
    is_finished = Event()

    def refresh(bar: Progress) -> None:
        """Show the elapsed time on the bar until the comparison is finished."""
        while not is_finished.wait(_REFRESH_SECONDS):
            bar.update(0)

    # The comparison runs in the main thread, where freed memory is reused best.
    with Progress(1, "pictures") as bar, ThreadPoolExecutor(1) as executor:
        executor.submit(refresh, bar)
        try:
            return compare_hand_in(options, hand_in)
        finally:
            is_finished.set()


def _get_sort_key(result_and_pair: tuple[Result, Pair | None]) -> tuple[bool, str, str]:
    """Return a sort key: pictures come first, by path, and missing pictures follow, by student.

    Scenes for which nobody handed in a picture come last.
    """
    result, _ = result_and_pair
    return not result.picture, result.picture or result.student or "~", result.scene


@lru_cache(maxsize=1)
def _load_reference(path: Path) -> Reference:
    """Load a picture or a scene file; the most recent one is cached.

    Raise Failure if the file cannot be read, or is not a valid scene.
    """
    if path.suffix.lower() != ".xml":
        return Reference(read_picture(path))
    with errors_as_failure(path, "read"):
        return Reference(load_scene(path), shlex.quote(str(path)))


@lru_cache(maxsize=1)
def _load_all_codes(folder: Path) -> dict[str, Shaped[Codes, "height width 3"]]:
    """Render all scenes of a folder, and read its reference pictures: codes by file name.

    What cannot be read is left out: its own hand-ins get the error.
    """
    all_codes = {}
    for path in list_references(folder).values():
        with suppress(Failure):
            all_codes[path.name] = _load_reference.__wrapped__(path).codes
    return all_codes


def compare_hand_in(options: argparse.Namespace, hand_in: HandIn) -> tuple[Result, Pair | None]:
    """Compare a submitted picture with its reference, and return errors instead of raising them.

    The pair is for the HTML page: None if no page is requested, or if there is an error.
    """
    paths = hand_in.picture, hand_in.reference
    picture_name, reference_name = (str(path) if path else None for path in paths)
    result = Result(hand_in.student, hand_in.scene, picture_name, reference_name)
    missing_name = Path(hand_in.student, hand_in.scene) if hand_in.student else reference_name
    name_in_error = picture_name or str(missing_name)
    try:
        if hand_in.error or not (hand_in.picture and hand_in.reference):
            raise Failure(name_in_error, hand_in.error)
        with errors_as_failure(name_in_error, "compared", memory_remedy="compare a part"):
            return _compare_files(options, hand_in.picture, hand_in.reference, result)
    except Failure as failure:
        return result._replace(error=str(failure)), None
    except Exception as bug:
        problem = f"cannot be compared: {type(bug).__name__}: {bug}"
        error = Failure(name_in_error, problem, "this is a bug, please report it")
        return result._replace(error=str(error)), None


def _compare_files(
    options: argparse.Namespace, picture_path: Path, reference_path: Path, result: Result
) -> tuple[Result, Pair | None]:
    """Complete a result: compare its pictures, and draw both side by side if requested.

    If a whole class is compared, only pictures that do not agree are drawn.  Raise Failure if a
    file cannot be read or written.
    """
    picture, reference = read_picture(picture_path), _load_reference(reference_path)
    diagnosis = reference.diagnose(picture)
    if diagnosis.kind in ("size", UNKNOWN) and options.reference.is_dir():
        for name, codes in _load_all_codes(options.reference).items():
            if np.array_equal(codes, picture.codes):
                diagnosis = make_verdict("other-scene", f"It is the picture of {name}.")
    notes = ("It", picture.note), (reference_path.name, reference.picture.note)
    sentences = [f"{name} {note}" for name, note in notes if note and diagnosis.kind != "identical"]
    result = result._replace(diagnosis=diagnosis.prepend_text(" ".join(sentences)))
    if picture.codes.shape != reference.codes.shape:
        if not options.html:
            return result, None
        return result, make_pair(result, picture.codes, reference.codes, None)
    ssim, rmse, max_difference, difference = compare_codes(picture.codes, reference.codes)
    agrees = diagnosis.kind in AGREEING_KINDS
    if options.ssim is not None or options.max is not None:
        agrees = (options.max is None or max_difference <= options.max) and (
            options.ssim is None or ssim >= options.ssim
        )
    result = result._replace(
        agrees=agrees,
        ssim=ssim,
        rmse=rmse,
        max=max_difference,
        differing=int((picture.codes != reference.codes).any(axis=2).sum()),
        worst=find_worst_pixel(picture.codes, reference.codes),
    )
    pair = make_pair(result, picture.codes, reference.codes, difference) if options.html else None
    if options.output and not (options.is_class and agrees):
        output_path = _choose_comparison_path(options, picture_path)
        labels = make_printable(picture_path.name), make_printable(reference_path.name)
        with errors_as_failure(output_path, "written", OUTPUT_REMEDY, error_types=(ValueError,)):
            output_path.parent.mkdir(parents=True, exist_ok=True)
            write_comparison(output_path, (picture.codes, reference.codes), difference, labels)
        result = result._replace(comparison=str(output_path))
    return result, pair
