"""Edge functions: functions of the position in the picture that are zero on an edge (Pineda 1988).

A cell is a pixel or a square part of a pixel.  From the values of an edge function at six points of
a cell, `fit_lines` computes the straight line that represents the edge in the cell, or finds that
the edge is too curved for a line.

Each edge function is computed from the ray from the eye through the position:

==========================  ======================================================================
silhouette of a sphere      the angle between the ray and the direction to the sphere's centre,
                            minus the angular radius of the sphere
silhouette edge of a box    n . ray, with the normal n of the plane through viewpoint and edge
intersection of surfaces,   1 / t1 - 1 / t2, where the points t1 * ray and t2 * ray lie on the two
or crease                   surfaces
terminator                  the cosine between the normal and the direction to the light
==========================  ======================================================================

The functions of silhouettes are evaluated by `Shape.find_silhouettes`, and all others by
`CellSurfaces` (see `edges`), from the 1 / t that `ExtendedFaces` computes.

The *viewpoint* of a silhouette is the eye or a light.  Silhouettes seen from a light are the edges
of shadows; the ray then leads from the light to the surface that is visible in the cell.

All vectors are in the axes of the camera, relative to the eye.

Pineda, A parallel algorithm for polygon rasterization, SIGGRAPH 1988.
"""

from __future__ import annotations

from collections.abc import Iterable
from itertools import chain
from typing import Annotated as Shaped
from typing import NamedTuple

import numpy as np

from tracer.arrays import (
    Floats,
    Ints,
    Triple,
    find,
    mark_run_starts,
    scale,
)
from tracer.geometry.camera import CameraFrame
from tracer.geometry.silhouette import bound_variation

# The six points of a cell relative to its centre, in units of the cell's width: the centre; the
# centres of the right, left, lower and upper sides; and the lower right corner.
_POINT_X = np.array([[0.0], [0.5], [-0.5], [0.0], [0.0], [0.5]])
_POINT_Y = np.array([[0.0], [0.0], [0.0], [0.5], [-0.5], [0.5]])

# A line represents an edge that turns across the cell by at most this angle, in radians.  Tuned on
# the project's scenes: with half of it, errors of 4 samples per pixel are up to 1.6 times as large.
_MAX_TURN = 0.5

# An edge counts as straight if it turns by at most this many radians times the cell's tolerance in
# radiance.  Half or twice as much changes errors and times by 1 %.
_TURN_PER_TOLERANCE = 500.0


class EdgeValues(NamedTuple):
    """Values of the edge functions of n edges, each at six points of one cell."""

    cell_index: Shaped[Ints, "n"]
    values: Shaped[Floats, "6 n"]  # at the points of `compute_rays`; NaN if unknown


class Lines(NamedTuple):
    """Straight lines c + a x + b y = 0 that cross cells.

    The coordinates x and y are relative to the centre of the cell, in units of the cell's width.
    The y-axis points down.  The coefficients are scaled so that the maximum of |a x + b y| in the
    cell is 1, and that a > 0 (or b > 0 if a = 0).
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
    """Compute the rays from the eye through the six points of cells that `_POINT_X` lists.

    The arguments give the rays through the centres of cells that are `cell_width` pixels wide.  The
    forward components, which are all `frame.depth`, have a single row for all six points.
    """
    offset_right = _POINT_X * (frame.pixel_width * cell_width)
    offset_down = _POINT_Y * (frame.pixel_height * cell_width)
    ray_forward = np.full((1, center_ray_x.size), frame.depth)
    return center_ray_x + offset_right, center_ray_y + offset_down, ray_forward


class FittedLines(NamedTuple):
    """Lines that represent edges, and the cells in which they do not suffice."""

    # A line for each edge that turns by at most `_MAX_TURN`, unless the line misses the cell.
    lines: Lines
    # Cells with an edge that turns too much for the tolerance, or whose values are unknown; an
    # index may be repeated.
    curved_cell_index: Shaped[Ints, "k"]


def fit_lines(edges: Iterable[EdgeValues], tolerance: float) -> FittedLines:
    """Fit a straight line to each edge.  For `tolerance`, see `Cells`."""
    no_edges = EdgeValues(cell_index=np.zeros(0, dtype=np.intp), values=np.zeros((6, 0)))
    fits = (_fit_line_batch(batch, tolerance) for batch in chain([no_edges], edges))
    batch_lines, curved_cell_index = zip(*fits, strict=True)
    return FittedLines(
        lines=Lines.concatenate(batch_lines), curved_cell_index=np.concatenate(curved_cell_index)
    )


class _Quadratics(NamedTuple):
    """Functions f(p) = c + g . p + p . H p / 2 of a point p = (x, y), as in `Lines`.

    The gradient g at the centre is (a, b); H is a symmetric matrix.  The scale of f is such that
    |f(p) - c| is at most 1 in the cell.
    """

    c: Shaped[Floats, "n"]
    a: Shaped[Floats, "n"]
    b: Shaped[Floats, "n"]
    h_xx: Shaped[Floats, "n"]
    h_xy: Shaped[Floats, "n"]
    h_yy: Shaped[Floats, "n"]

    @classmethod
    def from_values(cls, values: Shaped[Floats, "6 n"]) -> _Quadratics:
        """Interpolate the values of edge functions at six points, after scaling."""
        # Without scaling, squares of very small or very large values would be 0 or infinite.
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
        """Compute the second derivatives of f in the directions of the vectors (x, y)."""
        along_both = x * x * self.h_xx + 2 * x * y * self.h_xy + y * y * self.h_yy
        return along_both / (x * x + y * y)

    def find_nearest_zeros(
        self, h_gradient: Shaped[Floats, "n"]
    ) -> tuple[Shaped[Floats, "n"], Shaped[Floats, "n"]]:
        """Find x and y of the zero nearest to the centre, on the line along g through the centre.

        A zero outside the cell is replaced by the point at which the line leaves the cell.
        `h_gradient` is the second derivative along g.
        """
        # At the point s g, with G = |g|^2 and the second derivative h, f is c + G s + G h s^2 / 2.
        # The zero nearest to s = 0 is s = -2 c / (G + root), where root^2 = G^2 - 2 c G h.  The
        # usual form, (root - G) / (G h), fails if h is 0 and is inexact if h is small.
        squared_gradient = self.a * self.a + self.b * self.b
        discriminant = squared_gradient * (squared_gradient - 2 * self.c * h_gradient)
        # If it is negative, f has no zero on the line.  Its absolute value then gives some finite
        # point in the direction in which |f| decreases.
        root = np.sqrt(np.abs(discriminant))
        step = -2 * self.c / (squared_gradient + root)
        max_step = 0.5 / np.maximum(np.abs(self.a), np.abs(self.b))
        step = np.clip(step, -max_step, max_step)
        return step * self.a, step * self.b

    def compute_tangent_planes(
        self, x: Shaped[Floats, "n"], y: Shaped[Floats, "n"]
    ) -> _TangentPlanes:
        """Compute the linear functions with the value and the gradient of f at the point (x, y)."""
        square_part = x * (self.h_xx * x + 2 * self.h_xy * y) + y * self.h_yy * y
        value = self.c + self.a * x + self.b * y + 0.5 * square_part
        a = self.a + self.h_xx * x + self.h_xy * y
        b = self.b + self.h_xy * x + self.h_yy * y
        return _TangentPlanes(c=value - (a * x + b * y), a=a, b=b)


class _TangentPlanes(NamedTuple):
    """Linear functions c + a x + b y."""

    c: Shaped[Floats, "n"]
    a: Shaped[Floats, "n"]
    b: Shaped[Floats, "n"]

    def find_lines(self, cell_index: Shaped[Ints, "n"], h_along: Shaped[Floats, "n"]) -> Lines:
        """Find the lines of zeros, moved to the mean positions of the edges.

        `h_along` is the second derivative of the edge function along the line.
        """
        max_change = 0.5 * (np.abs(self.a) + np.abs(self.b))
        is_negative = (self.a < 0) | ((self.a == 0) & (self.b < 0))
        scale_factor = np.where(is_negative, -1.0, 1.0) / max_change
        # Along the line, f differs from the plane by h_along / 24 on average, over a length of 1.
        a, b, c = scale((self.a, self.b, self.c + h_along / 24), scale_factor)
        return Lines(cell_index=cell_index, a=a, b=b, c=c)


def _fit_line_batch(edges: EdgeValues, tolerance: float) -> FittedLines:
    """Fit a line to each edge, parallel to it near the centre, at the edge's mean position."""
    f = _Quadratics.from_values(edges.values)
    h_across = f.compute_second_derivatives(f.a, f.b)
    plane = f.compute_tangent_planes(*f.find_nearest_zeros(h_across))
    h_along = f.compute_second_derivatives(-plane.b, plane.a)
    lines = plane.find_lines(edges.cell_index, h_along)
    # Over a length of 1, the edge turns by |h_along| / |g| radians.  If the gradient changes much
    # across the edge, the cell may contain both sides of a small object.
    gradient = np.sqrt(plane.a * plane.a + plane.b * plane.b)
    turn = np.maximum(np.abs(h_along), np.abs(h_across)) / gradient
    has_line = turn <= _MAX_TURN
    crosses_cell = np.abs(lines.c) < 1
    # A curved edge may cross a cell that its tangent misses, but none in which f has no zero, which
    # is certain if |f.c| > 1.  The negated tests are True for NaN.
    may_cross = np.where(has_line, crosses_cell, ~(np.abs(f.c) > 1))
    is_curved = may_cross & ~(turn <= min(_TURN_PER_TOLERANCE * tolerance, _MAX_TURN))
    return FittedLines(
        lines=lines.take(find(has_line & crosses_cell)),
        curved_cell_index=edges.cell_index[find(is_curved)],
    )
