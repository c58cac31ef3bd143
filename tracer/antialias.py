"""Antialiasing: samples on either side of an edge, weighted by their share of the pixel.

Most pixels see one smooth surface: there the sample at the centre, with a
correction for curvature, is worth more than any number of samples.  Where one
edge crosses a pixel, its place is known in closed form, and a sample on either
side is enough (two next to a limb, where light falls off).  A pixel that holds
more is split into four, and so on (Whitted 1980); in the last of its parts samples lie on a
lattice that is as good as the grid asked for, and those between the same edges
stand for their exact area together.  What a look has found is known of all
samples near it.  Pictures that are full of edges are lattices everywhere.
"""

from __future__ import annotations

import numpy as np

from tracer.arrays import Bools, Floats, Ints, equal_runs, ranges
from tracer.crossings import crossed, outlines_across, spans_of
from tracer.curvature import curvature, extrapolated
from tracer.edges import Lines, joined
from tracer.lighting import Lighting
from tracer.looks import Cells, Lights, Seen, look, look_at, radiance_in
from tracer.outlines import Outlines
from tracer.regions import Points, post_stratified, sides_of
from tracer.sampling import CENTRES, Lattice

__all__ = ["antialiased", "dense", "splittings"]

# Samples in cells that are split at a time.
_CHUNK = 1 << 16

# Pixels that are looked at, at a time.
_STRIP = 3 << 15

# A correction for curvature may be off by a part of itself; where that could show, split.  Grids
# err less with the power 3/2 of the samples along each side.
_CURVATURE = 1e-2

# Cells that stand for so many samples along each side are not split any more: looks would cost
# more than the samples they save.
_AT_ONCE = 3

# With more pairs of outlines in a pixel, for each sample that is asked for, samples everywhere do
# for less than looks.
_DENSE = 0.006

# Lines in a cell that are told apart; samples see to the others.
_LINES = 4


def dense(outlines: Outlines, per_side: int) -> bool:
    """Whether a picture is so full of outlines that samples everywhere cost less than looks.

    Either way it is to be as accurate as per_side x per_side samples in every pixel.
    """
    return outlines.crossed_twice() > _DENSE * per_side**2


def splittings(per_side: int) -> int:
    """How often pixels are split to be looked at again, where they need it."""
    return 0 if per_side <= _AT_ONCE else 1 + splittings((per_side + 1) // 2)


def antialiased(
    lighting: Lighting, rows: slice, columns: slice, per_side: int, out: Floats
) -> None:
    """Radiance, averaged over each pixel of a rectangle, into zeros (rows, columns, 3).

    To err no more than per_side x per_side samples in a grid in every pixel.
    """
    # A pixel more on every side: the curvature is that between neighbours.
    top, height = rows.start - 1, rows.stop + 2 - rows.start
    spans = spans_of(lighting.view.outlines, top, height, per_side)
    if not spans.owner.size:
        return
    # Nothing is seen to the left and to the right of all objects.
    begin = max(columns.start, int(spans.left.min()) - 1)
    end = min(columns.stop, int(spans.right.max()) + 2)
    if begin >= end:
        return
    out = out[:, begin - columns.start : end - columns.start]
    left, width = begin - 1, end + 2 - begin
    # The finer the grid that is asked for, the less a sample may be off.
    tolerance = _CURVATURE / per_side**1.5
    seen = Seen.of(height * width)
    # As much at a time as the processor's cache holds.
    step, across = max(1, _STRIP // width), slice(left, left + width)
    for first in range(0, height, step):
        strip = CENTRES.samples(slice(top + first, top + min(first + step, height)), across)
        places = np.arange(first * width, first * width + strip.size)
        look(lighting, strip, 1.0, tolerance, seen, places)
    bend, error = curvature(seen.radiance, seen.key, width)
    mean = np.add(seen.radiance, bend, out=bend)
    row, column, owner = crossed(spans, left, height, width, per_side)
    inner = np.flatnonzero((row > 0) & (row < height - 1) & (column > 0) & (column < width - 1))
    pixels = Cells(
        1.0,
        tolerance,
        *CENTRES.samples(slice(top, top + height), across).positions(),
        error,
        (row * width + column)[inner],
        owner[inner],
    )
    inside = np.zeros((height, width), dtype=np.bool_)
    inside[1:-1, 1:-1] = True
    _refine(lighting, pixels, seen, mean, per_side, inside.ravel())
    out[:] = np.moveaxis(mean.reshape(3, height, width)[:, 1:-1, 1:-1], 0, 2)


def _refine(
    lighting: Lighting,
    cells: Cells,
    seen: Seen,
    mean: Floats,
    per_side: int,
    wanted: Bools,
) -> None:
    """Put mean radiance (3, n) in the place of that of cells that hold more than a smooth surface.

    `seen` is what their centres see.
    """
    rough = cells.error > cells.tolerance
    lines = joined([*outlines_across(lighting.view, cells, seen, rough), *seen.lines])
    unresolved = seen.unresolved | rough
    lines = _few(lines.take(np.flatnonzero(wanted[lines.cell])), unresolved)
    sides = sides_of(lines.take(np.flatnonzero(~unresolved[lines.cell])))
    colors = np.empty((3, sides.cell.size))
    beyond = np.flatnonzero(sides.beyond)
    if beyond.size:
        colors[:, beyond], found, more = _beyond(lighting, cells, sides.take(beyond))
        unresolved[more] = True
        lines = joined([lines, found])
    # Once more, whatever other cells have found: each is decided alone.
    lines = _few(lines, unresolved)
    kept = np.flatnonzero(~unresolved[sides.cell])
    sides, colors = sides.take(kept), colors[:, kept]
    rest = np.flatnonzero(unresolved & wanted)
    lights = seen.lights(lighting, np.append(rest, sides.cell))
    # All of the surface that the middle of a cell sees has been looked at.
    beside = np.flatnonzero(~sides.beyond)
    near = sides.take(beside)
    if per_side <= _AT_ONCE:
        at_once = lighting.view.at_once(_CHUNK)
        colors[:, beside] = _sample(lights, cells, lines, rest, per_side, at_once, mean, near)
    else:
        _split(lighting, lights, cells, seen, rest, per_side, mean)
        at = cells.at(near.cell, near.x, near.y)
        colors[:, beside] = radiance_in(lights, *at, near.cell)
    order = np.argsort(sides.cell, kind="stable")
    first, _ = equal_runs(sides.cell[order])
    if first.size:
        total = np.add.reduceat((sides.share * colors)[:, order], first, axis=1)
        mean[:, sides.cell[order[first]]] = total


def _few(lines: Lines, unresolved: Bools) -> Lines:
    """Different lines, a few in each cell, sorted by cell; marks cells with more than one."""
    lines = lines.distinct()
    first, count = equal_runs(lines.cell)
    unresolved[lines.cell[first[count > 1]]] = True
    return lines.take(np.flatnonzero(ranges(0, count) < _LINES))


def _beyond(lighting: Lighting, cells: Cells, sides: Points) -> tuple[Floats, Lines, Ints]:
    """Radiance (3, n) of points, lines in their cells there, and cells that hold more."""
    cell, x, y = sides.cell, sides.x, sides.y
    # From anywhere in a cell, one of twice the size holds all of it.
    at = cells.at(cell, x, y)
    seen = look_at(lambda _: lighting, *at, cell, 2 * cells.size, cells.tolerance, 0.5)
    found = joined(seen.lines)
    a, b = found.a / 2, found.b / 2
    c = found.c - a * x[found.cell] - b * y[found.cell]
    lines = Lines(cell[found.cell], found.kind, a, b, c).crossing()
    return seen.radiance, lines, cell[seen.unresolved]


def _sample(
    lights: Lights,
    cells: Cells,
    lines: Lines,
    some: Ints,
    per_side: int,
    at_once: int,
    mean: Floats,
    near: Points,
) -> Floats:
    """Put mean radiance (3, n) in the place of that of some cells, from a lattice in each.

    So many samples are taken `at_once`.  Returns radiance of other points, sampled with the first.
    """
    lattice = Lattice.of(per_side)
    x, y = lattice.points()
    step, colors = max(1, at_once // lattice.size), []
    for begin in range(0, max(some.size, 1), step):
        part = some[begin : begin + step]
        held = np.flatnonzero(np.isin(lines.cell, part))
        weights, empty = post_stratified(lines.take(held), part, x, y)
        points = empty.joined(near)
        (every_x, every_y), (own_x, own_y) = (
            cells.places(part, x, y),
            cells.at(points.cell, points.x, points.y),
        )
        inside = np.append(np.repeat(part, lattice.size), points.cell)
        at = np.append(every_x, own_x), np.append(every_y, own_y)
        radiance, lone, other = np.split(
            radiance_in(lights, *at, inside),
            [weights.size, weights.size + empty.cell.size],
            axis=1,
        )
        mean[:, part] = (radiance.reshape(3, *weights.shape) * weights).sum(axis=2)
        for channel, values in zip(mean, lone, strict=True):
            np.add.at(channel, empty.cell, empty.share * values)
        colors.append(other)
        near = near.take(np.zeros(0, dtype=np.intp))
    return np.concatenate(colors, axis=1)


def _split(
    lighting: Lighting,
    lights: Lights,
    cells: Cells,
    seen: Seen,
    some: Ints,
    per_side: int,
    mean: Floats,
) -> None:
    """Put mean radiance (3, n) in the place of that of some cells, from that of their quarters."""
    step = max(1, lighting.view.at_once(_CHUNK) // 4)
    for begin in range(0, some.size, step):
        part = some[begin : begin + step]
        quarters, inside = cells.split(part), np.repeat(part, 4)
        x, y, size = quarters.x, quarters.y, quarters.size
        closer = look_at(lights, x, y, inside, size, cells.tolerance)
        bend, error = extrapolated(
            seen.radiance[:, part], seen.key[part], closer.radiance, closer.key
        )
        quarters = quarters._replace(error=np.fmax(quarters.error, error))
        radiance = np.add(closer.radiance, bend, out=bend)
        every = np.ones(x.size, dtype=np.bool_)
        _refine(lighting, quarters, closer, radiance, (per_side + 1) // 2, every)
        mean[:, part] = radiance.reshape(3, part.size, -1).mean(axis=2)
