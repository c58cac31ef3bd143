"""Quadratic forms: affine arithmetic (Comba and Stolfi, 1993), taken to second order.

A cell of the picture has coordinates -1 <= X, Y <= 1.  A *form* encloses a quantity that depends on
them, as interval arithmetic (Moore, 1966) does, but keeps track of how:

    m[C] + m[X] X + m[Y] Y + m[XX] X^2 + m[XY] X Y + m[YY] Y^2 + m[Z] Z + [-m[R], m[R]].

Z, from -1 to 1, is what is not known of the inverse distance of a surface: one symbol for each
surface, so that what is linear in the distance cancels.  It has no meaning between surfaces.

Rounding.  With e = 2^-53, an operation on floats errs by at most e of its result.  A product of
forms adds at most three products to each coefficient, and at most twenty to the radius, hence errs
by less than 30 e of the sum of all |a_i b_j|.  Its radius is widened by `ROUNDING`, 900 e, of that
sum.  The sum of forms, or the product with a number, errs by e of each coefficient: of coefficients
that their own products have been widened by 900 e of.  At most four follow each other.
"""

from __future__ import annotations

import numpy as np

from reference.judges.arrays import Floats, Index

C, X, Y, XX, XY, YY, Z, R = range(8)
"""Rows of a form's coefficients."""

ROUNDING = 1e-13
"""The part of each term that its rounding is less than."""


class Form:
    """Forms (n,), each of one quantity in one cell.

    Attributes
    ----------
    m : (8, n), or (8, 3, n) of radiance
        The coefficients; m[R] >= 0.
    """

    __slots__ = ("m",)

    def __init__(self, m: Floats) -> None:
        self.m = m

    def __getitem__(self, index: Index) -> Form:
        # `take` needs half the time of indexing.
        at = np.flatnonzero(index) if index.dtype == np.bool_ else index
        return Form(self.m.take(at, axis=-1))

    @property
    def radius(self) -> Floats:
        """By how much a quantity may differ from the quadratic."""
        radius: Floats = np.abs(self.m[Z]) + self.m[R]
        return radius

    @property
    def size(self) -> Floats:
        """The sum of the coefficients' absolute values: no quantity is larger."""
        size: Floats = np.abs(self.m).sum(axis=0)
        return size

    def bounds(self) -> tuple[Floats, Floats]:
        """Least and greatest value in the cell."""
        a, m = np.abs(self.m), self.m
        either = a[X] + a[Y] + a[XY] + a[Z] + m[R]
        low = m[C] - either + np.minimum(m[XX], 0) + np.minimum(m[YY], 0)
        return low, m[C] + either + np.maximum(m[XX], 0) + np.maximum(m[YY], 0)

    def __add__(self, other: Form | Floats | float) -> Form:
        if isinstance(other, Form):
            return Form(self.m + other.m)
        m = self.m.copy()
        m[C] += other
        m[R] += ROUNDING * np.abs(other)
        return Form(m)

    def __sub__(self, other: Form) -> Form:
        return self + other * -1.0

    def __mul__(self, other: Form | Floats | float) -> Form:
        if not isinstance(other, Form):
            m = self.m * other
            m[R] = np.abs(m[R])
            return Form(m)
        a, b = self.m, other.m
        m = b * a[C]
        m += a * b[C]
        m[C] = a[C] * b[C]
        m[XX] += a[X] * b[X]
        m[XY] += a[X] * b[Y] + a[Y] * b[X]
        m[YY] += a[Y] * b[Y]
        # What is left out has the third degree or the fourth, or two symbols of which one is Z.
        a, b = np.abs(a), np.abs(b)
        a1, b1, a2, b2 = a[X] + a[Y], b[X] + b[Y], a[XX:Z].sum(axis=0), b[XX:Z].sum(axis=0)
        m[R] = a1 * b2 + a2 * (b1 + b2) + a[Z] * (b1 + b2 + b[Z]) + b[Z] * (a1 + a2)
        a_size, b_size = a[C] + a1 + a2 + a[Z], b[C] + b1 + b2 + b[Z]
        m[R] += a[R] * (b_size + b[R]) + b[R] * a_size + ROUNDING * a_size * b_size
        return Form(m)

    def power(self, s: Floats | float, least: float = 0.0, most: float = np.inf) -> Form:
        """z^s of quantities that are known to lie between `least` >= 0 and `most`.

        In the middle c of what z may be, [c - w, c + w], Taylor's polynomial of degree 2 errs by at
        most |f'''| w^3 / 6, with the third derivative at one end, as it is monotonic.  Where that
        is too coarse: a line parallel to the chord.  From the chord, f differs most where f' is its
        slope, for f is convex or concave; the line runs two thirds of the way to there, where a
        parabola has its mean.

        Rounding: a power errs by some e, relatively, and every coefficient by some e of itself.
        These are multiplied by no more than |f'| w, f'' w^2 < |f'| w, or z^s.
        """
        a, b = (np.clip(end, least, most) for end in self.bounds())
        middle, w = 0.5 * (a + b), 0.5 * (b - a)
        f_a, f_b, f = (_power(z, s) for z in (a, b, middle))
        first = s * f / middle
        second = 0.5 * (s - 1) * first / middle
        off = np.abs(s * (s - 1) * (s - 2)) / 6 * np.maximum(f_a / a**3, f_b / b**3) * w**3
        d = self + -middle
        result = d * d * second + d * first + f
        result.m[R] += off + ROUNDING * (np.maximum(f_a, f_b) + np.abs(first) * b)
        coarse = ~(off < np.abs(f_b - f_a) / 16) & (w > 1e-6 * middle) | ~(off < np.inf)
        at = np.flatnonzero(coarse)
        t, (a, b, f_a, f_b) = np.broadcast_to(s, w.shape)[at], (m[at] for m in (a, b, f_a, f_b))
        slope = np.where(b > a, (f_b - f_a) / (b - a), 0)
        z = (slope / t) ** (1 / (t - 1))
        z = np.clip(np.where(np.isfinite(z), z, 0.5 * (a + b)), a, b)
        chord, tangent = f_a - slope * a, z**t - slope * z
        line = self[at] * slope
        line.m[C] += (chord + 2 * tangent) / 3
        line.m[R] += np.abs(chord - tangent) * (2 / 3)
        line.m[R] += ROUNDING * (np.maximum(f_a, f_b) + np.abs(slope) * b)
        better = ~(result.m[R, at] < line.m[R])
        result.m[:, at[better]] = line.m[:, better]
        return result

    def unit(self) -> Form:
        """The same, or [0, 1] where that says more, of quantities that lie there."""
        loose = ~(self.size < 2)
        m = np.where(loose, 0, self.m)
        m[C, loose] = m[R, loose] = 0.5
        return Form(m)

    def quarters(self) -> Form:
        """The same in the four quarters of each cell, whose own X and Y run from -1 to 1.

        Z is another there; each coefficient is a sum of at most six terms, and errs by 6 e of them.
        """
        c, x, y, xx, xy, yy, _, _ = self.m.repeat(4, axis=-1)
        part = np.arange(c.shape[-1]) % 4
        a, b = (part & 1) - 0.5, (part >> 1) - 0.5
        off = (self.radius + ROUNDING * self.size).repeat(4, axis=-1)
        middle = c + a * (x + a * xx + b * xy) + b * (y + b * yy)
        across, down = x / 2 + a * xx + b * xy / 2, y / 2 + b * yy + a * xy / 2
        return Form(np.array([middle, across, down, xx / 4, xy / 4, yy / 4, 0 * c, off]))


def _power(z: Floats, s: Floats | float) -> Floats:
    """z^s; roots are much faster than powers."""
    if isinstance(s, float) and abs(s) == 0.5:
        return np.sqrt(z) if s > 0 else 1 / np.sqrt(z)
    power: Floats = z**s
    return power


def constant(value: Floats, radius: Floats | float = 0.0) -> Form:
    """Quantities (..., n) that are the same in all of a cell, or differ by no more than that."""
    m = np.zeros((8, *value.shape))
    m[C], m[R] = value, radius
    return Form(m)


def difference(form: Form, other: Form) -> Form:
    """The difference of quantities of two surfaces, each with a Z of its own."""
    m = form.m - other.m
    m[R], m[Z] = form.radius + other.radius, 0
    return Form(m)
