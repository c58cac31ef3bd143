"""From a scene to radiance, band by band.

A band is a few rows of the picture: small enough for its arrays to stay in
cache and in memory that is already there, large enough for NumPy's calls to
weigh nothing.  Bands depend on nothing but the scene, so they can be rendered
in any order, side by side, and written out as they come.

A `_Picture` says what to render, `_Bands` how it is cut; a `_Renderer` has the scene
prepared, and renders any band.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Iterator
from functools import partial
from itertools import pairwise, product
from math import inf, isqrt
from typing import TYPE_CHECKING, NamedTuple, TypeVar

import numpy as np

from tracer.antialias.lattice import CENTRES, Lattice
from tracer.arrays import Floats
from tracer.light.lighting import Lighting, lighting_of, radiance_at
from tracer.picture.memory import keep_heap
from tracer.picture.workers import AHEAD, forked, processors
from tracer.scene.model import Scene
from tracer.view.camera import Raster, raster_of
from tracer.view.view import frames_of, view_of

if TYPE_CHECKING:
    from tracer.picture.helpers import Fill

__all__ = ["render", "render_each"]

T = TypeVar("T")

# Infinities and NaN are valid results here: a slab never left, a sphere not met.
_QUIET = np.errstate(all="ignore")

# Samples in a band, and the least that pays; both times `_SPLIT_BANDS` where pixels are split.
_BAND_SAMPLES, _LEAST_SAMPLES = 3 << 15, 1 << 15
_SPLIT_BANDS = 4

# A picture's load grows with its samples, its lights, its objects up to `_FEW_OBJECTS`, and how
# often pixels are split, each time for the work of `_SPLIT` samples.  Last, the loads from which it
# pays to fork, and to ask helpers; the latter times `_SPLIT_BANDS` where pixels are split.
_FEW_OBJECTS, _SPLIT = 8, 3
_WORTH_FORKING, _WORTH_HELP = 1 << 21, 3 << 18

# Of samples and of processors, as in the command: with 1e18 samples a picture would never end.
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
    """
    if not isinstance(scene, Scene):
        raise TypeError(f"render takes a Scene, as load_scene returns it; {scene!r} is none")
    from tracer.picture.helpers import Job, helped

    picture = _Picture.of(scene, samples, offset)
    load = picture.load()
    count = _processes(processes, load >= _WORTH_HELP * picture.larger)
    bands = _Bands.of(picture, count)
    job = Job(partial(_help, bands), (AHEAD, bands.tallest, scene.width, 3))
    # Memory of zeros takes no time where nothing is seen: its pages are never touched.
    image = np.zeros((scene.height, scene.width, 3))
    # Whoever asks for processors by number gets helpers from the first picture on.
    with helped(bands.total, count - 1, job, inf if processes else load) as team:
        renderer = _Renderer.of(bands)

        def work(number: int) -> Floats | None:
            renderer(number, image[bands.rows(number)])
            return None

        for number, band in enumerate(team.results(work)):
            if band is not None:  # a helper's
                rows, columns = bands.rows(number), renderer.columns(number)
                image[rows, columns] = band[: rows.stop - rows.start, columns]
    return image


def render_each(
    scene: Scene,
    work: Callable[[Floats], T],
    samples: int = 1,
    *,
    processes: int | None = None,
    offset: tuple[float, float] = (0.0, 0.0),
) -> Iterator[T]:
    """Render a scene from the top, band by band, and yield what becomes of each.

    Parameters are those of `render`, but other processes are forks, and end with the picture:
    this is for a program that does nothing else.  `work` is called with each band (rows, width,
    3) on the processor that renders it, and returns something small.
    """
    picture = _Picture.of(scene, samples, offset)
    count = _processes(processes, picture.load() >= _WORTH_FORKING)
    bands = _Bands.of(picture, count)
    renderer = _Renderer.of(bands)

    def result(number: int) -> T:
        return work(renderer(number))

    with forked(result, bands.total, count - 1) as team:
        yield from team.results(result)


def _processes(asked: int | None, pays: bool) -> int:
    """As many as are asked for, or else one or two; not more than there are processors."""
    count = (2 if pays else 1) if asked is None else _integer(asked, "processes", 1)
    return min(count, processors())


def _integer(value: int, name: str, least: int) -> int:
    """As a Python integer, checked: NumPy's overflow, and have other methods."""
    try:
        number = int(operator.index(value))
    except TypeError:
        raise TypeError(f"{name} must be an int, is {value!r}") from None
    if number < least:
        raise ValueError(f"{name} must be at least {least}, is {number}")
    if number > _MOST:
        raise ValueError(f"{name} must be at most {_MOST}")
    return number


class _Picture(NamedTuple):
    """What is rendered.

    Attributes
    ----------
    scene : Scene
    raster : Raster
        The rays of the samples that every pixel has.
    lattice : Lattice
        Where these are in a pixel.
    per_side : int
        1, or if pixels are split where they need it: samples along each side of the grid that the
        picture is to be as good as.
    """

    scene: Scene
    raster: Raster
    lattice: Lattice
    per_side: int

    @classmethod
    @_QUIET
    def of(cls, scene: Scene, samples: int, offset: tuple[float, float] = (0.0, 0.0)) -> _Picture:
        """As good as this many samples a pixel, or better: by lattices everywhere, or splitting."""
        samples = _integer(samples, "samples", 1)
        shift = np.asarray(offset, dtype=np.float64)
        if shift.shape != (2,) or not np.isfinite(shift).all():
            raise ValueError(f"offset must be two finite numbers, is {offset!r}")
        right, down = shift.tolist()
        per_side = isqrt(samples - 1) + 1
        raster = raster_of(scene.camera, scene.width, scene.height, (right, down))
        if per_side > 1:
            from tracer.antialias.refine import dense

            if dense(frames_of(raster, scene.surfaces), raster, per_side):
                lattice = Lattice.of(per_side)
                width, height = scene.width * lattice.columns, scene.height * lattice.rows
                offset = right * lattice.columns, down * lattice.rows
                return cls(scene, raster_of(scene.camera, width, height, offset), lattice, 1)
        return cls(scene, raster, CENTRES, per_side)

    @property
    def split(self) -> bool:
        """Whether pixels are split."""
        return self.per_side > 1

    @property
    def larger(self) -> int:
        """How many times as large bands are if pixels are split, and pictures worth help."""
        return _SPLIT_BANDS if self.split else 1

    @_QUIET
    def shares(self, count: int) -> list[int]:
        """`_Bands.tops` of a number of bands, for about as many outlines in each."""
        total = np.cumsum(frames_of(self.raster, self.scene.surfaces).in_rows(self.raster))
        between: list[int] = np.searchsorted(
            total, total[-1] * np.arange(1, count) / count
        ).tolist()
        return [0, *between, self.scene.height]

    def load(self) -> float:
        """About how long it takes to render, in units of some 10 ns."""
        scene = self.scene
        each = 1 + len(scene.lights) * min(len(scene.surfaces), _FEW_OBJECTS)
        often = 0
        if self.split:
            from tracer.antialias.refine import splittings

            often = 1 + splittings(self.per_side)
        return scene.width * scene.height * self.lattice.size * (1 + _SPLIT * often) * each


class _Bands(NamedTuple):
    """A picture in bands.

    Attributes
    ----------
    picture : _Picture
    tops : list of int
        The first row of each band; then the picture's height.
    at_once : int
        At most this many pixels are rendered together.
    """

    picture: _Picture
    tops: list[int]
    at_once: int

    @classmethod
    def of(cls, picture: _Picture, processes: int) -> _Bands:
        """Bands for a number of processes."""
        width, height = picture.scene.width, picture.scene.height
        # Few pixels of a band are split: larger bands have enough of them for long arrays.
        times = picture.larger / picture.lattice.size
        at_once = max(1, int(_BAND_SAMPLES * times))
        step = max(1, at_once // width)
        if processes > 1:
            # Enough bands that all processes end at about the same time, unless they get too small.
            least = _LEAST_SAMPLES * times
            count = max(processes, min(4 * processes, int(width * height / least)))
            step = min(step, -(-height // count))
        tops = [*range(0, height, step), height]
        if picture.split and 1 < processes == len(tops) - 1:
            # One band for each process: with as many outlines, which cost most, not as many rows.
            tops = picture.shares(processes)
        return cls(picture, tops, at_once)

    @property
    def total(self) -> int:
        """How many bands there are."""
        return len(self.tops) - 1

    @property
    def tallest(self) -> int:
        """How many rows the tallest band has."""
        return max(bottom - top for top, bottom in pairwise(self.tops))

    def rows(self, number: int) -> slice:
        """The rows of a band."""
        return slice(self.tops[number], self.tops[number + 1])


class _Renderer(NamedTuple):
    """Renders bands; holds what they share.

    Attributes
    ----------
    bands : _Bands
    lighting : Lighting
    window : (slice, slice)
        Rows and columns of the picture outside of which nothing is seen.
    """

    bands: _Bands
    lighting: Lighting
    window: tuple[slice, slice]

    @classmethod
    @_QUIET
    def of(cls, bands: _Bands) -> _Renderer:
        """Prepare a scene."""
        keep_heap()
        picture = bands.picture
        view = view_of(picture.raster, picture.scene.surfaces)
        lighting = lighting_of(picture.scene, view, picture.split)
        sides = picture.lattice.rows, picture.lattice.columns
        rows, columns = (
            slice(m.start // side, -(-m.stop // side))
            for m, side in zip(view.frames.window(view.raster), sides, strict=True)
        )
        return cls(bands, lighting, (rows, columns))

    def columns(self, number: int) -> slice:
        """Columns in which something may be seen in a band."""
        here, (rows, columns) = self.bands.rows(number), self.window
        return columns if here.start < rows.stop and rows.start < here.stop else slice(0, 0)

    @_QUIET
    def __call__(self, number: int, out: Floats | None = None) -> Floats:
        """Radiance (rows, width, 3) of a band; written into `out`, zeros, if that is given."""
        picture, rows = self.bands.picture, self.bands.rows(number)
        width, lattice = picture.scene.width, picture.lattice
        if out is None:
            out = np.zeros((rows.stop - rows.start, width, 3))
        at_once = self.lighting.view.at_once(self.bands.at_once)
        tall = max(1, at_once // width)
        window, _ = self.window
        first, last = (min(max(m, rows.start), rows.stop) for m in (window.start, window.stop))
        for top, left in product(range(first, last, tall), range(0, width, at_once)):
            part = out[top - rows.start : last - rows.start][:tall, left : left + at_once]
            here = slice(top, top + part.shape[0]), slice(left, left + part.shape[1])
            if picture.split:
                from tracer.antialias.refine import antialiased

                antialiased(self.lighting, *here, picture.per_side, part)
            elif lattice.size > 1:
                radiance = radiance_at(self.lighting, lattice.samples(*here))
                part[:] = lattice.mean(radiance, part.shape[1])
            else:
                radiance_at(self.lighting, lattice.samples(*here), part.reshape(-1, 3).T)
        return out


def _help(bands: _Bands) -> Fill:
    """What a helper does: render bands into the memory that it is given."""
    renderer = _Renderer.of(bands)

    def fill(number: int, slot: Floats) -> None:
        rows = bands.rows(number)
        out = slot[: rows.stop - rows.start]
        out[:, renderer.columns(number)] = 0
        renderer(number, out)

    return fill
