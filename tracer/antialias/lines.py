"""Straight lines across cells, which stand there for the edges that the picture shows.

A *cell* is a square of the picture: a pixel, or a part of one.  Positions in a cell are x and y
from -1/2 to 1/2, so its middle is at 0, 0.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tracer.arrays import Bools, Floats, Ints, Triple, indices, scaled

# A line is compared with fewer than this many of those sorted before it in its cell.
_COMPARED = 6


class Lines(NamedTuple):
    """Lines c + a x + b y = 0 across cells.

    Attributes
    ----------
    cell : (n,)
        The cell that each lies in.
    a, b, c : (n,)
        Of any scale.
    """

    cell: Ints
    a: Floats
    b: Floats
    c: Floats

    def take(self, index: Ints | slice) -> Lines:
        """Some of them."""
        return Lines._make(m[index] for m in self)

    def reach(self) -> Floats:
        """The largest |a x + b y| in a cell: a line crosses its cell where |c| is less."""
        reach: Floats = 0.5 * (np.abs(self.a) + np.abs(self.b))
        return reach

    def distinct(self, same: float) -> Lines:
        """Sort them by cell; of lines that are the same keep only the first, by a, b and c.

        So the order in which they were found changes nothing.  Lines that differ by no more than
        `same` count as one (c, and a and b, where `reach` is 1): a light near the eye throws
        shadows right behind silhouettes.
        """
        a, b, c = scaled((self.a, self.b, self.c), 1 / self.reach())
        # A line and its negative are the same.
        a, b, c = scaled((a, b, c), np.where((a < 0) | ((a == 0) & (b < 0)), -1.0, 1.0))
        order = self.cell.argsort(kind="stable")
        beside = np.diff(self.cell[order]) == 0
        at = indices(np.append(beside, False) | np.append(False, beside))
        shared = order[at]
        order[at] = shared[np.lexsort((c[shared], b[shared], a[shared], self.cell[shared]))]
        lines = Lines(self.cell[order], a[order], b[order], c[order])
        kept = np.ones(order.size, dtype=np.bool_)
        for back in range(1, _COMPARED):
            at = indices(lines.cell[back:] == lines.cell[:-back])
            if not at.size:
                break
            kept[at[~_differ(lines.take(at + back), lines.take(at), same)] + back] = False
        return lines.take(indices(kept))


def _differ(one: Lines, other: Lines, same: float) -> Bools:
    """Whether lines, whose `reach` is 1, differ by more than `same`."""
    sign = np.where(one.a * other.a + one.b * other.b < 0, -1.0, 1.0)
    first: Triple = one.a, one.b, one.c
    off = sum(np.abs(sign * m - n) for m, n in zip(first, other[1:], strict=True))
    return np.asarray(off > same)
