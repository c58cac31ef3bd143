"""Find the pixels that the silhouettes of objects may cross.

A *silhouette* is the outline of an object, seen from the eye.  Every pixel that it may cross is
found, even if no sample hits the object there.
"""

from __future__ import annotations

from typing import Annotated as Shaped
from typing import NamedTuple

import numpy as np

from tracer.arrays import Floats, Ints, enumerate_ranges
from tracer.geometry.shape import Shape
from tracer.trace.samples import ObjectSpans, find_object_spans
from tracer.world.prepared_scene import PreparedScene


class PixelObjects(NamedTuple):
    """Pairs of a pixel and an object whose silhouette may cross it."""

    row: Shaped[Ints, "n"]
    column: Shaped[Ints, "n"]
    object_index: Shaped[Ints, "n"]


def find_silhouette_pixels(scene: PreparedScene, rows: slice, columns: slice) -> PixelObjects:
    """Find the pixels of a rectangle that the silhouette of each object may cross.

    Objects are convex, so an object covers a pixel entirely if it covers the upper and the lower
    edge of the pixel.  All other pixels that it overlaps are found.
    """
    interval_sets = list[_PixelIntervals]()
    for shape in scene.shapes:
        interval_sets += _find_partly_covered(shape, scene, rows, columns)
    intervals = _PixelIntervals._make(map(np.concatenate, zip(*interval_sets, strict=True)))
    start_column = intervals.start.clip(columns.start, columns.stop).astype(np.intp)
    stop_column = intervals.stop.clip(columns.start, columns.stop).astype(np.intp)
    interval_index, column = enumerate_ranges(stop_column - start_column, start_column)
    return PixelObjects(
        row=intervals.row[interval_index] + rows.start,
        column=column,
        object_index=intervals.object_index[interval_index],
    )


class _PixelIntervals(NamedTuple):
    """Ranges of pixels in a row, each paired with an object; they may be empty."""

    row: Shaped[Ints, "n"]  # counted from 0 at the top of the rectangle
    object_index: Shaped[Ints, "n"]
    # The first column, and the column after the last one; they may be outside the picture.
    start: Shaped[Floats, "n"]
    stop: Shaped[Floats, "n"]


def _find_partly_covered(
    shape: Shape, scene: PreparedScene, rows: slice, columns: slice
) -> tuple[_PixelIntervals, _PixelIntervals]:
    """Find the pixels of each row that each object of one shape covers in part.

    In a row, an object may cover some pixels entirely.  The first result contains the overlapped
    pixels to the left of these, or all overlapped pixels if none is covered entirely.  The second
    result contains the overlapped pixels to the right.
    """
    pixel_row_top = np.arange(rows.start, rows.stop, dtype=np.float64)
    column_limits = (columns.start, columns.stop)
    spans = find_object_spans(shape, scene.bounds, pixel_row_top, column_limits, height=1.0)
    overlap_start = np.floor(spans.left)
    overlap_stop = np.floor(spans.right) + 1
    covered = _find_covered_parts(shape, scene, spans, pixel_row_top[spans.band])
    # Shrink the covered parts to whole pixels.
    covered_start = np.ceil(covered.left).clip(overlap_start, overlap_stop)
    covered_stop = np.floor(covered.right).clip(covered_start, overlap_stop)
    left_pixels = _PixelIntervals(
        row=spans.band,
        object_index=spans.object_index,
        start=overlap_start,
        stop=covered_start,
    )
    return left_pixels, left_pixels._replace(start=covered_stop, stop=overlap_stop)


class _CoveredParts(NamedTuple):
    """The part of each row, from its upper to its lower edge, that an object covers.

    If the object covers no such part, `left` is infinite, and `right` is minus infinity.
    """

    left: Shaped[Floats, "n"]
    right: Shaped[Floats, "n"]


def _find_covered_parts(
    shape: Shape, scene: PreparedScene, spans: ObjectSpans, top: Shaped[Floats, "n"]
) -> _CoveredParts:
    """Find the part of a row that the object of each span covers; `top` is the row's upper edge."""
    object_index = spans.object_index
    bottom = top + 1
    covered_left = spans.left
    covered_right = spans.right
    for y in (top, bottom):
        left_on_edge, right_on_edge = shape.find_x_range(object_index, y, 0.0)
        covered_left = np.maximum(covered_left, left_on_edge)
        covered_right = np.minimum(covered_right, right_on_edge)
    bounds = scene.bounds
    covers_row = (bounds.top[object_index] < top) & (bounds.bottom[object_index] > bottom)
    covers_row &= covered_left < covered_right
    return _CoveredParts(
        left=np.where(covers_row, covered_left, np.inf),
        right=np.where(covers_row, covered_right, -np.inf),
    )
