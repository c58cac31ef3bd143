"""Locate edges in cells: enclose each edge in a strip, and divide the cell along the strips.

An edge of the picture is the zero of an *edge function*, which a quadratic polynomial with an error
bound encloses (see `enclosures`).  Two ideas make areas computable:

strip
    The part of a cell between two parallel lines, which certainly contains the edge.
region
    A convex part of a cell.  The centre lines of all strips in a cell divide it into regions.
    Outside the strips, a region contains no point of an edge.

A cell has coordinates X and Y from -1 to 1, so its area is 4; areas here are fractions of it.

The tracer's antialiasing divides cells in a similar way.  This module repeats the method on
purpose: a reference that shares code with what it validates would repeat its errors.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from reference.judges.arrays import Bools, Floats, Index, Ints, sum_by_index
from reference.judges.enclosures import X_SQUARED, Enclosures

# Minimum area of a region, as a fraction of its cell.  Smaller areas are mostly rounding error.
_MIN_AREA = 1e-12


class Strips(NamedTuple):
    """Strips (n,) in cells of the picture, each of which contains an edge, sorted by cell.

    A strip is the part of a cell near a line a X + b Y + c = 0 with |a| + |b| = 1.  A cell has
    coordinates X and Y from -1 to 1.

    Attributes
    ----------
    cell_index : (n,) int array
        Index of the cell that each strip crosses.
    a, b, c : (n,) float arrays
        Coefficients of the strip's centre line.
    half_width : (n,) float array
        A point is in the strip if |a X + b Y + c| is at most this.
    jump : (n,) float array
        Upper bound on the change of radiance across the edge, in any channel.
    """

    cell_index: Ints
    a: Floats
    b: Floats
    c: Floats
    half_width: Floats
    jump: Floats

    def take(self, index: Index) -> Strips:
        """Copy the strips selected by indices (k,) or a mask (n,)."""
        return Strips._make(field[index] for field in self)

    @property
    def area(self) -> Floats:
        """Upper bound (n,) on the fraction of its cell that each strip covers."""
        max_slope = np.maximum(np.abs(self.a), np.abs(self.b))
        return np.asarray(np.fmin(self.half_width / max_slope, 1))


def _take_newton_step(coefficients: Floats) -> tuple[Floats, Floats]:
    """Take one Newton step from the cell's centre towards a zero of each polynomial.

    The step is shortened if it would leave the cell.

    Parameters
    ----------
    coefficients : (8, n) float array
        Coefficients of polynomials in X and Y, which run from -1 to 1 in the cell.  Only rows 0 to
        2, the coefficients of 1, X and Y, are used.

    Returns
    -------
    x, y : (n,) float arrays
        The points, with coordinates from -1 to 1; (0, 0) where the gradient is 0.
    """
    value, slope_x, slope_y = coefficients[:X_SQUARED]
    max_scale = 1 / np.maximum(np.abs(slope_x), np.abs(slope_y))
    scale = np.clip(-value / (slope_x**2 + slope_y**2), -max_scale, max_scale)
    scale = np.nan_to_num(scale, posinf=0, neginf=0)
    return scale * slope_x, scale * slope_y


def enclose_in_strips(cell_index: Ints, functions: Enclosures, jump: Floats) -> Strips:
    """Enclose the zeros of each edge function in a strip between two parallel lines.

    The strip is perpendicular to the function's gradient at a point near the zero.  It is wide
    enough to allow for the error bound and the curvature of the function.

    Parameters
    ----------
    cell_index : (n,) int array
        Index of the cell of each edge function.
    functions : Enclosures
        The edge functions, enclosed by polynomials (8, n) in the cell's coordinates X and Y.
    jump : (n,) float array
        Upper bound on the change of radiance across the edge.

    Returns
    -------
    strips : Strips
        Strips that contain all zeros, sorted by cell.  An edge function without a zero in its cell
        may get no strip.
    """
    constant, coef_x, coef_y, coef_xx, coef_xy, coef_yy, *_ = functions.coefficients
    # Compute the value and the gradient (a, b) at a point (x, y).  The closer the point is to a
    # zero, the narrower is the strip.
    x, y = _take_newton_step(functions.coefficients)
    value = constant + coef_x * x + coef_y * y
    value = value + coef_xx * x * x + coef_xy * x * y + coef_yy * y * y
    a = coef_x + 2 * coef_xx * x + coef_xy * y
    b = coef_y + coef_xy * x + 2 * coef_yy * y
    slope = np.hypot(a, b)
    p, q = a / slope, b / slope
    # Relative to the point (x, y), let n be the coordinate along the gradient (p, q), and t the one
    # along (-q, p).  With the second derivatives f_tt, f_tn and f_nn, the function is
    #     value + slope n + f_tn t n + f_nn n^2 / 2 + f_tt t^2 / 2.
    f_tt = 2 * (coef_xx * q * q - coef_xy * p * q + coef_yy * p * p)
    f_tn = 2 * (coef_yy - coef_xx) * p * q + coef_xy * (p * p - q * q)
    f_nn = 2 * (coef_xx * p * p + coef_xy * p * q + coef_yy * q * q)
    half_extent = np.abs(p) + np.abs(q)  # half the extent of the cell, along t and along n
    max_t, max_n = half_extent + np.abs(p * y - q * x), half_extent + np.abs(p * x + q * y)
    # The second to fourth terms are slope n (1 + e) with |e| <= max_e.
    max_e = (np.abs(f_tn) * max_t + 0.5 * np.abs(f_nn) * max_n) / slope
    # The last term differs from f_tt max_t^2 / 6 by at most |f_tt| max_t^2 / 3.
    value += f_tt * max_t * max_t / 6
    deviation = np.abs(f_tt) * max_t * max_t / 3 + functions.max_deviation
    # If the function is 0, |value + slope n (1 + e)| is at most the deviation.  Then
    # |value + slope n| is at most the deviation plus the following bound on |slope n e|.
    max_change = (np.abs(value) + deviation) * max_e / (1 - max_e)
    half_width = np.where(max_e < 1, deviation + max_change, np.inf)
    # The coefficients of the centre line are scaled so that |a| + |b| = 1.
    scale = np.where((a < 0) | ((a == 0) & (b < 0)), -1, 1) / (np.abs(a) + np.abs(b))
    center_line = np.array([a, b, value - a * x - b * y]) * scale
    # If there is no gradient, the strip is the whole cell.
    is_flat = ~np.isfinite(scale)
    center_line[:, is_flat] = [[1], [0], [0]]
    half_width = np.where(is_flat, np.inf, half_width * np.abs(scale))
    # The other strips miss the cell.
    kept_index = np.flatnonzero(~(np.abs(center_line[2]) - half_width >= 1))
    kept_index = kept_index[np.argsort(cell_index[kept_index], kind="stable")]
    a, b, c = center_line[:, kept_index]
    return Strips(cell_index[kept_index], a, b, c, half_width[kept_index], jump[kept_index])


class Regions(NamedTuple):
    """Convex regions (n,) into which strips divide cells, sorted by cell and side bits.

    The borders of the regions are the centre lines of the strips.  A cell has coordinates X and Y
    from -1 to 1.

    Attributes
    ----------
    cell_index : (n,) int array
        Index of the cell of each region.
    side_bits : (n,) int array
        Bit i is set if the region is on the positive side of the i-th centre line in its cell.
    area : (n,) float array
        Area of the region, as a fraction of the cell's area.
    moments : (6, n) float array
        Means of 1, X, Y, X^2, X Y and Y^2 over the region.
    """

    cell_index: Ints
    side_bits: Ints
    area: Floats
    moments: Floats

    @property
    def is_tiny(self) -> Bools:
        """Mask (n,) of the regions whose area is too small for accurate moments."""
        return np.asarray(self.area < _MIN_AREA)


def divide_into_regions(strips: Strips, cell_count: int) -> Regions:
    """Divide cells into convex regions along the centre lines of strips.

    Each cell starts as two triangles.  Each line in turn cuts every triangle that it crosses into
    three.  Triangles on the same sides of all lines form a region.

    Parameters
    ----------
    strips : Strips
        Strips (n,) in the cells 0 to cell_count - 1, sorted by cell.
    cell_count : int
        Number of cells, including those without strips.

    Returns
    -------
    regions : Regions
        All regions of all cells.  Regions without area may be missing.
    """
    strip_start = strips.cell_index.searchsorted(np.arange(cell_count + 1))
    bit_count = int(np.diff(strip_start).max(initial=0))
    cell_index, side_bits = np.arange(cell_count).repeat(2), np.zeros(2 * cell_count, dtype=np.intp)
    # The three corners of each triangle, as complex numbers X + i Y.
    corners = np.tile([[-1 - 1j, -1 - 1j], [1 - 1j, 1 + 1j], [1 + 1j, -1 + 1j]], cell_count)
    for bit in range(bit_count):
        strip_index = strip_start[cell_index] + bit
        triangle_index = np.flatnonzero(strip_index < strip_start[cell_index + 1])
        triangle, strip = corners[:, triangle_index], strips.take(strip_index[triangle_index])
        height = strip.a * triangle.real + strip.b * triangle.imag + strip.c
        is_above = height > 0
        above_count = is_above.sum(axis=0)
        side_bits[triangle_index[above_count == 3]] |= 1 << bit
        cut_index = np.flatnonzero((above_count == 1) | (above_count == 2))
        # Rotate the corners so that the first, a, is alone on its side of the line.
        is_a_above, triangle_index = above_count[cut_index] == 1, triangle_index[cut_index]
        lone_corner_index = np.argmax(is_above[:, cut_index] == is_a_above, axis=0)
        corner_index = (lone_corner_index + np.arange(3)[:, None]) % 3
        a, b, c = corners[corner_index, triangle_index]
        height_a, height_b, height_c = height[corner_index, cut_index]
        # The line meets the triangle's sides at p and q.
        p = a + height_a / (height_a - height_b) * (b - a)
        q = a + height_a / (height_a - height_c) * (c - a)
        corners[:, triangle_index] = a, p, q
        corners = np.concatenate([corners, (p, b, c), (p, c, q)], axis=1)
        old_bits = side_bits[triangle_index]
        side_bits[triangle_index] = old_bits | is_a_above << bit
        side_bits = np.concatenate([side_bits, *[old_bits | ~is_a_above << bit] * 2])
        cell_index = np.append(cell_index, np.tile(cell_index[triangle_index], 2))
    area, moments = _compute_moments(corners)
    keys, region_index = np.unique(cell_index << bit_count | side_bits, return_inverse=True)
    region_area = sum_by_index(region_index, area, keys.size)
    moments *= area / np.maximum(region_area, _MIN_AREA)[region_index]
    region_moments = np.array([sum_by_index(region_index, row, keys.size) for row in moments])
    region_moments[0] = 1
    cell_index, side_bits = keys >> bit_count, keys & ((1 << bit_count) - 1)
    return Regions(cell_index, side_bits, region_area, region_moments)


def _compute_moments(corners: NDArray[np.complex128]) -> tuple[Floats, Floats]:
    """Compute the areas of triangles, and the means of 1, X, Y, X^2, X Y and Y^2 over them.

    Parameters
    ----------
    corners : (3, n) complex array
        Corners X + i Y of each triangle, in the coordinates of a cell (-1 to 1).

    Returns
    -------
    area : (n,) float array
        Areas, as fractions of the cell's area of 4.
    moments : (6, n) float array
        The means of 1, X, Y, X^2, X Y and Y^2 over each triangle.
    """
    x, y = corners.real, corners.imag
    area = np.abs((x[1] - x[0]) * (y[2] - y[0]) - (x[2] - x[0]) * (y[1] - y[0])) / 8
    moments = [np.ones_like(area), x.sum(axis=0) / 3, y.sum(axis=0) / 3]
    # Let p and q each be X or Y, and p_i and q_i their values at corner i.  The mean of p q over
    # the triangle is (sum of p_i q_i + sum of p_i * sum of q_i) / 12.
    for p, q in ((x, x), (x, y), (y, y)):
        moments.append(((p * q).sum(axis=0) + p.sum(axis=0) * q.sum(axis=0)) / 12)
    return area, np.array(moments)
