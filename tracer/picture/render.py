"""Render a scene to linear radiance, tile by tile.

tile
    A rectangle of pixels: several whole rows of the picture, or a part of one row.  It is so small
    that its arrays stay in the CPU cache, and so large that the overhead of NumPy calls is
    negligible.  Its pixels depend only on the scene, the samples and the offset, so the picture is
    the same to the last bit, whichever process renders the tile.
crop
    A rectangle of the picture that is rendered instead of all of it.  Its tiles contain whole rows
    of the crop, or a part of one.
adaptive
    In an adaptive picture, edges are found first, and only pixels that edges cross are sampled more
    than once.  Otherwise all pixels have the same samples.

A `RenderJob` is a picture to render.  `render` collects the radiance of all tiles in an array, and
can share them with any executor.  `render_tiles` yields the tiles encoded for a file.

Threads that render at once share a scene, a `RenderJob` and its `PreparedScene`.  These objects do
not change after they are built, except that they store values that are computed on demand, which
are the same in whichever thread they are computed.  If two threads render the same tile of a
picture, they write the same bits.

Radiance is linear RGB.  A `Rectangle` gives the rows and columns of a tile in the picture.
"""

from __future__ import annotations

import io
import operator
import pickle
import warnings
from collections.abc import Generator
from contextlib import closing
from functools import cached_property, lru_cache, partial
from itertools import pairwise, product
from math import isqrt, sqrt
from typing import Annotated as Shaped
from typing import Any, NamedTuple, Protocol, SupportsFloat, SupportsIndex, TypeAlias

import numpy as np

from tracer.antialias.lattice import PIXEL_CENTERS, Lattice
from tracer.antialias.refine import average_pixels, is_supersampling_cheaper
from tracer.arrays import CACHE_SIZE, Floats
from tracer.picture.lint import Exposure, SceneWarning, lint_scene
from tracer.picture.memory import keep_freed_memory
from tracer.picture.parallel import (
    Distribution,
    Executor,
    Threads,
    choose_thread_count,
    count_processors,
)
from tracer.picture.png import compress_tile, write_png
from tracer.scene.model import Scene
from tracer.trace.radiance import compute_radiance
from tracer.world.prepared_scene import PreparedScene

# Infinities and NaN are valid results in NumPy operations of the tracer: for example, the distance
# at which a ray parallel to a plane meets the plane.
_IGNORE_FLOAT_ERRORS = np.errstate(all="ignore")

# Maximum number of samples in a tile, to limit memory (`CACHE_SIZE` is a number of floats).
_MAX_TILE_SAMPLES = 3 * CACHE_SIZE

# Factor by which tiles of an adaptive picture may have more samples: few pixels are divided there,
# and the arrays of their samples should be long, too.
_ADAPTIVE_FACTOR = 4

# Maximum estimated seconds for a tile, so that a bar shows progress and workers share the work
# evenly.
_MAX_TILE_SECONDS = 0.2

# Number of samples per pixel for which the maximum time of a tile is halved.  With more samples, a
# few pixels take most of the time, so some tiles exceed their estimates by more.  At 20,000 samples
# and more, no tile took more than 0.3 s; without this, some took 0.75 s.
_HALVING_SAMPLES = 10_000

# Minimum number of tiles for each processor, to balance the load, if the other limits allow it.
_TILES_PER_PROCESSOR = 4

# Estimated seconds for a picture of any size, for example for reading and preparing a small scene.
_FIXED_SECONDS = 0.003

# Estimated seconds for each sample, light, and object that the ray through the sample meets.  With
# 1 to 100 lights, the measured time was 0.5 to 1.8 times the estimate; with 300, 0.1 times.
_SECONDS_PER_SAMPLE = 4e-8

# The following five constants estimate how many samples a pixel of an adaptive picture takes, if
# n x n are requested.  The measured time of 30 pictures was 0.25 to 2.2 times the estimate.

# Number of samples in a pixel without edges.
_ADAPTIVE_SAMPLES = 2.5

# Each edge in the pixel adds n + n^2 / `_SQUARE_DIVISOR` samples.
_SQUARE_DIVISOR = 100

# The number of edges in a pixel is `_EDGE_FACTOR` / sqrt(number of pixels in the picture) ...
_EDGE_FACTOR = 330

# ... plus this factor times the density of pairs of silhouettes.
_PAIR_FACTOR = 400

# Maximum number of samples that edges add to a pixel, divided by n^2: pixels with many edges are
# sampled on a lattice, however many edges there are.  Without this limit, pictures of 1,000 objects
# at 64 samples took twice as long: they had more tiles, and the pixels around each are classified.
_MAX_ADAPTIVE_FACTOR = 2


class Sharing(NamedTuple):
    """What is worth sharing among workers, in estimated seconds."""

    min_seconds: float  # minimum for a picture, or for all pictures of a command
    min_tile_seconds: float  # minimum for a tile: in smaller ones, the overhead is significant
    # Whether the number of tiles is a multiple of the number of processors, so that few tiles end
    # at about the same time.
    is_even: bool


PROCESSES = Sharing(min_seconds=0.1, min_tile_seconds=0.02, is_even=False)
"""For processes, which take time to start and to prepare the scene."""

THREADS = Sharing(min_seconds=0.02, min_tile_seconds=0.01, is_even=True)
"""For threads of this process."""

# Minimum estimated seconds for a pixel: without objects, the estimate is 0, and any positive number
# does instead.
_MIN_SECONDS_PER_PIXEL = 1e-12

# Maximum number of samples per pixel.
_MAX_SAMPLES = 999_999_999

# Maximum number of unpickled jobs that a process caches: several pictures may be rendered at the
# same time on one executor.
_MAX_CACHED_JOBS = 4

Rectangle: TypeAlias = tuple[slice, slice]
"""Rows and columns of a picture."""

Crop: TypeAlias = tuple[SupportsIndex, SupportsIndex, SupportsIndex, SupportsIndex]
"""A part of a picture: the column and the row of its top left pixel, its width and its height."""


def render(
    scene: Scene,
    samples: SupportsIndex = 1,
    *,
    executor: Executor | None = None,
    offset: tuple[SupportsFloat, SupportsFloat] = (0.0, 0.0),
    crop: Crop | None = None,
    threads: SupportsIndex | None = None,
) -> Floats:
    """Render a scene to an array of linear radiance.

    Parameters
    ----------
    scene : Scene
        The scene, for example from `load_scene`.
    samples : int
        Number of samples per pixel, rounded up to a square, n x n.  The error of the picture (RMSE)
        is at most that of a grid of n x n samples in every pixel, and usually much smaller.  With 1
        sample, rays pass through the centres of the pixels.
    executor : concurrent.futures.Executor, optional
        Renders part of the picture in other processes: a ProcessPoolExecutor, or an executor from
        Dask or loky.  If it is omitted, or the picture is too small to be worth sharing, the
        calling process renders the whole picture.
    offset : (float, float)
        Distances to the right and down, in pixels, by which every sample is shifted.
    crop : (int, int, int, int), optional
        The part of the picture to render: the column and the row of its top left pixel, its width
        and its height.  Every pixel is the same, to the last bit, as in the whole picture.
    threads : int, optional
        Number of threads that render the picture where Python has no global lock (free-threaded
        Python); elsewhere, and with an executor, it is 1.  By default, there is one thread for each
        processor in the main thread of a program, and 1 in other threads and in processes that
        `multiprocessing` has started: many pictures at once are rendered faster if each of them has
        one thread.

    Returns
    -------
    image : (height, width, 3) float64
        Linear RGB radiance of each pixel of the picture or its part.  Row 0 is at the top.

    Raises
    ------
    TypeError
        If `scene` is not a Scene, `samples` or `threads` is not an integer, `crop` is not four
        integers, or `executor` is not an executor.
    ValueError
        If `samples` is less than 1 or more than 999,999,999, `threads` is less than 1, `offset` is
        not two finite numbers, or `crop` has no pixel or is not inside the picture.

    Warns
    -----
    SceneWarning
        If the picture is black, more than half of its lit pixels are brighter than 1, a light or a
        shader has no effect, a colour seems to be given as 0 to 255 instead of 0 to 1, or pixels
        are far from square.  The brightness of a part of a picture is not judged.
    """
    if not isinstance(scene, Scene):
        raise TypeError(f"render takes a Scene, as load_scene returns it; {scene!r} is not a Scene")
    if executor is not None:
        _check_executor(executor)
    job = RenderJob(scene, samples, offset, crop)
    image = _render_image(job, executor, job.choose_thread_count(threads))
    exposure = Exposure.from_radiance(image) if job.is_whole else None
    for warning in lint_scene(scene, job.prepared_scene, exposure):
        warnings.warn(warning, SceneWarning, stacklevel=2)
    return image


def _check_executor(executor: object) -> None:
    """Raise TypeError if an object is not an executor."""
    if not callable(getattr(executor, "submit", None)):
        raise TypeError(f"executor must be a concurrent.futures.Executor, not {executor!r}")
    if hasattr(executor, "get_executor"):
        message = "executor must be a concurrent.futures.Executor"
        raise TypeError(f"{message}: from a Dask client, client.get_executor()")


def _render_image(
    job: RenderJob, executor: Executor | None, thread_count: int
) -> Shaped[Floats, "height width 3"]:
    """Render a picture in threads, or in this process and an executor if one is given."""
    # NumPy gets zeros from calloc, so memory pages that stay black cost nothing.
    image = np.zeros((job.height, job.width, 3))

    def select(rectangle: Rectangle) -> Shaped[Floats, "rows columns 3"]:
        rows, columns = map(_to_inner_range, rectangle, job.rectangle)
        return image[rows, columns]

    def render_into_image(rectangle: Rectangle) -> None:
        job.render_tile(rectangle, out=select(rectangle))

    def fits_tile(rectangle: Rectangle, result: object) -> bool:
        return isinstance(result, np.ndarray) and result.shape == select(rectangle).shape

    with closing(Threads(thread_count - 1)) as pool:
        if executor is None:
            sharing = THREADS if thread_count > 1 else None
            distribution = Distribution[Rectangle, Any](
                function=render_into_image,
                remote_function=render_into_image,
                worker_count=pool.worker_count,
                executor=pool,
            )
        else:
            sharing = PROCESSES if job.seconds >= PROCESSES.min_seconds else None
            distribution = Distribution[Rectangle, Any](
                function=render_into_image,
                remote_function=job.render_tile,
                worker_count=count_processors() if sharing else 0,
                executor=executor,
                is_valid=fits_tile,
            )
        tiles = job.divide(sharing)
        for rectangle, radiance in zip(tiles, distribution.process(tiles), strict=True):
            if radiance is not None:  # from the executor
                select(rectangle)[:] = radiance
    return image


def to_png(
    scene: Scene,
    samples: SupportsIndex = 1,
    *,
    crop: Crop | None = None,
    threads: SupportsIndex | None = None,
) -> bytes:
    """Render a scene to the bytes of a PNG file.

    To render many scenes, let each worker of a pool render whole pictures::

        pool.map(partial(tracer.to_png, samples=4), scenes)

    Parameters
    ----------
    scene : Scene
        The scene to render.
    samples : int
        Number of samples per pixel, as in `render`.
    crop : (int, int, int, int), optional
        The part of the picture to render, as in `render`.
    threads : int, optional
        Number of threads, as in `render`: in a worker, 1 by default.

    Returns
    -------
    png : bytes
        The content of an 8-bit RGB PNG file, as written by `write_png`.

    Raises
    ------
    TypeError
        If `scene` is not a Scene, `samples` or `threads` is not an integer, or `crop` is not four
        integers.
    ValueError
        If `samples` is less than 1 or more than 999,999,999, `threads` is less than 1, or `crop`
        has no pixel or is not inside the picture.
    """
    write_png(file := io.BytesIO(), render(scene, samples, crop=crop, threads=threads))
    return file.getvalue()


class TileEncoder(Protocol):
    """Converts the radiance of a tile to data for a file: for example `compress_tile`."""

    def __call__(
        self, radiance: Shaped[Floats, "rows columns 3"], /, *, is_leftmost: bool = True
    ) -> Any:
        """Encode a tile; `is_leftmost` tells whether it is at the left edge of the picture."""


class EncodedTile(NamedTuple):
    """A rendered tile, in a form for a file."""

    data: Any  # from a `TileEncoder`
    exposure: Exposure


def render_tiles(
    job: RenderJob,
    encode: TileEncoder = compress_tile,
    *,
    threads: SupportsIndex | None = None,
) -> Generator[EncodedTile]:
    """Render and encode the tiles of a picture, by default for a PNG file, in this process.

    For `threads`, see `render`.
    """
    thread_count = job.choose_thread_count(threads)
    rectangles = job.divide(THREADS if thread_count > 1 else None)
    encode_tile = partial(job.encode_tile, encode=encode)
    with closing(Threads(thread_count - 1)) as pool:
        distribution = Distribution(
            function=encode_tile,
            remote_function=encode_tile,
            worker_count=pool.worker_count,
            executor=pool,
        )
        yield from distribution.process(rectangles)


def _compute_samples_per_side(samples: SupportsIndex) -> int:
    """Compute the smallest n for which n x n is at least the requested number of samples.

    Raise TypeError if it is not an integer, and ValueError if it is out of range.
    """
    try:
        sample_count = int(operator.index(samples))  # unlike NumPy integers, ints never overflow
    except TypeError:
        raise TypeError(f"samples must be an int, not {samples!r}") from None
    if sample_count < 1:
        raise ValueError(f"samples must be at least 1, not {sample_count}")
    if sample_count > _MAX_SAMPLES:
        raise ValueError(f"samples must be at most {_MAX_SAMPLES}")
    return isqrt(sample_count - 1) + 1


def _to_rectangle(crop: Crop, scene: Scene) -> Rectangle:
    """Convert a crop to rows and columns; raise TypeError or ValueError if it is not one."""
    try:
        left, top, width, height = map(operator.index, crop)
    except (TypeError, ValueError):
        raise TypeError(f"crop must be four ints: x, y, width, height, not {crop!r}") from None
    if left < 0 or top < 0 or left + width > scene.width or top + height > scene.height:
        extent = f"crop {left},{top},{width},{height} is not inside the picture"
        raise ValueError(f"{extent} of {scene.width} x {scene.height} pixels")
    if width < 1 or height < 1:
        raise ValueError(f"crop must have a width and a height of at least 1, not {crop!r}")
    return slice(top, top + height), slice(left, left + width)


def _to_shift(offset: tuple[SupportsFloat, SupportsFloat]) -> tuple[float, float]:
    """Convert an offset to floats; raise ValueError if it is not two finite numbers."""
    shift = np.asarray(offset, dtype=np.float64)
    if shift.shape != (2,) or not np.isfinite(shift).all():
        raise ValueError(f"offset must be two finite numbers, not {offset!r}")
    right, down = shift.tolist()
    return right, down


class RenderJob:
    """A picture or a crop of it, to be rendered, which can be divided into tiles.

    For arguments, and the errors that they raise, see `render`.  A pickled job contains only its
    arguments.  The process that unpickles it prepares the scene again, which may take longer than
    rendering a tile, so it caches jobs (`_MAX_CACHED_JOBS`).
    """

    scene: Scene
    prepared_scene: PreparedScene
    rectangle: Rectangle  # that is rendered
    width: int  # of the rectangle, in pixels
    height: int
    is_whole: bool  # whether the rectangle is the whole picture
    seconds: float  # rough estimate of the time that one process needs for the picture

    @_IGNORE_FLOAT_ERRORS
    def __init__(
        self,
        scene: Scene,
        samples: SupportsIndex = 1,
        offset: tuple[SupportsFloat, SupportsFloat] = (0.0, 0.0),
        crop: Crop | None = None,
    ) -> None:
        self.scene = scene
        self._arguments = scene, samples, offset, crop
        whole_picture = slice(0, scene.height), slice(0, scene.width)
        self.rectangle = whole_picture if crop is None else _to_rectangle(crop, scene)
        self.height, self.width = (each.stop - each.start for each in self.rectangle)
        self.is_whole = self.rectangle == whole_picture
        per_side = _compute_samples_per_side(samples)
        self._samples_per_side = per_side
        self.prepared_scene = PreparedScene(scene, _to_shift(offset))
        is_antialiased = per_side > 1
        uses_lattice = is_antialiased and is_supersampling_cheaper(self.prepared_scene, per_side)
        self._is_adaptive = is_antialiased and not uses_lattice
        self._lattice = Lattice.choose(per_side) if uses_lattice else PIXEL_CENTERS
        max_samples = _MAX_TILE_SAMPLES * (_ADAPTIVE_FACTOR if self._is_adaptive else 1)
        self._max_samples = self.prepared_scene.choose_batch_size(max_samples)
        self.seconds = _FIXED_SECONDS + self._seconds_per_pixel * self.width * self.height

    @cached_property
    def _seconds_per_pixel(self) -> float:
        """Estimate of the time, in seconds, that one process needs to render a pixel.

        The time is proportional to the number of samples in the pixel, to the number of lights, and
        to the mean number of objects on a ray.
        """
        prepared_scene = self.prepared_scene
        sample_count = (
            self._estimate_adaptive_samples() if self._is_adaptive else self._lattice.size
        )
        seconds_per_hit = _SECONDS_PER_SAMPLE * max(1, prepared_scene.light_count)
        return sample_count * seconds_per_hit * prepared_scene.depth_complexity

    def _estimate_adaptive_samples(self) -> float:
        """Estimate the mean number of samples in a pixel of an adaptive picture."""
        frame = self.prepared_scene.frame
        silhouette_pairs = self.prepared_scene.bounds.estimate_silhouette_pairs(frame)
        pixel_count = frame.width * frame.height
        edges_per_pixel = _EDGE_FACTOR / sqrt(pixel_count) + _PAIR_FACTOR * silhouette_pairs
        samples_per_edge = self._samples_per_side + self._samples_per_side**2 / _SQUARE_DIVISOR
        max_samples = _MAX_ADAPTIVE_FACTOR * self._samples_per_side**2
        return _ADAPTIVE_SAMPLES + min(edges_per_pixel * samples_per_edge, max_samples)

    def choose_thread_count(self, max_threads: SupportsIndex | None) -> int:
        """Choose how many threads render the picture: see the argument `threads` of `render`."""
        max_count = None if max_threads is None else operator.index(max_threads)
        if max_count is not None and max_count < 1:
            raise ValueError(f"threads must be at least 1, not {max_count}")
        return choose_thread_count(max_count) if self.seconds >= THREADS.min_seconds else 1

    def divide(self, sharing: Sharing | None) -> list[Rectangle]:
        """Divide the rectangle into tiles, from top to bottom and from left to right.

        Tiles that workers share may be smaller, so that each processor gets several.
        """
        pixels_per_second = 1 / max(self._seconds_per_pixel, _MIN_SECONDS_PER_PIXEL)
        max_seconds = _MAX_TILE_SECONDS / (1 + self._samples_per_side**2 / _HALVING_SAMPLES)
        max_pixels = min(self._max_samples / self._lattice.size, max_seconds * pixels_per_second)
        divisor = 1
        if sharing:
            fair_share = self.width * self.height / (_TILES_PER_PROCESSOR * count_processors())
            min_pixels = sharing.min_tile_seconds * pixels_per_second
            max_pixels = min(max_pixels, max(min_pixels, fair_share))
            divisor = count_processors() if sharing.is_even else 1
        rows, columns = self.rectangle
        row_ranges = _divide_range(rows, max(1, int(max_pixels / self.width)), divisor)
        return list(product(row_ranges, _divide_range(columns, max(1, int(max_pixels)))))

    def __reduce__(self) -> tuple[Any, ...]:
        return _unpickle_job, (self._pickled_arguments,)

    @cached_property
    def _pickled_arguments(self) -> bytes:
        return pickle.dumps(self._arguments)

    def encode_tile(self, rectangle: Rectangle, encode: TileEncoder) -> EncodedTile:
        """Render and encode a tile."""
        radiance = self.render_tile(rectangle)
        is_leftmost = rectangle[1].start == self.rectangle[1].start
        return EncodedTile(
            data=encode(radiance, is_leftmost=is_leftmost),
            exposure=Exposure.from_radiance(radiance),
        )

    @_IGNORE_FLOAT_ERRORS
    def render_tile(
        self, rectangle: Rectangle, out: Shaped[Floats, "rows columns 3"] | None = None
    ) -> Shaped[Floats, "rows columns 3"]:
        """Render a tile and return its radiance.

        If `out` is given, the radiance is stored in it.  It must contain only zeros, because some
        black pixels are never written.
        """
        keep_freed_memory()
        prepared_scene = self.prepared_scene
        rows, columns = rectangle
        row_count = rows.stop - rows.start
        column_count = columns.stop - columns.start
        radiance = np.zeros((row_count, column_count, 3)) if out is None else out
        # No object is visible in other pixels, so they stay black.
        visible_pixels = prepared_scene.visible_pixels
        visible_rows, visible_columns = map(_intersect_ranges, rectangle, visible_pixels)
        if visible_rows.start >= visible_rows.stop or visible_columns.start >= visible_columns.stop:
            return radiance
        visible_radiance = radiance[_to_inner_range(visible_rows, rows)]
        if self._is_adaptive:
            visible_radiance[:, _to_inner_range(visible_columns, columns)] = average_pixels(
                prepared_scene, visible_rows, visible_columns, self._samples_per_side
            )
            return radiance
        samples = self._lattice.place_in_pixels(visible_rows, columns)
        if self._lattice.size > 1:
            sample_radiance = compute_radiance(prepared_scene, samples)
            visible_radiance[:] = self._lattice.average(sample_radiance, column_count)
        else:
            # The reshaped array is a view, because a tile is whole rows or a part of one row.
            compute_radiance(prepared_scene, samples, out=visible_radiance.reshape(-1, 3).T)
        return radiance


@lru_cache(_MAX_CACHED_JOBS)
def _unpickle_job(pickled_arguments: bytes) -> RenderJob:
    return RenderJob(*pickle.loads(pickled_arguments))


def _intersect_ranges(range_a: slice, range_b: slice) -> slice:
    """Return the overlap of two ranges; if they do not overlap, stop <= start."""
    return slice(max(range_a.start, range_b.start), min(range_a.stop, range_b.stop))


def _to_inner_range(picture_range: slice, outer_range: slice) -> slice:
    """Convert a range of rows or columns of the picture to a range in the one that contains it.

    For example, rows 12 to 15 of the picture are rows 2 to 5 of a tile that starts at row 10.
    """
    return slice(picture_range.start - outer_range.start, picture_range.stop - outer_range.start)


def _divide_range(outer_range: slice, max_length: int, divisor: int = 1) -> list[slice]:
    """Divide a range into as few slices of at most `max_length` as possible.

    If possible, their number is a multiple of `divisor`.  Their lengths differ by at most 1.
    """
    start, length = outer_range.start, outer_range.stop - outer_range.start
    slice_count = -(-length // max_length)
    slice_count = min(length, slice_count + -slice_count % divisor)
    bounds = [start + length * index // slice_count for index in range(slice_count + 1)]
    return [slice(start, stop) for start, stop in pairwise(bounds)]
