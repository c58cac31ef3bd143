"""Antialiasing: samples on either side of an edge, weighted by their share of the pixel.

A *cell* is a pixel or a part of one.  A *look* at it takes the sample in its
middle, and finds the straight *lines* that edges draw across it (see `looks`;
outlines are found by `crossings`, whether a middle sees the object or not).

Most cells see one smooth surface: there that sample, with a correction for
curvature, is worth a whole grid of samples.  Where one line crosses a
cell, a sample on either side is enough (two on a sphere within its limb, where
light falls off).  A cell that holds more is *unresolved*: it is split into
quarters, which are looked at in turn, and so on (Whitted 1980).  The last parts
get samples on a lattice that is as good as the grid asked for; those between the
same lines stand for their exact area together.  Where these do not see the same,
there is an edge that was not found, and a finer lattice takes their place.

What a look has found of shadows serves all samples in its cell.  In pictures full
of edges there are no looks, and all pixels have the lattice.
"""

from __future__ import annotations

import numpy as np

from tracer.antialias.classify import Cells, Seen, look, look_at, radiance_in
from tracer.antialias.crossings import crossed
from tracer.antialias.curvature import curvature, extrapolated
from tracer.antialias.edges import silhouettes
from tracer.antialias.lattice import CENTRES, Lattice
from tracer.antialias.lines import Kind, Lines, joined
from tracer.antialias.regions import Points, mixed, post_stratified, sides_of
from tracer.arrays import Bools, Floats, Ints, equal_runs, indices, ranges
from tracer.light.lighting import Lighting
from tracer.shadow.occlusion import NearbyShadows
from tracer.view.view import View

__all__ = ["antialiased", "dense", "splittings"]

# Samples that are taken at a time in unresolved cells.
_CHUNK = 1 << 16

# A cell is split where its correction for curvature may err by more than this, in radiance, over
# the power 3/2 of the samples along each side: so fast the error of grids falls.
_CURVATURE = 1e-2

# Cells in which the grid asked for has no more samples along each side than this are not split any
# more, but sampled: looks would cost more than the samples they save.
_LAST = 3

# Looks cost so much that what has been split gets more samples than asked for: as many as for a
# grid of so many along each side; then, where these miss an edge or the correction for curvature
# may err by more than `_BENT` times the tolerance, as many as for the second.
_ROUNDS, _BENT = (2, 4), 8.0

# With more pairs of outlines in a pixel than this, for each sample that is asked for, samples
# everywhere cost less than looks.
_DENSE = 0.006

# Lines in a cell that differ by no more than this, times the tolerance, count as one.
_SAME = 6.0

# Of the lines in a cell, this many divide it into regions; the others are left to its samples.
_LINES = 4


def dense(view: View, per_side: int) -> bool:
    """Whether a picture is so full of outlines that samples everywhere cost less than looks.

    Either way it is to be as accurate as per_side x per_side samples in every pixel.
    """
    return view.frames.pairs_in_pixel(view.raster) > _DENSE * per_side**2


def splittings(per_side: int) -> int:
    """How many times over pixels are split into quarters and looked at, where they need it."""
    return 0 if per_side <= _LAST else 1 + splittings((per_side + 1) // 2)


def antialiased(
    lighting: Lighting, rows: slice, columns: slice, per_side: int, out: Floats
) -> None:
    """Write radiance, averaged over each pixel of a rectangle, into zeros `out` (rows, columns, 3).

    Its RMSE is to be no larger than that of per_side x per_side samples in every pixel.
    """
    view = lighting.view
    # Nothing is seen to the left and to the right of all objects.
    _, seen_in = view.frames.window(view.raster)
    begin, end = max(columns.start, seen_in.start), min(columns.stop, seen_in.stop)
    if begin >= end:
        return
    out = out[:, begin - columns.start : end - columns.start]
    # One pixel more on every side: curvature is found from neighbours.
    top, height = rows.start - 1, rows.stop + 2 - rows.start
    left, width = begin - 1, end + 2 - begin
    # The finer the grid that is asked for, the less a sample may be off.
    tolerance = _CURVATURE / per_side**1.5
    centres = CENTRES.samples(slice(top, top + height), slice(left, left + width))
    row, column, owner = crossed(view, rows, slice(begin, end))
    pixel = (row - top) * width + column - left
    x, y = centres.positions()
    outlines = silhouettes(view, pixel, owner, x[pixel], y[pixel], 1.0)
    seen = look(lighting, centres, np.arange(centres.size), 1.0, tolerance, 1.0, outlines)
    bend, error = curvature(seen.radiance, seen.key, width)
    mean = np.add(seen.radiance, bend, out=bend)
    pixels = Cells(
        1.0,
        tolerance,
        x,
        y,
        error,
        pixel,
        owner,
    )
    inside = np.zeros((height, width), dtype=np.bool_)
    inside[1:-1, 1:-1] = True
    _refine(lighting, pixels, seen, mean, per_side, inside.ravel())
    np.stack([*mean.reshape(3, height, width)[:, 1:-1, 1:-1]], axis=2, out=out)


def _refine(
    lighting: Lighting,
    cells: Cells,
    seen: Seen,
    mean: Floats,
    per_side: int,
    wanted: Bools,
) -> None:
    """Correct the mean radiance (3, n) of cells that hold more than one smooth surface.

    `seen`: what looks at the cells have found.  `per_side`: samples along a cell's side in the grid
    asked for.  `wanted` (n,): where means are of interest.
    """
    lines = seen.lines
    unresolved = cells.error > cells.tolerance
    # Just within a limb light bends because it falls off towards that line: points there tell.
    unresolved[lines.cell[(lines.kind == Kind.SILHOUETTE) & (lines.c < 0)]] = False
    unresolved |= seen.unresolved
    same = _SAME * cells.tolerance
    lines = _few(lines.take(indices(wanted[lines.cell])), same, unresolved)
    # Each side of a line has samples of its own; what is not divided needs to be known as a whole.
    unknown = np.isnan(cells.error)
    unknown[lines.cell] = False
    unresolved |= unknown
    if not (lines.cell.size or (unresolved & wanted).any()):
        return  # one smooth surface
    sides, beyond = sides_of(lines.take(indices(~unresolved[lines.cell])), same)
    # Points on the middle's side, or across a shadow's edge, are covered by the look.  The others
    # are looked at, too, unless few samples are asked for: so coarse a grid errs more than samples
    # there, whatever these miss.
    looked = beyond & (per_side >= _LAST)
    beside, there = (sides.take(indices(m)) for m in (~looked, looked))
    colors, hidden = np.empty((3, 0)), np.zeros(unresolved.size, dtype=np.bool_)
    if there.cell.size:
        colors, key, found, more = _look_beyond(lighting, cells, there)
        unresolved[more] = True
        lines = joined([lines, found])
        # A hidden outline divides nothing: there the sample in the middle, corrected, is better.
        hidden[there.cell] = True
        hidden[there.cell[key != seen.key[there.cell]]] = False
    # Again for all cells, even if nothing was found: no cell's result may depend on other cells.
    lines = _few(lines, same, unresolved)
    divided, rest = ~(unresolved | hidden), indices(unresolved & wanted)
    mean[:, rest] = 0
    mean[:, sides.cell[divided[sides.cell]]] = 0
    kept = indices(divided[there.cell])
    there.take(kept).add(colors[:, kept], mean)
    beside = beside.take(indices(divided[beside.cell]))
    nearby = seen.nearby()
    if per_side > _LAST:
        _split(lighting, nearby, cells, seen, rest, per_side, mean)
        rest = rest[:0]
    rounds = (per_side,) if cells.size == 1 else _ROUNDS
    _sample(lighting, nearby, cells, lines, rest, rounds, beside, mean)


def _few(lines: Lines, same: float, unresolved: Bools) -> Lines:
    """Different lines, at most `_LINES` a cell, sorted by cell; several leave it `unresolved`."""
    lines = lines.distinct(same)
    first, count = equal_runs(lines.cell)
    unresolved[lines.cell[first[count > 1]]] = True
    return lines.take(indices(ranges(0, count) < _LINES))


def _look_beyond(
    lighting: Lighting, cells: Cells, sides: Points
) -> tuple[Floats, Ints, Lines, Ints]:
    """Look around points beyond lines: radiance (3, n), keys, lines in cells, unresolved cells."""
    cell, x, y = sides.cell, sides.x, sides.y
    # A square of twice the size, around whichever point of a cell, contains all of the cell.
    at = cells.at(cell, x, y)
    seen = look_at(lighting, None, *at, cell, 2 * cells.size, cells.tolerance, 0.5)
    found = seen.lines
    a, b = found.a / 2, found.b / 2
    c = found.c - a * x[found.cell] - b * y[found.cell]
    lines = Lines(cell[found.cell], found.kind, a, b, c).crossing()
    return seen.radiance, seen.key, lines, cell[seen.unresolved]


def _sample(
    lighting: Lighting,
    nearby: NearbyShadows | None,
    cells: Cells,
    lines: Lines,
    some: Ints,
    rounds: tuple[int, ...],
    beside: Points,
    mean: Floats,
) -> None:
    """Add to the mean radiance (3, n) that of a lattice of samples in some cells.

    `rounds`: the lattice is as good as a grid of so many samples along each side; where it is too
    coarse, the next takes its place.

    What the points `beside` see is added as well: together with the first cells, for one long array
    takes less time than two.
    """
    per_side, *finer = rounds
    lattice = Lattice.of(per_side)
    x, y = lattice.points()
    step = max(1, lighting.view.at_once(_CHUNK) // lattice.size)
    coarse = np.zeros(cells.x.size, dtype=np.bool_)
    if finer:
        coarse[some] = cells.error[some] > _BENT * cells.tolerance
        some = some[~coarse[some]]
    for begin in range(0, max(some.size, 1), step):
        part = some[begin : begin + step]
        within = np.zeros(cells.x.size, dtype=np.bool_)
        within[part] = True
        points, region = post_stratified(lines.take(indices(within[lines.cell])), part, x, y)
        if not begin:
            points = points.joined(beside)
        radiance, key = radiance_in(
            lighting, nearby, *cells.at(points.cell, points.x, points.y), points.cell
        )
        if finer:
            # What differs between the same lines shows that an edge has not been found.
            coarse[points.cell[mixed(region, key[: region.size])]] = True
            kept = indices(~coarse[points.cell])
            points, radiance = points.take(kept), radiance[:, kept]
        points.add(radiance, mean)
    again, none = indices(coarse), beside.take(np.arange(0))
    if again.size:
        _sample(lighting, nearby, cells, lines, again, tuple(finer), none, mean)


def _split(
    lighting: Lighting,
    nearby: NearbyShadows | None,
    cells: Cells,
    seen: Seen,
    some: Ints,
    per_side: int,
    mean: Floats,
) -> None:
    """Replace the mean radiance (3, n) of some cells by that of their quarters, looked at anew."""
    step = max(1, lighting.view.at_once(_CHUNK) // 4)
    for begin in range(0, some.size, step):
        part = some[begin : begin + step]
        quarters, inside = cells.split(part), part.repeat(4)
        x, y, size = quarters.x, quarters.y, quarters.size
        q = quarters.cell
        outlines = silhouettes(lighting.view, q, quarters.owner, x[q], y[q], size)
        # `cell` of a quarter's silhouettes is the quarter
        closer = look_at(lighting, nearby, x, y, inside, size, cells.tolerance, 1.0, outlines)
        bend, error = extrapolated(
            seen.radiance[:, part], seen.key[part], closer.radiance, closer.key
        )
        # What the whole says of one surface does not hold for a quarter that sees another one.
        elsewhere = (closer.key != seen.key[inside]) & (closer.key >= 0)
        quarters.error[elsewhere & (quarters.error <= cells.tolerance)] = np.nan
        # What was not known of the whole (NaN), the quarters tell.
        quarters = quarters._replace(error=np.fmax(quarters.error, error))
        radiance = np.add(closer.radiance, bend, out=bend)
        every = np.ones(x.size, dtype=np.bool_)
        _refine(lighting, quarters, closer, radiance, max((per_side + 1) // 2, _LAST), every)
        mean[:, part] = radiance.reshape(3, part.size, -1).mean(axis=2)
