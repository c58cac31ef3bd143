"""Outlines across the picture: which pixels each may cross, and the lines they draw in cells.

So objects are found as well that the samples in the middles of pixels miss.
"""

from __future__ import annotations

import numpy as np

from tracer.arrays import Floats, Ints, expand
from tracer.view.samples import Spans
from tracer.view.view import View

# A line so near to the top or bottom of an object, in pixels, may touch it and no more.
_TOUCHING = 1e-6


def crossed(view: View, rows: slice, columns: slice) -> tuple[Ints, Ints, Ints]:
    """Row, column and object: the pixels of a rectangle that an outline may cross.

    Being convex, an object fills the pixels of a row whose upper and lower sides it covers.  Its
    outline may cross the others in which it is seen.
    """
    lines = np.arange(rows.start, rows.stop + 1, dtype=np.float64)
    top, bottom = view.frames.top, view.frames.bottom
    none = np.zeros(0, dtype=np.intp)
    found: list[tuple[Ints, Ints, Floats, Floats]] = [(none, none, np.zeros(0), np.zeros(0))]
    for shape in view.shapes:
        between = columns.start, columns.stop
        owner, row, left, right = Spans.of(shape, view, lines[:-1], between, height=1.0)
        full, full_end = left, right
        for line in (row, row + 1):
            begin, end = shape.ends(view.raster, owner, lines[line], 0.0)
            full, full_end = np.maximum(full, begin), np.minimum(full_end, end)
        # Where a line just touches an object, rounding decides what that covers of it.
        fills = (top[owner] < lines[row] - _TOUCHING) & (full < full_end)
        fills &= bottom[owner] > lines[row + 1] + _TOUCHING
        left, stop = np.floor(left), np.floor(right) + 1
        full, full_end = (np.where(fills, m, stop) for m in (np.ceil(full), np.floor(full_end)))
        full = np.clip(full, left, stop)
        full_end = np.clip(full_end, full, stop)
        found += [(row, owner, left, full), (row, owner, full_end, stop)]
    row, owner, start, stop = (np.concatenate(m) for m in zip(*found, strict=True))
    start, stop = (m.clip(columns.start, columns.stop).astype(np.intp) for m in (start, stop))
    span, column = expand(stop - start, start)
    return row[span] + rows.start, column, owner[span]
