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

from tracer.arrays import Bools, Floats, Ints, Triple, cross, dot, each, indices, pick, scaled

__all__ = ["MOST_TURN", "Kind", "Lines", "Pencil", "joined", "sagitta_error"]

MOST_TURN = 0.5
"""A line that turns by less (in radians) across a cell can stand for what bends there."""

# Such a line passes for straight if it turns by less than this, in radians, times the tolerance: a
# limb, or any other line.  Found by trial.
_LIMB_TURN, _TURN = 57.0, 400.0

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

    LIMB = 0
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

    def turn(self, off: Floats) -> Floats:
        """How far each turns across its cell (radians), being an arc, not a straight line.

        `off` (n,): by how much that changes c in the corners.
        """
        # As long as the cell, an arc leaves its tangent by an eighth of its turn at the ends; in
        # the corners, by twice as much.
        turn: Floats = 4 * off / self.reach()
        return turn

    def straightened(
        self, turn: Floats, tolerance: float, unresolved: Bools, near: Bools | None = None
    ) -> Lines:
        """The lines that pass through their cells, where they can stand for the arcs that they are.

        Marks `unresolved` the cells where arcs do not pass for straight if cells may be off by no
        more than the tolerance.  `turn` (n,): how far each turns; `near` (n,): which may cross
        their cells as arcs: by default, as far as `turn` says.
        """
        if near is None:
            near = np.abs(self.c) <= self.reach() * (1 + turn / 4)
        most = np.where(self.kind == Kind.LIMB, _LIMB_TURN, _TURN) * tolerance
        unresolved[self.cell[near & ~(turn <= np.minimum(most, MOST_TURN))]] = True
        return self.take(indices((turn <= MOST_TURN) & self.crosses()))

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


def sagitta_error(gradient: Triple, sagitta: Triple | None) -> Floats:
    """How far c is off in the corners because the surface is curved.

    `gradient`: of c, as the point moves; `sagitta`: the vector by which the surface leaves its
    tangent plane in the corners, or None for a plane.
    """
    return np.zeros(gradient[0].size) if sagitta is None else np.abs(dot(gradient, sagitta))


class Pencil(NamedTuple):
    """Rays through the middles of cells: one for each pair of a cell and an object.

    Attributes
    ----------
    kind : Kind
        Of the lines that these rays draw.
    cell : (n,)
    ray : three (n,)
        From its apex: from the eye to the window, or from a light to the point that is seen.
    across, down : three (n,), or numbers
        How the ray changes from the cell's left side to its right, and from its top to its bottom.
    sagitta : three (n,), optional
        By how much the ray's end is off in the corners, where the surface is curved.
    """

    kind: Kind
    cell: Ints
    ray: Triple
    across: Triple
    down: Triple
    sagitta: Triple | None = None

    def take(self, index: Ints) -> Pencil:
        """Some of them."""
        across, down = pick(self.across, index), pick(self.down, index)
        sagitta = pick(self.sagitta, index) if self.sagitta else None
        return Pencil(self.kind, self.cell[index], pick(self.ray, index), across, down, sagitta)

    def discs(self, center: Triple, radius: Floats) -> tuple[Lines, Floats, Bools]:
        """The outline of one sphere for each ray: a line, and how far it turns (n,) in radians.

        The third array (n,) says which may cross their cells, as lines or, where they turn by more
        than `MOST_TURN`, as arcs.  `center`: as seen from the apex.
        """
        length2 = dot(self.ray, self.ray)
        nearest = dot(center, self.ray) / length2
        offset = each(lambda c, d: c - nearest * d, center, self.ray)
        distance, along = np.sqrt(dot(offset, offset)), nearest * np.sqrt(length2)
        c, scale = _beyond_limb(distance, along, radius)
        # Two vectors across the ray, away from the sphere's centre and around it: their products
        # with a step of the ray are lengths, measured as c is.
        out = scaled(offset, -scale / (distance * np.sqrt(length2)))
        around = scaled(cross(out, self.ray), 1 / np.sqrt(length2))
        a, b = dot(out, self.across), dot(out, self.down)
        turn_a, turn_b = dot(around, self.across), dot(around, self.down)
        # A step along the ray lengthens it, and c in proportion.
        a += c * dot(self.ray, self.across) / length2
        b += c * dot(self.ray, self.down) / length2
        # Cotangent of the angle to the centre: the outline is straight where that is 90 degrees.
        curvature = along / (distance * scale)
        # An arc may cross the cell where its tangent does not: c is held against the farthest that
        # the cell reaches in any direction.  A ray through the centre (NaN) rules nothing out.
        half = 0.5 * (np.sqrt(a * a + turn_a * turn_a) + np.sqrt(b * b + turn_b * turn_b))
        within = ~(np.abs(c) >= half)
        size = np.sqrt(a * a + b * b)
        # Across the rays the disc is a circle.  On the steepest way in the cell c changes by u, and
        # the line is met where bent u^2 + 2 u + level = 0, or nearly met where the root is of less
        # than zero.  The tangent is taken there, or at the rim before it.
        aside = a * turn_a + b * turn_b
        bent = curvature * (1 + (aside / (size * size)) ** 2)
        level = c * (2 - c * curvature)
        met = -level / (1 + np.sqrt(np.abs(1 - bent * level)))
        most = 0.5 / np.maximum(np.abs(a), np.abs(b))
        step = np.clip(met / (size * size), -most, most)
        u, v = step * size * size, step * aside
        # There the disc's centre is in another direction, and so many times as far away.
        cosine, sine = 1 + u * curvature, v * curvature
        times = np.sqrt(cosine * cosine + sine * sine)
        cosine, sine = cosine / times, sine / times
        c += (u * (2 + u * curvature) + v * v * curvature) / (1 + times) - u * cosine - v * sine
        a, turn_a = a * cosine + turn_a * sine, turn_a * cosine - a * sine
        b, turn_b = b * cosine + turn_b * sine, turn_b * cosine - b * sine
        size = np.sqrt(a * a + b * b)
        sagging = ((b * turn_a - a * turn_b) / size) ** 2 * curvature / times
        # On average over the length of a cell, a flat arc lies this far inside its tangent.
        c += np.where(np.abs(sagging) < size, sagging / 24, 0)
        lines = self._lines(a, b, c)
        # Where the steepest way from there leaves the disc within the cell, there is a second line.
        aside = (a * turn_a + b * turn_b) / (size * size)
        farther = (lines.reach() - c) * (1 + aside * aside)
        both = ~(2 * radius * scale >= farther * np.abs(along))
        turned = np.abs(sagging) / size + lines.turn(sagitta_error(out, self.sagitta))
        turn = np.where(both, np.inf, turned)
        return lines, turn, lines.crosses() | (within & (turn > MOST_TURN))

    def boxes(self, planes: Triple) -> tuple[Lines, Floats, Bools]:
        """The outline of one box for each ray: lines that may cross their cells, and their turns.

        `planes`: the normals, three (6, n), of the planes through the apex that hold the outline's
        edges, pointing inwards.  The third array (n,) says where one of them is missing (zero).
        """
        normals = [*zip(*planes, strict=True)]
        edges = [
            self._lines(*(dot(normal, ray) for ray in (self.across, self.down, self.ray)))
            for normal in normals
        ]
        # How far off the lines may be because the surface that the cell sees is curved.
        off = [sagitta_error(normal, self.sagitta) for normal in normals]
        reach = [edge.reach() + m for edge, m in zip(edges, off, strict=True)]
        within = np.all([edge.c >= -m for edge, m in zip(edges, reach, strict=True)], axis=0)
        for k in (4, 5):
            # An outline of four edges has the first two again as its last.
            edges[k].c[np.all([m[k] == m[k - 4] for m in planes], axis=0)] = np.inf
        turn = [edge.turn(m) for edge, m in zip(edges, off, strict=True)]
        at = [indices(within & (np.abs(edge.c) < m)) for edge, m in zip(edges, reach, strict=True)]
        lines = joined(edge.take(index) for edge, index in zip(edges, at, strict=True))
        turns = np.concatenate([m[index] for m, index in zip(turn, at, strict=True)])
        unknown = ~np.any([m != 0 for m in planes], axis=0).all(axis=0)
        return lines, turns, unknown

    def _lines(self, a: Floats, b: Floats, c: Floats) -> Lines:
        return Lines(self.cell, np.full(self.cell.size, self.kind), a, b, c)


def _beyond_limb(distance: Floats, along: Floats, radius: Floats) -> tuple[Floats, Floats]:
    """How far rays pass by the limbs of spheres, and how far from the apex that is measured.

    Parameters
    ----------
    distance
        From the sphere's centre to the nearest point of the ray.
    along
        From the apex to that point.
    radius
    """
    # Measured at right angles to the ray, as far away as the limb (`tangent`): so it is tangent
    # times tan(ray - limb), with the angles of either to the centre.
    tangent2 = along * along + (distance - radius) * (distance + radius)
    tangent = np.sqrt(tangent2)
    turned = along * tangent + distance * radius
    beyond = tangent * (distance * tangent - along * radius) / turned
    # Seen from inside, or from behind, there is no limb.
    there = (tangent2 > 0) & (turned > 0)
    return np.where(there, beyond, distance - radius), np.where(there, tangent, np.abs(along))
