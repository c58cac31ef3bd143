"""From a scene to radiance, tile by tile.

A tile is some rows of the picture, or a part of one row: small enough for its arrays to stay in
cache and in memory that is already there, large enough for NumPy's calls to weigh nothing.  Tiles
depend on nothing but the scene, so processes can share them, and they are written out in order.
"""

from __future__ import annotations

import io
import operator
import pickle
import warnings
from collections.abc import Iterator
from contextlib import closing
from functools import cached_property
from itertools import product
from math import inf, isqrt
from mmap import mmap

import numpy as np

from tracer.antialias.lattice import CENTRES, Lattice
from tracer.arrays import Floats
from tracer.light.lighting import Lighting, lighting_of, radiance_at
from tracer.picture.memory import keep_heap
from tracer.picture.parallel import Work, forked, helped, processors
from tracer.picture.png import Compressed, compressed, write_png
from tracer.scene.model import Scene
from tracer.suspicions import SceneWarning, suspicions
from tracer.view.camera import raster_of
from tracer.view.view import view_of

__all__ = ["render", "render_compressed", "to_png"]

# Infinities and NaN are valid results here: a slab never left, a sphere not met.
_QUIET = np.errstate(all="ignore")

# Samples in a tile, and the least that pays; both times `_SPLIT` where pixels are split.
_TILE_SAMPLES, _LEAST_SAMPLES, _SPLIT = 3 << 15, 1 << 15, 4

# Tiles of fewer pixels than this would make a large file; so many for each process are enough.
_LEAST_PIXELS, _TILES = 1 << 10, 4

# A picture's load, in units of some 10 ns, grows with its samples, its lights and its objects up to
# `_FEW_OBJECTS`; where pixels are split they count `_SPLIT_LOAD` times.  From the last of these on
# a second process pays.
_FEW_OBJECTS, _SPLIT_LOAD, _WORTH_SHARING = 8, 10, 1 << 20

# Of samples and of processes, as in the command: with 1e18 samples a picture would never end.
_MOST = 999_999_999


def render(
    scene: Scene,
    samples: int = 1,
    *,
    processes: int | None = None,
    offset: tuple[float, float] = (0.0, 0.0),
) -> Floats:
    """Render a scene.

    Parameters
    ----------
    scene : Scene
    samples : int
        Rounded up to a square, n x n: the picture's error (RMSE) is no larger than with a grid of
        n x n samples in every pixel, and mostly much smaller; 1 samples the pixels' centres.
    processes : int, optional
        How many processes render, this one included, and no more than there are processors; if
        absent, one or two, whichever pays.  The others start in the background, and stay for the
        next picture.
    offset : (float, float)
        Moves every sample, in pixels to the right and down.

    Returns
    -------
    image : (height, width, 3) float64
        Linear RGB radiance; row 0 is the top.

    Raises
    ------
    TypeError
        If `scene` is not a Scene, or `samples` or `processes` is not an integer.
    ValueError
        If `samples` or `processes` is less than 1 or more than 999,999,999, or `offset` is not two
        finite numbers.

    Warns
    -----
    SceneWarning
        If no object is in view, no light reaches any, or a colour looks like 0 to 255.
    """
    if not isinstance(scene, Scene):
        raise TypeError(f"render takes a Scene, as load_scene returns it; {scene!r} is none")
    picture = _Picture(scene, samples, offset, processes)
    # Memory of zeros takes no time where nothing is seen: its pages are never touched.
    image = np.zeros((scene.height, scene.width, 3))
    # Whoever asks for processes by number gets helpers from the first picture on.
    load = inf if processes else picture.load
    others, size = picture.processes - 1, image.nbytes

    def work(number: int) -> None:
        picture.draw(number, image[picture.tile(number)])

    with closing(helped(picture.tiles, others, size, picture.drawing, work, load)) as done:
        for number, memory in done:
            if memory is not None:
                seen = picture.seen(number)
                image[seen] = picture.image_in(memory)[seen]
    # Row by row: this ends at the first that is not black.
    for suspicion in suspicions(scene, black=not any(row.any() for row in image)):
        warnings.warn(suspicion, SceneWarning, stacklevel=2)
    return image


def to_png(scene: Scene) -> bytes:
    """Render a scene at one sample a pixel, as the bytes of a PNG file."""
    write_png(file := io.BytesIO(), render(scene))
    return file.getvalue()


def render_compressed(
    scene: Scene, samples: int = 1, *, processes: int | None = None
) -> Iterator[Compressed]:
    """Render a scene for a PNG file, and yield its tiles from the top.

    Parameters are those of `render`, but other processes are forks, and end with the picture: this
    is for a program that does nothing else.
    """
    picture = _Picture(scene, samples, (0.0, 0.0), processes)
    # Deflate adds a few bytes to what it cannot compress.
    rows, columns = picture.tile(0)
    place = 4 * (rows.stop - rows.start) * (columns.stop + 1) + 1000
    waiting, written = dict[int, Compressed](), 0

    def made(number: int) -> Compressed:
        rows, columns = picture.tile(number)
        radiance = np.zeros((rows.stop - rows.start, columns.stop - columns.start, 3))
        picture.draw(number, radiance)
        return compressed(radiance, from_left=columns.start == 0)

    def work(number: int) -> None:
        waiting[number] = made(number)

    def job(memory: mmap) -> Work:
        _ = picture.prepared  # before the processes part

        def store(number: int) -> None:
            memory.seek(number * place)
            pickle.dump(made(number), memory)

        return store

    others, size = picture.processes - 1, picture.tiles * place
    with closing(forked(picture.tiles, others, size, job, work)) as done:
        for number, memory in done:
            if memory is not None:
                memory.seek(number * place)
                waiting[number] = pickle.load(memory)
            while written in waiting:
                yield waiting.pop(written)
                written += 1


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


class _Picture:
    """A picture to render, and how it is cut into tiles; picklable until the first is drawn.

    Parameters
    ----------
    scene, samples, offset, processes
        See `render`.

    Attributes
    ----------
    load : float
        About how long it takes to render, in units of some 10 ns.
    processes, tiles : int
        How many there are; tiles are numbered from the top and from the left.
    """

    @_QUIET
    def __init__(
        self,
        scene: Scene,
        samples: int,
        offset: tuple[float, float],
        processes: int | None,
    ) -> None:
        shift = np.asarray(offset, dtype=np.float64)
        per_side = isqrt(_integer(samples, "samples") - 1) + 1
        if shift.shape != (2,) or not np.isfinite(shift).all():
            raise ValueError(f"offset must be two finite numbers, is {offset!r}")
        width, height = scene.width, scene.height
        right, down = shift.tolist()
        self.scene, self._per_side, self._lattice = scene, per_side, CENTRES
        self._raster = raster_of(scene.camera, width, height, (right, down))
        if per_side > 1:
            from tracer.antialias.refine import dense

            if dense(view_of(self._raster, scene.surfaces), per_side):
                self._lattice = lattice = Lattice.of(per_side)
                columns, rows = lattice.columns, lattice.rows
                self._per_side, moved = 1, (right * columns, down * rows)
                self._raster = raster_of(scene.camera, width * columns, height * rows, moved)
        split, pixels = self._per_side > 1, width * height
        lit = 1 + len(scene.lights) * min(len(scene.surfaces), _FEW_OBJECTS)
        self.load = pixels * self._lattice.size * lit * (_SPLIT_LOAD if split else 1)
        asked = (2 if self.load >= _WORTH_SHARING else 1) if processes is None else processes
        self.processes = min(_integer(asked, "processes"), processors())
        # Few pixels of a tile are split: larger tiles have enough of them for long arrays.
        times = (_SPLIT if split else 1) / self._lattice.size
        self._at_once, least = (max(1, int(n * times)) for n in (_TILE_SAMPLES, _LEAST_SAMPLES))
        size = self._at_once
        if self.processes > 1:
            size = min(size, max(least, pixels // (_TILES * self.processes)))
            size = min(size, -(-pixels // self.processes))
        size = max(_LEAST_PIXELS, size)
        self._rows = _pieces(slice(0, height), max(1, size // width))
        self._columns = _pieces(slice(0, width), size)
        self.tiles = len(self._rows) * len(self._columns)

    def tile(self, number: int) -> tuple[slice, slice]:
        """Rows and columns of a tile."""
        row, column = divmod(number, len(self._columns))
        return self._rows[row], self._columns[column]

    @cached_property
    @_QUIET
    def prepared(self) -> tuple[Lighting, tuple[slice, slice]]:
        """The lighting, and the rows and columns of pixels in which something may be seen."""
        view = view_of(self._raster, self.scene.surfaces)
        rows, columns = view.frames.window(view.raster)
        across, down = self._lattice
        lighting = lighting_of(self.scene, view)
        keep_heap()  # of what is drawn: what was needed to prepare it is given back
        return lighting, (
            slice(rows.start // down, -(-rows.stop // down)),
            slice(columns.start // across, -(-columns.stop // across)),
        )

    def seen(self, number: int) -> tuple[slice, ...]:
        """Rows and columns of a tile in which something may be seen."""
        both = zip(self.tile(number), self.prepared[1], strict=True)
        return tuple(slice(max(a.start, b.start), min(a.stop, b.stop)) for a, b in both)

    def image_in(self, memory: mmap) -> Floats:
        """The picture (height, width, 3) in memory."""
        height, width = self.scene.height, self.scene.width
        return np.frombuffer(memory, count=height * width * 3).reshape(height, width, 3)

    def drawing(self, memory: mmap) -> Work:
        """Return what draws tiles of the picture in shared memory."""
        image = self.image_in(memory)

        def work(number: int) -> None:
            image[self.seen(number)] = 0  # where the last picture may still be
            self.draw(number, image[self.tile(number)])

        return work

    @_QUIET
    def draw(self, number: int, out: Floats) -> None:
        """Write the radiance of a tile into zeros `out` (rows, columns, 3)."""
        (tile_rows, tile_columns), (seen, _) = self.tile(number), self.seen(number)
        top, left = tile_rows.start, tile_columns.start
        lattice, lighting = self._lattice, self.prepared[0]
        split = self._per_side > 1
        at_once = (lighting if split else lighting.view).at_once(self._at_once)
        tall = max(1, at_once // (tile_columns.stop - left))
        for rows, columns in product(_pieces(seen, tall), _pieces(tile_columns, at_once)):
            part = out[
                rows.start - top : rows.stop - top, columns.start - left : columns.stop - left
            ]
            if split:
                from tracer.antialias.refine import antialiased

                antialiased(lighting, rows, columns, self._per_side, part)
            elif lattice.size > 1:
                radiance = radiance_at(lighting, lattice.samples(rows, columns))
                part[:] = lattice.mean(radiance, part.shape[1])
            else:
                radiance_at(lighting, lattice.samples(rows, columns), part.reshape(-1, 3).T)


def _pieces(whole: slice, size: int) -> list[slice]:
    """A range in pieces of `size`, the last of what is left."""
    starts = range(whole.start, whole.stop, size)
    return [slice(start, min(start + size, whole.stop)) for start in starts]
