"""Convert scene files to files for Mitsuba 3, or render them with Mitsuba.

python -m converters.to_mitsuba SCENE.xml ...            writes NAME.mitsuba.xml
python -m converters.to_mitsuba --render SCENE.xml ...   writes NAME.mitsuba.png and .exr

Both take the option --flavour:
  stock  a similar picture, for the plain mitsuba command: lights fall off with distance, and
         highlights differ (default without --render)
  exact  the same picture, with small plugins of this project: mitsuba.load_file reads the file
         after "import converters.plugins" (default with --render)

Converting needs no Mitsuba; --render needs it ("pip install .[reference]").
"""

# Mitsuba is imported where it is used, because converting does not need it.

from __future__ import annotations

from tracer.command.process import run

if __name__ == "__main__":
    run(__spec__.name)  # before the other imports: see tracer/command/process.py

import argparse
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import NamedTuple

from converters.mitsuba_xml import FILE_START, ConversionError
from tracer.command.arguments import (
    CommandParser,
    check_path,
    choose_output_paths,
    make_output_folder,
    parse_positive_int,
)
from tracer.command.failure import Failure, describe_cause, errors_as_failure
from tracer.command.process import FAILED, attempt, print_line
from tracer.files import open_atomically
from tracer.messages import make_printable


def main(arguments: Sequence[str] | None = None) -> int:
    """Convert or render the scene files named on the command line.

    Parameters
    ----------
    arguments : sequence of str, optional
        The command-line arguments; by default, the arguments of this process.

    Returns
    -------
    exit_status : int
        0, or `FAILED` (1) if a scene could not be read, converted or rendered, or a file could not
        be written.  The other scenes are still processed.

    Raises
    ------
    Failure
        If Mitsuba cannot run, or the output folder cannot be created.
    SystemExit
        If the arguments are wrong.
    """
    parser = _make_parser()
    options = parser.parse_args(arguments)
    if options.variant is not None and not options.render:
        parser.error("--variant is for --render; converting needs no Mitsuba")
    mode = _RENDERING if options.render else _CONVERSION
    flavour = options.flavour or mode.default_flavour
    scene_paths = skip_converted_scenes(options.scenes)
    output_paths = choose_output_paths(
        parser,
        [*map(str, scene_paths)],
        options.output,
        [mode.derive_output_path(path, flavour) for path in scene_paths],
        mode.list_files,
    )
    if options.render:
        set_up_mitsuba(options.variant)
    make_output_folder(options.output)
    results = [
        attempt(mode.process_scene, scene_path, Path(output_path), flavour, options)
        for scene_path, output_path in zip(scene_paths, output_paths, strict=True)
    ]
    return FAILED if any(isinstance(result, Failure) for result in results) else 0


def set_up_mitsuba(variant: str | None, *, exit_status: int = FAILED) -> None:
    """Set the variant that Mitsuba uses, and print its name and the reason for choosing it.

    A variant is one of the ways in which Mitsuba computes, such as "llvm_ad_rgb".  None stands for
    the fastest one that works on this machine.  Raise `Failure`, with the exit status, if Mitsuba
    is not installed or the variant does not work.
    """
    try:
        import converters.rendering  # noqa: F401 (fails if Mitsuba is missing)
        from converters.variant import use_variant

        choice = use_variant(variant)
    except (ImportError, OSError) as error:
        is_missing = isinstance(error, ModuleNotFoundError)
        remedy = "install it with pip install -e '.[reference]'" if is_missing else ""
        problem = f"Mitsuba cannot run: {describe_cause(error)}"
        raise Failure("", problem, remedy, exit_status) from error
    print_line(sys.stdout, f"Mitsuba variant {choice.variant}: {choice.reason}")


@contextmanager
def mitsuba_errors_as_failure(path: str | os.PathLike[str], participle: str) -> Iterator[None]:
    """Convert errors in a with block that converts or renders a scene to a `Failure`.

    The message is "PATH: cannot be PARTICIPLE: reason".  PATH is the path of the scene file, and
    the participle is, for example, "rendered".  After a `ConversionError`, it is "converted".  The
    other errors are OSError, MemoryError, ImportError, RuntimeError and ValueError, because Mitsuba
    raises all of them.
    """
    with errors_as_failure(path, participle, error_types=(ImportError, RuntimeError, ValueError)):
        try:
            yield
        except ConversionError as error:
            raise Failure(os.fspath(path), f"cannot be converted: {error}") from error


def skip_converted_scenes(paths: Sequence[str]) -> list[Path]:
    """Return the paths of scene files, and print a line for each file that is a converted scene.

    Naming a converted scene is no error, because the pattern *.xml matches converted scenes and
    original ones.
    """
    kept_paths = []
    for path in paths:
        if _is_converted_scene(Path(path)):
            notice = f"{path}: skipped, because it is a converted scene"
            print_line(sys.stdout, make_printable(notice))
        else:
            kept_paths.append(Path(path))
    return kept_paths


def _is_converted_scene(path: Path) -> bool:
    """Test whether a file begins like every Mitsuba scene that this command writes.

    The result is False if the file cannot be read: the caller reads it again and reports the error.
    """
    start = FILE_START.encode()
    with suppress(OSError, ValueError):
        if path.is_file():  # opening a pipe may block for ever
            with path.open("rb") as file:
                return file.read(len(start)) == start
    return False


def _derive_picture_paths(output_path: str) -> tuple[Path, Path]:
    """Return the paths of the PNG file and of the EXR file for one output path, in this order.

    They differ only in the suffix, which replaces a suffix .png or .exr of the output path.  Any
    other suffix is kept, so that room.v1 and room.v2 give different paths.
    """
    path = Path(output_path)
    if path.suffix.lower() == ".exr":
        return path.with_suffix(".png"), path
    if path.suffix.lower() == ".png":
        return path, path.with_suffix(".exr")
    return Path(output_path + ".png"), Path(output_path + ".exr")


def add_scene_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments SCENE.xml, -o and --variant to a parser.

    The parsed arguments have the attributes `scenes` (a list of paths), `output` (None if -o is not
    given) and `variant` (None if --variant is not given).
    """
    parser.add_argument("scenes", nargs="+", type=check_path, metavar="SCENE.xml")
    output_help = "the file to write, or a folder for the results of several scenes;"
    output_help += " a missing folder is created if PATH ends in /"
    parser.add_argument("-o", "--output", type=check_path, metavar="PATH", help=output_help)
    variant_help = "Mitsuba's variant (default: the fastest that works on this machine)"
    parser.add_argument("--variant", help=variant_help)


def _make_parser() -> CommandParser:
    parser = CommandParser(__name__)
    add_scene_arguments(parser)
    parser.add_argument("--flavour", choices=("stock", "exact"), help="described above")
    samples_help = "samples per pixel, which may be rounded up (default: 64 for stock; 1 for exact,"
    samples_help += " at the pixel's centre)"
    parser.add_argument("--samples", type=parse_positive_int, metavar="N", help=samples_help)
    parser.add_argument("--render", action="store_true", help="render to a PNG and an EXR file")
    return parser


def _convert_file(
    scene_path: Path, output_path: Path, flavour: str, options: argparse.Namespace
) -> None:
    """Convert a scene file to a Mitsuba scene file, and print the path of the result.

    `flavour` is "stock" or "exact".  Of the options, only `samples` is used.  Raise `Failure` if
    the scene cannot be read or converted, or the result cannot be written.
    """
    from converters.flavours import convert
    from tracer import load_scene

    with errors_as_failure(scene_path, "read", memory_remedy="split the scene"):
        scene = load_scene(scene_path)
    with mitsuba_errors_as_failure(scene_path, "converted"):
        text = convert(scene, flavour, options.samples)
    with (
        errors_as_failure(output_path, "written", "choose another with -o"),
        open_atomically(output_path, FILE_START.encode()) as file,
    ):
        file.write(text.encode())
    print_line(sys.stdout, make_printable(f"{output_path}: {flavour} flavour"))


def _render_file(
    scene_path: Path, output_path: Path, flavour: str, options: argparse.Namespace
) -> None:
    """Render a scene file with Mitsuba to a PNG and an EXR file, and print their paths.

    For these paths, see `_derive_picture_paths`.  `flavour` is "stock" or "exact".  Of the options,
    `samples` and `variant` are used.  Raise `Failure` if the scene cannot be read or rendered, or a
    picture cannot be written.
    """
    from converters.rendering import render_with_mitsuba, write_exr
    from tracer import load_scene, write_png

    with errors_as_failure(scene_path, "read", memory_remedy="split the scene"):
        scene = load_scene(scene_path)
    with mitsuba_errors_as_failure(scene_path, "rendered"):
        image = render_with_mitsuba(scene, options.samples, options.variant, flavour)
    png_path, exr_path = _derive_picture_paths(str(output_path))
    for picture_path, write_picture in ((png_path, write_png), (exr_path, write_exr)):
        with errors_as_failure(picture_path, "written", "choose another with -o"):
            write_picture(picture_path, image)
    height, width, _ = image.shape
    print_line(sys.stdout, make_printable(f"{png_path} and {exr_path.name}: {width} x {height}"))


class _Mode(NamedTuple):
    """One of the two things that the command can do with each scene: convert it, or render it."""

    default_flavour: str
    suffix: str  # of the output path if -o is not given
    # Takes the output path, and returns the paths of all files that are written.
    list_files: Callable[[str], tuple[Path, ...]]
    # Takes the path of the scene, the output path, the flavour and the options.
    process_scene: Callable[[Path, Path, str, argparse.Namespace], None]

    def derive_output_path(self, scene_path: Path, flavour: str) -> str:
        """Return the output path for a scene if -o is not given: a file beside the scene file.

        Its name contains the flavour if that is not the default.  A path such as / has no name, but
        is accepted here: reading it fails with a clear message.
        """
        flavour_suffix = "" if flavour == self.default_flavour else f".{flavour}"
        return str(scene_path.parent / f"{scene_path.stem}{flavour_suffix}{self.suffix}")


_CONVERSION = _Mode(
    default_flavour="stock",
    suffix=".mitsuba.xml",
    list_files=lambda output_path: (Path(output_path),),
    process_scene=_convert_file,
)
_RENDERING = _Mode(
    default_flavour="exact",
    suffix=".mitsuba.png",
    list_files=_derive_picture_paths,
    process_scene=_render_file,
)
