"""Render many scene files to pictures with all processors.

There are two ways to use several processes.  (1) Each process takes whole scenes: it reads them,
renders them and writes the pictures, so that the processes need to exchange only names and lines of
text.  This is best where there are as many scenes as processes or more.  (2) All processes share
the tiles of one picture.  This is best for a single large picture.  So whole scenes are
distributed, but a process returns a scene that is large, or one of the last, and the command's own
process shares the tiles of its picture.

All processes come from one pool for the whole command, which is started only when enough work is
left for this to be worth it.  A worker that dies costs time only: see `Distribution`.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from time import perf_counter
from typing import Any, NamedTuple

from tracer.command.failure import Failure, errors_as_failure
from tracer.command.process import end_on_signals, print_line
from tracer.command.progress import Progress
from tracer.files import atomic_file
from tracer.messages import printable
from tracer.picture.linear import EXR, NPY, raw, write_exr, write_npy
from tracer.picture.lint import Exposure, scene_warnings
from tracer.picture.parallel import Distribution, WorkerPool, in_order
from tracer.picture.png import PNG, compressed, write_tiles
from tracer.picture.render import MIN_POOL_SECONDS, RenderJob, render_tiles
from tracer.scene.model import Scene
from tracer.scene.reader import load_scene
from tracer.scene.schema import SceneError

_BUG = "this is a bug in the tracer; please report it with the scene"
_OTHER_NAME = "choose another with -o"

# Estimated seconds of rendering up to which one process renders a picture alone while there are
# other scenes for the other processes.
_MAX_WHOLE_SECONDS = 1.0


class Settings(NamedTuple):
    """What the arguments of the command say about all pictures.

    Attributes
    ----------
    samples : int
        Number of samples per pixel.
    size : (int,), (int, int) or None
        Width and height of the pictures in pixels, in place of those in the files.  With a width
        only, the proportions of the file are kept.
    file_format : str
        "png", "npy" or "exr".
    folder : str or None
        Folder for the pictures, which is made if it is missing; None if they need no folder.
    """

    samples: int
    size: tuple[int, ...] | None
    file_format: str
    folder: str | None


class Job(NamedTuple):
    """A scene file, and the picture to write.

    Attributes
    ----------
    scene : str
        Path of the scene file; "-" is standard input.
    output : str
        Path of the picture; "-" is standard output.
    max_seconds : float
        Estimated seconds of rendering from which on all processes share the picture.
    """

    scene: str
    output: str
    max_seconds: float = MIN_POOL_SECONDS


class Report(NamedTuple):
    """What there is to print about a scene.

    Attributes
    ----------
    pixels : int
        Number of pixels that were rendered.
    line : str
        The line about the picture, if it was written.
    warnings : tuple of str
        Lines about probable mistakes in the scene.
    failure : Failure or None
        Why the picture was not written.
    """

    pixels: int = 0
    line: str = ""
    warnings: tuple[str, ...] = ()
    failure: Failure | None = None


FORMATS: dict[str, tuple[bytes, Callable[..., Any], Callable[..., None]]] = {
    "png": (PNG, compressed, write_tiles),
    "npy": (NPY, raw, write_npy),
    "exr": (EXR, raw, write_exr),
}
"""Formats of pictures.  For each: the first bytes of a file, the function that encodes a tile, and
the function that writes a file from encoded tiles."""


class _Obsolete(Exception):  # noqa: N818
    """A worker has meanwhile finished the scene that this process is repeating."""


class Batch:
    """Renders scene files with all processors, and prints a line for each.

    Parameters
    ----------
    settings : Settings
        What all pictures have in common.
    processes : int
        Maximum number of processes.
    quiet : bool
        Whether to print only errors.
    """

    def __init__(self, settings: Settings, processes: int, *, quiet: bool) -> None:
        self._settings, self._quiet = settings, quiet
        self._pool = WorkerPool(processes - 1, end_on_signals)

    def render(self, jobs: Sequence[Job]) -> bool:
        """Render scenes, and print a line for each, in the order of `jobs`.

        Returns
        -------
        succeeded : bool
            Whether all pictures were written.
        """
        succeeded = True
        self._done, self._pixels = 0, 0
        unit = "pictures" if len(jobs) > 1 else "picture"
        with Progress(len(jobs), unit, show=not self._quiet) as self._progress:
            for report, job in zip(self._reports(jobs), jobs, strict=True):
                self._done += 1
                self._pixels += report.pixels
                self._show_progress(0, 0)
                succeeded &= report.failure is None
                with self._progress.hidden():
                    self._print(report, job)
        return succeeded

    def close(self) -> None:
        """End the worker processes."""
        self._pool.close()

    def _reports(self, jobs: Sequence[Job]) -> Iterator[Report]:
        """Render scenes, and yield a report about each, in the order of `jobs`."""
        self._work: Distribution[Job, Any] | None = None
        processes, start = self._pool.workers + 1, perf_counter()
        for count, job in enumerate(jobs):
            remaining = len(jobs) - count
            estimated_seconds = (perf_counter() - start) / max(count, 1) * remaining
            if count and processes > 1 and estimated_seconds >= MIN_POOL_SECONDS:
                break
            yield self._render(job)
        else:
            return
        whole = remaining - remaining % processes
        items = [
            job._replace(max_seconds=_MAX_WHOLE_SECONDS) for job in jobs[count : count + whole]
        ]
        items += jobs[count + whole :]
        self._work = Distribution(
            self._render,
            items,
            self._pool,
            partial(_render_whole, self._settings),
            lambda _, result: isinstance(result, Report),
            workers=self._pool.workers,
        )
        yield from in_order(self._work)

    def _render(self, job: Job) -> Report:
        """Render a scene in this process, and share its tiles with the others if it is large."""
        pixels = 0

        def on_tile(tile_pixels: int, total: int) -> None:
            nonlocal pixels
            pixels += tile_pixels
            self._show_progress(pixels / total, pixels)
            if self._work:
                self._work.submit()
                if self._work.is_obsolete:
                    raise _Obsolete

        try:
            return _render_scene(job, self._settings, on_tile, self._pool) or Report()
        except _Obsolete:
            return Report()  # the worker's report is taken instead
        except Failure as failure:
            return Report(failure=failure)

    def _show_progress(self, fraction: float, pixels: int) -> None:
        """Show the progress: pictures that are done, and a fraction or some pixels of the next."""
        note = f"{(self._pixels + pixels) / 1e6:.3g} million pixels"
        self._progress.update(self._done + fraction, note)

    def _print(self, report: Report, job: Job) -> None:
        """Print the lines about a scene."""
        if report.failure:
            print_line(sys.stderr, str(report.failure))
        if not self._quiet:
            for warning in report.warnings:
                print_line(sys.stderr, warning)
            if report.line:
                print_line(sys.stderr if job.output == "-" else sys.stdout, report.line)


def _render_whole(settings: Settings, job: Job) -> Report | None:
    """Render a scene in a worker process; return None if all processes should share it."""
    try:
        return _render_scene(job, settings, lambda *_: None) if job.scene != "-" else None
    except Failure as failure:
        return Report(failure=failure)


def _render_scene(
    job: Job,
    settings: Settings,
    on_tile: Callable[[int, int], None],
    pool: WorkerPool | None = None,
) -> Report | None:
    """Read a scene, render it, and write the picture.

    Parameters
    ----------
    job : Job
        The scene and the picture.
    settings : Settings
        What all pictures have in common.
    on_tile : callable
        Called after each tile with the number of pixels in the tile, and in the picture.
    pool : WorkerPool, optional
        Shares the picture if it is large.  If None, a large picture is not rendered.

    Returns
    -------
    report : Report or None
        None if the picture is so large that all processes should share it, but there is no pool.

    Raises
    ------
    Failure
        If the scene cannot be read or rendered, or the picture not be written.
    """
    start, exposure = perf_counter(), Exposure()
    scene = read_scene(job.scene, settings.size)
    size, pixels = f"{scene.width} x {scene.height} pixels", scene.width * scene.height
    fewer_samples = f" or take fewer samples than {settings.samples}" * (settings.samples > 1)
    rendering_errors = partial(
        errors_as_failure,
        *(job.scene, "rendered", _BUG),
        memory_remedy=f"make the image smaller than {size}{fewer_samples}",
        errors=(ValueError,),
    )
    with rendering_errors():
        render_job = RenderJob(scene, settings.samples)
    is_large = render_job.seconds >= job.max_seconds
    if is_large and pool is None:
        return None
    magic, encode, write = FORMATS[settings.file_format]

    def encoded_tiles() -> Iterator[Any]:
        nonlocal exposure
        with rendering_errors():
            for tile in render_tiles(render_job, pool if is_large else None, encode):
                yield tile.data
                exposure = exposure.including(tile.exposure)
                on_tile(tile.pixels, pixels)

    _make_folder(settings.folder)
    with (
        errors_as_failure(job.output, "written", _OTHER_NAME),
        open(1, "wb", closefd=False)
        if job.output == "-"
        else atomic_file(job.output, magic, is_named=magic == EXR) as file,
    ):
        write(file, scene.width, scene.height, encoded_tiles())
    found = scene_warnings(scene, exposure)
    warnings = tuple(printable(f"{job.scene}: warning: {warning}") for warning in found)
    line = printable(f"{job.output}: {size} in {perf_counter() - start:.3f} s")
    return Report(pixels, line, warnings)


def read_scene(path: str, size: tuple[int, ...] | None) -> Scene:
    """Read a scene from a file, or from standard input.

    Parameters
    ----------
    path : str
        The scene file; "-" is standard input.
    size : (int,), (int, int) or None
        Width and height of the picture in pixels, in place of those in the file.  With a width
        only, the proportions of the file are kept.

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
    proportional_height = max(1, round(size[0] * scene.height / scene.width))
    width, height = (*size, proportional_height)[:2]
    try:
        return replace(scene, width=width, height=height)
    except SceneError as error:
        raise Failure("--size", str(error)) from error


def _make_folder(path: str | None) -> None:
    """Create the folder for the pictures, if they need one and it is missing.

    Raises
    ------
    Failure
        If it cannot be created, or something else has its name.
    """
    if path is not None:
        with errors_as_failure(path, "written", _OTHER_NAME):
            try:
                os.makedirs(path, exist_ok=True)
            except (FileExistsError, NotADirectoryError):  # a file, or a link to nothing
                raise OSError("it is not a folder") from None
