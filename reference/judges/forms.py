"""Enclose functions on a cell of the picture by quadratic polynomials with an error bound.

The problem: the certificate must bound quantities, such as radiance, everywhere in a square cell.
Interval arithmetic (Moore, 1966) does so by two numbers, but forgets that two quantities depend on
the same position, so that its bounds soon become useless.  Affine arithmetic (Comba and Stolfi,
1993) keeps the linear dependence.  This module keeps the quadratic dependence as well.

A cell has coordinates X and Y from -1 to 1.  A *form* represents a quantity by eight coefficients:
for some Z between -1 and 1, the quantity differs by at most coef[R] from

    coef[C] + coef[X] X + coef[Y] Y
        + coef[XX] X^2 + coef[XY] X Y + coef[YY] Y^2 + coef[Z] Z.

Z stands for the unknown part of the inverse distance of a surface.  All forms about one surface
share the same Z, so unknown parts that are linear in the distance cancel.  Forms about different
surfaces have different Z: see `difference`.

Why the result is right: each operation moves what it cannot represent (terms of degree three or
four, products with Z, rounding errors) to the radius coef[R], with its largest absolute value.

Rounding.  With e = 2^-53, an operation on floats errs by at most e times its result.  A product of
forms adds at most three products to each coefficient, and at most twenty to the radius.  So its
rounding error is less than 30 e times the sum of all |a_i b_j|.  Its radius is widened by
`ROUNDING`, which is 900 e, times this sum.  Sums of forms, and products of a form with a number,
err by e of each coefficient and widen nothing: at most four of them follow a product, whose
widening of 900 e covers them.
"""

from __future__ import annotations

import numpy as np

from reference.judges.arrays import Floats, Index

C, X, Y, XX, XY, YY, Z, R = range(8)
"""Indices of a form's coefficients; R is the radius."""

ROUNDING = 1e-13
"""Bound on the rounding error of each term, relative to the term: about 900 roundings."""

# A power is enclosed by a line along its chord, instead of Taylor's polynomial, if the polynomial's
# remainder is more than this fraction of the power's range.
_MAX_REMAINDER_RATIO = 1 / 16

# In intervals with a smaller ratio of half width to centre, the slope of the chord is lost in
# rounding errors, and Taylor's polynomial is always accurate enough.
_MIN_CHORD_WIDTH = 1e-6


class Form:
    """Forms: n quantities, each enclosed in one cell by a quadratic polynomial.

    Attributes
    ----------
    coef : (8, n) float array, or (8, 3, n) for the three channels of radiance
        The coefficients, in the order C, X, Y, XX, XY, YY, Z, R; coef[R] is at least 0.
    """

    __slots__ = ("coef",)

    def __init__(self, coef: Floats) -> None:
        """Wrap coefficients, without a copy."""
        self.coef = coef

    def __getitem__(self, index: Index) -> Form:
        """Select forms by indices or a mask (n,)."""
        # `take` needs half the time of indexing.
        index = np.flatnonzero(index) if index.dtype == np.bool_ else index
        return Form(self.coef.take(index, axis=-1))

    @property
    def radius(self) -> Floats:
        """Bound (n,) on the difference between a quantity and its quadratic polynomial."""
        radius: Floats = np.abs(self.coef[Z]) + self.coef[R]
        return radius

    @property
    def size(self) -> Floats:
        """Sum (n,) of the absolute coefficients, which bounds the quantity's absolute value."""
        size: Floats = np.abs(self.coef).sum(axis=0)
        return size

    def bounds(self) -> tuple[Floats, Floats]:
        """Bound each quantity from below (n,) and from above (n,) in its cell."""
        a, coef = np.abs(self.coef), self.coef
        either_sign = a[X] + a[Y] + a[XY] + a[Z] + coef[R]  # X^2 and Y^2 are never negative
        low = coef[C] - either_sign + np.minimum(coef[XX], 0) + np.minimum(coef[YY], 0)
        high = coef[C] + either_sign + np.maximum(coef[XX], 0) + np.maximum(coef[YY], 0)
        return low, high

    def __add__(self, other: Form | Floats | float) -> Form:
        """Add forms about the same surfaces, or numbers."""
        if isinstance(other, Form):
            return Form(self.coef + other.coef)
        coef = self.coef.copy()
        coef[C] += other
        coef[R] += ROUNDING * np.abs(other)
        return Form(coef)

    def __sub__(self, other: Form) -> Form:
        """Subtract forms about the same surfaces."""
        return self + other * -1.0

    def __mul__(self, other: Form | Floats | float) -> Form:
        """Multiply by forms about the same surfaces, or by numbers."""
        if not isinstance(other, Form):
            coef = self.coef * other
            coef[R] = np.abs(coef[R])
            return Form(coef)
        a, b = self.coef, other.coef
        coef = b * a[C]
        coef += a * b[C]
        coef[C] = a[C] * b[C]
        coef[XX] += a[X] * b[X]
        coef[XY] += a[X] * b[Y] + a[Y] * b[X]
        coef[YY] += a[Y] * b[Y]
        # The radius bounds all other products: of degree three or four, or with a Z.
        a, b = np.abs(a), np.abs(b)
        a1, b1, a2, b2 = a[X] + a[Y], b[X] + b[Y], a[XX:Z].sum(axis=0), b[XX:Z].sum(axis=0)
        coef[R] = a1 * b2 + a2 * (b1 + b2) + a[Z] * (b1 + b2 + b[Z]) + b[Z] * (a1 + a2)
        a_size, b_size = a[C] + a1 + a2 + a[Z], b[C] + b1 + b2 + b[Z]
        coef[R] += a[R] * (b_size + b[R]) + b[R] * a_size + ROUNDING * a_size * b_size
        return Form(coef)

    def power(
        self, exponent: Floats | float, minimum: float = 0.0, maximum: float = np.inf
    ) -> Form:
        """Enclose powers f(z) = z^exponent of the quantities z that these forms enclose.

        Two enclosures are computed, and the one with the smaller radius is returned:

        1. Taylor's polynomial of degree 2 around the centre c of the interval [c - w, c + w] of z.
           Its remainder is at most |f'''| w^3 / 6.  The maximum of |f'''| is at one end of the
           interval, because f''' is monotonic.
        2. If the remainder is large: a line parallel to the chord of f.  As f is convex or concave,
           it lies between the chord and the parallel tangent.  The line is at two thirds of the way
           from the chord to the tangent, where a parabola has its mean.

        Rounding: the power and each coefficient have a relative error of a few e.  They are
        multiplied by at most |f'| w, f'' w^2 < |f'| w, or f.

        Parameters
        ----------
        exponent : float, or (n,) float array
            The exponents.
        minimum, maximum : float
            Bounds on z that are known from elsewhere; minimum is at least 0.

        Returns
        -------
        power : Form
            Enclosures (8, n) of the powers.
        """
        low, high = (np.clip(end, minimum, maximum) for end in self.bounds())
        center, w = 0.5 * (low + high), 0.5 * (high - low)
        f_low, f_high, f = (_power(z, exponent) for z in (low, high, center))
        first = exponent * f / center
        second = 0.5 * (exponent - 1) * first / center
        third = np.abs(exponent * (exponent - 1) * (exponent - 2)) / 6
        remainder = third * np.maximum(f_low / low**3, f_high / high**3) * w**3
        d = self + -center
        result = d * d * second + d * first + f
        result.coef[R] += remainder + ROUNDING * (np.maximum(f_low, f_high) + np.abs(first) * high)
        is_coarse = ~(remainder < np.abs(f_high - f_low) * _MAX_REMAINDER_RATIO)
        is_coarse = is_coarse & (w > _MIN_CHORD_WIDTH * center) | ~(remainder < np.inf)
        index = np.flatnonzero(is_coarse)
        low, high, f_low, f_high = (values[index] for values in (low, high, f_low, f_high))
        line = self[index]._line(
            np.broadcast_to(exponent, w.shape)[index], low, high, f_low, f_high
        )
        is_better = ~(result.coef[R, index] < line.coef[R])
        result.coef[:, index[is_better]] = line.coef[:, is_better]
        return result

    def _line(
        self, exponent: Floats, low: Floats, high: Floats, f_low: Floats, f_high: Floats
    ) -> Form:
        """Enclose the powers of quantities by a line parallel to the chord; see `power`.

        Parameters
        ----------
        exponent : (n,) float array
            The exponents.
        low, high : (n,) float arrays
            Bounds on the quantities.
        f_low, f_high : (n,) float arrays
            The powers of these bounds.

        Returns
        -------
        line : Form
            Enclosures (8, n) of the powers, linear in the quantities.
        """
        slope = np.where(high > low, (f_high - f_low) / (high - low), 0)
        z = (slope / exponent) ** (1 / (exponent - 1))  # there the tangent has this slope
        z = np.clip(np.where(np.isfinite(z), z, 0.5 * (low + high)), low, high)
        chord, tangent = f_low - slope * low, z**exponent - slope * z
        line = self * slope
        line.coef[C] += (chord + 2 * tangent) / 3
        line.coef[R] += np.abs(chord - tangent) * (2 / 3)
        line.coef[R] += ROUNDING * (np.maximum(f_low, f_high) + np.abs(slope) * high)
        return line

    def unit(self) -> Form:
        """Replace forms that are wider than [0, 1] by [0, 1], for quantities that lie there."""
        is_loose = ~(self.size < 2)
        coef = np.where(is_loose, 0, self.coef)
        coef[C, is_loose] = coef[R, is_loose] = 0.5
        return Form(coef)

    def quarters(self) -> Form:
        """Express each quantity by the coordinates of each of the four quarters of its cell.

        Returns
        -------
        quarters : Form
            Forms (8, ..., 4 n), quarter after quarter: upper left, upper right, lower left, lower
            right.  In each quarter, X and Y run from -1 to 1.  The unknown Z becomes part of the
            radius.  Each coefficient is a sum of at most six terms, and errs by 6 e of them.
        """
        c, x, y, xx, xy, yy, _, _ = self.coef.repeat(4, axis=-1)
        quarter = np.arange(c.shape[-1]) % 4
        a, b = (quarter & 1) - 0.5, (quarter >> 1) - 0.5  # the quarter's centre
        radius = (self.radius + ROUNDING * self.size).repeat(4, axis=-1)
        center = c + a * (x + a * xx + b * xy) + b * (y + b * yy)
        across, down = x / 2 + a * xx + b * xy / 2, y / 2 + b * yy + a * xy / 2
        return Form(np.array([center, across, down, xx / 4, xy / 4, yy / 4, 0 * c, radius]))


def _power(z: Floats, exponent: Floats | float) -> Floats:
    """Compute z^exponent; square roots are much faster than other powers."""
    if isinstance(exponent, float) and abs(exponent) == 0.5:
        return np.sqrt(z) if exponent > 0 else 1 / np.sqrt(z)
    power: Floats = z**exponent
    return power


def constant(value: Floats, radius: Floats | float = 0.0) -> Form:
    """Make forms (8, ..., n) of quantities that are constant in a cell, within a radius.

    Parameters
    ----------
    value : (..., n) float array
        The constants.
    radius : float, or array that broadcasts to (..., n)
        Bound on the difference between each quantity and its constant.
    """
    coef = np.zeros((8, *value.shape))
    coef[C], coef[R] = value, radius
    return Form(coef)


def difference(form: Form, other: Form) -> Form:
    """Subtract quantities of different surfaces.

    Their unknown parts Z are independent, so they do not cancel, but add to the radius.

    Parameters
    ----------
    form, other : Form
        Enclosures (8, n) of the minuend and the subtrahend.

    Returns
    -------
    difference : Form
        Enclosures (8, n) of the differences, without Z.
    """
    coef = form.coef - other.coef
    coef[R], coef[Z] = form.radius + other.radius, 0
    return Form(coef)
