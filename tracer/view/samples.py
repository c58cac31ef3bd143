"""Positions of samples in the picture, in rows or anywhere, and which of them see what."""

from __future__ import annotations

from typing import NamedTuple, TypeAlias

import numpy as np

from tracer.arrays import Floats, Ints, changes, expand, indices
from tracer.view.camera import Raster
from tracer.view.view import Shape, View

# Spans are widened by this many pixels before rays are tried: far more than they err.
_PAD = 0.5


def spans(
    shape: Shape,
    view: View,
    rows: Floats,
    columns: tuple[float, float],
    height: float = 0.0,
    pad: float = 0.0,
) -> tuple[Ints, Ints, Floats, Floats]:
    """Intervals of ascending rows that objects of a shape cover, widened by `pad` pixels.

    Returns the object, the index into `rows`, and the left and right ends.  Exact but for rounding
    if the rows' `height` is 0.  What is beside the `columns` is left out.
    """
    frames = view.frames.take(slice(shape.first, shape.first + shape.count))
    at = indices((frames.left - pad <= columns[1]) & (frames.right + pad >= columns[0]))
    begin = rows.searchsorted(frames.top[at] - pad - height)
    end = rows.searchsorted(frames.bottom[at] + pad, side="right")
    which, row = expand(np.maximum(end - begin, 0), begin)
    at = at[which]
    left, right = shape.ends(view.raster, at + shape.first, rows[row], height)
    left, right = np.maximum(left, frames.left[at]), np.minimum(right, frames.right[at])
    keep = indices(left <= right)
    return at[keep] + shape.first, row[keep], left[keep] - pad, right[keep] + pad


class Rows(NamedTuple):
    """Samples in rows, from the picture's upper left corner.

    The unit is the pixel of the raster that gives their rays: for a `Lattice` that is a finer
    one, with the lattice's columns and rows in every pixel of the picture.

    Attributes
    ----------
    y : (rows,)
        Ascending.
    x : (columns,)
        Ascending, one pixel apart.
    shift : (rows,)
        How far each row is moved to the right.
    """

    y: Floats
    x: Floats
    shift: Floats

    @property
    def size(self) -> int:
        """Number of samples."""
        return self.x.size * self.y.size

    def across(self, raster: Raster) -> Floats:
        """First component of each sample's ray."""
        return np.add.outer(self.shift * raster.step_u, raster.across(self.x)).ravel()

    def at(self, index: Ints) -> tuple[Floats, Floats]:
        """x and y of some samples."""
        row, column = np.divmod(index, self.x.size)
        return self.x[column] + self.shift[row], self.y[row]

    def covered(self, shape: Shape, view: View) -> tuple[Ints, Ints, Ints, Ints]:
        """Spans of samples that may see a shape: object, index in `y`, first sample, and length."""
        beside, columns = (self.x[0] - 1, self.x[-1] + 1), self.x.size
        owner, row, left, right = spans(shape, view, self.y, beside, pad=_PAD)
        first = self.x[0] + self.shift[row]
        start = np.ceil(left - first).clip(0, columns).astype(np.intp)
        stop = (np.floor(right - first) + 1).clip(0, columns).astype(np.intp)
        return owner, row, row * columns + start, np.maximum(stop - start, 0)


class Scattered(NamedTuple):
    """Samples anywhere, sorted by rows of pixels and along these.

    Attributes
    ----------
    y, x : (n,)
        In pixels from the picture's upper left corner.
    place : (n,)
        One number for both row and x, in ascending order: row * `wide` + x.
    wide : float
        More than twice any x, to either side.
    """

    y: Floats
    x: Floats
    place: Floats
    wide: float

    @classmethod
    def of(cls, x: Floats, y: Floats) -> tuple[Scattered, Ints]:
        """Positions, in any order, as samples; and which position each sample has."""
        wide = 2.0 * float(np.ceil(np.abs(x).max(initial=0))) + 2
        place = np.floor(y) * wide + x
        order = place.argsort(kind="stable")
        return cls(y[order], x[order], place[order], wide), order

    @property
    def size(self) -> int:
        """Number of samples."""
        return self.x.size

    @property
    def row(self) -> Floats:
        """The row of pixels (n,) that each is in."""
        return np.floor(self.y)

    def across(self, raster: Raster) -> Floats:
        """First component of each sample's ray."""
        return raster.across(self.x)

    def at(self, index: Ints) -> tuple[Floats, Floats]:
        """x and y of some samples."""
        return self.x[index], self.y[index]

    def covered(self, shape: Shape, view: View) -> tuple[Ints, Ints, Ints, None]:
        """See `Rows.covered`: here each sample is a span of its own, and no length is given."""
        rows, half = self.row[changes(self.row)], self.wide / 2
        owner, row, left, right = spans(shape, view, rows, (-half, half), height=1.0, pad=_PAD)
        begin = rows[row] * self.wide
        start = self.place.searchsorted(begin + left.clip(-half, half))
        stop = self.place.searchsorted(begin + right.clip(-half, half), side="right")
        span, sample = expand(np.maximum(stop - start, 0), start)
        return owner[span], sample, sample, None


Samples: TypeAlias = Rows | Scattered
"""Positions in the picture through which rays are traced."""
