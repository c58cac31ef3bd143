"""Enclose functions on a cell of the picture by quadratic polynomials with an error bound.

The problem: the certificate must bound quantities, such as radiance, everywhere in a square cell of
the picture.  Interval arithmetic (Moore, 1966) encloses a quantity between two numbers.  But it
forgets that two quantities depend on the same position, so its bounds soon become useless.  Affine
arithmetic (Comba and Stolfi, 1993) keeps the linear dependence on the position.  This module also
keeps the quadratic dependence.

A cell has coordinates X and Y from -1 to 1.  An *enclosure* describes a quantity by eight
coefficients a: for some Z between -1 and 1, the quantity differs by at most a[ERROR] from

    a[CONSTANT] + a[X] X + a[Y] Y
        + a[X_SQUARED] X^2 + a[X_TIMES_Y] X Y + a[Y_SQUARED] Y^2 + a[UNKNOWN_Z] Z.

Z stands for the unknown part of the inverse distance of a surface.  All enclosures about one
surface share the same Z, so unknown parts that are linear in the distance cancel.  Enclosures about
different surfaces have different Z: see `Enclosures.subtract_independent`.

Why the result is right: some terms of a result cannot be represented, such as those of degree three
or four, and products with Z.  Their largest absolute values are added to a[ERROR], and so are
bounds on the rounding errors.

Rounding.  With e = 2^-53, an operation on floats errs by at most e times its result.  The rounding
error of a product of enclosures is less than 30 e times the sum of the absolute values of all its
terms.  `ROUNDING`, which is 900 e, times this sum is added to the error bound.  Nothing is added
for sums of enclosures, and for products with a number: at most four of these operations follow a
product, and what was added for the product covers them.
"""

from __future__ import annotations

import numpy as np

from reference.judges.arrays import Floats, Index

CONSTANT, X, Y, X_SQUARED, X_TIMES_Y, Y_SQUARED, UNKNOWN_Z, ERROR = range(8)
"""Rows of the array of an enclosure: coefficients of 1, X, Y, X^2, X Y, Y^2 and of the unknown Z,
then the error bound."""

ROUNDING = 1e-13
"""Bound on the rounding error of each term, relative to the term: about 900 roundings."""

# If the remainder of a power's Taylor polynomial is more than this fraction of the power's range, a
# line parallel to the chord is tried instead.
_MAX_REMAINDER_RATIO = 1 / 16

# If the ratio of an interval's half width to its centre is smaller, rounding errors spoil the slope
# of the chord, and the Taylor polynomial is always accurate enough.
_MIN_CHORD_WIDTH = 1e-6


class Enclosures:
    """n quantities, each enclosed in one cell by a quadratic polynomial with an error bound.

    X and Y are the coordinates in the cell, from -1 to 1.  Z is an unknown number from -1 to 1, the
    same in all enclosures about one surface.  A quantity with the coefficients a differs by at most
    a[ERROR] from

        a[CONSTANT] + a[X] X + a[Y] Y
            + a[X_SQUARED] X^2 + a[X_TIMES_Y] X Y + a[Y_SQUARED] Y^2 + a[UNKNOWN_Z] Z.

    Attributes
    ----------
    coefficients : (8, n) float array, or (8, 3, n) for the three channels of radiance
        Rows 0 to 6 hold the coefficients of 1, X, Y, X^2, X Y, Y^2 and Z.  Row 7 (ERROR) holds the
        error bound, which is at least 0.
    """

    __slots__ = ("coefficients",)

    def __init__(self, coefficients: Floats) -> None:
        """Store the array of coefficients (8, ..., n), without copying it."""
        self.coefficients = coefficients

    def __getitem__(self, index: Index) -> Enclosures:
        """Copy the enclosures selected along the last axis by indices (k,) or a mask (n,)."""
        # `take` is twice as fast as indexing.
        index = np.flatnonzero(index) if index.dtype == np.bool_ else index
        return Enclosures(self.coefficients.take(index, axis=-1))

    def __setitem__(self, index: Index, enclosures: Enclosures) -> None:
        """Replace the enclosures at the given indices (k,) along the last axis."""
        self.coefficients[..., index] = enclosures.coefficients

    def widen(self, error: Floats) -> None:
        """Add an error (..., n) of at least 0 to each error bound."""
        self.coefficients[ERROR] += error

    @property
    def max_deviation(self) -> Floats:
        """Upper bound (..., n) on the deviation of each quantity from its polynomial in X and Y."""
        return np.asarray(np.abs(self.coefficients[UNKNOWN_Z]) + self.coefficients[ERROR])

    @property
    def max_abs(self) -> Floats:
        """Upper bound (..., n) on the absolute value of each quantity."""
        return np.asarray(np.abs(self.coefficients).sum(axis=0))

    @property
    def relative_width(self) -> Floats:
        """Estimated width (n,) of the strip of the cell in which each quantity may be zero."""
        abs_coef = np.abs(self.coefficients)
        return np.asarray(abs_coef[X_SQUARED:].sum(axis=0) / np.maximum(abs_coef[X], abs_coef[Y]))

    def find_bounds(self) -> tuple[Floats, Floats]:
        """Compute a lower and an upper bound on each quantity over its cell.

        Returns
        -------
        low, high : (..., n) float arrays
            The lower and the upper bounds.
        """
        constant, coef_x, coef_y, coef_xx, coef_xy, coef_yy, coef_z, error = self.coefficients
        # The terms with X^2 and Y^2 have the signs of their coefficients; the others, either sign.
        spread = np.abs([coef_x, coef_y, coef_xy, coef_z]).sum(axis=0) + error
        low = constant - spread + np.minimum(coef_xx, 0) + np.minimum(coef_yy, 0)
        high = constant + spread + np.maximum(coef_xx, 0) + np.maximum(coef_yy, 0)
        return low, high

    def __add__(self, other: Enclosures | Floats | float) -> Enclosures:
        """Add numbers, or enclosures with the same unknown Z.

        An enclosure is a polynomial in X, Y and an unknown number Z, with an error bound.  Two
        quantities have the same Z if they describe the same surface.  For quantities with
        different Z, use `subtract_independent`.

        Parameters
        ----------
        other : Enclosures, or float array that broadcasts to (..., n)
            The enclosures or numbers to add.

        Returns
        -------
        sum : Enclosures
            Enclosures (8, ..., n) of the sums.
        """
        if isinstance(other, Enclosures):
            return Enclosures(self.coefficients + other.coefficients)
        coefficients = self.coefficients.copy()
        coefficients[CONSTANT] += other
        coefficients[ERROR] += ROUNDING * np.abs(other)
        return Enclosures(coefficients)

    def __sub__(self, other: Enclosures) -> Enclosures:
        """Subtract enclosures with the same unknown Z."""
        return self + other * -1.0

    def subtract_independent(self, other: Enclosures) -> Enclosures:
        """Subtract enclosures with a different unknown Z.

        An enclosure is a polynomial in X, Y and an unknown number Z, with an error bound.  Two
        quantities that describe different surfaces have different Z, so their terms with Z do not
        cancel.  The absolute values of the coefficients of Z are added to the error bound instead.

        Parameters
        ----------
        other : Enclosures
            The enclosures (8, n) to subtract.

        Returns
        -------
        difference : Enclosures
            Enclosures (8, n) of the differences, without Z.
        """
        coefficients = self.coefficients - other.coefficients
        coefficients[ERROR], coefficients[UNKNOWN_Z] = self.max_deviation + other.max_deviation, 0
        return Enclosures(coefficients)

    def __mul__(self, other: Enclosures | Floats | float) -> Enclosures:
        """Multiply by numbers, or by enclosures with the same unknown Z.

        An enclosure is a polynomial in X, Y and an unknown number Z, with an error bound.  A
        product also has terms that an enclosure cannot represent, such as X^3 and X Z.  Their
        largest absolute values, for X, Y and Z from -1 to 1, are added to the error bound.

        Parameters
        ----------
        other : Enclosures, or float array that broadcasts to (..., n)
            The numbers or enclosures to multiply by.

        Returns
        -------
        product : Enclosures
            Enclosures (8, ..., n) of the products.
        """
        if not isinstance(other, Enclosures):
            coefficients = self.coefficients * other
            coefficients[ERROR] = np.abs(coefficients[ERROR])
            return Enclosures(coefficients)
        a, b = self.coefficients, other.coefficients
        coefficients = b * a[CONSTANT]
        coefficients += a * b[CONSTANT]
        coefficients[CONSTANT] = a[CONSTANT] * b[CONSTANT]
        coefficients[X_SQUARED] += a[X] * b[X]
        coefficients[X_TIMES_Y] += a[X] * b[Y] + a[Y] * b[X]
        coefficients[Y_SQUARED] += a[Y] * b[Y]
        # The error bound covers all other products of two terms with X, Y or Z.  The polynomial `a`
        # differs from its constant by at most `a_spread`, and from 0 by at most `a_max`.
        a, b = np.abs(a), np.abs(b)
        a_spread, b_spread = a[X:ERROR].sum(axis=0), b[X:ERROR].sum(axis=0)
        a_max, b_max = a[CONSTANT] + a_spread, b[CONSTANT] + b_spread
        coefficients[ERROR] = a_spread * b_spread - (a[X] + a[Y]) * (b[X] + b[Y])
        coefficients[ERROR] += a[ERROR] * (b_max + b[ERROR]) + b[ERROR] * a_max
        coefficients[ERROR] += ROUNDING * a_max * b_max
        return Enclosures(coefficients)

    def power(
        self, exponent: Floats | float, min_z: float = 0.0, max_z: float = np.inf
    ) -> Enclosures:
        """Enclose the powers f(z) = z^exponent of the enclosed quantities z.

        The function f is enclosed by its Taylor polynomial of degree 2.  If the remainder is
        large, a line parallel to the chord of f is also tried, and the smaller error decides.

        Parameters
        ----------
        exponent : float, or (n,) float array
            The exponents, of either sign.
        min_z, max_z : float
            Bounds that are known to hold for all z.  Both are at least 0.

        Returns
        -------
        power : Enclosures
            Enclosures (8, n) of the powers.
        """
        low, high = (np.clip(end, min_z, max_z) for end in self.find_bounds())
        center, half_width = 0.5 * (low + high), 0.5 * (high - low)
        f_low, f_high, f_center = (_raise_to_power(z, exponent) for z in (low, high, center))
        # The Taylor polynomial is expanded around the centre.  The absolute value of the third
        # derivative of f is 6 * cubic_coef * f / z^3, whose maximum is at one end of the interval.
        linear_coef = exponent * f_center / center
        quadratic_coef = 0.5 * (exponent - 1) * linear_coef / center
        cubic_coef = np.abs(exponent * (exponent - 1) * (exponent - 2)) / 6
        remainder = cubic_coef * np.maximum(f_low / low**3, f_high / high**3) * half_width**3
        z_offset = self + -center
        polynomial = z_offset * z_offset * quadratic_coef + z_offset * linear_coef + f_center
        # The power and all coefficients have relative errors of a few times 2^-53.
        rounding_error = ROUNDING * (np.maximum(f_low, f_high) + np.abs(linear_coef) * high)
        polynomial.widen(remainder + rounding_error)
        is_coarse = ~(remainder < np.abs(f_high - f_low) * _MAX_REMAINDER_RATIO)
        is_coarse = is_coarse & (half_width > _MIN_CHORD_WIDTH * center) | ~(remainder < np.inf)
        coarse_index = np.flatnonzero(is_coarse)
        low, high, f_low, f_high = (values[coarse_index] for values in (low, high, f_low, f_high))
        exponents = np.broadcast_to(exponent, half_width.shape)[coarse_index]
        line = self[coarse_index]._enclose_power_by_line(exponents, low, high, f_low, f_high)
        is_line_better = ~(polynomial.coefficients[ERROR, coarse_index] < line.coefficients[ERROR])
        polynomial[coarse_index[is_line_better]] = line[is_line_better]
        return polynomial

    def _enclose_power_by_line(
        self, exponent: Floats, low: Floats, high: Floats, f_low: Floats, f_high: Floats
    ) -> Enclosures:
        """Enclose z^exponent by a linear function of z, for each enclosed quantity z.

        The graph of f(z) = z^exponent lies between its chord and the parallel tangent.  The linear
        function is two thirds of the way from the chord to the tangent, like a parabola's mean.

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
        line : Enclosures
            Enclosures (8, n) of the powers.
        """
        slope = np.where(high > low, (f_high - f_low) / (high - low), 0)
        tangent_z = (slope / exponent) ** (1 / (exponent - 1))
        tangent_z = np.where(np.isfinite(tangent_z), tangent_z, 0.5 * (low + high)).clip(low, high)
        # The heights of both lines at z = 0.
        chord_at_0, tangent_at_0 = f_low - slope * low, tangent_z**exponent - slope * tangent_z
        line = self * slope
        line.coefficients[CONSTANT] += (chord_at_0 + 2 * tangent_at_0) / 3
        line.widen(np.abs(chord_at_0 - tangent_at_0) * (2 / 3))
        line.widen(ROUNDING * (np.maximum(f_low, f_high) + np.abs(slope) * high))
        return line

    def fall_back_to_unit_interval(self) -> Enclosures:
        """Replace every wide enclosure with the interval [0, 1].

        Use this only for quantities that certainly lie in [0, 1], such as the cosines of acute
        angles.

        Returns
        -------
        enclosures : Enclosures
            The constant 0.5 with an error bound of 0.5, where the absolute values of all eight
            coefficients add up to 2 or more, or to NaN.  Other enclosures are unchanged.
        """
        is_too_wide = ~(self.max_abs < 2)
        coefficients = np.where(is_too_wide, 0, self.coefficients)
        coefficients[CONSTANT, is_too_wide] = coefficients[ERROR, is_too_wide] = 0.5
        return Enclosures(coefficients)

    def split_into_quarters(self) -> Enclosures:
        """Express each enclosure in the coordinates of each quarter of its cell.

        In each quarter, X and Y run from -1 to 1.  The term with Z, an unknown number from -1 to 1,
        is dropped, and the absolute value of its coefficient is added to the error bound.

        Returns
        -------
        quarters : Enclosures
            Enclosures with coefficients (8, ..., 4 n).  The quarters of each cell are adjacent, in
            the order upper left, upper right, lower left, lower right.
        """
        constant, coef_x, coef_y, coef_xx, coef_xy, coef_yy, *_ = self.coefficients.repeat(4, -1)
        quarter_index = np.arange(constant.shape[-1]) % 4
        # The quarter's centre, in the coordinates of the cell.
        center_x, center_y = (quarter_index & 1) - 0.5, (quarter_index >> 1) - 0.5
        # Each new coefficient is a sum of at most six terms.  ROUNDING covers its rounding error.
        error_bound = (self.max_deviation + ROUNDING * self.max_abs).repeat(4, axis=-1)
        new_constant = constant + center_x * (coef_x + center_x * coef_xx + center_y * coef_xy)
        new_constant = new_constant + center_y * (coef_y + center_y * coef_yy)
        slope_x = coef_x / 2 + center_x * coef_xx + center_y * coef_xy / 2
        slope_y = coef_y / 2 + center_y * coef_yy + center_x * coef_xy / 2
        quadratic_coefs = np.divide([coef_xx, coef_xy, coef_yy], 4)
        coefficients = new_constant, slope_x, slope_y, *quadratic_coefs, 0 * constant, error_bound
        return Enclosures(np.array(coefficients))


def _raise_to_power(z: Floats, exponent: Floats | float) -> Floats:
    """Compute z^exponent for non-negative z (n,).  The exponent is a number, or an array (n,)."""
    # A square root is faster than a power.
    if isinstance(exponent, float) and exponent == -0.5:
        return np.asarray(1 / np.sqrt(z))
    return np.asarray(z**exponent)


def enclose_constants(constants: Floats, max_deviation: Floats | float = 0.0) -> Enclosures:
    """Enclose quantities that are nearly constant in their cell.

    Parameters
    ----------
    constants : (..., n) float array
        One constant for each quantity.
    max_deviation : float, or array that broadcasts to (..., n)
        Upper bound on the difference between each quantity and its constant.

    Returns
    -------
    enclosures : Enclosures
        Enclosures (8, ..., n) with the constants in row 0 (CONSTANT), the maximum deviations in row
        7 (ERROR), and zeros in all other rows.
    """
    coefficients = np.zeros((8, *constants.shape))
    coefficients[CONSTANT], coefficients[ERROR] = constants, max_deviation
    return Enclosures(coefficients)
