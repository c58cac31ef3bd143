"""The command line: render scenes to PNG files, watch them, or explain a pixel."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, suppress
from dataclasses import replace
from time import perf_counter, sleep
from typing import Any

from tracer.command.arguments import file_name, is_folder, output_paths, whole_number
from tracer.command.failure import Failure, errors_as_failure
from tracer.command.process import FAILED, attempt, print_line, print_result
from tracer.files import atomic_file
from tracer.messages import printable
from tracer.picture.explanation import explain
from tracer.picture.lint import Exposure, scene_warnings
from tracer.picture.parallel import WorkerPool, processors
from tracer.picture.png import PNG, write_tiles
from tracer.picture.render import MIN_POOL_SECONDS, RenderJob, Tile, render_tiles
from tracer.scene.model import Scene
from tracer.scene.reader import load_scene
from tracer.scene.schema import SceneError
from tracer.version import __version__

_EXAMPLES = """\
examples:
  tracer scenes/one-sphere.xml          write scenes/one-sphere.xml.png
  tracer scenes/*.xml -o pictures/      write every picture to a folder
  tracer room.xml -o room.png --samples 16
                                        smooth edges, as good as 16 samples a pixel
  tracer room.xml --size 160x90 --watch
                                        a small picture, anew whenever room.xml is saved
  generate | tracer - -o - | display    from standard input to standard output

exit status:
  0    all scenes were rendered
  1    some scene could not be read, rendered or written; the others were
  2    wrong usage
  130  interrupted
"""

_BUG = "this is a bug in the tracer; please report it with the scene"

# A bar is shown once a picture turns out to take longer than this, in seconds.
_SLOW = 1.0

# Seconds between two looks at the scene files, with --watch.
_PAUSE = 0.1


def main(argv: Sequence[str] | None = None) -> int:
    """Render scenes to PNG files as the arguments say, and return the exit status.

    Raises
    ------
    SystemExit
        With status 2 for wrong usage, and 0 for ``--help`` and ``--version``.
    Failure
        If the working folder is gone.
    """
    arguments, jobs = _parsed(argv)
    if arguments.watch:
        return _watch(jobs, arguments)
    # A list, not a generator: after a failure the other scenes must still be rendered.
    results = [attempt(_render, *job, arguments) for job in jobs]
    return FAILED if any(isinstance(result, Failure) for result in results) else 0


def _parsed(argv: Sequence[str] | None) -> tuple[argparse.Namespace, list[tuple[str, str]]]:
    """Parse the arguments; return them, and pairs of the paths of a scene and its picture."""
    parser = argparse.ArgumentParser(
        prog="tracer",
        description="Render scenes; each picture is written beside its scene, as SCENE.xml.png.",
        epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = parser.add_argument
    count: dict[str, Any] = {"type": whole_number(1), "metavar": "N"}
    size = _pair("x", 1, "width and height in pixels, as 640x360")
    pixel = _pair(",", 0, "column and row, as 160,90")
    text = "a scene file; - for standard input"
    add("scenes", nargs="+", type=file_name, metavar="SCENE.xml", help=text)
    text = (
        "the picture to write, always a PNG; - for standard output; or a folder for those of"
        " several scenes, which is made if it is missing and PATH ends in /"
    )
    add("-o", "--output", type=file_name, metavar="PATH", help=text)
    text = "smooth edges as well as N samples a pixel would (default: 1, the pixel's centre)"
    add("--samples", default=1, help=text, **count)
    text = "width and height of the pictures in pixels, whatever the files say"
    add("--size", type=size, metavar="WxH", help=text)
    add("--watch", action="store_true", help="render again whenever a scene file is saved")
    text = "processes that render, at most one for each processor (default: as many as pay)"
    add("--processes", help=text, **count)
    text = "explain a pixel, by its column and row (0,0 is the top left), and write no picture"
    add("--pixel", type=pixel, metavar="X,Y", help=text)
    add("--quiet", action="store_true", help="report only what goes wrong")
    add("--version", action="version", version=f"%(prog)s {__version__}")
    arguments = parser.parse_args(argv)
    scenes, output, watch = arguments.scenes, arguments.output, arguments.watch
    if arguments.pixel is not None:
        if output is not None or watch:
            parser.error("--pixel cannot be combined with -o or --watch")
        return arguments, [(scene, "") for scene in scenes]
    if "-" in scenes and (output is None or watch):
        parser.error("-: a picture of standard input needs a name, with -o, and no --watch")
    if output == "-":
        if len(scenes) > 1 or watch:
            parser.error("-o -: standard output takes the picture of one scene, and no --watch")
        return arguments, [(scenes[0], output)]
    stem, suffix = os.path.splitext(output or "")
    if suffix.lower() not in ("", ".png") and not is_folder(output):
        parser.error(printable(f"-o {output}: pictures are PNG files; name it {stem}.png"))
    pictures = output_paths(parser, scenes, output, [f"{scene}.png" for scene in scenes])
    return arguments, list(zip(scenes, pictures, strict=True))


def _pair(mark: str, least: int, wanted: str) -> Callable[[str], tuple[int, int]]:
    """Make a parser of arguments that are two whole numbers with a mark between them."""
    number = whole_number(least)

    def pair(text: str) -> tuple[int, int]:
        try:
            first, second = text.split(mark)
            return number(first), number(second)
        except (ValueError, argparse.ArgumentTypeError):
            raise argparse.ArgumentTypeError(f"must be {wanted}, is {text!r}") from None

    return pair


def _watch(jobs: list[tuple[str, str]], arguments: argparse.Namespace) -> int:
    """Render each scene, and again whenever its file has changed.

    Returns the exit status once nobody reads what this prints any more.
    """
    last, rendered = dict[str, object](), dict[str, object]()
    while arguments.quiet or not (sys.stdout is None or sys.stdout.closed):
        for scene, output in jobs:
            try:
                status = os.stat(scene)
                now = status.st_mtime_ns, status.st_size, status.st_ino
            except OSError:
                now = None
            # An editor may write a file in pieces: wait until it stops changing.
            settled = last.get(scene, now) == now
            last[scene] = now
            if settled and rendered.get(scene, ()) != now:
                rendered[scene] = now
                attempt(_render, scene, output, arguments)
        sleep(_PAUSE)
    return 0


def _render(path: str, output: str, arguments: argparse.Namespace) -> None:
    """Render a scene to a PNG file, or explain one of its pixels; print the result in a line.

    Parameters
    ----------
    path : str
        The scene file; "-" is standard input.
    output : str
        The picture to write; "-" is standard output.
    arguments : Namespace
        The arguments of the command.

    Raises
    ------
    Failure
        If the scene cannot be read, rendered or written, or the pixel not be explained.
    """
    start, to_standard_output = perf_counter(), output == "-"
    scene = _read_scene(path, arguments.size)
    if arguments.pixel is not None:
        try:
            text = str(explain(scene, *arguments.pixel))
        except ValueError as error:
            raise Failure(path, str(error), "columns and rows count from 0") from error
        with errors_as_failure("standard output", "written"):
            print_result(sys.stdout, text)
        return
    if arguments.output is not None and is_folder(arguments.output):
        with errors_as_failure(arguments.output, "written", "choose another with -o"):
            try:
                os.makedirs(arguments.output, exist_ok=True)
            except (FileExistsError, NotADirectoryError):  # a file, or a link to nothing
                raise OSError("it is not a folder") from None
    progress = _Progress(output, scene.width * scene.height, show=not arguments.quiet)
    with (
        errors_as_failure(output, "written", "choose another with -o"),
        open(1, "wb", closefd=False) if to_standard_output else atomic_file(output, PNG) as file,
    ):
        tiles = progress.watch(_render_tiles(scene, path, arguments))
        write_tiles(file, scene.width, scene.height, (tile.data for tile in tiles))
    if arguments.quiet:
        return
    for warning in scene_warnings(scene, progress.exposure):
        print_line(sys.stderr, printable(f"{path}: warning: {warning}"))
    seconds = perf_counter() - start
    line = f"{output}: {scene.width} x {scene.height} pixels in {seconds:.3f} s"
    print_line(sys.stderr if to_standard_output else sys.stdout, printable(line))


def _read_scene(path: str, size: tuple[int, int] | None) -> Scene:
    """Read a scene from a file, or from standard input if `path` is "-".

    Parameters
    ----------
    path : str
        The scene file, or "-".
    size : (int, int), optional
        Width and height of the picture in pixels, in place of those in the file.

    Raises
    ------
    Failure
        If the scene cannot be read, or the size is too large.
    """
    if path == "-" and sys.stdin is None:
        raise Failure("<stdin>", "cannot be read: it is closed", "name a scene file")
    with errors_as_failure(path, "read", memory_remedy="split the scene"):
        scene = load_scene(sys.stdin.buffer if path == "-" else path)
    if size is None:
        return scene
    try:
        return replace(scene, width=size[0], height=size[1])
    except SceneError as error:
        raise Failure("--size", str(error)) from error


def _render_tiles(scene: Scene, path: str, arguments: argparse.Namespace) -> Iterator[Tile]:
    """Render a scene and yield its tiles in order; `path` is the scene's, for messages.

    Raises
    ------
    Failure
        If there is too little memory, or the tracer fails because of a bug.
    """
    size = f"make the image smaller than {scene.width} x {scene.height} pixels"
    samples = f" or take fewer samples than {arguments.samples}" * (arguments.samples > 1)
    memory_remedy = size + samples
    with errors_as_failure(
        path, "rendered", _BUG, memory_remedy=memory_remedy, errors=(ValueError,)
    ):
        job = RenderJob(scene, arguments.samples)
        wanted = arguments.processes or (processors() if job.seconds >= MIN_POOL_SECONDS else 1)
        workers = min(wanted, processors(), len(job.tiles(shared=True))) - 1
        with closing(WorkerPool(workers)) as pool:
            yield from render_tiles(job, pool)


class _Progress:
    """Progress of a picture, with a bar once it turns out to be slow.

    Attributes
    ----------
    exposure : Exposure
        How much of the picture so far is black or clipped.
    """

    def __init__(self, name: str, pixels: int, *, show: bool) -> None:
        self.name, self.pixels = os.path.basename(printable(name)), pixels
        self.exposure = Exposure()
        lost = sys.stderr is None or sys.stderr.closed
        self.show = show and not lost and sys.stderr.isatty()

    def watch(self, tiles: Iterator[Tile]) -> Iterator[Tile]:
        """Yield the same tiles, and count their pixels."""
        start, done, bar = perf_counter(), 0, None
        try:
            for tile in tiles:
                yield tile
                self.exposure = self.exposure.including(tile.exposure)
                done += tile.pixels
                if bar is None and self.show and perf_counter() - start > _SLOW:
                    bar = self._bar()
                if bar:
                    bar.update(done - bar.n)
        finally:
            if bar:
                bar.close()

    def _bar(self) -> Any:
        """Make a progress bar; False if there can be none: a picture must not fail for that."""
        # Not installed, or the environment has settings for it that it cannot read.
        with suppress(ImportError, ValueError):
            from tqdm import tqdm  # takes longer to import than a small picture to render

            tqdm.monitor_interval = 0  # else it starts a thread
            return tqdm(desc=self.name, total=self.pixels, unit="px", unit_scale=True, leave=False)
        return False
