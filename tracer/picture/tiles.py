"""Estimate how long a picture takes, and divide it into tiles.

tile
    A rectangle of pixels: several whole rows of the rendered part of a picture, or a piece of one
    row.  It is so small that its arrays stay in the CPU cache, and so large that the overhead of
    NumPy calls is negligible.
adaptive
    In an adaptive picture, edges are found first, and only pixels that edges cross are sampled more
    than once.  In all other pictures, every pixel has the samples of the same `Lattice`.

The estimated time of a pixel is proportional to the number of its samples, to the number of lights,
and to the mean number of objects that a ray meets.  Estimates only need to be right within a factor
of two or so: they decide what is worth sharing and how large tiles are, but change no pixel.
"""

from __future__ import annotations

from itertools import pairwise, product
from math import sqrt
from typing import NamedTuple

from tracer.antialias.lattice import Lattice
from tracer.arrays import CACHE_SIZE
from tracer.picture.parallel import Sharing, count_processors
from tracer.world.prepared_scene import PreparedScene

# Maximum number of samples in a tile, to limit memory (`CACHE_SIZE` is a number of floats).
_MAX_TILE_SAMPLES = 3 * CACHE_SIZE

# Tiles of an adaptive picture may have this many times as many pixels.  Only few of the pixels are
# sampled more than once, and the arrays of their samples should be long, too.
_ADAPTIVE_FACTOR = 4

# Maximum estimated seconds of a tile, so that progress is shown and workers are equally busy.
_MAX_TILE_SECONDS = 0.2

# Number of samples per pixel for which `_MAX_TILE_SECONDS` is halved.  With more samples, few
# pixels take most of the time, and some tiles exceed their estimates more.  No tile then took more
# than 0.3 s.
_HALVING_SAMPLES = 10_000

# Minimum number of tiles for each processor, to balance the load, if the other limits allow it.
_TILES_PER_PROCESSOR = 4

# Estimated seconds for a picture of any size: a small scene is read and prepared.
_FIXED_SECONDS = 0.003


class Rectangle(NamedTuple):
    """A rectangle of pixels, which selects them in an array of the picture."""

    rows: slice
    columns: slice

    @property
    def height(self) -> int:
        """Number of rows; not positive if the rectangle is empty."""
        return _get_length(self.rows)

    @property
    def width(self) -> int:
        """Number of columns; not positive if the rectangle is empty."""
        return _get_length(self.columns)

    def intersect(self, rows: slice, columns: slice) -> Rectangle:
        """Return the pixels of this rectangle in certain rows and columns of the picture."""
        return Rectangle(
            rows=slice(max(self.rows.start, rows.start), min(self.rows.stop, rows.stop)),
            columns=slice(
                max(self.columns.start, columns.start), min(self.columns.stop, columns.stop)
            ),
        )

    def relative_to(self, outer: Rectangle) -> Rectangle:
        """Return the place of this rectangle in an array of the pixels of an outer rectangle.

        For example, rows 12 to 15 of the picture are rows 2 to 5 of a tile that starts at row 10.
        """
        top, left = outer.rows.start, outer.columns.start
        return Rectangle(
            rows=slice(self.rows.start - top, self.rows.stop - top),
            columns=slice(self.columns.start - left, self.columns.stop - left),
        )


class Work(NamedTuple):
    """The work of rendering a rectangle of a picture, which can be divided into tiles."""

    rectangle: Rectangle
    seconds_per_pixel: float  # estimate for one process with one thread
    max_tile_pixels: float  # maximum number of pixels in a tile, to limit memory and time

    @property
    def seconds(self) -> float:
        """Estimate how long one thread takes to prepare the scene and to render the rectangle."""
        pixel_count = self.rectangle.width * self.rectangle.height
        return _FIXED_SECONDS + self.seconds_per_pixel * pixel_count

    def divide(self, sharing: Sharing | None) -> list[Rectangle]:
        """Divide the rectangle into tiles, from top to bottom and from left to right.

        If workers share the tiles, `sharing` tells their kind.  Then there are enough tiles to keep
        all processors busy, unless the tiles would be too small.
        """
        rectangle = self.rectangle
        max_pixels = self.max_tile_pixels
        processor_count = 1
        if sharing:
            processor_count = count_processors()
            tile_count = _TILES_PER_PROCESSOR * processor_count
            fair_share = rectangle.width * rectangle.height / tile_count
            min_pixels = sharing.min_tile_seconds / self.seconds_per_pixel
            max_pixels = min(max_pixels, max(min_pixels, fair_share))
        max_rows = max(1, int(max_pixels / rectangle.width))
        row_ranges = _divide_range(rectangle.rows, max_rows, processor_count)
        column_ranges = _divide_range(rectangle.columns, max(1, int(max_pixels)))
        return [Rectangle(*ranges) for ranges in product(row_ranges, column_ranges)]


# Estimated seconds for each sample, light, and object that the ray through the sample meets.
# Pictures with 1 to 100 lights took 0.5 to 1.8 times as long as estimated; with 300, 0.1 times.
_SECONDS_PER_SAMPLE = 4e-8

# Stands for the estimate of a pixel in a scene without objects, which is 0.
_MIN_SECONDS_PER_PIXEL = 1e-12


def estimate_work(
    scene: PreparedScene, rectangle: Rectangle, samples_per_side: int, lattice: Lattice | None
) -> Work:
    """Estimate the work of rendering a rectangle, if n x n samples per pixel are requested.

    Parameters
    ----------
    samples_per_side
        The number n.
    lattice
        The samples that all pixels have; None if the picture is adaptive.
    """
    if lattice is None:
        samples_per_pixel = _estimate_adaptive_samples(scene, samples_per_side)
        max_pixels: float = scene.choose_batch_size(_ADAPTIVE_FACTOR * _MAX_TILE_SAMPLES)
    else:
        samples_per_pixel = lattice.size
        max_pixels = scene.choose_batch_size(_MAX_TILE_SAMPLES) / lattice.size
    seconds_per_sample = _SECONDS_PER_SAMPLE * max(1, scene.light_count) * scene.depth_complexity
    seconds_per_pixel = max(samples_per_pixel * seconds_per_sample, _MIN_SECONDS_PER_PIXEL)
    max_tile_seconds = _MAX_TILE_SECONDS / (1 + samples_per_side**2 / _HALVING_SAMPLES)
    return Work(
        rectangle=rectangle,
        seconds_per_pixel=seconds_per_pixel,
        max_tile_pixels=min(max_pixels, max_tile_seconds / seconds_per_pixel),
    )


# Number of samples in a pixel of an adaptive picture that no edge crosses.
_ADAPTIVE_SAMPLES = 2.5

# If n x n samples are requested, each edge adds n + n^2 / `_SQUARE_DIVISOR` samples to a pixel that
# it crosses.
_SQUARE_DIVISOR = 100

# The mean number of edges in a pixel is `_EDGE_FACTOR` / sqrt(number of pixels in the picture) plus
# `_PAIR_FACTOR` times the mean number of pairs of silhouettes that cross the same pixel.
_EDGE_FACTOR = 330
_PAIR_FACTOR = 400

# Maximum number of samples that edges add to a pixel, divided by n^2: pixels with many edges are
# sampled on a lattice instead.  Without this limit, 1,000 objects at 64 samples had more tiles and
# took twice as long.
_MAX_ADAPTIVE_FACTOR = 2


def _estimate_adaptive_samples(scene: PreparedScene, samples_per_side: int) -> float:
    """Estimate the mean number of samples in a pixel of an adaptive picture.

    `samples_per_side` is the number n, if n x n samples are requested.  Thirty pictures took 0.25
    to 2.2 times as long as follows from the estimate.
    """
    pixel_count = scene.frame.width * scene.frame.height
    silhouette_pairs = scene.bounds.estimate_silhouette_pairs(scene.frame)
    edges_per_pixel = _EDGE_FACTOR / sqrt(pixel_count) + _PAIR_FACTOR * silhouette_pairs
    samples_per_edge = samples_per_side + samples_per_side**2 / _SQUARE_DIVISOR
    max_edge_samples = _MAX_ADAPTIVE_FACTOR * samples_per_side**2
    return _ADAPTIVE_SAMPLES + min(edges_per_pixel * samples_per_edge, max_edge_samples)


def _divide_range(outer_range: slice, max_length: int, divisor: int = 1) -> list[slice]:
    """Divide a range into as few slices of at most `max_length` as possible.

    Their lengths differ by at most 1.  If there are more than `divisor`, their number is a multiple
    of it where possible, so that this many processors end at about the same time.
    """
    start = outer_range.start
    length = _get_length(outer_range)
    slice_count = -(-length // max_length)
    if slice_count > divisor:
        slice_count = min(length, slice_count + -slice_count % divisor)
    bounds = [start + length * index // slice_count for index in range(slice_count + 1)]
    return [slice(*pair) for pair in pairwise(bounds)]


def _get_length(pixel_range: slice) -> int:
    length: int = pixel_range.stop - pixel_range.start
    return length
