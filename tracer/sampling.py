"""Where samples lie: on the same lattice in all pixels, or anywhere."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tracer.arrays import Floats, Ints
from tracer.camera import Raster
from tracer.outlines import Spans

__all__ = ["CENTRES", "Lattice", "Samples"]


class Samples(NamedTuple):
    """Sample positions, row by row, from the picture's upper left corner.

    The unit is the pixel of the raster that gives their rays: for a `Lattice` that is a finer
    one, with the lattice's columns and rows in every pixel of the picture.

    Attributes
    ----------
    y : (rows,)
        Ascending.
    x : (columns,) or (n,)
        Position along the row, ascending within each row.
    row : (n,), optional
        Index into `y`, ascending; without it, every row holds all of `x`, one pixel apart.
    shift : (rows,)
        How far each row is moved to the right; used only without `row`.
    """

    y: Floats
    x: Floats
    row: Ints | None = None
    shift: Floats = np.zeros(0)

    @property
    def size(self) -> int:
        """How many there are."""
        return self.x.size if self.row is not None else self.x.size * self.y.size

    def across(self, raster: Raster) -> Floats:
        """First component of each sample's ray."""
        s = raster.across(self.x)
        return s if self.row is not None else np.add.outer(self.shift * raster.step_u, s).ravel()

    def positions(self) -> tuple[Floats, Floats]:
        """x and y of all samples."""
        if self.row is not None:
            return self.x, self.y[self.row]
        return np.add.outer(self.shift, self.x).ravel(), np.repeat(self.y, self.x.size)

    def at(self, index: Ints) -> tuple[Floats, Floats]:
        """x and y of some samples."""
        if self.row is not None:
            return self.x[index], self.y[self.row[index]]
        row, column = np.divmod(index, self.x.size)
        return self.x[column] + self.shift[row], self.y[row]

    def within(self, spans: Spans) -> tuple[Ints, Ints]:
        """First sample in each span, and the number of samples there."""
        if self.row is None:
            columns = self.x.size
            first = self.x[0] + self.shift[spans.row]
            start = np.ceil(spans.left - first).astype(np.intp)
            stop = np.floor(spans.right - first).astype(np.intp) + 1
            np.clip(start, 0, columns, out=start)
            np.clip(stop, 0, columns, out=stop)
            return spans.row * columns + start, np.maximum(stop - start, 0)
        # Lay the rows end to end on one axis, so far apart that no span reaches into the next.
        ends = (self.x, spans.left, spans.right)
        stride = 4 * (max(float(np.abs(end).max(initial=0)) for end in ends) + 2)
        key = self.row * stride + self.x
        start = np.searchsorted(key, spans.row * stride + spans.left)
        stop = np.searchsorted(key, spans.row * stride + spans.right, side="right")
        return start, np.maximum(stop - start, 0)


class Lattice(NamedTuple):
    """Points of a pixel: its centre, or a square grid rotated by atan(1 / 2).

    Where edges follow the rows or columns of an upright grid, as those of boxes often do, they pass
    a whole row of points at once; in most other directions all square grids do equally well.  In
    this one few points of a pixel share a row or a column, and yet it repeats from pixel to
    pixel: it is a rank-1 lattice of five points (Dammertz and Keller, Image synthesis by rank-1
    lattices, 2008), repeated `columns` times across the pixel and down.  A quarter turn maps it
    onto itself, so what is smooth is averaged as well as by an upright grid.  Where all
    pixels have it (`samples`), every other row of them has its mirror image: an edge along one of
    its own directions meets those in only half of the pixels.

    Attributes
    ----------
    columns : int
        Points in each row.
    rows : int
        1 for the centre alone, else 5 * `columns`.
    """

    columns: int
    rows: int

    @classmethod
    def of(cls, per_side: int) -> Lattice:
        """A lattice that mostly errs less than an upright grid of per_side x per_side points.

        A quarter more points than the grid's are enough for the mean error; the largest error is a
        matter of chance, hence one more repetition of the five points across and down.
        """
        columns = (per_side + 1) // 2 + 1
        return cls(columns, 5 * columns)

    @property
    def size(self) -> int:
        """Points in a pixel."""
        return self.columns * self.rows

    def samples(self, rows: slice, columns: slice) -> Samples:
        """The points in a rectangle of pixels, in units of the lattice's rows and columns."""
        row = np.arange(self.rows * rows.start, self.rows * rows.stop)
        column = np.arange(self.columns * columns.start, self.columns * columns.stop)
        y, x = (each.astype(np.float64) + 0.5 for each in (row, column))
        return Samples(y, x, shift=self._shift(row))

    def points(self) -> tuple[Floats, Floats]:
        """x and y of the points, row by row, from -1/2 to 1/2 across the pixel."""
        row, column = np.arange(self.rows), np.arange(self.columns)
        x = np.add.outer(self._shift(row), column + 0.5) / self.columns - 0.5
        return x.ravel(), np.repeat((row + 0.5) / self.rows - 0.5, self.columns)

    def mean(self, radiance: Floats, width: int) -> Floats:
        """Mean (height, width, 3) over pixels of radiance (3, n) at all their `samples`."""
        each = radiance.reshape(3, -1, self.rows, width, self.columns).sum(axis=2)
        return np.moveaxis(each.sum(axis=3) / self.size, 0, 2)

    def _shift(self, row: Ints) -> Floats:
        """How far each row is moved, in columns: by two fifths from one to the next."""
        steps = self.rows // self.columns
        middle = steps // 2
        place = (2 * (row - middle) + middle) % steps
        shift: Floats = (place - middle) / steps
        return np.where(row // self.rows % 2, -shift, shift)


CENTRES = Lattice(1, 1)
"""The one point in the middle of each pixel."""
