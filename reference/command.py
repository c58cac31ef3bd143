"""Paths of files, and functions for the command line, that the commands of this folder share."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from tracer.command.arguments import OTHER_NAME, CommandParser, real_path
from tracer.command.process import MISUSED

HERE = Path(__file__).resolve().parent
SCENES = HERE.parent / "scenes"
BUILD = HERE.parent / "build"
"""Folder for files that can be generated again; not under version control."""
FAILED_STATUS = 3
"""Exit status of `compare` and `certify` if a file cannot be read, processed or written."""


def own_scenes() -> list[Path]:
    """Return the sorted paths of this project's scene files, without converted Mitsuba scenes."""
    return sorted(p for p in SCENES.glob("*.xml") if not p.name.endswith(".mitsuba.xml"))


def build_path(name: str) -> Path:
    """Return the path of a file in the build folder, which is created if it does not exist."""
    BUILD.mkdir(exist_ok=True)
    return BUILD / name


def make_parser(module: str, quick: str | None = None) -> CommandParser:
    """Create a command-line parser whose help text is the docstring of a module.

    Parameters
    ----------
    module : str
        Full name of the module, which is run by ``python -m module``.
    quick : str, optional
        Help text of an option ``--quick``.  By default, the parser does not have this option.

    Returns
    -------
    parser : CommandParser
        A parser without arguments, apart from ``--quick``; the caller adds them.
    """
    parser = CommandParser(module)
    if quick:
        parser.add_argument("--quick", action="store_true", help=f"{quick}; write to build/")
    return parser


def forbid_overwriting_inputs(
    command_parser: CommandParser, outputs: Iterable[Path], inputs: Iterable[Path]
) -> None:
    """Reject a command line on which an output file is also an input file.

    Symbolic links are resolved before paths are compared.

    Parameters
    ----------
    command_parser : CommandParser
        The parser, which prints an error message, and ends the process with exit status 2.
    outputs : iterable of Path
        Files that the command will write.
    inputs : iterable of Path
        Files that the command will read.

    Raises
    ------
    SystemExit
        If an output file is also an input file.
    Failure
        If a path is relative, and the working folder has been deleted.
    """
    input_paths = {real_path(path, status=MISUSED) for path in inputs}
    for output in outputs:
        if real_path(output, status=MISUSED) in input_paths:
            command_parser.error(f"{output}: this would replace an input; {OTHER_NAME}")
