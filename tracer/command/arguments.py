"""Arguments that commands share: names of files, whole numbers, paths of results."""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable, Iterable, Sequence

from tracer.command.process import FAILED
from tracer.messages import printable


def file_name(text: str) -> str:
    """Parse an argument that names a file or a folder."""
    if not text:
        raise argparse.ArgumentTypeError("the name is empty; name a file")
    return text


def whole_number(least: int) -> Callable[[str], int]:
    """Make a parser of arguments that are whole numbers, `least` or more."""

    def number(text: str) -> int:
        if not (text.isascii() and text.isdigit() and len(text) < 10 and int(text) >= least):
            wanted = f"must be a whole number from {least} to 999999999"
            raise argparse.ArgumentTypeError(f"{wanted}, is {text!r}")
        return int(text)

    return number


def is_folder(path: str) -> bool:
    """Return whether a path names a folder, which need not exist yet."""
    return path.endswith(("/", os.sep)) or os.path.isdir(path)


def no_working_folder(error: OSError) -> str:
    """Make the message for a relative path whose working folder is gone."""
    return f"the working folder cannot be found: {error.strerror or error}; change to another"


def output_paths(
    parser: argparse.ArgumentParser,
    scenes: Sequence[str],
    output: str | None,
    beside: Sequence[str],
    files: Callable[[str], Iterable[str | os.PathLike[str]]] = lambda target: (target,),
) -> list[str]:
    """Choose the path of each scene's result: `output`, a file in the folder `output`, or `beside`.

    `files` lists all files that are written for a result's path.  The parser ends the process with
    status 2 if one of these would replace a scene or another result, and with status 1 if the
    working folder is gone.
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
        inputs, writers = {os.path.realpath(scene) for scene in scenes}, dict[str, str]()
        for scene, target in zip(scenes, found, strict=True):
            for path in files(target):
                real = os.path.realpath(path)
                if real in inputs:
                    wrong = "this would replace a scene; choose another with -o"
                    parser.error(printable(f"{path}: {wrong}"))
                if real in writers:
                    wrong = f"{writers[real]} and {scene} would both be written there"
                    parser.error(printable(f"{path}: {wrong}; do them one by one"))
                writers[real] = scene
    except OSError as error:
        parser.exit(FAILED, no_working_folder(error) + "\n")
    return found
