"""Antialiasing: as many samples as a pixel needs, and no more.

Most pixels see one smooth surface: there the sample at the centre, with a
correction for curvature, is worth more than any number of samples.  Where an
outline, a box edge, a shadow edge or a narrow highlight crosses a pixel, it
gets the full grid of samples.  Outlines are known in closed form, so objects
between the pixel centres are found however small they are.
"""

from __future__ import annotations

import numpy as np

from tracer.camera import Raster
from tracer.groups import Bools, dot
from tracer.lighting import Keys, Lighting, shade
from tracer.pencil import Spans
from tracer.scene import Floats, Ints
from tracer.visibility import Hits, Samples, View, grid, visible

__all__ = ["antialiased"]

_CHUNK = 1 << 15

# The curvature correction may be off by a part of itself; where that could show, sample.
_CURVATURE = 4e-3


def antialiased(
    view: View, lighting: Lighting, top: int, bottom: int, left: int, right: int, per_side: int
) -> Floats:
    """Radiance (bottom - top, right - left, 3), averaged over each pixel of a rectangle.

    At least as accurate as `per_side` x `per_side` samples in every pixel.
    """
    width, rows = right - left, bottom - top
    # A pixel more on every side: each pixel is compared with its neighbours.
    samples = grid(top - 1, bottom + 1, left - 1, right + 1)
    shape = (rows + 2, width + 2)
    radiance, key, edge = _pixels(view, lighting, samples)
    radiance = radiance.reshape(*shape, 3)
    image = radiance[1:-1, 1:-1]
    around = radiance[:-2, 1:-1] + radiance[2:, 1:-1] + radiance[1:-1, :-2] + radiance[1:-1, 2:]
    # The mean over a pixel is the centre's value plus a 24th of the Laplacian.
    curvature = (around - 4 * image) / 24
    marked = edge.reshape(shape)[1:-1, 1:-1] | _differ(key.reshape(shape))
    marked |= np.abs(curvature).max(axis=2) > _CURVATURE / per_side
    for spans in _spans(view, top, bottom, per_side):
        marked |= _crossed(spans, rows, left, width, per_side)
    image = image + curvature
    row, column = np.nonzero(marked)
    if row.size:
        image[row, column] = _sampled(view, lighting, top + row, left + column, per_side)
    return image


def _pixels(view: View, lighting: Lighting, samples: Samples) -> tuple[Floats, Ints, Bools]:
    """Radiance (n, 3) and key (n,) of pixels' centres, and whether pixels hold an edge.

    That is the edge of a shadow, or of one surface where it leaves another;
    the key is -1 where nothing is seen.
    """
    radiance, key = np.zeros((samples.x.size, 3)), np.full(samples.x.size, -1)
    edge = np.zeros(samples.x.size, dtype=np.bool_)
    for hits in visible(view, samples, close=edge):
        count = hits.t.size
        keys = Keys(
            _footprint(view.raster, hits),
            np.empty(count, dtype=np.intp),
            np.zeros(count, dtype=np.bool_),
        )
        for k, values in enumerate(shade(lighting, hits, keys)):
            radiance[hits.sample, k] = values
        key[hits.sample] = keys.key
        edge[hits.sample] |= keys.undecided
    return radiance, key, edge


def _footprint(raster: Raster, hits: Hits) -> Floats:
    """Radius (n,) on the surface, around each point, of what its pixel sees."""
    length = np.sqrt(dot(hits.direction, hits.direction))
    cosine = np.abs(dot(hits.n, hits.direction)) / length
    # Nearly edge-on, outlines mark the pixel anyway.
    half = 0.5 * float(np.hypot(raster.step_u, raster.step_v))
    return hits.t * half / np.maximum(cosine, 0.02)


def _differ(key: Ints) -> Bools:
    """Whether a pixel's key differs from one of its eight neighbours'."""
    high = np.maximum(np.maximum(key[:-2], key[1:-1]), key[2:])
    low = np.minimum(np.minimum(key[:-2], key[1:-1]), key[2:])
    high = np.maximum(np.maximum(high[:, :-2], high[:, 1:-1]), high[:, 2:])
    low = np.minimum(np.minimum(low[:, :-2], low[:, 1:-1]), low[:, 2:])
    differ: Bools = high != low
    return differ


def _spans(view: View, top: int, bottom: int, per_side: int) -> tuple[Spans, Spans]:
    """Outlines in every row of the sampling grid."""
    y = top + (np.arange((bottom - top) * per_side) + 0.5) / per_side
    return view.outlines.sphere_spans(y), view.outlines.box_spans(y)


def _crossed(spans: Spans, rows: int, first_column: int, width: int, per_side: int) -> Bools:
    """Which pixels an outline crosses, by the spans in each row of the sampling grid.

    Between the leftmost and the rightmost place at which an object begins (or
    ends) in the rows of one pixel, its outline crosses; an object that misses
    some of these rows has its top or bottom there, and crosses wherever it is.
    """
    if not spans.owner.size:
        return np.zeros((rows, width), dtype=np.bool_)
    pixel_row = spans.row // per_side
    group = spans.owner * rows + pixel_row
    order = np.argsort(group, kind="stable")
    first = np.flatnonzero(np.diff(group[order], prepend=-1))
    counts = np.diff(first, append=order.size)
    left, right = spans.left[order], spans.right[order]
    left_min, left_max = np.minimum.reduceat(left, first), np.maximum.reduceat(left, first)
    right_min, right_max = np.minimum.reduceat(right, first), np.maximum.reduceat(right, first)
    whole = (counts < per_side) | (left_max >= right_min)
    left_max = np.where(whole, right_max, left_max)
    row = pixel_row[order][first]
    # +1 where crossed pixels begin and -1 after they end: a running sum marks them.
    edge = np.zeros((rows, width + 3), dtype=np.intp)
    for begin, end in ((left_min, left_max), (right_min, right_max)):
        np.add.at(edge, (row, _pixel(begin - first_column, width)), 1)
        np.add.at(edge, (row, _pixel(end - first_column, width) + 1), -1)
    crossed: Bools = edge.cumsum(axis=1)[:, 1 : width + 1] > 0
    return crossed


def _pixel(x: Floats, width: int) -> Ints:
    """Column + 1 of the pixel at x; 0 and width + 1 are outside."""
    column: Ints = np.clip(np.floor(x).astype(np.intp) + 1, 0, width + 1)
    return column


def _sampled(view: View, lighting: Lighting, row: Ints, column: Ints, per_side: int) -> Floats:
    """Mean radiance (n, 3) of a grid of samples in each of some pixels.

    `row` and `column` (n,) are in reading order.
    """
    mean = np.empty((row.size, 3))
    steps = (np.arange(per_side) + 0.5) / per_side
    chunk = max(1, _CHUNK // per_side**2)
    for begin in range(0, row.size, chunk):
        end = min(begin + chunk, row.size)
        new_row = np.diff(row[begin:end], prepend=-1) != 0
        y = (row[begin:end][new_row][:, None] + steps).ravel()
        # Each pixel crosses per_side rows of samples: sort these by row, then by column.
        pixel_row = np.cumsum(new_row) - 1
        across = (pixel_row[:, None] * per_side + np.arange(per_side)).ravel()
        order = np.argsort(across, kind="stable")
        pixel = order // per_side
        x = (column[begin:end][pixel][:, None] + steps).ravel()
        samples = Samples(y, np.repeat(across[order], per_side), x)
        pixel = np.repeat(pixel, per_side)
        total = np.zeros((3, end - begin))
        for hits in visible(view, samples):
            for k, values in enumerate(shade(lighting, hits)):
                total[k] += np.bincount(pixel[hits.sample], values, minlength=end - begin)
        mean[begin:end] = total.T / per_side**2
    return mean
