"""Edge functions: smooth functions on the picture that are zero at an edge (Pineda 1988).

The values of an edge function at six points of a cell (a pixel, or a square part of a pixel) give
its gradient and its second derivatives by differences.  `fit_lines` computes from them the straight
line that represents the edge in the cell, or finds that the edge is too curved for a line.

The edge functions are, of a ray from the eye:

==========================  ======================================================================
silhouette of a sphere      the angle between the ray and the direction to the sphere's centre,
                            minus the angular radius of the sphere
silhouette of a box         n . ray, with the normal n of the plane through the apex and an edge
intersection of surfaces,   the difference of 1 / t, where the ray meets the two surfaces at t
or crease                   times the ray
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

from tracer.arrays import (
    Floats,
    Ints,
    Triple,
    dot,
    indices,
    join_ranges,
    map3,
    run_lengths,
    run_starts,
    scale3,
    take3,
)
from tracer.geometry.camera import CameraFrame
from tracer.trace.hits import Hits

EdgeValues: TypeAlias = tuple[Ints, Floats]
"""Indices (n,) of the cells that n edges may cross, and the values (6, n) of the edge functions at
the six points of the cell; NaN where unknown."""

# The six points of a cell, in widths of the cell from its centre: the centre; the centres of the
# right, left, lower and upper side; and the lower right corner.
_X = np.array([[0.0], [0.5], [-0.5], [0.0], [0.0], [0.5]])
_Y = np.array([[0.0], [0.0], [0.0], [0.5], [-0.5], [0.5]])

# Maximum turn of an edge across a cell, in radians, for which a line represents the edge.  An edge
# that turns by less than `_TURN_PER_TOLERANCE` times the cell's tolerance in radiance counts as
# straight.  Tuned on the project's scenes: with half the maximum, errors of 4 samples per pixel are
# up to 1.6 times as large; half or twice the other number changes errors and times by 1 %.
_MAX_TURN, _TURN_PER_TOLERANCE = 0.5, 500.0


class Lines(NamedTuple):
    """Straight lines c + a x + b y = 0 that cross cells (pixels, or square parts of pixels).

    The coordinates x and y are relative to the centre of the cell, in widths of the cell.  The
    y-axis points down.

    Attributes
    ----------
    cell : (n,) int array
        Index of the cell that each line crosses.
    a, b, c : (n,) float arrays
        Coefficients, scaled so that the maximum of |a x + b y| in the cell is 1, with a > 0, or
        with a = 0 and b > 0.
    """

    cell: Ints
    a: Floats
    b: Floats
    c: Floats

    @classmethod
    def joined(cls, parts: Iterable[Lines]) -> Lines:
        """Concatenate one or more sets of lines, in the given order."""
        return cls._make(map(np.concatenate, zip(*parts, strict=True)))

    def take(self, index: Ints | slice) -> Lines:
        """Return the lines with the given indices, in their order."""
        return Lines._make(field[index] for field in self)

    def distinct(self) -> Lines:
        """Return the lines without duplicates, sorted by cell and then by coefficients.

        The result does not depend on the order in which the lines were found.
        """
        lines = self.take(np.lexsort((self.c, self.b, self.a, self.cell)))
        return lines.take(indices(run_starts(*lines)))

    def limit_per_cell(self, max_lines: int) -> Lines:
        """Return at most `max_lines` lines per cell, the first ones.

        The lines must be sorted by cell.
        """
        return self.take(indices(join_ranges(0, run_lengths(self.cell)[1]) < max_lines))


def cell_rays(frame: CameraFrame, x: Floats, y: Floats, cell_width: float) -> Triple:
    """Compute the rays from the eye through six points of each cell.

    A cell is a pixel, or a square part of a pixel.  The six points are, in this order: the centre;
    the centres of the right, left, lower and upper side; and the lower right corner.

    Parameters
    ----------
    frame : CameraFrame
        The camera.
    x, y : (n,) float arrays
        The vectors (x, y, frame.depth) are rays through the centres of the cells, in the axes of
        the camera.
    cell_width : float
        Width of the cells, in pixels.

    Returns
    -------
    ray_x, ray_y : (6, n) float arrays
        First and second components of the rays, in the axes of the camera.
    ray_z : (1, n) float array
        Third component of the rays, which is the same for all six points.
    """
    offset_x, offset_y = _X * (frame.step_u * cell_width), _Y * (frame.step_v * cell_width)
    return x + offset_x, y + offset_y, np.full((1, x.size), frame.depth)


def bound_variation(values: Floats) -> Floats:
    """Bound how far an edge function in a cell differs from its value at the cell's centre.

    A cell is a pixel, or a square part of a pixel.  An edge function is a smooth function on the
    picture that is zero at an edge.  Here it is approximated by the quadratic polynomial through
    its values at six points, so the bound ignores its third derivatives.

    Parameters
    ----------
    values : (6, ...) float array
        Values of edge functions at six points of their cells: the centre; the centres of the right,
        left, lower and upper side; and the lower right corner.

    Returns
    -------
    max_difference : (...) float array
        Upper bound on the absolute difference of the polynomial, anywhere in the cell, from its
        value at the centre.
    """
    center, right, left, below, above, corner = values
    linear = np.abs(right - left) + np.abs(below - above)
    quadratic = np.abs(right + left - 2 * center) + np.abs(below + above - 2 * center)
    mixed = np.abs(corner - right - below + center)
    return np.asarray(0.5 * linear + 0.5 * quadratic + mixed)


def fit_lines(edges: Iterable[EdgeValues], tolerance: float) -> tuple[Lines, Ints]:
    """Fit straight lines to edges in cells, and find the cells of edges that are not straight.

    A cell is a pixel, or a square part of a pixel.  Each edge is given by its edge function, which
    is a smooth function on the picture that is zero at the edge.

    Parameters
    ----------
    edges : iterable of (cell, values)
        Batches of edges.  `cell` (n,) contains the index of a cell for each edge.  `values` (6, n)
        contains the values of the edge function at six points of this cell: the centre; the centres
        of the right, left, lower and upper side; and the lower right corner.  Unknown values are
        NaN.
    tolerance : float
        Maximum error of the mean radiance of a cell.

    Returns
    -------
    lines : Lines
        A line for each edge that crosses its cell, except for edges that turn by more than
        `_MAX_TURN` radians.
    curved_cell : (k,) int array
        For each edge that no line represents within the tolerance, although it may cross its cell,
        the index of the cell.  Such an edge is too curved, or its function is unknown (NaN).  The
        index of a cell with several such edges is repeated.
    """
    no_edges: EdgeValues = np.zeros(0, dtype=np.intp), np.zeros((6, 0))
    fits = (_fit_batch(cell, values, tolerance) for cell, values in chain([no_edges], edges))
    lines, curved_cell = zip(*fits, strict=True)
    return Lines.joined(lines), np.concatenate(curved_cell)


def _fit_batch(cell: Ints, values: Floats, tolerance: float) -> tuple[Lines, Ints]:
    """Fit a straight line to each edge of one batch, and find the cells of curved edges.

    A cell is a pixel, or a square part of a pixel.  Each edge is given by its edge function f,
    which is a smooth function on the picture that is zero at the edge.  It is approximated by
    f(x) = c + g . x + x . H x / 2, with the gradient g and the matrix H of second derivatives at
    the centre of the cell.  The line is computed in two steps:

    1. On the straight line x = s g through the centre, f is c + s g^2 + s^2 (g . H g) / 2.  It is
       zero for s = -2 c / (g^2 + sqrt(g^4 - 2 c g . H g)).  At this point, or at the point of
       x = s g in the cell that is nearest to it, f is replaced by its tangent plane c + a x + b y.
    2. Along the unit vector t of the line c + a x + b y = 0, f differs from the tangent plane by
       u^2 (t . H t) / 2, at the distance u from the point.  The average for -1/2 < u < 1/2, which
       is t . H t / 24, is added to c.

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
        A line for each edge that crosses its cell, except for edges that turn by more than
        `_MAX_TURN` radians.
    curved_cell : (k,) int array
        For each edge that no line represents within the tolerance, although it may cross its cell,
        the index of the cell.  Such an edge is too curved, or its function is unknown (NaN).  The
        index of a cell with several such edges is repeated.
    """
    # Scale the values, so that powers of the derivatives are finite in any unit of length.
    center, right, left, below, above, corner = values / bound_variation(values)
    # The components (a, b) of the gradient g, and the elements of the matrix H.
    a, b = right - left, below - above
    h_xx, h_yy = 4 * (right + left - 2 * center), 4 * (below + above - 2 * center)
    h_xy = 4 * (corner - right - below + center)
    slope_squared = a * a + b * b
    # Second derivative in the direction of g: g . H g / g^2
    second_across = (a * a * h_xx + 2 * a * b * h_xy + b * b * h_yy) / slope_squared
    sqrt_term = np.sqrt(np.abs(slope_squared * (slope_squared - 2 * center * second_across)))
    s = -2 * center / (slope_squared + sqrt_term)
    max_s = 0.5 / np.maximum(np.abs(a), np.abs(b))
    s = np.clip(s, -max_s, max_s)
    x, y = s * a, s * b
    c = center + a * x + b * y + 0.5 * (x * (h_xx * x + 2 * h_xy * y) + y * h_yy * y)
    a, b = a + h_xx * x + h_xy * y, b + h_xy * x + h_yy * y
    c -= a * x + b * y
    slope_squared = a * a + b * b
    # Second derivative in the direction of t: t . H t
    second_along = (b * b * h_xx - 2 * a * b * h_xy + a * a * h_yy) / slope_squared
    max_linear = 0.5 * (np.abs(a) + np.abs(b))
    sign = np.where((a < 0) | ((a == 0) & (b < 0)), -1.0, 1.0)
    lines = Lines(cell, *scale3((a, b, c + second_along / 24), sign / max_linear))
    # If the slope changes much across the edge, the far side of a small object may be in the cell.
    turn = np.maximum(np.abs(second_along), np.abs(second_across)) / np.sqrt(slope_squared)
    has_line, crosses = turn <= _MAX_TURN, np.abs(lines.c) < 1
    # A curved edge may cross a cell that its tangent misses.  NaN counts as an edge in the cell.
    may_cross = np.where(has_line, crosses, ~(np.abs(center) > 1))
    is_curved = may_cross & ~(turn <= min(_TURN_PER_TOLERANCE * tolerance, _MAX_TURN))
    return lines.take(indices(has_line & crosses)), cell[indices(is_curved)]


class InverseDepth(NamedTuple):
    """The surfaces at n hits as functions on the picture: 1 / t, where a ray meets them at t.

    A plane n . x = n . p has 1 / t = d . n / (n . p) for a ray d, which is a linear function.  A
    sphere |t d - C|^2 = r^2 with the centre C has 1 / t = (d . C + sqrt((d . C)^2 - d^2 P)) / P,
    with P = C^2 - r^2.  This is the near intersection or, if the eye is inside (P < 0), the far
    one.  Both are 1 / t = k . d + sqrt((k . d)^2 - w d^2):

    - for a plane, k = n / (n . p) and w = 0, without the square root;
    - for a sphere, k = C / P and w = 1 / P.

    A ray that misses the sphere is treated as one that touches it.

    Attributes
    ----------
    k : tuple of three (n,) float arrays
        Components of k, in the axes of the camera.
    w : (n,) float array
        w; 0 for planes.
    """

    k: Triple
    w: Floats

    @classmethod
    def from_hits(cls, hits: Hits) -> InverseDepth:
        """Describe the surface at each hit, so that `evaluate` can intersect it with other rays.

        A ray d from the eye meets the surface at t d, with 1 / t = k . d + sqrt((k . d)^2 - w d^2).
        This method computes the vector k and the number w of each surface.

        Parameters
        ----------
        hits : Hits
            The n hits, on spheres or on faces of boxes.

        Returns
        -------
        surfaces : InverseDepth
            For a hit on a box, the plane of the face.  For a hit on a sphere, the sphere, or its
            tangent plane at the hit if the eye is on the sphere.  Planes have w = 0.
        """
        spheres = hits.prepared.spheres
        k, w = np.empty(hits.from_eye.shape), np.zeros(hits.from_eye.shape[1])
        for group in hits.groups:
            interval = group.interval
            # Planes.  If the eye is on a sphere, the tangent plane at the hit replaces the sphere.
            k[:, interval] = [group.per_hit(normal / -group.eye_height) for normal in group.normal]
            if not group.shape.is_planar:
                power_of_eye = group.object_values(spheres.power)
                center = np.array([*map(group.object_values, spheres.from_eye)])
                w[interval] = np.where(power_of_eye != 0, 1 / power_of_eye, 0)
                k[:, interval] = np.where(power_of_eye != 0, center / power_of_eye, k[:, interval])
        return cls((k[0], k[1], k[2]), w)

    def take(self, index: Ints) -> InverseDepth:
        """Return the surfaces with the given indices, in their order."""
        return InverseDepth(take3(self.k, index), self.w[index])

    def evaluate(self, ray: Triple) -> Floats:
        """Compute 1 / t for each of six rays per surface, where t times the ray is on the surface.

        The formula is 1 / t = k . d + sqrt((k . d)^2 - w d^2), for the ray d.  If the ray misses
        the sphere, the radicand is negative, and 0 replaces it.

        Parameters
        ----------
        ray : tuple of three (6, n) float arrays
            Components of rays from the eye, in the axes of the camera.  Column i contains six rays
            for surface i.  An array may have one row, which is then that of all six rays.

        Returns
        -------
        inverse_t : (6, n) float array
            1 / t of each ray.
        """
        inverse_t = dot(self.k, ray)
        sphere_index = indices(self.w)
        if sphere_index.size:
            d = map3(lambda component: component[:, sphere_index], ray)
            radicand = inverse_t[:, sphere_index] ** 2 - self.w[sphere_index] * dot(d, d)
            inverse_t[:, sphere_index] += np.sqrt(np.maximum(radicand, 0))
        return inverse_t
