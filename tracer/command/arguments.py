"""Parse the arguments that several commands have in common: paths, numbers, and the option -o."""

from __future__ import annotations

import argparse
import os
import re
import sys
from collections.abc import Callable, Iterable, Sequence
from typing import NoReturn

from tracer.command.failure import errors_as_failure
from tracer.messages import make_printable

OUTPUT_REMEDY = "choose another with -o"
"""Suggested fix for a result that cannot be written."""


class CommandParser(argparse.ArgumentParser):
    """A command-line parser whose help is the docstring of a module that has been imported.

    `prog` is how users call the command; by default, ``python -m MODULE_NAME``.
    """

    def __init__(self, module_name: str, prog: str | None = None) -> None:
        formatter = argparse.RawDescriptionHelpFormatter
        super().__init__(prog=prog or f"python -m {module_name}", formatter_class=formatter)
        self._module_name = module_name

    def format_help(self) -> str:
        """Return the help text: usage, the module's docstring, and the options."""
        import ast  # only now, because the import takes milliseconds

        # Read the docstring from the source, because `python -OO` discards docstrings.
        with open(sys.modules[self._module_name].__file__ or "", encoding="utf-8") as file:
            self.description = ast.get_docstring(ast.parse(file.read()))
        return super().format_help()

    def error(self, message: str) -> NoReturn:
        """Print an error about wrong usage, and end the process with exit status 2.

        A suggested fix is added if an option seems to be misspelt, the value of an option begins
        with "-", or a file exists whose name begins with "-".
        """
        unknown = message.partition("unrecognized arguments: ")[2].split()
        message += "".join(map(self._suggest_option, unknown))
        if message.endswith("expected one argument"):
            message += "; if the value begins with -, write OPTION=VALUE"
        for argument in sys.argv[1:]:
            if argument.startswith("-") and len(argument) > 1 and os.path.lexists(argument):
                message += f"; for the file named {argument}, write ./{argument}"
        super().error(make_printable(message))

    def _suggest_option(self, argument: str) -> str:
        """Return the end of a message about an unknown option: "; did you mean --size?", or ""."""
        from difflib import get_close_matches  # only now, because the import takes milliseconds

        if not argument.startswith("--"):
            return ""
        matches = get_close_matches(argument.partition("=")[0], self._option_string_actions, n=1)
        return f"; did you mean {matches[0]}?" if matches else ""


def check_path(argument: str) -> str:
    """Return a path given on the command line; raise ArgumentTypeError if it is empty."""
    if not argument:
        raise argparse.ArgumentTypeError("the name is empty; name a file")
    return argument


def parse_positive_int(argument: str) -> int:
    """Convert one to nine ASCII digits, of which the first is not 0, to an integer.

    Raise ArgumentTypeError if the argument is anything else.
    """
    if not re.fullmatch("[1-9][0-9]{0,8}", argument):
        rule = "must be a whole number from 1 to 999999999"
        raise argparse.ArgumentTypeError(f"{rule}, not {argument!r}")
    return int(argument)


def is_folder(path: str) -> bool:
    """Test whether a path ends in a slash or names an existing folder."""
    return path.endswith(("/", os.sep)) or os.path.isdir(path)


def make_output_folder(output: str | None) -> None:
    """Create the folder that the option -o names, and its parent folders, if they are missing.

    Do nothing if the value of the option does not end in a slash, or is None because there is no
    option -o.  Raise Failure if the folder cannot be created, for example because a file of this
    name exists.
    """
    if output is not None and is_folder(output):
        with errors_as_failure(output, "written", OUTPUT_REMEDY):
            os.makedirs(output, exist_ok=True)


def resolve_path(path: str | os.PathLike[str], *, exit_status: int = 1) -> str:
    """Return the absolute path of a file, in which all symbolic links are resolved.

    The file need not exist.  Raise Failure, with the exit status, if the path is relative and the
    working folder has been deleted.
    """
    remedy = "change to another"
    with errors_as_failure("the working folder", "found", remedy, exit_status=exit_status):
        return os.path.realpath(path)


def choose_output_paths(
    parser: CommandParser,
    scenes: Sequence[str],
    output: str | None,
    default_paths: Sequence[str],
    list_files: Callable[[str], Iterable[str | os.PathLike[str]]] = lambda path: (path,),
) -> list[str]:
    """Choose the path of each scene's result, and return the paths in the order of the scenes.

    Call `parser.error`, which ends the process, if a result would replace a scene or the result of
    another scene, or if `output` is a file but there are several scenes.  Raise Failure if the
    working folder has been deleted.

    Parameters
    ----------
    output
        The value of the option -o: a file, or a folder for the results of several scenes.  None if
        the option was not given.
    default_paths
        For each scene, the path of its result if the option -o was not given.  If the option names
        a folder, only the file name of this path is used.
    list_files
        Takes the path of a result, and returns the paths of all files of the result.  By default,
        a result is a single file.
    """
    if output is None:
        result_paths = list(default_paths)
    elif is_folder(output):
        result_paths = [os.path.join(output, os.path.basename(path)) for path in default_paths]
    elif len(scenes) == 1:
        result_paths = [output]
    else:
        parser.error(
            f"-o {output}: several scenes need a folder; to have it made, end it in {os.sep}"
        )
    _refuse_to_replace_files(parser, scenes, result_paths, list_files)
    return result_paths


def _refuse_to_replace_files(
    parser: CommandParser,
    scenes: Sequence[str],
    result_paths: Sequence[str],
    list_files: Callable[[str], Iterable[str | os.PathLike[str]]],
) -> None:
    """Call `parser.error` if a result would replace a scene or another scene's result.

    Raise Failure if the working folder has been deleted.
    """
    scene_paths = {resolve_path(scene) for scene in scenes}
    scene_of_file = dict[str, str]()
    for scene, result_path in zip(scenes, result_paths, strict=True):
        for path in list_files(result_path):
            absolute_path = resolve_path(path)
            if absolute_path in scene_paths:
                parser.error(f"{path}: this would replace a scene; {OUTPUT_REMEDY}")
            if absolute_path in scene_of_file:
                both_scenes = f"{scene_of_file[absolute_path]} and {scene}"
                parser.error(
                    f"{path}: {both_scenes} would both be written there; process them one by one"
                )
            scene_of_file[absolute_path] = scene
