"""A picture that a user asks for: checked, and prepared so that any tile can be rendered.

A *tile* is a rectangle of pixels that is rendered at once.  Its pixels depend only on the scene,
the samples and the offset.  So they are the same to the last bit, whichever thread or process
renders the tile, even if two render it.

Threads may share a scene, a `RenderJob` and its `PreparedScene`.  These objects do not change after
they are built, but some values are computed when they are first needed, and then stored.  Two
threads may both compute such a value, which does no harm, because they get the same result.
"""

from __future__ import annotations

import operator
import pickle
from collections.abc import Callable, Generator
from contextlib import closing
from functools import cached_property, lru_cache, partial
from math import isqrt
from typing import Annotated as Shaped
from typing import Any, SupportsFloat, SupportsIndex, TypeAlias, TypeVar

import numpy as np

from tracer.antialias.lattice import PIXEL_CENTERS, Lattice
from tracer.arrays import Floats
from tracer.picture.formats import EncodedTile, TileEncoder
from tracer.picture.lint import Exposure
from tracer.picture.memory import keep_freed_memory
from tracer.picture.parallel import Distribution, Sharing, Threads
from tracer.picture.tiles import Rectangle, estimate_cost
from tracer.scene.model import Scene
from tracer.trace.radiance import compute_radiance
from tracer.world.prepared_scene import PreparedScene

_Result = TypeVar("_Result")

# Infinities and NaN are valid results in NumPy operations of the tracer: for example, the distance
# at which a ray parallel to a plane meets the plane.
_IGNORE_FLOAT_ERRORS = np.errstate(all="ignore")

# Maximum number of samples per pixel.
_MAX_SAMPLES = 999_999_999

# Maximum number of unpickled jobs that a process caches: several pictures may be rendered at the
# same time on one executor.
_MAX_CACHED_JOBS = 4

Crop: TypeAlias = tuple[SupportsIndex, SupportsIndex, SupportsIndex, SupportsIndex]
"""A part of a picture: the column and the row of its top left pixel, its width and its height."""


class RenderJob:
    """A picture, or a rectangle of it, that is rendered tile by tile.

    A pickled job contains only its arguments.  The process that unpickles it prepares the scene
    again, which may take longer than rendering a tile, so it caches jobs (`_MAX_CACHED_JOBS`).

    Parameters
    ----------
    samples
        Samples per pixel, from 1 to `_MAX_SAMPLES`.  The number is rounded up to a square.
    offset
        Displacement of every ray to the right and down, in pixels.
    crop
        The rectangle; None for the whole picture.

    Raises
    ------
    TypeError
        If `samples` is not an integer, or `crop` is not four integers.
    ValueError
        If `samples` is out of range, `crop` is empty or not inside the picture, or `offset` is not
        two finite numbers.
    """

    scene: Scene
    prepared_scene: PreparedScene
    rectangle: Rectangle  # rows and columns of the picture that are rendered
    width: int  # width of the rectangle, in pixels
    height: int  # height of the rectangle, in pixels
    is_whole: bool  # whether the rectangle is the whole picture
    seconds: float  # rough estimate of the time that one thread needs for the rectangle

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
        self._samples_per_side = _compute_samples_per_side(samples)
        self.prepared_scene = PreparedScene(scene, _to_shift(offset))
        self._lattice = _choose_lattice(self.prepared_scene, self._samples_per_side)
        self._cost = estimate_cost(self.prepared_scene, self._samples_per_side, self._lattice)
        self.seconds = self._cost.estimate_seconds(self.rectangle)

    def divide(self, sharing: Sharing | None) -> list[Rectangle]:
        """Divide the rectangle into tiles, from top to bottom and from left to right.

        If workers share the tiles, `sharing` tells their kind.  Then there are enough tiles to keep
        all processors busy, unless the tiles would be too small.
        """
        return self._cost.divide(self.rectangle, sharing)

    def process_tiles(
        self, process_tile: Callable[[Rectangle], _Result], max_threads: int
    ) -> Generator[_Result]:
        """Call a function for each tile, and yield the results in order.

        A picture that is too small to be worth sharing is rendered in one thread.
        """
        is_shared = max_threads > 1 and self.seconds >= Threads.sharing.min_seconds
        thread_count = max_threads if is_shared else 1
        with closing(Threads(thread_count - 1)) as pool:
            distribution = Distribution(
                function=process_tile,
                remote_function=process_tile,
                worker_count=pool.worker_count,
                executor=pool,
            )
            yield from distribution.process(self.divide(Threads.sharing if is_shared else None))

    def render_tiles(self, encode: TileEncoder, max_threads: int) -> Generator[EncodedTile]:
        """Render and encode all tiles, and yield them in order."""
        return self.process_tiles(partial(self.encode_tile, encode), max_threads)

    def encode_tile(self, encode: TileEncoder, tile: Rectangle) -> EncodedTile:
        """Render a tile, and encode it for a file."""
        radiance = self.render_tile(tile)
        is_leftmost = tile[1].start == self.rectangle[1].start
        return EncodedTile(
            data=encode(radiance, is_leftmost=is_leftmost),
            exposure=Exposure.from_radiance(radiance),
        )

    def find_place(self, tile: Rectangle) -> Rectangle:
        """Find the slices that select the pixels of a tile in an array of the rectangle's pixels.

        The rows and columns of `tile` itself are counted from the top left of the whole picture.
        """
        rows, columns = map(_to_inner_range, tile, self.rectangle)
        return rows, columns

    def __reduce__(self) -> tuple[Any, ...]:
        return _unpickle_job, (self._pickled_arguments,)

    @cached_property
    def _pickled_arguments(self) -> bytes:
        return pickle.dumps(self._arguments)

    @_IGNORE_FLOAT_ERRORS
    def render_tile(
        self, tile: Rectangle, out: Shaped[Floats, "rows columns 3"] | None = None
    ) -> Shaped[Floats, "rows columns 3"]:
        """Render a tile and return its linear RGB radiance.

        If `out` is given, the radiance is stored in it.  It must contain only zeros, because some
        black pixels are never written.
        """
        keep_freed_memory()
        rows, columns = tile
        column_count = columns.stop - columns.start
        if out is None:
            out = np.zeros((rows.stop - rows.start, column_count, 3))
        # Outside these rows and columns, no object is visible, so the pixels stay black.
        visible_pixels = self.prepared_scene.visible_pixels
        visible_rows, visible_columns = map(_intersect_ranges, tile, visible_pixels)
        if visible_rows.start >= visible_rows.stop or visible_columns.start >= visible_columns.stop:
            return out
        out_rows = out[_to_inner_range(visible_rows, rows)]
        if self._lattice is None:
            from tracer.antialias.refine import average_pixels

            out_rows[:, _to_inner_range(visible_columns, columns)] = average_pixels(
                self.prepared_scene, visible_rows, visible_columns, self._samples_per_side
            )
            return out
        # All columns are sampled, not only the visible ones, so that a single sample per pixel can
        # be stored in whole rows of `out`.  Samples that no object covers take little time.
        samples = self._lattice.place_in_pixels(visible_rows, columns)
        if self._lattice.size > 1:
            sample_radiance = compute_radiance(self.prepared_scene, samples)
            out_rows[:] = self._lattice.average(sample_radiance, column_count)
        else:
            # The reshaped array is a view, because a tile is whole rows or a piece of one row.
            compute_radiance(self.prepared_scene, samples, out=out_rows.reshape(-1, 3).T)
        return out


@lru_cache(_MAX_CACHED_JOBS)
def _unpickle_job(pickled_arguments: bytes) -> RenderJob:
    return RenderJob(*pickle.loads(pickled_arguments))


def _choose_lattice(scene: PreparedScene, samples_per_side: int) -> Lattice | None:
    """Choose the samples of all pixels; return None if the picture is adaptive."""
    if samples_per_side == 1:
        return PIXEL_CENTERS
    # Imported on demand: a command that renders one sample per pixel starts 3 % faster without it.
    from tracer.antialias.refine import is_supersampling_cheaper

    if is_supersampling_cheaper(scene, samples_per_side):
        return Lattice.choose(samples_per_side)
    return None


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


def _intersect_ranges(range_a: slice, range_b: slice) -> slice:
    """Return the overlap of two ranges; if they do not overlap, stop <= start."""
    return slice(max(range_a.start, range_b.start), min(range_a.stop, range_b.stop))


def _to_inner_range(picture_range: slice, outer_range: slice) -> slice:
    """Convert a range of rows or columns of the picture to a range in the one that contains it.

    For example, rows 12 to 15 of the picture are rows 2 to 5 of a tile that starts at row 10.
    """
    return slice(picture_range.start - outer_range.start, picture_range.stop - outer_range.start)
