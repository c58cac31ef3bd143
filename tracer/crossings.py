"""Outlines across the picture: which pixels each may cross, and the lines they draw in cells.

So objects are found as well that the samples in the middles of pixels miss.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tracer.arrays import Bools, Floats, Ints, dot, each, equal_runs, expand, pick
from tracer.edges import MOST_TURN, Kind, Lines, Pencil, joined
from tracer.looks import Cells, Seen
from tracer.outlines import Outlines
from tracer.scene import Surfaces
from tracer.visibility import View

__all__ = ["Ends", "crossed", "ends_of", "outlines_across"]

# A limb passes for straight if it turns by less than this, in radians, times the tolerance: found
# by trial.
_LIMB_TURN = 57.0

# What is so near to the line between two rows of pixels lies in both.
_ON_LINE = 1e-6


class Ends(NamedTuple):
    """Where objects begin and end in rows of pixels.

    Known are the spans on the lines above and below each row, and in between the places where an
    outline turns: the corners of boxes, and the extreme points of spheres.

    Attributes
    ----------
    owner : (n,)
        The object, of all, spheres first.
    row : (n,)
        Which row of pixels.
    begin, end : (n,)
        In pixels from the picture's left edge; NaN for what is no beginning, or no end.
    on_line : (n,)
        Whether this is a span, and the outline known on its way to the next.
    """

    owner: Ints
    row: Ints
    begin: Floats
    end: Floats
    on_line: Bools

    def columns(self) -> tuple[float, float]:
        """The leftmost and the rightmost place of all."""
        both = np.append(self.begin, self.end)
        return float(np.nanmin(both)), float(np.nanmax(both))


def ends_of(outlines: Outlines, surfaces: Surfaces, top: int, height: int) -> Ends:
    """The ends of all objects, in so many rows of pixels from the `top` on."""
    lines = np.arange(top, top + height + 1, dtype=np.float64)
    spheres, boxes = outlines.sphere_spans(lines), outlines.box_spans(lines)
    owner = np.append(spheres.owner, boxes.owner + len(outlines.radius))
    line, left, right = (
        np.append(getattr(spheres, name), getattr(boxes, name)) for name in ("row", "left", "right")
    )
    broken = outlines.broken(surfaces)
    known = np.append(np.ones(spheres.owner.size, dtype=np.bool_), ~broken[boxes.owner])
    turned, x, y, begins, ends = outlines.turns(surfaces)
    y = y - top
    at = np.flatnonzero((y > -1) & (y < height + 1) & np.isfinite(x))
    x, y, turned = np.clip(x[at], -1.0, outlines.raster.width + 1.0), y[at], turned[at]
    begin, end = np.where(begins[at], x, np.nan), np.where(ends[at], x, np.nan)
    # A line is the lower end of one row and the upper of the next; so is what lies on it.
    row, above = (np.floor(y + m).astype(np.intp) for m in (_ON_LINE, -_ON_LINE))
    both = np.flatnonzero(above != row)
    found = Ends(
        np.concatenate([owner, owner, turned, turned[both]]),
        np.concatenate([line - 1, line, row, above[both]]),
        np.concatenate([left, left, begin, begin[both]]),
        np.concatenate([right, right, end, end[both]]),
        np.append(np.tile(known, 2), np.zeros(at.size + both.size, dtype=np.bool_)),
    )
    inside = np.flatnonzero((found.row >= 0) & (found.row < height))
    return Ends._make(m[inside] for m in found)


def crossed(found: Ends, columns: slice) -> tuple[Ints, Ints, Ints]:
    """Row, column and object: pixels that an outline may cross.

    An outline crosses the pixels from the leftmost to the rightmost beginning of its object in a
    row, and likewise of the ends.  If the object misses the line above or below, its outline closes
    in between: then it may cross any pixel in which the object is.  So may an outline that is not
    wholly known.
    """
    # One number for object and row.
    key = found.owner * (found.row.max(initial=0) + 1) + found.row
    order = np.argsort(key, kind="stable")
    owner, row = found.owner[order], found.row[order]
    begin, end = found.begin[order], found.end[order]
    first, _ = equal_runs(key[order])
    (left_min, left_max), (right_min, right_max) = (
        (np.fmin.reduceat(m, first), np.fmax.reduceat(m, first)) for m in (begin, end)
    )
    closes = np.add.reduceat(found.on_line[order], first, dtype=np.intp) < 2
    whole = closes | (left_max + 1 >= right_min)
    apart = np.flatnonzero(~whole)
    far = np.where(whole, np.fmax(left_max, right_max), left_max)
    start = np.append(np.where(whole, np.fmin(left_min, right_min), left_min), right_min[apart])
    stop = np.append(far, right_max[apart])
    row, owner = (np.append(m, m[apart]) for m in (row[first], owner[first]))
    start, stop = (np.floor(m).astype(np.intp) for m in (start, stop))
    start = np.maximum(start, columns.start)
    each_one, column = expand(np.maximum(np.minimum(stop + 1, columns.stop) - start, 0), start)
    return row[each_one], column - columns.start, owner[each_one]


def outlines_across(view: View, cells: Cells, seen: Seen) -> tuple[Lines, Ints]:
    """Lines that outlines draw across cells; marks in `seen` the cells where they are not straight.

    Also returned are the cells whose middles see a sphere within its limb: there the light bends
    as it falls off towards that line.
    """
    outlines, spheres = view.outlines, view.surfaces.sphere_count
    lines, within_limbs = [], np.zeros(0, dtype=np.intp)
    at = np.flatnonzero(cells.owner < spheres)
    if at.size:
        cell, ball = cells.cell[at], cells.owner[at]
        pencil = _pencil(view, cells, cell, Kind.LIMB)
        touched = outlines.power[ball] == 0
        if touched.any():
            # The eye is on them: the plane that touches them there divides what it sees.
            on = pencil.take(np.flatnonzero(touched))
            center = pick(outlines.center, ball[touched])
            a, b, c = (dot(center, m) for m in (on.across, on.down, on.ray))
            lines.append(Lines(on.cell, np.full(on.cell.size, Kind.EDGE), a, b, c).crossing())
            rest = np.flatnonzero(~touched)
            cell, ball, pencil = cell[rest], ball[rest], pencil.take(rest)
        discs, turn, near = pencil.discs(pick(outlines.center, ball), outlines.radius[ball])
        straight = turn <= min(MOST_TURN, _LIMB_TURN * cells.tolerance)
        seen.unresolved[cell[near & ~straight]] = True
        crosses = discs.crosses()
        lines.append(discs.take(np.flatnonzero((turn <= MOST_TURN) & crosses)))
        within_limbs = cell[straight & crosses & (seen.spheres()[cell] == ball)]
    at = np.flatnonzero(cells.owner >= spheres)
    if at.size:
        pencil = _pencil(view, cells, cells.cell[at], Kind.EDGE)
        a, b, c = each(lambda m: m.take(cells.owner[at] - spheres, axis=1), outlines.planes)
        edges, _, unknown = pencil.boxes((a, b, c / view.raster.depth))
        seen.unresolved[pencil.cell[unknown]] = True
        lines.append(edges)
    return joined(lines), within_limbs


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
