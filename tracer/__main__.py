"""The command line: `python -m tracer SCENE.xml [SCENE.xml ...]`.

NumPy takes longer to import than a small picture to render.  What needs it is imported where it
is used, so that `run` can prepare for it, and `--help` and wrong usage do without.
"""

from __future__ import annotations

import argparse
import gc
import os
import sys
from collections.abc import Iterator, Sequence
from contextlib import suppress
from functools import partial
from time import perf_counter
from typing import TYPE_CHECKING, Any, NoReturn

from tracer import __version__
from tracer.commands import (
    allow_interrupts,
    file_name,
    install_signal_handlers,
    is_folder,
    output_paths,
    print_line,
    whole_number,
)
from tracer.messages import printable

if TYPE_CHECKING:
    from tracer.picture.png import Packed

__all__ = ["main", "run"]

_EXAMPLES = """\
examples:
  tracer scenes/one-sphere.xml          write scenes/one-sphere.xml.png
  tracer scenes/*.xml -o pictures/      write every picture to a folder
  tracer room.xml -o room.png --samples 16
                                        smooth edges, as good as 16 samples a pixel

exit status:
  0    all scenes were rendered
  1    some scene could not be read, rendered or written; the others were
  2    wrong usage
  130  interrupted
"""

# A bar is shown once a picture turns out to take longer than this, in seconds.
_SLOW = 1.0


def main(argv: Sequence[str] | None = None) -> int:
    """Render scenes to PNG files.

    Parameters
    ----------
    argv : sequence of str, optional
        The arguments; those of the process if absent.

    Returns
    -------
    int
        Exit status: 0 if all is done, 1 if some scene could not be read, rendered or written, or
        NumPy is not installed, 130 if interrupted.

    Raises
    ------
    SystemExit
        With status 2 for wrong usage, 1 in a folder that is gone, and 0 for ``--help`` and
        ``--version``.
    """
    parser = _parser()
    arguments = parser.parse_args(argv)
    beside = [f"{scene}.png" for scene in arguments.scenes]
    outputs = output_paths(parser, arguments.scenes, arguments.output, beside)
    try:
        status = 0
        for scene, output in zip(arguments.scenes, outputs, strict=True):
            fault = _render(scene, output, arguments)
            if fault is not None:
                print_line(sys.stderr, fault)
                status = 1
        return status
    except ModuleNotFoundError as error:
        package = (error.name or "numpy").partition(".")[0]
        print_line(sys.stderr, f"{error}; install it with python -m pip install {package}")
        return 1
    except KeyboardInterrupt:
        return 130


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="tracer",
        description="Render scenes; each picture is written beside its scene, as SCENE.xml.png.",
        epilog=_EXAMPLES,
        # Looking up the terminal's width would import the whole of shutil.
        formatter_class=partial(argparse.RawDescriptionHelpFormatter, width=88),
    )
    parser.add_argument(
        "scenes", nargs="+", type=file_name, metavar="SCENE.xml", help="a scene file"
    )
    parser.add_argument(
        "-o",
        "--output",
        type=file_name,
        metavar="PATH",
        help="the picture to write, always a PNG, or a folder for those of several scenes;"
        " a folder that ends in / is made if it is missing",
    )
    parser.add_argument(
        "--samples",
        type=whole_number(1),
        default=1,
        metavar="N",
        help="smooth edges as well as N samples a pixel would (default: 1, the pixel's centre)",
    )
    parser.add_argument(
        "--processes",
        type=whole_number(1),
        metavar="N",
        help="processes that render, at most one for each processor (default: one or two,"
        " whichever pays)",
    )
    parser.add_argument("--quiet", action="store_true", help="report only what goes wrong")
    parser.add_argument("--version", action="version", version=f"%(prog)s {__version__}")
    return parser


def _render(scene_path: str, output: str, arguments: argparse.Namespace) -> str | None:
    """Render one scene; return what went wrong, if anything did."""
    from tracer.picture.png import packed, write_bands
    from tracer.picture.rendering import render_each
    from tracer.scene.reader import SceneFileError, load_scene

    allow_interrupts()
    start = perf_counter()
    shown = printable(output)
    try:
        scene = load_scene(scene_path)
    except SceneFileError as error:
        return str(error)
    except MemoryError:
        return f"{printable(scene_path)}: not enough memory to read it; split the scene"
    try:
        if arguments.output is not None and is_folder(arguments.output):
            os.makedirs(arguments.output, exist_ok=True)
        bands = render_each(scene, packed, arguments.samples, processes=arguments.processes)
        if not arguments.quiet and sys.stderr is not None and sys.stderr.isatty():
            bands = _with_progress(bands, scene.height, os.path.basename(shown))
        write_bands(output, scene.width, scene.height, bands)
    except MemoryError:
        size, remedy = f"{scene.width} x {scene.height} pixels", "make the image smaller"
        if arguments.samples > 1:
            size += f" of {arguments.samples} samples"
            remedy += " or take fewer samples"
        return f"{printable(scene_path)}: not enough memory for {size}; {remedy}"
    except OSError as error:
        return f"{shown}: cannot be written: {error.strerror or error}; choose another with -o"
    except ValueError as error:
        return (
            f"{shown}: cannot be written: {error}; keep the numbers of the scene further from 1e308"
        )
    if not arguments.quiet:
        seconds = perf_counter() - start
        print_line(sys.stdout, f"{shown}: {scene.width} x {scene.height} pixels in {seconds:.3f} s")
    return None


def _with_progress(bands: Iterator[Packed], rows: int, name: str) -> Iterator[Packed]:
    """The same bands; shows a bar as soon as the picture turns out to take long."""
    start = perf_counter()
    bar = None
    done = 0
    try:
        for band in bands:
            yield band
            done += band.rows
            seconds = perf_counter() - start
            if bar is None and seconds > _SLOW / 2 and seconds * rows > _SLOW * done:
                bar = _bar(name, rows)
                if bar is None:
                    break
            if bar is not None:
                bar.update(done - bar.n)
        yield from bands
    finally:
        if bar is not None:
            bar.close()


def _bar(name: str, rows: int) -> Any:
    """A progress bar; None where there can be none, for a picture is not to fail by that."""
    # Not installed, or the environment has settings for it that it cannot read.
    with suppress(ImportError, ValueError):
        from tqdm import tqdm  # takes longer to import than a small picture to render

        tqdm.monitor_interval = 0  # else it starts a thread; see `forked`
        return tqdm(desc=name, total=rows, unit="row", leave=False)
    return None


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
