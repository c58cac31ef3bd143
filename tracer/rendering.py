"""From a scene to radiance, band by band.

A band is a few rows of the picture: small enough for its arrays to stay in
cache and in memory that is already there, large enough for NumPy's calls to
weigh nothing.  Bands depend on nothing but the scene, so they can be rendered
in any order, side by side, and written out as they come.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from math import inf
from typing import NamedTuple, TypeVar

import numpy as np

from tracer.antialias import antialiased
from tracer.camera import raster_of
from tracer.helpers import helped
from tracer.lighting import Lighting, lighting_of, radiance_at
from tracer.memory import keep_heap
from tracer.pencil import outlines
from tracer.scene import Floats, Scene
from tracer.visibility import View, grid
from tracer.workers import AHEAD, Job, Work, can_fork, forked

__all__ = ["render", "render_bands", "render_each"]

T = TypeVar("T")

# Infinities and NaN are answers here: a slab never left, a sphere not met.
_QUIET = np.errstate(all="ignore")

# How large bands are, and how small it pays to make them.
_BAND_PIXELS, _LEAST_PIXELS = 3 << 15, 1 << 15

# What a picture takes grows with pixels, lights, (a few) objects and how often pixels are split.
# From so much on it pays to fork, and to ask a helper.
_FEW_OBJECTS = 8
_WORTH_FORKING, _WORTH_HELP = 1 << 21, 1 << 20


def render(
    scene: Scene,
    samples: int = 1,
    *,
    threads: int | None = None,
    offset: tuple[float, float] = (0.0, 0.0),
) -> Floats:
    """Render a scene.

    Parameters
    ----------
    scene : Scene
    samples : int
        The picture is at least as accurate as with so many samples spread
        evenly over every pixel; 1 samples the pixels' centres.
    threads : int, optional
        How many processors to use, with a process on each; one or two, whatever pays, if
        absent.  Processes that help start in the background, and stay for the next picture.
    offset : (float, float)
        Moves every sample by so many pixels to the right and down.

    Raises
    ------
    ValueError
        For fewer than one sample.

    Returns
    -------
    image : (height, width, 3) float64
        Linear RGB radiance; row 0 is the top.
    """
    # Where nothing is seen, its pages are never touched.
    image = np.zeros((scene.height, scene.width, 3))
    for rows, band in _rendered(scene, samples, threads, offset, _BAND_PIXELS, image):
        if not np.may_share_memory(band, image):
            image[rows] = band
    return image


def render_bands(
    scene: Scene,
    samples: int = 1,
    *,
    threads: int | None = None,
    offset: tuple[float, float] = (0.0, 0.0),
    band_pixels: int = _BAND_PIXELS,
) -> Iterator[Floats]:
    """Render a scene from the top, band by band.

    Parameters are those of `render`; `band_pixels` is the size of a band,
    which changes no pixel.

    Yields
    ------
    band : (rows, width, 3) float64
        The next rows of the picture, there until more are asked for.
    """
    for _, band in _rendered(scene, samples, threads, offset, band_pixels):
        yield band


def render_each(
    scene: Scene, work: Callable[[Floats], T], samples: int = 1, *, threads: int | None = None
) -> Iterator[T]:
    """Render a scene from the top, band by band, and yield what becomes of each.

    Parameters are those of `render`, but other processes are forks, and end with the picture:
    this is for a program that does nothing else.  `work` is called with each band (rows, width,
    3) on the processor that renders it, and returns something small.
    """
    processes = threads or (2 if can_fork() and _load(scene, samples) >= _WORTH_FORKING else 1)
    bands = _Bands.of(scene, samples, (0.0, 0.0), _BAND_PIXELS, processes)
    render = _Renderer.of(bands)

    def result(number: int, _: Floats | None) -> T:
        return work(render(number))

    with forked(result, len(bands.tops), processes - 1) as team:
        yield from team.results(result)


def _rendered(
    scene: Scene,
    samples: int,
    threads: int | None,
    offset: tuple[float, float],
    band_pixels: int,
    image: Floats | None = None,
) -> Iterator[tuple[slice, Floats]]:
    """All bands and their rows; those that are rendered here, in their places in the image."""
    load = _load(scene, samples)
    processes = threads or (2 if load >= _WORTH_HELP else 1)
    bands = _Bands.of(scene, samples, offset, band_pixels, processes)
    job = Job(_help, (bands,), (AHEAD, bands.step, scene.width, 3))
    # Who asks for more processors gets them at once.
    load = inf if threads else load
    with helped(len(bands.tops), processes - 1, job, load) as team:
        render = _Renderer.of(bands)

        def work(number: int, _: Floats | None) -> Floats:
            return render(number, None if image is None else image[bands.rows(number)])

        for number, band in enumerate(team.results(work)):
            yield bands.rows(number), band


def _depth(samples: int) -> int:
    """How often pixels are split: to the least power of four that is as many samples."""
    return ((samples - 1).bit_length() + 1) // 2


def _load(scene: Scene, samples: int) -> float:
    """Roughly what a picture takes: some 10 ns for each of these."""
    each = 1 + len(scene.lights) * min(len(scene.surfaces), _FEW_OBJECTS)
    return scene.width * scene.height * each * (1 + _depth(samples))


class _Bands(NamedTuple):
    """A picture in parts.

    Attributes
    ----------
    scene : Scene
    samples : int
    offset : (float, float)
    band_pixels : int
        In a band, at most.
    step : int
        Rows in a band.
    """

    scene: Scene
    samples: int
    offset: tuple[float, float]
    band_pixels: int
    step: int

    @classmethod
    def of(
        cls,
        scene: Scene,
        samples: int,
        offset: tuple[float, float],
        band_pixels: int,
        processes: int,
    ) -> _Bands:
        """Bands for so many processes."""
        if samples < 1:
            raise ValueError(f"samples must be at least 1, is {samples}")
        step = max(1, band_pixels // scene.width)
        if processes > 1:
            # Enough bands for all to end at much the same time, unless that makes them small.
            pixels = scene.width * scene.height
            count = max(processes, min(4 * processes, pixels // _LEAST_PIXELS))
            step = min(step, -(-scene.height // count))
        return cls(scene, samples, offset, band_pixels, step)

    @property
    def tops(self) -> range:
        """The first row of each."""
        return range(0, self.scene.height, self.step)

    def rows(self, number: int) -> slice:
        """The rows of a band."""
        top = self.tops[number]
        return slice(top, min(top + self.step, self.scene.height))


class _Renderer(NamedTuple):
    """Bands, and all that they share."""

    bands: _Bands
    view: View
    lighting: Lighting

    @classmethod
    def of(cls, bands: _Bands) -> _Renderer:
        """Prepare a scene."""
        keep_heap()
        return cls(bands, *_prepare(bands.scene, bands.offset, bands.samples))

    def __call__(self, number: int, out: Floats | None = None) -> Floats:
        """Radiance (rows, width, 3) of a band; in zeros, if they are given."""
        width, rows = self.bands.scene.width, self.bands.rows(number)
        if out is None:
            out = np.zeros((rows.stop - rows.start, width, 3))
        # A row longer than a band is rendered in parts.
        for left in range(0, width, self.bands.band_pixels):
            right = min(left + self.bands.band_pixels, width)
            self._part(rows, left, right, out[:, left:right])
        return out

    @_QUIET
    def _part(self, rows: slice, left: int, right: int, out: Floats) -> None:
        view, lighting, top, bottom = self.view, self.lighting, rows.start, rows.stop
        if depth := _depth(self.bands.samples):
            antialiased(view, lighting, top, bottom, left, right, depth, out)
        else:
            radiance_at(view, lighting, grid(top, bottom, left, right), out.reshape(-1, 3).T)


def _help(bands: _Bands) -> Work[Floats]:
    """What a helper does: render bands where it is told."""
    render = _Renderer.of(bands)

    def work(number: int, slot: Floats | None) -> Floats:
        assert slot is not None
        rows = bands.rows(number)
        out = slot[: rows.stop - rows.start]
        out[:] = 0
        return render(number, out)

    return work


@_QUIET
def _prepare(scene: Scene, offset: tuple[float, float], samples: int) -> tuple[View, Lighting]:
    """Everything that all bands share."""
    surfaces = scene.surfaces
    raster = raster_of(scene.camera, scene.width, scene.height, offset)
    lines = outlines(raster, surfaces)
    in_box = ((surfaces.min_pt <= raster.eye) & (raster.eye <= surfaces.max_pt)).all(axis=1)
    view = View(
        raster=raster,
        surfaces=surfaces,
        outlines=lines,
        eye_inside=np.concatenate([lines.power <= 0, in_box]),
        order=np.concatenate([surfaces.sphere_index, surfaces.box_index]),
    )
    return view, lighting_of(scene, view, samples)
