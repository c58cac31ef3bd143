"""Fit straight lines to the edges that cross cells, from values of edge functions.

An *edge function* is a smooth function of the position in the picture that is zero on an edge
(Pineda 1988).  The module `tracer.antialias.edges` defines the functions of all kinds of edges.  A
*cell* is a pixel or a square part of a pixel.  `fit_lines` fits a line in four steps:

1. It finds the quadratic polynomial through the values of the edge function at six points.
2. From the center of the cell, it follows the gradient to a zero of the polynomial.  This is a
   point on the edge.
3. There, it replaces the polynomial by its tangent plane, whose zeros are a straight line.
4. The second derivatives show by which angle the edge turns within the cell.  If the angle is
   small, the line represents the edge.

Pineda, A parallel algorithm for polygon rasterization, SIGGRAPH 1988.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Annotated as Shaped
from typing import NamedTuple

import numpy as np

from tracer.arrays import Floats, Ints, Triple, find, mark_run_starts, scale
from tracer.geometry.camera import CameraFrame
from tracer.geometry.silhouette import bound_variation

# The six points of a cell, in the order that `compute_rays` states, relative to its center and in
# units of its width.
_POINT_X = np.array([[0.0], [0.5], [-0.5], [0.0], [0.0], [0.5]])
_POINT_Y = np.array([[0.0], [0.0], [0.0], [0.5], [-0.5], [0.5]])

# A line represents an edge that turns within the cell by at most this angle, in radians.  On the
# project's scenes, half of it makes errors of 4 samples per pixel up to 1.6 times as large.
_MAX_TURN = 0.5

# An edge counts as straight if it turns by at most this many radians, times the tolerance of the
# mean radiance.  Half or twice as much changes errors and times by 1 %.
_TURN_PER_TOLERANCE = 500.0


class EdgeValues(NamedTuple):
    """Values of the edge functions of n edges, each at six points of one cell."""

    cell_index: Shaped[Ints, "n"]
    values: Shaped[Floats, "6 n"]  # at the six points, ordered as in `compute_rays`; NaN if unknown


class Lines(NamedTuple):
    """Straight lines c + a x + b y = 0 that cross cells.

    The position (x, y) is relative to the center of the cell, in units of its width; y points down.
    The coefficients are scaled so that the maximum of |a x + b y| in the cell is 1, and that a > 0
    (or b > 0 if a = 0).
    """

    cell_index: Shaped[Ints, "n"]
    a: Shaped[Floats, "n"]
    b: Shaped[Floats, "n"]
    c: Shaped[Floats, "n"]

    @classmethod
    def concatenate(cls, line_sets: Iterable[Lines]) -> Lines:
        """Concatenate at least one set of lines."""
        return cls._make(map(np.concatenate, zip(*line_sets, strict=True)))

    def take(self, line_index: Shaped[Ints, "k"]) -> Lines:
        return Lines._make(field[line_index] for field in self)

    def sort_and_deduplicate(self) -> Lines:
        """Sort the lines by cell and then by coefficients, and remove duplicates.

        The result does not depend on the order in which the lines were found.  Lights at the same
        place cause equal lines.
        """
        sorted_lines = self.take(np.lexsort((self.c, self.b, self.a, self.cell_index)))
        return sorted_lines.take(find(mark_run_starts(*sorted_lines)))

    def limit_per_cell(self, max_lines: int) -> Lines:
        """Keep the first `max_lines` lines of each cell; the lines must be sorted by cell."""
        position_in_cell = np.arange(self.a.size) - self.cell_index.searchsorted(self.cell_index)
        return self.take(find(position_in_cell < max_lines))


def compute_rays(
    frame: CameraFrame,
    center_ray_x: Shaped[Floats, "n"],
    center_ray_y: Shaped[Floats, "n"],
    cell_width: float,
) -> Shaped[Triple, "#6 n"]:
    """Compute the directions of rays from the eye through six points of each cell.

    The points are the center of the cell; the centers of its right, left, lower and upper sides;
    and its lower right corner.  The directions are in camera axes.  All have the same forward
    component, which therefore has a single row.

    Parameters
    ----------
    center_ray_x, center_ray_y
        Components to the right and down of the ray through the center of each cell, whose forward
        component is `frame.depth`.
    cell_width
        Width of the cells, in pixels.
    """
    offset_right = _POINT_X * (frame.pixel_width * cell_width)
    offset_down = _POINT_Y * (frame.pixel_height * cell_width)
    ray_forward = np.full((1, center_ray_x.size), frame.depth)
    return center_ray_x + offset_right, center_ray_y + offset_down, ray_forward


class FittedLines(NamedTuple):
    """Lines that represent edges, and the cells in which lines do not suffice."""

    # At most one line for each edge.  An edge has no line if it turns by more than `_MAX_TURN`, or
    # if the line misses the cell.
    lines: Lines
    # The cell of each edge that may cross the cell, and that turns too much or has unknown values.
    # An index may be repeated.
    curved_cell_index: Shaped[Ints, "k"]


def fit_lines(edges: Iterable[EdgeValues], tolerance: float) -> FittedLines:
    """Fit a straight line to each edge, from batches of values of edge functions.

    `tolerance` is the maximum error of the mean radiance of a cell.  The smaller it is, the less an
    edge may turn before its cell is listed as curved.  Such an edge may still have a line.
    """
    max_turn = min(_TURN_PER_TOLERANCE * tolerance, _MAX_TURN)
    # Without edges, there is still an empty batch to concatenate.
    no_edges = EdgeValues(cell_index=np.zeros(0, dtype=np.intp), values=np.zeros((6, 0)))
    fits = [_fit_line_batch(no_edges, max_turn)]
    fits += [_fit_line_batch(batch, max_turn) for batch in edges]
    return FittedLines(
        lines=Lines.concatenate([fit.lines for fit in fits]),
        curved_cell_index=np.concatenate([fit.curved_cell_index for fit in fits]),
    )


def _fit_line_batch(edges: EdgeValues, max_turn: float) -> FittedLines:
    """Fit a line to each edge, and list the cells of edges that turn by more than `max_turn`.

    The line is parallel to the edge near the center of the cell, at the edge's mean position.
    Angles are in radians.
    """
    quadratics = _Quadratics.from_values(edges.values)
    h_across = quadratics.compute_second_derivatives(quadratics.a, quadratics.b)
    zero_x, zero_y = quadratics.find_nearest_zeros(h_across)
    planes = quadratics.compute_tangent_planes(zero_x, zero_y)
    h_along = quadratics.compute_second_derivatives(-planes.b, planes.a)
    lines = planes.find_lines(edges.cell_index, h_along)
    # Over a length of 1, the edge turns by |h_along| / |gradient| radians.  If the gradient changes
    # much across the edge, the cell may contain both sides of a small object.
    gradient = np.sqrt(planes.a * planes.a + planes.b * planes.b)
    turn = np.maximum(np.abs(h_along), np.abs(h_across)) / gradient
    # If values are unknown, NaN makes all four comparisons False.  The edge then has no line, and
    # its cell is listed, because the edge is neither straight nor certain to miss the cell.
    has_line = turn <= _MAX_TURN
    is_straight = turn <= max_turn
    line_crosses_cell = np.abs(lines.c) < 1
    edge_misses_cell = np.abs(quadratics.c) > 1  # the function certainly has no zero in the cell
    # An edge that turns much may cross a cell that its line misses.
    may_cross = np.where(has_line, line_crosses_cell, ~edge_misses_cell)
    return FittedLines(
        lines=lines.take(find(has_line & line_crosses_cell)),
        curved_cell_index=edges.cell_index[find(may_cross & ~is_straight)],
    )


class _Quadratics(NamedTuple):
    """Quadratic polynomials c + g . p + p . H p / 2 of a position p = (x, y), as in `Lines`.

    The vector g = (a, b) is the gradient at the center, and H is the symmetric matrix of second
    derivatives.  In the cell, a polynomial differs from c by at most 1.
    """

    c: Shaped[Floats, "n"]
    a: Shaped[Floats, "n"]
    b: Shaped[Floats, "n"]
    h_xx: Shaped[Floats, "n"]
    h_xy: Shaped[Floats, "n"]
    h_yy: Shaped[Floats, "n"]

    @classmethod
    def from_values(cls, values: Shaped[Floats, "6 n"]) -> _Quadratics:
        """Interpolate the values of edge functions at the six points of a cell, after scaling."""
        # Without scaling, squares of very small or very large values would underflow or overflow.
        center, right, left, lower, upper, corner = values / bound_variation(values)
        return cls(
            c=center,
            a=right - left,
            b=lower - upper,
            h_xx=4 * (right + left - 2 * center),
            h_xy=4 * (corner - right - lower + center),
            h_yy=4 * (lower + upper - 2 * center),
        )

    def compute_second_derivatives(
        self, x: Shaped[Floats, "n"], y: Shaped[Floats, "n"]
    ) -> Shaped[Floats, "n"]:
        """Compute the second derivatives in the directions of vectors v = (x, y) of any length."""
        # This is v . H v / |v|^2.
        quadratic_form = x * x * self.h_xx + 2 * x * y * self.h_xy + y * y * self.h_yy
        return quadratic_form / (x * x + y * y)

    def find_nearest_zeros(
        self, h_across: Shaped[Floats, "n"]
    ) -> tuple[Shaped[Floats, "n"], Shaped[Floats, "n"]]:
        """Find x and y of the zero that is nearest to the center, on a line along the gradient g.

        The line passes through the center.  If the zero is outside the cell, the result is the
        point at which the line leaves the cell.  `h_across` is the second derivative along g.
        """
        # At the point s g, with G = |g|^2 and the second derivative h, the value is
        # c + G s + G h s^2 / 2.  Its zeros are s = (-G +- root) / (G h) = -2 c / (G +- root), where
        # root^2 = G^2 - 2 c G h.  The nearest to 0 is s = -2 c / (G + root), which is accurate also
        # if h is small or 0.
        squared_gradient = self.a * self.a + self.b * self.b
        discriminant = squared_gradient * (squared_gradient - 2 * self.c * h_across)
        # If the discriminant is negative, there is no zero on the line.  Its root would be NaN, and
        # the cell would count as crossed by a curved edge.  The absolute value gives a point in the
        # direction in which the polynomial approaches 0.
        root = np.sqrt(np.abs(discriminant))
        step = -2 * self.c / (squared_gradient + root)
        max_step = 0.5 / np.maximum(np.abs(self.a), np.abs(self.b))
        step = np.clip(step, -max_step, max_step)
        return step * self.a, step * self.b

    def compute_tangent_planes(
        self, x: Shaped[Floats, "n"], y: Shaped[Floats, "n"]
    ) -> _TangentPlanes:
        """Compute linear functions with the values and gradients of the polynomials at (x, y)."""
        square_part = x * (self.h_xx * x + 2 * self.h_xy * y) + y * self.h_yy * y
        value = self.c + self.a * x + self.b * y + 0.5 * square_part
        a = self.a + self.h_xx * x + self.h_xy * y
        b = self.b + self.h_xy * x + self.h_yy * y
        return _TangentPlanes(c=value - (a * x + b * y), a=a, b=b)


class _TangentPlanes(NamedTuple):
    """Linear functions c + a x + b y that approximate edge functions near the edges."""

    c: Shaped[Floats, "n"]
    a: Shaped[Floats, "n"]
    b: Shaped[Floats, "n"]

    def find_lines(self, cell_index: Shaped[Ints, "n"], h_along: Shaped[Floats, "n"]) -> Lines:
        """Find the lines on which the functions are zero, moved to the mean positions of the edges.

        `h_along` is the second derivative of the edge function along the line.
        """
        max_change = 0.5 * (np.abs(self.a) + np.abs(self.b))
        is_negative = (self.a < 0) | ((self.a == 0) & (self.b < 0))
        scale_factor = np.where(is_negative, -1.0, 1.0) / max_change
        # At the distance s along the line, the edge function differs from the linear one by
        # h_along s^2 / 2.  Over a length of 1, from s = -1/2 to 1/2, the mean is h_along / 24.
        a, b, c = scale((self.a, self.b, self.c + h_along / 24), scale_factor)
        return Lines(cell_index=cell_index, a=a, b=b, c=c)
