"""Render many scene files to pictures with all processors.

Several workers can divide the work in two ways.  (1) Each worker takes whole scenes: it reads them,
renders them and writes the pictures, so processes exchange only names and lines of text.  This is
best for many scenes.  (2) All share the tiles of one picture.  This is best for a single large
picture.

A batch combines both.  It has one list of *items* (see `Distribution`): first the scenes, later
also tiles.  The workers and the main thread of the command take items from it.  If a worker takes a
scene that is large, or that is one of the last and not small, it declines the scene.  Then the main
thread reads the scene, puts the tiles of its picture in front of the other items, and writes the
picture from what it and the workers render.

Workers are processes, or threads where Python has no global interpreter lock.  They are started
only if the remaining work takes longer than starting them.
"""

from __future__ import annotations

import sys
from collections.abc import Generator, Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, closing
from dataclasses import replace
from functools import partial
from time import perf_counter
from typing import IO, Any, NamedTuple

from tracer.command.arguments import OUTPUT_REMEDY
from tracer.command.failure import Failure, errors_as_failure
from tracer.command.process import end_on_signals, print_line
from tracer.command.progress import Progress, format_pixel_count
from tracer.files import (
    get_part_prefix,
    open_atomically,
    register_result_folders,
    remove_part_files,
    set_part_prefix,
)
from tracer.messages import make_printable
from tracer.picture.distribution import Distribution
from tracer.picture.formats import FORMATS, EncodedTile, TileEncoder
from tracer.picture.lint import Exposure, lint_scene
from tracer.picture.parallel import Threads, WorkerPool, has_gil
from tracer.picture.render_job import RenderJob
from tracer.picture.tiles import Rectangle
from tracer.scene.model import Scene
from tracer.scene.reader import load_scene
from tracer.scene.schema import SceneError

_BUG = "this is a bug in the tracer; please report it with the scene"
_SHRINK = "make the image smaller or take fewer samples"

# Minimum estimated seconds of a picture that all workers share although they could render other
# scenes.  Sharing a picture takes longer in all, because each process prepares the scene: for
# 10,000 objects, preparing takes as long as rendering 640 x 360 pixels.
_MIN_SHARED_SECONDS = 1.0


class Settings(NamedTuple):
    """The settings that all pictures of a command have in common."""

    samples: int  # number of samples per pixel
    # Width, or width and height, of the pictures in pixels.  If only a width is given, the aspect
    # ratio of each scene file is kept; None keeps the size in the file.
    size: tuple[int, ...] | None
    file_format: str  # a key of `FORMATS`
    quiet: bool  # whether to print only errors
    # The part of each picture to render: x and y of its top left pixel, its width and its height.
    crop: tuple[int, int, int, int] | None = None


class Job(NamedTuple):
    """An item of the list: a scene file to render, and the path of its picture."""

    scene_path: str  # "-" is standard input
    output_path: str  # "-" is standard output
    # All workers share the picture if it takes at least this many seconds, by estimate.  `_Run`
    # chooses the number.
    min_shared_seconds: float = 0.0


class _Tile(NamedTuple):
    """An item of the list: a tile of a picture that all workers share."""

    render_job: RenderJob
    encode: TileEncoder
    rectangle: Rectangle

    def render(self) -> EncodedTile:
        return self.render_job.encode_tile(self.encode, self.rectangle)


class Report(NamedTuple):
    """The lines to print about a scene when its picture has been written, or could not be."""

    pixel_count: int = 0  # 0 if the picture could not be written
    line: str = ""  # line about the picture; empty if it was not written or the command is quiet
    # Lines for standard error: why the picture was not written, or warnings about the scene.
    notices: tuple[str, ...] = ()


class Batch:
    """A renderer of many scene files, which uses all processors and prints a line for each scene.

    Call `close` at the end, so that the workers end.

    Parameters
    ----------
    max_processes
        Maximum number of processes or threads, including the calling one.
    """

    settings: Settings
    pool: WorkerPool | Threads

    def __init__(self, settings: Settings, max_processes: int) -> None:
        self.settings = settings
        worker_count = max_processes - 1
        if has_gil():
            self.pool = WorkerPool(worker_count, partial(_init_worker, get_part_prefix()))
        else:
            self.pool = Threads(worker_count)

    def close(self) -> None:
        """End the workers, if there are any, and remove their incomplete files."""
        self.pool.close()
        remove_part_files()

    def render(self, jobs: Sequence[Job]) -> bool:
        """Render scenes, write their pictures, and print a line about each scene, in order.

        If a scene cannot be rendered, an error is printed, and the other scenes are still rendered.
        Return whether all pictures were written.
        """
        has_succeeded = True
        with Progress(len(jobs), "pictures", show=not self.settings.quiet) as progress:
            reports = _Run(self, jobs, progress).render_scenes()
            for job, report in zip(jobs, reports, strict=True):
                has_succeeded &= report.pixel_count > 0
                for line in report.notices:
                    print_line(sys.stderr, line)
                if report.line:
                    print_line(sys.stderr if job.output_path == "-" else sys.stdout, report.line)
        return has_succeeded


class _Run:
    """The state of one call of `Batch.render`."""

    def __init__(self, batch: Batch, jobs: Sequence[Job], progress: Progress) -> None:
        self._settings = batch.settings
        self._pool = batch.pool
        self._jobs = jobs
        self._progress = progress
        self._finished_count = 0  # number of finished scenes
        self._pixel_count = 0  # number of pixels in the pictures of the finished scenes
        # A worker that declines a scene returns None, which is not valid, so this thread processes
        # the scene.  It also does so if a worker fails, for example because it lacks memory.
        self._distribution = Distribution[Job | _Tile, Any](
            function=self._process,
            remote_function=partial(_process_in_worker, self._settings),
            worker_count=self._pool.worker_count,
            is_valid=lambda _item, result: result is not None,
        )

    def render_scenes(self) -> Iterator[Report]:
        """Render all scenes, and yield their reports in order."""
        for report in self._distribution.process(self._list_items()):
            self._finished_count += 1
            self._pixel_count += report.pixel_count
            self._show_progress(0, 0)
            yield report

    def _list_items(self) -> Iterator[Job]:
        """Yield the scenes, each with the minimum time for which all workers share its picture."""
        # At the end, too few scenes are left to occupy all workers, so they share even small ones.
        last_count = len(self._jobs) % (self._pool.worker_count + 1)
        for index, job in enumerate(self._jobs):
            is_one_of_last = index >= len(self._jobs) - last_count
            min_seconds = self._pool.sharing.min_seconds if is_one_of_last else _MIN_SHARED_SECONDS
            yield job._replace(min_shared_seconds=min_seconds)

    def _process(self, item: Job | _Tile) -> Report | EncodedTile:
        """Render a tile, or a scene of which a failure is reported, in the main thread."""
        if isinstance(item, _Tile):
            return item.render()
        start_time = perf_counter()
        try:
            render_job = _make_render_job(item, self._settings)
            self._start_workers_if_worthwhile(render_job)
            with closing(self._render_tiles(item, render_job)) as tiles:
                return _write_picture(item, self._settings, render_job, tiles, start_time)
        except Failure as failure:
            return Report(notices=(str(failure),))

    def _start_workers_if_worthwhile(self, render_job: RenderJob) -> None:
        """Submit items to the workers, and start them first if the remaining scenes take long.

        `render_job` is the first of the remaining scenes.
        """
        # The other scenes presumably take about as long as this one.
        seconds = render_job.work.seconds * (len(self._jobs) - self._finished_count)
        if seconds >= self._pool.sharing.min_seconds and self._distribution.executor is None:
            register_result_folders(job.output_path for job in self._jobs)
            self._distribution.executor = self._pool
        self._distribution.submit_items()

    def _render_tiles(self, job: Job, render_job: RenderJob) -> Generator[EncodedTile]:
        """Yield all tiles of a picture in order; if it is large, the workers share them.

        After each tile, show the progress, and keep the workers busy.
        """
        encode = FORMATS[self._settings.file_format].encode
        if render_job.work.seconds < job.min_shared_seconds:
            tiles = render_job.render_tiles(encode, max_threads=1)
        else:
            sharing = self._pool.sharing if self._pool.worker_count else None
            tiles = self._distribution.process(
                _Tile(render_job=render_job, encode=encode, rectangle=rectangle)
                for rectangle in render_job.work.divide(sharing)
            )
        all_pixels = render_job.rectangle.width * render_job.rectangle.height
        pixel_count = 0
        with closing(tiles):
            for tile in tiles:
                yield tile
                pixel_count += tile.exposure.pixel_count
                self._show_progress(pixel_count / all_pixels, pixel_count)
                self._distribution.submit_items()

    def _show_progress(self, rendered_fraction: float, rendered_pixel_count: int) -> None:
        """Show progress in pictures and pixels, including those of the current picture.

        `rendered_fraction` is the part of this picture that has been rendered, from 0 to 1.
        """
        note = format_pixel_count(self._pixel_count + rendered_pixel_count)
        self._progress.update(self._finished_count + rendered_fraction, note)


def _init_worker(part_prefix: str) -> None:
    """Prepare a worker process to write pictures, and to end on signals."""
    set_part_prefix(part_prefix)
    end_on_signals()


def _process_in_worker(settings: Settings, item: Job | _Tile) -> Report | EncodedTile | None:
    """Render a tile or a scene in a worker, or return None if the main thread should do this.

    Raise Failure if the scene cannot be read or rendered, or its picture cannot be written.
    """
    if isinstance(item, _Tile):
        return item.render()
    if item.scene_path == "-":  # only the main process can read standard input
        return None
    start_time = perf_counter()
    render_job = _make_render_job(item, settings)
    if render_job.work.seconds >= item.min_shared_seconds:
        return None
    tiles = render_job.render_tiles(FORMATS[settings.file_format].encode, max_threads=1)
    return _write_picture(item, settings, render_job, tiles, start_time)


def _make_render_job(job: Job, settings: Settings) -> RenderJob:
    """Read a scene, and prepare its picture; raise Failure for all that a user can get wrong."""
    scene = read_scene(job.scene_path, settings.size)
    with errors_as_failure(
        job.scene_path, "rendered", memory_remedy=_SHRINK, error_types=(ValueError,)
    ):
        return RenderJob(scene, settings.samples, crop=settings.crop)


def _write_picture(
    job: Job,
    settings: Settings,
    render_job: RenderJob,
    tiles: Iterable[EncodedTile],
    start_time: float,  # when the job began, by `perf_counter`
) -> Report:
    """Write a picture from its tiles, which may be rendered meanwhile.

    Raise Failure if a tile cannot be rendered, or the picture cannot be written.
    """
    file_format = FORMATS[settings.file_format]
    with (
        # What users can get wrong was checked before, so a ValueError is a bug.
        errors_as_failure(job.scene_path, "rendered", _BUG, error_types=(ValueError,)),
        errors_as_failure(job.output_path, "written", OUTPUT_REMEDY, memory_remedy=_SHRINK),
        _open_output(job.output_path, file_format.magic) as file,
    ):
        width, height = render_job.rectangle.width, render_job.rectangle.height
        exposure = file_format.write_picture(file, width, height, tiles)
    if settings.quiet:
        return Report(pixel_count=exposure.pixel_count)
    return _make_report(job, render_job, exposure, seconds=perf_counter() - start_time)


def _open_output(path: str, magic: bytes) -> AbstractContextManager[IO[bytes]]:
    """Open standard output if the path is "-"; otherwise a file that replaces only pictures."""
    if path == "-":
        return open(1, "wb", closefd=False)
    return open_atomically(path, magic)


def _make_report(job: Job, render_job: RenderJob, exposure: Exposure, *, seconds: float) -> Report:
    """Report a picture that was written, with warnings about its scene.

    `exposure` counts its pixels, and `seconds` is the time from reading the scene to the end.
    """
    size = f"{render_job.rectangle.width} x {render_job.rectangle.height}"
    line = f"{job.output_path}: {size} pixels in {seconds:.3f} s"
    whole_exposure = exposure if render_job.is_whole else None
    warnings = lint_scene(render_job.scene, render_job.prepared_scene, whole_exposure)
    return Report(
        pixel_count=exposure.pixel_count,
        line=make_printable(line),
        notices=tuple(make_printable(f"{job.scene_path}: warning: {text}") for text in warnings),
    )


def read_scene(path: str, size: tuple[int, ...] | None) -> Scene:
    """Read a scene from a file or standard input, and change the size of its picture if requested.

    Parameters
    ----------
    path
        Path of the file; "-" is standard input.
    size
        Width, or width and height, of the picture in pixels.  If only a width is given, the aspect
        ratio in the file is kept; None keeps the size in the file.

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
    width = size[0]
    proportional_height = max(1, round(width * scene.height / scene.width))
    height = size[1] if len(size) > 1 else proportional_height
    try:
        return replace(scene, width=width, height=height)
    except SceneError as error:
        raise Failure("--size", str(error)) from error
