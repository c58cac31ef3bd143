"""Classification of cells: what the sample in a cell's middle tells of all of the cell.

A cell is a square of the picture: a pixel, or a part of one.  Besides what the sample in its middle
sees, `classify` finds the straight lines that edges draw across the cell, and which objects may
keep lights from any part of it.  A cell that may hold more than such lines is *unresolved*.
"""

from __future__ import annotations

from itertools import chain
from typing import NamedTuple

import numpy as np

from tracer.antialias.edges import Seen, footprints_of, silhouettes
from tracer.antialias.lines import Lines
from tracer.antialias.margins import Sheets, fitted
from tracer.arrays import Bools, Floats, Ints, indices
from tracer.light.lighting import (
    Lighting,
    ids_of,
    incoming_at,
    narrow_highlights,
    radiance_at,
    shade,
)
from tracer.shadow.occlusion import shadow_edges
from tracer.view.samples import Samples, Scattered
from tracer.view.visibility import visible_and_hidden

# Cells with a larger footprint than this, as a part of the distance to a light, are split.
_WIDE = 0.1


class Cells(NamedTuple):
    """Squares of the picture: pixels, or parts of them.

    Attributes
    ----------
    size : float
        Width of a cell, in pixels.
    tolerance : float
        By how much a cell's mean may be off, in radiance.
    x, y : (n,)
        Their middles, in pixels.
    cell, owner : (m,)
        Pairs of a cell and an object whose silhouette may cross it.
    """

    size: float
    tolerance: float
    x: Floats
    y: Floats
    cell: Ints
    owner: Ints

    def at(self, cell: Ints, x: Floats, y: Floats) -> tuple[Floats, Floats]:
        """One point, x and y from -1/2 to 1/2, in each of some cells."""
        return self.x[cell] + self.size * x, self.y[cell] + self.size * y

    def quarters(self, index: Ints) -> Cells:
        """Quarters of some cells, four after four."""
        count, quarter = index.size, np.array([-0.25, 0.25])
        x, y = np.tile(quarter, 2 * count), np.tile(quarter.repeat(2), count)
        x, y = self.at(index.repeat(4), x, y)
        place = np.full(self.x.size, -1)
        place[index] = np.arange(count)
        cell = place[self.cell]
        kept = indices(cell >= 0)
        quarters = (4 * cell[kept, None] + np.arange(4)).ravel()
        return Cells(self.size / 2, self.tolerance, x, y, quarters, self.owner[kept].repeat(4))


class Classification(NamedTuple):
    """What is known of n cells.

    Attributes
    ----------
    radiance : (3, n)
        Of the sample in each cell's middle.
    id : (n,)
        Of object, face and lights there, see `ids_of`; -1 where nothing is seen.
    lines : Lines
        What divides the cells.
    unresolved : (n,)
        Whether a cell may hold more than straight lines.
    """

    radiance: Floats
    id: Ints
    lines: Lines
    unresolved: Bools


def radiance_in(lighting: Lighting, x: Floats, y: Floats) -> tuple[Floats, Ints]:
    """Radiance (3, n) and ids (n,), as in `Classification`, at positions in any order."""
    radiance, ids, found = np.empty((3, x.size)), *np.full((2, x.size), -1)
    if x.size:
        samples, order = Scattered.of(x, y)
        radiance[:, order] = radiance_at(lighting, samples, ids=found)
        ids[order] = found
    return radiance, ids


def classify(
    lighting: Lighting,
    cells: Cells,
    samples: Samples,
    cell: Ints,
) -> Classification:
    """Classify cells by the samples in their middles.

    `cell` (n,): the cell of each sample.
    """
    radiance, ids = np.zeros((3, cell.size)), np.full(cell.size, -1)
    unresolved = np.zeros(cell.size, dtype=np.bool_)
    hits, hidden = visible_and_hidden(lighting.view, samples)
    incoming, place = incoming_at(lighting, hits), cell[hits.sample]
    facing = incoming.n_dot_l > 0
    footprint = footprints_of(hits, cells.size)
    # Cells that see so much of a surface are split anyway: the edges of shadows are not sought.
    wide = np.any(incoming.length2 < (footprint / _WIDE) ** 2, axis=0)
    unresolved[place[wide]] = True
    blocked, found = shadow_edges(lighting.occluders, hits, facing, np.where(wide, 0, footprint))
    lit = facing & ~blocked
    for channel, values in zip(radiance, shade(incoming, lit), strict=True):
        channel[place] = values
    ids[place] = ids_of(hits, lit)
    for narrow in narrow_highlights(incoming, facing, footprint):
        unresolved[place[narrow]] = True
    lights, sheets = (lighting.positions, lighting.local), Sheets.of(hits)
    seen = Seen(hits, *lights, sheets, place, footprint, cells.size)
    x, y = cells.x[cells.cell], cells.y[cells.cell]
    margins = chain(
        silhouettes(lighting.view, cells.cell, cells.owner, x, y, cells.size),
        seen.intersections(hidden),
        seen.shadows(*found),
        seen.terminators(incoming.n_dot_l, incoming.length2),
        seen.creases(),
    )
    lines, curved = fitted(margins, cells.tolerance)
    unresolved[curved] = True
    return Classification(radiance, ids, lines, unresolved)
