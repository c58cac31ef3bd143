"""Edges in closed form: the lines that outlines and shadows draw across a pixel.

Whatever bounds what is seen touches a sphere or an edge of a box, in a pencil
of rays from the eye or from a light.  How far a pixel's ray passes it by, and
how fast that changes across the pixel, gives a straight line.
"""

from __future__ import annotations

from collections.abc import Iterable
from enum import IntEnum
from typing import NamedTuple

import numpy as np

from tracer.arrays import Bools, Floats, Ints, Triple, cross, dot, each, pick, scaled

__all__ = ["BEND", "Kind", "Lines", "Pencil", "joined", "sagitta_error"]

BEND = 0.2
"""A line that turns by less (in radians) across a cell passes for straight."""

# Slopes of a line are at least so much of each other: then nothing divides by nearly zero.
_LEAST_SLOPE = 1e-4

# A share of a cell, or a variance in it, that is nothing but rounding.
_TINY = 1e-12

# Lines that are nowhere farther apart, in cells, count as one: a light near the eye
# throws its shadows right behind the outlines.
_SAME = 0.02

# A line is compared with fewer than so many before it in its cell.
_COMPARED = 6


class Kind(IntEnum):
    """What a line divides, from the side of its cell's middle."""

    LIMB = 0
    """A sphere from what is behind it; towards it the light on the sphere falls off as a root."""

    EDGE = 1
    """A surface from what has not been looked at yet: another surface, or what light it gets."""

    SHADOW = 2
    """A surface in one light from the same in another."""


class Lines(NamedTuple):
    """Lines c + a x + b y = 0 across cells, with x and y from -1/2 to 1/2.

    Attributes
    ----------
    cell, kind, a, b, c : (n,)
    """

    cell: Ints
    kind: Ints
    a: Floats
    b: Floats
    c: Floats

    def take(self, index: Ints) -> Lines:
        """Some of them."""
        return Lines(
            self.cell[index], self.kind[index], self.a[index], self.b[index], self.c[index]
        )

    def crosses(self) -> Bools:
        """Whether each passes through its cell."""
        crosses: Bools = np.abs(self.c) < self.reach()
        return crosses

    def crossing(self) -> Lines:
        """Those that do."""
        return self.take(np.flatnonzero(self.crosses()))

    def differ(self, other: Lines) -> Bools:
        """Whether each is another line than its counterpart."""
        mine, its = self._unit(), other._unit()
        sign = np.where(mine[0] * its[0] + mine[1] * its[1] < 0, -1.0, 1.0)
        a, b, c = (np.abs(sign * m - n) for m, n in zip(mine, its, strict=True))
        differ: Bools = a + b + c > _SAME
        return differ

    def _unit(self) -> Triple:
        """a, b and c, where the most that a x + b y differs from zero in a cell is 1."""
        return scaled((self.a, self.b, self.c), 1 / self.reach())

    def distinct(self) -> Lines:
        """Sorted by cell, and by what they are: those that are not the same as one before.

        The order in which they were found says nothing; beyond an edge there is more than beyond
        a shadow that hides it.
        """
        order = np.argsort(self.cell, kind="stable")
        same = np.diff(self.cell[order]) == 0
        at = np.flatnonzero(np.append(same, False) | np.append(False, same))
        shared = self.take(order[at])
        a, b, c = shared._unit()
        order[at] = order[at[np.lexsort((c, b, a, shared.kind, shared.cell))]]
        lines = self.take(order)
        kept = np.ones(lines.cell.size, dtype=np.bool_)
        for back in range(1, _COMPARED):
            at = np.flatnonzero(lines.cell[back:] == lines.cell[:-back])
            same = ~lines.take(at + back).differ(lines.take(at))
            kept[at[same] + back] = False
        return lines.take(np.flatnonzero(kept))

    def reach(self) -> Floats:
        """The most that a x + b y differs from zero in a cell."""
        reach: Floats = 0.5 * (np.abs(self.a) + np.abs(self.b))
        return reach

    def turn(self, off: Floats) -> Floats:
        """How far each turns in its cell (radians), if c is `off` so far in the corners."""
        # An arc is off by an eighth of its turn at the ends, and twice as far in the corners.
        turn: Floats = 4 * off / self.reach()
        return turn

    def areas_and_moments(self) -> tuple[Floats, Floats, Floats]:
        """Share (n,) of the cell where c + a x + b y > 0, and its moments in x and y.

        A step at the line, integrated in x and in y, is max(z, 0)^2 / (2 a b): what is in the
        cell is the sum over its corners, with signs in turn.
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

        Within a limb light is a function of s = sqrt(z).  The points are those of Gauss's
        quadrature, found from the moments of s: the means of 1, s, s^2 and s^3 are exact.  Each
        lies in the middle of its line of equal z.
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
        along = (begin + end) / 2
        return shares, x - along * b, y + along * a

    def _scaled(self) -> tuple[Floats, Floats, Floats]:
        """a, b and c, the larger of a and b being 1, and none of them nearly 0."""
        size = np.maximum(np.abs(self.a), np.abs(self.b))
        a, b = (
            np.copysign(np.maximum(np.abs(m / size), _LEAST_SLOPE), m) for m in (self.a, self.b)
        )
        return a, b, self.c / size


def joined(lines: Iterable[Lines]) -> Lines:
    """All lines in one."""
    none, nothing = np.zeros(0, dtype=np.intp), np.zeros(0)
    parts = [Lines(none, none, nothing, nothing, nothing), *lines]
    cell, kind = (np.concatenate([getattr(p, name) for p in parts]) for name in ("cell", "kind"))
    a, b, c = (np.concatenate([getattr(p, name) for p in parts]) for name in "abc")
    return Lines(cell, kind, a, b, c)


def sagitta_error(gradient: Triple, sagitta: Triple | None) -> Floats:
    """How far c is off in the corners because the surface is curved.

    `gradient`: of c, by where the point lies; `sagitta`: how far the surface leaves its tangent
    plane in the corners, or None.
    """
    return np.zeros(gradient[0].size) if sagitta is None else np.abs(dot(gradient, sagitta))


class Pencil(NamedTuple):
    """Rays from one apex through cells.

    Attributes
    ----------
    kind : Kind
    cell : (n,)
    ray : three (n,)
    across, down : three (n,), or numbers
        How the ray changes from one side of the cell to the other.
    sagitta : three (n,), optional
        How far it is off in the corners, for the cell's surface is curved.
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
        """Outlines of spheres, one for each ray, and how far they turn in the cell (radians).

        The last says which may cross the cell, however they turn.
        """
        length2 = dot(self.ray, self.ray)
        nearest = dot(center, self.ray) / length2
        offset = each(lambda c, d: c - nearest * d, center, self.ray)
        distance, along = np.sqrt(dot(offset, offset)), nearest * np.sqrt(length2)
        c, scale = _beyond_limb(distance, along, radius)
        # Across the ray, at that scale: how far the cell's sides lead out of it, and around it.
        out = scaled(offset, -scale / (distance * np.sqrt(length2)))
        around = scaled(cross(out, self.ray), 1 / np.sqrt(length2))
        a, b = dot(out, self.across), dot(out, self.down)
        turn_a, turn_b = dot(around, self.across), dot(around, self.down)
        # What leads along the ray makes all of it larger.
        a += c * dot(self.ray, self.across) / length2
        b += c * dot(self.ray, self.down) / length2
        # Seen at right angles from the centre the outline is straight.
        curvature = along / (distance * scale)
        # Of a line that turns, it takes more to say that it passes the cell by; of one around the
        # ray itself nothing is known.
        half = 0.5 * (np.sqrt(a * a + turn_a * turn_a) + np.sqrt(b * b + turn_b * turn_b))
        within = ~(np.abs(c) >= half)
        size = np.sqrt(a * a + b * b)
        # From the cell's middle to the line, at most to its rim, it turns as well.
        most = 0.5 / np.maximum(np.abs(a), np.abs(b))
        turned = np.clip(-c / (size * size), -most, most) * (a * turn_a + b * turn_b)
        bend = ((b * turn_a - a * turn_b) / size) ** 2 * curvature
        a, b = a + turn_a * turned * curvature, b + turn_b * turned * curvature
        c -= turned * turned * curvature / 2
        # A chord as long as the cell lies so far inside a flat arc on average.
        c += np.where(np.abs(bend) < size, bend / 24, 0)
        lines = self._lines(a, b, c)
        # With both sides of the disc in the cell there is another line.
        both = ~((distance + radius) * scale >= lines.reach() * np.abs(along))
        turned = np.abs(bend) / size + lines.turn(sagitta_error(out, self.sagitta))
        turn = np.where(both, np.inf, turned)
        return lines, turn, lines.crosses() | (within & (turn > BEND))

    def boxes(self, planes: Triple) -> tuple[Lines, Floats, Bools]:
        """The same of boxes: planes three (6, n) contain the edges of their outlines.

        The last says where a plane is missing (zero).
        """
        normals = [*zip(*planes, strict=True)]
        edges = [
            self._lines(*(dot(normal, ray) for ray in (self.across, self.down, self.ray)))
            for normal in normals
        ]
        # As far as lines may lie elsewhere because the cell's surface is curved.
        off = [sagitta_error(normal, self.sagitta) for normal in normals]
        reach = [edge.reach() + m for edge, m in zip(edges, off, strict=True)]
        within = np.all([edge.c >= -m for edge, m in zip(edges, reach, strict=True)], axis=0)
        for k in (4, 5):
            # Outlines of four edges repeat the first two.
            edges[k].c[np.all([m[k] == m[k - 4] for m in planes], axis=0)] = np.inf
        turn = [edge.turn(m) for edge, m in zip(edges, off, strict=True)]
        at = [
            np.flatnonzero(within & np.where(t > BEND, np.abs(edge.c) < m, edge.crosses()))
            for edge, m, t in zip(edges, reach, turn, strict=True)
        ]
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
        From the sphere's centre to the ray.
    along
        From the apex to where that is.
    radius
    """
    # At right angles to the ray, as far away as the limb: tan(ray - limb), with their angles to
    # the centre.
    tangent2 = along * along + (distance - radius) * (distance + radius)
    tangent = np.sqrt(tangent2)
    turned = along * tangent + distance * radius
    beyond = tangent * (distance * tangent - along * radius) / turned
    # Seen from inside, or from behind, there is no limb.
    there = (tangent2 > 0) & (turned > 0)
    return np.where(there, beyond, distance - radius), np.where(there, tangent, np.abs(along))
