"""Edge functions: smooth functions on the picture that are zero at an edge (Pineda 1988).

A cell is a pixel or a square part of a pixel.  An edge function is evaluated at six points of a
cell.  Differences of these values approximate its gradient and its second derivatives.  `fit_lines`
computes from them the straight line that represents the edge in the cell, or finds that the edge is
too curved for a line.

Each edge function is a function of the ray from the eye:

==========================  ======================================================================
silhouette of a sphere      the angle between the ray and the direction to the sphere's centre,
                            minus the angular radius of the sphere
silhouette of a box         n . ray, with the normal n of the plane through the apex and an edge
intersection of surfaces,   1 / t1 - 1 / t2, where the points t1 * ray and t2 * ray lie on the two
or crease                   surfaces
terminator                  the cosine between the normal and the direction to the light
==========================  ======================================================================

The *apex* of a silhouette is the eye or a light.  Silhouettes from a light are the edges of
shadows; the ray then leads from the light to the surface that is visible in the cell.

All vectors are in the axes of the camera, relative to the eye.

Pineda, A parallel algorithm for polygon rasterization, SIGGRAPH 1988.
"""

from __future__ import annotations

from collections.abc import Iterable
from itertools import chain
from typing import NamedTuple, TypeAlias

import numpy as np

from tracer.arrays import Floats, Ints, Triple, dot, indices, map3, mark_run_starts, scale3, take3
from tracer.geometry.camera import CameraFrame
from tracer.trace.hits import Hits

# For n edges, the index (n,) of the cell that each edge may cross, and the values (6, n) of its
# edge function at six points of the cell.  Unknown values are NaN.
EdgeValues: TypeAlias = tuple[Ints, Floats]

# The six points of a cell relative to its centre, in units of the cell's width: the centre; the
# centres of the right, left, lower and upper side; and the lower right corner.
_POINT_X = np.array([[0.0], [0.5], [-0.5], [0.0], [0.0], [0.5]])
_POINT_Y = np.array([[0.0], [0.0], [0.0], [0.5], [-0.5], [0.5]])

# A line represents an edge that turns across the cell by at most the first number, in radians.  The
# edge counts as straight if it turns by at most the second number times the cell's tolerance in
# radiance.  Tuned on the project's scenes: with half the first number, errors of 4 samples per
# pixel are up to 1.6 times as large; half or twice the second changes errors and times by 1 %.
_MAX_TURN, _TURN_PER_TOLERANCE = 0.5, 500.0


class Lines(NamedTuple):
    """Straight lines c + a x + b y = 0 that cross cells (pixels, or square parts of pixels).

    The coordinates x and y are relative to the centre of the cell, in units of the cell's width.
    The y-axis points down.

    Attributes
    ----------
    cell : (n,) int array
        Index of the cell that each line crosses.
    a, b, c : (n,) float arrays
        Coefficients, scaled so that the maximum of |a x + b y| in the cell is 1, and that a > 0 (or
        b > 0 if a = 0).
    """

    cell: Ints
    a: Floats
    b: Floats
    c: Floats

    @classmethod
    def joined(cls, line_sets: Iterable[Lines]) -> Lines:
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
        selected : Lines
            The k selected lines, in the order of `line_index`.
        """
        return Lines._make(field[line_index] for field in self)

    def distinct(self) -> Lines:
        """Sort the lines by cell and then by coefficients, and remove duplicates.

        The result does not depend on the order in which the lines were found.

        Returns
        -------
        lines : Lines
            The sorted lines without duplicates.
        """
        sorted_lines = self.take(np.lexsort((self.c, self.b, self.a, self.cell)))
        return sorted_lines.take(indices(mark_run_starts(*sorted_lines)))

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
        position_in_cell = np.arange(self.cell.size) - self.cell.searchsorted(self.cell)
        return self.take(indices(position_in_cell < max_lines))


def cell_rays(
    frame: CameraFrame, center_right: Floats, center_down: Floats, cell_width: float
) -> Triple:
    """Compute the rays from the eye through six points of each of n cells.

    A cell is a pixel, or a square part of a pixel.  The six points are, in this order: the centre;
    the centres of the right, left, lower and upper side; and the lower right corner.

    Parameters
    ----------
    frame : CameraFrame
        The camera.
    center_right, center_down : (n,) float arrays
        Rightward and downward components of the ray through the centre of each cell.  The forward
        component of all rays is `frame.depth`.
    cell_width : float
        Width of the cells, in pixels.

    Returns
    -------
    ray_right, ray_down : (6, n) float arrays
        Rightward and downward components of the rays.
    ray_forward : (1, n) float array
        Forward component of the rays, which is the same for all six points.
    """
    offset_right = _POINT_X * (frame.pixel_width * cell_width)
    offset_down = _POINT_Y * (frame.pixel_height * cell_width)
    ray_forward = np.full((1, center_right.size), frame.depth)
    return center_right + offset_right, center_down + offset_down, ray_forward


def bound_variation(values: Floats) -> Floats:
    """Bound how far edge functions deviate, within a cell, from their values at its centre.

    A cell is a pixel, or a square part of a pixel.  An edge function is a smooth function on the
    picture that is zero at an edge.  Here it is approximated by the quadratic polynomial through
    its values at six points, so the bound ignores its third derivatives.

    Parameters
    ----------
    values : (6, ...) float array
        Values of each edge function at six points of a cell: the centre; the centres of the right,
        left, lower and upper side; and the lower right corner.

    Returns
    -------
    max_deviation : (...) float array
        Upper bound on the absolute difference between the polynomial at any point of the cell and
        its value at the centre.
    """
    center, right, left, lower, upper, corner = values
    linear_part = np.abs(right - left) + np.abs(lower - upper)
    square_part = np.abs(right + left - 2 * center) + np.abs(lower + upper - 2 * center)
    mixed_part = np.abs(corner - right - lower + center)
    return np.asarray(0.5 * linear_part + 0.5 * square_part + mixed_part)


def fit_lines(edges: Iterable[EdgeValues], tolerance: float) -> tuple[Lines, Ints]:
    """Fit straight lines to edges in cells, and list the cells of curved edges.

    A cell is a pixel, or a square part of a pixel.  Each edge is given by its edge function, which
    is a smooth function on the picture that is zero at the edge.

    Parameters
    ----------
    edges : iterable of (cell, values)
        Batches of n edges.  `cell` (n,) contains the index of the cell that each edge may cross.
        `values` (6, n) contains the values of the edge function at six points of this cell: the
        centre; the centres of the right, left, lower and upper side; and the lower right corner.
        Unknown values are NaN.
    tolerance : float
        Maximum error of the mean radiance of a cell.

    Returns
    -------
    lines : Lines
        One line for each edge that crosses its cell.  Edges that turn by more than `_MAX_TURN`
        radians have no line.
    curved_cell : (k,) int array
        Indices of cells that a curved edge may cross: one index for each edge that no line
        represents within the tolerance, or whose edge function is unknown (NaN).
    """
    no_edges: EdgeValues = np.zeros(0, dtype=np.intp), np.zeros((6, 0))
    fits = (_fit_batch(cell, values, tolerance) for cell, values in chain([no_edges], edges))
    lines, curved_cell = zip(*fits, strict=True)
    return Lines.joined(lines), np.concatenate(curved_cell)


def _fit_batch(cell: Ints, values: Floats, tolerance: float) -> tuple[Lines, Ints]:
    """Fit a straight line to each of n edges, and list the cells of curved edges.

    A cell is a pixel, or a square part of a pixel.  Each edge is given by its edge function f,
    which is a smooth function on the picture that is zero at the edge.  It is approximated by
    f(x) = c + g . x + x . H x / 2, with the gradient g and the matrix H of second derivatives at
    the centre of the cell.  The line is computed in two steps:

    1. On the straight line x = s g through the centre, f is c + s g^2 + s^2 (g . H g) / 2.  It is
       zero for s = -2 c / (g^2 + sqrt(g^4 - 2 c g . H g)).  If this point is outside the cell, it
       is moved along x = s g to the border.  At the point, f is replaced by its tangent plane
       c + a x + b y.
    2. Along the line c + a x + b y = 0, whose unit vector is t, f differs from the tangent plane by
       u^2 (t . H t) / 2 at the distance u from the point.  The mean of this difference over
       -1/2 < u < 1/2, which is t . H t / 24, is added to c.

    The curvature of the edge is |t . H t| / |g|.  This is also the angle, in radians, by which the
    edge turns over a length of 1.

    Parameters
    ----------
    cell : (n,) int array
        Index of the cell that each edge may cross.
    values : (6, n) float array
        Values of the edge functions at six points of the cell: the centre; the centres of the
        right, left, lower and upper side; and the lower right corner.  Unknown values are NaN.
    tolerance : float
        Maximum error of the mean radiance of a cell.

    Returns
    -------
    lines : Lines
        One line for each edge that crosses its cell.  Edges that turn by more than `_MAX_TURN`
        radians have no line.
    curved_cell : (k,) int array
        Indices of cells that a curved edge may cross: one index for each edge that no line
        represents within the tolerance, or whose edge function is unknown (NaN).
    """
    # Scale the values so that powers of the derivatives are finite in any unit of length.
    center, right, left, lower, upper, corner = values / bound_variation(values)
    # The components (a, b) of the gradient g, and the elements of the matrix H.
    a, b = right - left, lower - upper
    h_xx, h_yy = 4 * (right + left - 2 * center), 4 * (lower + upper - 2 * center)
    h_xy = 4 * (corner - right - lower + center)
    slope_squared = a * a + b * b
    # Second derivative in the direction of g: g . H g / g^2
    second_across = (a * a * h_xx + 2 * a * b * h_xy + b * b * h_yy) / slope_squared
    sqrt_term = np.sqrt(np.abs(slope_squared * (slope_squared - 2 * center * second_across)))
    s = -2 * center / (slope_squared + sqrt_term)
    s_at_border = 0.5 / np.maximum(np.abs(a), np.abs(b))
    s = np.clip(s, -s_at_border, s_at_border)
    x, y = s * a, s * b
    c = center + a * x + b * y + 0.5 * (x * (h_xx * x + 2 * h_xy * y) + y * h_yy * y)
    a, b = a + h_xx * x + h_xy * y, b + h_xy * x + h_yy * y
    c -= a * x + b * y
    slope_squared = a * a + b * b
    # Second derivative in the direction of t: t . H t
    second_along = (b * b * h_xx - 2 * a * b * h_xy + a * a * h_yy) / slope_squared
    max_slope_term = 0.5 * (np.abs(a) + np.abs(b))
    sign = np.where((a < 0) | ((a == 0) & (b < 0)), -1.0, 1.0)
    lines = Lines(cell, *scale3((a, b, c + second_along / 24), sign / max_slope_term))
    # If the slope changes much across the edge, the cell may contain both sides of a small object.
    turn = np.maximum(np.abs(second_along), np.abs(second_across)) / np.sqrt(slope_squared)
    has_line, crosses = turn <= _MAX_TURN, np.abs(lines.c) < 1
    # A curved edge may cross a cell that its tangent misses.  The comparison is True for NaN.
    may_cross = np.where(has_line, crosses, ~(np.abs(center) > 1))
    is_curved = may_cross & ~(turn <= min(_TURN_PER_TOLERANCE * tolerance, _MAX_TURN))
    return lines.take(indices(has_line & crosses)), cell[indices(is_curved)]


class InverseDepth(NamedTuple):
    """The surfaces at n hits, given by 1 / t as a function of the ray that meets them at t * ray.

    Let d be a ray from the eye, and t d the point where it meets the surface.

    - A plane n . x = n . p has 1 / t = d . n / (n . p), which is a linear function of d.
    - A sphere |t d - C|^2 = r^2 with the centre C has 1 / t = (d . C + sqrt((d . C)^2 - d^2 P)) / P
      with P = C^2 - r^2.  This is the near intersection or, if the eye is inside (P < 0), the far
      one.

    Both have the form 1 / t = k . d + sqrt((k . d)^2 - w d^2), with

    - k = n / (n . p) and w = 0 for a plane, without the square root;
    - k = C / P and w = 1 / P for a sphere.

    A ray that misses the sphere is treated as one that touches it.

    Attributes
    ----------
    linear : tuple of three (n,) float arrays
        Components of the vector k of each surface, in the axes of the camera.
    quadratic : (n,) float array
        The number w of each surface; 0 for planes.
    """

    linear: Triple
    quadratic: Floats

    @classmethod
    def from_hits(cls, hits: Hits) -> InverseDepth:
        """Describe the surface at each hit, so that other rays can be intersected with it.

        A ray d from the eye meets the surface at t d, with 1 / t = k . d + sqrt((k . d)^2 - w d^2).
        This method computes the vector k (`linear`) and the number w (`quadratic`).

        Parameters
        ----------
        hits : Hits
            The n hits, on spheres or on faces of boxes.

        Returns
        -------
        surfaces : InverseDepth
            The plane of the face for each hit on a box, and the sphere for each hit on a sphere.
            If the eye is on the sphere, the tangent plane at the hit replaces the sphere.  Planes
            have w = 0.
        """
        spheres = hits.scene.spheres
        linear, quadratic = np.empty(hits.from_eye.shape), np.zeros(hits.from_eye.shape[1])
        for group in hits.groups:
            batch = group.interval
            # Start with tangent planes.  Spheres replace them unless the eye is on the sphere.
            linear[:, batch] = [group.expand(part / -group.eye_height) for part in group.normal]
            if not group.shape.is_planar:
                sphere_index = spheres.objects.positions(group.repeat_runs(group.run_object))
                power = spheres.power[sphere_index]  # P = C^2 - r^2, with centre C and radius r
                center = np.array(take3(spheres.from_eye, sphere_index))
                quadratic[batch] = np.where(power != 0, 1 / power, 0)
                linear[:, batch] = np.where(power != 0, center / power, linear[:, batch])
        return cls((linear[0], linear[1], linear[2]), quadratic)

    def take(self, surface_index: Ints) -> InverseDepth:
        """Select surfaces by index.

        Parameters
        ----------
        surface_index : (m,) int array
            Indices of the surfaces to select.

        Returns
        -------
        selected : InverseDepth
            The m selected surfaces, in the order of `surface_index`.
        """
        return InverseDepth(take3(self.linear, surface_index), self.quadratic[surface_index])

    def compute_inverse_t(self, ray: Triple) -> Floats:
        """Compute 1 / t for six rays per surface, where the point t * ray lies on the surface.

        For the ray d, 1 / t = k . d + sqrt((k . d)^2 - w d^2).  The vector k (`linear`) and the
        number w (`quadratic`) describe the surface.  Planes have w = 0, and no square root.  If a
        ray misses a sphere, the radicand is negative, and is replaced by 0.

        Parameters
        ----------
        ray : tuple of three (6, n) float arrays
            Components of rays from the eye, in the axes of the camera.  Column i contains six rays
            for surface i.  An array with a single row applies to all six rays.

        Returns
        -------
        inverse_t : (6, n) float array
            1 / t of each ray.
        """
        inverse_t = dot(self.linear, ray)
        on_sphere = indices(self.quadratic)
        if on_sphere.size:
            d = map3(lambda component: component[:, on_sphere], ray)
            radicand = inverse_t[:, on_sphere] ** 2 - self.quadratic[on_sphere] * dot(d, d)
            inverse_t[:, on_sphere] += np.sqrt(np.maximum(radicand, 0))
        return inverse_t
