"""Arguments that commands share: names of files, whole numbers, where results go."""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable, Iterable, Sequence

from tracer.command.process import FAILED
from tracer.messages import printable


def file_name(text: str) -> str:
    """Type of an argument that names a file or a folder."""
    if not text:
        raise argparse.ArgumentTypeError("the name is empty; name a file")
    return text


def whole_number(least: int) -> Callable[[str], int]:
    """Type of an argument that is a whole number, `least` or more."""

    def number(text: str) -> int:
        if not (text.isascii() and text.isdigit() and len(text) < 10 and int(text) >= least):
            wanted = f"must be a whole number from {least} to 999999999"
            raise argparse.ArgumentTypeError(f"{wanted}, is {text!r}")
        return int(text)

    return number


def is_folder(path: str) -> bool:
    """Whether results are to be written to a folder of this name, which need not exist yet."""
    return path.endswith(("/", os.sep)) or os.path.isdir(path)


def no_working_folder(error: OSError) -> str:
    """Message for a path that cannot be resolved: the folder that it starts from is gone."""
    return f"the working folder cannot be found: {error.strerror or error}; change to another"


def output_paths(
    parser: argparse.ArgumentParser,
    scenes: Sequence[str],
    output: str | None,
    beside: Sequence[str],
    files: Callable[[str], Iterable[str | os.PathLike[str]]] = lambda target: (target,),
) -> list[str]:
    """Choose where each scene's result goes: to `output`, a file or a folder, or `beside` it.

    `files` returns all that is written for a result's path.  The parser ends the process with
    status 2 where one of these would replace a scene or another result, and with 1 in a working
    folder that is gone.
    """
    if output is None:
        found = list(beside)
    elif is_folder(output):
        found = [os.path.join(output, os.path.basename(path)) for path in beside]
    elif len(scenes) == 1:
        found = [output]
    else:
        wrong = "several scenes need a folder; to have it made, end it in"
        parser.error(printable(f"-o {output}: {wrong} {os.sep}"))
    try:
        inputs, taken = {os.path.realpath(scene) for scene in scenes}, dict[str, str]()
        for scene, target in zip(scenes, found, strict=True):
            for path in files(target):
                place = os.path.realpath(path)
                if place in inputs:
                    wrong = "this would replace a scene; choose another with -o"
                    parser.error(printable(f"{path}: {wrong}"))
                if place in taken:
                    wrong = f"{taken[place]} and {scene} would both be written there"
                    parser.error(printable(f"{path}: {wrong}; do them one by one"))
                taken[place] = scene
    except OSError as error:
        parser.exit(FAILED, no_working_folder(error) + "\n")
    return found
