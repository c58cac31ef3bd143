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
"""Cells (n,) of n edges, and the values (6, n) of their edge functions at the six points of the
cell; NaN where unknown."""

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
    """Straight lines c + a x + b y = 0 that cross cells.

    The coordinates x and y are relative to the centre of the cell, in widths of the cell.

    Attributes
    ----------
    cell : (n,) int array
        The cell of each line.
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
        """Return the lines of all parts, one part after the other."""
        return cls._make(map(np.concatenate, zip(*parts, strict=True)))

    def take(self, index: Ints | slice) -> Lines:
        """Select lines by index."""
        return Lines._make(field[index] for field in self)

    def distinct(self) -> Lines:
        """Sort lines by cell and coefficients, and keep one of equal lines.

        So the order in which lines were found does not change the result.
        """
        lines = self.take(np.lexsort((self.c, self.b, self.a, self.cell)))
        return lines.take(indices(run_starts(*lines)))

    def first(self, max_lines: int) -> Lines:
        """Return the first `max_lines` lines of each cell; the lines must be sorted by cell."""
        return self.take(indices(join_ranges(0, run_lengths(self.cell)[1]) < max_lines))


def rays(frame: CameraFrame, x: Floats, y: Floats, cell_width: float) -> Triple:
    """Compute rays from the eye through the six points of cells.

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
    ray : tuple of three (6, n) or (1, n) float arrays
        Components of the rays; the third is the same for all six points.
    """
    across, down = _X * (frame.step_u * cell_width), _Y * (frame.step_v * cell_width)
    return x + across, y + down, np.full((1, x.size), frame.depth)


def value_range(values: Floats) -> Floats:
    """Bound the difference between an edge function in a cell and its value at the centre.

    Parameters
    ----------
    values : (6, ...) float array
        Values of the edge functions at the six points of their cells.

    Returns
    -------
    maximum : (...) float array
        Bound on the absolute difference, from the first and second differences.
    """
    center, right, left, below, above, corner = values
    linear = np.abs(right - left) + np.abs(below - above)
    quadratic = np.abs(right + left - 2 * center) + np.abs(below + above - 2 * center)
    mixed = np.abs(corner - right - below + center)
    return np.asarray(0.5 * linear + 0.5 * quadratic + mixed)


def fit_lines(edges: Iterable[EdgeValues], tolerance: float) -> tuple[Lines, Ints]:
    """Fit straight lines to edges, and find the cells of edges that are not straight.

    Parameters
    ----------
    edges : iterable of (cell, values)
        In batches: the cells (n,) of edges, and the values (6, n) of their edge functions.
    tolerance : float
        Maximum error of the mean radiance of a cell.

    Returns
    -------
    lines : Lines
        Lines that represent the edges, except for edges that certainly do not cross their cells,
        and for edges that turn too much.
    curved_cell : (k,) int array
        Cells with edges that are not straight, or are unknown.
    """
    no_edges: EdgeValues = np.zeros(0, dtype=np.intp), np.zeros((6, 0))
    fits = (_fit(cell, values, tolerance) for cell, values in chain([no_edges], edges))
    lines, curved_cell = zip(*fits, strict=True)
    return Lines.joined(lines), np.concatenate(curved_cell)


def _fit(cell: Ints, values: Floats, tolerance: float) -> tuple[Lines, Ints]:
    """Fit a straight line to each edge of one batch, and find the cells of curved edges.

    The edge function is approximated by f(x) = c + g . x + x . H x / 2, with the gradient g and the
    matrix H of second derivatives at the centre of the cell.  The line is computed in two steps:

    1. On the straight line x = s g through the centre, f is c + s g^2 + s^2 (g . H g) / 2.  It is
       zero for s = -2 c / (g^2 + sqrt(g^4 - 2 c g . H g)).  In this point, or the nearest point to
       it on x = s g in the cell, f is replaced by its tangent plane c + a x + b y.
    2. Along the unit vector t of the line, f differs from the tangent plane by u^2 (t . H t) / 2,
       at the distance u from the point.  This is t . H t / 24 on average, for -1/2 < u < 1/2, and
       is added to c.

    The curvature of the edge is |t . H t| / |g|, so this is also its turn over a length of 1.

    Parameters
    ----------
    cell : (n,) int array
        The cell of each edge.
    values : (6, n) float array
        Values of the edge functions at the six points of the cells.
    tolerance : float
        Maximum error of the mean radiance of a cell.

    Returns
    -------
    lines, curved_cell : Lines, (k,) int array
        See `fit_lines`.
    """
    # So powers of the derivatives are finite, whatever the scene's unit of length.
    center, right, left, below, above, corner = values / value_range(values)
    a, b = right - left, below - above
    xx, yy = 4 * (right + left - 2 * center), 4 * (below + above - 2 * center)
    xy = 4 * (corner - right - below + center)
    slope2 = a * a + b * b
    bend = (a * a * xx + 2 * a * b * xy + b * b * yy) / slope2
    step = -2 * center / (slope2 + np.sqrt(np.abs(slope2 * (slope2 - 2 * center * bend))))
    max_step = 0.5 / np.maximum(np.abs(a), np.abs(b))
    step = np.clip(step, -max_step, max_step)
    x, y = step * a, step * b
    c = center + a * x + b * y + 0.5 * (x * (xx * x + 2 * xy * y) + y * yy * y)
    a, b = a + xx * x + xy * y, b + xy * x + yy * y
    c -= a * x + b * y
    slope2 = a * a + b * b
    sag = (b * b * xx - 2 * a * b * xy + a * a * yy) / slope2
    maximum = 0.5 * (np.abs(a) + np.abs(b))
    sign = np.where((a < 0) | ((a == 0) & (b < 0)), -1.0, 1.0)
    lines = Lines(cell, *scale3((a, b, c + sag / 24), sign / maximum))
    # If the slope changes much across the edge, the far side of a small object may be in the cell.
    turn = np.maximum(np.abs(sag), np.abs(bend)) / np.sqrt(slope2)
    has_line, crosses = turn <= _MAX_TURN, np.abs(lines.c) < 1
    # A curved edge may cross a cell that its tangent misses.  NaN counts as an edge in the cell.
    is_near = np.where(has_line, crosses, ~(np.abs(center) > 1))
    is_curved = is_near & ~(turn <= min(_TURN_PER_TOLERANCE * tolerance, _MAX_TURN))
    return lines.take(indices(has_line & crosses)), cell[indices(is_curved)]


class InverseDepth(NamedTuple):
    """The surfaces at n hits as functions on the picture: 1 / t, where a ray meets them at t.

    A plane n . x = n . p has 1 / t = d . n / (n . p) for a ray d, which is a linear function.  A
    sphere |t d - C|^2 = r^2 with the centre C has 1 / t = (d . C + sqrt((d . C)^2 - d^2 P)) / P,
    with P = C^2 - r^2.  This is the near intersection or, if the eye is inside (P < 0), the far
    one.  Both are 1 / t = k . d + sqrt((k . d)^2 - w d^2):

    - for a plane, k = n / (n . p) and w = 0, without the square root;
    - for a sphere, k = C / P and w = 1 / P.

    A ray that misses the sphere counts as one that touches it.

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
        """Return the surfaces at n hits."""
        spheres = hits.prepared.spheres
        k, w = np.empty(hits.local.shape), np.zeros(hits.local.shape[1])
        for group in hits.groups:
            interval = group.interval
            # If the eye is on a sphere (P = 0), the tangent plane at the hit replaces the sphere.
            k[:, interval] = [group.per_hit(normal / -group.eye_height) for normal in group.normal]
            if not group.shape.is_planar:
                power = group.object_values(spheres.power)
                center = np.array([*map(group.object_values, spheres.local)])
                w[interval] = np.where(power != 0, 1 / power, 0)
                k[:, interval] = np.where(power != 0, center / power, k[:, interval])
        return cls((k[0], k[1], k[2]), w)

    def take(self, index: Ints) -> InverseDepth:
        """Select surfaces by index."""
        return InverseDepth(take3(self.k, index), self.w[index])

    def inverse(self, ray: Triple) -> Floats:
        """Compute 1 / t (6, n) for rays, whose three components are (6, n) float arrays.

        Column i contains six rays that meet the surface i.
        """
        values = dot(self.k, ray)
        index = indices(self.w)
        if index.size:
            sphere_ray = map3(lambda x: x[:, index], ray)
            square = values[:, index] ** 2 - self.w[index] * dot(sphere_ray, sphere_ray)
            values[:, index] += np.sqrt(np.maximum(square, 0))
        return values
