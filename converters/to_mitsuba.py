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
    file_name,
    make_output_folder,
    module_docstring,
    output_paths,
    whole_number,
)
from tracer.command.failure import Failure, errors_as_failure, reason_of
from tracer.command.process import FAILED, attempt, print_line
from tracer.files import atomic_file
from tracer.messages import printable

__all__ = ["add_scene_arguments", "choose_variant", "main"]
__all__ += ["mitsuba_errors_as_failure", "without_converted"]

_FLAVOURS = "stock", "exact"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line.

    Returns
    -------
    status : int
        0, or 1 if a scene cannot be read, converted or rendered, or a file not be written.

    Raises
    ------
    Failure
        If Mitsuba cannot run, or the folder of the results cannot be made.
    """
    parser = _parser()
    options = parser.parse_args(arguments)
    process, default_flavour, ending, files_of = (
        (_render, "exact", ".mitsuba.png", _png_and_exr)
        if options.render
        else (_convert, "stock", ".mitsuba.xml", lambda target: (target,))
    )
    options.flavour = options.flavour or default_flavour
    suffix = ending if options.flavour == default_flavour else f".{options.flavour}{ending}"
    scenes = without_converted(options.scenes)
    # A path such as / has no name to replace; reading it fails later, with a clear message.
    default_paths = [str(scene.parent / f"{scene.stem}{suffix}") for scene in scenes]
    targets = output_paths(parser, [*map(str, scenes)], options.output, default_paths, files_of)
    if options.variant is not None and not options.render:
        parser.error("--variant is for --render; converting needs no Mitsuba")
    if options.render:
        choose_variant(options.variant)
    make_output_folder(options.output)
    results = [
        attempt(process, scene, Path(target), options)
        for scene, target in zip(scenes, targets, strict=True)
    ]
    return FAILED if any(isinstance(result, Failure) for result in results) else 0


def choose_variant(variant: str | None, *, status: int = FAILED) -> None:
    """Set Mitsuba's variant, and print which it is and why.

    Raises
    ------
    Failure
        With this exit status, if Mitsuba cannot run or the variant does not work here.
    """
    try:
        import converters.rendering  # noqa: F401 (and all that it needs)
        from converters.variant import use

        choice = use(variant)
    except (ImportError, OSError) as error:
        is_missing = isinstance(error, ModuleNotFoundError)
        remedy = "install it with pip install -e '.[reference]'" if is_missing else ""
        raise Failure("", f"Mitsuba cannot run: {reason_of(error)}", remedy, status) from error
    print_line(sys.stdout, f"Mitsuba variant {choice.variant}: {choice.reason}")


@contextmanager
def mitsuba_errors_as_failure(path: str | os.PathLike[str], action: str) -> Iterator[None]:
    """Raise a Failure in place of what the converter or Mitsuba raises in a with block.

    Parameters
    ----------
    path : str or path-like
        The scene file.
    action : str
        The participle of what the block does with it, such as "rendered".
    """
    with errors_as_failure(path, action, errors=(ImportError, RuntimeError, ValueError)):
        try:
            yield
        except ConversionError as error:
            raise Failure(os.fspath(path), f"cannot be converted: {error}") from error


def without_converted(paths: Sequence[str]) -> list[Path]:
    """Return the paths without those of converted scenes; print a line for each of these.

    The shell's *.xml matches them too.
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


def _png_and_exr(target: str) -> tuple[Path, Path]:
    """Return the paths of both files that a rendering writes; -o may name either.

    Only the suffix of a picture is replaced, so that room.v1 and room.v2 have different files.
    """
    path = Path(target)
    if path.suffix.lower() == ".exr":
        return path.with_suffix(".png"), path
    if path.suffix.lower() == ".png":
        return path, path.with_suffix(".exr")
    return Path(target + ".png"), Path(target + ".exr")


def add_scene_arguments(parser: argparse.ArgumentParser) -> None:
    """Let a command accept scenes, the path of its results, and Mitsuba's variant."""
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


def _parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
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


def _convert(path: Path, target: Path, options: argparse.Namespace) -> None:
    """Convert the scene file `path` to the file `target`, and print a line.

    Raises
    ------
    Failure
        If the scene cannot be read or converted, or the file not be written.
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


def _render(path: Path, target: Path, options: argparse.Namespace) -> None:
    """Render the scene file `path` with Mitsuba, and print a line.

    Two files are written, a PNG and an EXR; `target` is the path of either.

    Raises
    ------
    Failure
        If the scene cannot be read, converted or rendered, or a file not be written.
    """
    from converters.rendering import render_mitsuba, write_exr
    from tracer import load_scene, write_png

    with errors_as_failure(path, "read", memory_remedy="split the scene"):
        scene = load_scene(path)
    with mitsuba_errors_as_failure(path, "rendered"):
        image = render_mitsuba(scene, options.samples, options.variant, options.flavour)
    png, exr = _png_and_exr(str(target))
    for picture, write in ((png, write_png), (exr, write_exr)):
        with errors_as_failure(picture, "written", "choose another with -o"):
            write(picture, image)
    height, width, _ = image.shape
    print_line(sys.stdout, printable(f"{png} and {exr.name}: {width} x {height}"))
