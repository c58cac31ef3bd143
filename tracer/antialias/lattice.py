"""Lattices of samples: the same in all pixels."""

from __future__ import annotations

from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from tracer.arrays import Floats, Ints
from tracer.trace.samples import Rows

Points2D: TypeAlias = NDArray[np.complex128]
"""Positions x + iy in cells."""

# Of rank-1 lattices with so many points: by how many columns each lies to the right of that above.
_GENERATORS = {5: 2, 13: 5, 25: 7, 65: 18}

# A lattice has at least this many points for each of the grid's.
_MORE = 2.5


class Lattice(NamedTuple):
    """Points of a pixel: a square grid, upright or rotated by atan(1 / 2), say.

    Edges of boxes often follow the rows or columns of an upright grid, and pass a whole row of its
    points at once.  Here few points share a row or a column, and yet all pixels can have the same:
    a rank-1 lattice (Dammertz and Keller, Image synthesis by rank-1 lattices, 2008) of 13, 25 or 65
    points, or one of five that is repeated `columns` times across the pixel and down.  A quarter
    turn maps it onto itself, so what is smooth is averaged as well as by an upright grid.  Where
    all pixels have it (`samples`), every other row of them has its mirror image: an edge along one
    of its own directions meets those in only half of the pixels.

    Attributes
    ----------
    columns : int
        Points in each row.
    rows : int
        13, 25, 65 or 5 * `columns`; or, of an upright grid, as many as the columns.
    """

    columns: int
    rows: int

    @classmethod
    def of(cls, per_side: int, more: float = _MORE) -> Lattice:
        """A lattice that mostly errs less than an upright grid of per_side x per_side points.

        For the mean error of most pictures it need not have `more` points: these are for the
        largest error, and for edges along its own directions.
        """
        repeated = (cls(columns, 5 * columns) for columns in range(1, per_side + 1))
        lattices = *(cls(1, points) for points in (13, 25, 65)), *repeated
        return min((m for m in lattices if m.size >= more * per_side**2), key=lambda m: m.size)

    @property
    def size(self) -> int:
        """Points in a pixel."""
        return self.columns * self.rows

    def samples(self, rows: slice, columns: slice) -> Rows:
        """The points in a rectangle of pixels."""
        row = np.arange(self.rows * rows.start, self.rows * rows.stop)
        column = np.arange(self.columns * columns.start, self.columns * columns.stop)
        y, x = (row + 0.5) / self.rows, (column + 0.5) / self.columns
        return Rows(y, x, self._shift(row) / self.columns, (self.columns, self.rows))

    def points(self) -> Points2D:
        """The points x + iy, row by row, from -1/2 to 1/2 across the pixel."""
        row, column = np.arange(self.rows), np.arange(self.columns)
        x = np.add.outer(self._shift(row), column + 0.5) / self.columns - 0.5
        y = (row + 0.5) / self.rows - 0.5
        points: Points2D = (x + 1j * y[:, None]).ravel()
        return points

    def mean(self, radiance: Floats, width: int) -> Floats:
        """Mean (height, width, 3) over pixels of radiance (3, n) at all their `samples`."""
        points = radiance.reshape(3, -1, self.rows, width, self.columns)
        # Row by row: how NumPy adds along an axis depends on the width.
        total = points[:, :, 0].copy()
        for row in range(1, self.rows):
            total += points[:, :, row]
        return np.moveaxis(total.sum(axis=3) / self.size, 0, 2)

    def _shift(self, row: Ints) -> Floats:
        """How far each row is moved, in columns, so that its middle row and column cross."""
        points = self.rows // self.columns
        middle = points // 2
        column = (_GENERATORS.get(points, 0) * (row - middle) + middle) % points
        shift: Floats = (column - middle) / points
        return np.where(row // self.rows % 2, -shift, shift)


CENTRES = Lattice(1, 1)
"""The one point in the middle of each pixel."""
