"""Render many scene files to pictures with all processors.

Several workers can divide the work in two ways.  (1) Each worker takes whole scenes: it reads them,
renders them and writes the pictures, so processes exchange only names and lines of text.  This is
best for many scenes.  (2) All share the tiles of one picture.  This is best for a single large
picture.

A batch combines both.  It has one list of *items* (see `Distribution`), which are scenes and tiles.
A worker declines a scene that is large, or that is one of the last and not small.  The main thread
of the command, which works, too, then reads the scene, puts the tiles of the picture in front of
the other items, and writes the picture.

Workers are processes, or threads where Python has no global interpreter lock.  They are started
only if the remaining work takes longer than starting them.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import closing
from dataclasses import replace
from functools import partial
from operator import add
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
from tracer.picture.linear import (
    EXR_MAGIC,
    NPY_MAGIC,
    encode_float32,
    encode_float64,
    write_exr,
    write_npy,
)
from tracer.picture.lint import Exposure, lint_scene
from tracer.picture.parallel import Distribution, Threads, WorkerPool, has_gil
from tracer.picture.png import PNG_MAGIC, compress_tile, write_tiles
from tracer.picture.render import (
    PROCESSES,
    THREADS,
    EncodedTile,
    Rectangle,
    RenderJob,
    Sharing,
    TileEncoder,
    render_tiles,
)
from tracer.scene.model import Scene
from tracer.scene.reader import load_scene
from tracer.scene.schema import SceneError


class Format(NamedTuple):
    """A picture format."""

    magic: bytes  # the first bytes of a file
    encode: TileEncoder
    # Writes a file from its width, its height and the results of `encode` for all tiles.
    write: Callable[[IO[bytes], int, int, Iterable[Any]], None]


FORMATS: dict[str, Format] = {
    "png": Format(magic=PNG_MAGIC, encode=compress_tile, write=write_tiles),
    "npy": Format(magic=NPY_MAGIC, encode=encode_float64, write=write_npy),
    "exr": Format(magic=EXR_MAGIC, encode=encode_float32, write=write_exr),
}
"""Picture formats, by the suffix of the file name."""

_BUG = "this is a bug in the tracer; please report it with the scene"
_SHRINK = "make the image smaller or take fewer samples"

# Maximum estimated seconds of a picture that one process renders alone, while the others render
# other scenes.  Sharing a picture takes longer in all, because each process prepares the scene: for
# 10,000 objects, preparing takes as long as rendering 640 x 360 pixels.
_MAX_UNSHARED_SECONDS = 1.0


class Settings(NamedTuple):
    """The settings that all pictures of a command have in common."""

    samples: int  # per pixel
    # Width, or width and height, of the pictures in pixels.  If only a width is given, the aspect
    # ratio of each scene file is kept; None keeps the size in the file.
    size: tuple[int, ...] | None
    file_format: str  # a key of `FORMATS`
    quiet: bool  # whether to print only errors
    crop: tuple[int, int, int, int] | None = None  # the part of the pictures: see `render`


class Job(NamedTuple):
    """A scene file to render, and the path of its picture: an item of the list."""

    scene_path: str  # "-" is standard input
    output_path: str  # "-" is standard output
    # Minimum estimated seconds for which all workers share the picture; chosen by `Batch`.
    min_shared_seconds: float = 0.0


class _Tile(NamedTuple):
    """A tile of a picture that all workers share: an item of the list."""

    render_job: RenderJob
    rectangle: Rectangle
    encode: TileEncoder

    def render(self) -> EncodedTile:
        return self.render_job.encode_tile(self.rectangle, self.encode)


class Report(NamedTuple):
    """The lines to print about a scene whose picture was written or could not be written."""

    pixel_count: int = 0  # 0 if the picture could not be written
    line: str = ""  # about the picture; empty if it was not written, or the command is quiet
    # Lines for standard error: why the picture was not written, or warnings about the scene.
    notices: tuple[str, ...] = ()


class Batch:
    """A renderer of many scene files, which uses all processors and prints a line for each scene.

    Call `close` at the end: it ends the workers.

    Parameters
    ----------
    max_processes
        Maximum number of processes or threads, including the calling one.
    """

    _pool: WorkerPool | Threads
    _sharing: Sharing

    def __init__(self, settings: Settings, max_processes: int) -> None:
        self._settings = settings
        worker_count = max_processes - 1
        if has_gil():
            self._pool = WorkerPool(worker_count, partial(_init_worker, get_part_prefix()))
            self._sharing = PROCESSES
        else:
            self._pool = Threads(worker_count)
            self._sharing = THREADS

    def close(self) -> None:
        """End the workers, if there are any, and remove part files of processes."""
        self._pool.close()
        remove_part_files()

    def render(self, jobs: Sequence[Job]) -> bool:
        """Render scenes, write their pictures, and print a line about each scene, in order.

        If a scene cannot be rendered, an error is printed, and the other scenes are still rendered.
        Return whether all pictures were written.
        """
        worker_count = self._pool.worker_count
        # At the end, too few scenes are left to occupy all workers.  So any large one among them is
        # divided.
        unshared_count = len(jobs) - len(jobs) % (worker_count + 1)
        limits = [_MAX_UNSHARED_SECONDS] * unshared_count
        limits += [self._sharing.min_seconds] * (len(jobs) - unshared_count)
        items = [
            job._replace(min_shared_seconds=limit) for job, limit in zip(jobs, limits, strict=True)
        ]
        # If a worker declines a scene or fails, for example because it lacks memory, this thread
        # renders the scene.
        self._distribution = Distribution[Job | _Tile, Any](
            function=self._process,
            remote_function=partial(_process_in_worker, self._settings),
            worker_count=worker_count,
            is_valid=lambda _item, result: result is not None,
        )
        # Numbers of finished scenes, and of pixels in their pictures.
        self._finished_count = self._pixel_count = 0
        self._job_count = len(jobs)
        has_succeeded = True
        self._unshared_paths = [job.output_path for job in jobs]  # see `register_result_folders`
        with Progress(len(jobs), "pictures", show=not self._settings.quiet) as self._progress:
            for job, report in zip(jobs, self._distribution.process(items), strict=True):
                self._finished_count += 1
                self._pixel_count += report.pixel_count
                has_succeeded &= report.pixel_count > 0
                self._show_progress(0, 0)
                for line in report.notices:
                    print_line(sys.stderr, line)
                if report.line:
                    print_line(sys.stderr if job.output_path == "-" else sys.stdout, report.line)
        return has_succeeded

    def _process(self, item: Job | _Tile) -> Report | EncodedTile:
        """Process an item in the main thread.

        While a scene is rendered, the progress is shown, and items are submitted to the workers.
        """
        if isinstance(item, _Tile):
            return item.render()
        start_time = perf_counter()
        encode = FORMATS[self._settings.file_format].encode
        try:
            render_job = _make_render_job(item, self._settings)
            # The other scenes presumably take about as long.
            seconds = render_job.seconds * (self._job_count - self._finished_count)
            if seconds >= self._sharing.min_seconds:
                self._use_workers()
            if render_job.seconds >= item.min_shared_seconds:
                rectangles = render_job.divide(self._sharing if self._pool.worker_count else None)
                items = [
                    _Tile(render_job=render_job, rectangle=rectangle, encode=encode)
                    for rectangle in rectangles
                ]
                tiles = self._distribution.process(items)
            else:
                tiles = render_tiles(render_job, encode, threads=1)
            with closing(tiles):
                tracked_tiles = self._track(render_job, tiles)
                return _write_picture(item, self._settings, render_job, tracked_tiles, start_time)
        except Failure as failure:
            return Report(notices=(str(failure),))

    def _use_workers(self) -> None:
        """Start submitting items to the workers."""
        register_result_folders(self._unshared_paths)
        self._unshared_paths.clear()
        self._distribution.executor = self._pool

    def _track(self, render_job: RenderJob, tiles: Iterator[EncodedTile]) -> Iterator[EncodedTile]:
        """Yield tiles of a picture; after each, show the progress, and keep the workers busy."""
        all_pixels = render_job.width * render_job.height
        pixel_count = 0
        self._distribution.submit_items()
        for tile in tiles:
            yield tile
            pixel_count += tile.exposure.pixel_count
            self._show_progress(pixel_count / all_pixels, pixel_count)
            self._distribution.submit_items()

    def _show_progress(self, rendered_fraction: float, rendered_pixel_count: int) -> None:
        """Show progress in pictures and pixels, including the rendered part of the current picture.

        The fraction is from 0 to 1.
        """
        note = format_pixel_count(self._pixel_count + rendered_pixel_count)
        self._progress.update(self._finished_count + rendered_fraction, note)


def _init_worker(part_prefix: str) -> None:
    """Prepare a worker process to write pictures, and to end on signals."""
    set_part_prefix(part_prefix)
    end_on_signals()


def _process_in_worker(settings: Settings, item: Job | _Tile) -> Report | EncodedTile | None:
    """Process an item in a worker, or return None if the main thread should process it.

    Raise Failure if this fails.
    """
    if isinstance(item, _Tile):
        return item.render()
    if item.scene_path == "-":  # only the main process can read standard input
        return None
    start_time = perf_counter()
    render_job = _make_render_job(item, settings)
    if render_job.seconds >= item.min_shared_seconds:
        return None
    tiles = render_tiles(render_job, FORMATS[settings.file_format].encode, threads=1)
    return _write_picture(item, settings, render_job, tiles, start_time)


def _make_render_job(job: Job, settings: Settings) -> RenderJob:
    """Read a scene, and prepare its picture.

    Raise Failure for everything that a user can get wrong.  So whatever raises ValueError later is
    a bug.
    """
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
    start_time: float,  # of `perf_counter`
) -> Report:
    """Write a picture from its tiles, which are rendered meanwhile; raise Failure if this fails."""
    exposure = Exposure()
    file_format = FORMATS[settings.file_format]

    def list_data() -> Iterator[Any]:
        nonlocal exposure
        for tile in tiles:
            exposure = Exposure(*map(add, exposure, tile.exposure))
            yield tile.data

    with (
        errors_as_failure(job.scene_path, "rendered", _BUG, error_types=(ValueError,)),
        errors_as_failure(job.output_path, "written", OUTPUT_REMEDY, memory_remedy=_SHRINK),
        open(1, "wb", closefd=False)
        if job.output_path == "-"
        else open_atomically(job.output_path, file_format.magic) as file,
    ):
        file_format.write(file, render_job.width, render_job.height, list_data())
    if settings.quiet:
        return Report(pixel_count=exposure.pixel_count)
    return _make_report(job, render_job, exposure, seconds=perf_counter() - start_time)


def _make_report(job: Job, render_job: RenderJob, exposure: Exposure, *, seconds: float) -> Report:
    """Report a picture that was written in the given time, with warnings about its scene."""
    line = f"{job.output_path}: {render_job.width} x {render_job.height} pixels in {seconds:.3f} s"
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
        "-" is standard input.
    size
        As in `Settings`.

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
