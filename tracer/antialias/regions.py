"""Regions: what straight lines divide cells into, and the points that stand for each.

Points are spread evenly over a cell.  Those in one region together stand for its exact area
(post-stratification: Cochran, Sampling Techniques, 1977, ch. 5A), with weights that make their
centroid the region's, so that the mean of what changes linearly across it is exact as well.
Lines are taken to run right across their cells: where one in truth ends within, two regions are
told apart that are one, which does no harm.  All positions are complex numbers, x + iy.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tracer.antialias.edge_functions import Lines
from tracer.antialias.lattice import Points2D
from tracer.arrays import Bools, Floats, Ints, indices

# Areas no larger than this part of a cell are left out.
_NOTHING = 1e-9

# Points of a region stand for it if the determinant of their covariance, in cells' widths, is more
# than this: there are three or more, and not all in one row.
_SPREAD = 1e-6


class Points(NamedTuple):
    """Points that stand for regions of cells.

    Attributes
    ----------
    cell : (n,)
    point : (n,)
        Where they are in their cells, from -1/2 to 1/2.
    weight : (n,)
        The part of the cell's area that each stands for; less than zero for a few.
    region : (n,)
        A number for the region that each lies in, of all cells.
    """

    cell: Ints
    point: Points2D
    weight: Floats
    region: Ints


def stratified(lines: Lines, count: int, points: Points2D) -> Points:
    """The same points in so many cells, cell after cell, given lines sorted by cell.

    A region that holds too few of them has the centroids of its triangles instead: these come last.
    """
    cell, first = np.arange(count), lines.cell.searchsorted(np.arange(count + 1))
    bits = int(np.diff(first).max(initial=0))
    # A region's number has a bit for each line of its cell, set where that is above zero.
    point: Points2D = np.repeat(points[:, None], count, axis=1)
    region = np.repeat(cell[None] << bits, points.size, axis=0)
    for bit in range(bits):
        some, z = _values(lines, first, bit, cell, point)
        region[:, some] |= (z > 0) << bit
    point, region = point.T.ravel(), region.T.ravel()
    triangles = _triangles(lines, first, bits)
    weight, enough = _weights(point, region, triangles, count << bits)
    lone = indices(~enough[triangles.region] & (triangles.weight > _NOTHING))
    spread = Points(cell.repeat(points.size), point, weight, region)
    return Points(*(np.append(m, n[lone]) for m, n in zip(spread, triangles, strict=True)))


def mixed(region: Ints, ids: Ints) -> Ints:
    """Points, of some in regions (n,), that have another id (n,) than others in their region."""
    any_id = np.empty(int(region.max(initial=0)) + 1, dtype=np.intp)
    any_id[region] = ids
    return indices(any_id[region] != ids)


def _values(
    lines: Lines, first: Ints, bit: int, cell: Ints, point: Points2D
) -> tuple[Ints, Floats]:
    """Which of some cells (n,) have a line of that number, and its values at places (m, n) there.

    `first` (cells + 1,): where the lines of each cell begin.
    """
    line = first[cell] + bit
    some = indices(line < first[cell + 1])
    here, at = lines.take(line[some]), point[:, some]
    return some, here.a * at.real + here.b * at.imag + here.c


def _triangles(lines: Lines, first: Ints, bits: int) -> Points:
    """Triangles that lines cut cells into: their centroids, weighed by their areas."""
    cell = np.arange(first.size - 1).repeat(2)
    region = cell << bits
    square = np.array([-1 - 1j, 1 - 1j, 1 + 1j, -1 + 1j]) / 2
    corner: Points2D = np.tile(square[[[0, 0], [1, 2], [2, 3]]], first.size - 1)
    for bit in range(bits):
        some, z = _values(lines, first, bit, cell, corner)
        above = z > 0
        count = above.sum(axis=0)
        region[some[count == 3]] |= 1 << bit
        cut = indices((count == 1) | (count == 2))
        # Turned so that the first corner is the one that is alone on its side.
        alone, some = count[cut] == 1, some[cut]
        turned = (np.argmax(above[:, cut] == alone, axis=0) + np.arange(3)[:, None]) % 3
        (a, b, c), (z_a, z_b, z_c) = corner[turned, some], z[turned, cut]
        p, q = a + z_a / (z_a - z_b) * (b - a), a + z_a / (z_a - z_c) * (c - a)
        corner[:, some] = a, p, q
        corner = np.concatenate([corner, (p, b, c), (p, c, q)], axis=1)
        below = region[some]
        region[some] = below | alone << bit
        region = np.concatenate([region, *[below | ~alone << bit] * 2])
        cell = np.concatenate([cell, cell[some], cell[some]])
    one, two = corner[1] - corner[0], corner[2] - corner[0]
    # No product of complex numbers, which NumPy rounds in another way at an array's end.
    area = np.abs(one.real * two.imag - one.imag * two.real) / 2
    return Points(cell, corner.sum(axis=0) / 3, area, region)


def _weights(point: Points2D, region: Ints, triangles: Points, count: int) -> tuple[Floats, Bools]:
    """Weights (n,) of points in regions (n,), and which regions (count,) they are enough for.

    A weight is w (1 + t . (p - q)), with w = area / points, the point p and their mean q.  With
    their covariance S, the weighted mean is q + S t: t = S^-1 (centroid - q) makes it the centroid.
    """

    def total(regions: Ints, values: Floats) -> Floats:
        return np.bincount(regions, values, minlength=count).astype(np.float64, copy=False)

    points = np.maximum(np.bincount(region, minlength=count), 1)
    area = total(triangles.region, triangles.weight)
    q_x, q_y = total(region, point.real) / points, total(region, point.imag) / points
    x, y = point.real - q_x[region], point.imag - q_y[region]
    xx, xy, yy = (total(region, m) / points for m in (x * x, x * y, y * y))
    determinant = xx * yy - xy * xy
    enough: Bools = determinant > _SPREAD
    off_x = total(triangles.region, triangles.weight * triangles.point.real) - area * q_x
    off_y = total(triangles.region, triangles.weight * triangles.point.imag) - area * q_y
    divisor = np.where(enough, points * determinant, np.inf)
    t_x, t_y = (yy * off_x - xy * off_y) / divisor, (xx * off_y - xy * off_x) / divisor
    weights = np.where(enough, area / points, 0)[region] + t_x[region] * x + t_y[region] * y
    return weights, enough
