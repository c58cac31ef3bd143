"""Compare pictures with the right ones, and say what is wrong with them.

    python -m reference.compare HAND-IN.png SCENE.xml
    python -m reference.compare HAND-INS/ SCENES/

On the right stands a scene file, which is drawn, a picture, or a folder of these.  With a scene,
the mistake is named that draws the very hand-in, or where that differs is; with a picture,
only geometry and encoding are.  All pictures in a folder and its folders are compared with the
scenes of their names: NAME.png, NAME.xml.png and ID_NAME.png with NAME.xml.  Exit status: 0 if
all agree, or are within the tolerances; 1 if some do not, or are missing; 2 for wrong usage; 3 if
some cannot be compared.
"""

from __future__ import annotations

from tracer.command.process import run

if __name__ == "__main__":
    run(__spec__.name)

import argparse
import os
import shlex
import sys
from collections import Counter
from collections.abc import Callable, Sequence
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

from PIL import UnidentifiedImageError
from tqdm import tqdm

from reference.command import parser, spare_inputs
from reference.figures import figures, linear, write_comparison
from reference.handins.alignment import Codes, Diagnosis
from reference.handins.class_page import class_page, pair_of
from reference.handins.diagnosis import SceneDiagnosis
from reference.handins.page import Pair
from reference.handins.pictures import AGREEING, compare_pictures, worst_pixel
from reference.handins.reading import (
    UNREADABLE,
    HandIn,
    Picture,
    empty_folders,
    hand_ins,
    match,
    read_picture,
)
from reference.handins.results import MISSING, Result, csv_of, json_of, text_of
from reference.handins.workers import shared
from tracer import SceneFileError, load_scene
from tracer.command.arguments import file_name, is_folder
from tracer.command.process import print_line, print_result
from tracer.files import atomic_file
from tracer.messages import printable

__all__ = ["main"]


class Job(NamedTuple):
    """A hand-in to be judged, where its comparison goes, and what is tolerated."""

    hand_in: HandIn
    output: Path | None
    many: bool
    ssim: float | None
    max: float | None
    html: bool
    """Whether its pictures are to be shown in a page."""


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
    many = options.a.is_dir()
    pictures = hand_ins(options.a) if many else [options.a]
    if not pictures:
        used.error(printable(f"{options.a}: holds no pictures"))
    if many and options.output is not None and not is_folder(options.output):
        wrong = f"-o {options.output}: several pictures need a folder; end it in {os.sep}"
        used.error(printable(wrong))
    matched, nobodys = match(pictures, options.b)
    outputs = _outputs(options, pictures) if options.output else [None] * len(pictures)
    pages = [Path(options.html)] if options.html else []
    rights = (hand_in.right for hand_in in matched if hand_in.right)
    spare_inputs(used, (*filter(None, outputs), *pages), (*pictures, *rights))
    jobs = [Job(hand_in, output, many, options.ssim, options.max, bool(pages))
            for hand_in, output in zip(matched, outputs, strict=True)]  # fmt: skip
    # Hand-ins of one scene follow one another: what is drawn of it serves all of them.
    jobs.sort(key=lambda job: (str(job.hand_in.right), str(job.hand_in.picture)))
    few = len(jobs) < 3 or sys.stderr is None
    judged = [
        *tqdm(shared(judge, jobs, lost), total=len(jobs), unit="picture", disable=few or None)
    ]
    pairs = {str(result.picture): pair for result, pair in judged if pair}
    results = sorted((result for result, _ in judged), key=lambda result: str(result.picture))
    results += [_missing(None, path, f"{path}: nobody has handed in a picture of it")
                for path in nobodys]  # fmt: skip
    results += [_missing(path, None, f"{path}: holds no pictures")
                for path in (empty_folders(options.a) if many else ())]  # fmt: skip
    unread = any(result.word == "unread" for result in results)
    try:
        where = printable(str(options.html))
        for path in pages:
            text = class_page(results, pairs, options.a if many else options.a.parent)
            path.parent.mkdir(parents=True, exist_ok=True)
            with atomic_file(path, b"<!doctype html>") as file:
                file.write(text.encode())
        where = "standard output"
        if options.json or options.csv:
            print_result(sys.stdout, (json_of if options.json else csv_of)(results))
        elif unread and not many:
            print_line(sys.stderr, text_of(results, many=False))
        else:
            print_result(sys.stdout, text_of(results, many=many))
    except OSError as error:
        print_line(sys.stderr, f"{where}: cannot be written: {error.strerror or error}")
        return 3
    return 3 if unread else int(not all(result.agrees for result in results))


def _missing(picture: Path | None, right: Path | None, error: str) -> Result:
    a, b = (None if path is None else str(path) for path in (picture, right))
    return Result(a, b, kind=MISSING, error=printable(error))


def _outputs(options: argparse.Namespace, pictures: list[Path]) -> list[Path]:
    """Where the comparison of each picture goes; none to another's place."""
    many = options.a.is_dir()
    if not many and not is_folder(options.output):
        return [Path(options.output)]
    above, outputs = options.a if many else options.a.parent, []
    taken = Counter(picture.with_suffix("") for picture in pictures)  # a.png and a.jpg
    for picture in pictures:
        name = picture.stem if taken[picture.with_suffix("")] == 1 else picture.name
        folder = Path(options.output, picture.parent.relative_to(above))
        outputs.append(folder / f"{name}.compare.png")
    return outputs


@lru_cache(maxsize=4)
def _right(path: Path) -> tuple[Codes, Callable[[Picture], Diagnosis], Picture | None]:
    """The right picture, what names how another differs from it, and how it was read."""
    if path.suffix.lower() == ".xml":
        scene = SceneDiagnosis(load_scene(path), shlex.quote(str(path)))
        return scene.right, scene.diagnose, None
    picture = read_picture(path)

    def diagnose(other: Picture) -> Diagnosis:
        lossy = bool(picture.lossy or other.lossy)
        return compare_pictures(other.codes, picture.codes, lossy=lossy)

    return picture.codes, diagnose, picture


def lost(job: Job) -> tuple[Result, None]:
    """The result of a picture whose process died."""
    picture, right, _ = job.hand_in
    error = printable(f"{picture}: cannot be compared: its process was ended; is memory short?")
    return Result(str(picture), str(right), error=error), None


def judge(job: Job) -> tuple[Result, Pair | None]:
    """Compare a picture; of many, a comparison is written only of those that differ."""
    pair = None
    picture, right, error = job.hand_in
    result = Result(str(picture), None if right is None else str(right))
    if right is None:
        return result._replace(error=printable(f"{picture}: {error}")), None
    where, what = picture, "read"
    try:
        a = read_picture(picture)
        where = right
        b, diagnose, other = _right(right)
        where, what = picture, "compared"
        found = diagnose(a)
        notes = [f"{n} {p.note}" for n, p in zip("AB", (a, other), strict=True) if p and p.note]
        text = " ".join([*(() if found.kind == "identical" else notes), found.text])
        result = result._replace(kind=found.kind, diagnosis=text)
        if a.codes.shape != b.shape:
            return result, None
        light = linear(a.codes), linear(b)
        distance = figures(*light)
        same = found.kind in AGREEING
        if job.ssim is not None or job.max is not None:
            same = (job.max is None or distance.max <= job.max) and (
                job.ssim is None or distance.ssim >= job.ssim
            )
        result = result._replace(
            agrees=same, ssim=distance.ssim, rmse=distance.rmse, max=distance.max,
            differing=int((a.codes != b).any(axis=2).sum()), worst=worst_pixel(a.codes, b),
        )  # fmt: skip
        if job.html:
            pair = pair_of(result, (a.codes, b), light)
        if job.output is not None and not (job.many and same):
            where, what = job.output, "written"
            job.output.parent.mkdir(parents=True, exist_ok=True)
            write_comparison(job.output, *light, (printable(picture.name), printable(right.name)))
            result = result._replace(comparison=str(job.output))
    except SceneFileError as fault:
        return result._replace(error=str(fault)), None
    except UNREADABLE as fault:
        reason = getattr(fault, "strerror", None) or fault
        if isinstance(fault, MemoryError):
            reason = "not enough memory; compare a part"
        elif isinstance(fault, UnidentifiedImageError):
            reason = "not a picture in a format that is known"
        return result._replace(error=printable(f"{where}: cannot be {what}: {reason}")), None
    return result, pair
