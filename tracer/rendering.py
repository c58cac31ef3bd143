"""From a scene to radiance, band by band.

A band is a few rows of the picture: small enough for its arrays to stay in
cache and in memory that is already there, large enough for NumPy's calls to
weigh nothing.  Bands depend on nothing but the scene, so they can be rendered
in any order, side by side, and written out as they come.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from typing import NamedTuple, TypeVar

import numpy as np

from tracer.antialias import antialiased
from tracer.camera import raster_of
from tracer.lighting import Lighting, lighting_of, radiance_at
from tracer.memory import keep_heap, resident, shared
from tracer.pencil import outlines
from tracer.scene import Floats, Scene
from tracer.visibility import View, grid
from tracer.workers import AHEAD, can_fork, forked

__all__ = ["render", "render_bands", "render_each"]

T = TypeVar("T")

# Infinities and NaN are answers here: a slab never left, a sphere not met.
_QUIET = np.errstate(all="ignore")

# How large bands are, and how small it pays to make them.
_BAND_PIXELS, _LEAST_PIXELS = 3 << 15, 1 << 15

# What a picture takes is roughly in proportion to pixels, lights, (a few) objects and how often
# pixels are split: from so much on, a second processor pays; later, where memory in use makes
# forking slow.
_WORTH_TWO, _PER_BYTE, _FEW_OBJECTS = 1 << 21, 1 / 160, 8


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
        How many processors to use, with a process on each; chosen by the size of
        the picture if absent.
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
    bands = _Bands.of(scene, samples, threads, offset, _BAND_PIXELS)
    # Where nothing is seen, its pages are never touched.
    image = np.zeros((scene.height, scene.width, 3))
    for number, band in enumerate(_rendered(bands, image)):
        if number % bands.workers:
            image[bands.rows(number)] = band
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
    yield from _rendered(_Bands.of(scene, samples, threads, offset, band_pixels))


def render_each(
    scene: Scene, work: Callable[[Floats], T], samples: int = 1, *, threads: int | None = None
) -> Iterator[T]:
    """Render a scene from the top, band by band, and yield what becomes of each.

    Parameters are those of `render`; `work` is called with each band (rows,
    width, 3) on the processor that renders it, and returns something small.
    """
    bands = _Bands.of(scene, samples, threads, (0.0, 0.0), _BAND_PIXELS)

    def result(number: int) -> T:
        return work(bands.render(number))

    yield from forked(result, len(bands.tops), bands.workers)


def _rendered(bands: _Bands, image: Floats | None = None) -> Iterator[Floats]:
    """All bands; those that this process renders itself in their places in the image."""

    def work(number: int) -> Floats:
        if image is None or number % bands.workers:
            return bands.render(number)
        return bands.render(number, image[bands.rows(number)])

    slots = shared((bands.workers - 1, AHEAD, bands.step, bands.scene.width, 3))
    yield from forked(work, len(bands.tops), bands.workers, slots)


class _Bands(NamedTuple):
    """A picture's bands, and all that they share.

    Attributes
    ----------
    scene : Scene
    view : View
    lighting : Lighting
    depth : int
        How often pixels are split at most.
    band_pixels : int
    step : int
        Rows in a band.
    tops : range
        The first row of each.
    workers : int
        Processes that are to render them.
    """

    scene: Scene
    view: View
    lighting: Lighting
    depth: int
    band_pixels: int
    step: int
    tops: range
    workers: int

    @classmethod
    def of(
        cls,
        scene: Scene,
        samples: int,
        threads: int | None,
        offset: tuple[float, float],
        band_pixels: int,
    ) -> _Bands:
        """Prepare a scene."""
        if samples < 1:
            raise ValueError(f"samples must be at least 1, is {samples}")
        keep_heap()
        view, lighting = _prepare(scene, offset, samples)
        # The least power of four that is as many.
        depth = ((samples - 1).bit_length() + 1) // 2
        step = max(1, band_pixels // scene.width)
        pixels = scene.width * scene.height
        if threads is None:
            work = pixels * len(scene.lights) * min(len(scene.surfaces), _FEW_OBJECTS) * (1 + depth)
            pays = can_fork() and work >= _WORTH_TWO + _PER_BYTE * resident()
            threads = 2 if pays else 1
        if threads > 1:
            # Enough bands for all to end at much the same time, unless that makes them small.
            count = max(threads, min(4 * threads, pixels // _LEAST_PIXELS))
            step = min(step, -(-scene.height // count))
        tops = range(0, scene.height, step)
        workers = min(threads, len(tops)) if hasattr(os, "fork") else 1
        return cls(scene, view, lighting, depth, band_pixels, step, tops, workers)

    def rows(self, number: int) -> slice:
        """The rows of a band."""
        top = self.tops[number]
        return slice(top, min(top + self.step, self.scene.height))

    def render(self, number: int, out: Floats | None = None) -> Floats:
        """Radiance (rows, width, 3) of a band; into zeros, if they are given."""
        width, rows = self.scene.width, self.rows(number)
        if out is None:
            out = np.zeros((rows.stop - rows.start, width, 3))
        # A row longer than a band is rendered in parts.
        for left in range(0, width, self.band_pixels):
            right = min(left + self.band_pixels, width)
            self._part(rows, left, right, out[:, left:right])
        return out

    @_QUIET
    def _part(self, rows: slice, left: int, right: int, out: Floats) -> None:
        view, lighting, top, bottom = self.view, self.lighting, rows.start, rows.stop
        if self.depth:
            antialiased(view, lighting, top, bottom, left, right, self.depth, out)
        else:
            radiance_at(view, lighting, grid(top, bottom, left, right), out.reshape(-1, 3).T)


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
