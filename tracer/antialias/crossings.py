"""Outlines across the picture: which pixels each may cross, and the lines they draw in cells.

So objects are found as well that the samples in the middles of pixels miss.
"""

from __future__ import annotations

import numpy as np

from tracer.antialias.classify import Cells, Seen
from tracer.antialias.edges import Kind, Lines, Pencil, joined
from tracer.arrays import Floats, Ints, each, expand, indices, pick
from tracer.view.view import View

__all__ = ["crossed", "outlines_across"]

# A line so near to the top or bottom of an object, in pixels, may touch it and no more.
_TOUCHING = 1e-6


def crossed(view: View, rows: slice, columns: slice) -> tuple[Ints, Ints, Ints]:
    """Row, column and object: the pixels of a rectangle that an outline may cross.

    Being convex, an object fills the pixels of a row whose upper and lower sides it covers.  Its
    outline may cross the others in which it is seen; or any of them, if it is not wholly known.
    """
    lines = np.arange(rows.start, rows.stop + 1, dtype=np.float64)
    top, bottom = view.frames.top, view.frames.bottom
    none = np.zeros(0, dtype=np.intp)
    found: list[tuple[Ints, Ints, Floats, Floats]] = [(none, none, np.zeros(0), np.zeros(0))]
    for shape in view.shapes:
        owner, row, left, right = shape.spans(view.raster, lines[:-1], 1.0)
        # Where a line just touches an object, rounding decides what that covers of it.
        fills = top[owner] < lines[row] - _TOUCHING
        fills &= (bottom[owner] > lines[row + 1] + _TOUCHING) & shape.whole[owner - shape.first]
        covering = shape.spans(view.raster, lines)
        # One number for line and object: spans are sorted by it.  Last, a span of nothing.
        key = np.append(covering.row * top.size + covering.owner, -1)
        begin, end = np.append(covering.left, np.inf), np.append(covering.right, -np.inf)
        full, full_end = left, right
        for line in (row, row + 1):
            wanted = line * top.size + owner
            place = key[:-1].searchsorted(wanted)
            place[(key[place] != wanted) | ~fills] = -1
            full, full_end = np.maximum(full, begin[place]), np.minimum(full_end, end[place])
        left, stop = np.floor(left), np.floor(right) + 1
        full = np.clip(np.ceil(full), left, stop)
        full_end = np.clip(np.floor(full_end), full, stop)
        found += [(row, owner, left, full), (row, owner, full_end, stop)]
    row, owner, start, stop = (np.concatenate(m) for m in zip(*found, strict=True))
    start, stop = (m.clip(columns.start, columns.stop).astype(np.intp) for m in (start, stop))
    span, column = expand(stop - start, start)
    return row[span] + rows.start, column, owner[span]


def outlines_across(view: View, cells: Cells, seen: Seen) -> Lines:
    """Lines that outlines draw across cells; marks in `seen` where they are not straight."""
    spheres = view.spheres
    lines = []
    at = indices(cells.owner < spheres.count)
    if at.size:
        cell, ball = cells.cell[at], cells.owner[at]
        pencil = _pencil(view, cells, cell, Kind.LIMB)
        discs, turn, near = pencil.discs(pick(spheres.local, ball), spheres.radius[ball])
        # The outline of a sphere that the eye is on is no circle around its centre.
        on = spheres.power[ball] == 0
        turn[on], near[on] = np.inf, True
        lines.append(discs.straightened(turn, cells.tolerance, seen.unresolved, near))
    at = indices(cells.owner >= spheres.count)
    if at.size:
        pencil = _pencil(view, cells, cells.cell[at], Kind.EDGE)
        a, b, c = each(lambda m: m.take(cells.owner[at] - spheres.count, axis=1), view.boxes.planes)
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
