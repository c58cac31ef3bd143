"""Render scenes by the plainest means: every ray against every object.  Read this module first.

The problem: what should a picture look like, exactly?  This renderer answers without any code of
the tracer but the scene's description, so that the two can be compared.  All formulas of the format
are repeated here on purpose: a reference that shares code with what it validates would repeat its
errors.

The arithmetic can be chosen:

- In decimal numbers of 80 digits, it is the *oracle*.  Lengths that agree to 50 digits count as
  equal, because the scene's own numbers have 16 digits.  So contact and ties are decided exactly.
- In float32, or with the textbook's quadratic formula, or with an epsilon for shadows, it shows how
  usual ray tracers fail (see `reference.stability`).

What is visible: the nearest intersection with t > 0 along the camera ray.  Of equal ones, the first
object in the file is visible, and of the faces of a box, the one along the first axis.  If the eye
is inside an object, or on its surface, the far intersection counts, and the normal points inwards.
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
"""For each arithmetic, the function that converts numbers to it, and the length, relative to the
scene's largest coordinate, up to which lengths count as 0."""


def _dot(a: Array, b: Array) -> Any:
    """Compute the dot products of vectors (3, n)."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _norm(a: Array) -> Any:
    """Compute the lengths of vectors (3, n)."""
    return np.sqrt(_dot(a, a))


def _unit(a: Array) -> Any:
    """Normalise vectors (3, n)."""
    return a / _norm(a)


def closest_approach(o: Array, d: Array, c: Array, r: Array) -> tuple[Array, Array]:
    """Intersect rays with a sphere by way of the point closest to the centre.

    The error grows as eps D with the distance D in radii (Haines, Günther and Akenine-Möller,
    Precision Improvements for Ray/Sphere Intersection, Ray Tracing Gems, chapter 7).  The stable
    form of the roots does not cancel on huge spheres (Press et al., Numerical Recipes, 5.6).

    Parameters
    ----------
    o, d : (3, n) arrays
        Origins and directions of the rays.
    c, r : (3, 1) and () arrays
        Centre and radius of the sphere.

    Returns
    -------
    near, far : (n,) arrays
        t of the intersections o + t d; NaN if the ray misses the sphere.
    """
    m = c - o
    a, b = _dot(d, d), _dot(m, d)
    offset = m - b / a * d
    root = np.sqrt(a * (r * r - _dot(offset, offset)))
    q = np.where(b < 0, b - root, b + root)
    t, other = q / a, (_dot(m, m) - r * r) / q
    return np.minimum(t, other), np.maximum(t, other)


def textbook(o: Array, d: Array, c: Array, r: Array) -> tuple[Array, Array]:
    """Intersect rays with a sphere by the quadratic formula of most textbooks.

    The error grows as eps D^2 with the distance D in radii.

    Parameters
    ----------
    o, d : (3, n) arrays
        Origins and directions of the rays.
    c, r : (3, 1) and () arrays
        Centre and radius of the sphere.

    Returns
    -------
    near, far : (n,) arrays
        t of the intersections o + t d; NaN if the ray misses the sphere.
    """
    m = o - c
    return _quadratic_roots(_dot(d, d), 2 * _dot(m, d), _dot(m, m) - r * r)


def expanded(o: Array, d: Array, c: Array, r: Array) -> tuple[Array, Array]:
    """Intersect rays with a sphere by the quadratic formula with |o - c|^2 multiplied out.

    The error also grows as the square of the scene's offset from the origin.

    Parameters
    ----------
    o, d : (3, n) arrays
        Origins and directions of the rays.
    c, r : (3, 1) and () arrays
        Centre and radius of the sphere.

    Returns
    -------
    near, far : (n,) arrays
        t of the intersections o + t d; NaN if the ray misses the sphere.
    """
    distance2 = _dot(o, o) - 2 * _dot(o, c) + _dot(c, c)
    return _quadratic_roots(_dot(d, d), 2 * (_dot(o, d) - _dot(c, d)), distance2 - r * r)


def _quadratic_roots(a: Array, b: Array, c: Array) -> tuple[Array, Array]:
    """Solve quadratic equations a t^2 + b t + c = 0 with coefficients (n,).

    Returns
    -------
    low, high : (n,) arrays
        The smaller and the larger solution, if a > 0; NaN if there is none.
    """
    root = np.sqrt(b * b - 4 * a * c)
    return (-b - root) / (2 * a), (-b + root) / (2 * a)


SPHERES = {"closest": closest_approach, "textbook": textbook, "expanded": expanded}
"""Methods to intersect rays with a sphere."""

SHADOWS: dict[str, Callable[[Array, Array], tuple[Array, float]]] = {
    "exact": lambda p, n: (p, 0),
    "t>0": lambda p, n: (p, 0),
    "t>1e-4": lambda p, n: (p, 1e-4),
    "t>1e-6": lambda p, n: (p, 1e-6),
    "normal": lambda p, n: (p + 1e-4 * n, 0),
    # Wächter and Binder (A Fast and Robust Method for Avoiding Self-Intersection, Ray Tracing Gems,
    # chapter 6), with their constants.
    "ulps": lambda p, n: (
        p + n * np.where(np.abs(p) < 1 / 32, 1 / 65536, 256 * np.spacing(np.abs(p))),
        0,
    ),
}
"""Methods to keep a point from shading itself: from points and normals (3, n), return the origins
(3, n) of the shadow rays, and the length up to which intersections are ignored.

The first method also skips the point's own object.  This is exact, because all objects are convex.
"""


_DEFAULTS = {"arithmetic": "float64", "spheres": "closest", "shadows": "exact", "ties": "first"}


class Seen(NamedTuple):
    """What n camera rays show.

    Attributes
    ----------
    radiance : (n, 3) float array
        Linear RGB radiance.
    surface : (n,) int array
        The visible surface, as its number in the file, or -1 for the background.
    lit : (lights, n) bool array
        Whether the light reaches the visible surface.
    """

    radiance: NDArray[np.float64]
    surface: NDArray[np.intp]
    lit: NDArray[np.bool_]


class _Plain:
    """A scene in numbers of one arithmetic, and the methods to trace it.

    Attributes
    ----------
    eye : (3, 1) array
        Position of the eye.
    lights : list of (3, 1) arrays
        Positions of the lights.
    shapes : list of pairs of arrays
        For each surface, centre (3, 1) and radius (1, 1) of a sphere, or the lower and the upper
        corner (3, 1) of a box.
    inside : list of bool
        For each surface, whether the eye is inside of it, or on it.
    scale : number
        The largest coordinate or radius of the scene.
    contact, tiny : numbers
        Lengths up to this count as 0: relative to other lengths, and relative to `scale`.
    """

    def __init__(
        self, scene: Scene, arithmetic: str, spheres: str, shadows: str, ties: str
    ) -> None:
        """Convert a scene to numbers of an arithmetic.

        Parameters
        ----------
        scene : Scene
            The scene.
        arithmetic, spheres, shadows : str
            Keys of `ARITHMETICS`, `SPHERES` and `SHADOWS`.
        ties : str
            Which of several nearest surfaces is visible: "first" or "last".
        """
        self.scene, self.surfaces, self.exact = scene, scene.surfaces[:], shadows == "exact"
        self.last_wins = ties == "last"
        self.cast, contact = ARITHMETICS[arithmetic]
        self.intersect_sphere, self.shadow_start = SPHERES[spheres], SHADOWS[shadows]
        self.eye = self.cast(scene.camera.view_point)[:, None]
        self.lights = [self.cast(light.position)[:, None] for light in scene.lights]
        self.is_sphere = [isinstance(s, Sphere) for s in self.surfaces]
        pairs = [
            (s.center, [s.radius]) if isinstance(s, Sphere) else (s.min_pt, s.max_pt)
            for s in self.surfaces
        ]
        self.shapes = [(self.cast(a)[:, None], self.cast(b)[:, None]) for a, b in pairs]
        lengths = [self.eye, *self.lights, *(v for pair in self.shapes for v in pair)]
        self.contact = self.cast(contact)
        self.scale = max(np.abs(v).max() for v in lengths)
        self.tiny = self.contact * self.scale
        indices = range(len(self.shapes))
        self.inside = [bool(self.signed_distance(i, self.eye)[0] <= 0) for i in indices]

    def snap_to_zero(self, values: Array, scale: Array) -> Array:
        """Replace values by 0 where they are tiny.

        Parameters
        ----------
        values : array
            Numbers of this arithmetic.
        scale : array that broadcasts to `values`
            A value is tiny if its absolute value is at most 1e-50 times this.  In float32 and
            float64, no value is tiny.
        """
        if not self.contact:
            return values
        return np.where(np.abs(values) <= self.contact * scale, self.cast(0), values)

    def signed_distance(self, i: int, p: Array) -> Array:
        """Measure distances of points from a surface.

        Parameters
        ----------
        i : int
            The surface.
        p : (3, n) array
            The points.

        Returns
        -------
        distance : (n,) array
            Positive outside the surface, 0 on it, negative inside.
        """
        a, b = self.shapes[i]
        if self.is_sphere[i]:
            distance = _norm(p - a) - b[0]
        else:
            distance = np.maximum(a - p, p - b).max(axis=0)
        return self.snap_to_zero(distance, self.scale)

    def rays(self, x: Array, y: Array) -> Array:
        """Return the directions of camera rays.

        Parameters
        ----------
        x, y : (n,) float arrays
            Positions in the picture, in pixels from its upper left corner.

        Returns
        -------
        d : (3, n) array
            Vectors from the eye to points of the window.
        """
        cast, camera = self.cast, self.scene.camera
        width, height = self.scene.width, self.scene.height
        ahead, w = _unit(cast(camera.view_dir)), _unit(cast(camera.normal))
        w = -w if _dot(w, ahead) > 0 else w
        u = _unit(np.cross(cast(camera.view_up), w))
        right = cast(2 * x - width) / (2 * width) * cast(camera.view_width)
        up = cast(height - 2 * y) / (2 * height) * cast(camera.view_height)
        window_center = ahead[:, None] * cast(camera.proj_distance)
        d = window_center + np.outer(u, right) + np.outer(np.cross(w, u), up)
        # So that a direction can be exactly parallel to the faces of a box.
        return self.snap_to_zero(d, np.abs(d).max(axis=0))

    def slabs(self, i: int, o: Array, d: Array, closed: bool) -> tuple[Array, Array]:
        """Intersect rays with the three slabs between opposite faces of a box.

        Parameters
        ----------
        i : int
            The box.
        o, d : (3, 1) or (3, n), and (3, n) arrays
            Origins and directions of the rays.
        closed : bool
            Whether the faces belong to the box: only then does a ray in a face meet its slab.

        Returns
        -------
        near, far : (3, n) arrays
            t where the ray enters and leaves the slab along each axis; near > far if it misses the
            slab.
        """
        low, high = (self.snap_to_zero(v - o, self.scale) for v in self.shapes[i])
        is_between = (low <= 0) & (high >= 0) if closed else (low < 0) & (high > 0)
        far_if_parallel = np.where(is_between, self.cast(np.inf), self.cast(-np.inf))
        a, b = low / d, high / d
        near = np.where(d == 0, -far_if_parallel, np.minimum(a, b))
        return near, np.where(d == 0, far_if_parallel, np.maximum(a, b))

    def intersect(self, i: int, o: Array, d: Array, closed: bool) -> tuple[Array, Array]:
        """Intersect rays with a surface.

        Parameters
        ----------
        i : int
            The surface.
        o, d : (3, 1) or (3, n), and (3, n) arrays
            Origins and directions of the rays.
        closed : bool
            Whether rays in a face of a box meet the box.

        Returns
        -------
        near, far : (n,) arrays
            t of both intersections.  If the ray misses the surface, near <= far is False.
        """
        if self.is_sphere[i]:
            return self.intersect_sphere(o, d, self.shapes[i][0], self.shapes[i][1][0])
        near, far = self.slabs(i, o, d, closed)
        return near.max(axis=0), far.min(axis=0)

    def trace(self, x: Array, y: Array) -> Seen:
        """Find the visible surface of each camera ray, the lights that reach it, and its radiance.

        Parameters
        ----------
        x, y : (n,) float arrays
            Positions in the picture, in pixels from its upper left corner.

        Returns
        -------
        seen : Seen
            What each ray shows.
        """
        d = self.rays(x, y)
        nearest, owner = self.nearest(d)
        visible = np.flatnonzero(owner >= 0)
        own, d = owner[visible], d.take(visible, 1)
        p = self.eye + nearest[visible] * d
        n = np.zeros_like(p)
        for i in np.unique(own).tolist():
            index = np.flatnonzero(own == i)
            p[:, index], n[:, index] = self.settle(i, p.take(index, 1), d.take(index, 1))
        radiance, lit = np.zeros((x.size, 3)), np.zeros((len(self.lights), x.size), dtype=bool)
        for light, position, is_lit in zip(self.scene.lights, self.lights, lit, strict=True):
            is_lit[visible] = self.is_lit(own, p, n, position)
            wi, wo = _unit(position - p), -_unit(d)
            for i in np.unique(own[is_lit[visible]]).tolist():
                index = np.flatnonzero(is_lit[visible] & (own == i))
                vectors = (v.take(index, 1) for v in (n, wi, wo))
                radiance[visible[index]] += self.reflected(i, *vectors) * light.intensity
        return Seen(radiance, owner, lit)

    def nearest(self, d: Array) -> tuple[Array, NDArray[np.intp]]:
        """Find the nearest intersection of each camera ray.

        Parameters
        ----------
        d : (3, n) array
            Directions of the rays.

        Returns
        -------
        t : (n,) array
            Where the intersection is: at eye + t d; infinity if there is none.
        owner : (n,) int array
            The surface, or -1.
        """
        nearest, owner = self.cast(np.full(d.shape[1], np.inf)), np.full(d.shape[1], -1)
        length, order = _norm(d), [*enumerate(self.inside)]
        for i, inside in reversed(order) if self.last_wins else order:
            near, far = self.intersect(i, self.eye, d, closed=True)
            t = far if inside else near
            is_ahead = (near <= far) & (t * length > self.tiny)
            is_closer = is_ahead & (t < nearest * (1 - self.contact))
            nearest, owner = np.where(is_closer, t, nearest), np.where(is_closer, i, owner)
        return nearest, owner

    def settle(self, i: int, p: Array, d: Array) -> tuple[Array, Array]:
        """Move points exactly onto a surface, and return its normals there.

        Parameters
        ----------
        i : int
            The surface.
        p, d : (3, n) arrays
            Points where camera rays meet the surface, and the rays' directions.

        Returns
        -------
        p, n : (3, n) arrays
            The points on the surface, and the unit normals on the side of the eye.
        """
        inside, (a, b) = self.inside[i], self.shapes[i]
        if self.is_sphere[i]:
            outward = (p - a) / b[0]
            return a + b[0] * outward, -outward if inside else outward
        near, far = self.slabs(i, self.eye, d, closed=True)
        # Through an edge or a corner, the face along the first axis is visible (or the last).
        t, best = (far, far.min(axis=0)) if inside else (near, near.max(axis=0))
        is_tied = np.asarray(np.abs(t - best) * _norm(d) <= self.tiny)
        axis = 2 - is_tied[::-1].argmax(axis=0) if self.last_wins else is_tied.argmax(axis=0)
        every = np.arange(d.shape[1])
        is_forward = d[axis, every] > 0
        p[axis, every] = np.where(is_forward == inside, b[axis, 0], a[axis, 0])
        n = np.zeros_like(p)
        n[axis, every] = self.cast(np.where(is_forward, -1, 1))
        return p, n

    def is_lit(self, own: Array, p: Array, n: Array, light: Array) -> Array:
        """Test whether a light reaches points.

        Parameters
        ----------
        own : (n,) int array
            The surface on which each point lies.
        p, n : (3, n) arrays
            The points, and their normals.
        light : (3, 1) array
            Position of the light.

        Returns
        -------
        is_lit : (n,) bool array
            Whether the light is above the surface and no object is in between.
        """
        is_lit = np.asarray(_dot(n, light - p) > self.tiny)
        for i, inside in enumerate(self.inside):
            index = np.flatnonzero(is_lit)
            start, minimum = self.shadow_start(p.take(index, 1), n.take(index, 1))
            is_blocked = self.blocks(i, start, light, minimum)
            if self.exact:
                # A surface around the eye blocks light from outside of it; any other does not
                # block light from its own points.
                blocks_own = inside and self.signed_distance(i, light)[0] >= 0
                is_blocked = np.where(own[index] == i, blocks_own, is_blocked)
            is_lit[index] = ~is_blocked
        return is_lit

    def blocks(self, i: int, p: Array, light: Array, minimum: float) -> Array:
        """Test whether surface i has an intersection strictly between points and a light.

        If the point or the light is on a sphere, one intersection is known exactly, and the other
        one follows from the point closest to the sphere's centre, without a square root.

        Parameters
        ----------
        i : int
            The surface.
        p : (3, n) array
            The points.
        light : (3, 1) array
            Position of the light.
        minimum : float
            Distance from the point up to which intersections are ignored.

        Returns
        -------
        is_blocked : (n,) bool array
            Whether the surface blocks the light.
        """
        reach = _norm(light - p)
        d = (light - p) / reach
        d = self.snap_to_zero(d, np.abs(d).max(axis=0))

        def is_between(t: Array) -> Any:
            """Test whether t (n,) is strictly between the point and the light."""
            return (t > self.cast(minimum) + self.tiny) & (t < reach - self.tiny)

        near, far = self.intersect(i, p, d, closed=False)
        is_blocked = (near <= far) & (is_between(near) | is_between(far))
        if self.contact and self.exact and self.is_sphere[i]:
            # Both intersections are at the same distance from the closest point, at t = closest.
            closest = _dot(self.shapes[i][0] - p, d)
            if_light_is_on = is_between(2 * closest - reach)
            is_blocked = np.where(self.signed_distance(i, light) == 0, if_light_is_on, is_blocked)
            # From a point on the sphere, the segment is blocked if it leaves to the other side than
            # that of the eye, or returns to the sphere.
            outwards = (closest < -self.tiny) | is_between(2 * closest)
            if_point_is_on = outwards if self.inside[i] else closest > self.tiny
            is_blocked = np.where(self.signed_distance(i, p) == 0, if_point_is_on, is_blocked)
        return np.asarray(is_blocked)

    def reflected(self, i: int, n: Array, wi: Array, wo: Array) -> NDArray[np.float64]:
        """Compute the radiance that surface i reflects from a light of intensity 1.

        Lambert's term is the diffuse colour times n.wi.  The Blinn-Phong term is the specular
        colour times (n.h)^exponent, with h halfway between wi and wo.

        Parameters
        ----------
        i : int
            The surface.
        n, wi, wo : (3, n) arrays
            Unit vectors: normals, and directions to the light and to the eye.

        Returns
        -------
        radiance : (n, 3) float array
            Linear RGB.
        """
        shader = self.surfaces[i].shader
        value = np.outer(_dot(n, wi).astype(float), shader.diffuse)
        if isinstance(shader, Phong) and any(shader.specular):
            cosine = _dot(n, _unit(wi + wo))
            base = np.where(cosine > 0, cosine, self.cast(0))
            # Decimal cannot raise 0 to the power of 0.
            lobe = base ** self.cast(shader.exponent) if shader.exponent else np.ones(base.size)
            value += np.outer(lobe.astype(float), shader.specular)
        return value


def trace(scene: Scene, x: ArrayLike, y: ArrayLike, **methods: str) -> Seen:
    """Trace one ray through each of n positions in the picture.

    Parameters
    ----------
    scene : Scene
        The scene.
    x, y : (n,) arrays
        Positions in pixels, to the right of the upper left corner and below it.  Centres of pixels
        are at + 0.5.
    **methods : str
        `arithmetic` (a key of `ARITHMETICS`, by default "float64"), `spheres` (of `SPHERES`,
        "closest"), `shadows` (of `SHADOWS`, "exact"), and `ties`: whether of several nearest
        surfaces the "first" in the file is visible (the default) or the "last".

    Returns
    -------
    seen : Seen
        What each ray shows.
    """
    with decimal.localcontext(_DECIMALS), np.errstate(all="ignore"):
        return _Plain(scene, **_DEFAULTS | methods).trace(np.asarray(x), np.asarray(y))


def render(scene: Scene, offset: Sequence[float] = (0, 0), **methods: str) -> Array:
    """Render a scene with one sample per pixel.

    Parameters
    ----------
    scene : Scene
        The scene.
    offset : sequence of two floats
        Moves the samples from the pixels' centres, in pixels to the right and down.
    **methods : str
        See `trace`.

    Returns
    -------
    image : (height, width, 3) float array
        Linear RGB radiance, the top row first.
    """
    y, x = np.indices((scene.height, scene.width)).reshape(2, -1) + 0.5
    seen = trace(scene, x + offset[0], y + offset[1], **methods)
    return seen.radiance.reshape(scene.height, scene.width, 3)
