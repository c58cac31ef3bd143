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
from tracer.trace.samples import find_object_spans
from tracer.world.prepared_scene import PreparedScene


class PixelObjects(NamedTuple):
    """Pairs of a pixel and an object whose silhouette may cross it."""

    row: Shaped[Ints, "n"]
    column: Shaped[Ints, "n"]
    object_index: Shaped[Ints, "n"]


def find_silhouette_pixels(scene: PreparedScene, rows: slice, columns: slice) -> PixelObjects:
    """Find the pixels of a rectangle that the silhouette of each object may cross.

    Objects are convex, so one that covers the top and bottom edges of a pixel covers the whole
    pixel.  All other pixels that it overlaps may contain part of its silhouette.
    """
    interval_sets = [
        intervals
        for shape in scene.shapes
        for intervals in _find_partly_covered(shape, scene, rows, columns)
    ]
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

    row: Shaped[Ints, "n"]  # index among the given rows
    object_index: Shaped[Ints, "n"]
    # The first column, and the column after the last one; they may be outside the picture.
    start: Shaped[Floats, "n"]
    stop: Shaped[Floats, "n"]


def _find_partly_covered(
    shape: Shape, scene: PreparedScene, rows: slice, columns: slice
) -> tuple[_PixelIntervals, _PixelIntervals]:
    """Find the pixels of each row that objects cover in part: the left ones, and the right ones."""
    row_edge_y = np.arange(rows.start, rows.stop + 1, dtype=np.float64)  # top and bottom edges
    column_limits = (columns.start, columns.stop)
    spans = find_object_spans(shape, scene, row_edge_y[:-1], column_limits, height=1.0)
    object_index = spans.object_index
    # Find the x coordinates at which the object covers the top and bottom edges of the row.
    covered_left = spans.left
    covered_right = spans.right
    top_y = row_edge_y[spans.row]
    bottom_y = row_edge_y[spans.row + 1]
    for y in (top_y, bottom_y):
        left_on_edge, right_on_edge = shape.find_x_range(object_index, y, 0.0)
        covered_left = np.maximum(covered_left, left_on_edge)
        covered_right = np.minimum(covered_right, right_on_edge)
    bounds = scene.bounds
    covers_row = (bounds.top[object_index] < top_y) & (bounds.bottom[object_index] > bottom_y)
    covers_row &= covered_left < covered_right
    overlap_start = np.floor(spans.left)
    overlap_stop = np.floor(spans.right) + 1
    # Shrink the covered interval to whole pixels.  It is empty in a row that is not covered.
    covered_start = np.where(covers_row, np.ceil(covered_left), overlap_stop)
    covered_stop = np.where(covers_row, np.floor(covered_right), overlap_stop)
    covered_start = covered_start.clip(overlap_start, overlap_stop)
    covered_stop = covered_stop.clip(covered_start, overlap_stop)
    return (
        _PixelIntervals(
            row=spans.row, object_index=object_index, start=overlap_start, stop=covered_start
        ),
        _PixelIntervals(
            row=spans.row, object_index=object_index, start=covered_stop, stop=overlap_stop
        ),
    )
