"""From a scene to radiance, tile by tile.

A tile is some rows of the picture, or a part of one row: small enough for its arrays to stay in
cache and in memory that is already there, large enough for NumPy's calls to weigh nothing.  Tiles
depend on nothing but the scene, so processes can share them.
"""

from __future__ import annotations

import io
import operator
import pickle
import warnings
from collections.abc import Iterator
from functools import cached_property, lru_cache, partial
from itertools import product
from math import isqrt
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import numpy as np

from tracer.antialias.lattice import CENTRES, Lattice
from tracer.antialias.refine import antialiased, prefers_supersampling
from tracer.arrays import Floats
from tracer.geometry.camera import camera_frame
from tracer.picture.lint import SceneWarning, scene_warnings
from tracer.picture.memory import keep_heap
from tracer.picture.parallel import processors, share, worker_pool
from tracer.picture.png import Compressed, compressed, write_png
from tracer.scene.model import Scene
from tracer.trace.radiance import radiance_at
from tracer.world.prepared_scene import PreparedScene

if TYPE_CHECKING:
    from concurrent.futures import Executor

# Infinities and NaN are valid results here: a slab never left, a sphere not met.
_QUIET = np.errstate(all="ignore")

# Samples in a tile, and the least that pays; both times `_CLASSIFIED` where pixels are classified.
_TILE_SAMPLES, _LEAST_SAMPLES, _CLASSIFIED = 3 << 15, 1 << 15, 4

# Tiles of fewer pixels than this would make a large file; so many for each processor are enough.
_LEAST_PIXELS, _TILES = 1 << 10, 4

# A rough guess of the seconds that a sample takes: for each light and object, up to `_FEW_OBJECTS`;
# `_CLASSIFIED_COST` times that where pixels are classified.
_SECONDS, _FEW_OBJECTS, _CLASSIFIED_COST = 1e-8, 8, 10

# A picture that takes less than so many seconds is drawn by one process.
_WORTH_A_POOL = 0.1

_Part: TypeAlias = tuple[slice, slice]
"""Rows and columns of a picture."""

# The most samples, and processes: with 1e18 samples a picture would never end.
_MOST = 999_999_999


def render(
    scene: Scene,
    samples: int = 1,
    *,
    executor: Executor | None = None,
    offset: tuple[float, float] = (0.0, 0.0),
) -> Floats:
    """Render a scene.

    Parameters
    ----------
    scene : Scene
    samples : int
        Rounded up to a square, n x n: the picture's error (RMSE) is no larger than with a grid of
        n x n samples in every pixel, and mostly much smaller; 1 samples the pixels' centres.
    executor : concurrent.futures.Executor, optional
        Draws a part of the picture: one of processes, of Dask or loky, say.  If absent, this
        process draws alone.
    offset : (float, float)
        Moves every sample, in pixels to the right and down.

    Returns
    -------
    image : (height, width, 3) float64
        Linear RGB radiance; row 0 is the top.

    Raises
    ------
    TypeError
        If `scene` is not a Scene, or `samples` is not an integer.
    ValueError
        If `samples` is less than 1 or more than 999,999,999, or `offset` is not two finite numbers.

    Warns
    -----
    SceneWarning
        If no object is in view, no light reaches any, a colour looks like 0 to 255, or pixels are
        far from square.
    """
    if not isinstance(scene, Scene):
        raise TypeError(f"render takes a Scene, as load_scene returns it; {scene!r} is not a Scene")
    job = _RenderJob(scene, samples, offset, shared=executor is not None)
    remote = partial(_RenderJob.radiance, job)
    # calloc: untouched pages cost nothing.
    image = np.zeros((scene.height, scene.width, 3))

    def draw(part: _Part) -> None:
        job.draw(part, image[part])

    for index, radiance in share(draw, job.tiles, executor, remote):
        if radiance is not None:
            image[job.tiles[index]] = radiance
    # Row by row: this ends at the first that is not black.
    for warning in scene_warnings(scene, black=not any(row.any() for row in image)):
        warnings.warn(warning, SceneWarning, stacklevel=2)
    return image


def to_png(scene: Scene) -> bytes:
    """Render a scene at one sample a pixel, as the bytes of a PNG file."""
    write_png(file := io.BytesIO(), render(scene))
    return file.getvalue()


class Tile(NamedTuple):
    """A part of a picture, ready for a PNG file.

    Attributes
    ----------
    data : Compressed
    pixels : int
        How many there are.
    black : bool
        Whether all of them are.
    """

    data: Compressed
    pixels: int
    black: bool


def render_tiles(scene: Scene, samples: int = 1, *, processes: int | None = None) -> Iterator[Tile]:
    """Render a scene for a program that does nothing else; yield its tiles from the top.

    `processes`: at most so many draw; by default one, or where that pays one for each processor.
    """
    job = _RenderJob(scene, samples, (0.0, 0.0), shared=processes != 1)
    if processes is None:
        processes = processors() if job.seconds >= _WORTH_A_POOL else 1
    count = min(_integer(processes, "processes"), processors(), len(job.tiles))
    if count > 1:
        _ = [*job.prepared.light_batches]  # forks have them
    pool = worker_pool(count - 1, _begin_job, job)
    waiting, first = dict[int, Tile](), 0
    try:
        for index, tile in share(job.tile, job.tiles, pool, _tile_of_job):
            waiting[index] = tile
            while first in waiting:
                yield waiting.pop(first)
                first += 1
    finally:
        if pool:
            pool.shutdown(cancel_futures=True)


def _integer(value: int, name: str) -> int:
    """As a Python integer, checked: NumPy's overflow, and have other methods."""
    try:
        number = int(operator.index(value))
    except TypeError:
        raise TypeError(f"{name} must be an int, is {value!r}") from None
    if number < 1:
        raise ValueError(f"{name} must be at least 1, is {number}")
    if number > _MOST:
        raise ValueError(f"{name} must be at most {_MOST}")
    return number


class _RenderJob:
    """A picture to render, cut into tiles; pickled without what is prepared.

    Parameters
    ----------
    scene, samples, offset
        See `render`.
    shared : bool
        Whether processes may share it: then there are several tiles, if that pays.

    Attributes
    ----------
    tiles : list of (slice, slice)
        Rows and columns of each, from the top and from the left.
    seconds : float
        A rough guess of how long it takes to render.
    """

    @_QUIET
    def __init__(
        self, scene: Scene, samples: int, offset: tuple[float, float], *, shared: bool
    ) -> None:
        self._given = scene, samples, offset, shared
        self._per_side = isqrt(_integer(samples, "samples") - 1) + 1
        shift = np.asarray(offset, dtype=np.float64)
        if shift.shape != (2,) or not np.isfinite(shift).all():
            raise ValueError(f"offset must be two finite numbers, is {offset!r}")
        right, down = shift.tolist()
        width, height = scene.width, scene.height
        frame = camera_frame(scene.camera, width, height, (right, down))
        self.prepared = PreparedScene(scene, frame)
        self._classified = self._per_side > 1 and not prefers_supersampling(
            self.prepared, self._per_side
        )
        supersampled = self._per_side > 1 and not self._classified
        self._lattice = Lattice.of(self._per_side) if supersampled else CENTRES
        lit = 1 + len(scene.lights) * min(len(scene.surfaces), _FEW_OBJECTS)
        cost = lit * (_CLASSIFIED_COST if self._classified else self._lattice.size)
        self.seconds = _SECONDS * width * height * cost
        # Few pixels of a tile are split: larger tiles have enough of them for long arrays.
        times = _CLASSIFIED if self._classified else 1
        at_once, least = _TILE_SAMPLES * times, _LEAST_SAMPLES * times
        size = at_once // self._lattice.size
        if shared:
            enough = width * height // (_TILES * processors())
            size = min(size, max(least // self._lattice.size, enough))
        size = max(_LEAST_PIXELS, size)
        self._at_once = max(1, self.prepared.at_once(at_once) // self._lattice.size)
        rows = _pieces(slice(0, height), max(1, size // width))
        self.tiles = list(product(rows, _pieces(slice(0, width), size)))

    def __reduce__(self) -> tuple[Any, ...]:
        return _unpickled, (self._pickled,)

    @cached_property
    def _pickled(self) -> bytes:
        return pickle.dumps(self._given)

    def tile(self, part: _Part) -> Tile:
        """A part of the picture for a PNG file."""
        radiance = self.radiance(part)
        data = compressed(radiance, from_left=part[1].start == 0)
        return Tile(data, radiance.size // 3, not radiance.any())

    def radiance(self, part: _Part) -> Floats:
        """Radiance of a part of the picture (rows, columns, 3)."""
        rows, columns = part
        out = np.zeros((rows.stop - rows.start, columns.stop - columns.start, 3))
        self.draw(part, out)
        return out

    @_QUIET
    def draw(self, part: _Part, out: Floats) -> None:
        """Write the radiance of a part of the picture into zeros `out` (rows, columns, 3)."""
        keep_heap()
        rows, columns = part
        window = self.prepared.window
        height = max(1, self._at_once // out.shape[1])
        pieces = _pieces(_overlap(rows, window[0]), height), _pieces(columns, self._at_once)
        for piece in product(*pieces):
            here = tuple(
                slice(a.start - b.start, a.stop - b.start) for a, b in zip(piece, part, strict=True)
            )
            self._draw_piece(*piece, out[here])

    def _draw_piece(self, rows: slice, columns: slice, out: Floats) -> None:
        """Write the radiance of a rectangle into zeros `out` (rows, columns, 3)."""
        if self._classified:
            seen = _overlap(columns, self.prepared.window[1])
            if seen.start < seen.stop:
                left, right = seen.start - columns.start, seen.stop - columns.start
                out[:, left:right] = antialiased(self.prepared, rows, seen, self._per_side)
            return
        samples = self._lattice.samples(rows, columns)
        if self._lattice.size > 1:
            out[:] = self._lattice.mean(radiance_at(self.prepared, samples), out.shape[1])
        else:
            radiance_at(self.prepared, samples, out=out.reshape(-1, 3).T)


@lru_cache(maxsize=1)
def _unpickled(pickled: bytes) -> _RenderJob:
    """A job in another process, which draws several of its tiles."""
    scene, samples, offset, shared = pickle.loads(pickled)
    return _RenderJob(scene, samples, offset, shared=shared)


_job: _RenderJob
"""What this process, one of a pool, works on."""


def _begin_job(job: _RenderJob) -> None:
    global _job
    _job = job


def _tile_of_job(part: _Part) -> Tile:
    return _job.tile(part)


def _overlap(a: slice, b: slice) -> slice:
    return slice(max(a.start, b.start), min(a.stop, b.stop))


def _pieces(whole: slice, size: int) -> list[slice]:
    """A range in pieces of `size`, the last of what is left."""
    starts = range(whole.start, whole.stop, size)
    return [slice(start, min(start + size, whole.stop)) for start in starts]
