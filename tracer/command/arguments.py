"""Parse the arguments that several commands have in common: file names, numbers, result paths."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable, Iterable, Sequence
from typing import NoReturn

from tracer.command.failure import Failure, describe_cause, errors_as_failure
from tracer.messages import printable

OTHER_NAME = "choose another with -o"
"""Suggested fix for a result that cannot be written."""


def module_docstring(module: str) -> str:
    """Read the docstring of a module from its source, because `python -OO` does not keep it.

    Parameters
    ----------
    module : str
        Full name of a module that has been imported.

    Returns
    -------
    docstring : str
        The docstring; "" if the module has none.
    """
    import ast  # importing it takes milliseconds, which the tracer's own command does not need

    path = sys.modules[module].__file__
    with open(path or "", encoding="utf-8") as file:
        return ast.get_docstring(ast.parse(file.read())) or ""


class CommandParser(argparse.ArgumentParser):
    """A command-line parser whose error messages explain how to write names that begin with "-"."""

    def error(self, message: str) -> NoReturn:
        """Print a message about wrong usage, and end the process with exit status 2.

        Parameters
        ----------
        message : str
            What is wrong.  If names that begin with "-" may be the cause, a suggested fix is added.
        """
        if message.endswith("expected one argument"):
            message += "; a value that begins with - is joined to its option by ="
        for word in sys.argv[1:]:
            if word.startswith("-") and len(word) > 1 and os.path.lexists(word):
                message += printable(f"; for the file named {word}, write ./{word}")
        super().error(message)


def file_name(text: str) -> str:
    """Check a command-line argument that names a file or a folder.

    Parameters
    ----------
    text : str
        The argument.

    Returns
    -------
    name : str
        The same text.

    Raises
    ------
    argparse.ArgumentTypeError
        If the argument is empty.
    """
    if not text:
        raise argparse.ArgumentTypeError("the name is empty; name a file")
    return text


def whole_number(minimum: int) -> Callable[[str], int]:
    """Return a function that converts a command-line argument to a whole number.

    Parameters
    ----------
    minimum : int
        The smallest number that is accepted.  The largest is 999,999,999.

    Returns
    -------
    parse : callable
        Called with the text of the argument, it returns the number as an int, or raises
        argparse.ArgumentTypeError.
    """

    def parse(text: str) -> int:
        if not (text.isascii() and text.isdigit() and len(text) < 10 and int(text) >= minimum):
            rule = f"must be a whole number from {minimum} to 999999999"
            raise argparse.ArgumentTypeError(f"{rule}, is {text!r}")
        return int(text)

    return parse


def is_folder(path: str) -> bool:
    """Test whether a path names a folder.

    It does if it ends in a slash, or if there is a folder of this name.
    """
    return path.endswith(("/", os.sep)) or os.path.isdir(path)


def make_output_folder(output: str | None) -> None:
    """Create the folder for results if the option -o names a folder that does not exist.

    Parent folders are created, too.  If the option names a file, nothing is done.

    Parameters
    ----------
    output : str or None
        The argument of the option; None if the option is not given.

    Raises
    ------
    Failure
        If the folder cannot be created, for example because a file has its name.
    """
    if output is not None and is_folder(output):
        with errors_as_failure(output, "written", OTHER_NAME):
            os.makedirs(output, exist_ok=True)


def real_path(path: str | os.PathLike[str], *, status: int = 1) -> str:
    """Return the absolute path of a file, with all symbolic links resolved.

    Parameters
    ----------
    path : str or path-like
        The path of the file, which need not exist.
    status : int
        Exit status of the command if this function fails.

    Raises
    ------
    Failure
        If the path is relative, and the working folder has been deleted.
    """
    try:
        return os.path.realpath(path)
    except OSError as error:
        what = f"the working folder cannot be found: {describe_cause(error)}"
        raise Failure("", what, "change to another", status) from error


def choose_output_paths(
    parser: argparse.ArgumentParser,
    scenes: Sequence[str],
    output: str | None,
    default_paths: Sequence[str],
    files_of: Callable[[str], Iterable[str | os.PathLike[str]]] = lambda path: (path,),
) -> list[str]:
    """Choose the path of the result of each scene, so that no file is overwritten by mistake.

    If (1) two scenes would have the same file as their result, (2) a result would replace a scene,
    or (3) the results of several scenes cannot be one file, the parser prints an error and ends the
    process with exit status 2.

    Parameters
    ----------
    parser : ArgumentParser
        Its method `error` is called for wrong usage.
    scenes : sequence of str
        Paths of the scene files.
    output : str or None
        The argument of the option ``-o``: a file, or a folder for the results of several scenes.
        None if the option is not given.
    default_paths : sequence of str
        For each scene, the path of its result without the option ``-o``.  If that names a folder,
        the last part of this path is the name of the result in the folder.
    files_of : callable
        Called with the path of a result, it returns the paths of all files that are written for the
        result.  By default, that is the result alone.

    Returns
    -------
    result_paths : list of str
        The path of the result of each scene.

    Raises
    ------
    Failure
        If the working folder has been deleted.
    """
    if output is None:
        result_paths = list(default_paths)
    elif is_folder(output):
        result_paths = [os.path.join(output, os.path.basename(path)) for path in default_paths]
    elif len(scenes) == 1:
        result_paths = [output]
    else:
        rule = "several scenes need a folder; to have it made, end it in"
        parser.error(printable(f"-o {output}: {rule} {os.sep}"))
    scene_paths, scene_of_file = {real_path(scene) for scene in scenes}, dict[str, str]()
    for scene, result_path in zip(scenes, result_paths, strict=True):
        for path in files_of(result_path):
            absolute = real_path(path)
            if absolute in scene_paths:
                problem = f"this would replace a scene; {OTHER_NAME}"
                parser.error(printable(f"{path}: {problem}"))
            if absolute in scene_of_file:
                problem = f"{scene_of_file[absolute]} and {scene} would both be written there"
                parser.error(printable(f"{path}: {problem}; do them one by one"))
            scene_of_file[absolute] = scene
    return result_paths
