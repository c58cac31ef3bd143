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
# left border of the picture.  All positions farther away are treated as equally far, so they are
# tested with more objects than necessary.  A power of two: see `_sort_key`.
_MAX_SORTED_X = 2.0**20


def object_spans(
    shape: Shape,
    prepared: PreparedScene,
    rows: Floats,
    columns: tuple[float, float],
    height: float = 0.0,
    pad: float = 0.0,
) -> tuple[Ints, Ints, Floats, Floats]:
    """Compute which part of each row of the picture is covered by each object of one shape.

    A span is the part of one row that one object covers, whether or not other objects hide it.

    Parameters
    ----------
    shape : Spheres or Boxes
        The objects.
    prepared : PreparedScene
        The scene, with bounding rectangles of all objects in the picture.
    rows : (rows,) float array
        Upper border of each row, in pixels from the top of the picture, in ascending order.
    columns : (float, float)
        Minimum and maximum column, in pixels from the left border of the picture.  Objects that are
        entirely outside of this interval are skipped.
    height : float
        Height of the rows, in pixels.  If it is 0, a row is a line, and the spans are exact except
        for rounding.
    pad : float
        Number of pixels by which spans are widened on both sides.

    Returns
    -------
    object_index : (n,) int array
        Index of each span's object in the list of all objects of the scene.
    row : (n,) int array
        Index of each span's row in `rows`.
    left, right : (n,) float arrays
        Ends of each span, in pixels from the left border of the picture; left <= right.
    """
    bounds = prepared.bounds.take(shape.objects.slice)
    candidates = indices((bounds.left - pad <= columns[1]) & (bounds.right + pad >= columns[0]))
    first_row = rows.searchsorted(bounds.top[candidates] - pad - height)
    end_row = rows.searchsorted(bounds.bottom[candidates] + pad, side="right")
    span_candidate, row = segment_indices(np.maximum(end_row - first_row, 0), first_row)
    position = candidates[span_candidate]
    object_index = position + shape.objects.start
    left, right = shape.row_extent(object_index, rows[row], height)
    left, right = np.maximum(left, bounds.left[position]), np.minimum(right, bounds.right[position])
    kept = indices(left <= right)
    return object_index[kept], row[kept], left[kept] - pad, right[kept] + pad


class Rows(NamedTuple):
    """Samples in rows, numbered row by row.

    All positions are in pixels from the upper left corner of the picture.

    Attributes
    ----------
    y : (rows,) float array
        Vertical position of each row, in ascending order.
    x : (columns,) float array
        Horizontal positions along a row, in ascending order and equally spaced.
    shift : (rows,) float array
        Distance by which the samples of each row are moved to the right.
    per_pixel : (int, int)
        Number of columns of samples in the width of a pixel, and of rows in its height.
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
        """Number of samples in the width of a pixel, for the choice of the width of packets.

        This is a weighted geometric mean of the numbers across a pixel and down a pixel.  A packet
        (a group of neighbouring hits) lies along a row, so the first number has more weight.
        """
        columns, rows = self.per_pixel
        return float(columns**0.75 * rows**0.25)

    def ray_s(self, frame: CameraFrame) -> Floats:
        """Compute the rightward direction component of the ray through each sample.

        Parameters
        ----------
        frame : CameraFrame
            The rays of the camera; their directions are (s, g, depth), in camera axes.

        Returns
        -------
        s : (n,) float array
            Rightward component of each sample's ray direction.
        """
        return np.add.outer(self.shift * frame.step_u, frame.ray_s(self.x)).ravel()

    def positions(self, index: Ints) -> tuple[Floats, Floats]:
        """Return the positions of the given samples in the picture.

        Parameters
        ----------
        index : (k,) int array
            Index of each sample.

        Returns
        -------
        x, y : (k,) float arrays
            Distances from the left and upper borders of the picture, in pixels.
        """
        row, column = np.divmod(index, self.x.size)
        return self.x[column] + self.shift[row], self.y[row]

    def grid_positions(self, index: Ints) -> tuple[Ints, Ints]:
        """Return the row and the column of the given samples in the grid of samples.

        Parameters
        ----------
        index : (k,) int array
            Index of each sample.

        Returns
        -------
        row, column : (k,) int arrays
            Indices into `y` and `x`.
        """
        row, column = np.divmod(index, self.x.size)
        return row, column

    def sample_spans(self, shape: Shape, prepared: PreparedScene) -> tuple[Ints, Ints, Ints, Ints]:
        """Find, for each object of one shape, the samples at which it may be visible.

        The result consists of spans.  A span is a pair of one object and consecutive samples in one
        row.

        Parameters
        ----------
        shape : Spheres or Boxes
            The objects.
        prepared : PreparedScene
            The scene.

        Returns
        -------
        object_index : (spans,) int array
            Index of each span's object in the list of all objects of the scene.
        row : (spans,) int array
            Index of each span's row in `y`.
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
    """Place one sample at the centre of each pixel in a rectangle of the picture.

    Parameters
    ----------
    rows, columns : slices
        The pixels, counted from the upper left corner of the picture; start and stop are given.

    Returns
    -------
    samples : Rows
        The samples, row by row, in the order of the pixels.
    """
    y, x = (np.arange(interval.start, interval.stop) + 0.5 for interval in (rows, columns))
    return Rows(y, x, np.zeros(y.size))


class Scattered(NamedTuple):
    """Samples at arbitrary positions, sorted by row of pixels, and along each row.

    All positions are in pixels from the upper left corner of the picture.

    Attributes
    ----------
    y, x : (n,) float arrays
        Vertical and horizontal position of each sample.
    row_start : (rows,) int array
        Index of the first sample in each row of pixels.  Rows without samples are omitted.
    key : (n,) float array
        A number for each sample, from its row and x: see `_sort_key`.  The numbers are in ascending
        order, except for rounding errors that are negligible compared with `_SPAN_PADDING`.
    """

    y: Floats
    x: Floats
    row_start: Ints
    key: Floats

    @classmethod
    def from_positions(cls, x: Floats, y: Floats) -> tuple[Scattered, Ints]:
        """Create samples by sorting positions in the picture.

        Parameters
        ----------
        x, y : (n,) float arrays
            Finite positions in any order, in pixels from the left border and from the upper border
            of the picture.

        Returns
        -------
        samples : Scattered
            The sorted samples.
        order : (n,) int array
            Sample i is at the position (x[order[i]], y[order[i]]).
        """
        row = np.floor(y)
        # Sorting by a single number is faster, but large numbers would be rounded too much.
        single_key = row * (2 * np.ceil(np.abs(x).max(initial=0)) + 2) + x
        if np.abs(single_key).max(initial=0) < _MAX_SINGLE_KEY:
            order = single_key.argsort(kind="stable")
        else:
            order = np.lexsort((x, row))
        y, x = y[order], x[order]
        is_row_start = run_starts(np.floor(y))
        return cls(y, x, indices(is_row_start), _sort_key(is_row_start.cumsum(), x)), order

    @property
    def size(self) -> int:
        """Number of samples."""
        return self.x.size

    @property
    def density(self) -> float:
        """Assumed number of samples in the width of a pixel: 1, since the real one is unknown."""
        return 1.0

    def ray_s(self, frame: CameraFrame) -> Floats:
        """Compute the rightward direction component of the ray through each sample.

        Parameters
        ----------
        frame : CameraFrame
            The rays of the camera; their directions are (s, g, depth), in camera axes.

        Returns
        -------
        s : (n,) float array
            Rightward component of each sample's ray direction.
        """
        return frame.ray_s(self.x)

    def positions(self, index: Ints) -> tuple[Floats, Floats]:
        """Return the positions of the given samples in the picture.

        Parameters
        ----------
        index : (k,) int array
            Index of each sample.

        Returns
        -------
        x, y : (k,) float arrays
            Distances from the left and upper borders of the picture, in pixels.
        """
        return self.x[index], self.y[index]

    def grid_positions(self, index: Ints) -> tuple[Ints, Ints]:
        """Return the row and the column of the pixels that contain the given samples.

        Parameters
        ----------
        index : (k,) int array
            Index of each sample.

        Returns
        -------
        row, column : (k,) int arrays
            Row and column of the pixel, counted from the upper left corner of the picture.
        """
        return self.y[index].astype(np.intp), self.x[index].astype(np.intp)

    def sample_spans(self, shape: Shape, prepared: PreparedScene) -> tuple[Ints, Ints, Ints, None]:
        """Find, for each object of one shape, the samples at which it may be visible.

        The result has the same form as that of `Rows.sample_spans`: each (object, sample) pair is
        given as a span of one sample.

        Parameters
        ----------
        shape : Spheres or Boxes
            The objects.
        prepared : PreparedScene
            The scene.

        Returns
        -------
        object_index : (n,) int array
            For each (object, sample) pair, the index of its object in the list of all objects.
        row, first_sample : (n,) int arrays
            For each pair, the index of its sample.  Both are the same array: the vertical position
            of the span is `y[row]`, and its only sample is `first_sample`.
        count : None
            None means that each span has one sample.
        """
        rows = np.floor(self.y[self.row_start])
        columns = self.x.min(initial=0), self.x.max(initial=0)
        object_index, row, left, right = object_spans(
            shape, prepared, rows, columns, height=1.0, pad=_SPAN_PADDING
        )
        start = self.key.searchsorted(_sort_key(row + 1, left))
        stop = self.key.searchsorted(_sort_key(row + 1, right), side="right")
        span_index, sample_index = segment_indices(np.maximum(stop - start, 0), start)
        return object_index[span_index], sample_index, sample_index, None


def _sort_key(row: Ints, x: Floats) -> Floats:
    """Encode each position as one number; the numbers are ordered by row, then by x.

    Parameters
    ----------
    row : (n,) int array
        Row of each position, at most `schema.MAX_PIXELS`.
    x : (n,) float array
        Position along the row, in pixels; infinity is allowed.

    Returns
    -------
    key : (n,) float array
        A number for each position.  Two positions can have equal numbers if they differ by very
        little, or are farther from the left border than `_MAX_SORTED_X`.
    """
    # Rounding never changes the order, because the product is exact.
    key: Floats = row * (4 * _MAX_SORTED_X) + x.clip(-_MAX_SORTED_X, _MAX_SORTED_X)
    return key


Samples: TypeAlias = Rows | Scattered
"""Positions in the picture through which rays are traced."""
