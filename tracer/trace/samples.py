"""Samples: positions in the picture, and which objects may be visible at each of them.

There are two kinds of samples: `Rows` of equally spaced samples, and `Scattered` samples at
arbitrary positions.  Both kinds have the same interface: the attribute `y` and the properties
`size` and `per_pixel_side`, and the methods `compute_ray_x`, `get_positions` and `find_spans`.  The
last one finds all pairs of a sample and an object that the ray through the sample may meet.  The
pairs are arranged in *spans*: a span is the part of one row that one object covers.  Other objects
may hide it.

All positions and lengths are in pixels; positions are measured from the upper left corner of the
picture.
"""

from __future__ import annotations

from typing import Annotated as Shaped
from typing import NamedTuple, TypeAlias

import numpy as np

from tracer.arrays import Floats, Ints, enumerate_ranges, find, mark_run_starts
from tracer.geometry.camera import CameraFrame
from tracer.geometry.shape import Shape
from tracer.world.prepared_scene import PreparedScene

# Spans are widened on both sides by this many pixels (of scattered samples) or samples (of rows):
# far more than their rounding errors.
_SPAN_PADDING = 0.5

# Weights of the numbers of samples along x and along y in `Rows.per_pixel_side`, a weighted
# geometric mean.
_X_WEIGHT = 0.75
_Y_WEIGHT = 1 - _X_WEIGHT

# Scattered samples are sorted along a row if they are at most this many pixels from the left edge
# of the picture.  Samples farther away are treated as equally far, so they are tested with more
# objects than necessary.  A power of two: see `_encode_position`.
_MAX_SORTED_X = 2.0**20


class ObjectSpans(NamedTuple):
    """The parts of rows that objects cover."""

    object_index: Shaped[Ints, "n"]
    row: Shaped[Ints, "n"]  # index among the given rows
    left: Shaped[Floats, "n"]
    right: Shaped[Floats, "n"]  # at least `left`


class SampleSpans(NamedTuple):
    """Ranges of consecutive samples in a row, each paired with an object."""

    object_index: Shaped[Ints, "spans"]
    row: Shaped[Ints, "spans"]  # index into `y` of the samples
    first_sample: Shaped[Ints, "spans"]
    sample_count: Shaped[Ints, "spans"] | None  # None: each span has one sample


def find_object_spans(
    shape: Shape,
    scene: PreparedScene,
    row_top: Shaped[Floats, "rows"],
    x_range: tuple[float, float],
    height: float = 0.0,
    pad: float = 0.0,
) -> ObjectSpans:
    """Find the spans that objects of one shape cover in rows of the picture.

    Parameters
    ----------
    row_top
        Tops of the rows, in ascending order.
    x_range
        Objects entirely to the left or right of this interval are skipped.
    height
        Height of the rows.  A row of height 0 is a line, whose spans are exact except for rounding
        errors.
    pad
        Length by which to widen the spans on both sides.
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
    return ObjectSpans(
        object_index=object_index[kept_index],
        row=row[kept_index],
        left=left[kept_index] - pad,
        right=right[kept_index] + pad,
    )


class Rows(NamedTuple):
    """Samples in rows, numbered row by row."""

    y: Shaped[Floats, "rows"]  # in ascending order
    x: Shaped[Floats, "columns"]  # in ascending order, with a spacing of 1 / per_pixel[0]
    shift: Shaped[Floats, "rows"]  # length by which the samples of each row are shifted right
    per_pixel: tuple[int, int] = (1, 1)  # numbers of samples in a pixel along x and along y

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
        return float(x_count**_X_WEIGHT * y_count**_Y_WEIGHT)

    def compute_ray_x(self, frame: CameraFrame) -> Shaped[Floats, "rows*columns"]:
        """Compute `ray_x`, the rightward component of the ray through each sample."""
        return np.add.outer(self.shift * frame.pixel_width, frame.to_ray_x(self.x)).ravel()

    def get_positions(
        self, sample_index: Shaped[Ints, "k"]
    ) -> tuple[Shaped[Floats, "k"], Shaped[Floats, "k"]]:
        """Return x and y of selected samples."""
        row, column = np.divmod(sample_index, self.x.size)
        return self.x[column] + self.shift[row], self.y[row]

    def find_spans(self, shape: Shape, scene: PreparedScene) -> SampleSpans:
        """Find spans of samples at which objects of one shape may be visible; some are empty."""
        row_size, per_pixel = self.x.size, self.per_pixel[0]
        # Samples are shifted by at most half the distance between two columns, or half a pixel.
        x_range = self.x[0] - 1, self.x[-1] + 1
        spans = find_object_spans(shape, scene, self.y, x_range, pad=_SPAN_PADDING / per_pixel)
        # Positions relative to the first sample of the row, in samples.
        first_x = self.x[0] + self.shift[spans.row]
        left, right = (spans.left - first_x) * per_pixel, (spans.right - first_x) * per_pixel
        span_start = np.ceil(left).clip(0, row_size).astype(np.intp)
        span_end = (np.floor(right) + 1).clip(0, row_size).astype(np.intp)
        return SampleSpans(
            object_index=spans.object_index,
            row=spans.row,
            first_sample=spans.row * row_size + span_start,
            sample_count=np.maximum(span_end - span_start, 0),
        )


class Scattered(NamedTuple):
    """Samples at arbitrary positions, sorted by row of pixels, and along each row."""

    y: Shaped[Floats, "n"]
    x: Shaped[Floats, "n"]
    # Index of the first sample in each row of pixels.  Rows without samples are omitted.
    row_start: Shaped[Ints, "rows"]
    # The row and x of each sample, encoded by `_encode_position`.  The keys ascend, except for
    # rounding errors much smaller than `_SPAN_PADDING`.
    sort_key: Shaped[Floats, "n"]

    @classmethod
    def from_positions(
        cls, x: Shaped[Floats, "n"], y: Shaped[Floats, "n"]
    ) -> tuple[Scattered, Shaped[Ints, "n"]]:
        """Sort finite positions, and return also their order: sample i is at position order[i]."""
        order = np.lexsort((x, np.floor(y)))
        y, x = y[order], x[order]
        is_row_start = mark_run_starts(np.floor(y))
        samples = cls(
            y=y,
            x=x,
            row_start=find(is_row_start),
            sort_key=_encode_position(is_row_start.cumsum(), x),
        )
        return samples, order

    @property
    def size(self) -> int:
        """Number of samples."""
        return self.x.size

    @property
    def per_pixel_side(self) -> float:
        """Assumed number of samples across a pixel: 1, because the actual number is unknown."""
        return 1.0

    def compute_ray_x(self, frame: CameraFrame) -> Shaped[Floats, "n"]:
        """Compute `ray_x`, the rightward component of the ray through each sample."""
        return frame.to_ray_x(self.x)

    def get_positions(
        self, sample_index: Shaped[Ints, "k"]
    ) -> tuple[Shaped[Floats, "k"], Shaped[Floats, "k"]]:
        """Return x and y of selected samples."""
        return self.x[sample_index], self.y[sample_index]

    def find_spans(self, shape: Shape, scene: PreparedScene) -> SampleSpans:
        """Find samples at which objects of one shape may be visible, as spans of one sample."""
        row_top = np.floor(self.y[self.row_start])
        x_range = self.x.min(initial=0), self.x.max(initial=0)
        spans = find_object_spans(shape, scene, row_top, x_range, height=1.0, pad=_SPAN_PADDING)
        # The rows in `sort_key` are numbered from 1.
        left_key = _encode_position(spans.row + 1, spans.left)
        right_key = _encode_position(spans.row + 1, spans.right)
        span_start = self.sort_key.searchsorted(left_key)
        span_end = self.sort_key.searchsorted(right_key, side="right")
        span_size = np.maximum(span_end - span_start, 0)
        span_index, sample_index = enumerate_ranges(span_size, span_start)
        return SampleSpans(
            object_index=spans.object_index[span_index],
            row=sample_index,  # `y` has one element for each sample
            first_sample=sample_index,
            sample_count=None,
        )


def _encode_position(row: Shaped[Ints, "n"], x: Shaped[Floats, "n"]) -> Shaped[Floats, "n"]:
    """Encode each position as a number that sorts by row, and then by x, which may be infinite.

    Rows are at most `schema.MAX_PIXELS`.  Two positions may have equal numbers if they differ by
    very little, or if both are farther from the left edge than `_MAX_SORTED_X`.
    """
    # The product is exact, so rounding never reverses the order of two positions.
    return np.asarray(row * (4 * _MAX_SORTED_X) + x.clip(-_MAX_SORTED_X, _MAX_SORTED_X))


# Positions in the picture through which rays are traced.
Samples: TypeAlias = Rows | Scattered
