"""Regions: what straight lines divide cells into, and the points that stand for each.

Points are spread evenly over a cell.  Those in one region together stand for its exact area
(post-stratification: Cochran, Sampling Techniques, 1977, ch. 5A), with weights that make their
centroid the region's, so that the mean of what changes linearly across it is exact as well.
Lines are taken to run right across their cells: where one in truth ends within, two regions are
told apart that are one, which does no harm.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tracer.antialias.lines import Lines
from tracer.arrays import Bools, Floats, Ints, equal_runs, indices

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
    weight : (n,)
        The part of the cell's area that each stands for; less than zero for a few.
    x, y : (n,)
        Where they are in their cells, from -1/2 to 1/2.
    region : (n,)
        A number for the region that each lies in, of all cells.
    """

    cell: Ints
    weight: Floats
    x: Floats
    y: Floats
    region: Ints


def stratified(lines: Lines, count: int, x: Floats, y: Floats) -> Points:
    """The same points in so many cells, cell after cell, given lines sorted by cell.

    A region that holds too few of them has one in its middle instead: these come last.
    """
    first, number_of = equal_runs(lines.cell)
    bits = int(number_of.max(initial=0))
    # A region's code has a bit for each line, set on the side where c + a x + b y < 0.
    code = np.repeat(np.arange(count)[:, None] << bits, x.size, axis=1)
    crossed = lines.cell[first]
    polygons = _Polygons.squares(first.size)
    for number in range(bits):
        some = indices(number_of > number)
        line = (first + number)[some, None]
        z = lines.a[line] * x + lines.b[line] * y + lines.c[line]
        code[crossed[some]] |= (z < 0) << number
        polygons = polygons.divided(lines, first + number, number_of > number, number)
    area, middle_x, middle_y = polygons.centroids()
    place = crossed[polygons.cell]
    region = polygons.code + (place << bits)
    weight, own = np.full((count, x.size), 1 / x.size), code[crossed]
    wanted = np.zeros((3, count << bits))
    wanted[:, region] = area, middle_x, middle_y
    weights, enough = _weights(own.ravel(), wanted, x, y)
    weight[crossed] = weights.reshape(own.shape)
    lone = indices(~enough[region] & (area > _NOTHING))
    return Points(
        np.append(np.arange(count).repeat(x.size), place[lone]),
        np.append(weight, area[lone]),
        np.append(np.tile(x, count), middle_x[lone]),
        np.append(np.tile(y, count), middle_y[lone]),
        np.append(code, region[lone]),
    )


def _weights(region: Ints, wanted: Floats, x: Floats, y: Floats) -> tuple[Floats, Bools]:
    """Weights (n,) of points, cell after cell, and which regions (m,) they are enough for.

    `wanted` (3, m): the area of each region, and its centroid.

    A weight is w (1 + t . (p - q)), with w = area / points, the point p and their mean q.  With
    their covariance S, the weighted mean is q + S t: t = S^-1 (centroid - q) makes it the centroid.
    """
    x, y = (np.tile(m, region.size // m.size) for m in (x, y))
    area, middle_x, middle_y = wanted
    points = np.maximum(np.bincount(region, minlength=area.size), 1)

    def mean(values: Floats) -> Floats:
        means: Floats = np.bincount(region, values, minlength=area.size) / points
        return means

    q_x, q_y = mean(x), mean(y)
    x, y = x - q_x[region], y - q_y[region]
    xx, xy, yy = mean(x * x), mean(x * y), mean(y * y)
    determinant = xx * yy - xy * xy
    enough: Bools = determinant > _SPREAD
    off_x, off_y = middle_x - q_x, middle_y - q_y
    w = np.where(enough, area / points, 0)
    scale = w / np.where(enough, determinant, 1)
    t_x, t_y = scale * (yy * off_x - xy * off_y), scale * (xx * off_y - xy * off_x)
    weights: Floats = w[region] + t_x[region] * x + t_y[region] * y
    return weights, enough


def mixed(region: Ints, ids: Ints) -> Ints:
    """Points, of some in regions (n,), that have another id (n,) than others in their region."""
    any_id = np.empty(int(region.max(initial=0)) + 1, dtype=np.intp)
    any_id[region] = ids
    return indices(any_id[region] != ids)


class _Polygons(NamedTuple):
    """Convex polygons: regions of cells.

    Attributes
    ----------
    cell : (n,)
        Which of the cells that lines cross, in their order.
    code : (n,)
        A bit for each line that divides the cell: set on the side where it is less than zero.
    x, y : (n, vertices)
        Vertices in order around each; where there are fewer, the last is repeated.
    """

    cell: Ints
    code: Ints
    x: Floats
    y: Floats

    @classmethod
    def squares(cls, count: int) -> _Polygons:
        """Whole cells, this many."""
        square = np.array([[-0.5, 0.5, 0.5, -0.5], [-0.5, -0.5, 0.5, 0.5]])
        x, y = square[:, None].repeat(count, axis=1)
        return cls(np.arange(count), np.zeros(count, dtype=np.intp), x, y)

    def take(self, index: Ints) -> _Polygons:
        """Some of them."""
        return _Polygons._make(m[index] for m in self)

    def divided(self, lines: Lines, line: Ints, crossed: Bools, number: int) -> _Polygons:
        """The parts on either side of one line in each cell, where `crossed`; the others whole.

        `line`, `crossed` (cells,): which line, and whether there is one; `number`: its bit.
        """
        rest = self.take(indices(~crossed[self.cell]))
        whole = self.take(indices(crossed[self.cell]))
        a, b, c = (m[line[whole.cell], None] for m in (lines.a, lines.b, lines.c))
        z = a * whole.x + b * whole.y + c
        parts = [whole.clipped(z), whole._replace(code=whole.code | 1 << number).clipped(-z)]
        # Whole polygons get one vertex more, as their clipped fellows have.
        x, y = (np.append(m, m[:, -1:], axis=1) for m in (rest.x, rest.y))
        parts.append(rest._replace(x=x, y=y))
        return _Polygons._make(map(np.concatenate, zip(*parts, strict=True)))

    def clipped(self, z: Floats) -> _Polygons:
        """What is left where a linear z, given at the vertices (n, vertices), is above zero.

        Sutherland and Hodgman, Reentrant polygon clipping, 1974.  The arrays get one vertex more.
        """
        inside, after = z > 0, np.arange(1, z.shape[1] + 1) % z.shape[1]
        crossing = inside != inside[:, after]
        part = np.where(crossing, z / (z - z[:, after]), 0)
        # By turns each vertex, and the crossing on the way to the next, if they are kept.
        kept = np.stack([inside, crossing], axis=2).reshape(len(z), -1)
        count = kept.sum(axis=1)
        some = indices(count)
        first = (count.cumsum() - count)[some, None]
        last = np.minimum(np.arange(z.shape[1] + 1), count[some, None] - 1)
        place = indices(kept)[first + last]
        corners = []
        for m in (self.x, self.y):
            new = m + part * (m[:, after] - m)
            corners.append(np.stack([m, new], axis=2).ravel()[place])
        return _Polygons(self.cell[some], self.code[some], corners[0], corners[1])

    def centroids(self) -> tuple[Floats, Floats, Floats]:
        """Areas (n,), and the centroids' x and y: the shoelace formula, from the first vertex."""
        # Summed vertex by vertex: a repeated one adds exactly nothing, so no bit of a result
        # depends on how many vertices other polygons have.
        x0, y0 = self.x[:, 0], self.y[:, 0]
        x, y = (self.x - x0[:, None]).T, (self.y - y0[:, None]).T
        double, moment_x, moment_y = np.zeros((3, x0.size))
        for k in range(1, len(x) - 1):
            cross = x[k] * y[k + 1] - x[k + 1] * y[k]
            double += cross
            moment_x += (x[k] + x[k + 1]) * cross
            moment_y += (y[k] + y[k + 1]) * cross
        triple = 3 * np.maximum(double, _NOTHING**2)
        return double / 2, x0 + moment_x / triple, y0 + moment_y / triple
