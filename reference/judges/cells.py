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
from reference.judges.enclosures import Enclosures
from reference.judges.faces import Faces

MAX_WIDTH = 8
"""Maximum width, in pixels, of cells that have triples, and whose pixels may be finished together.
A power of two."""


class Cells(NamedTuple):
    """c square cells of equal width that cover parts of a picture, with p pairs and q triples.

    A pair consists of a cell, and a face (a sphere, or a side of a box) that may be visible in the
    cell.  A light is settled for a pair if it is known to reach either all or nothing of the face
    in the cell.  A triple consists of a pair, a light, and an object that may shade a part of the
    face from the light.

    Attributes
    ----------
    width : float
        Width of the cells in pixels; a power of two.
    x, y : (c,) float arrays
        Centres of the cells, in pixels from the upper left corner of the picture.
    pair_cell, pair_face : (p,) int arrays
        The cell and the face of each pair.
    covers_cell : (p,) bool array
        Whether the pair's face covers all of the pair's cell.
    is_settled : (p, lights) bool array
        Whether the light is settled for the pair.
    radiance : Enclosures
        Enclosures (8, 3, p) of the radiance that all settled lights together add to the pair.
    triples : (3, q) int array
        Row 0 contains indices of pairs, row 1 of lights, and row 2 of the objects that may shade
        the pair's face from the light.
    """

    width: float
    x: Floats
    y: Floats
    pair_cell: Ints
    pair_face: Ints
    covers_cell: Bools
    is_settled: Bools
    radiance: Enclosures
    triples: Ints

    def select_triples(self, kept: Bools) -> Cells:
        """Copy all cells and pairs, but only the selected triples.

        A pair is a cell, and a face that may be visible in it.  A triple is a pair, a light, and an
        object that may shade the pair's face from the light.

        Parameters
        ----------
        kept : (q,) bool array
            Whether to keep each triple.

        Returns
        -------
        cells : Cells
            All cells and pairs, with the selected triples.
        """
        return self._replace(triples=self.triples.compress(kept, axis=1))

    def select_pairs(self, kept: Bools) -> tuple[Cells, Ints]:
        """Copy all cells, but only the selected pairs and their triples.

        A pair is a cell, and a face that may be visible in it.  A triple is a pair, a light, and an
        object that may shade the pair's face from the light.

        Parameters
        ----------
        kept : (p,) bool array
            Whether to keep each pair.

        Returns
        -------
        cells : Cells
            All cells, with the selected pairs and their triples.
        new_index : (p,) int array
            For each old pair, its index among the selected pairs, or -1 if it is not selected.
        """
        new_index = np.where(kept, kept.cumsum() - 1, -1)
        pair, light, occluder = self.triples
        names = "pair_cell", "pair_face", "covers_cell", "is_settled", "radiance"
        fields: dict[str, Any] = {name: getattr(self, name)[kept] for name in names}
        triples = np.array([new_index[pair], light, occluder])
        cells = self._replace(**fields, triples=triples)
        return cells.select_triples(cells.triples[0] >= 0), new_index

    def select_cells(self, kept: Bools) -> Cells:
        """Copy the selected cells, with all of their pairs and triples.

        A pair is a cell, and a face that may be visible in it.  A triple is a pair, a light, and an
        object that may shade the pair's face from the light.

        Parameters
        ----------
        kept : (c,) bool array
            Whether to keep each cell.

        Returns
        -------
        cells : Cells
            The selected cells.
        """
        new_index = np.where(kept, kept.cumsum() - 1, -1)
        pair_cell = new_index[self.pair_cell]
        cells = self._replace(x=self.x[kept], y=self.y[kept], pair_cell=pair_cell)
        return cells.select_pairs(pair_cell >= 0)[0]

    @property
    def area(self) -> float:
        """Area of all cells together, in square pixels."""
        return self.x.size * self.width**2

    def split_into_quarters(self, width: int, height: int) -> Cells:
        """Divide every cell into four quarters, each with copies of the cell's pairs and triples.

        A pair (a cell and a face that may be visible in it) and a triple (a pair, a light and an
        object that may shade the face from the light) may not matter in every quarter.  They are
        not tested here.

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
            pair_cell=(4 * self.pair_cell[:, None] + quarter).ravel(),
            pair_face=self.pair_face.repeat(4),
            covers_cell=self.covers_cell.repeat(4),
            is_settled=self.is_settled.repeat(4, axis=0),
            radiance=self.radiance.split_into_quarters(),
            triples=np.array([4 * pair + np.tile(quarter, pair.size // 4), light, occluder]),
        )
        is_inside = (x - offset < width) & (y - offset < height)
        return quarters if is_inside.all() else quarters.select_cells(is_inside)


def make_initial_cells(faces: Faces, width: int, height: int) -> Cells:
    """Cover a picture with a row or a column of square cells.

    The width of the cells is a power of two, in pixels: the smallest that is at least both 16 and
    the shorter side of the picture.

    Parameters
    ----------
    faces : Faces
        The spheres and the sides of boxes in the scene.
    width, height : int
        Size of the picture in pixels.

    Returns
    -------
    cells : Cells
        The cells.  Each is paired with every face that may be visible to the camera.  Lights known
        to reach no visible point of a face are settled.  There are no triples (of a cell with a
        face, a light, and an object that may shade the face).
    """
    cell_width = 2.0 ** np.ceil(np.log2(max(2 * MAX_WIDTH, min(width, height))))
    rows, columns = int(np.ceil(height / cell_width)), int(np.ceil(width / cell_width))
    y, x = (np.indices((rows, columns)).reshape(2, -1) + 0.5) * cell_width
    visible = np.flatnonzero(faces.may_be_visible)
    pair_cell, pair_face = np.arange(x.size).repeat(visible.size), np.tile(visible, x.size)
    return Cells(
        width=cell_width,
        x=x,
        y=y,
        pair_cell=pair_cell,
        pair_face=pair_face,
        covers_cell=np.zeros(pair_face.size, np.bool_),
        is_settled=faces.is_unlit[:, pair_face].T,
        radiance=Enclosures(np.zeros((8, 3, pair_face.size))),
        triples=np.zeros((3, 0), dtype=np.intp),
    )
