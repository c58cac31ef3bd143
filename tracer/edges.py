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

from tracer.arrays import Bools, Triple, cross, dot, each, pick, scaled
from tracer.scene import Floats, Ints

__all__ = ["BEND", "Kind", "Lines", "Pencil", "bowed", "joined"]

BEND = 0.2
"""A line that turns by less (in radians) across a cell passes for straight."""

# Slopes of a line are at least so much of each other: then nothing divides by nearly zero.
_LEAST_SLOPE = 1e-4

# Lines that are nowhere farther apart, in cells, count as one: a light near the eye
# throws its shadows right behind the outlines.
_SAME = 0.02


class Kind(IntEnum):
    """What draws a line: beyond it there may be lines of a later kind."""

    LIMB = 0
    OUTLINE = 1
    RIDGE = 2
    SHADOW = 3


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
        mine, its = self.reach(), other.reach()
        sign = np.where(self.a * other.a + self.b * other.b < 0, -1.0, 1.0)
        a, b, c = (
            np.abs(sign * m / mine - n / its)
            for m, n in ((self.a, other.a), (self.b, other.b), (self.c, other.c))
        )
        differ: Bools = a + b + c > _SAME
        return differ

    def reach(self) -> Floats:
        """The most that a x + b y differs from zero in a cell."""
        reach: Floats = 0.5 * (np.abs(self.a) + np.abs(self.b))
        return reach

    def halves(self) -> tuple[Floats, Floats, Floats]:
        """Share (n,) of the cell where c + a x + b y > 0, and its moments in x and y.

        A step at the line, integrated in x and in y, is max(z, 0)^2 / (2 a b): what is in the
        cell is the sum over its corners, with signs in turn.
        """
        size = np.maximum(np.abs(self.a), np.abs(self.b))
        a, b = (
            np.copysign(np.maximum(np.abs(m / size), _LEAST_SLOPE), m) for m in (self.a, self.b)
        )
        share, moment_x, moment_y = np.zeros(size.size), np.zeros(size.size), np.zeros(size.size)
        for x in (-0.5, 0.5):
            for y in (-0.5, 0.5):
                z = np.maximum(self.c / size + a * x + b * y, 0)
                square = 4 * x * y * z * z / 2
                share += square
                moment_x += x * square - square * z / (3 * a)
                moment_y += y * square - square * z / (3 * b)
        return share / (a * b), moment_x / (a * b), moment_y / (a * b)


def joined(lines: Iterable[Lines]) -> Lines:
    """All lines in one."""
    none, nothing = np.zeros(0, dtype=np.intp), np.zeros(0)
    parts = [Lines(none, none, nothing, nothing, nothing), *lines]
    cell, kind = (np.concatenate([getattr(p, name) for p in parts]) for name in ("cell", "kind"))
    a, b, c = (np.concatenate([getattr(p, name) for p in parts]) for name in "abc")
    return Lines(cell, kind, a, b, c)


def bowed(lines: Lines, slope: Triple, bow: Triple | None) -> Floats:
    """How far lines turn in their cells because the surface is curved (radians).

    `slope` is that of c on the way that the surface is off in the corners, `bow`.
    """
    if bow is None:
        return np.zeros(lines.cell.size)
    # An arc is off by an eighth of its turn at the ends, and twice as far in the corners.
    turn: Floats = 4 * np.abs(dot(slope, bow)) / lines.reach()
    return turn


class Pencil(NamedTuple):
    """Rays from one apex through cells.

    Attributes
    ----------
    kind : Kind
    cell : (n,)
    ray : three (n,)
    across, down : three (n,), or numbers
        How the ray changes from one side of the cell to the other.
    bow : three (n,), optional
        How far it is off in the corners, for the cell's surface is curved.
    """

    kind: Kind
    cell: Ints
    ray: Triple
    across: Triple
    down: Triple
    bow: Triple | None = None

    def take(self, index: Ints) -> Pencil:
        """Some of them."""
        across, down = pick(self.across, index), pick(self.down, index)
        bow = pick(self.bow, index) if self.bow else None
        return Pencil(self.kind, self.cell[index], pick(self.ray, index), across, down, bow)

    def discs(self, center: Triple, radius: Floats) -> tuple[Lines, Floats, Bools]:
        """Outlines of spheres, one for each ray, and how far they turn in the cell (radians).

        The last says which may cross the cell, however they turn.
        """
        length2 = dot(self.ray, self.ray)
        nearest = dot(center, self.ray) / length2
        offset = each(lambda c, d: c - nearest * d, center, self.ray)
        distance = np.sqrt(dot(offset, offset))
        # Across the ray, at the sphere: how far the cell's sides lead out of it, and around it.
        out = scaled(offset, -nearest / distance)
        around = scaled(cross(out, self.ray), 1 / np.sqrt(length2))
        a, b = dot(out, self.across), dot(out, self.down)
        turn_a, turn_b = dot(around, self.across), dot(around, self.down)
        c = _beyond_limb(distance, nearest * np.sqrt(length2), radius)
        # What leads along the ray makes all of it larger.
        a += c * dot(self.ray, self.across) / length2
        b += c * dot(self.ray, self.down) / length2
        # Of a line that turns, it takes more to say that it passes the cell by; of one around the
        # ray itself nothing is known.
        half = 0.5 * (np.sqrt(a * a + turn_a * turn_a) + np.sqrt(b * b + turn_b * turn_b))
        within = ~(np.abs(c) >= half)
        size = np.sqrt(a * a + b * b)
        # From the cell's middle to the line, at most to its rim, it turns as well.
        most = 0.5 / np.maximum(np.abs(a), np.abs(b))
        turned = np.clip(-c / (size * size), -most, most) * (a * turn_a + b * turn_b)
        bend = ((b * turn_a - a * turn_b) / size) ** 2 / distance
        a, b = a + turn_a * turned / distance, b + turn_b * turned / distance
        c -= turned * turned / (2 * distance)
        # A chord as long as the cell lies so far inside a flat arc on average.
        c += np.where(bend < size, bend / 24, 0)
        lines = self._lines(a, b, c)
        # With both sides of the disc in the cell there is another line.
        both = ~(distance + radius >= lines.reach())
        turn = np.where(both, np.inf, bend / size + bowed(lines, out, self.bow))
        return lines, turn, lines.crosses() | (within & (turn > BEND))

    def boxes(self, planes: Triple) -> tuple[Lines, Floats]:
        """The same of boxes: planes three (6, n) contain the edges of their outlines."""
        normals = [*zip(*planes, strict=True)]
        edges = [
            self._lines(*(dot(normal, ray) for ray in (self.across, self.down, self.ray)))
            for normal in normals
        ]
        within = np.all([edge.c >= -edge.reach() for edge in edges], axis=0)
        for k in (4, 5):
            # Outlines of four edges repeat the first two.
            edges[k].c[np.all([m[k] == m[k - 4] for m in planes], axis=0)] = np.inf
        turn = [bowed(edge, normal, self.bow) for edge, normal in zip(edges, normals, strict=True)]
        at = [np.flatnonzero(within & edge.crosses()) for edge in edges]
        lines = joined(edge.take(index) for edge, index in zip(edges, at, strict=True))
        return lines, np.concatenate([m[index] for m, index in zip(turn, at, strict=True)])

    def _lines(self, a: Floats, b: Floats, c: Floats) -> Lines:
        return Lines(self.cell, np.full(self.cell.size, self.kind), a, b, c)


def _beyond_limb(distance: Floats, along: Floats, radius: Floats) -> Floats:
    """How far rays pass by the limbs of spheres, at right angles, where they are nearest.

    Parameters
    ----------
    distance
        From the sphere's centre to the ray.
    along
        From the apex to where that is.
    radius
    """
    # With the angles of ray and limb to the centre, along * tan(ray - limb).
    tangent2 = along * along + (distance - radius) * (distance + radius)
    ratio = radius / np.sqrt(tangent2)
    angular = (distance - along * ratio) / (1 + distance / along * ratio)
    # Seen from inside, or from behind, there is no limb.
    return np.where((tangent2 > 0) & (along > 0), angular, distance - radius)
