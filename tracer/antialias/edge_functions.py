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

from tracer.arrays import Floats, Ints, Triple, dot, find, scale, take, take_columns
from tracer.geometry.camera import CameraFrame
from tracer.geometry.shape import CURVED_FACE, NO_AXIS, Shape
from tracer.geometry.silhouette import bound_variation
from tracer.trace.hits import Hits

# The six points of a cell relative to its centre, in units of the cell's width: the centre; the
# centres of the right, left, lower and upper sides; and the lower right corner.
_POINT_X = np.array([[0.0], [0.5], [-0.5], [0.0], [0.0], [0.5]])
_POINT_Y = np.array([[0.0], [0.0], [0.0], [0.5], [-0.5], [0.5]])

# A line represents an edge that turns across the cell by at most the first number, in radians.  The
# edge counts as straight if it turns by at most the second number times the cell's tolerance in
# radiance.  Tuned on the project's scenes: with half the first number, errors of 4 samples per
# pixel are up to 1.6 times as large; half or twice the second changes errors and times by 1 %.
_MAX_TURN, _TURN_PER_TOLERANCE = 0.5, 500.0


class EdgeValues(NamedTuple):
    """Values of the edge functions of n edges, each at six points of one cell.

    An edge function is a smooth function of the position in the picture that is zero on the edge.
    A cell is a pixel, or a square part of a pixel.

    Attributes
    ----------
    cell_index : (n,) int array
        Index of the cell that each edge may cross.
    values : (6, n) float array
        Values of each edge function at six points of the cell (see `compute_rays`); NaN if unknown.
    """

    cell_index: Ints
    values: Floats


class Lines(NamedTuple):
    """Straight lines c + a x + b y = 0 that cross cells (pixels, or square parts of pixels).

    The coordinates x and y are relative to the centre of the cell, in units of the cell's width.
    The y-axis points down.

    Attributes
    ----------
    cell_index : (n,) int array
        Index of the cell that each line crosses.
    a, b, c : (n,) float arrays
        Coefficients, scaled so that the maximum of |a x + b y| in the cell is 1, and that a > 0 (or
        b > 0 if a = 0).
    """

    cell_index: Ints
    a: Floats
    b: Floats
    c: Floats

    @classmethod
    def concatenate(cls, line_sets: Iterable[Lines]) -> Lines:
        """Concatenate sets of lines.

        Parameters
        ----------
        line_sets : iterable of Lines
            At least one set.

        Returns
        -------
        lines : Lines
            The lines of all sets, in the same order.
        """
        return cls._make(map(np.concatenate, zip(*line_sets, strict=True)))

    def take(self, line_index: Ints | slice) -> Lines:
        """Select lines by index.

        Parameters
        ----------
        line_index : (k,) int array or slice
            Indices of the lines to select.

        Returns
        -------
        selected_lines : Lines
            The k selected lines, in the order of `line_index`.
        """
        return Lines._make(field[line_index] for field in self)

    def sort(self) -> Lines:
        """Sort the lines by cell, and then by coefficients.

        The result does not depend on the order in which the lines were found.
        """
        return self.take(np.lexsort((self.c, self.b, self.a, self.cell_index)))

    def limit_per_cell(self, max_lines: int) -> Lines:
        """Keep at most `max_lines` lines of each cell.

        The lines must be sorted by cell.

        Parameters
        ----------
        max_lines : int
            Maximum number of lines to keep in a cell.

        Returns
        -------
        lines : Lines
            The first `max_lines` lines of each cell, in the same order.
        """
        position_in_cell = np.arange(self.a.size) - self.cell_index.searchsorted(self.cell_index)
        return self.take(find(position_in_cell < max_lines))


def compute_rays(
    frame: CameraFrame, center_ray_x: Floats, center_ray_y: Floats, cell_width: float
) -> Triple:
    """Compute the rays from the eye through six points of each of n cells.

    A cell is a pixel, or a square part of a pixel.  The six points are, in this order: the centre;
    the centres of the right, left, lower and upper sides; and the lower right corner.

    Parameters
    ----------
    frame : CameraFrame
        The camera.
    center_ray_x, center_ray_y : (n,) float arrays
        Rightward and downward components of the ray through the centre of each cell.  The forward
        component is `frame.depth`.
    cell_width : float
        Width of the cells, in pixels.

    Returns
    -------
    ray_x, ray_y : (6, n) float arrays
        Rightward and downward components of the rays.
    ray_forward : (1, n) float array
        Forward component of the rays, the same for all six points.
    """
    offset_right = _POINT_X * (frame.pixel_width * cell_width)
    offset_down = _POINT_Y * (frame.pixel_height * cell_width)
    ray_forward = np.full((1, center_ray_x.size), frame.depth)
    return center_ray_x + offset_right, center_ray_y + offset_down, ray_forward


def fit_lines(edges: Iterable[EdgeValues], tolerance: float) -> tuple[Lines, Ints]:
    """Fit a straight line to each edge in a cell, and find the cells with curved edges.

    Parameters
    ----------
    edges : iterable of EdgeValues
        Batches of edges.  Each edge is given by the cell (a pixel, or a square part of a pixel)
        that it may cross, and by values of its edge function: a function of the position in the
        picture that is zero on the edge.
    tolerance : float
        Tolerated error of the mean radiance of a cell.

    Returns
    -------
    lines : Lines
        A line for each edge that turns by at most `_MAX_TURN` radians in its cell, unless the line
        misses the cell.
    curved_cell_index : (k,) int array
        Index of the cell of each curved edge.  An edge counts as curved if it turns too much for
        the tolerance, or if values are unknown.
    """
    no_edges = EdgeValues(np.zeros(0, dtype=np.intp), np.zeros((6, 0)))
    fits = (_fit_line_batch(batch, tolerance) for batch in chain([no_edges], edges))
    batch_lines, curved_cell_index = zip(*fits, strict=True)
    return Lines.concatenate(batch_lines), np.concatenate(curved_cell_index)


def _fit_line_batch(edges: EdgeValues, tolerance: float) -> tuple[Lines, Ints]:
    """Fit a straight line to each of n edges, and find the cells with curved edges.

    A cell is a pixel, or a square part of a pixel.  Each edge is given by its edge function f, a
    function of the position in the picture that is zero on the edge.  The line is parallel to the
    edge near the centre of the cell, and lies at the edge's mean position.

    Parameters
    ----------
    edges : EdgeValues
        The cells that the n edges may cross, and values of the edge functions.
    tolerance : float
        Tolerated error of the mean radiance of a cell.

    Returns
    -------
    lines : Lines
        A line for each edge that turns by at most `_MAX_TURN` radians in its cell, unless the line
        misses the cell.
    curved_cell_index : (k,) int array
        Index of the cell of each curved edge.  An edge counts as curved if it turns too much for
        the tolerance, or if values are unknown.
    """
    cell_index, values = edges
    # Values of f, scaled so that powers of the derivatives are finite in any unit of length.
    center, right, left, lower, upper, corner = values / bound_variation(values)
    # Near the centre, f(p) = c + g . p + p . H p / 2, with the gradient g = (a, b) and a matrix H.
    # The second derivatives across and along the edge are h_across and h_along.
    a, b = right - left, lower - upper
    h_xx, h_yy = 4 * (right + left - 2 * center), 4 * (lower + upper - 2 * center)
    h_xy = 4 * (corner - right - lower + center)
    squared_gradient = a * a + b * b
    # Find the zero p = step * g of f that is nearest to the centre, and move it into the cell.
    h_across = (a * a * h_xx + 2 * a * b * h_xy + b * b * h_yy) / squared_gradient
    root = np.sqrt(np.abs(squared_gradient * (squared_gradient - 2 * center * h_across)))
    step = -2 * center / (squared_gradient + root)
    max_step = 0.5 / np.maximum(np.abs(a), np.abs(b))
    step = np.clip(step, -max_step, max_step)
    x, y = step * a, step * b
    # Replace f by its tangent plane c + a x + b y at this point.
    c = center + a * x + b * y + 0.5 * (x * (h_xx * x + 2 * h_xy * y) + y * h_yy * y)
    a, b = a + h_xx * x + h_xy * y, b + h_xy * x + h_yy * y
    c -= a * x + b * y
    squared_gradient = a * a + b * b
    # Along the line, f differs from the plane by h_along / 24 on average, over a length of 1.
    h_along = (b * b * h_xx - 2 * a * b * h_xy + a * a * h_yy) / squared_gradient
    max_change = 0.5 * (np.abs(a) + np.abs(b))
    sign = np.where((a < 0) | ((a == 0) & (b < 0)), -1.0, 1.0)
    lines = Lines(cell_index, *scale((a, b, c + h_along / 24), sign / max_change))
    # Over a length of 1, the edge turns by |h_along| / |g| radians.  If the gradient changes much
    # across the edge, the cell may contain both sides of a small object.
    turn = np.maximum(np.abs(h_along), np.abs(h_across)) / np.sqrt(squared_gradient)
    has_line, crosses_cell = turn <= _MAX_TURN, np.abs(lines.c) < 1
    # A curved edge may cross a cell that its tangent misses.  The negated tests are True for NaN.
    may_cross = np.where(has_line, crosses_cell, ~(np.abs(center) > 1))
    is_curved = may_cross & ~(turn <= min(_TURN_PER_TOLERANCE * tolerance, _MAX_TURN))
    return lines.take(find(has_line & crosses_cell)), cell_index[find(is_curved)]


class InverseDepth(NamedTuple):
    """The faces at n hits, extended beyond their rims, in a form that is fast to intersect.

    A ray d from the eye meets a planar face, with the unit normal n and the hit p, at t d where
    1 / t = d . n / (n . p).
    """

    shapes: list[Shape]  # shapes with curved faces
    scaled_normal: Shaped[Triple, "n"]  # n / (n . p)
    curved_object: Shaped[Ints, "n"]  # object index of hits on curved faces; -1 for planar faces

    @classmethod
    def from_hits(cls, hits: Hits) -> InverseDepth:
        normal = np.empty(hits.from_eye.shape)
        curved_object = np.empty(hits.from_eye.shape[1], dtype=np.intp)
        for group in hits.groups:
            planes = group.planes
            run_object = np.where(planes.face_axis == NO_AXIS, group.run_object, -1)
            curved_object[group.interval] = group.repeat_runs(run_object)
            for axis, component in enumerate(planes.normal):
                normal[axis, group.interval] = group.expand_to_hits(component / -planes.eye_height)
        shapes = [shape for shape in hits.scene.shapes if shape.has_curved_face]
        return cls(shapes, (normal[0], normal[1], normal[2]), curved_object)

    def take(self, surface_index: Shaped[Ints, "m"]) -> InverseDepth:
        """Select faces by index."""
        normal = take(self.scaled_normal, surface_index)
        return InverseDepth(self.shapes, normal, self.curved_object[surface_index])

    def compute_inverse_t(self, ray: Shaped[Triple, "#6 n"]) -> Shaped[Floats, "6 n"]:
        """Compute 1 / t for six rays to each face, where t * ray is the point on the face."""
        inverse_t = dot(self.scaled_normal, ray)
        for shape in self.shapes:
            column = find(shape.objects.contains(self.curved_object))
            if column.size:
                curved_ray = take_columns(ray, column)
                inverse_t[:, column] = shape.compute_inverse_t(
                    CURVED_FACE, self.curved_object[column], curved_ray
                )
        return inverse_t
