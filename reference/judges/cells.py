"""List the faces that may be visible in cells of the picture, and the objects that may shade them.

The certificate (see `certificate`) must know every face that may be visible in a small part of the
picture, and every object that may shade such a face, without testing all combinations.  As in
Warnock's subdivision (A hidden surface algorithm for computer generated halftone pictures, 1969),
large cells are divided into quarters.  Each quarter inherits the lists of the larger cell, and
drops the entries that do not matter in it.

cell
    A square part of the picture.
face
    A sphere, or a side of a box (see `faces`).
pair
    A face that may be visible in a cell.
settled
    A light is settled for a pair if it is known to reach all of the face in the cell, or none of
    it.  If it reaches all, its contribution has been added to the pair's radiance.
triple
    A pair, a light, and an object that may shade the face from the light.

The tracer's antialiasing divides cells into quarters, too.  This module does not use its code, on
purpose: a reference that shares code with what it validates would repeat its errors.
"""

from __future__ import annotations

from typing import Annotated as Shaped
from typing import Any, NamedTuple

import numpy as np

from reference.judges.arrays import Bools, Floats, Ints, list_segment_elements
from reference.judges.certified_scene import CertifiedScene
from reference.judges.enclosures import Enclosures

MAX_WIDTH = 8
"""Maximum width in pixels of cells that have triples, and that can be finished undivided.

It is a power of two.
"""


class Cells(NamedTuple):
    """Square cells of equal width that cover parts of a picture, with their pairs and triples.

    A pair is a face that may be visible in a cell.  A triple adds a light, and an object that may
    shade the face from the light.
    """

    width: float  # in pixels; a power of two
    # Centres of the cells, in pixels from the upper left corner of the picture.
    x: Shaped[Floats, "cells"]
    y: Shaped[Floats, "cells"]
    cell_index: Shaped[Ints, "pairs"]
    face_index: Shaped[Ints, "pairs"]
    covers_cell: Shaped[Bools, "pairs"]  # whether the pair's face covers all of its cell
    is_settled: Shaped[Bools, "pairs lights"]
    radiance: Enclosures  # (8, 3, pairs), of the radiance due to all settled lights
    shadow_triples: Shaped[Ints, "3 triples"]  # rows: indices of pairs, lights, and objects

    def select_triples(self, is_selected: Shaped[Bools, "triples"]) -> Cells:
        """Copy all cells and pairs, but only the selected triples."""
        return self._replace(shadow_triples=self.shadow_triples.compress(is_selected, axis=1))

    def select_pairs(
        self, is_selected: Shaped[Bools, "pairs"]
    ) -> tuple[Cells, Shaped[Ints, "pairs"]]:
        """Copy all cells, but only the selected pairs and their triples.

        Return also the index of each pair in the copy; -1 if the pair is not selected.
        """
        new_index = _renumber(is_selected)
        pair_fields = "cell_index", "face_index", "covers_cell", "is_settled", "radiance"
        fields: dict[str, Any] = {name: getattr(self, name)[is_selected] for name in pair_fields}
        old_pair_index, light_index, object_index = self.shadow_triples
        pair_index = new_index[old_pair_index]
        triples = np.array([pair_index, light_index, object_index])
        cells = self._replace(**fields, shadow_triples=triples)
        return cells.select_triples(pair_index >= 0), new_index

    def select_cells(self, is_selected: Shaped[Bools, "cells"]) -> Cells:
        """Copy the selected cells with all their pairs and triples."""
        cell_index = _renumber(is_selected)[self.cell_index]
        cells = self._replace(x=self.x[is_selected], y=self.y[is_selected], cell_index=cell_index)
        return cells.select_pairs(cell_index >= 0)[0]

    def list_combined_pairs(self) -> Shaped[Ints, "2 n"]:
        """List all combinations of two pairs of the same cell, each once, by their indices."""
        # A position is an index into the pairs sorted by cell.
        sorted_index = np.argsort(self.cell_index, kind="stable")
        sorted_cell_index = self.cell_index[sorted_index]
        cell_start = sorted_cell_index.searchsorted(sorted_cell_index)
        # Combine each pair with all earlier pairs of its cell.
        earlier_count = np.arange(sorted_index.size) - cell_start
        later_position, earlier_position = list_segment_elements(earlier_count, cell_start)
        return np.array([sorted_index[later_position], sorted_index[earlier_position]])

    @property
    def area(self) -> float:
        """Total area of all cells, in square pixels."""
        return self.x.size * self.width**2

    def split_into_quarters(self, picture_width: int, picture_height: int) -> Cells:
        """Divide each cell into four quarters with the same pairs and triples.

        Each cell becomes four adjacent ones: upper left, upper right, lower left, lower right.
        Quarters outside the picture are dropped.
        """
        quarter_index = np.arange(4)
        is_right = quarter_index & 1
        is_lower = quarter_index >> 1
        half_width = self.width / 4  # of a quarter
        x = np.add.outer(self.x, (2 * is_right - 1) * half_width).ravel()
        y = np.add.outer(self.y, (2 * is_lower - 1) * half_width).ravel()
        # Pairs are numbered like quarters: pair i becomes the pairs 4 i to 4 i + 3.
        triples = self.shadow_triples.repeat(4, axis=1)
        triples[0] = 4 * triples[0] + np.tile(quarter_index, self.shadow_triples.shape[1])
        quarters = Cells(
            width=self.width / 2,
            x=x,
            y=y,
            cell_index=(4 * self.cell_index[:, None] + quarter_index).ravel(),
            face_index=self.face_index.repeat(4),
            covers_cell=self.covers_cell.repeat(4),
            is_settled=self.is_settled.repeat(4, axis=0),
            radiance=self.radiance.split_into_quarters(),
            shadow_triples=triples,
        )
        is_inside = (x - half_width < picture_width) & (y - half_width < picture_height)
        return quarters if is_inside.all() else quarters.select_cells(is_inside)


def _renumber(is_selected: Shaped[Bools, "n"]) -> Shaped[Ints, "n"]:
    """Number the selected elements from 0 in their order; the others get -1."""
    return np.where(is_selected, is_selected.cumsum() - 1, -1)


class Contributions(NamedTuple):
    """What single lights add to the radiance of pairs, sorted by pair and light.

    It is what the pair's face reflects to the eye wherever the light reaches the face.
    """

    pair_index: Shaped[Ints, "n"]
    light_index: Shaped[Ints, "n"]
    radiance: Enclosures  # (8, 3, n)

    def select(self, is_selected: Shaped[Bools, "n"]) -> Contributions:
        return Contributions._make(field[is_selected] for field in self)


def make_initial_cells(scene: CertifiedScene, width: int, height: int) -> Cells:
    """Cover a picture of `width` times `height` pixels with a row or a column of square cells.

    The width of the cells is a power of two: at least 16 pixels, and at least the shorter side of
    the picture.  Each cell forms a pair with every face that may be visible to the camera.  Lights
    that certainly do not reach a face are settled for its pairs.  There are no triples yet.
    """
    cell_width = 2.0 ** np.ceil(np.log2(max(2 * MAX_WIDTH, min(width, height))))
    row_count = int(np.ceil(height / cell_width))
    column_count = int(np.ceil(width / cell_width))
    y, x = (np.indices((row_count, column_count)).reshape(2, -1) + 0.5) * cell_width
    visible_face_index = np.flatnonzero(scene.faces.may_be_visible)
    face_index = np.tile(visible_face_index, x.size)
    return Cells(
        width=cell_width,
        x=x,
        y=y,
        cell_index=np.arange(x.size).repeat(visible_face_index.size),
        face_index=face_index,
        covers_cell=np.zeros(face_index.size, np.bool_),
        is_settled=scene.is_unlit[:, face_index].T,
        radiance=Enclosures(np.zeros((8, 3, face_index.size))),
        shadow_triples=np.zeros((3, 0), dtype=np.intp),
    )
