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

from typing import Annotated as Shaped
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from reference.judges.arrays import Bools, Floats, Index, Ints, sum_by_index
from reference.judges.enclosures import X_SQUARED, Enclosures

Complexes: TypeAlias = NDArray[np.complex128]
"""Points X + i Y."""

# Minimum area of a region, as a fraction of its cell.  Smaller areas are mostly rounding error.
_MIN_AREA = 1e-12

# Corners of the two triangles into which each cell is divided first.
_CELL_TRIANGLES = [[-1 - 1j, -1 - 1j], [1 - 1j, 1 + 1j], [1 + 1j, -1 + 1j]]


class Strips(NamedTuple):
    """Strips in cells of the picture, each of which contains an edge, sorted by cell.

    A strip consists of the points with |a X + b Y + c| <= half_width, where |a| + |b| = 1.
    """

    cell_index: Shaped[Ints, "strips"]
    # Coefficients of the centre line.
    a: Shaped[Floats, "strips"]
    b: Shaped[Floats, "strips"]
    c: Shaped[Floats, "strips"]
    half_width: Shaped[Floats, "strips"]
    # Upper bound on the change of radiance across the edge, in any channel.
    jump: Shaped[Floats, "strips"]

    def take(self, index: Shaped[Index, "k"]) -> Strips:
        return Strips._make(field[index] for field in self)

    def compute_height(
        self, x: Shaped[Floats, "... strips"], y: Shaped[Floats, "... strips"]
    ) -> Shaped[Floats, "... strips"]:
        """Compute a X + b Y + c at one or more points for each strip."""
        return self.a * x + self.b * y + self.c

    @property
    def area(self) -> Shaped[Floats, "strips"]:
        """Upper bound on the fraction of its cell that each strip covers."""
        max_slope = np.maximum(np.abs(self.a), np.abs(self.b))
        return np.asarray(np.fmin(self.half_width / max_slope, 1))


def enclose_in_strips(
    cell_index: Shaped[Ints, "n"], functions: Enclosures, jump: Shaped[Floats, "n"]
) -> Strips:
    """Enclose the zeros of each edge function (8, n) in a strip between two parallel lines.

    The strip is perpendicular to the function's gradient at a point near the zero.  It is wide
    enough to allow for the error bound and the curvature of the function.  An edge function without
    a zero in its cell may get no strip.
    """
    constant, slope_x, slope_y, coef_xx, coef_xy, coef_yy, *_ = functions.coefficients
    # Compute the value and the gradient (a, b) at a point (x, y).  The closer the point is to a
    # zero, the narrower is the strip.
    x, y = _take_newton_step(functions.coefficients[:X_SQUARED])
    value = constant + slope_x * x + slope_y * y
    value = value + coef_xx * x * x + coef_xy * x * y + coef_yy * y * y
    a = slope_x + 2 * coef_xx * x + coef_xy * y
    b = slope_y + coef_xy * x + 2 * coef_yy * y
    slope = np.hypot(a, b)
    p, q = a / slope, b / slope
    # Relative to the point (x, y), let n be the coordinate along the gradient (p, q), and t the one
    # along (-q, p).  With the second derivatives f_tt, f_tn and f_nn, the function is
    #     value + slope n + f_tn t n + f_nn n^2 / 2 + f_tt t^2 / 2.
    f_tt = 2 * (coef_xx * q * q - coef_xy * p * q + coef_yy * p * p)
    f_tn = 2 * (coef_yy - coef_xx) * p * q + coef_xy * (p * p - q * q)
    f_nn = 2 * (coef_xx * p * p + coef_xy * p * q + coef_yy * q * q)
    half_extent = np.abs(p) + np.abs(q)  # half the extent of the cell, along t and along n
    max_t = half_extent + np.abs(p * y - q * x)
    max_n = half_extent + np.abs(p * x + q * y)
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
    return Strips(
        cell_index=cell_index[kept_index],
        a=a,
        b=b,
        c=c,
        half_width=half_width[kept_index],
        jump=jump[kept_index],
    )


def _take_newton_step(
    coefficients: Shaped[Floats, "3 n"],
) -> tuple[Shaped[Floats, "n"], Shaped[Floats, "n"]]:
    """Take one Newton step from the cell's centre towards a zero of each polynomial.

    There are coefficients of 1, X and Y.  The step, to X and Y, is shortened if it would leave the
    cell, and is 0 where the gradient is 0.
    """
    value, slope_x, slope_y = coefficients
    max_scale = 1 / np.maximum(np.abs(slope_x), np.abs(slope_y))
    scale = np.clip(-value / (slope_x**2 + slope_y**2), -max_scale, max_scale)
    scale = np.nan_to_num(scale, posinf=0, neginf=0)
    return scale * slope_x, scale * slope_y


class Regions(NamedTuple):
    """Convex regions into which strips divide cells, sorted by cell and side bits.

    The borders of the regions are the centre lines of the strips.
    """

    cell_index: Shaped[Ints, "regions"]
    # Bit i is set if the region is on the positive side of the i-th centre line in its cell.
    side_bits: Shaped[Ints, "regions"]
    area: Shaped[Floats, "regions"]
    moments: Shaped[Floats, "6 regions"]  # means of 1, X, Y, X^2, X Y and Y^2

    @property
    def is_tiny(self) -> Shaped[Bools, "regions"]:
        """Whether the area of each region is too small for accurate moments."""
        return np.asarray(self.area < _MIN_AREA)


class _Triangles(NamedTuple):
    """Triangles into which cells are divided.  Those with equal side bits form a region."""

    cell_index: Shaped[Ints, "triangles"]
    side_bits: Shaped[Ints, "triangles"]  # see `Regions`
    corners: Shaped[Complexes, "3 triangles"]


def divide_into_regions(strips: Strips, cell_count: int) -> Regions:
    """Divide the cells 0 to cell_count - 1 into convex regions along the centre lines of strips.

    Each cell starts as two triangles.  Each line in turn cuts every triangle that it crosses into
    three.  Triangles on the same sides of all lines form a region.  Regions without area may be
    missing.
    """
    strip_start = strips.cell_index.searchsorted(np.arange(cell_count + 1))
    bit_count = int(np.diff(strip_start).max(initial=0))
    triangles = _Triangles(
        cell_index=np.arange(cell_count).repeat(2),
        side_bits=np.zeros(2 * cell_count, dtype=np.intp),
        corners=np.tile(_CELL_TRIANGLES, cell_count),
    )
    for bit in range(bit_count):
        strip_index = strip_start[triangles.cell_index] + bit
        has_strip = strip_index < strip_start[triangles.cell_index + 1]
        strip = strips.take(strip_index[has_strip])
        triangles = _cut_triangles(triangles, np.flatnonzero(has_strip), strip, bit)
    return _merge_triangles(triangles, bit_count)


def _cut_triangles(
    triangles: _Triangles, triangle_index: Shaped[Ints, "n"], strips: Strips, bit: int
) -> _Triangles:
    """Cut some triangles, each along the centre line of a strip, which owns this side bit.

    The arrays of the argument are changed.  A triangle on one side of its line remains whole.
    """
    cell_index, side_bits, corners = triangles
    triangle = corners[:, triangle_index]
    height = strips.compute_height(triangle.real, triangle.imag)
    is_above = height > 0
    above_count = is_above.sum(axis=0)
    side_bits[triangle_index[above_count == 3]] |= 1 << bit
    cut_index = np.flatnonzero((above_count == 1) | (above_count == 2))
    triangle_index = triangle_index[cut_index]
    # Rotate the corners so that the first, a, is alone on its side of the line.
    is_a_above = above_count[cut_index] == 1
    lone_corner_index = np.argmax(is_above[:, cut_index] == is_a_above, axis=0)
    corner_index = (lone_corner_index + np.arange(3)[:, None]) % 3
    a, b, c = corners[corner_index, triangle_index]
    height_a, height_b, height_c = height[corner_index, cut_index]
    # The line meets the triangle's sides at p and q.
    p = a + height_a / (height_a - height_b) * (b - a)
    q = a + height_a / (height_a - height_c) * (c - a)
    corners[:, triangle_index] = a, p, q
    old_bits = side_bits[triangle_index]
    side_bits[triangle_index] = old_bits | (is_a_above << bit)
    other_bits = old_bits | (~is_a_above << bit)
    return _Triangles(
        cell_index=np.append(cell_index, np.tile(cell_index[triangle_index], 2)),
        side_bits=np.concatenate([side_bits, other_bits, other_bits]),
        corners=np.concatenate([corners, (p, b, c), (p, c, q)], axis=1),
    )


def _merge_triangles(triangles: _Triangles, bit_count: int) -> Regions:
    """Merge the triangles that have the same cell and the same side bits to regions."""
    area, moments = _compute_moments(triangles.corners)
    triangle_keys = (triangles.cell_index << bit_count) | triangles.side_bits
    keys, region_index = np.unique(triangle_keys, return_inverse=True)
    region_area = sum_by_index(region_index, area, keys.size)
    moments *= area / np.maximum(region_area, _MIN_AREA)[region_index]
    region_moments = np.array([sum_by_index(region_index, row, keys.size) for row in moments])
    region_moments[0] = 1
    return Regions(
        cell_index=keys >> bit_count,
        side_bits=keys & ((1 << bit_count) - 1),
        area=region_area,
        moments=region_moments,
    )


def _compute_moments(
    corners: Shaped[Complexes, "3 n"],
) -> tuple[Shaped[Floats, "n"], Shaped[Floats, "6 n"]]:
    """Compute the areas of triangles, and the means of 1, X, Y, X^2, X Y and Y^2 over them."""
    x, y = corners.real, corners.imag
    area = np.abs((x[1] - x[0]) * (y[2] - y[0]) - (x[2] - x[0]) * (y[1] - y[0])) / 8
    moments = [np.ones_like(area), x.sum(axis=0) / 3, y.sum(axis=0) / 3]
    # Let p and q each be X or Y, and p_i and q_i their values at corner i.  The mean of p q over
    # the triangle is (sum of p_i q_i + sum of p_i * sum of q_i) / 12.
    for p, q in ((x, x), (x, y), (y, y)):
        moments.append(((p * q).sum(axis=0) + p.sum(axis=0) * q.sum(axis=0)) / 12)
    return area, np.array(moments)
