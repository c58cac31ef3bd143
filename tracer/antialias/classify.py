"""Classify cells: can the centre sample stand for the whole cell?

A cell is a square of the picture: a pixel, or a part of one.  Besides what the sample in its middle
sees, `classify` finds the straight lines that edges draw across the cell, and which objects may
keep lights from any part of it.  A cell that may hold more than such lines is *unresolved*.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import chain
from typing import NamedTuple

import numpy as np

from tracer.antialias.edge_functions import EdgeValues, InverseDepth, Lines, fit_lines, rays
from tracer.antialias.edges import Apexes, CellSurfaces, footprints_of, pieces, silhouettes
from tracer.antialias.lattice import Lattice, Points2D
from tracer.arrays import Bools, Floats, Ints, indices
from tracer.geometry.camera import CameraFrame
from tracer.trace.lighting import Shading, light_geometry, narrow_highlights
from tracer.trace.occlusion import shadow_edges
from tracer.trace.samples import Samples
from tracer.trace.visibility import nearest_and_hidden
from tracer.world.prepared_scene import Lights, PreparedScene

# Cells with a larger footprint than this, as a part of the distance to a light, are split.
_WIDE = 0.1

MOST_LINES = 4
"""Of the lines in a cell, this many divide it into regions; the others are left to its samples."""

# A cell with more lines than this is crowded: to split it would cost more than it gains.  With more
# lights than this no one of them matters much: more than `MOST_LINES` are enough.
_CROWDED = 24


class Cells(NamedTuple):
    """Squares of the picture: pixels, or parts of them.

    Attributes
    ----------
    size : float
        Width of a cell, in pixels.
    per_side : int
        Samples along a cell's side in the grid that is asked for.
    tolerance : float
        By how much a cell's mean may be off, in radiance.
    x, y : (n,)
        Their middles, in pixels.
    cell, obj : (m,)
        Pairs of a cell and an object whose silhouette may cross it.
    """

    size: float
    per_side: int
    tolerance: float
    x: Floats
    y: Floats
    cell: Ints
    obj: Ints

    def at(self, cell: Ints, point: Points2D) -> tuple[Floats, Floats]:
        """One point, x + iy from -1/2 to 1/2, in each of some cells."""
        return self.x[cell] + self.size * point.real, self.y[cell] + self.size * point.imag

    def quarters(self, index: Ints) -> Cells:
        """Quarters of some cells, four after four."""
        count = index.size
        x, y = self.at(index.repeat(4), np.tile(Lattice(2, 2).points(), count))
        rank = np.full(self.x.size, -1)
        rank[index] = np.arange(count)
        cell = rank[self.cell]
        kept = indices(cell >= 0)
        quarters = (4 * cell[kept, None] + np.arange(4)).ravel()
        half, per_side, obj = self.size / 2, (self.per_side + 1) // 2, self.obj[kept].repeat(4)
        return Cells(half, per_side, self.tolerance, x, y, quarters, obj)


class Classification(NamedTuple):
    """What is known of n cells.

    Attributes
    ----------
    cells : Cells
    radiance : (3, n)
        Of the sample in each cell's middle.
    id : (n,)
        Of object, face and lights there, see `Shading`; -1 where nothing is seen.
    lines : Lines
        What divides the cells, sorted and distinct: the first `MOST_LINES` of each.
    unresolved : (n,)
        Whether a cell may hold more than straight lines.
    crowded : (n,)
        Whether it may hold more edges than were worth finding.
    """

    cells: Cells
    radiance: Floats
    id: Ints
    lines: Lines
    unresolved: Bools
    crowded: Bools


def classify(prepared: PreparedScene, cells: Cells, samples: Samples, cell: Ints) -> Classification:
    """Classify cells by the samples in their middles.

    `cell` (n,): the cell of each sample.
    """
    radiance, ids = np.empty((3, cell.size)), np.full(cell.size, -1)
    unresolved = np.zeros(cell.size, dtype=np.bool_)
    hits, hidden = nearest_and_hidden(prepared, samples)
    hit_cell, footprint = cell[hits.sample], footprints_of(hits, cells.size)
    surfaces = CellSurfaces(hits, InverseDepth.of(hits), hit_cell, footprint, cells.size)
    seen = _outlines(prepared, cells), surfaces.intersections(hidden), surfaces.creases()
    lines, curved = fit_lines(chain(*seen), cells.tolerance)
    unresolved[curved], crowded = True, np.zeros_like(unresolved)
    shading, found = Shading(hits, with_ids=True), [lines]
    for lights in prepared.light_batches:
        geometry = light_geometry(hits, lights)
        facing = geometry.n_dot_l > 0
        # Cells that see so much of a surface are split anyway: shadows' edges are not sought.
        wide = np.any(geometry.length2 < (footprint / _WIDE) ** 2, axis=0)
        blocked, edges, many = shadow_edges(hits, lights, facing, np.where(wide, 0, footprint))
        shading.add(geometry, facing & ~blocked)
        apexes = _apexes(prepared.frame, lights)
        lit = (
            surfaces.shadows(apexes, *edges),
            surfaces.terminators(apexes, geometry.n_dot_l, geometry.length2),
        )
        lines, curved = fit_lines(chain(*lit), cells.tolerance)
        found.append(lines)
        for split in (hit_cell[wide | many], curved):
            unresolved[split] = True
        crowded[hit_cell[many]] = True
        for narrow in narrow_highlights(geometry, facing, footprint):
            unresolved[hit_cell[narrow]] = True
    radiance[:, cell] = shading.at_samples(np.zeros((3, samples.size)))
    ids[hit_cell] = shading.ids
    lines = Lines.joined(found).distinct()
    most = MOST_LINES if prepared.light_count > _CROWDED else _CROWDED
    crowded |= np.bincount(lines.cell, minlength=cell.size) > most
    return Classification(cells, radiance, ids, lines.first(MOST_LINES), unresolved, crowded)


def _outlines(prepared: PreparedScene, cells: Cells) -> Iterator[EdgeValues]:
    """Silhouettes that the eye sees."""
    frame, apexes = prepared.frame, (prepared.frame.eye[None], np.zeros((1, 3)))
    for pair in pieces(np.arange(cells.cell.size)):
        cell, obj = cells.cell[pair], cells.obj[pair]
        d = rays(frame, frame.across(cells.x[cell]), frame.down(cells.y[cell]), cells.size)
        yield from silhouettes(prepared, apexes, np.zeros_like(cell), cell, obj, d)


def _apexes(frame: CameraFrame, lights: Lights) -> Apexes:
    """The lights; suns are taken nearer, as in their grids."""
    if lights.grid is None:
        return lights.position, lights.local
    position = lights.grid.light[:, :, 0].T
    return position, np.column_stack(frame.to_camera(position))


def curvature(radiance: Floats, ids: Ints, width: int) -> tuple[Floats, Floats]:
    """Pixels' means (3, n) from the samples at their centres, where smooth, and their error (n,).

    `radiance` (3, n) and `ids` (n,) as in `Classification`, with n = height * width.

    The mean of f over a pixel is f + (f_xx + f_yy) / 24 and terms of higher order.  Derivatives
    are differences between a pixel and its neighbours, where both of these see the same as it
    does; where only one does, the difference counts as error; where neither does, that is NaN.
    Results for pixels on the border are meaningless.
    """
    total, error = np.zeros(radiance.shape), np.zeros(ids.size)
    for stride in (1, width):
        middle = slice(stride, -stride)
        same = ids[stride:] == ids[:-stride]
        step = (radiance[:, stride:] - radiance[:, :-stride]) * same
        bend = (step[:, stride:] - step[:, :-stride]) / 24
        before, after = same[:-stride], same[stride:]
        change = np.where(before | after, np.abs(bend).max(axis=0), np.nan)
        error[middle] = np.maximum(error[middle], change)
        total[:, middle] += bend * (before & after)
    return radiance + total, error


def extrapolated(radiance: Floats, ids: Ints, quarters: Classification) -> tuple[Floats, Floats]:
    """`curvature` of quarters of cells, from what the cells' centres and their own see.

    `radiance` (3, n), `ids` (n,): of the cells.

    Where all see the same, the cell's mean is that of its quarters' centres, plus a third of its
    difference from the cell's centre (Richardson's extrapolation).  Elsewhere the error is NaN.
    """
    fine = quarters.radiance.reshape(3, -1, 4)
    alike = (quarters.id.reshape(-1, 4) == ids[:, None]).all(axis=1)
    bend = np.where(alike, (fine.mean(axis=2) - radiance) / 3, 0)
    # What this leaves out is of higher order in the cells' size; half of the correction covers it.
    error = np.where(alike, np.abs(bend).max(axis=0) / 2, np.nan)
    return quarters.radiance + bend.repeat(4, axis=1), error.repeat(4)
