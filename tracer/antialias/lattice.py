"""Where samples lie: on the same lattice in all pixels, or anywhere."""

from __future__ import annotations

from collections.abc import Callable
from math import ceil
from typing import NamedTuple, TypeAlias

import numpy as np

from tracer.arrays import Floats, Ints, changes, expand, ranges
from tracer.view.camera import Raster
from tracer.view.outlines import Spans

__all__ = ["CENTRES", "Covered", "Lattice", "Rows", "Samples", "Scattered"]

# Of rank-1 lattices with so many points: by how many columns each lies to the right of that above.
_GENERATORS = {5: 2, 13: 5, 25: 7}

# A lattice has at least this many points for each of the grid's.
_MORE = 2.5


class Covered(NamedTuple):
    """Where objects may be seen.

    Attributes
    ----------
    owner : (spans,)
        Which sphere or box.
    row : (spans,)
        Index into the samples' `y`.
    first : (spans,)
        The first of a span of samples.
    counts : (spans,), or None
        How many there are; None if every span has one.
    """

    owner: Ints
    row: Ints
    first: Ints
    counts: Ints | None

    def take(self, index: Ints) -> Covered:
        """Some of the spans."""
        counts = None if self.counts is None else self.counts[index]
        return Covered(self.owner[index], self.row[index], self.first[index], counts)

    def samples(self) -> Ints:
        """All samples, span by span."""
        return self.first if self.counts is None else ranges(self.first, self.counts)


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
        """How many there are."""
        return self.x.size * self.y.size

    def across(self, raster: Raster) -> Floats:
        """First component of each sample's ray."""
        return np.add.outer(self.shift * raster.step_u, raster.across(self.x)).ravel()

    def positions(self) -> tuple[Floats, Floats]:
        """x and y of all samples."""
        return np.add.outer(self.shift, self.x).ravel(), self.y.repeat(self.x.size)

    def at(self, index: Ints) -> tuple[Floats, Floats]:
        """x and y of some samples."""
        row, column = np.divmod(index, self.x.size)
        return self.x[column] + self.shift[row], self.y[row]

    def covered(self, spans: Callable[[Floats, float], Spans]) -> Covered:
        """Where objects may be seen, given the function from rows and their height to `spans`."""
        owner, row, left, right = spans(self.y, 0.0)
        columns = self.x.size
        first = self.x[0] + self.shift[row]
        start = np.ceil(left - first).astype(np.intp)
        stop = np.floor(right - first).astype(np.intp) + 1
        start.clip(0, columns, out=start)
        stop.clip(0, columns, out=stop)
        return Covered(owner, row, row * columns + start, np.maximum(stop - start, 0))


class Scattered(NamedTuple):
    """Samples anywhere, sorted pixel by pixel, and downwards in each.

    Attributes
    ----------
    y, x : (n,)
        In pixels from the picture's upper left corner.
    row : (n,)
        The row of pixels each is in.
    pixel : (n,)
        A number for each pixel: row * (2 * `beside` + 1) + column.
    beside : int
        All columns are less, to either side.
    """

    y: Floats
    x: Floats
    row: Ints
    pixel: Floats
    beside: int

    @classmethod
    def of(cls, x: Floats, y: Floats) -> tuple[Scattered, Ints]:
        """Positions, in any order, as samples; and which position each sample has."""
        row, beside = np.floor(y), ceil(np.abs(x).max(initial=0)) + 1
        pixel = row * (2 * beside + 1) + np.floor(x)
        # One number for pixel and height is sorted several times as fast as three.
        order = np.argsort(pixel + (y - row) / 2, kind="stable")
        return cls(y[order], x[order], row[order].astype(np.intp), pixel[order], beside), order

    @property
    def size(self) -> int:
        """How many there are."""
        return self.x.size

    def across(self, raster: Raster) -> Floats:
        """First component of each sample's ray."""
        return raster.across(self.x)

    def at(self, index: Ints) -> tuple[Floats, Floats]:
        """x and y of some samples."""
        return self.x[index], self.y[index]

    def covered(self, spans: Callable[[Floats, float], Spans]) -> Covered:
        """Where objects may be seen, given the function from rows and their height to `spans`."""
        tops = self.row[changes(self.row)]
        owner, row, left, right = spans(tops.astype(np.float64), 1.0)
        # Whole pixels: so samples are sorted.
        beside, begin = self.beside, tops[row] * (2 * self.beside + 1)
        first, last = (begin + np.clip(np.floor(m), -beside, beside) for m in (left, right))
        start = self.pixel.searchsorted(first)
        stop = self.pixel.searchsorted(last, side="right")
        span, sample = expand(np.maximum(stop - start, 0), start)
        return Covered(owner[span], sample, sample, None)


Samples: TypeAlias = Rows | Scattered
"""Where rays are sent."""


class Lattice(NamedTuple):
    """Points of a pixel: its centre, or a square grid rotated by atan(1 / 2), say.

    Where edges follow the rows or columns of an upright grid, as those of boxes often do, they pass
    a whole row of points at once; in most other directions all square grids do equally well.  In
    this one few points of a pixel share a row or a column, and yet it repeats from pixel to
    pixel: it is a rank-1 lattice (Dammertz and Keller, Image synthesis by rank-1 lattices, 2008) of
    13 or 25 points, or one of five that is repeated `columns` times across the pixel and down.  A
    quarter turn maps it onto itself, so what is smooth is averaged as well as by an upright grid.
    Where all pixels have it (`samples`), every other row of them has its mirror image: an edge
    along one of its own directions meets those in only half of the pixels.

    Attributes
    ----------
    columns : int
        Points in each row.
    rows : int
        1 for the centre alone, else 13, 25 or 5 * `columns`.
    """

    columns: int
    rows: int

    @classmethod
    def of(cls, per_side: int) -> Lattice:
        """A lattice that mostly errs less than an upright grid of per_side x per_side points.

        As many points as the grid's are enough for the mean error of most pictures; more are for
        the largest error, and for edges along the lattice's own directions.
        """
        repeated = (cls(columns, 5 * columns) for columns in range(2, per_side + 1))
        lattices = (m for m in (cls(1, 13), cls(1, 25), *repeated) if m.size >= _MORE * per_side**2)
        return min(lattices, key=lambda m: m.size)

    @property
    def size(self) -> int:
        """Points in a pixel."""
        return self.columns * self.rows

    def samples(self, rows: slice, columns: slice) -> Rows:
        """The points in a rectangle of pixels, in units of the lattice's rows and columns."""
        row = np.arange(self.rows * rows.start, self.rows * rows.stop)
        column = np.arange(self.columns * columns.start, self.columns * columns.stop)
        y, x = (each.astype(np.float64) + 0.5 for each in (row, column))
        return Rows(y, x, self._shift(row))

    def points(self) -> tuple[Floats, Floats]:
        """x and y of the points, row by row, from -1/2 to 1/2 across the pixel."""
        row, column = np.arange(self.rows), np.arange(self.columns)
        x = np.add.outer(self._shift(row), column + 0.5) / self.columns - 0.5
        return x.ravel(), np.repeat((row + 0.5) / self.rows - 0.5, self.columns)

    def mean(self, radiance: Floats, width: int) -> Floats:
        """Mean (height, width, 3) over pixels of radiance (3, n) at all their `samples`."""
        each = radiance.reshape(3, -1, self.rows, width, self.columns)
        # Row by row: how NumPy adds along an axis depends on the width.
        total = each[:, :, 0].copy()
        for row in range(1, self.rows):
            total += each[:, :, row]
        return np.moveaxis(total.sum(axis=3) / self.size, 0, 2)

    def _shift(self, row: Ints) -> Floats:
        """How far each row is moved, in columns, so that its middle row and column cross."""
        points = self.rows // self.columns
        middle = points // 2
        place = (_GENERATORS.get(points, 0) * (row - middle) + middle) % points
        shift: Floats = (place - middle) / points
        return np.where(row // self.rows % 2, -shift, shift)


CENTRES = Lattice(1, 1)
"""The one point in the middle of each pixel."""
