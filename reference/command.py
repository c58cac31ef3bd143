"""Locations of files, and parts of the command line, that the commands of this folder share."""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from pathlib import Path

from tracer.command.arguments import CommandParser, module_docstring, real_path
from tracer.command.process import MISUSED
from tracer.messages import printable

HERE = Path(__file__).resolve().parent
SCENES = HERE.parent / "scenes"
BUILD = HERE.parent / "build"
"""Folder for files that can be generated again; not under version control."""


def own_scenes() -> list[Path]:
    """List the paths of this project's scene files, sorted, without those converted for Mitsuba."""
    return sorted(p for p in SCENES.glob("*.xml") if not p.name.endswith(".mitsuba.xml"))


def build_path(name: str) -> Path:
    """Return the path of a file in the build folder, and create the folder if needed."""
    BUILD.mkdir(exist_ok=True)
    return BUILD / name


def make_parser(module: str, quick: str | None = None) -> argparse.ArgumentParser:
    """Make a command-line parser whose help is the docstring of a module.

    Parameters
    ----------
    module : str
        Full name of the module, which is run by `python -m module`.
    quick : str, optional
        Description of the option `--quick` for the help.  Without it, the option does not exist.

    Returns
    -------
    parser : ArgumentParser
        The parser, to which arguments can be added.
    """
    new_parser = CommandParser(
        prog=f"python -m {module}",
        description=module_docstring(module),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    if quick:
        new_parser.add_argument("--quick", action="store_true", help=f"{quick}; write to build/")
    return new_parser


def forbid_overwriting_inputs(
    command_parser: argparse.ArgumentParser, outputs: Iterable[Path], inputs: Iterable[Path]
) -> None:
    """End the process with an error message if an output file is also an input file.

    Files are the same if their resolved paths are equal.

    Parameters
    ----------
    command_parser : ArgumentParser
        Prints the message, and ends the process with exit status 2.
    outputs, inputs : iterable of Path
        Files to write, and files to read.

    Raises
    ------
    Failure
        If a path is relative and the current folder has been deleted.
    """
    sources = {real_path(path, status=MISUSED) for path in inputs}
    for output in outputs:
        if real_path(output, status=MISUSED) in sources:
            message = f"{output}: this would replace an input; choose another with -o"
            command_parser.error(printable(message))
