"""Locate edges in cells: enclose each edge in a strip, and divide the cell along the strips.

An edge of the picture is the zero of an *edge function*, which is known only as a quadratic
polynomial with an error bound (see `enclosures`).  Two ideas make areas computable:

strip
    The part of a cell between two parallel lines, which certainly contains the edge.
region
    A convex part of a cell.  The centre lines of all strips in a cell divide it into regions.
    Outside the strips, a region contains no point of an edge.

A cell has coordinates X and Y from -1 to 1.  Areas are fractions of its area, which is 4.

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

# The two triangles into which each cell is divided first: row i contains corner i of both.
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
    """Enclose the zeros of each function (8, n) in a strip between two parallel lines.

    The lines are perpendicular to the function's gradient at a point near the zero.  The strip is
    wide enough to allow for the error bound and the curvature of the function.  The result is
    sorted by cell.  It may lack functions without a zero in their cell.

    Parameters
    ----------
    cell_index
        Index of the cell in which each function may be zero, in any order.
    jump
        Upper bound on the change of radiance across each edge, in any channel.
    """
    expansions = _expand_near_zeros(functions)
    constant, half_width = _bound_linear_part(functions, expansions)
    # The linear part is constant + gradient_x (X - x) + gradient_y (Y - y).  Scale its coefficients
    # so that |a| + |b| = 1.
    x, y, _, gradient_x, gradient_y = expansions
    is_negative = (gradient_x < 0) | ((gradient_x == 0) & (gradient_y < 0))
    scale = np.where(is_negative, -1, 1) / (np.abs(gradient_x) + np.abs(gradient_y))
    c = constant - gradient_x * x - gradient_y * y
    center_line = np.array([gradient_x, gradient_y, c]) * scale
    # If there is no gradient, the strip is the whole cell.
    is_flat = ~np.isfinite(scale)
    center_line[:, is_flat] = [[1], [0], [0]]
    half_width = np.where(is_flat, np.inf, half_width * np.abs(scale))
    return _make_strips_in_cells(cell_index, center_line, half_width, jump)


def _make_strips_in_cells(
    cell_index: Shaped[Ints, "n"],
    center_line: Shaped[Floats, "3 n"],
    half_width: Shaped[Floats, "n"],
    jump: Shaped[Floats, "n"],
) -> Strips:
    """Make strips in the order of their cells, without those that lie outside their cell.

    The rows of `center_line` are the coefficients a, b and c of a X + b Y + c, with |a| + |b| = 1.
    """
    # In the cell, |a X + b Y| is at most 1.
    is_outside = np.abs(center_line[2]) - half_width >= 1
    kept_index = np.flatnonzero(~is_outside)
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


class _Expansions(NamedTuple):
    """Values and gradients of the polynomials of edge functions, each at one point of its cell."""

    x: Shaped[Floats, "n"]
    y: Shaped[Floats, "n"]
    value: Shaped[Floats, "n"]
    gradient_x: Shaped[Floats, "n"]
    gradient_y: Shaped[Floats, "n"]


def _expand_near_zeros(functions: Enclosures) -> _Expansions:
    """Compute the value and the gradient of each edge function at a point near its zero.

    The closer the point is to the zero, the narrower the strip becomes.
    """
    constant, slope_x, slope_y, coef_xx, coef_xy, coef_yy, *_ = functions.coefficients
    x, y = _take_newton_step(functions.coefficients[:X_SQUARED])
    linear_part = constant + slope_x * x + slope_y * y
    return _Expansions(
        x=x,
        y=y,
        value=linear_part + coef_xx * x * x + coef_xy * x * y + coef_yy * y * y,
        gradient_x=slope_x + 2 * coef_xx * x + coef_xy * y,
        gradient_y=slope_y + coef_xy * x + 2 * coef_yy * y,
    )


def _take_newton_step(
    coefficients: Shaped[Floats, "3 n"],
) -> tuple[Shaped[Floats, "n"], Shaped[Floats, "n"]]:
    """Take one Newton step from the centre of each cell towards a zero, and return its X and Y.

    The rows of `coefficients` are those of 1, X and Y in a linear function.  A step that would
    leave the cell is shortened.  Where the gradient is 0, the step is 0.
    """
    value, slope_x, slope_y = coefficients
    max_scale = 1 / np.maximum(np.abs(slope_x), np.abs(slope_y))
    scale = np.clip(-value / (slope_x**2 + slope_y**2), -max_scale, max_scale)
    scale = np.nan_to_num(scale, posinf=0, neginf=0)
    return scale * slope_x, scale * slope_y


def _bound_linear_part(
    functions: Enclosures, expansions: _Expansions
) -> tuple[Shaped[Floats, "n"], Shaped[Floats, "n"]]:
    """Bound the linear part of each edge function where the function is 0 in its cell.

    At (X, Y), the linear part is constant + gradient_x (X - x) + gradient_y (Y - y).  Return the
    constant, and an upper bound on the absolute value of the linear part.  The bound is infinite if
    the curvature is too large.
    """
    x, y, value, gradient_x, gradient_y = expansions
    slope = np.hypot(gradient_x, gradient_y)
    normal_x = gradient_x / slope
    normal_y = gradient_y / slope
    # Relative to the point (x, y), let n be the coordinate along the gradient, and t the one along
    # (-normal_y, normal_x).  With the second derivatives f_tt, f_tn and f_nn, the function is
    #     value + slope n + f_tn t n + f_nn n^2 / 2 + f_tt t^2 / 2.
    f_tt, f_tn, f_nn = _rotate_second_derivatives(functions, normal_x, normal_y)
    # Half the extent of the cell, along t and along n.
    half_extent = np.abs(normal_x) + np.abs(normal_y)
    max_t = half_extent + np.abs(normal_x * y - normal_y * x)
    max_n = half_extent + np.abs(normal_x * x + normal_y * y)
    # The second to fourth terms are slope n (1 + e) with |e| <= max_e.
    max_e = (np.abs(f_tn) * max_t + 0.5 * np.abs(f_nn) * max_n) / slope
    # Replace the last term by its mean for t from -max_t to max_t, so that the centre line divides
    # the cell into almost the same areas as the edge.  The mean of t^2 / 2 is max_t^2 / 6.  The
    # term differs from it most at the ends, where t^2 / 2 - max_t^2 / 6 = max_t^2 / 3.
    constant = value + f_tt * max_t * max_t / 6
    deviation = np.abs(f_tt) * max_t * max_t / 3 + functions.max_deviation
    # If the function is 0, |constant + slope n (1 + e)| is at most the deviation.  Then
    # |constant + slope n| is at most the deviation plus the following bound on |slope n e|.
    max_change = (np.abs(constant) + deviation) * max_e / (1 - max_e)
    return constant, np.where(max_e < 1, deviation + max_change, np.inf)


def _rotate_second_derivatives(
    functions: Enclosures, normal_x: Shaped[Floats, "n"], normal_y: Shaped[Floats, "n"]
) -> tuple[Shaped[Floats, "n"], Shaped[Floats, "n"], Shaped[Floats, "n"]]:
    """Compute the second derivatives f_tt, f_tn and f_nn of the polynomials.

    The coordinate n runs along the unit vector (normal_x, normal_y), and t along
    (-normal_y, normal_x).
    """
    coef_xx, coef_xy, coef_yy = functions.coefficients[X_SQUARED : X_SQUARED + 3]
    # The derivative along unit vectors u and v is the sum of u_i v_j f_ij over X and Y.  Here,
    # f_XX = 2 coef_xx, f_XY = coef_xy and f_YY = 2 coef_yy.
    f_tt = 2 * (
        coef_xx * normal_y * normal_y
        - coef_xy * normal_x * normal_y
        + coef_yy * normal_x * normal_x
    )
    f_tn = 2 * (coef_yy - coef_xx) * normal_x * normal_y + coef_xy * (
        normal_x * normal_x - normal_y * normal_y
    )
    f_nn = 2 * (
        coef_xx * normal_x * normal_x
        + coef_xy * normal_x * normal_y
        + coef_yy * normal_y * normal_y
    )
    return f_tt, f_tn, f_nn


class Regions(NamedTuple):
    """Convex regions into which strips divide cells, sorted by cell and side bits.

    The borders of the regions are the centre lines of the strips.
    """

    cell_index: Shaped[Ints, "regions"]
    # Bit i is set if the region is on the positive side of the i-th centre line in its cell.
    side_bits: Shaped[Ints, "regions"]
    area: Shaped[Floats, "regions"]
    moments: Shaped[Floats, "6 regions"]  # means of 1, X, Y, X^2, X Y and Y^2 over each region

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
    three.  Triangles on the same sides of all lines form a region.  A cell without strips is one
    region.  Regions without area may be missing.
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
    """Cut the triangles with the given indices, each along the centre line of one strip.

    `strips` has one strip for each element of `triangle_index`.  Bit number `bit` of the side bits
    is set for parts on the positive side of the line.  A triangle that lies on one side of its line
    remains whole.  Return all triangles, the new ones last.  The arrays of the argument `triangles`
    are changed in place.
    """
    cell_index, side_bits, corners = triangles
    chosen_corners = corners[:, triangle_index]
    height = strips.compute_height(chosen_corners.real, chosen_corners.imag)
    is_above = height > 0
    above_count = is_above.sum(axis=0)
    side_bits[triangle_index[above_count == 3]] |= 1 << bit
    # The positions, in `triangle_index`, of the triangles that their line cuts.
    position = np.flatnonzero((above_count == 1) | (above_count == 2))
    cut_index = triangle_index[position]
    # Rotate the corners so that the first one is alone on its side of the line.
    is_first_above = above_count[position] == 1
    first_corner_index = np.argmax(is_above[:, position] == is_first_above, axis=0)
    corner_index = (first_corner_index + np.arange(3)[:, None]) % 3
    first, second, third = corners[corner_index, cut_index]
    first_height, second_height, third_height = height[corner_index, position]
    # Points where the line meets the two sides at the first corner.
    on_second = first + first_height / (first_height - second_height) * (second - first)
    on_third = first + first_height / (first_height - third_height) * (third - first)
    # The part at the first corner replaces the triangle.  The part on the other side of the line,
    # which has four corners, becomes two new triangles.
    old_bits = side_bits[cut_index]
    corners[:, cut_index] = first, on_second, on_third
    side_bits[cut_index] = old_bits | (is_first_above << bit)
    other_triangles = [(on_second, second, third), (on_second, third, on_third)]
    other_bits = old_bits | (~is_first_above << bit)
    return _Triangles(
        cell_index=np.append(cell_index, np.tile(cell_index[cut_index], 2)),
        side_bits=np.concatenate([side_bits, other_bits, other_bits]),
        corners=np.concatenate([corners, *other_triangles], axis=1),
    )


def _merge_triangles(triangles: _Triangles, bit_count: int) -> Regions:
    """Merge triangles with equal cells and side bits into one region, sorted by cell and bits."""
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
    # For f and g equal to X or Y, with values f_i and g_i at corner i, the mean of f g over the
    # triangle is (sum of f_i g_i + sum of f_i * sum of g_i) / 12.
    for f, g in ((x, x), (x, y), (y, y)):
        moments.append(((f * g).sum(axis=0) + f.sum(axis=0) * g.sum(axis=0)) / 12)
    return area, np.array(moments)
