"""Enclose functions on a cell of the picture by quadratic polynomials with an error bound.

The problem: the certificate must bound quantities, such as radiance, everywhere in a square cell of
the picture.  Interval arithmetic (Moore, 1966) encloses a quantity by two numbers.  But it forgets
that two quantities depend on the same position, so its bounds soon become useless.  Affine
arithmetic (Comba and Stolfi, 1993) keeps the linear dependence.  This module keeps the quadratic
dependence as well.

A cell has coordinates X and Y from -1 to 1.  A *form* represents a quantity by eight coefficients:
for some Z between -1 and 1, the quantity differs by at most coef[R] from

    coef[C] + coef[X] X + coef[Y] Y
        + coef[XX] X^2 + coef[XY] X Y + coef[YY] Y^2 + coef[Z] Z.

Z stands for the unknown part of the inverse distance of a surface.  All forms about one surface
share the same Z, so unknown parts that are linear in the distance cancel.  Forms about different
surfaces have different Z: see `difference_form`.

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
"""Rows of a form's array: coefficients of 1, X, Y, X^2, X Y, Y^2 and Z; R is the error bound."""

ROUNDING = 1e-13
"""Bound on the rounding error of each term, relative to the term: about 900 roundings."""

# A power is enclosed by a line along its chord, instead of Taylor's polynomial, if the polynomial's
# remainder is more than this fraction of the power's range.
_MAX_REMAINDER_RATIO = 1 / 16

# In intervals with a smaller ratio of half width to centre, the slope of the chord is lost in
# rounding errors, and Taylor's polynomial is always accurate enough.
_MIN_CHORD_WIDTH = 1e-6


class Form:
    """Forms: n quantities, each enclosed in one cell by a quadratic polynomial with an error bound.

    X and Y are the coordinates in the cell, from -1 to 1.  Z stands for the unknown part of the
    distance of a surface.  It lies between -1 and 1, and is the same for all forms about one
    surface.  A quantity differs by at most coef[R] from

        coef[C] + coef[X] X + coef[Y] Y
            + coef[XX] X^2 + coef[XY] X Y + coef[YY] Y^2 + coef[Z] Z.

    Attributes
    ----------
    coef : (8, n) float array, or (8, 3, n) for the three channels of radiance
        Rows 0 to 6 (C, X, Y, XX, XY, YY, Z) hold the coefficients of 1, X, Y, X^2, X Y, Y^2 and Z.
        Row 7 (R, the radius) holds the error bound, which is at least 0.
    """

    __slots__ = ("coef",)

    def __init__(self, coef: Floats) -> None:
        """Store the array of coefficients (8, ..., n), without copying it."""
        self.coef = coef

    def __getitem__(self, index: Index) -> Form:
        """Copy the forms that indices (k,) or a mask (n,) select along the last axis."""
        # `take` needs half the time of indexing.
        index = np.flatnonzero(index) if index.dtype == np.bool_ else index
        return Form(self.coef.take(index, axis=-1))

    @property
    def radius(self) -> Floats:
        """Upper bound (..., n) on the difference between a quantity and its polynomial."""
        radius: Floats = np.abs(self.coef[Z]) + self.coef[R]
        return radius

    @property
    def max_abs(self) -> Floats:
        """Upper bound (..., n) on the absolute value of each quantity."""
        max_abs: Floats = np.abs(self.coef).sum(axis=0)
        return max_abs

    def bounds(self) -> tuple[Floats, Floats]:
        """Bound each quantity by two numbers that are valid everywhere in its cell.

        Returns
        -------
        low, high : (..., n) float arrays
            A lower and an upper bound on each quantity.
        """
        coef, x2, y2 = self.coef, self.coef[XX], self.coef[YY]
        # All terms but these two may have either sign: X^2 and Y^2 are never negative.
        either_sign = np.abs(coef[[X, Y, XY, Z]]).sum(axis=0) + coef[R]
        low = coef[C] - either_sign + np.minimum(x2, 0) + np.minimum(y2, 0)
        high = coef[C] + either_sign + np.maximum(x2, 0) + np.maximum(y2, 0)
        return low, high

    def __add__(self, other: Form | Floats | float) -> Form:
        """Add other quantities of the same surfaces, or numbers.

        Each form contains an unknown Z from -1 to 1, which is the same for all quantities of one
        surface.  So the coefficients of Z are added.  Quantities of different surfaces have
        independent unknowns: see `difference_form`.

        Parameters
        ----------
        other : Form, or float array that broadcasts to (..., n)
            Enclosures of the quantities to add, or the numbers to add.

        Returns
        -------
        sum : Form
            Enclosures (8, ..., n) of the sums.
        """
        if isinstance(other, Form):
            return Form(self.coef + other.coef)
        coef = self.coef.copy()
        coef[C] += other
        coef[R] += ROUNDING * np.abs(other)
        return Form(coef)

    def __sub__(self, other: Form) -> Form:
        """Subtract other quantities of the same surfaces, which share the unknown Z."""
        return self + other * -1.0

    def __mul__(self, other: Form | Floats | float) -> Form:
        """Multiply by other quantities of the same surfaces, or by numbers.

        The product of two polynomials also has terms of degree three and four in X and Y, and
        products with the unknown Z, which a form cannot represent.  The largest absolute value of
        each such term is added to the radius (row R, the error bound).  A bound on the rounding
        errors is added, too.

        Parameters
        ----------
        other : Form, or float array that broadcasts to (..., n)
            Enclosures of the second factors, or numbers.

        Returns
        -------
        product : Form
            Enclosures (8, ..., n) of the products.
        """
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
        """Enclose the powers f(z) = z^exponent of the quantities z that these forms enclose.

        Two enclosures are computed, and the one with the smaller radius is returned:

        1.  Taylor's polynomial of degree 2 around the centre c of the interval [c - w, c + w] of z.
           Its remainder is at most |f'''| w^3 / 6.  The maximum of |f'''| is at one end of the
           interval, because f''' is monotonic.
        2.  If the remainder is large: a line parallel to the chord of f.  As f is convex or
           concave, it lies between the chord and the parallel tangent.  The line is at two thirds
           of the way from the chord to the tangent, where a parabola has its mean.

        Rounding: with e = 2^-53, the power and each coefficient have a relative error of a few e.
        They are multiplied by at most |f'| w, f'' w^2 < |f'| w, or f.

        Parameters
        ----------
        exponent : float, or (n,) float array
            The exponents, of either sign.
        minimum, maximum : float
            Bounds on z that are known independently of the forms; minimum is at least 0.  The
            interval of z is clipped to them.

        Returns
        -------
        power : Form
            Enclosures (8, n) of the powers.
        """
        low, high = (np.clip(end, minimum, maximum) for end in self.bounds())
        center, w = 0.5 * (low + high), 0.5 * (high - low)
        f_low, f_high, f = (_raise_to_power(z, exponent) for z in (low, high, center))
        first = exponent * f / center
        second = 0.5 * (exponent - 1) * first / center
        third = np.abs(exponent * (exponent - 1) * (exponent - 2)) / 6
        remainder = third * np.maximum(f_low / low**3, f_high / high**3) * w**3
        offset = self + -center
        result = offset * offset * second + offset * first + f
        result.coef[R] += remainder + ROUNDING * (np.maximum(f_low, f_high) + np.abs(first) * high)
        is_coarse = ~(remainder < np.abs(f_high - f_low) * _MAX_REMAINDER_RATIO)
        is_coarse = is_coarse & (w > _MIN_CHORD_WIDTH * center) | ~(remainder < np.inf)
        index = np.flatnonzero(is_coarse)
        low, high, f_low, f_high = (values[index] for values in (low, high, f_low, f_high))
        line = self[index]._power_by_line(
            np.broadcast_to(exponent, w.shape)[index], low, high, f_low, f_high
        )
        is_better = ~(result.coef[R, index] < line.coef[R])
        result.coef[:, index[is_better]] = line.coef[:, is_better]
        return result

    def _power_by_line(
        self, exponent: Floats, low: Floats, high: Floats, f_low: Floats, f_high: Floats
    ) -> Form:
        """Enclose powers z^exponent by a line parallel to the chord of the power function.

        The chord joins the powers at both ends of the interval [low, high] of z.  The line lies
        between the chord and the tangent with the same slope, at two thirds of the way from the
        chord.

        Parameters
        ----------
        exponent : (n,) float array
            The exponents.
        low, high : (n,) float arrays
            Lower and upper bounds on the quantities z.
        f_low, f_high : (n,) float arrays
            The powers of `low` and `high`.

        Returns
        -------
        line : Form
            Enclosures (8, n) of the powers, which are linear functions of the forms of z.
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

    def clamp_to_unit_interval(self) -> Form:
        """Replace each form that is much wider than the interval [0, 1] by this interval.

        Call this only for quantities that are certainly from 0 to 1, such as the cosines of angles
        below 90 degrees.

        Returns
        -------
        clamped : Form
            For each form, the form itself if the sum of its absolute coefficients is below 2.
            Otherwise, or if the sum is NaN, the constant 0.5 with an error bound of 0.5.
        """
        is_too_wide = ~(self.max_abs < 2)
        coef = np.where(is_too_wide, 0, self.coef)
        coef[C, is_too_wide] = coef[R, is_too_wide] = 0.5
        return Form(coef)

    def split_into_quarters(self) -> Form:
        """Convert each form of a cell to four forms, one for each quarter of the cell.

        In each quarter, the coordinates X and Y run from -1 to 1.  The absolute coefficient of the
        unknown Z is added to the radius (row R, the error bound).  Each new coefficient is a sum of
        at most six terms, so its rounding error is at most 6 * 2^-53 times the sum of their
        absolute values.  The radius includes this error.

        Returns
        -------
        quarters : Form
            Enclosures (8, ..., 4 n).  Each form is replaced by those of its four quarters in the
            order upper left, upper right, lower left, lower right.
        """
        c, x, y, xx, xy, yy, _, _ = self.coef.repeat(4, axis=-1)
        quarter = np.arange(c.shape[-1]) % 4
        a, b = (quarter & 1) - 0.5, (quarter >> 1) - 0.5  # X and Y of the quarter's centre
        radius = (self.radius + ROUNDING * self.max_abs).repeat(4, axis=-1)
        center = c + a * (x + a * xx + b * xy) + b * (y + b * yy)
        across, down = x / 2 + a * xx + b * xy / 2, y / 2 + b * yy + a * xy / 2
        return Form(np.array([center, across, down, xx / 4, xy / 4, yy / 4, 0 * c, radius]))


def _raise_to_power(z: Floats, exponent: Floats | float) -> Floats:
    """Compute z^exponent for positive z (n,), by square roots if the exponent is 0.5 or -0.5."""
    if isinstance(exponent, float) and abs(exponent) == 0.5:
        return np.sqrt(z) if exponent > 0 else 1 / np.sqrt(z)
    power: Floats = z**exponent
    return power


def constant_form(value: Floats, radius: Floats | float = 0.0) -> Form:
    """Enclose quantities that are nearly constant in a cell.

    Parameters
    ----------
    value : (..., n) float array
        The constants.
    radius : float, or array that broadcasts to (..., n)
        Upper bound on the difference between each quantity and its constant.

    Returns
    -------
    constant : Form
        Enclosures (8, ..., n): in row C the constants, in row R the radius, and zeros elsewhere.
    """
    coef = np.zeros((8, *value.shape))
    coef[C], coef[R] = value, radius
    return Form(coef)


def difference_form(form: Form, other: Form) -> Form:
    """Enclose differences between quantities of two different surfaces.

    A form encloses a quantity by a polynomial that contains an unknown Z from -1 to 1.  The
    unknowns of different surfaces are independent and do not cancel.  So the absolute coefficients
    of both are added to the radius of the difference (row R, the error bound).

    Parameters
    ----------
    form, other : Form
        Enclosures (8, n) of the minuends and of the subtrahends.

    Returns
    -------
    difference : Form
        Enclosures (8, n) of the differences, in which the coefficient of Z is 0.
    """
    coef = form.coef - other.coef
    coef[R], coef[Z] = form.radius + other.radius, 0
    return Form(coef)
