"""Antialiasing: pixels are split where they hold more than one smooth surface.

A *cell* is a pixel or a part of one, classified by the sample in its middle (see `classify`).  Most
cells see one smooth surface: there that sample, with a correction for curvature, is worth a whole
grid of samples.  Other pixels are split into quarters, and these in turn, and so on (Whitted 1980).
A smaller cell that straight lines divide gets samples on a lattice; those between the same lines
stand for their exact area together.  Where these do not see the same, there is an edge that was not
found: the cell is split as well, or in the end gets a finer lattice.

In pictures full of edges no cells are classified, and all pixels have the lattice.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from tracer.antialias.classify import Cells, Classification, classify, radiance_in
from tracer.antialias.crossings import crossed
from tracer.antialias.curvature import curvature, extrapolated
from tracer.antialias.lattice import CENTRES, Lattice
from tracer.antialias.lines import Lines
from tracer.antialias.regions import mixed, stratified
from tracer.arrays import Bools, Floats, Ints, equal_runs, indices, ranges
from tracer.light.lighting import Lighting
from tracer.view.samples import Scattered
from tracer.view.view import View

# Samples that are taken at a time in cells that are not smooth.
_CHUNK = 1 << 16

# A cell is split where its correction for curvature may err by more than this, in radiance, over
# the power 3/2 of the samples along each side: so fast the error of grids falls.
_CURVATURE = 1e-2

# Cells in which the grid asked for has no more samples along each side than this are not split any
# more, but sampled: classification would cost more than the samples it saves.
_LAST = 3

# Lattices for cells with straight lines: in pixels that are not split, in cells that might be split
# again, and in the last cells, unless the correction for curvature may err by more than `_BENT`
# times the tolerance there.  The second lattice for the last cells is as good as such a grid.
_IN_PIXELS, _IN_CELLS, _IN_LAST = Lattice(1, 5), Lattice(1, 25), Lattice(1, 13)
_BENT, _FINER = 8.0, 4

# With more pairs of silhouettes in a pixel than this, for each sample that is asked for, samples
# everywhere cost less than classification.
_DENSE = 0.006

# Lines in a cell that differ by no more than this, times the tolerance, count as one.
_SAME = 6.0

# Of the lines in a cell, this many divide it into regions; the others are left to its samples.
_LINES = 4


def dense(view: View, per_side: int) -> bool:
    """Whether samples everywhere cost less than classification, in a view full of silhouettes.

    Either way they are to be as accurate as per_side x per_side samples in every pixel.
    """
    return view.frames.pairs_in_pixel(view.raster) > _DENSE * per_side**2


def splittings(per_side: int) -> int:
    """How many times over pixels are split into quarters, where they need it."""
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
    centres = CENTRES.samples(slice(top, top + height), slice(left, left + width))
    row, column, owner = crossed(view, rows, slice(begin, end))
    pixel = (row - top) * width + column - left
    every = np.arange(centres.size)
    # The finer the grid that is asked for, the less a mean may be off.
    pixels = Cells(1.0, _CURVATURE / per_side**1.5, *centres.at(every), pixel, owner)
    found = classify(lighting, pixels, centres, every)
    smooth, error = curvature(found.radiance, found.id, width)
    smooth += found.radiance
    inside = np.zeros((height, width), dtype=np.bool_)
    inside[1:-1, 1:-1] = True
    mean = _refined(lighting, pixels, found, smooth, error, per_side, inside.ravel())
    np.stack([*mean.reshape(3, height, width)[:, 1:-1, 1:-1]], axis=2, out=out)


def _refined(
    lighting: Lighting,
    cells: Cells,
    found: Classification,
    smooth: Floats,
    error: Floats,
    per_side: int,
    wanted: Bools,
) -> Floats:
    """Mean radiance (3, n) of cells.

    Parameters
    ----------
    lighting, cells, found
    smooth : (3, n)
        The mean of a cell that sees one smooth surface.
    error : (n,)
        By how much it may be off; NaN if only the cell's parts can tell.
    per_side : int
        Samples along a cell's side in the grid asked for.
    wanted : (n,)
        Where means are of interest.
    """
    lines = found.lines.take(indices(wanted[found.lines.cell])).distinct(_SAME * cells.tolerance)
    first, count = equal_runs(lines.cell)
    divided, straight = np.zeros((2, error.size), dtype=np.bool_)
    divided[lines.cell] = True
    straight[lines.cell[first[count == 1]]] = True
    straight &= ~(found.unresolved | (error > cells.tolerance))
    rest = (divided | found.unresolved | ~(error <= cells.tolerance)) & wanted
    lines = lines.take(indices(ranges(0, count) < _LINES))
    last, whole = per_side <= _LAST, cells.size == 1
    mean = smooth
    if last or (per_side <= 2 * _LAST and not whole):
        lattice = _IN_PIXELS if whole else _IN_LAST if last else _IN_CELLS
        gentle = straight if whole or not last else ~(error > _BENT * cells.tolerance)
        some = indices(rest & gentle)
        means, coarse, alike = _sampled(lighting, cells, lines, some, lattice, found.id)
        # A hidden line divides nothing: there the smooth mean is better.
        alike &= straight[some] & (error[some] <= cells.tolerance)
        kept = indices(~(coarse | alike))
        mean[:, some[kept]] = means[:, kept]
        rest[some[~coarse]] = False
    some = indices(rest)
    if last:
        lattice = Lattice.of(per_side if whole else _FINER)
        mean[:, some], *_ = _sampled(lighting, cells, lines, some, lattice, found.id)
        return mean
    for part in _chunks(lighting, some, 4):
        mean[:, part] = _split(lighting, cells, found, error, per_side, part)
    return mean


def _chunks(lighting: Lighting, some: Ints, samples: int) -> Iterator[Ints]:
    """Some cells, with so many samples in each, a few at a time."""
    step = max(1, lighting.view.at_once(_CHUNK) // samples)
    for begin in range(0, some.size, step):
        yield some[begin : begin + step]


def _sampled(
    lighting: Lighting,
    cells: Cells,
    lines: Lines,
    some: Ints,
    lattice: Lattice,
    middle: Ints,
) -> tuple[Floats, Bools, Bools]:
    """Mean radiance (3, n) of some cells by a lattice of samples.

    `lines`, `middle`: of all cells, sorted, and the ids that their middles see.  Also returned are
    the cells for which the lattice is too coarse, and those in which all points see the same as
    the middle.
    """
    x, y = lattice.points()
    means = np.empty((3, some.size))
    coarse, other = np.zeros((2, some.size), dtype=np.bool_)
    place = np.full(cells.x.size, -1)
    place[some] = np.arange(some.size)
    lines = lines.take(indices(place[lines.cell] >= 0))
    lines = lines._replace(cell=place[lines.cell])
    for part in _chunks(lighting, np.arange(some.size), lattice.size):
        begin, count = part[0], part.size
        between = slice(*lines.cell.searchsorted([begin, begin + count]))
        here = lines.take(between)
        points = stratified(here._replace(cell=here.cell - begin), count, x, y)
        cell = some[points.cell + begin]
        radiance, ids = radiance_in(lighting, *cells.at(cell, points.x, points.y))
        for channel, values in zip(means, radiance, strict=True):
            channel[part] = np.bincount(points.cell, points.weight * values, minlength=count)
        # What differs between the same lines shows that an edge has not been found.
        coarse[points.cell[mixed(points.region, ids)] + begin] = True
        other[points.cell[ids != middle[cell]] + begin] = True
    return means, coarse, ~other


def _split(
    lighting: Lighting,
    cells: Cells,
    found: Classification,
    error: Floats,
    per_side: int,
    some: Ints,
) -> Floats:
    """Mean radiance (3, m) of some cells, from their quarters; the rest as in `_refined`."""
    quarters, inside = cells.quarters(some), some.repeat(4)
    samples, order = Scattered.of(quarters.x, quarters.y)
    closer = classify(lighting, quarters, samples, order)
    smooth, finer = extrapolated(
        found.radiance[:, some], found.id[some], closer.radiance, closer.id
    )
    smooth += closer.radiance
    error = error[inside] / 4
    # What the whole says of one surface does not hold for a quarter that sees another one.
    elsewhere = (closer.id != found.id[inside]) & (closer.id >= 0)
    error[elsewhere & (error <= cells.tolerance)] = np.nan
    # What was not known of the whole (NaN), the quarters tell.
    error = np.fmax(error, finer)
    every = np.ones(inside.size, dtype=np.bool_)
    per_side = max((per_side + 1) // 2, _LAST)
    mean = _refined(lighting, quarters, closer, smooth, error, per_side, every)
    quartered: Floats = mean.reshape(3, some.size, 4).mean(axis=2)
    return quartered
