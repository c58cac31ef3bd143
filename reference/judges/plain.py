"""The format's picture by the plainest means: all rays against all objects.  Read this first.

Of the tracer it knows nothing but the scene, so that it can judge it: in decimals of 80 digits it
is the oracle.  Lengths that agree to 50 digits are equal, since the scene's own numbers have 16:
contact and ties are decided exactly.  In float32, with the textbook's quadratic or with an epsilon
for shadows, it is what the stability chart (`reference.stability`) shows to fail.

The nearest root t > 0 of a camera ray is seen; of equal ones the first in the file, and of faces
of a box that of the first axis.  With the eye inside an object, or on it, that is the far root, and
the normal points inwards.
"""

from __future__ import annotations

import decimal
from collections.abc import Callable, Sequence
from decimal import Decimal
from functools import partial
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tracer import Phong, Scene, Sphere

Array: TypeAlias = NDArray[Any]
"""Numbers of any arithmetic: float32, float64, or Decimal objects.  Vectors are (3, n)."""

_DECIMALS = decimal.Context(prec=80, Emax=decimal.MAX_EMAX, Emin=decimal.MIN_EMIN, traps=[])


ARITHMETICS: dict[str, tuple[Callable[[ArrayLike], Any], float]] = {
    "float64": (partial(np.asarray, dtype=np.float64), 0),
    "float32": (partial(np.asarray, dtype=np.float32), 0),
    "decimal": (lambda v: np.frompyfunc(Decimal, 1, 1)(np.asarray(v, dtype=np.float64)), 1e-50),
}
"""A cast to the numbers to compute in; and the length, relative to the scene's, that is none."""


def _dot(a: Array, b: Array) -> Any:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _norm(a: Array) -> Any:
    return np.sqrt(_dot(a, a))


def _unit(a: Array) -> Any:
    return a / _norm(a)


def closest_approach(o: Array, d: Array, c: Array, r: Array) -> tuple[Array, Array]:
    """Haines, Günther and Akenine-Möller (Ray Tracing Gems, ch. 7): error grows as eps D.

    The roots' stable form (Numerical Recipes, 5.6) does not cancel on huge spheres.
    """
    m = c - o
    a, b = _dot(d, d), _dot(m, d)
    offset = m - b / a * d
    root = np.sqrt(a * (r * r - _dot(offset, offset)))
    q = np.where(b < 0, b - root, b + root)
    first, second = q / a, (_dot(m, m) - r * r) / q
    return np.minimum(first, second), np.maximum(first, second)


def textbook(o: Array, d: Array, c: Array, r: Array) -> tuple[Array, Array]:
    """The quadratic formula as most textbooks print it: error grows as eps D^2."""
    m = o - c
    return _quadratic(_dot(d, d), 2 * _dot(m, d), _dot(m, m) - r * r)


def expanded(o: Array, d: Array, c: Array, r: Array) -> tuple[Array, Array]:
    """The same with |o - c|^2 multiplied out: error grows as the square of an offset, too."""
    away2 = _dot(o, o) - 2 * _dot(o, c) + _dot(c, c)
    return _quadratic(_dot(d, d), 2 * (_dot(o, d) - _dot(c, d)), away2 - r * r)


def _quadratic(a: Array, b: Array, c: Array) -> tuple[Array, Array]:
    root = np.sqrt(b * b - 4 * a * c)
    return (-b - root) / (2 * a), (-b + root) / (2 * a)


SPHERES = {"closest": closest_approach, "textbook": textbook, "expanded": expanded}
"""From origin, direction, centre and radius to near and far t; NaN where the ray misses."""

SHADOWS: dict[str, Callable[[Array, Array], tuple[Array, float]]] = {
    "exact": lambda p, n: (p, 0),
    "t>0": lambda p, n: (p, 0),
    "t>1e-4": lambda p, n: (p, 1e-4),
    "t>1e-6": lambda p, n: (p, 1e-6),
    "normal": lambda p, n: (p + 1e-4 * n, 0),
    # Wächter and Binder (Ray Tracing Gems, ch. 6), with their constants.
    "ulps": lambda p, n: (
        p + n * np.where(np.abs(p) < 1 / 32, 1 / 65536, 256 * np.spacing(np.abs(p))),
        0,
    ),
}
"""From point and normal to where the shadow ray starts, and the least length t that blocks.

The first leaves out the own object, which is exact, since all are convex.
"""


# Of equal roots the first or the last is seen, in the order of the file, or of a box's axes.
_USUAL = {"arithmetic": "float64", "spheres": "closest", "shadows": "exact", "ties": "first"}


class Seen(NamedTuple):
    """Views of n rays: linear RGB, the surface's place in the file or -1, lights that reach it."""

    radiance: NDArray[np.float64]
    surface: NDArray[np.intp]
    lit: NDArray[np.bool_]  # (lights, n)


class _Plain:
    """A scene in numbers of one arithmetic, with the methods to trace it by."""

    def __init__(
        self, scene: Scene, arithmetic: str, spheres: str, shadows: str, ties: str
    ) -> None:
        self.scene, self.surfaces, self.exact = scene, scene.surfaces[:], shadows == "exact"
        self.last = ties == "last"
        self.cast, contact = ARITHMETICS[arithmetic]
        self.roots, self.start = SPHERES[spheres], SHADOWS[shadows]
        self.eye = self.cast(scene.camera.view_point)[:, None]
        self.lights = [self.cast(light.position)[:, None] for light in scene.lights]
        self.is_sphere = [isinstance(s, Sphere) for s in self.surfaces]
        # Centre and radius, or lowest and highest corner.
        pairs = [
            (s.center, [s.radius]) if isinstance(s, Sphere) else (s.min_pt, s.max_pt)
            for s in self.surfaces
        ]
        self.shapes = [(self.cast(a)[:, None], self.cast(b)[:, None]) for a, b in pairs]
        lengths = [self.eye, *self.lights, *(v for pair in self.shapes for v in pair)]
        self.contact = self.cast(contact)
        self.scale = max(np.abs(v).max() for v in lengths)
        self.none = self.contact * self.scale
        self.inside = [bool(self.side(i, self.eye)[0] <= 0) for i in range(len(self.shapes))]

    def zeroed(self, v: Array, scale: Array) -> Array:
        """Numbers of which those that are none beside `scale` become 0."""
        return np.where(np.abs(v) <= self.contact * scale, self.cast(0), v) if self.contact else v

    def side(self, i: int, p: Array) -> Array:
        """Signed distance of points from a surface: 0 on it, negative inside."""
        a, b = self.shapes[i]
        gap = _norm(p - a) - b[0] if self.is_sphere[i] else np.maximum(a - p, p - b).max(axis=0)
        return self.zeroed(gap, self.scale)

    def rays(self, x: Array, y: Array) -> Array:
        """Return directions (3, n) from the eye to the window, for places in pixels."""
        cast, camera = self.cast, self.scene.camera
        width, height = self.scene.width, self.scene.height
        ahead, w = _unit(cast(camera.view_dir)), _unit(cast(camera.normal))
        w = -w if _dot(w, ahead) > 0 else w
        u = _unit(np.cross(cast(camera.view_up), w))
        right = cast(2 * x - width) / (2 * width) * cast(camera.view_width)
        up = cast(height - 2 * y) / (2 * height) * cast(camera.view_height)
        middle = ahead[:, None] * cast(camera.proj_distance)
        d = middle + np.outer(u, right) + np.outer(np.cross(w, u), up)
        # What nearly lies in a plane of two axes lies in it.
        return self.zeroed(d, np.abs(d).max(axis=0))

    def slabs(self, i: int, o: Array, d: Array, closed: bool) -> tuple[Array, Array]:
        """Return t (3, n) at which rays enter and leave a box, closed or open, along each axis."""
        low, high = (self.zeroed(v - o, self.scale) for v in self.shapes[i])
        between = (low <= 0) & (high >= 0) if closed else (low < 0) & (high > 0)
        along = np.where(between, self.cast(np.inf), self.cast(-np.inf))
        a, b = low / d, high / d
        near, far = np.minimum(a, b), np.maximum(a, b)
        return np.where(d == 0, -along, near), np.where(d == 0, along, far)

    def intersect(self, i: int, o: Array, d: Array, closed: bool) -> tuple[Array, Array]:
        """Near and far t (n,) of rays with a surface; near <= far unless they miss."""
        if self.is_sphere[i]:
            return self.roots(o, d, self.shapes[i][0], self.shapes[i][1][0])
        near, far = self.slabs(i, o, d, closed)
        return near.max(axis=0), far.min(axis=0)

    def trace(self, x: Array, y: Array) -> Seen:
        """Find what rays see, and shade it."""
        d = self.rays(x, y)
        nearest, owner = np.broadcast_to(self.cast(np.inf), x.size), np.full(x.size, -1)
        length = _norm(d)
        order = [*enumerate(self.inside)]
        for i, inside in reversed(order) if self.last else order:
            near, far = self.intersect(i, self.eye, d, closed=True)
            t = far if inside else near
            ahead = (near <= far) & (t * length > self.none)
            closer = ahead & (t < nearest * (1 - self.contact))
            nearest, owner = np.where(closer, t, nearest), np.where(closer, i, owner)

        seen = np.flatnonzero(owner >= 0)
        own, d = owner[seen], d.take(seen, 1)
        p = self.eye + nearest[seen] * d
        n = np.zeros_like(p)
        for i in np.unique(own).tolist():
            mine = np.flatnonzero(own == i)
            p[:, mine], n[:, mine] = self.settle(i, p.take(mine, 1), d.take(mine, 1))

        radiance, lit = np.zeros((x.size, 3)), np.zeros((len(self.lights), x.size), dtype=bool)
        for light, position, reached in zip(self.scene.lights, self.lights, lit, strict=True):
            reached[seen] = self.reached(own, p, n, position)
            wi, wo = _unit(position - p), -_unit(d)
            for i in np.unique(own[reached[seen]]).tolist():
                mine = np.flatnonzero(reached[seen] & (own == i))
                vectors = (v.take(mine, 1) for v in (n, wi, wo))
                radiance[seen[mine]] += self.reflected(i, *vectors) * light.intensity
        return Seen(radiance, owner, lit)

    def settle(self, i: int, p: Array, d: Array) -> tuple[Array, Array]:
        """Put points where rays meet a surface back on it; with their normals."""
        inside, (a, b) = self.inside[i], self.shapes[i]
        if self.is_sphere[i]:
            outward = (p - a) / b[0]
            return a + b[0] * outward, -outward if inside else outward
        near, far = self.slabs(i, self.eye, d, closed=True)
        # Through an edge or a corner, the face of the first axis, or of the last.
        t, best = (far, far.min(axis=0)) if inside else (near, near.max(axis=0))
        tied = np.asarray(np.abs(t - best) * _norm(d) <= self.none)
        axis = 2 - tied[::-1].argmax(axis=0) if self.last else tied.argmax(axis=0)
        every = np.arange(d.shape[1])
        forward = d[axis, every] > 0
        p[axis, every] = np.where(forward == inside, b[axis, 0], a[axis, 0])
        n = np.zeros_like(p)
        n[axis, every] = self.cast(np.where(forward, -1, 1))
        return p, n

    def reached(self, own: Array, p: Array, n: Array, light: Array) -> Array:
        """Tell whether a light reaches points p with normals n on the objects `own`."""
        lit = np.asarray(_dot(n, light - p) > self.none)
        for i, inside in enumerate(self.inside):
            at = np.flatnonzero(lit)
            start, least = self.start(p.take(at, 1), n.take(at, 1))
            blocks = self.blocks(i, start, light, least)
            if self.exact:
                # Seen from inside, the own object keeps out what is not inside, too.
                hidden = inside and self.side(i, light)[0] >= 0
                blocks = np.where(own[at] == i, hidden, blocks)
            lit[at] = ~blocks
        return lit

    def blocks(self, i: int, p: Array, light: Array, least: float) -> Array:
        """Tell whether a surface has a root strictly between points and a light.

        A sphere that a point is on blocks what leaves the side that it is seen from.
        """
        reach = _norm(light - p)
        d = (light - p) / reach
        d = self.zeroed(d, np.abs(d).max(axis=0))

        def between(t: Array) -> Any:
            return (t > self.cast(least) + self.none) & (t < reach - self.none)

        near, far = self.intersect(i, p, d, closed=False)
        blocks = (near <= far) & (between(near) | between(far))
        if self.contact and self.exact and self.is_sphere[i]:
            # With a root at one end, the other is as far beyond the middle of the chord.
            toward = _dot(self.shapes[i][0] - p, d)
            outwards = (toward < -self.none) | between(2 * toward)
            leaves = outwards if self.inside[i] else toward > self.none
            blocks = np.where(self.side(i, light) == 0, between(2 * toward - reach), blocks)
            blocks = np.where(self.side(i, p) == 0, leaves, blocks)
        return np.asarray(blocks)

    def reflected(self, i: int, n: Array, wi: Array, wo: Array) -> NDArray[np.float64]:
        """Lambert's and Blinn's terms (n, 3) for a light of intensity 1."""
        shader = self.surfaces[i].shader
        value = np.outer(_dot(n, wi).astype(float), shader.diffuse)
        if isinstance(shader, Phong) and any(shader.specular):
            cosine = _dot(n, _unit(wi + wo))
            base = np.where(cosine > 0, cosine, self.cast(0))
            # 0 to the power 0 is no Decimal.
            lobe = base ** self.cast(shader.exponent) if shader.exponent else np.ones(base.size)
            value += np.outer(lobe.astype(float), shader.specular)
        return value


def trace(scene: Scene, x: ArrayLike, y: ArrayLike, **methods: str) -> Seen:
    """Trace one ray through each of n places in the picture.

    They are pixels `x` (n,) to the right of and `y` below the upper left corner; centres are at
    + 0.5.  `methods` are `arithmetic`, `spheres` and `shadows`, each out of its table, and `ties`,
    "first" or "last".
    """
    with decimal.localcontext(_DECIMALS), np.errstate(all="ignore"):
        return _Plain(scene, **_USUAL | methods).trace(np.asarray(x), np.asarray(y))


def render(scene: Scene, offset: Sequence[float] = (0, 0), **methods: str) -> Array:
    """Render a scene at one sample a pixel: (height, width, 3) linear RGB, the top row first.

    `offset` moves the samples, in pixels to the right and down; for `methods` see `trace`.
    """
    y, x = np.indices((scene.height, scene.width)).reshape(2, -1) + 0.5
    seen = trace(scene, x + offset[0], y + offset[1], **methods)
    return seen.radiance.reshape(scene.height, scene.width, 3)
