"""Bound functions on a cell of the picture by quadratic polynomials with an error bound.

The certificate (see `certificate`) must bound quantities, such as radiance, everywhere in a square
cell of the picture.  Interval arithmetic (Moore, 1966) encloses a quantity between two numbers.
But it forgets that two quantities depend on the same position, so its bounds soon become useless.
Affine arithmetic (Comba and Stolfi, 1993) keeps the linear dependence on the position.  This module
also keeps the quadratic dependence.

A cell has coordinates X and Y from -1 to 1.  An *enclosure* describes a quantity by eight
coefficients a.  At each point of the cell, for some Z between -1 and 1, the quantity differs by at
most a[ERROR] from

    a[CONSTANT] + a[X] X + a[Y] Y
        + a[X_SQUARED] X^2 + a[X_TIMES_Y] X Y + a[Y_SQUARED] Y^2 + a[UNKNOWN_Z] Z.

Z stands for the unknown part of the inverse distance of a surface.  All enclosures about one
surface share the same Z, so unknown parts that are linear in the distance cancel.  Enclosures about
different surfaces have different Z: see `Enclosures.subtract_independent`.

A product of enclosures has terms of degree three or four, and products with Z, which have no
coefficient.  Their largest absolute values are added to a[ERROR], and so are bounds on the rounding
errors.

Rounding.  With e = 2^-53, an operation on floats errs by at most e times its result.  The rounding
error of a product of enclosures is less than 30 e times the sum of the absolute values of all its
terms.  `ROUNDING`, which is 900 e, times this sum is added to the error bound.  Nothing is added
for sums of enclosures, and for products with a number.  At most four of these operations follow a
product, and what was added for the product covers them.
"""

from __future__ import annotations

from typing import Annotated as Shaped
from typing import NamedTuple

import numpy as np

from reference.judges.arrays import Bools, Floats, Index, Ints

CONSTANT, X, Y, X_SQUARED, X_TIMES_Y, Y_SQUARED, UNKNOWN_Z, ERROR = range(8)
"""Rows of the array of an enclosure: coefficients of 1, X, Y, X^2, X Y, Y^2 and of the unknown Z,
then the error bound."""

ROUNDING = 1e-13
"""Bound on the rounding error of each term, relative to the term: about 900 roundings."""

# If the remainder of a power's Taylor polynomial is more than this fraction of the power's range, a
# line parallel to the chord is tried, too.
_MAX_REMAINDER_RATIO = 1 / 16

# If the ratio of an interval's half width to its centre is smaller, rounding errors spoil the slope
# of the chord, and the Taylor polynomial is always accurate enough.
_MIN_CHORD_WIDTH = 1e-6


class _Powers(NamedTuple):
    """What is known of n quantities z >= 0 whose powers f(z) = z^exponent are to be enclosed."""

    exponent: Shaped[Floats, "n"]
    low: Shaped[Floats, "n"]  # lower bound on z
    high: Shaped[Floats, "n"]  # upper bound on z
    f_low: Shaped[Floats, "n"]  # f(low)
    f_high: Shaped[Floats, "n"]  # f(high)

    @property
    def center(self) -> Shaped[Floats, "n"]:
        return 0.5 * (self.low + self.high)

    @property
    def half_width(self) -> Shaped[Floats, "n"]:
        return 0.5 * (self.high - self.low)

    def take(self, index: Shaped[Ints, "k"]) -> _Powers:
        return _Powers._make(field[index] for field in self)


class Enclosures:
    """Quantities, each enclosed in one cell by a quadratic polynomial with an error bound."""

    __slots__ = ("coefficients",)

    # Coefficients by `CONSTANT` to `ERROR`, of shape (8, n), or (8, 3, n) for three channels of
    # radiance.  The error bound is at least 0.
    coefficients: Shaped[Floats, "8 ... n"]

    def __init__(self, coefficients: Shaped[Floats, "8 ... n"]) -> None:
        """Store an array of coefficients, without copying it."""
        self.coefficients = coefficients

    def __getitem__(self, index: Shaped[Index, "k"]) -> Enclosures:
        """Copy the enclosures that are selected along the last axis."""
        # `take` is twice as fast as indexing.
        index = np.flatnonzero(index) if index.dtype == np.bool_ else index
        return Enclosures(self.coefficients.take(index, axis=-1))

    def __setitem__(self, index: Shaped[Index, "k"], enclosures: Enclosures) -> None:
        """Replace the enclosures that are selected along the last axis."""
        self.coefficients[..., index] = enclosures.coefficients

    def widen(self, error: Shaped[Floats, "..."]) -> None:
        """Increase each error bound in place; no `error` may be negative."""
        self.coefficients[ERROR] += error

    @property
    def max_deviation(self) -> Shaped[Floats, "... n"]:
        """Upper bound on the deviation of each quantity from its polynomial in X and Y."""
        return np.asarray(np.abs(self.coefficients[UNKNOWN_Z]) + self.coefficients[ERROR])

    @property
    def max_abs(self) -> Shaped[Floats, "... n"]:
        """Upper bound on the absolute value of each quantity."""
        return np.asarray(np.abs(self.coefficients).sum(axis=0))

    @property
    def relative_width(self) -> Shaped[Floats, "n"]:
        """Estimated width of the part of the cell in which each quantity may be zero.

        It is the sum of the absolute values of all terms that are not linear in X or Y, divided by
        the slope.  The unit is half the width of the cell.
        """
        sizes = np.abs(self.coefficients)
        return np.asarray(sizes[X_SQUARED:].sum(axis=0) / np.maximum(sizes[X], sizes[Y]))

    def find_bounds(self) -> tuple[Shaped[Floats, "... n"], Shaped[Floats, "... n"]]:
        """Compute a lower and an upper bound on each quantity over its cell."""
        constant, coef_x, coef_y, coef_xx, coef_xy, coef_yy, coef_z, error = self.coefficients
        # X^2 and Y^2 are between 0 and 1.  X, Y, X Y and Z are between -1 and 1.
        spread = np.abs([coef_x, coef_y, coef_xy, coef_z]).sum(axis=0) + error
        low = constant - spread + np.minimum(coef_xx, 0) + np.minimum(coef_yy, 0)
        high = constant + spread + np.maximum(coef_xx, 0) + np.maximum(coef_yy, 0)
        return low, high

    def __add__(self, other: Enclosures | Shaped[Floats, "..."] | float) -> Enclosures:
        """Add numbers, or enclosures that share the unknown Z of `self`."""
        if isinstance(other, Enclosures):
            return Enclosures(self.coefficients + other.coefficients)
        coefficients = self.coefficients.copy()
        coefficients[CONSTANT] += other
        coefficients[ERROR] += ROUNDING * np.abs(other)
        return Enclosures(coefficients)

    def __sub__(self, other: Enclosures) -> Enclosures:
        """Subtract enclosures that share the unknown Z of `self`."""
        return self + other * -1.0

    def subtract_independent(self, other: Enclosures) -> Enclosures:
        """Subtract enclosures whose unknown Z differs from that of `self`.

        Terms with different Z do not cancel.  So the differences have no term with Z.  Instead, the
        absolute values of both coefficients of Z are added to the error bound.
        """
        coefficients = self.coefficients - other.coefficients
        coefficients[ERROR] = self.max_deviation + other.max_deviation
        coefficients[UNKNOWN_Z] = 0
        return Enclosures(coefficients)

    def __mul__(self, other: Enclosures | Shaped[Floats, "..."] | float) -> Enclosures:
        """Multiply by numbers, or by enclosures that share the unknown Z of `self`."""
        if not isinstance(other, Enclosures):
            coefficients = self.coefficients * other
            coefficients[ERROR] = np.abs(coefficients[ERROR])
            return Enclosures(coefficients)
        a, b = self.coefficients, other.coefficients
        # Coefficients of the product of the polynomials.
        coefficients = b * a[CONSTANT]
        coefficients += a * b[CONSTANT]
        coefficients[CONSTANT] = a[CONSTANT] * b[CONSTANT]
        coefficients[X_SQUARED] += a[X] * b[X]
        coefficients[X_TIMES_Y] += a[X] * b[Y] + a[Y] * b[X]
        coefficients[Y_SQUARED] += a[Y] * b[Y]
        # For X, Y and Z from -1 to 1, the polynomial of `self` differs from its constant by at most
        # `a_spread`, and from 0 by at most `a_max`.
        a_sizes = np.abs(a)
        b_sizes = np.abs(b)
        a_spread = a_sizes[X:ERROR].sum(axis=0)
        b_spread = b_sizes[X:ERROR].sum(axis=0)
        a_max = a_sizes[CONSTANT] + a_spread
        b_max = b_sizes[CONSTANT] + b_spread
        # Products of two linear terms with X or Y have coefficients above.  No other product of two
        # terms that are not constant has one.
        linear_product = (a_sizes[X] + a_sizes[Y]) * (b_sizes[X] + b_sizes[Y])
        coefficients[ERROR] = a_spread * b_spread - linear_product
        # Products of error bounds with each other and with polynomials.
        coefficients[ERROR] += a[ERROR] * (b_max + b[ERROR]) + b[ERROR] * a_max
        coefficients[ERROR] += ROUNDING * a_max * b_max
        return Enclosures(coefficients)

    def power(
        self,
        exponent: Shaped[Floats, "n"] | float,
        min_z: float = 0.0,
        max_z: float = np.inf,
    ) -> Enclosures:
        """Enclose the powers f(z) = z^exponent of the enclosed quantities z.

        All z are known to lie between `min_z` and `max_z`, which are at least 0.  The exponent may
        have either sign.  The function f is enclosed by its Taylor polynomial of degree 2 or, if
        that has a smaller error bound, by a line parallel to its chord.
        """
        low, high = (np.clip(end, min_z, max_z) for end in self.find_bounds())
        powers = _Powers(
            exponent=np.broadcast_to(exponent, low.shape),
            low=low,
            high=high,
            f_low=_raise_to_power(low, exponent),
            f_high=_raise_to_power(high, exponent),
        )
        f_center = _raise_to_power(powers.center, exponent)
        remainder = _bound_taylor_remainder(powers)
        result = self._enclose_power_by_taylor_polynomial(powers, f_center, remainder)
        # To save time, try the line only where it may be better.
        coarse_index = np.flatnonzero(_is_taylor_polynomial_coarse(powers, remainder))
        line = self[coarse_index]._enclose_power_by_line(powers.take(coarse_index))
        is_line_better = ~(result.coefficients[ERROR, coarse_index] < line.coefficients[ERROR])
        result[coarse_index[is_line_better]] = line[is_line_better]
        return result

    def _enclose_power_by_taylor_polynomial(
        self, powers: _Powers, f_center: Shaped[Floats, "n"], remainder: Shaped[Floats, "n"]
    ) -> Enclosures:
        """Enclose the power of each quantity z by a quadratic function of z.

        The function is the Taylor polynomial of degree 2 at the centre of the interval of z.

        Parameters
        ----------
        powers
            Intervals and exponents of the quantities that `self` encloses.
        f_center
            Powers of the centres of the intervals.
        remainder
            Upper bounds on the difference between a power and its polynomial.
        """
        # f'(z) = exponent f(z) / z, and f''(z) / 2 = (exponent - 1) f'(z) / (2 z).
        center = powers.center
        linear_coef = powers.exponent * f_center / center
        quadratic_coef = 0.5 * (powers.exponent - 1) * linear_coef / center
        z_offset = self + -center
        polynomial = z_offset * z_offset * quadratic_coef + z_offset * linear_coef + f_center
        # The power and all coefficients have relative errors of a few times 2^-53.
        max_power = np.maximum(powers.f_low, powers.f_high)
        rounding_error = ROUNDING * (max_power + np.abs(linear_coef) * powers.high)
        polynomial.widen(remainder + rounding_error)
        return polynomial

    def _enclose_power_by_line(self, powers: _Powers) -> Enclosures:
        """Enclose the power of each quantity z by a linear function of z.

        `powers` has the intervals and exponents of the quantities that `self` encloses.  The graph
        of f(z) = z^exponent lies between its chord and the parallel tangent.  The linear function
        is two thirds of the way from the chord to the tangent, where the mean of a parabola would
        be.
        """
        exponent, low, high, f_low, f_high = powers
        slope = np.where(high > low, (f_high - f_low) / (high - low), 0)
        # The tangent touches the graph where f'(z) = exponent z^(exponent - 1) is the slope.
        tangent_z = (slope / exponent) ** (1 / (exponent - 1))
        tangent_z = np.where(np.isfinite(tangent_z), tangent_z, powers.center).clip(low, high)
        # The heights of both lines at z = 0.
        chord_at_0 = f_low - slope * low
        tangent_at_0 = tangent_z**exponent - slope * tangent_z
        line = self * slope
        line.coefficients[CONSTANT] += (chord_at_0 + 2 * tangent_at_0) / 3
        line.widen(np.abs(chord_at_0 - tangent_at_0) * (2 / 3))
        line.widen(ROUNDING * (np.maximum(f_low, f_high) + np.abs(slope) * high))
        return line

    def fall_back_to_unit_interval(self) -> Enclosures:
        """Return a copy in which the interval [0, 1] replaces every wide enclosure.

        All quantities must certainly lie in [0, 1], like the cosines of acute angles.  An enclosure
        is wide if the absolute values of its coefficients add up to 2 or more, or to NaN.
        """
        is_too_wide = ~(self.max_abs < 2)
        coefficients = np.where(is_too_wide, 0, self.coefficients)
        coefficients[CONSTANT, is_too_wide] = coefficients[ERROR, is_too_wide] = 0.5
        return Enclosures(coefficients)

    def split_into_quarters(self) -> Enclosures:
        """Express each enclosure in the coordinates of each quarter of its cell.

        Each enclosure becomes four adjacent ones: upper left, upper right, lower left, lower right.
        They have no term with Z.  Instead, the absolute value of its coefficient is added to the
        error bound.
        """
        constant, coef_x, coef_y, coef_xx, coef_xy, coef_yy, *_ = self.coefficients.repeat(4, -1)
        quarter_index = np.arange(constant.shape[-1]) % 4
        # The quarter's centre, in the coordinates of the cell.  The point (X, Y) of the quarter is
        # the point (center_x + X / 2, center_y + Y / 2) of the cell.
        center_x = (quarter_index & 1) - 0.5
        center_y = (quarter_index >> 1) - 0.5
        # Each new coefficient is a sum of at most six terms.  ROUNDING covers its rounding error.
        error_bound = (self.max_deviation + ROUNDING * self.max_abs).repeat(4, axis=-1)
        new_constant = constant + center_x * (coef_x + center_x * coef_xx + center_y * coef_xy)
        new_constant = new_constant + center_y * (coef_y + center_y * coef_yy)
        slope_x = coef_x / 2 + center_x * coef_xx + center_y * coef_xy / 2
        slope_y = coef_y / 2 + center_y * coef_yy + center_x * coef_xy / 2
        quadratic_coefs = np.divide([coef_xx, coef_xy, coef_yy], 4)
        coefficients = new_constant, slope_x, slope_y, *quadratic_coefs, 0 * constant, error_bound
        return Enclosures(np.array(coefficients))


def _bound_taylor_remainder(powers: _Powers) -> Shaped[Floats, "n"]:
    """Bound the difference between each power and its Taylor polynomial of degree 2.

    The polynomial is expanded at the centre of the interval of z.
    """
    exponent, low, high, f_low, f_high = powers
    # The remainder is the third derivative of f at some z, divided by 6, times the cube of the
    # distance from the centre.  The absolute value of the derivative is 6 cubic_coef f(z) / z^3,
    # whose maximum is at one end of the interval.
    cubic_coef = np.abs(exponent * (exponent - 1) * (exponent - 2)) / 6
    return cubic_coef * np.maximum(f_low / low**3, f_high / high**3) * powers.half_width**3


def _is_taylor_polynomial_coarse(
    powers: _Powers, remainder: Shaped[Floats, "n"]
) -> Shaped[Bools, "n"]:
    """Test for which powers a line may have a smaller error bound than the Taylor polynomial.

    `remainder` is an upper bound on the difference between a power and its polynomial.  If it is
    infinite or NaN, the result is True.
    """
    power_range = np.abs(powers.f_high - powers.f_low)
    is_coarse = ~(remainder < power_range * _MAX_REMAINDER_RATIO)
    is_wide = powers.half_width > _MIN_CHORD_WIDTH * powers.center
    return np.asarray(is_coarse & is_wide | ~(remainder < np.inf))


def _raise_to_power(
    z: Shaped[Floats, "n"], exponent: Shaped[Floats, "n"] | float
) -> Shaped[Floats, "n"]:
    """Compute z^exponent, where no z is negative."""
    # A square root is faster than a power.
    if isinstance(exponent, float) and exponent == -0.5:
        return np.asarray(1 / np.sqrt(z))
    return np.asarray(z**exponent)


def enclose_constants(
    constants: Shaped[Floats, "... n"], max_deviation: Shaped[Floats, "..."] | float = 0.0
) -> Enclosures:
    """Make enclosures (8, ...) of quantities that differ from constants by a bounded amount.

    `max_deviation` is one bound for all, or a bound for each constant.
    """
    coefficients = np.zeros((8, *constants.shape))
    coefficients[CONSTANT] = constants
    coefficients[ERROR] = max_deviation
    return Enclosures(coefficients)
