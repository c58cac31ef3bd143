"""Edge functions: smooth signed functions on the picture that are zero at its edges.

(Pineda, A parallel algorithm for polygon rasterization, 1988.)  These are, of a ray from the eye,

    silhouette of a sphere    the angle between the ray and the sphere's centre, less its radius's
    silhouette of a box       n . ray, with the normal n of a plane through the apex and an edge
    where two surfaces meet   the difference of 1 / t, with the distances t along the ray
    terminator                the cosine between the normal and the direction to the light

The apex is the eye, or a light: then silhouettes are the edges of shadows, on the surface that a
cell sees, and the ray that counts leads from the light to that surface.

EdgeValues are evaluated at six points of a cell, which give gradient and second derivatives by
differences; `fit_lines` finds the straight lines c + a x + b y = 0 that stand for their zeros.
All vectors are in the camera's axes, seen from the eye.
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
    map3,
    ranges,
    run_lengths,
    run_starts,
    scaled,
    take3,
)
from tracer.geometry.camera import CameraFrame
from tracer.trace.hits import Hits

EdgeValues: TypeAlias = tuple[Ints, Floats]
"""Cells (n,), and edge functions at the six points of each (6, n); NaN where unknown."""

# The points: in the middle, half a cell to the right, left, below and above, and one corner.
_X = np.array([[0.0], [0.5], [-0.5], [0.0], [0.0], [0.5]])
_Y = np.array([[0.0], [0.0], [0.0], [0.5], [-0.5], [0.5]])

# A line that turns by less (in radians) across a cell can stand for what bends there.  It passes
# for straight if it turns by less than `_TURN` times the tolerance.  Found by trial.
_MOST_TURN, _TURN = 0.5, 500.0


class Lines(NamedTuple):
    """Lines c + a x + b y = 0 across cells.

    Attributes
    ----------
    cell : (n,)
        The cell that each lies in.
    a, b, c : (n,)
        So scaled that |a x + b y| is at most 1 in the cell, with a >= 0, or b > 0 if a is 0.
    """

    cell: Ints
    a: Floats
    b: Floats
    c: Floats

    @classmethod
    def joined(cls, lines: Iterable[Lines]) -> Lines:
        """All lines of some."""
        return cls._make(map(np.concatenate, zip(*lines, strict=True)))

    def take(self, index: Ints | slice) -> Lines:
        """Some of them."""
        return Lines._make(m[index] for m in self)

    def distinct(self) -> Lines:
        """Sort them by cell; of equal lines keep one.

        So the order in which they were found changes nothing.
        """
        lines = self.take(np.lexsort((self.c, self.b, self.a, self.cell)))
        return lines.take(indices(run_starts(*lines)))

    def first(self, most: int) -> Lines:
        """The first lines of each cell, at most so many; these are sorted."""
        return self.take(indices(ranges(0, run_lengths(self.cell)[1]) < most))


def rays(frame: CameraFrame, s: Floats, g: Floats, size: float) -> Triple:
    """Rays through the six points, three (6, n), of cells with (s, g, depth) through their middles.

    `size`: width of the cells, in pixels.
    """
    across, down = _X * (frame.step_u * size), _Y * (frame.step_v * size)
    return s + across, g + down, np.full((1, s.size), frame.depth)


def span(value: Floats) -> Floats:
    """Bound how far edge functions (6, ...) differ within a cell from its middle."""
    middle, right, left, below, above, corner = value
    linear = np.abs(right - left) + np.abs(below - above)
    bend = np.abs(right + left - 2 * middle) + np.abs(below + above - 2 * middle)
    twist = np.abs(corner - right - below + middle)
    most: Floats = 0.5 * linear + 0.5 * bend + twist
    return most


def fit_lines(edges: Iterable[EdgeValues], tolerance: float) -> tuple[Lines, Ints]:
    """Fit straight lines to edges; also return the cells of edges that are not straight.

    `tolerance`: by how much a cell's mean may be off, in radiance.

    An edge function is taken for c + g . x + x . H x / 2.  Straight down its slope, at x = s g,
    that is c + s g^2 + s^2 (g . H g) / 2, zero for s = -2 c / (g^2 + sqrt(g^4 - 2 c g . H g)): in
    this foot of the cell's middle, or as near to it as the cell reaches, it is linearised.  Along
    the tangent t (a unit vector) it changes by u^2 (t . H t) / 2: over the cell's length,
    -1/2 < u < 1/2, by t . H t / 24 on average, which is added to the line's c.  The zero's
    curvature, and so its turn over that length, is |t . H t| / |g|.
    """
    none: EdgeValues = np.zeros(0, dtype=np.intp), np.zeros((6, 0))
    lines, curved = zip(*(_fit(*some, tolerance) for some in chain([none], edges)), strict=True)
    return Lines.joined(lines), np.concatenate(curved)


def _fit(cell: Ints, value: Floats, tolerance: float) -> tuple[Lines, Ints]:
    # Whatever the unit of lengths, squares of squares stay within the range of numbers.
    value /= span(value)
    middle, right, left, below, above, corner = value
    a, b = right - left, below - above
    xx, yy = 4 * (right + left - 2 * middle), 4 * (below + above - 2 * middle)
    xy = 4 * (corner - right - below + middle)
    steep = a * a + b * b
    bend = (a * a * xx + 2 * a * b * xy + b * b * yy) / steep
    step = -2 * middle / (steep + np.sqrt(np.abs(steep * (steep - 2 * middle * bend))))
    most = 0.5 / np.maximum(np.abs(a), np.abs(b))
    step = np.clip(step, -most, most)
    x, y = step * a, step * b
    c = middle + a * x + b * y + 0.5 * (x * (xx * x + 2 * xy * y) + y * yy * y)
    a, b = a + xx * x + xy * y, b + xy * x + yy * y
    c -= a * x + b * y
    steep = a * a + b * b
    sag = (b * b * xx - 2 * a * b * xy + a * a * yy) / steep
    reach = 0.5 * (np.abs(a) + np.abs(b))
    sign = np.where((a < 0) | ((a == 0) & (b < 0)), -1.0, 1.0)
    lines = Lines(cell, *scaled((a, b, c + sag / 24), sign / reach))
    # Where the slope changes as much as that, the far side of what is small may be in the cell too.
    turn = np.maximum(np.abs(sag), np.abs(bend)) / np.sqrt(steep)
    straight, crosses = turn <= _MOST_TURN, np.abs(lines.c) < 1
    # Arcs may cross cells that their tangents miss; NaN rules nothing out.
    near = np.where(straight, crosses, ~(np.abs(middle) > 1))
    curved = near & ~(turn <= min(_TURN * tolerance, _MOST_TURN))
    return lines.take(indices(straight & crosses)), cell[indices(curved)]


class InverseDepth(NamedTuple):
    """Surfaces as the picture shows them: a ray d meets one at t, with 1 / t a function of d.

    A plane n . x = n . p has 1 / t = d . n / (n . p), a linear function.  A sphere of centre C, at
    |t d - C|^2 = r^2, has 1 / t = (d . C + sqrt((d . C)^2 - d^2 P)) / P, with P = C^2 - r^2: the
    near root, or with the eye inside (P < 0) the far one.  So for both, with k = n / (n . p) and
    w = 0, or k = C / P and w = 1 / P: 1 / t = k . d + sqrt((k . d)^2 - w d^2), without the root
    for planes.  A ray that misses the sphere counts as one that grazes it.

    Attributes
    ----------
    k : three (n,)
    w : (n,)
    """

    k: Triple
    w: Floats

    @classmethod
    def of(cls, hits: Hits) -> InverseDepth:
        """The surfaces (n,) that hits are on."""
        spheres = hits.prepared.spheres
        k, w = np.empty(hits.local.shape), np.zeros(hits.local.shape[1])
        for group in hits.groups:
            part = group.interval
            # Also where the eye is on a sphere: the plane that touches it where it is seen.
            for out, n in zip(k, group.normal, strict=True):
                out[part] = group.expand(n / -group.eye_height)
            if not group.shape.is_planar:
                power = group.per_sample(spheres.power)
                w[part] = np.where(power != 0, 1 / power, 0)
                for out, center in zip(k, spheres.local, strict=True):
                    np.divide(group.per_sample(center), power, out=out[part], where=power != 0)
        return cls((k[0], k[1], k[2]), w)

    def take(self, index: Ints) -> InverseDepth:
        """Some of them."""
        return InverseDepth(take3(self.k, index), self.w[index])

    def inverse(self, d: Triple) -> Floats:
        """1 / t (6, n) of rays, three (6, n)."""
        linear = dot(self.k, d)
        at = indices(self.w)
        if at.size:
            some = map3(lambda m: m[:, at], d)
            square = linear[:, at] ** 2 - self.w[at] * dot(some, some)
            linear[:, at] += np.sqrt(np.maximum(square, 0))
        return linear
