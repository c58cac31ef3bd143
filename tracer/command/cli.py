"""Render scenes.  Each picture is written beside its scene, as SCENE.xml.png.

examples:
  tracer scenes/one-sphere.xml          write scenes/one-sphere.xml.png
  tracer scenes/*.xml -o pictures/      write all pictures to a folder
  tracer room.xml -o room.png --samples 16
                                        edges as smooth as with 16 samples per pixel
  tracer room.xml -o room.npy           linear radiance, for numpy.load
  tracer room.xml --size 160 --watch
                                        a small picture, again after each change
  generate | tracer - -o - | display    from standard input to standard output

exit status:
  0    all scenes were rendered
  1    a scene could not be read, rendered or written; all others were rendered
  2    wrong usage
  130  interrupted
  141  nobody reads the picture or the explanation on standard output
"""

from __future__ import annotations

import argparse
import os
import re
import sys
from collections.abc import Callable, Sequence
from contextlib import closing
from importlib import import_module
from time import sleep

from tracer.command.arguments import (
    CommandParser,
    check_path,
    choose_output_paths,
    is_folder,
    make_output_folder,
    parse_positive_int,
)
from tracer.command.batch import Batch, Job, Settings, read_scene
from tracer.command.failure import Failure, errors_as_failure
from tracer.command.process import FAILED, attempt, print_line, print_or_raise
from tracer.messages import make_printable
from tracer.picture.formats import FORMATS
from tracer.picture.parallel import count_processors
from tracer.version import __version__

_HELP = {
    "scenes": "a scene file; - for standard input",
    "output": "the picture to write; - for standard output; or a folder for the pictures of several"
    " scenes, which is created if it is missing and PATH ends in /",
    "format": "format of the pictures: png (8-bit codes), npy (linear radiance, float64) or exr"
    " (linear radiance, float32); default: as the name of -o, otherwise png",
    "samples": "smooth edges as accurately as N samples per pixel would; 4 to 16 are enough for"
    " most pictures (default: 1, the pixel's centre)",
    "size": "width and height of the pictures in pixels; without xH, in the file's proportions",
    "crop": "render only a part of the pictures: the column and the row of its top left pixel, its"
    " width and its height",
    "watch": "render again whenever a scene file is saved",
    "processes": "maximum number of processes that render (default: one for each processor)",
    "pixel": "explain a pixel, by its column and row (0,0 is the top left), and write no picture",
    "quiet": "print only errors",
}

# Seconds between two checks of the scene files, with --watch.
_POLL_SECONDS = 0.1


class _Arguments(argparse.Namespace):
    """The command-line arguments, described in `_HELP`.

    An attribute that may be None is None if its option is not given.
    """

    scenes: list[str]
    output: str | None
    format: str | None
    samples: int
    size: tuple[int, ...] | None
    crop: tuple[int, int, int, int] | None
    watch: bool
    processes: int | None
    pixel: tuple[int, int] | None
    quiet: bool


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command ``tracer``: render scenes to picture files, watch them, or explain a pixel.

    Parameters
    ----------
    argv : sequence of str, optional
        The command-line arguments, without the name of the command.  By default, the arguments of
        this process.

    Returns
    -------
    exit_status : int
        0, or 1 if a scene could not be read, rendered or written.  Errors have been printed to
        standard error.

    Raises
    ------
    SystemExit
        With status 2 for wrong usage, and 0 for ``--help`` and ``--version``.
    Failure
        If the working folder has been deleted, or the folder for the pictures cannot be created.
    """
    # The functions that take the parser report wrong usage by `parser.error`, which prints it and
    # raises SystemExit.
    parser = _make_parser()
    _check_size(parser, sys.argv[1:] if argv is None else argv)
    arguments = parser.parse_args(argv, namespace=_Arguments())
    if arguments.pixel is not None:
        return _explain_pixels(parser, arguments, arguments.pixel)
    file_format = _choose_format(parser, arguments)
    _check_names(parser, arguments, file_format)
    jobs = _make_jobs(parser, arguments, file_format)
    if file_format == "exr":
        import_module("OpenEXR")  # fail now if it is missing, not after rendering
    make_output_folder(arguments.output)
    settings = Settings(
        samples=arguments.samples,
        size=arguments.size,
        crop=arguments.crop,
        file_format=file_format,
        quiet=arguments.quiet,
    )
    process_count = min(arguments.processes or count_processors(), count_processors())
    with closing(Batch(settings, process_count)) as batch:
        if arguments.watch:
            return _watch(jobs, batch, quiet=arguments.quiet)
        return 0 if batch.render(jobs) else FAILED


def _make_parser() -> CommandParser:
    parser = CommandParser(__name__, prog="tracer")
    add_argument = parser.add_argument
    size_pattern = "([1-9][0-9]{0,8})(?:x([1-9][0-9]{0,8}))?"
    size_rule = "a width, or a width and a height, in pixels (640 or 640x360)"
    parse_size = _make_int_parser(size_pattern, size_rule)
    parse_pixel = _make_int_parser(
        "([0-9]{1,9}),([0-9]{1,9})", "a column and a row (for example 160,90)"
    )
    parse_crop = _make_int_parser(
        "([0-9]{1,9}),([0-9]{1,9}),([1-9][0-9]{0,8}),([1-9][0-9]{0,8})",
        "a column, a row, a width and a height in pixels (for example 160,90,64,36)",
    )
    add_argument("scenes", nargs="+", type=check_path, metavar="SCENE.xml", help=_HELP["scenes"])
    add_argument("-o", "--output", type=check_path, metavar="PATH", help=_HELP["output"])
    add_argument("--format", choices=FORMATS, help=_HELP["format"])
    add_argument(
        "--samples", type=parse_positive_int, default=1, metavar="N", help=_HELP["samples"]
    )
    add_argument("--size", type=parse_size, metavar="W[xH]", help=_HELP["size"])
    add_argument("--crop", type=parse_crop, metavar="X,Y,W,H", help=_HELP["crop"])
    add_argument("--watch", action="store_true", help=_HELP["watch"])
    add_argument("--processes", type=parse_positive_int, metavar="N", help=_HELP["processes"])
    add_argument("--pixel", type=parse_pixel, metavar="X,Y", help=_HELP["pixel"])
    add_argument("--quiet", action="store_true", help=_HELP["quiet"])
    add_argument("--version", action="version", version=f"%(prog)s {__version__}")
    return parser


def _make_int_parser(pattern: str, rule: str) -> Callable[[str], tuple[int, ...]]:
    """Return a function that extracts the integers from an argument such as "640x360".

    The function raises ArgumentTypeError if the argument is not valid.

    Parameters
    ----------
    pattern
        Regular expression for valid arguments.  Each group matches the digits of an integer, or
        nothing; then this integer is left out.
    rule
        Description of valid arguments, which follows "must be" in the error message.
    """

    def parse(argument: str) -> tuple[int, ...]:
        match = re.fullmatch(pattern, argument)
        if match is None:
            raise argparse.ArgumentTypeError(f"must be {rule}, not {argument!r}")
        return tuple(int(digits) for digits in match.groups() if digits is not None)

    return parse


def _check_size(parser: CommandParser, argv: Sequence[str]) -> None:
    """Suggest a fix by `parser.error` if the arguments contain, for example, ``--size 400 300``.

    Otherwise, the 300 would count as the name of a scene.
    """
    for option, width, height in zip(argv, argv[1:], argv[2:], strict=False):
        if option == "--size" and f"{width}{height}".isdecimal() and not os.path.exists(height):
            size = f"{width}x{height}"
            parser.error(f"--size {width} {height}: a size is one argument; write {size}")


def _choose_format(parser: CommandParser, arguments: _Arguments) -> str:
    """Return the picture format, a key of `FORMATS`, from the options --format and -o.

    Without --format, the suffix of the file at -o determines the format.  Without such a suffix, it
    is "png".  Call `parser.error` if the suffix is unknown or contradicts --format.
    """
    output = arguments.output or ""
    valid_formats = [arguments.format] if arguments.format else list(FORMATS)
    stem, suffix = os.path.splitext(output)
    if is_folder(output) or not suffix:
        return valid_formats[0]
    if suffix[1:].lower() not in valid_formats:
        suffixes = ", ".join(f".{name}" for name in valid_formats)
        parser.error(f"-o {output}: pictures end in {suffixes}; name it {stem}.{valid_formats[0]}")
    return suffix[1:].lower()


def _check_names(parser: CommandParser, arguments: _Arguments, file_format: str) -> None:
    """Call `parser.error` if a scene has the name of a picture, or "-" stands where it cannot.

    In the arguments, "-" stands for standard input or standard output.
    """
    scenes = arguments.scenes
    output = arguments.output
    watch = arguments.watch
    for scene in scenes:
        if os.path.splitext(scene)[1][1:].lower() in FORMATS:
            parser.error(f"{scene}: a picture is not a scene; to write it, use -o {scene}")
    if "-" in scenes and (output is None or watch):
        parser.error(
            "-: a scene read from standard input needs -o, and cannot be used with --watch"
        )
    if output == "-":
        if len(scenes) > 1 or watch:
            parser.error(
                "-o -: only one scene can be written to standard output, and not with --watch"
            )
        if file_format == "exr":
            parser.error("-o -: an EXR file cannot go to standard output")
        if sys.stdout is not None and sys.stdout.isatty():
            parser.error("-o -: standard output is a terminal; write the picture to a file")


def _make_jobs(parser: CommandParser, arguments: _Arguments, file_format: str) -> list[Job]:
    """List the scenes to render, each with the path of its picture, in the order of the arguments.

    Without the option -o, the format is added to the name of the scene file, as in SCENE.xml.png.
    Call `parser.error` if a picture would replace a scene, another picture or a special file.
    Raise Failure if the working folder has been deleted.
    """
    scenes = arguments.scenes
    output = arguments.output
    if output == "-":
        return [Job(scene_path=scenes[0], output_path=output)]
    if output and os.path.exists(output) and not (os.path.isfile(output) or is_folder(output)):
        parser.error(f"-o {output}: not a regular file; for standard output, use -o -")
    default_paths = [f"{scene}.{file_format}" for scene in scenes]
    paths = choose_output_paths(parser, scenes, output, default_paths)
    return [
        Job(scene_path=scene, output_path=path) for scene, path in zip(scenes, paths, strict=True)
    ]


def _explain_pixels(parser: CommandParser, arguments: _Arguments, pixel: tuple[int, int]) -> int:
    """Print how the colour of a pixel is computed in each scene, and return the exit status.

    `pixel` is the column and the row of the pixel.  If a scene cannot be read or has no such pixel,
    print an error, continue with the next scene, and finally return 1.  Call `parser.error` if
    the arguments contain an option for pictures.
    """
    picture_options = arguments.output, arguments.format, arguments.crop, arguments.watch
    if any(picture_options) or arguments.samples > 1:
        parser.error("--pixel cannot be combined with -o, --format, --samples, --crop or --watch")
    from tracer.picture.explanation import explain  # only now, because rendering does not need it

    def print_explanation(path: str) -> None:
        scene = read_scene(path, arguments.size)
        try:
            text = str(explain(scene, *pixel))
        except ValueError as error:
            raise Failure(path, str(error), "columns and rows count from 0") from error
        if len(arguments.scenes) > 1:
            text = f"{make_printable(path)}:\n{text}"
        with errors_as_failure("standard output", "written"):
            print_or_raise(sys.stdout, text)

    results = [attempt(print_explanation, path) for path in arguments.scenes]
    return FAILED if any(isinstance(result, Failure) for result in results) else 0


def _watch(jobs: Sequence[Job], batch: Batch, *, quiet: bool) -> int:
    """Render all scenes, and render each of them again whenever its file changes.

    Return the exit status 0 when nobody reads standard output any more.  If `quiet`, nothing is
    printed there, and this never returns.
    """
    from tracer.command.watch import WatchedFile  # only now, because it is seldom needed

    if not quiet:
        scenes_text = "1 scene" if len(jobs) == 1 else f"{len(jobs)} scenes"
        print_line(sys.stderr, f"watching {scenes_text}; press Ctrl-C to end")
    watched_files = [WatchedFile(job.scene_path) for job in jobs]
    while quiet or not (sys.stdout is None or sys.stdout.closed):
        changed_jobs = [
            job for job, file in zip(jobs, watched_files, strict=True) if file.has_new_version()
        ]
        if changed_jobs:
            batch.render(changed_jobs)
        sleep(_POLL_SECONDS)
    return 0
