"""Antialiasing: pixels are split where they hold more than one smooth surface.

A *cell* is a pixel or a part of one, classified by the sample in its middle (see `classify`).  Most
cells see one smooth surface: there that sample, with a correction for curvature, is worth a whole
grid of samples.  Other pixels are split into quarters, and these in turn, and so on (Whitted 1980).
A cell that straight lines divide gets samples on a lattice once few enough are asked for; those
between the same lines stand for their exact area together.  Where these do not see the same, there
is an edge that was not found: the cell is split as well, or in the end gets a finer lattice.  A
cell of which no quarter can be resolved gets samples, too, and is split on if these disagree.

In pictures full of edges no cells are classified, and all pixels have the lattice.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from tracer.antialias.classify import Cells, Classification, classify, curvature, extrapolated
from tracer.antialias.edges import silhouette_pixels
from tracer.antialias.lattice import CENTRES, Lattice
from tracer.antialias.regions import mixed, stratified
from tracer.arrays import Bools, Floats, Ints, indices
from tracer.trace.radiance import radiance_and_ids
from tracer.trace.samples import Scattered
from tracer.world.prepared_scene import PreparedScene

# Samples that are taken at a time in cells that are not smooth.
_SAMPLES_AT_ONCE = 1 << 16

# A cell is split where its correction for curvature may err by more than this, in radiance, over
# the power 3/2 of the samples along each side: so fast the error of grids falls.
_CURVATURE = 8e-3

# Cells in which the grid asked for has no more samples along each side than this are not split any
# more, but sampled: classification would cost more than the samples it saves.  Where it has no
# more than twice as many, they are split only if they may hold more than straight lines.
_LAST = 3

# How many points of the first lattice stand for pixels and for parts of them that are not split,
# and for cells that might be split; and the grid whose lattice is the second for these parts.
_IN_PIXELS, _IN_PARTS, _IN_CELLS, _FINER = 5, 13, 25, 5

# With more pairs of silhouettes in a pixel than this, for each sample that is asked for, samples
# everywhere cost less than classification.
_SUPERSAMPLE = 0.006


def prefers_supersampling(prepared: PreparedScene, per_side: int) -> bool:
    """Whether samples everywhere cost less than classification, in a view full of silhouettes.

    Either way they are to be as accurate as per_side x per_side samples in every pixel.
    """
    density = prepared.bounds.silhouette_density(prepared.frame)
    return density > _SUPERSAMPLE * per_side**2


def antialiased(prepared: PreparedScene, rows: slice, columns: slice, per_side: int) -> Floats:
    """Radiance (rows, columns, 3), averaged over each pixel of a rectangle that is not empty.

    Its RMSE is to be no larger than that of per_side x per_side samples in every pixel.
    """
    # One pixel more on every side: curvature is found from neighbours.
    top, height = rows.start - 1, rows.stop + 2 - rows.start
    left, width = columns.start - 1, columns.stop + 2 - columns.start
    centres = CENTRES.samples(slice(top, top + height), slice(left, left + width))
    row, column, obj = silhouette_pixels(prepared, rows, columns)
    pixel = (row - top) * width + column - left
    every = np.arange(centres.size)
    # The finer the grid that is asked for, the less a mean may be off.
    tolerance = _CURVATURE / per_side**1.5
    pixels = Cells(1.0, per_side, tolerance, *centres.at(every), pixel, obj)
    found = classify(prepared, pixels, centres, every)
    smooth, error = curvature(found.radiance, found.id, width)
    inside = np.pad(np.ones((height - 2, width - 2), dtype=np.bool_), 1).ravel()
    split, crowded = inside & ~found.crowded, indices(inside & found.crowded)
    lines = found.lines.take(indices(split[found.lines.cell]))
    rest = found._replace(lines=lines, unresolved=found.unresolved & split)
    mean = _refined(prepared, rest, smooth, np.where(split, error, 0))
    mean[:, crowded], _ = _sampled(prepared, found, crowded, Lattice.of(per_side, more=1))
    # A few points have weights less than zero.
    return np.stack([*mean.reshape(3, height, width)[:, 1:-1, 1:-1].clip(0)], axis=2)


def _refined(
    prepared: PreparedScene, found: Classification, smooth: Floats, error: Floats
) -> Floats:
    """Mean radiance (3, n) of cells.

    Parameters
    ----------
    prepared, found
    smooth : (3, n)
        The mean of a cell that sees one smooth surface.
    error : (n,)
        By how much it may be off; NaN if only the cell's parts can tell.
    """
    cells, mean = found.cells, smooth.copy()
    last, whole = cells.per_side <= _LAST, cells.size == 1
    divided = np.zeros(error.size, dtype=np.bool_)
    divided[found.lines.cell] = True
    rest = divided | found.unresolved | ~(error <= cells.tolerance)
    if cells.per_side <= 2 * _LAST:
        straight = divided & ~(found.unresolved | (error > cells.tolerance))
        some = indices(rest if last and not whole else straight)
        lattice = Lattice(1, _IN_CELLS if not last else _IN_PIXELS if whole else _IN_PARTS)
        means, coarse = _sampled(prepared, found, some, lattice)
        some = some[~coarse]
        mean[:, some], rest[some] = means[:, ~coarse], False
    some = indices(rest)
    if last:
        lattice = Lattice.of(cells.per_side if whole else _FINER)
        mean[:, some], _ = _sampled(prepared, found, some, lattice)
        return mean
    for part in _chunks(prepared, some, 4):
        mean[:, part] = _split(prepared, found, error, part)
    return mean


def _chunks(prepared: PreparedScene, some: Ints, samples: int) -> Iterator[Ints]:
    """Some cells, with so many samples in each, a few at a time."""
    step = max(1, prepared.at_once(_SAMPLES_AT_ONCE) // samples)
    for begin in range(0, some.size, step):
        yield some[begin : begin + step]


def _sampled(
    prepared: PreparedScene, found: Classification, some: Ints, lattice: Lattice
) -> tuple[Floats, Bools]:
    """Mean radiance (3, n) of some cells by a lattice of samples, and where that is too coarse."""
    cells, lines = found.cells, found.lines
    means, coarse = np.empty((3, some.size)), np.zeros(some.size, dtype=np.bool_)
    for part in _chunks(prepared, np.arange(some.size), lattice.size):
        rank = np.full(cells.x.size, -1)
        rank[some[part]] = np.arange(part.size)
        here = lines.take(indices(rank[lines.cell] >= 0))
        points = stratified(here._replace(cell=rank[here.cell]), part.size, lattice.points())
        samples, order = Scattered.of(*cells.at(some[part][points.cell], points.point))
        cell, region = points.cell[order], points.region[order]
        radiance, ids = radiance_and_ids(prepared, samples)
        for channel, values in zip(means, radiance, strict=True):
            channel[part] = np.bincount(cell, points.weight[order] * values, part.size)
        # What differs between the same lines shows that an edge has not been found.
        coarse[part[cell[mixed(region, ids)]]] = True
    return means, coarse


def _split(prepared: PreparedScene, found: Classification, error: Floats, some: Ints) -> Floats:
    """Mean radiance (3, m) of some cells, from their quarters; the rest as in `_refined`."""
    quarters, inside, tolerance = found.cells.quarters(some), some.repeat(4), found.cells.tolerance
    closer = classify(prepared, quarters, *Scattered.of(quarters.x, quarters.y))
    smooth, finer = extrapolated(found.radiance[:, some], found.id[some], closer)
    # The error falls as the square of the size; or next to an edge, towards which light may fall
    # off as a square root does, more slowly.
    error = error[inside] / np.where(np.isnan(finer), 2, 4)
    # What the whole says of one surface does not hold for a quarter that sees another one.
    elsewhere = (closer.id != found.id[inside]) & (closer.id >= 0)
    error[elsewhere & (error <= tolerance)] = np.nan
    # What was not known of the whole (NaN), the quarters tell.
    error = np.fmax(error, finer)
    # What stays unresolved may be smooth all the same: it is split again if a lattice disagrees.
    unresolved = closer.unresolved.reshape(-1, 4).all(axis=1)
    at = indices(unresolved & (np.bincount(closer.lines.cell // 4, minlength=some.size) == 0))
    lattice = Lattice.of(found.cells.per_side, more=1)
    means, coarse = _sampled(prepared, found, some[at], lattice)
    expected = smooth.reshape(3, -1, 4).take(at, axis=1).mean(axis=2)
    agree = ~coarse & (np.abs(means - expected).max(axis=0) <= tolerance)
    known = np.zeros(some.size, dtype=np.bool_)
    known[at[agree]] = True
    closer = closer._replace(unresolved=closer.unresolved & ~known.repeat(4))
    mean = _refined(prepared, closer, smooth, np.where(known.repeat(4), 0, error))
    quartered: Floats = mean.reshape(3, some.size, 4).mean(axis=2)
    quartered[:, known] = means[:, agree]
    return quartered
