"""Samples: positions in the picture, and which objects may be visible at each of them.

There are two kinds of samples: `Rows` of equally spaced samples, and `Scattered` samples at any
positions.  Both find the pairs of a sample and an object that a ray has to be tested with.  For
this purpose, `object_spans` computes which part of each row of the picture an object covers.
"""

from __future__ import annotations

from typing import NamedTuple, TypeAlias

import numpy as np

from tracer.arrays import Floats, Ints, indices, run_starts, segment_indices
from tracer.geometry.camera import CameraFrame
from tracer.world.prepared_scene import PreparedScene, Shape

# Spans are widened by this many pixels on both sides: far more than their rounding errors.
_SPAN_PADDING = 0.5

# Scattered samples are sorted by single numbers if these are smaller than this.  Then the rounding
# errors of the numbers are less than 1e-4 pixels.
_MAX_SINGLE_KEY = 2.0**39

# The order of scattered samples along a row is exact for positions up to this many pixels from the
# left border of the picture.  All positions farther away count as equally far, so they are tested
# with more objects than necessary.  A power of two: see `_sort_key`.
_MAX_SORTED_X = 2.0**20


def object_spans(
    shape: Shape,
    prepared: PreparedScene,
    rows: Floats,
    columns: tuple[float, float],
    height: float = 0.0,
    pad: float = 0.0,
) -> tuple[Ints, Ints, Floats, Floats]:
    """Compute the parts of rows, called spans, that are covered by objects of one shape.

    Parameters
    ----------
    shape : Spheres or Boxes
        The objects.
    prepared : PreparedScene
        The scene.
    rows : (rows,) float array
        The upper border of each row, in pixels from the top of the picture, in ascending order.
    columns : (float, float)
        Objects outside of these columns are skipped: left and right, in pixels.
    height : float
        Height of the rows, in pixels.  If it is 0, the spans are exact except for rounding.
    pad : float
        Spans are widened by this number of pixels on both sides.

    Returns
    -------
    object_index : (n,) int array
        Index of the object of each span, among all objects.
    row : (n,) int array
        Index of the row of each span.
    left, right : (n,) float arrays
        Ends of each span, in pixels.
    """
    bounds = prepared.bounds.take(shape.objects.slice)
    near = indices((bounds.left - pad <= columns[1]) & (bounds.right + pad >= columns[0]))
    start = rows.searchsorted(bounds.top[near] - pad - height)
    stop = rows.searchsorted(bounds.bottom[near] + pad, side="right")
    owner, row = segment_indices(np.maximum(stop - start, 0), start)
    position = near[owner]
    object_index = position + shape.objects.start
    left, right = shape.row_extent(object_index, rows[row], height)
    left, right = np.maximum(left, bounds.left[position]), np.minimum(right, bounds.right[position])
    kept = indices(left <= right)
    return object_index[kept], row[kept], left[kept] - pad, right[kept] + pad


class Rows(NamedTuple):
    """Samples in rows, numbered row by row.  All positions are in pixels from the upper left.

    Attributes
    ----------
    y : (rows,) float array
        Position of each row, in ascending order.
    x : (columns,) float array
        Positions along a row, in ascending order and equally spaced.
    shift : (rows,) float array
        Distance by which each row is moved to the right.
    per_pixel : (int, int)
        Number of samples across a pixel, and down a pixel.
    """

    y: Floats
    x: Floats
    shift: Floats
    per_pixel: tuple[int, int] = (1, 1)

    @property
    def size(self) -> int:
        """Number of samples."""
        return self.x.size * self.y.size

    @property
    def density(self) -> float:
        """Number of samples across a pixel, as far as it affects the width of packets.

        Packets lie along rows.  So the samples across a pixel count more than those down a pixel.
        """
        columns, rows = self.per_pixel
        return float(columns**0.75 * rows**0.25)

    def ray_s(self, frame: CameraFrame) -> Floats:
        """Return the first component s (n,) of each sample's ray."""
        return np.add.outer(self.shift * frame.step_u, frame.ray_s(self.x)).ravel()

    def positions(self, index: Ints) -> tuple[Floats, Floats]:
        """Return the positions x and y of samples, given by index."""
        row, column = np.divmod(index, self.x.size)
        return self.x[column] + self.shift[row], self.y[row]

    def grid_positions(self, index: Ints) -> tuple[Ints, Ints]:
        """Return the row and the column of samples, given by index."""
        row, column = np.divmod(index, self.x.size)
        return row, column

    def covered_samples(
        self, shape: Shape, prepared: PreparedScene
    ) -> tuple[Ints, Ints, Ints, Ints]:
        """Find the samples at which objects of one shape may be visible.

        The samples are given as spans: consecutive samples in one row, paired with one object.

        Parameters
        ----------
        shape : Spheres or Boxes
            The objects.
        prepared : PreparedScene
            The scene.

        Returns
        -------
        object_index : (spans,) int array
            Index of the object of each span, among all objects.
        row : (spans,) int array
            Index into `y` of the row of each span.
        first_sample : (spans,) int array
            Index of the first sample of each span.
        count : (spans,) int array
            Number of samples in each span, possibly 0.
        """
        columns, per_pixel = self.x.size, self.per_pixel[0]
        object_index, row, left, right = object_spans(
            shape, prepared, self.y, (self.x[0] - 1, self.x[-1] + 1), pad=_SPAN_PADDING / per_pixel
        )
        first_x = self.x[0] + self.shift[row]
        start = np.ceil((left - first_x) * per_pixel).clip(0, columns).astype(np.intp)
        stop = (np.floor((right - first_x) * per_pixel) + 1).clip(0, columns).astype(np.intp)
        return object_index, row, row * columns + start, np.maximum(stop - start, 0)


def pixel_centers(rows: slice, columns: slice) -> Rows:
    """Return samples at the centres of the pixels in a rectangle of the picture."""
    y, x = (np.arange(pixels.start, pixels.stop) + 0.5 for pixels in (rows, columns))
    return Rows(y, x, np.zeros(y.size))


class Scattered(NamedTuple):
    """Samples at any positions, sorted by row of pixels, and along each row.

    All positions are in pixels from the upper left corner of the picture.

    Attributes
    ----------
    y, x : (n,) float arrays
        Positions of the samples.
    row_start : (rows,) int array
        Index of the first sample in each row of pixels.  Rows without samples are not counted.
    key : (n,) float array
        A number for each sample: see `_sort_key`.  The numbers are in ascending order, except for
        rounding errors that are negligible compared with `_SPAN_PADDING`.
    """

    y: Floats
    x: Floats
    row_start: Ints
    key: Floats

    @classmethod
    def from_positions(cls, x: Floats, y: Floats) -> tuple[Scattered, Ints]:
        """Sort positions in the picture, and return them as samples.

        Parameters
        ----------
        x, y : (n,) float arrays
            Finite positions, in any order.

        Returns
        -------
        samples : Scattered
            The samples.
        order : (n,) int array
            Index of the position of each sample.
        """
        row = np.floor(y)
        # Sorting by a single number is faster.  Large numbers would be rounded too much.
        number = row * (2 * np.ceil(np.abs(x).max(initial=0)) + 2) + x
        if np.abs(number).max(initial=0) < _MAX_SINGLE_KEY:
            order = number.argsort(kind="stable")
        else:
            order = np.lexsort((x, row))
        y, x = y[order], x[order]
        is_start = run_starts(np.floor(y))
        return cls(y, x, indices(is_start), _sort_key(is_start.cumsum(), x)), order

    @property
    def size(self) -> int:
        """Number of samples."""
        return self.x.size

    @property
    def density(self) -> float:
        """Number of samples across a pixel; it is unknown, so packets are as for one sample."""
        return 1.0

    def ray_s(self, frame: CameraFrame) -> Floats:
        """Return the first component s (n,) of each sample's ray."""
        return frame.ray_s(self.x)

    def positions(self, index: Ints) -> tuple[Floats, Floats]:
        """Return the positions x and y of samples, given by index."""
        return self.x[index], self.y[index]

    def grid_positions(self, index: Ints) -> tuple[Ints, Ints]:
        """Return the row and the column of the pixel that contains each sample, given by index."""
        return self.y[index].astype(np.intp), self.x[index].astype(np.intp)

    def covered_samples(
        self, shape: Shape, prepared: PreparedScene
    ) -> tuple[Ints, Ints, Ints, None]:
        """Find the samples at which objects of one shape may be visible.

        Parameters
        ----------
        shape : Spheres or Boxes
            The objects.
        prepared : PreparedScene
            The scene.

        Returns
        -------
        object_index : (n,) int array
            The object of each pair of an object and a sample, as an index among all objects.
        sample, sample : (n,) int arrays
            The sample of each pair, twice: as the index into `y`, and as the first sample of a span
            as in `Rows.covered_samples`.
        count : None
            Each span has one sample.
        """
        rows = np.floor(self.y[self.row_start])
        columns = self.x.min(initial=0), self.x.max(initial=0)
        object_index, row, left, right = object_spans(
            shape, prepared, rows, columns, height=1.0, pad=_SPAN_PADDING
        )
        start = self.key.searchsorted(_sort_key(row + 1, left))
        stop = self.key.searchsorted(_sort_key(row + 1, right), side="right")
        span, sample = segment_indices(np.maximum(stop - start, 0), start)
        return object_index[span], sample, sample, None


def _sort_key(row: Ints, x: Floats) -> Floats:
    """Return numbers that order positions by row and, along each row, by x.

    Rounding may make numbers equal, but never changes their order: the product is exact.

    Parameters
    ----------
    row : (n,) int array
        Number of the row of each position, at most `schema.MAX_PIXELS`.
    x : (n,) float array
        Position along the row, in pixels; may be infinite.
    """
    key: Floats = row * (4 * _MAX_SORTED_X) + x.clip(-_MAX_SORTED_X, _MAX_SORTED_X)
    return key


Samples: TypeAlias = Rows | Scattered
"""Positions in the picture through which rays are traced."""
