"""Turn scene files into Mitsuba 3 scenes, and render these.

python -m converters.to_mitsuba SCENE.xml ...            writes NAME.mitsuba.xml
python -m converters.to_mitsuba --render SCENE.xml ...   writes NAME.mitsuba.png and .exr

Each takes --flavour:
  stock  for the plain mitsuba command, in one file (default when converting). Its lights fall off
         with distance, and its highlights are similar, not the same
  exact  the same picture (default of --render), by small plugins of this project: loads with
         mitsuba.load_file after "import converters.plugins"

Converting needs no Mitsuba; --render needs it ("pip install .[reference]").
"""

# Mitsuba is imported where it is used: converting needs none.

from __future__ import annotations

from tracer.command.process import run

if __name__ == "__main__":
    run(__spec__.name)

import argparse
import os
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TypeVar

from converters.mitsuba_xml import WRITTEN
from tracer.command.arguments import CommandParser, file_name, is_folder, output_paths, whole_number
from tracer.command.process import print_line
from tracer.files import atomic_file
from tracer.messages import printable

__all__ = ["TROUBLE", "add_scenes", "describe_error", "guarded", "main", "ready"]
__all__ += ["without_converted"]

_FLAVOURS = "stock", "exact"

TROUBLE = (ChildProcessError, ImportError, MemoryError, RuntimeError, ValueError)
"""What the reader, the tracer, the converter and Mitsuba raise over a scene."""

_Result = TypeVar("_Result")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line.

    Returns 0, or 1 where a scene could not be read or a file not be written.  Exits with 2 for
    wrong usage, 1 in a folder that is gone, 0 for ``--help``.
    """
    parser = _parser()
    options = parser.parse_args(arguments)
    if options.check:
        parser.error("to compare is a command of its own: python -m reference.check SCENE.xml ...")
    work, usual, ending, files = (
        (_render, "exact", ".mitsuba.png", _png_and_exr)
        if options.render
        else (_convert, "stock", ".mitsuba.xml", lambda target: (target,))
    )
    options.flavour = options.flavour or usual
    suffix = ending if options.flavour == usual else f".{options.flavour}{ending}"
    scenes = without_converted(options.scenes)
    # A path such as / has no name to replace; reading it will fail later, with a clear message.
    beside = [str(scene.parent / f"{scene.stem}{suffix}") for scene in scenes]
    found = output_paths(parser, [*map(str, scenes)], options.output, beside, files)
    if options.variant is not None and not options.render:
        parser.error("--variant is for --render; converting needs no Mitsuba")
    try:
        if options.render and not ready(options):
            return 1
        pairs = zip(scenes, found, strict=True)
        done = [guarded(work, scene, Path(target), options) for scene, target in pairs]
    except ModuleNotFoundError as error:  # that converting needs
        print_line(sys.stderr, f"{error}; install it with pip install -e .")
        return 1
    return 0 if all(done) else 1


def ready(options: argparse.Namespace) -> bool:
    """Choose Mitsuba's variant; say which it is, or why there is none."""
    try:
        import converters.rendering  # noqa: F401 (and all that it needs)
        from converters.variant import use

        choice = use(options.variant)
    except (ImportError, OSError) as error:
        missing = isinstance(error, ModuleNotFoundError)
        remedy = "; install it with pip install -e '.[reference]'" if missing else ""
        print_line(sys.stderr, printable(f"Mitsuba cannot run: {error}{remedy}"))
        return False
    print_line(sys.stdout, f"Mitsuba variant {choice.variant}: {choice.reason}")
    return True


def without_converted(scenes: Sequence[str]) -> list[Path]:
    """Leave out this command's own output, which *.xml matches too; print a line for each."""
    kept = []
    for scene in scenes:
        written = b""
        with suppress(OSError, ValueError):
            if Path(scene).is_file():
                with Path(scene).open("rb") as file:
                    written = file.read(len(WRITTEN))
        if written == WRITTEN.encode():
            print_line(sys.stdout, printable(f"{scene}: left out, for it is a converted scene"))
        else:
            kept.append(Path(scene))
    return kept


def _png_and_exr(target: str) -> tuple[Path, Path]:
    """Choose the paths of both files; -o may name either.

    Only the suffix of a picture is replaced: room.v1 and room.v2 get files of their own.
    """
    path = Path(target)
    if path.suffix.lower() == ".exr":
        return path.with_suffix(".png"), path
    if path.suffix.lower() == ".png":
        return path, path.with_suffix(".exr")
    return Path(target + ".png"), Path(target + ".exr")


def add_scenes(parser: argparse.ArgumentParser) -> None:
    """Let a command take scenes, where to write, and Mitsuba's variant."""
    parser.add_argument("scenes", nargs="+", type=file_name, metavar="SCENE.xml")
    parser.add_argument(
        "-o",
        "--output",
        type=file_name,
        metavar="PATH",
        help="the file to write, or a folder for those of several scenes;"
        " a folder that ends in / is made if it is missing",
    )
    parser.add_argument(
        "--variant", help="Mitsuba's variant (default: the fastest that works on this machine)"
    )


def _parser() -> argparse.ArgumentParser:
    parser = CommandParser(
        prog="python -m converters.to_mitsuba",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add_scenes(parser)
    parser.add_argument("--flavour", choices=_FLAVOURS, help="see above")
    parser.add_argument(
        "--samples",
        type=whole_number(1),
        metavar="N",
        help="samples a pixel, which may be rounded up (default: 64 in the stock flavour, the"
        " pixel's centre in the exact)",
    )
    parser.add_argument(
        "--render", action="store_true", help="render with Mitsuba: a PNG and an EXR"
    )
    parser.add_argument("--check", action="store_true", help=argparse.SUPPRESS)
    return parser


def guarded(
    work: Callable[[Path, Path, argparse.Namespace], _Result],
    scene: Path,
    target: Path,
    options: argparse.Namespace,
) -> _Result | None:
    """Do one scene; print a line for each fault, and return nothing then."""
    try:
        if options.output is not None and is_folder(options.output):
            target.parent.mkdir(parents=True, exist_ok=True)
        return work(scene, target, options)
    except TROUBLE as error:
        print_line(sys.stderr, describe_error(scene, error))
    except OSError as error:
        _print_unwritten(target, error)
    return None


def describe_error(path: str | os.PathLike[str], error: BaseException) -> str:
    """Describe an error in the scene file at `path`: a line, or one for each fault."""
    from tracer import SceneFileError

    if isinstance(error, SceneFileError):
        return str(error)
    # drjit hides the cause behind a RuntimeError.
    while isinstance(error, RuntimeError) and error.__cause__ is not None:
        error = error.__cause__
    if isinstance(error, (ChildProcessError, MemoryError)):  # the system kills who takes too much
        reason = "not enough memory; make the image smaller"
    else:
        reason = " ".join(str(error).split()) or type(error).__name__
    return printable(f"{os.fspath(path)}: {reason}")


def _print_unwritten(path: Path, error: OSError) -> None:
    """Print that a file cannot be written, and why, to standard error."""
    print_line(sys.stderr, printable(f"{path}: cannot be written: {error.strerror or error}"))


def _convert(path: Path, target: Path, options: argparse.Namespace) -> bool:
    from converters.flavours import convert
    from tracer import load_scene

    text = convert(load_scene(path), options.flavour, options.samples)
    with atomic_file(target, WRITTEN.encode()) as file:
        file.write(text.encode())
    print_line(sys.stdout, printable(f"{target}: {options.flavour} flavour"))
    return True


def _render(path: Path, target: Path, options: argparse.Namespace) -> bool:
    from converters.rendering import render_mitsuba, write_exr
    from tracer import load_scene, write_png

    image = render_mitsuba(load_scene(path), options.samples, options.variant, options.flavour)
    png, exr = _png_and_exr(str(target))
    for written, write in ((png, write_png), (exr, write_exr)):
        try:
            write(written, image)
        except OSError as error:
            _print_unwritten(written, error)
            return False
    height, width, _ = image.shape
    print_line(sys.stdout, printable(f"{png} and {exr.name}: {width} x {height}"))
    return True
