"""Edges in closed form: the lines that outlines and shadows draw across a cell of the picture.

A *cell* is a square of the picture: a pixel, or a part of one.  Positions in a
cell are x and y from -1/2 to 1/2, so its middle is at 0, 0.  Edges are
approximated there by straight *lines*, c + a x + b y = 0.

The rays that draw an outline start at the eye, those that draw a shadow's edge
at a light; they touch a sphere or an edge of a box.  By how much the ray through
the cell's middle misses it is c; how that changes across the cell is a and b.
"""

from __future__ import annotations

from collections.abc import Iterable
from enum import IntEnum
from typing import NamedTuple

import numpy as np

from tracer.arrays import Bools, Floats, Ints, Triple, indices, scaled

__all__ = ["Kind", "Lines", "joined"]

# The smaller of |a| and |b| counts as at least this part of the larger: areas divide by both.
_LEAST_SLOPE = 1e-4

# An area, as a share of its cell, or a variance in it, that is nothing but rounding.
_TINY = 1e-12

# A line is compared with fewer than this many of those sorted before it in its cell.
_COMPARED = 6


class Kind(IntEnum):
    """What a line divides, and whether a look at the cell (see `looks`) covers both sides.

    Of lines in one place the first in this order is kept: see `Lines.distinct`.
    """

    SILHOUETTE = 0
    """A sphere from what is behind it; light on the sphere varies as the root of the distance."""

    EDGE = 1
    """A surface from what the look does not cover: another one, or a part that may be lit."""

    SHADOW = 2
    """A surface's part in a light from its part out of it: the look covers both."""


class Lines(NamedTuple):
    """Lines c + a x + b y = 0 across cells, with x and y from -1/2 to 1/2.

    Attributes
    ----------
    cell : (n,)
        The cell that each lies in.
    kind : (n,)
        Its `Kind`.
    a, b, c : (n,)
        Of any scale; along a limb, negative on the sphere's side.
    """

    cell: Ints
    kind: Ints
    a: Floats
    b: Floats
    c: Floats

    def take(self, index: Ints) -> Lines:
        """Some of them."""
        return Lines._make(m[index] for m in self)

    def crosses(self) -> Bools:
        """Whether each passes through its cell."""
        crosses: Bools = np.abs(self.c) < self.reach()
        return crosses

    def crossing(self) -> Lines:
        """The lines that pass through their cells."""
        return self.take(indices(self.crosses()))

    def differ(self, other: Lines, same: float) -> Bools:
        """Whether each is another line than its counterpart; `same`: see `distinct`."""
        mine, its = self._unit(), other._unit()
        sign = np.where(mine[0] * its[0] + mine[1] * its[1] < 0, -1.0, 1.0)
        a, b, c = (np.abs(sign * m - n) for m, n in zip(mine, its, strict=True))
        differ: Bools = a + b + c > same
        return differ

    def _unit(self) -> Triple:
        """a, b and c, scaled so that `reach` is 1."""
        return scaled((self.a, self.b, self.c), 1 / self.reach())

    def distinct(self, same: float) -> Lines:
        """Sorted by cell: of lines that are the same only the first, by kind, then a, b and c.

        So the order in which they were found changes nothing; and of an edge and a shadow in one
        place the edge is kept, for less is known of what lies beyond it.

        Lines that differ by no more than `same` count as one (c, and a and b, where `reach` is 1):
        a light near the eye throws its shadows right behind the outlines.
        """
        order = self.cell.argsort(kind="stable")
        beside = np.diff(self.cell[order]) == 0
        at = indices(np.append(beside, False) | np.append(False, beside))
        shared = self.take(order[at])
        a, b, c = shared._unit()
        order[at] = order[at[np.lexsort((c, b, a, shared.kind, shared.cell))]]
        lines = self.take(order)
        kept = np.ones(lines.cell.size, dtype=np.bool_)
        for back in range(1, _COMPARED):
            at = indices(lines.cell[back:] == lines.cell[:-back])
            if not at.size:
                break
            again = ~lines.take(at + back).differ(lines.take(at), same)
            kept[at[again] + back] = False
        return lines.take(indices(kept))

    def reach(self) -> Floats:
        """The largest |a x + b y| in a cell: a line crosses its cell where |c| is less."""
        reach: Floats = 0.5 * (np.abs(self.a) + np.abs(self.b))
        return reach

    def areas_and_moments(self) -> tuple[Floats, Floats, Floats]:
        """Share (n,) of the cell where c + a x + b y > 0, and its moments in x and y.

        The step function of z = c + a x + b y, integrated in x and in y, is max(z, 0)^2 / (2 a b):
        its integral over the cell is the sum over the corners, with alternating signs.
        """
        a, b, c = self._scaled()
        share, moment_x, moment_y = np.zeros(a.size), np.zeros(a.size), np.zeros(a.size)
        for x in (-0.5, 0.5):
            for y in (-0.5, 0.5):
                z = np.maximum(c + a * x + b * y, 0)
                square = 4 * x * y * z * z / 2
                share += square
                moment_x += x * square - square * z / (3 * a)
                moment_y += y * square - square * z / (3 * b)
        return share / (a * b), moment_x / (a * b), moment_y / (a * b)

    def gauss_points(self) -> tuple[Floats, Floats, Floats]:
        """Shares, x and y (2, n): two points for the cell's part where z = -(c + a x + b y) > 0.

        On a sphere near its limb light is a function of s = sqrt(z).  The points are those of
        Gauss's quadrature, found from the moments of s: the means of 1, s, s^2 and s^3 are exact.
        Along the limb each lies near the middle of its line of equal z, so that the mean of what
        rises evenly that way is exact as well.  Shares are of the whole cell.
        """
        a, b, c = (-m for m in self._scaled())
        x, y = np.array([[-0.5, -0.5, 0.5, 0.5], [-0.5, 0.5, -0.5, 0.5]])[:, :, None]
        z = np.maximum(c + a * x + b * y, 0)
        # As in `areas_and_moments`, with z^(k / 2) integrated twice.
        power, root = 4 * x * y / (a * b) * z * z, np.sqrt(z)
        moments = []
        for k in range(4):
            moments.append(power.sum(axis=0) / ((k / 2 + 1) * (k / 2 + 2)))
            power = power * root
        share = np.maximum(moments[0], _TINY)
        mean, second, third = (m / share for m in moments[1:])
        deviation = np.sqrt(np.maximum(second - mean * mean, _TINY))
        half_skew = (third - 3 * mean * second + 2 * mean**3) / deviation**3 / 2
        sign, root = np.array([[-1.0], [1.0]]), np.sqrt(1 + half_skew * half_skew)
        s = np.maximum(mean + deviation * (half_skew + sign * root), 0)
        shares = share * (1 - sign * half_skew / root) / 2
        level = (s * s - c) / (a * a + b * b)
        x, y = level * a, level * b
        ends = [(x - 0.5) / b, (x + 0.5) / b], [(-y - 0.5) / a, (-y + 0.5) / a]
        begin = np.maximum(*(np.minimum(*m) for m in ends))
        end = np.minimum(*(np.maximum(*m) for m in ends))
        middle, half = (begin + end) / 2, (end - begin) / 2
        _, moment_x, moment_y = self.areas_and_moments()  # of the other part: the sum is zero
        moment = (b * moment_x - a * moment_y) / (a * a + b * b)
        missing = moment - (shares * middle).sum(axis=0)
        along = middle + half * np.clip(missing / (shares * half).sum(axis=0), -1, 1)
        return shares, x - along * b, y + along * a

    def _scaled(self) -> tuple[Floats, Floats, Floats]:
        """a, b and c, scaled: the larger of |a| and |b| is 1, the smaller not nearly 0."""
        size = np.maximum(np.abs(self.a), np.abs(self.b))
        a, b = (
            np.copysign(np.maximum(np.abs(m / size), _LEAST_SLOPE), m) for m in (self.a, self.b)
        )
        return a, b, self.c / size


def joined(lines: Iterable[Lines]) -> Lines:
    """All of them as one `Lines`."""
    none, nothing = np.zeros(0, dtype=np.intp), np.zeros(0)
    parts = [Lines(none, none, nothing, nothing, nothing), *lines]
    return Lines._make(map(np.concatenate, zip(*parts, strict=True)))
