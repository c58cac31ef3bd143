"""Name the folders that the commands in this folder share, and parse their command lines."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from tracer.command.arguments import OUTPUT_REMEDY, CommandParser, resolve_path
from tracer.command.process import MISUSED

REFERENCE_FOLDER = Path(__file__).resolve().parent
SCENES = REFERENCE_FOLDER.parent / "scenes"
BUILD = REFERENCE_FOLDER.parent / "build"
"""Folder for generated files; not under version control."""
FAILED_STATUS = 3
"""Exit status of `compare` and `certify` if a file cannot be read, processed or written."""


def list_scene_files() -> list[Path]:
    """List this project's scene files in sorted order, without converted Mitsuba scenes."""
    return sorted(path for path in SCENES.glob("*.xml") if not path.name.endswith(".mitsuba.xml"))


def build_path(name: str) -> Path:
    """Return the path of a file in the build folder, creating the folder if necessary."""
    BUILD.mkdir(exist_ok=True)
    return BUILD / name


def make_parser(module: str, quick_help: str | None = None) -> CommandParser:
    """Create a command-line parser for ``python -m MODULE``, whose help is the module's docstring.

    `quick_help` says what the option ``--quick`` reduces; if it is None, there is no such option.
    """
    parser = CommandParser(module)
    if quick_help:
        parser.add_argument("--quick", action="store_true", help=f"{quick_help}; write to build/")
    return parser


def forbid_overwriting_inputs(
    command_parser: CommandParser, output_paths: Iterable[Path], input_paths: Iterable[Path]
) -> None:
    """Exit with a usage error (status 2) if a command would overwrite one of its input files.

    Paths that lead to the same file through symbolic links count as equal.  Raise Failure if a path
    is relative, and the working folder has been deleted.
    """
    real_input_paths = {resolve_path(path, exit_status=MISUSED) for path in input_paths}
    for path in output_paths:
        if resolve_path(path, exit_status=MISUSED) in real_input_paths:
            command_parser.error(f"{path}: this would replace an input; {OUTPUT_REMEDY}")
