"""Cells of the picture, and lists of what may be visible in each cell and of what may shade it.

The problem: the certificate must know every face that may be visible in a small part of the
picture, and every object that may shade such a face, without testing all against all.  As in
Warnock's subdivision (A hidden surface algorithm for computer generated halftone pictures, 1969),
a cell inherits the lists of the cell of which it is a quarter, and drops what no longer matters.

cell
    A square part of the picture.
pair
    A cell, and a face that may be visible in it.
settled
    A light is settled for a pair if it is known to reach all of the face in the cell, in which case
    its radiance has been added to the pair's, or if it is known to reach nothing of it.
triple
    A pair, a light and an object that may shade a part of the face from the light.

The tracer's antialiasing divides cells into quarters, too.  This module does not use its code, on
purpose: a reference that shares code with what it validates would repeat its errors.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from reference.judges.arrays import Bools, Floats, Ints
from reference.judges.faces import Faces
from reference.judges.forms import Form

MAX_WIDTH = 8
"""Maximum width, in pixels, of cells that have triples, and whose pixels may be finished together.
A power of two."""


class Cells(NamedTuple):
    """Cells of equal width, with p pairs and q triples.

    Attributes
    ----------
    width : float
        Width of the cells in pixels; a power of two.
    x, y : (c,) float arrays
        Centres of the cells, in pixels from the upper left corner of the picture.
    cell, face : (p,) int arrays
        The cell and the face of each pair.
    covers : (p,) bool array
        Whether the face covers all of the cell.
    is_settled : (p, lights) bool array
        Whether the light is settled for the pair.
    radiance : Form
        Enclosures (8, 3, p) of the radiance that settled lights add to the pair.
    triples : (3, q) int array
        Row 0 contains indices of pairs, row 1 of lights, and row 2 of objects.
    """

    width: float
    x: Floats
    y: Floats
    cell: Ints
    face: Ints
    covers: Bools
    is_settled: Bools
    radiance: Form
    triples: Ints

    def with_triples(self, kept: Bools) -> Cells:
        """Select triples by a mask (q,)."""
        return self._replace(triples=self.triples.compress(kept, axis=1))

    def with_pairs(self, kept: Bools) -> tuple[Cells, Ints]:
        """Select pairs by a mask (p,), and their triples.

        Returns
        -------
        cells : Cells
            All cells, with the selected pairs.
        new_index : (p,) int array
            The index of each old pair among the selected ones, or -1.
        """
        new_index = np.where(kept, kept.cumsum() - 1, -1)
        pair, light, occluder = self.triples
        names = "cell", "face", "covers", "is_settled", "radiance"
        pairs: dict[str, Any] = {name: getattr(self, name)[kept] for name in names}
        triples = np.array([new_index[pair], light, occluder])
        cells = self._replace(**pairs, triples=triples)
        return cells.with_triples(cells.triples[0] >= 0), new_index

    def take(self, kept: Bools) -> Cells:
        """Select cells by a mask (c,), and their pairs."""
        cell = np.where(kept, kept.cumsum() - 1, -1)[self.cell]
        cells = self._replace(x=self.x[kept], y=self.y[kept], cell=cell)
        return cells.with_pairs(cell >= 0)[0]

    @property
    def area(self) -> float:
        """Area of all cells together, in pixels."""
        return self.x.size * self.width**2

    def quarters(self, width: int, height: int) -> Cells:
        """Divide every cell into four quarters, which inherit its pairs and triples.

        Parameters
        ----------
        width, height : int
            Size of the picture in pixels.

        Returns
        -------
        quarters : Cells
            The quarters, except those that lie outside the picture.
        """
        quarter, offset = np.arange(4), self.width / 4
        x = np.add.outer(self.x, (2 * (quarter & 1) - 1) * offset).ravel()
        y = np.add.outer(self.y, (quarter & 2) * offset - offset).ravel()
        pair, light, occluder = self.triples.repeat(4, axis=1)
        quarters = Cells(
            width=self.width / 2,
            x=x,
            y=y,
            cell=(4 * self.cell[:, None] + quarter).ravel(),
            face=self.face.repeat(4),
            covers=self.covers.repeat(4),
            is_settled=self.is_settled.repeat(4, axis=0),
            radiance=self.radiance.quarters(),
            triples=np.array([4 * pair + np.tile(quarter, pair.size // 4), light, occluder]),
        )
        is_inside = (x - offset < width) & (y - offset < height)
        return quarters if is_inside.all() else quarters.take(is_inside)


def first_cells(faces: Faces, width: int, height: int) -> Cells:
    """Cover a picture by a row or a column of cells, each as wide as the picture is narrow.

    Parameters
    ----------
    faces : Faces
        The scene.
    width, height : int
        Size of the picture in pixels.

    Returns
    -------
    cells : Cells
        The cells, each paired with every face that may be visible; there are no triples.
    """
    cell_width = 2.0 * MAX_WIDTH
    while cell_width < min(width, height):
        cell_width *= 2
    shape = int(np.ceil(height / cell_width)), int(np.ceil(width / cell_width))
    y, x = (np.indices(shape).reshape(2, -1) + 0.5) * cell_width
    visible = np.flatnonzero(faces.may_be_visible)
    cell, face = np.arange(x.size).repeat(visible.size), np.tile(visible, x.size)
    radiance, triples = Form(np.zeros((8, 3, face.size))), np.zeros((3, 0), dtype=np.intp)
    is_settled = faces.is_unlit[:, face].T
    return Cells(cell_width, x, y, cell, face, cell < 0, is_settled, radiance, triples)
