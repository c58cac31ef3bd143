"""Outlines across the picture: which pixels each may cross, and the lines they draw in cells."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from tracer.arrays import Bools, Floats, Ints, each, expand, pick
from tracer.edges import BEND, Kind, Lines, Pencil
from tracer.looks import Cells, Seen
from tracer.outlines import Outlines, Spans
from tracer.visibility import View

__all__ = ["crossed", "outlines_across", "spans_of"]

# A limb that turns by less in a cell (radians) passes for straight: for each unit of radiance that
# a sample may be off.
_TURN = 57.0

# From a limb on, in halves of a cell, light is a function of the distance from it.
_NEAR_LIMB = 6.0


def spans_of(outlines: Outlines, top: int, height: int, per_side: int) -> Spans:
    """Spans of all objects in the rows of each pixel, and in the nearest ones above and below."""
    place = _rows_in(per_side)
    y = np.add.outer(np.arange(top, top + height), place).ravel()
    y = np.concatenate([[top - 1 + place[-1]], y, [top + height + place[0]]])
    spheres, boxes = outlines.sphere_spans(y), outlines.box_spans(y)
    boxes = boxes._replace(owner=boxes.owner + len(outlines.radius))
    return Spans(*(np.concatenate(pair) for pair in zip(spheres, boxes, strict=True)))


def _rows_in(per_side: int) -> Floats:
    """Rows in a pixel, from 0 to 1: those of the grid that is asked for, and that of its centre."""
    place = (np.arange(per_side) + 0.5) / per_side
    return place if per_side % 2 else np.insert(place, per_side // 2, 0.5)


def crossed(
    spans: Spans, left: int, height: int, width: int, per_side: int
) -> tuple[Ints, Ints, Ints]:
    """Row, column and object: pixels that an outline may cross.

    Seen in rows of samples: between the leftmost and the rightmost place at which
    an object begins (or ends) in a pixel's rows and the next ones its outline
    crosses; one that misses some of them crosses wherever it is.
    """
    owner, line, begin, end = spans.owner, spans.row - 1, spans.left, spans.right
    rows = _rows_in(per_side).size
    # The first row of a pixel is that below the pixel above, too.
    above, below = (np.flatnonzero(line % rows == k) for k in (0, rows - 1))
    span = np.concatenate([np.arange(line.size), above, below])
    row = line // rows
    row = np.concatenate([row, row[above] - 1, row[below] + 1])
    keep = np.flatnonzero((row >= 0) & (row < height))
    span, row = span[keep], row[keep]
    order = np.lexsort((row, owner[span]))
    span, row = span[order], row[order]
    first = np.flatnonzero(
        (np.diff(row, prepend=-1) != 0) | (np.diff(owner[span], prepend=-1) != 0)
    )
    if not first.size:
        return first, first, first
    (left_min, left_max), (right_min, right_max) = (
        (np.minimum.reduceat(m[span], first), np.maximum.reduceat(m[span], first))
        for m in (begin, end)
    )
    whole = (np.diff(first, append=row.size) < rows + 2) | (left_max + 1 >= right_min)
    apart = np.flatnonzero(~whole)
    start = np.concatenate([left_min, right_min[apart]])
    stop = np.concatenate([np.where(whole, right_max, left_max), right_max[apart]])
    row, owner = (np.concatenate([m, m[apart]]) for m in (row[first], owner[span][first]))
    start, stop = (np.floor(m).astype(np.intp) - left for m in (start, stop))
    start = np.maximum(start, 0)
    each_one, column = expand(np.maximum(np.minimum(stop + 1, width) - start, 0), start)
    return row[each_one], column, owner[each_one]


def outlines_across(view: View, cells: Cells, seen: Seen, rough: Bools) -> Iterator[Lines]:
    """Lines that outlines draw across cells; marks in `seen` the cells where they are not straight.

    Cells that are `rough` only because they see a sphere beside its limb have its line as well,
    and are rough no more.
    """
    outlines, spheres = view.outlines, view.surfaces.sphere_count
    at = np.flatnonzero(cells.owner < spheres)
    beside, own = seen.spheres(rough)
    cell, ball = np.append(cells.cell[at], beside), np.append(cells.owner[at], own)
    if cell.size:
        pencil = _pencil(view, cells, cell, Kind.LIMB)
        discs, turn, near = pencil.discs(pick(outlines.center, ball), outlines.radius[ball])
        straight = turn <= min(BEND, _TURN * cells.tolerance)
        seen.unresolved[cell[near & ~straight]] = True
        explained = straight & (np.abs(discs.c) < _NEAR_LIMB * discs.reach())
        explained[: at.size] = False
        rough[cell[explained]] = False
        yield discs.take(np.flatnonzero((turn <= BEND) & (discs.crosses() | explained)))
    at = np.flatnonzero(cells.owner >= spheres)
    if at.size:
        pencil = _pencil(view, cells, cells.cell[at], Kind.EDGE)
        a, b, c = each(lambda m: m.take(cells.owner[at] - spheres, axis=1), outlines.edges)
        edges, _, unknown = pencil.boxes((a, b, c / view.raster.depth))
        seen.unresolved[pencil.cell[unknown]] = True
        yield edges


def _pencil(view: View, cells: Cells, cell: Ints, kind: Kind) -> Pencil:
    """Rays through the middles of some cells, in the camera's axes."""
    raster = view.raster
    s, g = raster.across(cells.x[cell]), raster.down(cells.y[cell])
    zero, one = np.zeros(s.size), np.ones(s.size)
    return Pencil(
        kind,
        cell,
        (s, g, raster.depth * one),
        (raster.step_u * cells.size * one, zero, zero),
        (zero, raster.step_v * cells.size * one, zero),
    )
