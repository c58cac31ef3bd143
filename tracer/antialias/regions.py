"""Regions: what straight lines divide cells into, and the points that stand for each.

The area of a region, as a part of its cell's, is its *share*.  Where one line divides a cell, each
side has points of its own.  In a cell with more lines, or with more than lines, many points are
spread evenly, and those in one region together stand for its exact share (post-stratification:
Cochran, Sampling Techniques, 1977, ch. 5A).  Lines are taken to run right across their cells: where
one in truth ends within, two regions are told apart that are one, which does no harm.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tracer.antialias.lines import Kind, Lines
from tracer.arrays import Bools, Floats, Ints, equal_runs, indices

__all__ = ["Points", "mixed", "post_stratified", "sides_of"]

# Shares no larger than this are left out.
_NOTHING = 1e-9


class Points(NamedTuple):
    """Points that stand for parts of cells.

    Attributes
    ----------
    cell : (n,)
    share : (n,)
        The part of the cell's area that each stands for.
    x, y : (n,)
        Where they are in their cells, from -1/2 to 1/2.
    """

    cell: Ints
    share: Floats
    x: Floats
    y: Floats

    def take(self, index: Ints) -> Points:
        """Some of them."""
        return Points._make(m[index] for m in self)

    def joined(self, other: Points) -> Points:
        """These, then others."""
        return Points._make(map(np.append, self, other))

    def add(self, radiance: Floats, mean: Floats) -> None:
        """Add radiance (3, n) at the points, by their shares, to the mean (3, cells) of cells."""
        for channel, values in zip(mean, radiance, strict=True):
            np.add.at(channel, self.cell, self.share * values)


def sides_of(lines: Lines, same: float) -> tuple[Points, Bools]:
    """Points on both sides of lines, each line being the only one in its cell, or the `same`.

    One in the middle of each side; on the sphere's side of a limb, where light falls off, two.
    Those beyond the line, seen from the cell's middle, are marked (n,): there the look at the cell
    says nothing, and they may see another surface, or light that was not sought.
    """
    share, moment_x, moment_y = lines.areas_and_moments()
    shares, x, y = (
        np.concatenate(m)
        for m in ((share, 1 - share), (moment_x, -moment_x), (moment_y, -moment_y))
    )
    x /= np.maximum(shares, _NOTHING)
    y /= np.maximum(shares, _NOTHING)
    # The cell's middle is on the side that has the sign of c, unless another line that counts as
    # the same divides them: a floor ends in several at the horizon.  The look covers both sides of
    # a shadow's edge.
    side = np.repeat([1.0, -1.0], share.size)
    other = np.tile(lines.kind != Kind.SHADOW, 2)
    beyond = other & (side * np.tile(lines.c, 2) <= same * np.tile(lines.reach(), 2))
    limb = indices(lines.kind == Kind.SILHOUETTE)
    within = share.size + limb
    shares[within] = 0  # two points stand for that side
    sides = Points(np.tile(lines.cell, 2), shares, x, y)
    roots = (m.ravel() for m in lines.take(limb).gauss_points())
    sides = sides.joined(Points(np.tile(lines.cell[limb], 2), *roots))
    beyond = np.append(beyond, np.tile(beyond[within], 2))
    some = indices(sides.share > _NOTHING)
    return sides.take(some), beyond[some]


def post_stratified(lines: Lines, cells: Ints, x: Floats, y: Floats) -> tuple[Points, Ints]:
    """The same points in all cells, cell after cell, and their regions, given lines sorted by cell.

    The points in a region have equal parts of its share.  The regions without any have a point in
    the middle of each: these come last.
    """
    first, count = equal_runs(lines.cell)
    weights = np.full((cells.size, x.size), 1 / x.size)
    bits = int(count.max(initial=0))
    # A region's code has a bit for each line, set on the side where c + a x + b y < 0.
    code = np.repeat(np.arange(cells.size)[:, None] << bits, x.size, axis=1)
    crossed = cells.searchsorted(lines.cell[first])
    polygons = _Polygons.squares(first.size)
    for number in range(bits):
        some = indices(count > number)
        line = (first + number)[some, None]
        z = lines.a[line] * x + lines.b[line] * y + lines.c[line]
        code[crossed[some]] |= (z < 0) << number
        polygons = polygons.divided(lines, first + number, count > number, number)
    share, middle_x, middle_y = polygons.centroids()
    place = crossed[polygons.cell]
    region = polygons.code + (place << bits)
    held = np.bincount(code.ravel(), minlength=cells.size << bits)
    shares = np.bincount(region, share, minlength=held.size) / np.maximum(held, 1)
    weights[crossed] = shares[code[crossed]]
    empty = indices((held[region] == 0) & (share > _NOTHING))
    lone = Points(cells[place[empty]], share[empty], middle_x[empty], middle_y[empty])
    x, y = np.tile(x, cells.size), np.tile(y, cells.size)
    points = Points(cells.repeat(weights.shape[1]), weights.ravel(), x, y).joined(lone)
    return points, np.append(code, region[empty])


def mixed(region: Ints, key: Ints) -> Ints:
    """Points, of some in regions (n,), that have another key (n,) than others in their region."""
    keys = np.empty(int(region.max(initial=0)) + 1, dtype=np.intp)
    keys[region] = key
    return indices(keys[region] != key)


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
