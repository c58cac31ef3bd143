"""Compare pictures with the right ones, and report the mistakes in them.

    python -m reference.compare HAND-IN RIGHT
    python -m reference.compare room.png scenes/room.xml
    python -m reference.compare hand-ins/ scenes/

HAND-IN is a picture, or a folder.  RIGHT is a scene file, which is rendered, or a picture, or a
folder of these.  A mistake is reported if rendering the scene with this mistake reproduces the
hand-in.  If no mistake does, the report names the nearest one, and states where the pictures
differ.  If RIGHT is a picture, only some mistakes of the camera and of the encoding can be found.
All pictures in a folder and its subfolders are compared with the scenes of the same name: NAME.png,
NAME.xml.png, ID_NAME.png and NAME-ID.png with NAME.xml.
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
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from functools import lru_cache, partial
from pathlib import Path
from threading import Event
from typing import Annotated as Shaped
from typing import NamedTuple

from reference.command import FAILED_STATUS, forbid_overwriting_inputs, make_parser
from reference.figures import Differences, compare_codes, write_comparison
from reference.handins.class_page import make_pair, render_class_page, render_student_pages
from reference.handins.diagnosis import (
    AGREEING_KINDS,
    IDENTICAL,
    Reference,
    find_worst_pixel,
)
from reference.handins.folders import HandIn, list_hand_ins, list_references, match_hand_ins
from reference.handins.results import (
    UNREAD,
    Result,
    format_class_text,
    format_csv,
    format_json,
    format_single_text,
    sort_causes,
)
from reference.handins.workers import map_in_workers
from reference.page import Pair, write_page
from reference.pictures import Codes, read_picture
from tracer import load_scene
from tracer.command.arguments import OUTPUT_REMEDY, CommandParser, check_path, is_folder
from tracer.command.failure import Failure, errors_as_failure
from tracer.command.process import print_or_raise
from tracer.command.progress import Progress, track
from tracer.messages import make_printable

# Time between updates of the progress bar of a single comparison.
_REFRESH_SECONDS = 0.5
# The error of a hand-in whose worker process has died.
_WORKER_DIED = "cannot be compared: its process was ended; is there enough memory?"


class Options(NamedTuple):
    """The arguments and options on the command line."""

    hand_in: Path  # a picture, or a folder of pictures
    reference: Path  # a scene file or a picture, or a folder of these
    ssim: float | None  # minimum structural similarity of pictures that agree
    max: float | None  # maximum linear difference of pictures that agree
    output: str | None  # file for the comparison picture, or folder for several
    html: str | None  # file for the page of all pictures, or folder that also gets students' pages
    students: Path | None  # the class list
    format_results: Callable[[Sequence[Result]], str] | None  # None for text

    @property
    def is_class(self) -> bool:
        """Whether a folder of pictures is compared, not a single picture."""
        return self.hand_in.is_dir()

    @property
    def folder(self) -> Path:
        """The folder that contains the pictures, directly or in its subfolders."""
        return self.hand_in if self.is_class else self.hand_in.parent

    @property
    def page_path(self) -> Path | None:
        """The path of the page of all pictures, which is `index.html` if --html names a folder."""
        if self.html is None:
            return None
        return Path(self.html, "index.html") if is_folder(self.html) else Path(self.html)

    def choose_comparison_path(self, picture_path: Path) -> Path | None:
        """Choose where to write the comparison of a submitted picture; None without -o.

        If -o names a folder, each picture gets a path of its own in this folder.
        """
        if self.output is None:
            return None
        if not is_folder(self.output):
            return Path(self.output)
        relative_path = picture_path.relative_to(self.folder)
        return Path(self.output, relative_path.with_name(f"{picture_path.name}.compare.png"))


class Compared(NamedTuple):
    """What has been found out about a submitted or missing picture."""

    result: Result
    # The pictures for the HTML page.  None if no page is requested, or if there is an error.
    pair: Pair | None


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


def _make_command_parser() -> CommandParser:
    """Create the parser of the command line; its results are the fields of `Options`."""
    command_parser = make_parser("reference.compare")
    add_argument = command_parser.add_argument
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
    return command_parser


def _parse_command_line(arguments: Sequence[str] | None) -> tuple[Options, list[HandIn]]:
    """Parse the command line, and match each hand-in with its reference picture or scene.

    If the arguments are wrong, or if an output would replace an input, print a message and exit
    with status 2.  Raise Failure if a file does not exist, or if the class list cannot be read.
    """
    command_parser = _make_command_parser()
    options = Options(**vars(command_parser.parse_args(arguments)))
    picture_paths = _list_pictures(options, command_parser)
    names = _read_class_list(options.students) if options.students else []
    hand_ins = match_hand_ins(picture_paths, options.hand_in, options.reference, names)
    outputs = [options.page_path, *map(options.choose_comparison_path, picture_paths)]
    references = [hand_in.reference for hand_in in hand_ins if hand_in.reference]
    forbid_overwriting_inputs(command_parser, filter(None, outputs), [*picture_paths, *references])
    return options, hand_ins


def _list_pictures(options: Options, command_parser: CommandParser) -> list[Path]:
    """List the pictures to compare: the given one, or all in the given folder.

    If there is none, or if several pictures have a single output file, print a message and exit
    with status 2.  Raise Failure if a file named on the command line does not exist.
    """
    for path in (options.hand_in, options.reference):
        if not path.exists():
            raise Failure(str(path), "does not exist", exit_status=FAILED_STATUS)
    path = options.hand_in
    picture_paths = list_hand_ins(path) if options.is_class else [path]
    is_scene = path.suffix.lower() == ".xml"
    if is_scene or (not picture_paths and [*path.glob("*.xml")]):
        command_parser.error(f"{path}: a hand-in is a picture; put it before the scene")
    if not picture_paths:
        command_parser.error(f"{path}: contains no pictures")
    if options.is_class and options.output and not is_folder(options.output):
        problem = f"several pictures need a folder; end it in {os.sep}"
        command_parser.error(f"-o {options.output}: {problem}")
    return picture_paths


def _read_class_list(path: Path) -> list[str]:
    """Read the names of students, one a line; empty lines are skipped."""
    with errors_as_failure(path, "read", exit_status=FAILED_STATUS, error_types=(ValueError,)):
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    return [name for line in lines if (name := line.strip())]


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
    all_compared = _compare_hand_ins(options, hand_ins)
    results = sort_causes([compared.result for compared in all_compared])
    pairs = {str(result.picture): pair for result, pair in all_compared if pair}
    _write_pages(options, results, pairs)
    if results[0].error and not (options.is_class or options.format_results):
        raise Failure("", results[0].error, exit_status=FAILED_STATUS)
    format_text = format_class_text if options.is_class else format_single_text
    format_results = options.format_results or format_text
    with errors_as_failure("standard output", "written", exit_status=FAILED_STATUS):
        print_or_raise(sys.stdout, format_results(results))
    if any(result.verdict == UNREAD for result in results):
        return FAILED_STATUS
    return int(not all(result.agrees for result in results))


def _compare_hand_ins(options: Options, hand_ins: Sequence[HandIn]) -> list[Compared]:
    """Compare all hand-ins with their references while a progress bar is shown.

    Results for pictures come first, sorted by path.  Missing pictures follow, sorted by student.
    """
    if len(hand_ins) == 1:
        return [_compare_with_progress_bar(options, hand_ins[0])]
    # Sort by reference, so that consecutive hand-ins can use the same cached reference.
    hand_ins = sorted(hand_ins, key=lambda hand_in: str(hand_in.reference))
    compare = partial(compare_hand_in, options)
    comparisons = map_in_workers(
        compare, hand_ins, lambda hand_in: compare(hand_in._replace(error=_WORKER_DIED))
    )
    return sorted(track(comparisons, len(hand_ins), "pictures"), key=_get_sort_key)


def _get_sort_key(compared: Compared) -> tuple[bool, str, str]:
    """Return a sort key: pictures come first, by path, and missing pictures follow, by student.

    Scenes for which nobody handed in a picture come last.
    """
    result = compared.result
    return not result.picture, result.picture or result.student or "~", result.scene


def _compare_with_progress_bar(options: Options, hand_in: HandIn) -> Compared:
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


def _write_pages(options: Options, results: Sequence[Result], pairs: dict[str, Pair]) -> None:
    """Write the pages that --html requests; without this option, do nothing.

    One page shows all pictures.  If the option names a folder, `students/NAME.html` there shows
    those of one student.  `pairs` maps the path of a submitted picture to the pictures to show.
    """
    page_path = options.page_path
    if not (options.html and page_path):
        return
    pages = {page_path: render_class_page(results, pairs, options.folder)}
    if is_folder(options.html):
        for student, page in render_student_pages(results, pairs, options.folder).items():
            # Names from a class list may contain slashes.
            pages[page_path.parent / "students" / f"{student.replace('/', '-')}.html"] = page
    for path, html in pages.items():
        write_page(path, html, "choose another with --html", FAILED_STATUS)


@lru_cache(maxsize=1)
def _load_reference(path: Path, folder: Path | None) -> Reference:
    """Load a picture or a scene file; the most recent one is cached.

    If a folder is given, its other scenes and pictures are recognised in hand-ins.  Raise Failure
    if the file cannot be read, or is not a valid scene.
    """
    load_other_codes = partial(_load_all_codes, folder) if folder else dict
    if path.suffix.lower() != ".xml":
        return Reference(read_picture(path), load_other_codes=load_other_codes)
    with errors_as_failure(path, "read"):
        return Reference(load_scene(path), shlex.quote(str(path)), load_other_codes)


@lru_cache(maxsize=1)
def _load_all_codes(folder: Path) -> dict[str, Shaped[Codes, "height width 3"]]:
    """Render all scenes of a folder, and read its reference pictures: codes by file name.

    Files that cannot be read are left out: the hand-ins that are compared with them get the error.
    """
    all_codes = {}
    for path in list_references(folder).values():
        with suppress(Failure):
            all_codes[path.name] = _load_reference.__wrapped__(path, None).codes
    return all_codes


def compare_hand_in(options: Options, hand_in: HandIn) -> Compared:
    """Compare a submitted picture with its reference.

    If they cannot be compared, no exception is raised, but the result contains the error.
    """
    picture_name = str(hand_in.picture) if hand_in.picture else None
    reference_name = str(hand_in.reference) if hand_in.reference else None
    result = Result(hand_in.student, hand_in.scene, picture_name, reference_name)
    # A missing picture has no path, so its student and its scene are named.
    missing_name = Path(hand_in.student, hand_in.scene) if hand_in.student else reference_name
    name_in_error = picture_name or str(missing_name)
    try:
        if hand_in.error or not (hand_in.picture and hand_in.reference):
            raise Failure(name_in_error, hand_in.error)
        with errors_as_failure(name_in_error, "compared", memory_remedy="compare a part"):
            return _compare_files(options, hand_in.picture, hand_in.reference, result)
    except Failure as failure:
        error = str(failure)
    except Exception as bug:
        problem = f"cannot be compared: {type(bug).__name__}: {bug}"
        error = str(Failure(name_in_error, problem, "this is a bug, please report it"))
    return Compared(result=result._replace(error=error), pair=None)


def _compare_files(
    options: Options, picture_path: Path, reference_path: Path, result: Result
) -> Compared:
    """Compare the files of two pictures, and complete the result, which so far only names them.

    If -o is given, also draw both pictures side by side.  In a class, this is done only for
    pictures that do not agree.  Raise Failure if a file cannot be read or written.
    """
    picture = read_picture(picture_path)
    folder = options.reference if options.reference.is_dir() else None
    reference = _load_reference(reference_path, folder)
    diagnosis = reference.diagnose(picture)
    if diagnosis.kind != IDENTICAL:
        notes = {"It": picture.note, reference_path.name: reference.picture.note}
        sentences = [f"{subject} {note}" for subject, note in notes.items() if note]
        diagnosis = diagnosis.prepend_text(" ".join(sentences))
    result = result._replace(diagnosis=diagnosis)
    difference = None
    if picture.codes.shape == reference.codes.shape:
        result, difference = _add_metrics(options, result, picture.codes, reference.codes)
        comparison_path = options.choose_comparison_path(picture_path)
        if comparison_path and not (options.is_class and result.agrees):
            titles = make_printable(picture_path.name), make_printable(reference_path.name)
            images = picture.codes, reference.codes
            _save_comparison(comparison_path, images, difference, titles)
            result = result._replace(comparison=str(comparison_path))
    has_page = options.html is not None
    pair = make_pair(result, picture.codes, reference.codes, difference) if has_page else None
    return Compared(result=result, pair=pair)


def _add_metrics(
    options: Options,
    result: Result,
    submitted_codes: Shaped[Codes, "height width 3"],
    reference_codes: Shaped[Codes, "height width 3"],
) -> tuple[Result, Shaped[Differences, "height width"]]:
    """Add the metrics, and whether the pictures agree, to a result that has a diagnosis.

    Return also the difference in linear light, positive where the submitted picture is brighter.
    """
    comparison = compare_codes(submitted_codes, reference_codes)
    if options.ssim is None and options.max is None:
        agrees = result.diagnosis is not None and result.diagnosis.kind in AGREEING_KINDS
    else:  # tolerances that are given replace the diagnosis
        is_similar = options.ssim is None or comparison.ssim >= options.ssim
        agrees = is_similar and (options.max is None or comparison.max <= options.max)
    result = result._replace(
        agrees=agrees,
        ssim=comparison.ssim,
        rmse=comparison.rmse,
        max=comparison.max,
        differing=int((submitted_codes != reference_codes).any(axis=2).sum()),
        worst=find_worst_pixel(submitted_codes, reference_codes),
    )
    return result, comparison.difference


def _save_comparison(
    path: Path,
    images: tuple[Shaped[Codes, "height width 3"], Shaped[Codes, "height width 3"]],
    difference: Shaped[Differences, "height width"],
    titles: tuple[str, str],
) -> None:
    """Write a comparison picture, creating its folder if necessary; raise Failure if it fails."""
    with errors_as_failure(path, "written", OUTPUT_REMEDY, error_types=(ValueError,)):
        path.parent.mkdir(parents=True, exist_ok=True)
        write_comparison(path, images, difference, titles)
