"""Render many scene files to pictures with all processors.

Several processes can divide the work in two ways.  (1) Each process takes whole scenes: it reads
them, renders them and writes the pictures, so the processes exchange only names and lines of text.
This is best for many scenes.  (2) All processes share the tiles of one picture.  This is best for a
single large picture.

A batch combines both.  It distributes whole scenes, but a worker process refuses a scene that is
large, or that is one of the last and not small.  The main process, which is that of the command,
then renders the scene, and shares the tiles of the picture with the workers.

All workers come from one pool for the whole command.  The pool is started only if the remaining
work takes longer than starting it.  A worker that dies costs time, but no picture, because the
main process repeats whatever a worker has not finished (see `Distribution`).
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from operator import add
from time import perf_counter
from typing import Any, NamedTuple

from tracer.command.arguments import OUTPUT_REMEDY
from tracer.command.failure import Failure, errors_as_failure
from tracer.command.process import end_on_signals, print_line
from tracer.command.progress import Progress
from tracer.files import open_atomically
from tracer.messages import make_printable
from tracer.picture.linear import EXR_MAGIC, NPY_MAGIC, encode_raw, write_exr, write_npy
from tracer.picture.lint import Exposure, lint_scene
from tracer.picture.parallel import Distribution, WorkerPool
from tracer.picture.png import PNG_MAGIC, compress_tile, write_tiles
from tracer.picture.render import MIN_POOL_SECONDS, RenderJob, render_tiles
from tracer.scene.model import Scene
from tracer.scene.reader import load_scene
from tracer.scene.schema import SceneError

FORMATS: dict[str, tuple[bytes, Callable[..., Any], Callable[..., None]]] = {
    "png": (PNG_MAGIC, compress_tile, write_tiles),
    "npy": (NPY_MAGIC, encode_raw, write_npy),
    "exr": (EXR_MAGIC, encode_raw, write_exr),
}
"""Picture formats.  The key is the suffix of the file name.  The value contains the first bytes of
a file, the function that encodes a tile, and the function that writes a file from encoded tiles."""

_BUG = "this is a bug in the tracer; please report it with the scene"
_SHRINK = "make the image smaller or take fewer samples"

# Seconds that a process needs to read a small scene and to write its picture, without rendering.
_SECONDS_PER_SCENE = 0.003

# Maximum estimated seconds of rendering for which one process renders a picture alone, while the
# other processes render other scenes.
_MAX_UNSHARED_SECONDS = 1.0


class Settings(NamedTuple):
    """The settings that all pictures of a command have in common.

    Attributes
    ----------
    samples : int
        Number of samples per pixel.
    size : (int,), (int, int) or None
        Width, or width and height, of the pictures in pixels.  If only a width is given, the aspect
        ratio of each scene file is kept; None keeps the size in the file.
    file_format : str
        Format of the pictures: a key of `FORMATS`.
    quiet : bool
        Whether to print only errors.
    """

    samples: int
    size: tuple[int, ...] | None
    file_format: str
    quiet: bool


class Job(NamedTuple):
    """A scene file to render, and the path of its picture.

    Attributes
    ----------
    scene_path : str
        Path of the scene file; "-" is standard input.
    output_path : str
        Path of the picture; "-" is standard output.
    min_shared_seconds : float
        Minimum estimated rendering time, in seconds, for which all processes share the picture.  A
        picture that takes less time is rendered by a single process.
    """

    scene_path: str
    output_path: str
    min_shared_seconds: float = MIN_POOL_SECONDS


class Report(NamedTuple):
    """The lines to print about a scene whose picture was written or could not be written.

    Attributes
    ----------
    pixel_count : int
        Number of pixels of the picture; 0 if it could not be written.
    line : str
        The line about the picture; empty if it was not written, or the command is quiet.
    notices : tuple of str
        Lines for standard error: why the picture was not written, or warnings about the scene.
    """

    pixel_count: int = 0
    line: str = ""
    notices: tuple[str, ...] = ()


class Batch:
    """A renderer of many scene files, which uses all processors and prints a line for each scene.

    Call `close` at the end: it ends the worker processes.

    Parameters
    ----------
    settings : Settings
        The settings that all pictures have in common.
    max_processes : int
        Maximum number of processes, including the calling process.
    """

    def __init__(self, settings: Settings, max_processes: int) -> None:
        self._settings, self._pool = settings, WorkerPool(max_processes - 1, end_on_signals)
        # The scenes to render; None in a worker process, which renders only single scenes.
        self._distribution: Distribution[Job, Report] | None = None
        # Numbers of finished pictures, and of their pixels.
        self._finished_count = self._pixel_count = 0

    def render(self, jobs: Sequence[Job]) -> bool:
        """Render scenes, write their pictures, and print a line about each scene, in order.

        If a scene cannot be rendered, an error is printed, and the other scenes are still rendered.

        Parameters
        ----------
        jobs : sequence of Job
            The scene files, each with the path of its picture.

        Returns
        -------
        has_succeeded : bool
            Whether all pictures were written.
        """
        self._finished_count, self._pixel_count, has_succeeded = 0, 0, True
        # At the end, too few scenes are left to occupy all processes.  So any large one among them
        # is divided among the processes.
        worker_count = self._pool.worker_count
        unshared_count = len(jobs) - len(jobs) % (worker_count + 1)
        queue = [job._replace(min_shared_seconds=_MAX_UNSHARED_SECONDS) for job in jobs]
        queue[unshared_count:] = jobs[unshared_count:]
        # If a worker fails, for example because it lacks memory, this process repeats its job.
        render_in_worker = partial(_render_in_worker, self._settings)
        self._distribution = Distribution(self._try_render, render_in_worker, queue, worker_count)
        with Progress(len(jobs), "pictures", show=not self._settings.quiet) as self._progress:
            for job, report in zip(jobs, self._distribution, strict=True):
                self._finished_count += 1
                self._pixel_count += report.pixel_count
                has_succeeded &= report.pixel_count > 0
                self._show_progress(0, 0)
                for line in report.notices:
                    print_line(sys.stderr, line)
                if report.line:
                    print_line(sys.stderr if job.output_path == "-" else sys.stdout, report.line)
        return has_succeeded

    def close(self) -> None:
        """End the worker processes, if there are any."""
        self._pool.close()

    def _try_render(self, job: Job) -> Report:
        """Read a scene, render it and write the picture, or report the failure.

        Parameters
        ----------
        job : Job
            The scene file, and the path of its picture.

        Returns
        -------
        report : Report
            The lines to print about the scene.
        """
        try:
            return self._render_to_file(job)
        except Failure as failure:
            return Report(notices=(str(failure),))

    def _render_to_file(self, job: Job) -> Report:
        """Read a scene, render it, and write the picture.

        While the main process renders, it shows the progress and submits scenes to the workers.

        Parameters
        ----------
        job : Job
            The scene file, and the path of its picture.

        Returns
        -------
        report : Report
            The lines to print about the scene.

        Raises
        ------
        Failure
            If the scene cannot be read or rendered, or the picture cannot be written.  In a worker
            process, also if all processes should share the picture.
        """
        start_time, (samples, size, file_format, quiet) = perf_counter(), self._settings
        scene, exposure = read_scene(job.scene_path, size), Exposure()
        magic, encode, write = FORMATS[file_format]

        def encode_tiles(pool: WorkerPool | None) -> Iterator[Any]:
            nonlocal exposure
            for data, tile_exposure in render_tiles(render_job, pool, encode):
                yield data
                exposure = Exposure(*map(add, exposure, tile_exposure))
                if self._distribution is not None:
                    fraction = exposure.pixel_count / (scene.width * scene.height)
                    self._show_progress(fraction, exposure.pixel_count)
                    self._distribution.submit_items()

        with errors_as_failure(
            job.scene_path, "rendered", _BUG, memory_remedy=_SHRINK, error_types=(ValueError,)
        ):
            render_job = RenderJob(scene, samples)
            is_large = render_job.seconds >= job.min_shared_seconds
            if self._distribution is not None:
                remaining_count = len(self._distribution.items) - self._finished_count
                if (render_job.seconds + _SECONDS_PER_SCENE) * remaining_count >= MIN_POOL_SECONDS:
                    self._distribution.executor = self._pool
                    self._distribution.submit_items()
            elif is_large:
                raise Failure(job.scene_path, "all processes should share this picture")
            with (
                errors_as_failure(job.output_path, "written", OUTPUT_REMEDY, memory_remedy=_SHRINK),
                open(1, "wb", closefd=False)
                if job.output_path == "-"
                else open_atomically(job.output_path, magic) as file,
            ):
                tiles = encode_tiles(self._pool if is_large else None)
                write(file, scene.width, scene.height, tiles)
        if quiet:
            return Report(exposure.pixel_count)
        seconds = perf_counter() - start_time
        line = f"{job.output_path}: {scene.width} x {scene.height} pixels in {seconds:.3f} s"
        warnings = lint_scene(scene, render_job.prepared_scene, exposure)
        warning_lines = (make_printable(f"{job.scene_path}: warning: {text}") for text in warnings)
        return Report(exposure.pixel_count, make_printable(line), tuple(warning_lines))

    def _show_progress(self, rendered_fraction: float, rendered_pixel_count: int) -> None:
        """Show progress in pictures and pixels, including the rendered part of the current picture.

        Parameters
        ----------
        rendered_fraction : float
            Rendered fraction of the current picture, from 0 to 1.
        rendered_pixel_count : int
            Number of rendered pixels of the current picture.
        """
        note = f"{(self._pixel_count + rendered_pixel_count) / 1e6:.3g} million pixels"
        self._progress.update(self._finished_count + rendered_fraction, note)


def _render_in_worker(settings: Settings, job: Job) -> Report:
    """Read a scene, render it and write the picture, in a worker process.

    Parameters
    ----------
    settings : Settings
        The settings that all pictures of the command have in common.
    job : Job
        The scene file, and the path of its picture.

    Returns
    -------
    report : Report
        The lines to print about the scene.

    Raises
    ------
    Failure
        If the scene cannot be read or rendered, the picture cannot be written, or all processes
        should share the picture.  A worker cannot read standard input.
    """
    return Batch(settings, max_processes=1)._render_to_file(job)


def read_scene(path: str, size: tuple[int, ...] | None) -> Scene:
    """Read a scene from a file or standard input, and change the size of its picture if requested.

    Parameters
    ----------
    path : str
        Path of the scene file; "-" is standard input.
    size : (int,), (int, int) or None
        Width, or width and height, of the picture in pixels.  If only a width is given, the aspect
        ratio of the scene file is kept; None keeps the size in the file.

    Returns
    -------
    scene : Scene
        The scene, with the requested size.

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
