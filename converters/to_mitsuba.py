"""Convert scene files to scenes for Mitsuba 3, and render these.

python -m converters.to_mitsuba SCENE.xml ...            writes NAME.mitsuba.xml
python -m converters.to_mitsuba --render SCENE.xml ...   writes NAME.mitsuba.png and .exr

Each takes --flavour:
  stock  for the plain mitsuba command, in one file (default when converting). Its lights fall off
         with distance, and its highlights are similar, not the same
  exact  the same picture (default of --render), by small plugins of this project: loads with
         mitsuba.load_file after "import converters.plugins"

Converting needs no Mitsuba; --render needs it ("pip install .[reference]").
"""

# Mitsuba is imported where it is used, because converting does not need it.

from __future__ import annotations

from tracer.command.process import run

if __name__ == "__main__":
    run(__spec__.name)

import argparse
import os
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

from converters.mitsuba_xml import HEAD, ConversionError
from tracer.command.arguments import (
    CommandParser,
    choose_output_paths,
    file_name,
    make_output_folder,
    module_docstring,
    whole_number,
)
from tracer.command.failure import Failure, describe_cause, errors_as_failure
from tracer.command.process import FAILED, attempt, print_line
from tracer.files import atomic_file
from tracer.messages import printable

__all__ = ["add_scene_arguments", "choose_variant", "main"]
__all__ += ["mitsuba_errors_as_failure", "skip_converted"]

_FLAVOURS = "stock", "exact"


def main(arguments: Sequence[str] | None = None) -> int:
    """Convert or render all scenes that the command line names.

    Parameters
    ----------
    arguments : sequence of str, optional
        The command-line arguments; by default, those of the process.

    Returns
    -------
    status : int
        Exit status: 0, or `FAILED` (1) if any scene could not be read, converted or rendered, or a
        file could not be written.  The other scenes are processed nevertheless.

    Raises
    ------
    Failure
        If Mitsuba cannot run, or the output folder cannot be created.
    SystemExit
        If the arguments are wrong.
    """
    parser = _command_line_parser()
    options = parser.parse_args(arguments)
    process_scene, default_flavour, ending, paths_of = (
        (_render_file, "exact", ".mitsuba.png", _picture_paths)
        if options.render
        else (_convert_file, "stock", ".mitsuba.xml", lambda target: (target,))
    )
    options.flavour = options.flavour or default_flavour
    suffix = ending if options.flavour == default_flavour else f".{options.flavour}{ending}"
    scenes = skip_converted(options.scenes)
    # A path such as / has no name to replace; reading it fails later, with a clear message.
    default_paths = [str(scene.parent / f"{scene.stem}{suffix}") for scene in scenes]
    targets = choose_output_paths(
        parser, [*map(str, scenes)], options.output, default_paths, paths_of
    )
    if options.variant is not None and not options.render:
        parser.error("--variant is for --render; converting needs no Mitsuba")
    if options.render:
        choose_variant(options.variant)
    make_output_folder(options.output)
    results = [
        attempt(process_scene, scene, Path(target), options)
        for scene, target in zip(scenes, targets, strict=True)
    ]
    return FAILED if any(isinstance(result, Failure) for result in results) else 0


def choose_variant(variant: str | None, *, status: int = FAILED) -> None:
    """Set Mitsuba's variant, and print the variant with the reason for it.

    Parameters
    ----------
    variant : str or None
        The requested variant; None for the fastest that works on this machine.
    status : int
        Exit status of the command in case of failure.

    Raises
    ------
    Failure
        If Mitsuba cannot run, or the requested variant does not work on this machine.
    """
    try:
        import converters.rendering  # noqa: F401 (and all that it needs)
        from converters.variant import use_variant

        choice = use_variant(variant)
    except (ImportError, OSError) as error:
        is_missing = isinstance(error, ModuleNotFoundError)
        remedy = "install it with pip install -e '.[reference]'" if is_missing else ""
        raise Failure("", f"Mitsuba cannot run: {describe_cause(error)}", remedy, status) from error
    print_line(sys.stdout, f"Mitsuba variant {choice.variant}: {choice.reason}")


@contextmanager
def mitsuba_errors_as_failure(path: str | os.PathLike[str], action: str) -> Iterator[None]:
    """Convert errors of the converter and of Mitsuba, in a with block, to a `Failure`.

    Parameters
    ----------
    path : str or path-like
        The scene file, which the message names.
    action : str
        Participle for the message, such as "rendered": the file "cannot be rendered".

    Raises
    ------
    Failure
        If the block raises an error of the converter, of Mitsuba or of the file system.
    """
    with errors_as_failure(path, action, error_types=(ImportError, RuntimeError, ValueError)):
        try:
            yield
        except ConversionError as error:
            raise Failure(os.fspath(path), f"cannot be converted: {error}") from error


def skip_converted(paths: Sequence[str]) -> list[Path]:
    """Remove the paths of converted scenes from a list, and print a line for each removed path.

    The shell's pattern *.xml matches the results of earlier conversions, too.

    Parameters
    ----------
    paths : sequence of str
        Paths from the command line.

    Returns
    -------
    kept : list of Path
        The other paths, in the same order.  They include paths of files that cannot be read.
    """
    kept = []
    for path in paths:
        head = b""
        with suppress(OSError, ValueError):
            if Path(path).is_file():
                with Path(path).open("rb") as file:
                    head = file.read(len(HEAD))
        if head == HEAD.encode():
            print_line(sys.stdout, printable(f"{path}: skipped, because it is a converted scene"))
        else:
            kept.append(Path(path))
    return kept


def _picture_paths(target: str) -> tuple[Path, Path]:
    """Derive the paths of both files that a rendering writes from the output path.

    Parameters
    ----------
    target : str
        The output path.  A suffix .png or .exr is replaced; any other suffix is kept, so that
        room.v1 and room.v2 have different files.

    Returns
    -------
    png, exr : Paths
        One of them is `target` if it has the suffix .png or .exr.
    """
    path = Path(target)
    if path.suffix.lower() == ".exr":
        return path.with_suffix(".png"), path
    if path.suffix.lower() == ".png":
        return path, path.with_suffix(".exr")
    return Path(target + ".png"), Path(target + ".exr")


def add_scene_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments for scene files, output path and Mitsuba variant to a parser.

    Parameters
    ----------
    parser : argparse.ArgumentParser
        The parser, which is changed: it gets SCENE.xml, -o and --variant.
    """
    parser.add_argument("scenes", nargs="+", type=file_name, metavar="SCENE.xml")
    parser.add_argument(
        "-o",
        "--output",
        type=file_name,
        metavar="PATH",
        help="the file to write, or a folder for those of several scenes;"
        " a folder that ends in / is created if it is missing",
    )
    parser.add_argument(
        "--variant", help="Mitsuba's variant (default: the fastest that works on this machine)"
    )


def _command_line_parser() -> argparse.ArgumentParser:
    """Create the command-line parser of `python -m converters.to_mitsuba`."""
    parser = CommandParser(
        prog="python -m converters.to_mitsuba",
        description=module_docstring(__name__),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add_scene_arguments(parser)
    parser.add_argument("--flavour", choices=_FLAVOURS, help="see above")
    parser.add_argument(
        "--samples",
        type=whole_number(1),
        metavar="N",
        help="samples per pixel, which may be rounded up (default: 64 in the stock flavour; one,"
        " at the pixel's centre, in the exact flavour)",
    )
    parser.add_argument(
        "--render", action="store_true", help="render with Mitsuba: a PNG and an EXR"
    )
    return parser


def _convert_file(path: Path, target: Path, options: argparse.Namespace) -> None:
    """Convert one scene file, and print a line with the path of the result.

    Parameters
    ----------
    path : Path
        The scene file.
    target : Path
        The file to write.
    options : argparse.Namespace
        The parsed command line; `flavour` and `samples` are used.

    Raises
    ------
    Failure
        If the scene cannot be read or converted, or the result cannot be written.
    """
    from converters.flavours import convert
    from tracer import load_scene

    with errors_as_failure(path, "read", memory_remedy="split the scene"):
        scene = load_scene(path)
    with mitsuba_errors_as_failure(path, "converted"):
        text = convert(scene, options.flavour, options.samples)
    with (
        errors_as_failure(target, "written", "choose another with -o"),
        atomic_file(target, HEAD.encode()) as file,
    ):
        file.write(text.encode())
    print_line(sys.stdout, printable(f"{target}: {options.flavour} flavour"))


def _render_file(path: Path, target: Path, options: argparse.Namespace) -> None:
    """Render one scene file with Mitsuba to a PNG and an EXR, and print a line with their paths.

    Parameters
    ----------
    path : Path
        The scene file.
    target : Path
        Path of the PNG or of the EXR; the other picture is written beside it.
    options : argparse.Namespace
        The parsed command line; `flavour`, `samples` and `variant` are used.

    Raises
    ------
    Failure
        If the scene cannot be read, converted or rendered, or a picture cannot be written.
    """
    from converters.rendering import render_mitsuba, write_exr
    from tracer import load_scene, write_png

    with errors_as_failure(path, "read", memory_remedy="split the scene"):
        scene = load_scene(path)
    with mitsuba_errors_as_failure(path, "rendered"):
        image = render_mitsuba(scene, options.samples, options.variant, options.flavour)
    png, exr = _picture_paths(str(target))
    for picture, write in ((png, write_png), (exr, write_exr)):
        with errors_as_failure(picture, "written", "choose another with -o"):
            write(picture, image)
    height, width, _ = image.shape
    print_line(sys.stdout, printable(f"{png} and {exr.name}: {width} x {height}"))
