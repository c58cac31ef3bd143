"""Samples: the positions in the picture through which rays are traced.

`Samples` is the interface of two kinds of samples: `Rows` of equally spaced samples, and
`Scattered` samples at arbitrary positions.  In both, a *row* contains samples of equal y.  A row of
pixels is called a *pixel row*.

Not every ray has to be tested with every object.  A *band* is the part of the picture between two
values of y: a pixel row or, if both values are equal, a horizontal line.  A *span* is the part of a
band that one object covers, whether or not another object hides it there.  `find_object_spans`
finds these parts, and `Samples.find_spans` lists the samples in them.

Positions and lengths are in pixels, from the upper left corner of the picture; y points down.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Annotated as Shaped
from typing import NamedTuple

import numpy as np

from tracer.arrays import Floats, Ints, enumerate_ranges, find, join_ranges, mark_run_starts
from tracer.geometry.camera import CameraFrame
from tracer.geometry.screen_bounds import ScreenBounds
from tracer.geometry.shape import Shape

# Spans are widened by this length on both sides: far more than their rounding errors.  The unit is
# the distance between two columns for `Rows`, and a pixel for `Scattered`.
_SPAN_PADDING = 0.5

# In a pixel row, scattered samples are sorted by x if they are at most this many pixels from the
# left edge of the picture.  Samples farther away are treated as equally far, so they are tested
# with more objects than necessary.  `_encode_position` needs a power of two.
_MAX_SORTED_X = 2.0**20


class ObjectSpans(NamedTuple):
    """The parts of bands that objects cover, sorted by object and then by band."""

    object_index: Shaped[Ints, "n"]
    band: Shaped[Ints, "n"]  # index into `band_top` of `find_object_spans`
    left: Shaped[Floats, "n"]
    right: Shaped[Floats, "n"]  # at least `left`


def find_object_spans(
    shape: Shape,
    bounds: ScreenBounds,
    band_top: Shaped[Floats, "bands"],
    x_range: tuple[float, float],
    height: float = 0.0,
    pad: float = 0.0,
) -> ObjectSpans:
    """Find the part of each band that each object of one shape covers.

    Parameters
    ----------
    bounds
        Bounding rectangles of all objects of the scene.
    band_top
        Upper edges of the bands, in ascending order.
    x_range
        Smallest and largest x.  Objects entirely to the left or to the right are skipped.
    height
        Height of each band.  If it is 0, spans are exact except for rounding errors.
    pad
        Length by which to widen each span on both sides.
    """
    # Candidates are pairs of an object and a band that the object's bounding rectangle overlaps.
    bounds = bounds.select(shape.objects.slice)
    in_range_index = find((bounds.left - pad <= x_range[1]) & (bounds.right + pad >= x_range[0]))
    first_band = band_top.searchsorted(bounds.top[in_range_index] - pad - height)
    end_band = band_top.searchsorted(bounds.bottom[in_range_index] + pad, side="right")
    candidate_index, band = enumerate_ranges(np.maximum(end_band - first_band, 0), first_band)
    index_in_shape = in_range_index[candidate_index]
    object_index = index_in_shape + shape.objects.start
    left, right = shape.find_x_range(object_index, band_top[band], height)
    left = np.maximum(left, bounds.left[index_in_shape])
    right = np.minimum(right, bounds.right[index_in_shape])
    kept_index = find(left <= right)
    return ObjectSpans(
        object_index=object_index[kept_index],
        band=band[kept_index],
        left=left[kept_index] - pad,
        right=right[kept_index] + pad,
    )


class SampleSpans(NamedTuple):
    """Ranges of consecutive samples in a row, each paired with an object."""

    object_index: Shaped[Ints, "spans"]
    row: Shaped[Ints, "spans"]  # index into `y` of the samples
    first_sample: Shaped[Ints, "spans"]
    sample_count: Shaped[Ints, "spans"] | None  # None: each span has one sample

    def list_samples(self) -> Shaped[Ints, "n"]:
        """Return the indices of the samples in all spans, span by span."""
        if self.sample_count is None:
            return self.first_sample
        return join_ranges(self.sample_count, self.first_sample)


@dataclass(frozen=True, eq=False, kw_only=True)
class Samples(ABC):
    """Positions in the picture, numbered from 0 and arranged in rows of equal y."""

    y: Shaped[Floats, "rows"]
    # Numbers of samples in a pixel along x and along y.
    per_pixel: tuple[int, int]

    @property
    @abstractmethod
    def size(self) -> int:
        """Number of samples."""

    @abstractmethod
    def compute_ray_x(self, frame: CameraFrame) -> Shaped[Floats, "samples"]:
        """Compute `ray_x`, the rightward component of the ray through each sample.

        The directions of rays are explained in `tracer.geometry.camera`.
        """

    @abstractmethod
    def get_positions(
        self, sample_index: Shaped[Ints, "k"]
    ) -> tuple[Shaped[Floats, "k"], Shaped[Floats, "k"]]:
        """Return x and y of the samples with the given indices."""

    @abstractmethod
    def find_spans(self, shape: Shape, bounds: ScreenBounds) -> SampleSpans:
        """Find spans of samples whose rays may meet objects of one shape.

        Rays outside the spans of an object certainly miss the object.  Spans may be empty.
        `bounds` contains the bounding rectangles of all objects of the scene.
        """


@dataclass(frozen=True, eq=False, kw_only=True)
class Rows(Samples):
    """Samples in rows of one length, numbered row by row; `y` is in ascending order."""

    x: Shaped[Floats, "columns"]  # in ascending order, with a spacing of 1 / per_pixel[0]
    shift: Shaped[Floats, "rows"]  # length by which the samples of each row are shifted right

    @property
    def size(self) -> int:
        return self.x.size * self.y.size

    def compute_ray_x(self, frame: CameraFrame) -> Shaped[Floats, "rows*columns"]:
        return np.add.outer(self.shift * frame.pixel_width, frame.to_ray_x(self.x)).ravel()

    def get_positions(
        self, sample_index: Shaped[Ints, "k"]
    ) -> tuple[Shaped[Floats, "k"], Shaped[Floats, "k"]]:
        row, column = np.divmod(sample_index, self.x.size)
        return self.x[column] + self.shift[row], self.y[row]

    def find_spans(self, shape: Shape, bounds: ScreenBounds) -> SampleSpans:
        row_size = self.x.size
        columns_per_pixel = self.per_pixel[0]
        # With a margin of one pixel, the range contains all samples: a row is shifted by at most
        # half the distance between two columns, and this distance is at most one pixel.
        x_range = self.x[0] - 1, self.x[-1] + 1
        spans = find_object_spans(
            shape, bounds, self.y, x_range, pad=_SPAN_PADDING / columns_per_pixel
        )
        # A band of height 0 is a row.
        first_x = self.x[0] + self.shift[spans.band]
        # Positions relative to the first sample of the row, in samples.
        left = (spans.left - first_x) * columns_per_pixel
        right = (spans.right - first_x) * columns_per_pixel
        span_start = np.ceil(left).clip(0, row_size).astype(np.intp)
        span_end = (np.floor(right) + 1).clip(0, row_size).astype(np.intp)
        return SampleSpans(
            object_index=spans.object_index,
            row=spans.band,
            first_sample=spans.band * row_size + span_start,
            sample_count=np.maximum(span_end - span_start, 0),
        )


@dataclass(frozen=True, eq=False, kw_only=True)
class Scattered(Samples):
    """Samples at arbitrary positions, sorted by pixel row and then by x, up to `sort_key`.

    Each sample is a row of its own, with its own y.  The number of samples in a pixel is not known,
    and assumed to be 1.
    """

    per_pixel: tuple[int, int] = (1, 1)
    x: Shaped[Floats, "rows"]
    # Index of the first sample in each pixel row.  Pixel rows without samples are omitted.
    pixel_row_start: Shaped[Ints, "pixel_rows"]
    # The pixel row and the x of each sample as one number (see `_encode_position`), in ascending
    # order.
    sort_key: Shaped[Floats, "rows"]

    @classmethod
    def from_positions(
        cls, x: Shaped[Floats, "n"], y: Shaped[Floats, "n"]
    ) -> tuple[Scattered, Shaped[Ints, "n"]]:
        """Create samples at finite positions, and return the order into which they were sorted.

        Sample i is at the position (x[order[i]], y[order[i]]).
        """
        pixel_row = np.floor(y)
        key = _encode_position(pixel_row, x)
        order = key.argsort(kind="stable")
        samples = cls(
            y=y[order],
            x=x[order],
            pixel_row_start=find(mark_run_starts(pixel_row[order])),
            sort_key=key[order],
        )
        return samples, order

    @property
    def size(self) -> int:
        return self.x.size

    def compute_ray_x(self, frame: CameraFrame) -> Shaped[Floats, "rows"]:
        return frame.to_ray_x(self.x)

    def get_positions(
        self, sample_index: Shaped[Ints, "k"]
    ) -> tuple[Shaped[Floats, "k"], Shaped[Floats, "k"]]:
        return self.x[sample_index], self.y[sample_index]

    def find_spans(self, shape: Shape, bounds: ScreenBounds) -> SampleSpans:
        """Find samples whose rays may meet objects of one shape, as spans of one sample."""
        pixel_row_top = np.floor(self.y[self.pixel_row_start])
        x_range = self.x.min(initial=0), self.x.max(initial=0)
        spans = find_object_spans(
            shape, bounds, pixel_row_top, x_range, height=1.0, pad=_SPAN_PADDING
        )
        pixel_row = pixel_row_top[spans.band]
        left_key = _encode_position(pixel_row, spans.left)
        right_key = _encode_position(pixel_row, spans.right)
        span_start = self.sort_key.searchsorted(left_key)
        span_end = self.sort_key.searchsorted(right_key, side="right")
        span_size = np.maximum(span_end - span_start, 0)
        span_index, sample_index = enumerate_ranges(span_size, span_start)
        return SampleSpans(
            object_index=spans.object_index[span_index],
            row=sample_index,
            first_sample=sample_index,
            sample_count=None,
        )


def _encode_position(pixel_row: Shaped[Floats, "n"], x: Shaped[Floats, "n"]) -> Shaped[Floats, "n"]:
    """Encode each position as one number, so that the numbers sort by pixel row and then by x.

    `x` may be infinite.  Two positions may have equal numbers if they are less than 1/8 pixel
    apart, or if both are farther from the left edge of the picture than `_MAX_SORTED_X`.
    """
    # The factor is a power of two, so the product is exact.  Only the sum is rounded, which never
    # reverses the order of two positions.  A picture has at most 2^28 pixels along a side
    # (`schema.MAX_PIXELS`), so the sum is at most about 2^50, where the distance between
    # neighbouring floats is 1/8 or less: far less than `_SPAN_PADDING`.
    return np.asarray(pixel_row * (4 * _MAX_SORTED_X) + x.clip(-_MAX_SORTED_X, _MAX_SORTED_X))
