"""Samples: positions in the picture, and which objects may be visible at each of them.

There are two kinds of samples: `Rows` of equally spaced samples, and `Scattered` samples at
arbitrary positions.  Both find all pairs of a sample and an object that the ray through the sample
may meet.  For this purpose, `find_object_spans` computes which part of a row each object covers.
"""

from __future__ import annotations

from typing import NamedTuple, TypeAlias

import numpy as np

from tracer.arrays import Floats, Ints, enumerate_ranges, find, mark_run_starts
from tracer.geometry.camera import CameraFrame
from tracer.world.prepared_scene import PreparedScene, Shape

# Spans are widened by this many pixels on both sides: far more than their rounding errors.
_SPAN_PADDING = 0.5

# Maximum magnitude of the numbers that combine the row and x of a scattered sample.  At this
# magnitude, the rounding errors are less than 1e-4 pixels.
_MAX_COMBINED_KEY = 2.0**39

# Scattered samples are sorted along a row if they are at most this many pixels from the left edge
# of the picture.  Samples farther away are treated as equally far, so they are tested with more
# objects than necessary.  A power of two: see `_encode_position`.
_MAX_SORTED_X = 2.0**20


def find_object_spans(
    shape: Shape,
    scene: PreparedScene,
    row_top: Floats,
    x_range: tuple[float, float],
    height: float = 0.0,
    pad: float = 0.0,
) -> tuple[Ints, Ints, Floats, Floats]:
    """Compute the spans that the objects of one shape cover in rows of the picture.

    A span is the part of one row that one object covers.  Other objects may hide it.

    Parameters
    ----------
    shape : Spheres or Boxes
        The objects.
    scene : PreparedScene
        The scene, with bounding rectangles of all objects in the picture.
    row_top : (rows,) float array
        Distance of each row from the top of the picture, in pixels, in ascending order.
    x_range : (float, float)
        Horizontal interval, in pixels from the left edge of the picture.  Objects entirely
        outside this interval are skipped.
    height : float
        Height of the rows, in pixels.  A row of height 0 is a line.  Its spans are exact except
        for rounding errors.
    pad : float
        Number of pixels by which to widen the spans on both sides.

    Returns
    -------
    object_index : (n,) int array
        Index of each span's object among all objects of the scene.
    row : (n,) int array
        Index of each span's row in `row_top`.
    left, right : (n,) float arrays
        Ends of each span, in pixels from the left edge of the picture; left <= right.
    """
    bounds = scene.bounds.select(shape.objects.slice)
    in_range_index = find((bounds.left - pad <= x_range[1]) & (bounds.right + pad >= x_range[0]))
    first_row = row_top.searchsorted(bounds.top[in_range_index] - pad - height)
    end_row = row_top.searchsorted(bounds.bottom[in_range_index] + pad, side="right")
    candidate_index, row = enumerate_ranges(np.maximum(end_row - first_row, 0), first_row)
    index_in_shape = in_range_index[candidate_index]
    object_index = index_in_shape + shape.objects.start
    left, right = shape.find_x_range(object_index, row_top[row], height)
    left = np.maximum(left, bounds.left[index_in_shape])
    right = np.minimum(right, bounds.right[index_in_shape])
    kept_index = find(left <= right)
    left, right = left[kept_index] - pad, right[kept_index] + pad
    return object_index[kept_index], row[kept_index], left, right


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
        Distance by which the samples of each row are shifted to the right.
    per_pixel : (int, int)
        Numbers of samples in a pixel along x and along y.
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
    def per_pixel_side(self) -> float:
        """Weighted geometric mean of the numbers of samples across a pixel along x and y.

        It determines the size of packets (groups of neighbouring hits).  The weight of x is larger,
        because most packets lie along a row.
        """
        x_count, y_count = self.per_pixel
        return float(x_count**0.75 * y_count**0.25)

    def compute_ray_x(self, frame: CameraFrame) -> Floats:
        """Compute the rightward component of the ray through each of n samples.

        Parameters
        ----------
        frame : CameraFrame
            The camera.  Rays have the directions (ray_x, ray_y, frame.depth) in camera axes,
            which point to the right, down and ahead.

        Returns
        -------
        ray_x : (n,) float array
            Rightward component of each ray's direction.
        """
        return np.add.outer(self.shift * frame.pixel_width, frame.to_ray_x(self.x)).ravel()

    def get_positions(self, sample_index: Ints) -> tuple[Floats, Floats]:
        """Return the positions of selected samples in the picture.

        Parameters
        ----------
        sample_index : (k,) int array
            Indices of the samples to select.

        Returns
        -------
        x, y : (k,) float arrays
            Distances of the samples from the left and upper edges of the picture, in pixels.
        """
        row, column = np.divmod(sample_index, self.x.size)
        return self.x[column] + self.shift[row], self.y[row]

    def find_spans(self, shape: Shape, scene: PreparedScene) -> tuple[Ints, Ints, Ints, Ints]:
        """Find spans of samples at which the objects of one shape may be visible.

        A span consists of consecutive samples in one row, and belongs to one object.

        Parameters
        ----------
        shape : Spheres or Boxes
            The objects.
        scene : PreparedScene
            The scene.

        Returns
        -------
        object_index : (spans,) int array
            Index of each span's object among all objects of the scene.
        row : (spans,) int array
            Index of each span's row in `y`.
        first_sample : (spans,) int array
            Index of each span's first sample.
        sample_count : (spans,) int array
            Number of samples in each span, possibly 0.
        """
        row_size, per_pixel = self.x.size, self.per_pixel[0]
        object_index, row, left, right = find_object_spans(
            shape, scene, self.y, (self.x[0] - 1, self.x[-1] + 1), pad=_SPAN_PADDING / per_pixel
        )
        first_x = self.x[0] + self.shift[row]
        span_start = np.ceil((left - first_x) * per_pixel).clip(0, row_size).astype(np.intp)
        span_end = (np.floor((right - first_x) * per_pixel) + 1).clip(0, row_size).astype(np.intp)
        return object_index, row, row * row_size + span_start, np.maximum(span_end - span_start, 0)


class Scattered(NamedTuple):
    """Samples at arbitrary positions, sorted by row of pixels, and along each row.

    All positions are in pixels from the upper left corner of the picture.

    Attributes
    ----------
    y, x : (n,) float arrays
        Vertical and horizontal position of each sample.
    row_start : (rows,) int array
        Index of the first sample in each row of pixels.  Rows without samples are omitted.
    sort_key : (n,) float array
        A number that encodes the row and x of each sample: see `_encode_position`.  The numbers
        ascend, except for rounding errors much smaller than `_SPAN_PADDING`.
    """

    y: Floats
    x: Floats
    row_start: Ints
    sort_key: Floats

    @classmethod
    def from_positions(cls, x: Floats, y: Floats) -> tuple[Scattered, Ints]:
        """Sort positions in the picture by row of pixels, and then by x.

        Parameters
        ----------
        x, y : (n,) float arrays
            Finite positions in any order, in pixels from the left and upper edges of the picture.

        Returns
        -------
        samples : Scattered
            The sorted samples.
        order : (n,) int array
            Sample i is at the position (x[order[i]], y[order[i]]).
        """
        row = np.floor(y)
        # Sorting by one number is faster than by two, but large numbers have large rounding errors.
        combined_key = row * (2 * np.ceil(np.abs(x).max(initial=0)) + 2) + x
        if np.abs(combined_key).max(initial=0) < _MAX_COMBINED_KEY:
            order = combined_key.argsort(kind="stable")
        else:
            order = np.lexsort((x, row))
        y, x = y[order], x[order]
        is_row_start = mark_run_starts(np.floor(y))
        return cls(y, x, find(is_row_start), _encode_position(is_row_start.cumsum(), x)), order

    @property
    def size(self) -> int:
        """Number of samples."""
        return self.x.size

    @property
    def per_pixel_side(self) -> float:
        """Assumed number of samples across a pixel: 1, because the actual number is unknown."""
        return 1.0

    def compute_ray_x(self, frame: CameraFrame) -> Floats:
        """Compute the rightward component of the ray through each of n samples.

        Parameters
        ----------
        frame : CameraFrame
            The camera.  Rays have the directions (ray_x, ray_y, frame.depth) in camera axes,
            which point to the right, down and ahead.

        Returns
        -------
        ray_x : (n,) float array
            Rightward component of each ray's direction.
        """
        return frame.to_ray_x(self.x)

    def get_positions(self, sample_index: Ints) -> tuple[Floats, Floats]:
        """Return the positions of selected samples in the picture.

        Parameters
        ----------
        sample_index : (k,) int array
            Indices of the samples to select.

        Returns
        -------
        x, y : (k,) float arrays
            Distances of the samples from the left and upper edges of the picture, in pixels.
        """
        return self.x[sample_index], self.y[sample_index]

    def find_spans(self, shape: Shape, scene: PreparedScene) -> tuple[Ints, Ints, Ints, None]:
        """Find spans of samples at which the objects of one shape may be visible.

        A span belongs to one object, and has only one sample.

        Parameters
        ----------
        shape : Spheres or Boxes
            The objects.
        scene : PreparedScene
            The scene.

        Returns
        -------
        object_index : (spans,) int array
            Index of each span's object among all objects of the scene.
        row, first_sample : (spans,) int arrays
            Index of each span's sample, which is also its index in `y`; the arrays are the same.
        sample_count : None
            None, because each span has one sample.
        """
        row_top = np.floor(self.y[self.row_start])
        x_range = self.x.min(initial=0), self.x.max(initial=0)
        spans = find_object_spans(shape, scene, row_top, x_range, height=1.0, pad=_SPAN_PADDING)
        object_index, row, left, right = spans
        span_start = self.sort_key.searchsorted(_encode_position(row + 1, left))
        span_end = self.sort_key.searchsorted(_encode_position(row + 1, right), side="right")
        span_size = np.maximum(span_end - span_start, 0)
        span_index, sample_index = enumerate_ranges(span_size, span_start)
        return object_index[span_index], sample_index, sample_index, None


def _encode_position(row: Ints, x: Floats) -> Floats:
    """Encode each position as a number that sorts by row, and then by x.

    Parameters
    ----------
    row : (n,) int array
        Row of each position, at most `schema.MAX_PIXELS`.
    x : (n,) float array
        Distance of each position from the left edge of the picture, in pixels; may be infinite.

    Returns
    -------
    sort_key : (n,) float array
        The number for each position.  Two positions may have equal numbers if they differ by very
        little, or if both are farther from the left edge than `_MAX_SORTED_X`.
    """
    # The product is exact, so rounding never reverses the order of two positions.
    return np.asarray(row * (4 * _MAX_SORTED_X) + x.clip(-_MAX_SORTED_X, _MAX_SORTED_X))


# Positions in the picture through which rays are traced.
Samples: TypeAlias = Rows | Scattered
