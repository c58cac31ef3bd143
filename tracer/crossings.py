"""Outlines across the picture: which pixels each may cross, and the lines they draw in cells.

So objects are found as well that the samples in the middles of pixels miss.
"""

from __future__ import annotations

import numpy as np

from tracer.arrays import Bools, Floats, Ints, each, expand, pick
from tracer.edges import BEND, Kind, Lines, Pencil, joined
from tracer.looks import Cells, Seen
from tracer.outlines import Outlines, Spans
from tracer.visibility import View

__all__ = ["crossed", "outlines_across", "spans_of"]

# A limb passes for straight if it turns by less than this, in radians, times the tolerance.
_TURN = 57.0

# Within this distance of its limb, in half cells, light on a sphere is a function of the distance.
_NEAR_LIMB = 6.0


def spans_of(outlines: Outlines, top: int, height: int, per_side: int) -> Spans:
    """Spans of all objects in the scan lines of some rows of pixels, and in one more either way.

    Each pixel has several scan lines: see `_rows_in`.  Row 0 of the spans is the one above.
    """
    place = _rows_in(per_side)
    y = np.add.outer(np.arange(top, top + height), place).ravel()
    y = np.concatenate([[top - 1 + place[-1]], y, [top + height + place[0]]])
    spheres, boxes = outlines.sphere_spans(y), outlines.box_spans(y)
    boxes = boxes._replace(owner=boxes.owner + len(outlines.radius))
    return Spans(*(np.concatenate(pair) for pair in zip(spheres, boxes, strict=True)))


def _rows_in(per_side: int) -> Floats:
    """Scan lines in a pixel, from 0 to 1: rows of the grid that is asked for, and the centre's."""
    place = (np.arange(per_side) + 0.5) / per_side
    return place if per_side % 2 else np.insert(place, per_side // 2, 0.5)


def crossed(
    spans: Spans, left: int, height: int, width: int, per_side: int
) -> tuple[Ints, Ints, Ints]:
    """Row, column and object: pixels that an outline may cross.

    An outline is known by where the object's spans begin and end: in the scan
    lines of a row of pixels, and in the nearest one above and below.  The outline
    crosses the pixels from the leftmost to the rightmost of these beginnings, and
    likewise of the ends.  If some of these lines miss the object, its outline
    closes in between: then it may cross any pixel in which the object is.
    """
    owner, line, begin, end = spans.owner, spans.row - 1, spans.left, spans.right
    rows = _rows_in(per_side).size
    # A pixel's first scan line is also the nearest one below the pixel above, and so on.
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


def outlines_across(view: View, cells: Cells, seen: Seen, rough: Bools) -> Lines:
    """Lines that outlines draw across cells; marks in `seen` the cells where they are not straight.

    `rough` (n,): cells in which the light bends too much for one sample.  If that is because they
    see a sphere beside its limb, they get the limb's line, whether it crosses them or not, and are
    marked rough no more.
    """
    outlines, spheres = view.outlines, view.surfaces.sphere_count
    lines = []
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
        drawn = np.flatnonzero((turn <= BEND) & (discs.crosses() | explained))
        lines.append(discs.take(drawn))
    at = np.flatnonzero(cells.owner >= spheres)
    if at.size:
        pencil = _pencil(view, cells, cells.cell[at], Kind.EDGE)
        a, b, c = each(lambda m: m.take(cells.owner[at] - spheres, axis=1), outlines.edges)
        edges, _, unknown = pencil.boxes((a, b, c / view.raster.depth))
        seen.unresolved[pencil.cell[unknown]] = True
        lines.append(edges)
    return joined(lines)


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
