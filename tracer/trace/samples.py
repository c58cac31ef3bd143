"""Positions of samples in the picture, in rows or anywhere, and which of them see what."""

from __future__ import annotations

from typing import NamedTuple, TypeAlias

import numpy as np

from tracer.arrays import Floats, Ints, changes, indices, segment_indices
from tracer.geometry.camera import CameraFrame
from tracer.world.prepared_scene import PreparedScene, Shape

# Spans are widened by this many pixels before rays are tried: far more than they err.
_PAD = 0.5


def spans(
    shape: Shape,
    prepared: PreparedScene,
    rows: Floats,
    columns: tuple[float, float],
    height: float = 0.0,
    pad: float = 0.0,
) -> tuple[Ints, Ints, Floats, Floats]:
    """Intervals of ascending rows that objects of a shape cover, widened by `pad` pixels.

    Returns the object, the index into `rows`, and the left and right ends.  Exact but for rounding
    if the rows' `height` is 0.  What is beside the `columns` is left out.
    """
    bounds = prepared.bounds.take(slice(shape.first, shape.first + shape.count))
    at = indices((bounds.left - pad <= columns[1]) & (bounds.right + pad >= columns[0]))
    begin = rows.searchsorted(bounds.top[at] - pad - height)
    end = rows.searchsorted(bounds.bottom[at] + pad, side="right")
    which, row = segment_indices(np.maximum(end - begin, 0), begin)
    at = at[which]
    left, right = shape.row_extent(prepared.frame, at + shape.first, rows[row], height)
    left, right = np.maximum(left, bounds.left[at]), np.minimum(right, bounds.right[at])
    keep = indices(left <= right)
    return at[keep] + shape.first, row[keep], left[keep] - pad, right[keep] + pad


class Rows(NamedTuple):
    """Samples in rows, from the picture's upper left corner.

    Attributes
    ----------
    y : (rows,)
        In pixels, ascending.
    x : (columns,)
        In pixels, ascending, equally spaced.
    shift : (rows,)
        How far each row is moved to the right, in pixels.
    per_pixel : (int, int)
        Samples across a pixel, and down.
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
        """Samples across a pixel, as `PreparedScene.packet_pixels` weighs columns and rows."""
        columns, rows = self.per_pixel
        return float(columns**0.75 * rows**0.25)

    def across(self, frame: CameraFrame) -> Floats:
        """First component of each sample's ray."""
        return np.add.outer(self.shift * frame.step_u, frame.across(self.x)).ravel()

    def at(self, index: Ints) -> tuple[Floats, Floats]:
        """x and y of some samples."""
        row, column = np.divmod(index, self.x.size)
        return self.x[column] + self.shift[row], self.y[row]

    def grid_position(self, index: Ints) -> tuple[Ints, Ints]:
        """Row and column of some samples."""
        row, column = np.divmod(index, self.x.size)
        return row, column

    def covered(self, shape: Shape, prepared: PreparedScene) -> tuple[Ints, Ints, Ints, Ints]:
        """Spans of samples that may see a shape: object, index in `y`, first sample, and length."""
        between, columns, density = (self.x[0] - 1, self.x[-1] + 1), self.x.size, self.per_pixel[0]
        obj, row, left, right = spans(shape, prepared, self.y, between, pad=_PAD / density)
        first = self.x[0] + self.shift[row]
        start = np.ceil((left - first) * density).clip(0, columns).astype(np.intp)
        stop = (np.floor((right - first) * density) + 1).clip(0, columns).astype(np.intp)
        return obj, row, row * columns + start, np.maximum(stop - start, 0)


class Scattered(NamedTuple):
    """Samples anywhere, sorted by rows of pixels and along these.

    Attributes
    ----------
    y, x : (n,)
        In pixels from the picture's upper left corner.
    key : (n,)
        One number for both row and x, in ascending order: row * `wide` + x.
    wide : float
        More than twice any x, to either side.
    """

    y: Floats
    x: Floats
    key: Floats
    wide: float

    @classmethod
    def of(cls, x: Floats, y: Floats) -> tuple[Scattered, Ints]:
        """Positions, in any order, as samples; and which position each sample has."""
        wide = 2.0 * float(np.ceil(np.abs(x).max(initial=0))) + 2
        key = np.floor(y) * wide + x
        order = key.argsort(kind="stable")
        return cls(y[order], x[order], key[order], wide), order

    @property
    def size(self) -> int:
        """Number of samples."""
        return self.x.size

    @property
    def density(self) -> float:
        """See `Rows.density`: nothing is known, so they count as one a pixel."""
        return 1.0

    @property
    def row(self) -> Floats:
        """The row of pixels (n,) that each is in."""
        return np.floor(self.y)

    def across(self, frame: CameraFrame) -> Floats:
        """First component of each sample's ray."""
        return frame.across(self.x)

    def at(self, index: Ints) -> tuple[Floats, Floats]:
        """x and y of some samples."""
        return self.x[index], self.y[index]

    def grid_position(self, index: Ints) -> tuple[Ints, Ints]:
        """Row and column of the pixels that some samples are in."""
        return self.y[index].astype(np.intp), self.x[index].astype(np.intp)

    def covered(self, shape: Shape, prepared: PreparedScene) -> tuple[Ints, Ints, Ints, None]:
        """See `Rows.covered`: here each sample is a span of its own, and no length is given."""
        rows, half = self.row[changes(self.row)], self.wide / 2
        obj, row, left, right = spans(shape, prepared, rows, (-half, half), height=1.0, pad=_PAD)
        begin = rows[row] * self.wide
        start = self.key.searchsorted(begin + left.clip(-half, half))
        stop = self.key.searchsorted(begin + right.clip(-half, half), side="right")
        span, sample = segment_indices(np.maximum(stop - start, 0), start)
        return obj[span], sample, sample, None


Samples: TypeAlias = Rows | Scattered
"""Positions in the picture through which rays are traced."""
