"""Margins: smooth functions on the picture whose zeros are the edges that it shows.

Every edge is where some signed quantity of a ray from the eye, its *margin*, is zero:

    silhouette of a sphere    the angle between the ray and the sphere's centre, less its radius's
    silhouette of a box       n . ray, with a plane's normal n through the apex and a box's edge
    where two surfaces meet   the difference of 1 / t, with the distances t along the ray
    terminator                the cosine between the normal and the direction to the light

The apex is the eye, or a light: then silhouettes are the edges of shadows, on the surface that a
cell sees, and the ray that counts leads from the light to that surface.

Margins are evaluated at six points of a cell, which give gradient and second derivatives by
differences; `fitted` finds the straight lines c + a x + b y = 0 that stand for them.
All vectors are in the camera's axes, seen from the eye.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from tracer.antialias.lines import Kind, Lines
from tracer.arrays import Floats, Ints, Triple, cross, dot, each, indices, pick
from tracer.view.camera import Raster
from tracer.view.hits import Visible

__all__ = [
    "Margins",
    "Sheets",
    "box_margins",
    "fitted",
    "joined",
    "rays",
    "sheets",
    "sphere_margins",
    "terminator_margins",
]

# The points: in the middle, half a cell to the right, left, below and above, and one corner.
_X = np.array([[0.0], [0.5], [-0.5], [0.0], [0.0], [0.5]])
_Y = np.array([[0.0], [0.0], [0.0], [0.5], [-0.5], [0.5]])

# A line that turns by less (in radians) across a cell can stand for what bends there.  It passes
# for straight if it turns by less than this times the tolerance: the silhouette of a sphere, on
# which light falls off towards it, or any other line.  Found by trial.
_MOST_TURN = 0.5
_SILHOUETTE_TURN, _TURN = 57.0, 400.0


class Margins(NamedTuple):
    """Margins of edges in cells.

    Attributes
    ----------
    cell : (n,)
    kind : (n,)
        What the edge divides.
    value : (6, n)
        At the six points; NaN where there is no telling.
    """

    cell: Ints
    kind: Ints
    value: Floats


def joined(margins: Iterable[Margins]) -> Margins:
    """All of them as one `Margins`."""
    none = np.zeros(0, dtype=np.intp)
    cell, kind, value = zip(Margins(none, none, np.zeros((6, 0))), *margins, strict=True)
    return Margins(np.concatenate(cell), np.concatenate(kind), np.concatenate(value, axis=1))


def fitted(margins: Margins, tolerance: float) -> tuple[Lines, Ints]:
    """Straight lines through cells, and the cells of margins that are no straight lines.

    `tolerance`: by how much a cell's mean may be off, in radiance.

    A margin is taken for c + g . x + x . H x / 2.  Straight down its slope, at x = s g, that is
    c + s g^2 + s^2 (g . H g) / 2, zero for s = -2 c / (g^2 + sqrt(g^4 - 2 c g . H g)): in this
    foot of the cell's middle, or as near to it as the cell reaches, the margin is linearised.
    Along the tangent t (a unit vector) it changes by u^2 (t . H t) / 2: over the cell's length,
    -1/2 < u < 1/2, by t . H t / 24 on average, which is added to the line's c.  The zero's
    curvature, and so its turn over that length, is |t . H t| / |g|.
    """
    cell, kind, value = margins
    # Whatever the unit of lengths, squares of squares stay within the range of numbers.
    value = value / reach(value)
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
    # Where the slope changes as much as that, the far side of what is small may be in the cell too.
    turn = np.maximum(np.abs(sag), np.abs(bend)) / np.sqrt(steep)
    lines = Lines(cell, kind, a, b, c + sag / 24)
    straight = turn <= _MOST_TURN
    crosses = lines.crosses()
    # Arcs may cross cells that their tangents miss; NaN rules nothing out.
    near = np.where(straight, crosses, ~(np.abs(middle) > 1))
    most = np.where(kind == Kind.SILHOUETTE, _SILHOUETTE_TURN, _TURN) * tolerance
    curved = near & ~(turn <= np.minimum(most, _MOST_TURN))
    return lines.take(indices(straight & crosses)), cell[indices(curved)]


def reach(value: Floats) -> Floats:
    """How far margins (..., 6, n) differ within a cell from those in its middle, at most."""
    middle, right, left, below, above, corner = np.moveaxis(value, -2, 0)
    linear = np.abs(right - left) + np.abs(below - above)
    bend = np.abs(right + left - 2 * middle) + np.abs(below + above - 2 * middle)
    twist = np.abs(corner - right - below + middle)
    most: Floats = 0.5 * linear + 0.5 * bend + twist
    return most


def rays(raster: Raster, s: Floats, g: Floats, size: float) -> Triple:
    """Rays through the six points, three (6, n), of cells with (s, g, depth) through their middles.

    `size`: width of the cells, in pixels.
    """
    across, down = _X * (raster.step_u * size), _Y * (raster.step_v * size)
    return s + across, g + down, np.full(s.size, raster.depth)


class Sheets(NamedTuple):
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

    def take(self, index: Ints) -> Sheets:
        """Some of them."""
        return Sheets(pick(self.k, index), self.w[index])

    def inverse(self, d: Triple) -> Floats:
        """1 / t (6, n) of rays, three (6, n)."""
        linear = dot(self.k, d)
        at = indices(self.w)
        if at.size:
            d = d[0][:, at], d[1][:, at], d[2][at]
            square = linear[:, at] ** 2 - self.w[at] * dot(d, d)
            linear[:, at] += np.sqrt(np.maximum(square, 0))
        return linear


def sheets(hits: Visible) -> Sheets:
    """The surfaces (n,) that all hits are on."""
    spheres = hits.view.spheres
    k, w = np.empty(hits.p.shape), np.zeros(hits.p.shape[1])
    for group in hits.groups:
        part = group.part
        if group.flat:
            for out, component in zip(k, group.n, strict=True):
                out[part] = component / -group.height
            continue
        power = group.of(spheres.power)
        w[part] = 1 / power
        for out, center in zip(k, spheres.local, strict=True):
            out[part] = group.of(center) / power
        # The eye is on these, and where they are seen the plane that touches them stands for them.
        touched = part.start + indices(np.broadcast_to(power == 0, w[part].shape))
        if touched.size:
            p, n = hits.p[:, touched], pick(group.n, touched - part.start)
            k[:, touched], w[touched] = np.array(n) / dot(n, (p[0], p[1], p[2])), 0
    return Sheets((k[0], k[1], k[2]), w)


def sphere_margins(q: Triple, center: Triple, radius: Floats, power: Floats) -> Floats:
    """Margins (6, n) of spheres' silhouettes: negative where rays q meet them.

    `center`: as seen from the rays' apex; `power`: its squared length, less the squared radius.
    """
    aside = cross(center, q)
    angle = np.arctan2(np.sqrt(dot(aside, aside)), dot(center, q))
    margins: Floats = angle - np.arctan2(radius, np.sqrt(power))
    return margins


def box_margins(planes: Triple, q: Triple) -> tuple[Ints, Floats]:
    """Margins (6, m) of those edges of boxes' silhouettes that may cross cells, and whose (m,).

    `planes`: the normals, three (6, n), as `silhouette_planes` has them, pointing inwards.
    """
    value = np.array([dot(normal, q) for normal in zip(*planes, strict=True)])
    most, middle = reach(value), value[:, 0]
    # An edge ends where the planes beside it begin.
    near = (np.abs(middle) <= most) & (middle >= -most).all(axis=0)
    # A silhouette of four edges has the first two again as its last.
    near[4:] &= np.any([m[4:] != m[:2] for m in planes], axis=0)
    edge, at = near.nonzero()
    return at, value[edge, :, at].T


def terminator_margins(d: Triple, inverse: Floats, center: Triple, light: Triple) -> Floats:
    """Margins (6, n) of spheres' terminators: the cosine of n and l, where rays d meet spheres."""
    n = each(lambda d, c: d - c * inverse, d, center)
    to_light = each(lambda d, c: c * inverse - d, d, light)
    cosine: Floats = dot(n, to_light) / np.sqrt(dot(n, n) * dot(to_light, to_light))
    return cosine
