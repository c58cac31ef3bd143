"""From a scene to radiance, band by band.

A band is a few rows of the picture: small enough for its arrays to stay in
cache and in memory that is already there, large enough for NumPy's calls to
weigh nothing.  Bands depend on nothing but the scene, so they can be rendered
in any order, side by side, and written out as they come.
"""

from __future__ import annotations

import os
from collections.abc import Iterator

import numpy as np

from tracer.antialias import antialiased
from tracer.camera import raster_of
from tracer.lighting import Lighting, incidence, lighting_of, shade
from tracer.pencil import outlines
from tracer.scene import Floats, Scene
from tracer.visibility import View, grid, visible
from tracer.workers import can_fork, forked

__all__ = ["render", "render_bands"]

# Infinities and NaN are answers here: a slab never left, a sphere not met.
_QUIET = np.errstate(all="ignore")

_BAND_PIXELS = 3 << 15
# From so many pixels on, two processors pay; with antialiasing from fewer.
_PIXELS_WORTH_TWO = 1 << 19


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
    image = np.zeros((scene.height, scene.width, 3))
    row = 0
    for band in render_bands(scene, samples, threads=threads, offset=offset):
        image[row : row + len(band)] = band
        row += len(band)
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
        The next rows of the picture.
    """
    _keep_heap()
    if samples < 1:
        raise ValueError(f"samples must be at least 1, is {samples}")
    view, lighting = _prepare(scene, offset, samples)
    # The least power of four that is as many.
    depth = ((samples - 1).bit_length() + 1) // 2
    step = max(1, band_pixels // scene.width)
    if threads is None:
        worth = scene.width * scene.height * (1 + 10 * depth) >= _PIXELS_WORTH_TWO
        threads = 2 if worth and can_fork() else 1
    if threads > 1:
        # Enough bands for all to end at much the same time.
        step = min(step, max(1, scene.height // (4 * threads)))
    tops = range(0, scene.height, step)

    @_QUIET
    def band(top: int) -> Floats:
        bottom = min(top + step, scene.height)

        def part(left: int, right: int) -> Floats:
            if depth:
                return antialiased(view, lighting, top, bottom, left, right, depth)
            return _centres(view, lighting, top, bottom, left, right)

        if scene.width <= band_pixels:
            return part(0, scene.width)
        # Rows longer than a band are rendered in parts.
        radiance = np.empty((bottom - top, scene.width, 3))
        for left in range(0, scene.width, band_pixels):
            right = min(left + band_pixels, scene.width)
            radiance[:, left:right] = part(left, right)
        return radiance

    if threads == 1 or len(tops) == 1 or not hasattr(os, "fork"):
        yield from map(band, tops)
    else:
        shapes = [(min(step, scene.height - top), scene.width, 3) for top in tops]
        yield from forked(lambda number: band(tops[number]), shapes, threads)


def _centres(
    view: View, lighting: Lighting, top: int, bottom: int, left: int, right: int
) -> Floats:
    """Radiance (bottom - top, right - left, 3) at the centres of pixels."""
    samples = grid(top, bottom, left, right)
    radiance = np.zeros((samples.x.size, 3))
    hits = visible(view, samples)
    falls = incidence(lighting, hits)
    for group in hits.groups:
        for k, values in enumerate(shade(lighting, hits, group, falls[:, group.part])):
            radiance[group.sample, k] = values
    return radiance.reshape(bottom - top, right - left, 3)


def _keep_heap() -> None:
    """Let the C library keep freed memory for the next array.

    Fresh pages cost more than the arithmetic on them.  Freeing one block of
    nearly 32 MB moves glibc's thresholds (M_MMAP_THRESHOLD in mallopt(3)) so
    that smaller ones are reused from then on; the block itself is never touched.
    """
    np.empty((1 << 25) - (1 << 16), dtype=np.uint8)


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
