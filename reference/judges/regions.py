"""Where edges lie in a cell: strips that hold them, and the regions between."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from reference.judges.arrays import Floats, Index, Ints, sums
from reference.judges.forms import XX, XY, YY, C, Form, X, Y

NO_AREA = 1e-12
"""Regions that are smaller, as parts of a cell, are little but rounding."""


class Strips(NamedTuple):
    """Strips (n,) around lines c + a X + b Y = 0, |a| + |b| = 1, sorted by cell.

    Attributes
    ----------
    cell, a, b, c : (n,)
    half : (n,)
        A point is in the strip if |c + a X + b Y| is no more.
    jump : (n,)
        By how much radiance may change there.
    """

    cell: Ints
    a: Floats
    b: Floats
    c: Floats
    half: Floats
    jump: Floats

    def take(self, index: Index) -> Strips:
        """Some of them."""
        return self._replace(**{name: m[index] for name, m in self._asdict().items()})

    @property
    def share(self) -> Floats:
        """The part (n,) of its cell that each covers, at most."""
        return np.asarray(np.fmin(self.half / np.maximum(np.abs(self.a), np.abs(self.b)), 1))


def strips(cell: Ints, form: Form, jump: Floats) -> Strips:
    """Enclose the zeros of edge functions (n,), where radiance may `jump`, between parallel lines.

    At the foot of the cell's middle on the zero, let n run along the gradient, of length g, and t
    across it.  A quadratic is v + g n (1 + e) + h t^2 / 2, with |e| <= k, where k bounds
    (f_tn t + f_nn n / 2) / g in the cell.  With T = max |t|, h t^2 / 2 is h T^2 / 6, give or take
    |h| T^2 / 3; that and the form's radius make d.  With w = v + h T^2 / 6, the function is zero
    only where |w + g n| <= d + (|w| + d) k / (1 - k).
    """
    m = form.m
    steep = m[X] ** 2 + m[Y] ** 2
    bend = 2 * (m[X] ** 2 * m[XX] + m[X] * m[Y] * m[XY] + m[Y] ** 2 * m[YY]) / steep
    step = -2 * m[C] / (steep + np.sqrt(np.abs(steep * (steep - 2 * m[C] * bend))))
    most = 1 / np.maximum(np.abs(m[X]), np.abs(m[Y]))  # the foot stays in the cell
    step = np.where(steep > 0, np.clip(step, -most, most), 0)
    x, y = step * m[X], step * m[Y]
    v = m[C] + m[X] * x + m[Y] * y + m[XX] * x * x + m[XY] * x * y + m[YY] * y * y
    a, b = m[X] + 2 * m[XX] * x + m[XY] * y, m[Y] + m[XY] * x + 2 * m[YY] * y
    g = np.hypot(a, b)
    p, q = a / g, b / g  # n is along (p, q), t along (-q, p)
    f_tt = 2 * (m[XX] * q * q - m[XY] * p * q + m[YY] * p * p)
    f_tn = 2 * (m[YY] - m[XX]) * p * q + m[XY] * (p * p - q * q)
    f_nn = 2 * (m[XX] * p * p + m[XY] * p * q + m[YY] * q * q)
    side = np.abs(p) + np.abs(q)
    t, n = side + np.abs(p * y - q * x), side + np.abs(p * x + q * y)
    k = (np.abs(f_tn) * t + 0.5 * np.abs(f_nn) * n) / g
    w, d = v + f_tt * t * t / 6, np.abs(f_tt) * t * t / 3 + form.radius
    half = np.where(k < 1, d + (np.abs(w) + d) * k / (1 - k), np.inf)
    scale = np.where((a < 0) | ((a == 0) & (b < 0)), -1, 1) / (np.abs(a) + np.abs(b))
    line, flat = np.array([a, b, w - a * x - b * y]) * scale, ~np.isfinite(scale)
    line[:, flat], half = [[1], [0], [0]], np.where(flat, np.inf, half * np.abs(scale))
    near = np.flatnonzero(~(np.abs(line[2]) - half >= 1))
    by = near[np.argsort(cell[near], kind="stable")]
    (a, b, c), cell, half = line[:, by], cell[by], half[by]
    return Strips(cell, a, b, c, half, jump[by])


class Regions(NamedTuple):
    """Convex regions (n,) between the lines of cells, sorted by cell.

    Attributes
    ----------
    cell, signs, area : (n,)
        Bit i of `signs` is set above the i-th line of the cell.  The area is a part of the cell's.
    mean : (6, n)
        Means of 1, X, Y, X^2, X Y and Y^2.
    """

    cell: Ints
    signs: Ints
    area: Floats
    mean: Floats


def divide(lines: Strips, count: int) -> Regions:
    """Cut cells (count,), two triangles each, by the middle lines of strips."""
    first = lines.cell.searchsorted(np.arange(count + 1))
    bits = int(np.diff(first).max(initial=0))
    cell, signs = np.arange(count).repeat(2), np.zeros(2 * count, dtype=np.intp)
    corner = np.tile([[-1 - 1j, -1 - 1j], [1 - 1j, 1 + 1j], [1 + 1j, -1 + 1j]], count)
    for bit in range(bits):
        line = first[cell] + bit
        some = np.flatnonzero(line < first[cell + 1])
        at, line = corner[:, some], line[some]
        z = lines.a[line] * at.real + lines.b[line] * at.imag + lines.c[line]
        above = z > 0
        n = above.sum(axis=0)
        signs[some[n == 3]] |= 1 << bit
        cut = np.flatnonzero((n == 1) | (n == 2))
        # Turned so that the first corner is the one that is alone on its side.
        alone, some = n[cut] == 1, some[cut]
        turned = (np.argmax(above[:, cut] == alone, axis=0) + np.arange(3)[:, None]) % 3
        (a, b, c), (z_a, z_b, z_c) = corner[turned, some], z[turned, cut]
        p, q = a + z_a / (z_a - z_b) * (b - a), a + z_a / (z_a - z_c) * (c - a)
        corner[:, some] = a, p, q
        corner = np.concatenate([corner, (p, b, c), (p, c, q)], axis=1)
        below = signs[some]
        signs[some] = below | alone << bit
        signs = np.concatenate([signs, *[below | ~alone << bit] * 2])
        cell = np.concatenate([cell, cell[some], cell[some]])
    x, y = corner.real, corner.imag
    area = np.abs((x[1] - x[0]) * (y[2] - y[0]) - (x[2] - x[0]) * (y[1] - y[0])) / 8
    # Over a triangle, p q has the mean (sum of p_i q_i + sum of p_i times sum of q_i) / 12.
    means = [m.sum(axis=0) / 3 for m in (x, y)]
    for p, q in ((x, x), (x, y), (y, y)):
        means.append(((p * q).sum(axis=0) + p.sum(axis=0) * q.sum(axis=0)) / 12)
    key, region = np.unique(cell << bits | signs, return_inverse=True)
    total = sums(region, area, key.size)
    part = area / np.maximum(total, NO_AREA)[region]
    mean = [np.ones(key.size), *(sums(region, part * m, key.size) for m in means)]
    return Regions(key >> bits, key & ((1 << bits) - 1), total, np.array(mean))
