"""The command line: `python -m tracer SCENE.xml [SCENE.xml ...]`.

NumPy takes longer to import than a small picture to render.  What needs it is imported where it
is used, so that `run` can prepare for it, and `--help` and wrong usage do without.
"""

from __future__ import annotations

import argparse
import gc
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from functools import partial
from time import perf_counter, sleep
from typing import TYPE_CHECKING, Any, NoReturn

from tracer.commands import (
    FAILED,
    INTERRUPTED,
    allow_interrupts,
    atomic_file,
    file_name,
    install_signal_handlers,
    is_folder,
    output_paths,
    print_line,
    printable,
    whole_number,
)
from tracer.version import __version__

if TYPE_CHECKING:
    from tracer.picture.png import Compressed
    from tracer.scene.model import Scene

__all__ = ["main", "run"]

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

# A bar is shown once a picture turns out to take longer than this, in seconds.
_SLOW = 1.0

# Seconds between two looks at the scene files, with --watch.
_PAUSE = 0.1


def main(argv: Sequence[str] | None = None) -> int:
    """Render scenes to PNG files, as the arguments say; return the exit status.

    Raises
    ------
    SystemExit
        With status 2 for wrong usage, 1 in a folder that is gone, and 0 for ``--help`` and
        ``--version``.
    """
    arguments, jobs = _parsed(argv)
    try:
        if arguments.watch:
            _watch(jobs, arguments)
        # All of them, whatever becomes of the first.
        return FAILED if [job for job in jobs if not _rendered(*job, arguments)] else 0
    except ModuleNotFoundError as error:
        package = (error.name or "numpy").partition(".")[0]
        print_line(sys.stderr, f"{error}; install it with python -m pip install {package}")
        return FAILED
    except (ImportError, MemoryError, SystemError) as error:
        # What NumPy says of a library that cannot be loaded is a page.
        reason = str(error).strip().rpartition("Original error was: ")[2] or "not enough memory"
        remedy = "give it more memory, or install NumPy again"
        print_line(sys.stderr, printable(f"the tracer cannot start: {reason}; {remedy}"))
        return FAILED
    except KeyboardInterrupt:
        return INTERRUPTED


def _parsed(argv: Sequence[str] | None) -> tuple[argparse.Namespace, list[tuple[str, str]]]:
    """The arguments, and the pairs of a scene and its picture."""
    parser = argparse.ArgumentParser(
        prog="tracer",
        description="Render scenes; each picture is written beside its scene, as SCENE.xml.png.",
        epilog=_EXAMPLES,
        # Looking up the terminal's width would import the whole of shutil.
        formatter_class=partial(argparse.RawDescriptionHelpFormatter, width=88),
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
    text = "processes that render, at most one for each processor (default: 1 or 2, what pays)"
    add("--processes", help=text, **count)
    text = "explain a pixel, by its column and row (0,0 is the top left), and write no picture"
    add("--pixel", type=pixel, metavar="X,Y", help=text)
    add("--quiet", action="store_true", help="report only what goes wrong")
    add("--version", action="version", version=f"%(prog)s {__version__}")
    arguments = parser.parse_args(argv)
    scenes, output, watch = arguments.scenes, arguments.output, arguments.watch
    if arguments.pixel is not None:
        if output is not None or watch:
            parser.error("--pixel writes no picture: it goes without -o and --watch")
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
    """Type of an argument of two whole numbers with a mark between them."""
    number = whole_number(least)

    def pair(text: str) -> tuple[int, int]:
        try:
            first, second = text.split(mark)
            return number(first), number(second)
        except (ValueError, argparse.ArgumentTypeError):
            raise argparse.ArgumentTypeError(f"must be {wanted}, is {text!r}") from None

    return pair


def _watch(jobs: list[tuple[str, str]], arguments: argparse.Namespace) -> NoReturn:
    """Render each scene, and again whenever its file has changed."""
    last, rendered = dict[str, object](), dict[str, object]()
    while True:
        for scene, output in jobs:
            try:
                status = os.stat(scene)
                now = status.st_mtime_ns, status.st_size, status.st_ino
            except OSError:
                now = None
            # An editor may not have written all yet: it has, if nothing changes any more.
            settled = last.get(scene, now) == now
            last[scene] = now
            if settled and rendered.get(scene, ()) != now:
                rendered[scene] = now
                _rendered(scene, output, arguments)
        sleep(_PAUSE)


def _rendered(path: str, output: str, arguments: argparse.Namespace) -> bool:
    """Render a scene, or explain its pixel; print what goes wrong, if anything does."""
    from tracer.picture.bands import render_compressed
    from tracer.picture.png import PNG, write_tiles
    from tracer.scene.reader import SceneFileError, load_scene
    from tracer.scene.schema import SceneError
    from tracer.suspicions import suspicions

    allow_interrupts()
    start, shown, quiet = perf_counter(), printable(output), arguments.quiet
    size, remedy = "to read it", "split the scene"
    try:
        scene = load_scene(sys.stdin.buffer if path == "-" else path)
        if arguments.size is not None:
            scene = _resized(scene, path, arguments)
        if arguments.pixel is not None:
            from tracer.explanation import explain

            print_line(sys.stdout, str(explain(scene, *arguments.pixel)))
            return True
        size, remedy = f"for {scene.width} x {scene.height} pixels", "make the image smaller"
        if arguments.samples > 1:
            size += f" of {arguments.samples} samples"
            remedy += " or take fewer samples"
        tiles = render_compressed(scene, arguments.samples, processes=arguments.processes)
        if not quiet and sys.stderr is not None and sys.stderr.isatty():
            tiles = _with_progress(tiles, scene, os.path.basename(shown))
        if arguments.output is not None and is_folder(arguments.output):
            os.makedirs(arguments.output, exist_ok=True)
        standard = output == "-"
        with open(1, "wb", closefd=False) if standard else atomic_file(output, PNG) as file:
            black = write_tiles(file, scene.width, scene.height, tiles)
        for suspicion in () if quiet else suspicions(scene, black=black):
            print_line(sys.stderr, printable(f"{path}: warning: {suspicion}"))
    except SceneFileError as error:
        fault = str(error)
    except SceneError as error:
        fault = f"--size: {error}"
    except MemoryError:
        fault = f"{printable(path)}: not enough memory {size}; {remedy}"
    except OSError as error:
        fault = f"{shown}: cannot be written: {error.strerror or error}; choose another with -o"
    except ValueError as error:
        if arguments.pixel is not None:
            fault = f"{printable(path)}: {error}; columns and rows count from 0"
        else:
            remedy = "keep the numbers of the scene further from 1e308"
            fault = f"{shown}: cannot be written: {error}; {remedy}"
    else:
        if not quiet:
            size = f"{scene.width} x {scene.height} pixels"
            done = f"{shown}: {size} in {perf_counter() - start:.3f} s"
            print_line(sys.stderr if standard else sys.stdout, done)
        return True
    print_line(sys.stderr, fault)
    return False


def _resized(scene: Scene, path: str, arguments: argparse.Namespace) -> Scene:
    """The scene in another size; a line is printed if its pixels were square and no longer are."""
    from dataclasses import replace

    width, height = arguments.size
    resized = replace(scene, width=width, height=height)
    across, down = scene.camera.view_width, scene.camera.view_height

    def square(scene: Scene) -> bool:  # to the nearest whole number of pixels
        return abs(scene.width * down - scene.height * across) < max(across, down)

    if square(scene) and not square(resized) and not arguments.quiet:
        remedy = f"--size {width}x{max(1, round(width * down / across))} keeps them so"
        print_line(sys.stderr, printable(f"{path}: pixels are no longer square; {remedy}"))
    return resized


def _with_progress(tiles: Iterator[Compressed], scene: Scene, name: str) -> Iterator[Compressed]:
    """The same tiles; shows a bar once the picture takes long."""
    start, row, done, bar = perf_counter(), 1 + 3 * scene.width, 0, None
    try:
        for tile in tiles:
            yield tile
            done += tile.size
            if bar is None and perf_counter() - start > _SLOW:
                bar = _bar(name, scene.height)
            if bar:
                bar.update(done // row - bar.n)
    finally:
        if bar:
            bar.close()


def _bar(name: str, rows: int) -> Any:
    """A progress bar; False where there can be none, for a picture is not to fail by that."""
    # Not installed, or the environment has settings for it that it cannot read.
    with suppress(ImportError, ValueError):
        from tqdm import tqdm  # takes longer to import than a small picture to render

        tqdm.monitor_interval = 0  # else it starts a thread, beside which there are no forks
        return tqdm(desc=name, total=rows, unit="row", leave=False)
    return False


def run() -> NoReturn:
    """`main` as a process of its own."""
    install_signal_handlers()
    # No product of matrices here is worth OpenBLAS's threads; starting them would take as long as
    # rendering a small picture.  The variable is read when NumPy is imported.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    # Importing makes tens of thousands of objects, and none is garbage: seldom look for any.
    gc.set_threshold(50_000)
    # All output is flushed by now.  An orderly exit would take NumPy's modules down one by one,
    # and add a tenth to the time of a small picture.
    os._exit(main())


if __name__ == "__main__":
    run()
