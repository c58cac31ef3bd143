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
from tracer.picture.distribution import Distribution
from tracer.picture.formats import EncodedTile, TileEncoder
from tracer.picture.lint import Exposure
from tracer.picture.memory import keep_freed_memory
from tracer.picture.parallel import Threads
from tracer.picture.tiles import Rectangle, Work, estimate_work
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
    is_whole: bool  # whether the rectangle is the whole picture
    work: Work  # the rendering of the rectangle, which can be divided into tiles

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
        whole_picture = Rectangle(rows=slice(0, scene.height), columns=slice(0, scene.width))
        self.rectangle = whole_picture if crop is None else _to_rectangle(crop, scene)
        self.is_whole = self.rectangle == whole_picture
        self._samples_per_side = _compute_samples_per_side(samples)
        self.prepared_scene = PreparedScene(scene, _to_shift(offset))
        self._lattice = _choose_lattice(self.prepared_scene, self._samples_per_side)
        self.work = estimate_work(
            self.prepared_scene, self.rectangle, self._samples_per_side, self._lattice
        )

    def process_tiles(
        self, process_tile: Callable[[Rectangle], _Result], max_threads: int
    ) -> Generator[_Result]:
        """Call a function for each tile, and yield the results in order.

        A picture that is too small to be worth sharing is rendered in one thread.
        """
        if max_threads == 1 or self.work.seconds < Threads.sharing.min_seconds:
            yield from map(process_tile, self.work.divide(None))
            return
        with closing(Threads(max_threads - 1)) as pool:
            distribution = Distribution(
                function=process_tile,
                remote_function=process_tile,
                worker_count=pool.worker_count,
                executor=pool,
            )
            yield from distribution.process(self.work.divide(pool.sharing))

    def render_tiles(self, encode: TileEncoder, max_threads: int) -> Generator[EncodedTile]:
        """Render and encode all tiles, and yield them in order."""
        return self.process_tiles(partial(self.encode_tile, encode), max_threads)

    def encode_tile(self, encode: TileEncoder, tile: Rectangle) -> EncodedTile:
        """Render a tile, and encode it for a file."""
        radiance = self.render_tile(tile)
        is_leftmost = tile.columns.start == self.rectangle.columns.start
        return EncodedTile(
            data=encode(radiance, is_leftmost=is_leftmost),
            exposure=Exposure.from_radiance(radiance),
        )

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
        if out is None:
            out = np.zeros((tile.height, tile.width, 3))
        # Outside this rectangle, no object is visible, so the pixels stay black.
        visible = tile.intersect(*self.prepared_scene.visible_pixels)
        if visible.height <= 0 or visible.width <= 0:
            return out
        place = visible.relative_to(tile)
        if self._lattice is None:
            from tracer.antialias.refine import average_pixels

            out[place] = average_pixels(
                self.prepared_scene, visible.rows, visible.columns, self._samples_per_side
            )
            return out
        # All columns are sampled, not only the visible ones, so that a single sample per pixel can
        # be stored in whole rows of `out`.  Samples that no object covers take little time.
        out_rows = out[place.rows]
        samples = self._lattice.place_in_pixels(visible.rows, tile.columns)
        if self._lattice.size > 1:
            sample_radiance = compute_radiance(self.prepared_scene, samples)
            out_rows[:] = self._lattice.average(sample_radiance, tile.width)
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
    return Rectangle(rows=slice(top, top + height), columns=slice(left, left + width))


def _to_shift(offset: tuple[SupportsFloat, SupportsFloat]) -> tuple[float, float]:
    """Convert an offset to floats; raise ValueError if it is not two finite numbers."""
    shift = np.asarray(offset, dtype=np.float64)
    if shift.shape != (2,) or not np.isfinite(shift).all():
        raise ValueError(f"offset must be two finite numbers, not {offset!r}")
    right, down = shift.tolist()
    return right, down
