"""Compare pictures with the right ones, and say what is wrong with them.

    python -m reference.compare HAND-IN.png SCENE.xml
    python -m reference.compare HAND-INS/ SCENES/

On the right stands a scene file, which is drawn, a picture, or a folder of these.  The mistake is
named that draws the very hand-in, or where that differs is; with a picture in place of a scene,
only some of geometry and encoding can be drawn.  All pictures in a folder and its folders are
compared with the scenes of their names: NAME.png, NAME.xml.png and ID_NAME.png with NAME.xml.
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

from tqdm import tqdm

from reference.command import forbid_overwriting_inputs, parser
from reference.figures import figures, linear, write_comparison
from reference.handins.class_page import class_page, pair_of
from reference.handins.diagnosis import AGREEING, Solution, worst_pixel
from reference.handins.folders import HandIn, empty_folders, hand_ins, match
from reference.handins.results import MISSING, Result, csv_of, json_of, text_of
from reference.handins.workers import shared
from reference.page import Pair
from reference.pictures import UNREADABLE, read_picture, reason
from tracer import SceneFileError, load_scene
from tracer.command.arguments import file_name, is_folder
from tracer.command.process import print_line, print_result
from tracer.files import atomic_file
from tracer.messages import printable


def tolerance(text: str) -> float:
    """The type of a tolerance; argparse names it so where the text is no number."""
    if not (value := float(text)) >= 0:
        raise argparse.ArgumentTypeError(f"must be 0 or more, is {text}")
    return value


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit status."""
    used = parser("reference.compare", __doc__)
    add = used.add_argument
    add("a", metavar="HAND-IN", type=Path, help="the picture in question, or a folder")
    add("b", metavar="RIGHT", type=Path, help="a scene file, a picture, or a folder of these")
    add("--ssim", type=tolerance, metavar="S", help="least SSIM that is tolerated")
    add("--max", type=tolerance, metavar="M", help="largest linear difference that is tolerated")
    where = "write a comparison picture: a file, or a folder, which may end in /"
    add("-o", "--output", type=file_name, metavar="PATH", help=where)
    add("--html", type=file_name, metavar="OUT.html", help="write one page that shows all of them")
    form = used.add_mutually_exclusive_group()
    form.add_argument("--json", action="store_true", help="print a list with an object a picture")
    form.add_argument("--csv", action="store_true", help="print the same as a table")
    options = used.parse_args(arguments)
    for path in (options.a, options.b):
        if not path.exists():
            print_line(sys.stderr, printable(f"{path}: does not exist"))
            return 3
    options.many = options.a.is_dir()
    folder = options.a if options.many else options.a.parent
    pictures = hand_ins(folder) if options.many else [options.a]
    if not pictures:
        used.error(printable(f"{options.a}: holds no pictures"))
    if options.many and options.output and not is_folder(options.output):
        wrong = f"-o {options.output}: several pictures need a folder; end it in {os.sep}"
        used.error(printable(wrong))
    matched, nobodys = match(pictures, options.b)
    outputs = _outputs(options, folder, pictures) if options.output else [None] * len(pictures)
    rights = (hand_in.right for hand_in in matched if hand_in.right)
    page = Path(options.html) if options.html else None
    forbid_overwriting_inputs(used, filter(None, (*outputs, page)), (*pictures, *rights))
    # Hand-ins of one scene follow one another: what is drawn of it serves all of them.
    jobs = [hand_in._replace(output=output)
            for hand_in, output in zip(matched, outputs, strict=True)]  # fmt: skip
    jobs.sort(key=lambda hand_in: str(hand_in.right))
    judged = shared(partial(judge, options), jobs, lost)
    few = len(jobs) < 3 or sys.stderr is None
    judged = tqdm(judged, total=len(jobs), unit="picture", disable=few or None)
    found = sorted(judged, key=lambda one: str(one[0].picture))
    results = [result for result, _ in found]
    for path in nobodys:
        error = printable(f"{path}: nobody has handed in a picture of it")
        results.append(Result(None, str(path), kind=MISSING, error=error))
    for path in empty_folders(folder) if options.many else ():
        error = printable(f"{path}: holds no pictures")
        results.append(Result(str(path), None, kind=MISSING, error=error))
    unread = any(result.word == "unread" for result in results)
    try:
        where = printable(str(page))
        if page:
            pairs = {str(result.picture): pair for result, pair in found if pair}
            text = class_page(results, pairs, folder)
            page.parent.mkdir(parents=True, exist_ok=True)
            with atomic_file(page, b"<!doctype html>") as file:
                file.write(text.encode())
        where = "standard output"
        if options.json or options.csv:
            print_result(sys.stdout, (json_of if options.json else csv_of)(results))
        elif unread and not options.many:
            print_line(sys.stderr, text_of(results, many=False))
        else:
            print_result(sys.stdout, text_of(results, many=options.many))
    except OSError as error:
        print_line(sys.stderr, f"{where}: cannot be written: {error.strerror or error}")
        return 3
    return 3 if unread else int(not all(result.agrees for result in results))


def _outputs(options: argparse.Namespace, folder: Path, pictures: list[Path]) -> list[Path]:
    """Where the comparison of each picture goes; none to another's place."""
    if not options.many and not is_folder(options.output):
        return [Path(options.output)]
    below = [picture.relative_to(folder) for picture in pictures]
    return [Path(options.output, path.with_name(f"{path.name}.compare.png")) for path in below]


@lru_cache(maxsize=1)
def _solution(path: Path) -> tuple[Solution, str]:
    """The right picture of a file, and a note on what its format does to it."""
    if path.suffix.lower() == ".xml":
        return Solution(load_scene(path), shlex.quote(str(path))), ""
    picture = read_picture(path)
    return Solution(picture), picture.note


def lost(hand_in: HandIn) -> tuple[Result, None]:
    """The result of a picture whose process died."""
    reason = "cannot be compared: its process was ended; is memory short?"
    return _failed(hand_in, f"{hand_in.picture}: {reason}")


def _failed(hand_in: HandIn, error: str) -> tuple[Result, None]:
    right = str(hand_in.right) if hand_in.right else None
    return Result(str(hand_in.picture), right, error=printable(error)), None


def judge(options: argparse.Namespace, hand_in: HandIn) -> tuple[Result, Pair | None]:
    """Compare a picture; of many, a comparison is written only of those that differ."""
    picture, right, error, output = hand_in
    if right is None:
        return _failed(hand_in, f"{picture}: {error}")
    result, pair = Result(str(picture), str(right)), None
    where, what = picture, "read"
    try:
        a = read_picture(picture)
        where = right
        solution, note = _solution(right)
        where, what = picture, "compared"
        found, b = solution.diagnose(a), solution.codes
        notes = [f"{name} {n}" for name, n in (("It", a.note), (f"{right.name}", note)) if n]
        text = " ".join([*(() if found.kind == "identical" else notes), str(found)])
        result = result._replace(kind=found.kind, diagnosis=text)
        if a.codes.shape != b.shape:
            return result, None
        light = linear(a.codes), linear(b)
        distance = figures(*light)
        same = found.kind in AGREEING
        if options.ssim is not None or options.max is not None:
            same = (options.max is None or distance.max <= options.max) and (
                options.ssim is None or distance.ssim >= options.ssim
            )
        result = result._replace(
            agrees=same, ssim=distance.ssim, rmse=distance.rmse, max=distance.max,
            differing=int((a.codes != b).any(axis=2).sum()), worst=worst_pixel(a.codes, b),
        )  # fmt: skip
        if options.html:
            pair = pair_of(result, (a.codes, b), light)
        if output is not None and not (options.many and same):
            where, what = output, "written"
            output.parent.mkdir(parents=True, exist_ok=True)
            write_comparison(output, *light, (printable(picture.name), printable(right.name)))
            result = result._replace(comparison=str(output))
    except SceneFileError as fault:
        return result._replace(error=str(fault)), None
    except UNREADABLE as fault:
        why = reason(fault, "compare a part")
        return _failed(hand_in, f"{where}: cannot be {what}: {why}")
    return result, pair
