"""Lattices: arrangements of the points in a pixel through which rays are traced.

The edges of boxes often follow the rows or columns of an upright grid.  Then a small shift of an
edge changes a whole row of samples, so the error is large.  In a rotated lattice, few points share
a row or a column, and yet the samples of a picture lie in rows if all pixels have the same lattice.

In a *rank-1 lattice*, each row contains one point, which lies a fixed number of columns to the
right of the point in the row above, modulo the number of rows.  The lattices of this module are
those that a quarter turn maps onto themselves.  So they average a smooth function as accurately as
an upright grid.

Dammertz and Keller, Image synthesis by rank-1 lattices, Monte Carlo and Quasi-Monte Carlo Methods
2006, 2008.
"""

from __future__ import annotations

from typing import Annotated as Shaped
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from tracer.arrays import Floats, Ints
from tracer.trace.samples import Rows

# Points x + iy in a cell (a pixel or a square part of a pixel), relative to its center, in units of
# the cell's width: x and y are between -1/2 and 1/2, and the y-axis points down.
Points2D: TypeAlias = NDArray[np.complex128]

# For each number m of points in a rank-1 lattice, the number k of columns between the points of two
# successive rows.  A quarter turn maps the point in row 1 and column k to row k and column -1.  It
# maps the lattice onto itself, because the point in row k is in column k^2 = -1 modulo m.
_COLUMN_STEPS = {5: 2, 13: 5, 25: 7, 65: 18}

# A lattice that replaces an upright grid has at least this many points for each point of the grid.
# Fewer points are enough for the mean error of most pictures, but not for the largest error, or for
# edges parallel to lines of the lattice.
_POINTS_PER_GRID_POINT = 2.5


class Lattice(NamedTuple):
    """Sample points of a pixel: an upright grid, or copies of a rank-1 lattice.

    An upright grid has equal numbers of rows and columns.  A rank-1 lattice of m points (5, 13, 25
    or 65) has one column and m rows.  If it is repeated k times in both directions, it has k
    columns and k m rows.
    """

    column_count: int  # number of points in each row of a pixel
    row_count: int  # number of rows of points in a pixel

    @classmethod
    def choose(cls, grid_side: int, min_ratio: float = _POINTS_PER_GRID_POINT) -> Lattice:
        """Choose the smallest lattice that can replace an upright grid in a pixel.

        The grid has `grid_side` x `grid_side` points.  The lattice has at least `min_ratio` times
        as many points; `min_ratio` must be at most 5.  The lattice is one of 13, 25 or 65 points,
        or consists of copies of a lattice of 5 points.
        """
        candidates = [cls(1, 13), cls(1, 25), cls(1, 65)]
        candidates += [cls(columns, 5 * columns) for columns in range(1, grid_side + 1)]
        min_size = min_ratio * grid_side**2
        large_enough = [lattice for lattice in candidates if lattice.size >= min_size]
        return min(large_enough, key=lambda lattice: lattice.size)

    @property
    def size(self) -> int:
        """Number of points of the lattice in a pixel."""
        return self.column_count * self.row_count

    def place_in_pixels(self, pixel_rows: slice, pixel_columns: slice) -> Rows:
        """Place the lattice in every pixel of a rectangle of the picture.

        Both slices must have a start and a stop.  Every second row of pixels contains the mirror
        image of the lattice.
        """
        # Rows and columns of lattice points, numbered from the upper left corner of the picture.
        row = np.arange(self.row_count * pixel_rows.start, self.row_count * pixel_rows.stop)
        column = np.arange(
            self.column_count * pixel_columns.start, self.column_count * pixel_columns.stop
        )
        return Rows(
            y=(row + 0.5) / self.row_count,
            x=(column + 0.5) / self.column_count,
            shift=self._compute_row_shift(row) / self.column_count,
            per_pixel=(self.column_count, self.row_count),
        )

    def list_points(self) -> Shaped[Points2D, "n"]:
        """List the lattice points of a single pixel, row by row."""
        x, y = self.place_in_pixels(slice(0, 1), slice(0, 1)).get_positions(np.arange(self.size))
        return np.asarray(x - 0.5 + 1j * (y - 0.5))

    def average(
        self, radiance: Shaped[Floats, "3 samples"], width: int
    ) -> Shaped[Floats, "height width 3"]:
        """Average the radiance of the samples in each pixel of a rectangle, `width` pixels wide.

        The samples must be in the order in which `place_in_pixels` numbers them.
        """
        sample_radiance = radiance.reshape(3, -1, self.row_count, width, self.column_count)
        # Add row by row.  NumPy's order of summation along an axis depends on the width, so the
        # last digits of the mean would depend on the rectangle.
        row_sum = sample_radiance[:, :, 0].copy()
        for sample_row in range(1, self.row_count):
            row_sum += sample_radiance[:, :, sample_row]
        return np.moveaxis(row_sum.sum(axis=3) / self.size, 0, 2)

    def _compute_row_shift(self, sample_row: Shaped[Ints, "rows"]) -> Shaped[Floats, "rows"]:
        """Compute by how much each row of sample points is shifted to the right of an upright grid.

        The rows are numbered from the top of the picture.  The shift is between -1/2 and 1/2, in
        units of the distance between two points in a row.
        """
        # The middle row of a rank-1 lattice is not shifted.
        point_count = self.row_count // self.column_count
        middle = point_count // 2
        column = (_COLUMN_STEPS.get(point_count, 0) * (sample_row - middle) + middle) % point_count
        # If all lattices were the same, an edge could be parallel to lattice lines in every pixel.
        is_mirrored = sample_row // self.row_count % 2
        return np.where(is_mirrored, middle - column, column - middle) / point_count


# One point in each pixel: the center.
PIXEL_CENTERS = Lattice(1, 1)
