"""Cells: the square parts into which antialiasing divides the picture.

A cell is a pixel or a square part of a pixel.  Antialiasing begins with whole pixels, and divides
cells into quarters where edges cross them.
"""

from __future__ import annotations

from typing import Annotated as Shaped
from typing import NamedTuple

import numpy as np

from tracer.antialias.lattice import Lattice, Points2D
from tracer.arrays import Floats, Ints, find


class Cells(NamedTuple):
    """Cells of one width, with the accuracy that is requested in each."""

    width: float  # width of each cell, in pixels
    # The result should be as accurate as a uniform grid of this many samples along each side of a
    # cell.  The number decides whether a cell that edges cross is sampled or divided.
    samples_per_side: int
    # Maximum error of the mean radiance of a cell.  It decides which edges are straight enough to
    # be represented by lines, and which smooth cells need no more samples.
    tolerance: float
    center_x: Shaped[Floats, "cells"]  # in pixels from the left edge of the picture
    center_y: Shaped[Floats, "cells"]  # in pixels from the upper edge of the picture
    # The cell and the object of each pair: the object's silhouette may cross the cell.
    pair_cell_index: Shaped[Ints, "pairs"]
    pair_object_index: Shaped[Ints, "pairs"]

    def to_picture(
        self, cell_index: Shaped[Ints, "n"], point_in_cell: Shaped[Points2D, "n"]
    ) -> tuple[Shaped[Floats, "n"], Shaped[Floats, "n"]]:
        """Convert points x + iy of cells to x and y in the picture.

        Points are relative to the center of their cell, in units of its width.
        """
        x = self.center_x[cell_index] + self.width * point_in_cell.real
        y = self.center_y[cell_index] + self.width * point_in_cell.imag
        return x, y

    def divide(self, cell_index: Shaped[Ints, "n"]) -> Cells:
        """Divide the given cells into quarters; the four of the first given cell come first.

        `cell_index` must not contain duplicates.  Each quarter has half of the samples along each
        side, rounded up.  It is paired with the same objects as the divided cell.
        """
        quarter_centers = np.tile(Lattice(2, 2).list_points(), cell_index.size)
        x, y = self.to_picture(cell_index.repeat(4), quarter_centers)
        # For each cell, its position in `cell_index`; -1 if the cell is not divided.
        divided_index = np.full(self.center_x.size, -1)
        divided_index[cell_index] = np.arange(cell_index.size)
        pair_divided_index = divided_index[self.pair_cell_index]
        kept_index = find(pair_divided_index >= 0)
        return Cells(
            width=self.width / 2,
            samples_per_side=(self.samples_per_side + 1) // 2,
            tolerance=self.tolerance,
            center_x=x,
            center_y=y,
            pair_cell_index=(4 * pair_divided_index[kept_index, None] + np.arange(4)).ravel(),
            pair_object_index=self.pair_object_index[kept_index].repeat(4),
        )
