"""Arguments that several commands share: names of files, whole numbers, paths of results."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable, Iterable, Sequence
from typing import NoReturn

from tracer.command.failure import Failure, errors_as_failure, reason_of
from tracer.messages import printable

OTHER_NAME = "choose another with -o"
"""The remedy if a result cannot be written."""


class CommandParser(argparse.ArgumentParser):
    """A parser of arguments that explains how to write names that begin with "-"."""

    def error(self, message: str) -> NoReturn:
        """Print a message about wrong usage, and end the process with exit status 2."""
        if message.endswith("expected one argument"):
            message += "; a value that begins with - is joined to its option by ="
        for word in sys.argv[1:]:
            if word.startswith("-") and len(word) > 1 and os.path.lexists(word):
                message += printable(f"; for the file named {word}, write ./{word}")
        super().error(message)


def file_name(text: str) -> str:
    """Parse an argument that names a file or a folder."""
    if not text:
        raise argparse.ArgumentTypeError("the name is empty; name a file")
    return text


def whole_number(minimum: int) -> Callable[[str], int]:
    """Return a function that parses arguments: whole numbers from `minimum` to 999,999,999."""

    def parse(text: str) -> int:
        if not (text.isascii() and text.isdigit() and len(text) < 10 and int(text) >= minimum):
            rule = f"must be a whole number from {minimum} to 999999999"
            raise argparse.ArgumentTypeError(f"{rule}, is {text!r}")
        return int(text)

    return parse


def is_folder(path: str) -> bool:
    """Test whether a path names a folder: an existing one, or by a slash at the end."""
    return path.endswith(("/", os.sep)) or os.path.isdir(path)


def make_output_folder(output: str | None) -> None:
    """Create the folder that the option -o names, if it names a folder that is missing.

    Parameters
    ----------
    output : str or None
        The argument of the option.

    Raises
    ------
    Failure
        If the folder cannot be created, or something else has its name.
    """
    if output is not None and is_folder(output):
        with errors_as_failure(output, "written", OTHER_NAME):
            os.makedirs(output, exist_ok=True)


def real_path(path: str | os.PathLike[str], *, status: int = 1) -> str:
    """Return the absolute path of a file, with all links resolved.

    Raises
    ------
    Failure
        With this exit status, if the path is relative and the working folder is gone.
    """
    try:
        return os.path.realpath(path)
    except OSError as error:
        what = f"the working folder cannot be found: {reason_of(error)}"
        raise Failure("", what, "change to another", status) from error


def output_paths(
    parser: argparse.ArgumentParser,
    scenes: Sequence[str],
    output: str | None,
    default_paths: Sequence[str],
    files_of: Callable[[str], Iterable[str | os.PathLike[str]]] = lambda target: (target,),
) -> list[str]:
    """Choose the path of each scene's result.

    Parameters
    ----------
    parser : ArgumentParser
        Ends the process with exit status 2 if (1) several scenes have one file as their result, or
        (2) a result would replace a scene.
    scenes : sequence of str
        Paths of the scene files.
    output : str or None
        The argument of the option ``-o``: a file, or a folder for the results of several scenes.
    default_paths : sequence of str
        For each scene, the path of its result if there is no option ``-o``.  In the folder of
        ``-o``, a result has the last part of this path as its name.
    files_of : callable
        Returns all files that are written for a result, from the path of the result.

    Returns
    -------
    targets : list of str
        The path of each scene's result.

    Raises
    ------
    Failure
        If the working folder is gone.
    """
    if output is None:
        targets = list(default_paths)
    elif is_folder(output):
        targets = [os.path.join(output, os.path.basename(path)) for path in default_paths]
    elif len(scenes) == 1:
        targets = [output]
    else:
        rule = "several scenes need a folder; to have it made, end it in"
        parser.error(printable(f"-o {output}: {rule} {os.sep}"))
    inputs, scene_of = {real_path(scene) for scene in scenes}, dict[str, str]()
    for scene, target in zip(scenes, targets, strict=True):
        for path in files_of(target):
            absolute = real_path(path)
            if absolute in inputs:
                problem = f"this would replace a scene; {OTHER_NAME}"
                parser.error(printable(f"{path}: {problem}"))
            if absolute in scene_of:
                problem = f"{scene_of[absolute]} and {scene} would both be written there"
                parser.error(printable(f"{path}: {problem}; do them one by one"))
            scene_of[absolute] = scene
    return targets
