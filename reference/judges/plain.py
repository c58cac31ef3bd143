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

Visibility: the nearest intersection with t > 0 along the camera ray is visible.  Among equal ones,
it is that of the first object in the file or, on one box, of the first axis.  If the eye
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

Roots: TypeAlias = tuple[Array, Array]
"""The smaller and the larger t of the points origin + t direction where rays meet a surface."""

_DECIMALS = decimal.Context(prec=80, Emax=decimal.MAX_EMAX, Emin=decimal.MIN_EMIN, traps=[])


ARITHMETICS: dict[str, tuple[Callable[[ArrayLike], Any], float]] = {
    "float64": (partial(np.asarray, dtype=np.float64), 0),
    "float32": (partial(np.asarray, dtype=np.float32), 0),
    "decimal": (
        lambda values: np.frompyfunc(Decimal, 1, 1)(np.asarray(values, dtype=np.float64)),
        1e-50,
    ),
}
"""For each arithmetic, the function that converts numbers to it, and the length, relative to the
scene's largest coordinate, up to which lengths count as 0."""


def _dot(a: Array, b: Array) -> Any:
    """Compute the dot product of each pair of vectors (3, n) in numbers of any arithmetic."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _norm(vectors: Array) -> Any:
    """Compute the length of each vector (3, n) in numbers of any arithmetic."""
    return np.sqrt(_dot(vectors, vectors))


def _normalise(vectors: Array) -> Any:
    """Divide each vector (3, n) by its length."""
    return vectors / _norm(vectors)


def intersect_by_projection(origin: Array, direction: Array, center: Array, radius: Array) -> Roots:
    """Intersect rays with a sphere by projecting the sphere's centre onto them.

    The error grows linearly with the distance to the sphere (Haines, Günther and Akenine-Möller,
    Precision Improvements for Ray/Sphere Intersection, Ray Tracing Gems, chapter 7).  The stable
    form of the roots does not cancel on huge spheres (Press et al., Numerical Recipes, 5.6).

    Parameters
    ----------
    origin, direction : (3, n) arrays
        Origins and directions of the rays.  Directions may have any length.
    center, radius : (3, 1) and () arrays
        Centre and radius of the sphere.

    Returns
    -------
    near, far : (n,) arrays
        t of the intersections origin + t direction, near <= far; NaN if the ray misses the sphere.
    """
    to_center = center - origin
    a, b = _dot(direction, direction), _dot(to_center, direction)
    perpendicular = to_center - b / a * direction
    root = np.sqrt(a * (radius * radius - _dot(perpendicular, perpendicular)))
    q = np.where(b < 0, b - root, b + root)
    t, other_t = q / a, (_dot(to_center, to_center) - radius * radius) / q
    return np.minimum(t, other_t), np.maximum(t, other_t)


def intersect_by_textbook(origin: Array, direction: Array, center: Array, radius: Array) -> Roots:
    """Intersect rays with a sphere by the quadratic formula of most textbooks.

    The error grows with the square of the distance from the origin to the sphere.

    Parameters
    ----------
    origin, direction : (3, n) arrays
        Origins and directions of the rays.  Directions may have any length.
    center, radius : (3, 1) and () arrays
        Centre and radius of the sphere.

    Returns
    -------
    near, far : (n,) arrays
        t of the intersections origin + t direction, near <= far; NaN if the ray misses the sphere.
    """
    from_center = origin - center
    constant = _dot(from_center, from_center) - radius * radius
    return _quadratic_roots(_dot(direction, direction), 2 * _dot(from_center, direction), constant)


def intersect_by_expansion(origin: Array, direction: Array, center: Array, radius: Array) -> Roots:
    """Intersect rays with a sphere by the quadratic formula with a square that is multiplied out.

    The square |origin - center|^2 becomes |origin|^2 - 2 origin.center + |center|^2.  The error
    grows with the square of the distance from the origin to the sphere, and with the square of the
    distance of both from the scene's zero point.

    Parameters
    ----------
    origin, direction : (3, n) arrays
        Origins and directions of the rays.  Directions may have any length.
    center, radius : (3, 1) and () arrays
        Centre and radius of the sphere.

    Returns
    -------
    near, far : (n,) arrays
        t of the intersections origin + t direction, near <= far; NaN if the ray misses the sphere.
    """
    distance2 = _dot(origin, origin) - 2 * _dot(origin, center) + _dot(center, center)
    along = _dot(origin, direction) - _dot(center, direction)
    return _quadratic_roots(_dot(direction, direction), 2 * along, distance2 - radius * radius)


def _quadratic_roots(a: Array, b: Array, c: Array) -> Roots:
    """Solve quadratic equations a t^2 + b t + c = 0 by the textbook's formula.

    Parameters
    ----------
    a, b, c : (n,) arrays
        Coefficients of the equations; a > 0.

    Returns
    -------
    low, high : (n,) arrays
        The smaller and the larger solution; NaN if there is no real one.
    """
    root = np.sqrt(b * b - 4 * a * c)
    return (-b - root) / (2 * a), (-b + root) / (2 * a)


SPHERES = {
    "closest": intersect_by_projection,
    "textbook": intersect_by_textbook,
    "expanded": intersect_by_expansion,
}
"""Methods to intersect rays with a sphere."""

SHADOWS: dict[str, Callable[[Array, Array], tuple[Array, float]]] = {
    "exact": lambda point, normal: (point, 0),
    "t>0": lambda point, normal: (point, 0),
    "t>1e-4": lambda point, normal: (point, 1e-4),
    "t>1e-6": lambda point, normal: (point, 1e-6),
    "normal": lambda point, normal: (point + 1e-4 * normal, 0),
    # Wächter and Binder (A Fast and Robust Method for Avoiding Self-Intersection, Ray Tracing Gems,
    # chapter 6), with their constants.
    "ulps": lambda point, normal: (
        point
        + normal * np.where(np.abs(point) < 1 / 32, 1 / 65536, 256 * np.spacing(np.abs(point))),
        0,
    ),
}
"""Methods to keep a point from shading itself: from points and normals (3, n), compute the origins
(3, n) of the shadow rays, and the length up to which intersections are ignored.

The first method also skips the point's own object.  This is exact, because all objects are convex.
"""


_DEFAULTS = {"arithmetic": "float64", "spheres": "closest", "shadows": "exact", "ties": "first"}


class TracedRays(NamedTuple):
    """Results for n camera rays: the visible surface, the lights that reach it, and its radiance.

    Attributes
    ----------
    radiance : (n, 3) float array
        Linear RGB radiance that reaches the eye.
    surface : (n,) int array
        The visible surface, as its number in the scene file from 0 on, or -1 for the background.
    is_lit : (lights, n) bool array
        Whether the light reaches the visible point; False for the background.
    """

    radiance: NDArray[np.float64]
    surface: NDArray[np.intp]
    is_lit: NDArray[np.bool_]


class _PlainTracer:
    """A scene in numbers of one arithmetic, and the methods to trace rays through it.

    Attributes
    ----------
    scene, surfaces : Scene, list of Surface
        The scene and its surfaces, in the order of the file.
    cast : callable
        Converts numbers, or arrays of them, to this arithmetic.
    intersect_sphere, shadow_start : callables
        The chosen items of `SPHERES` and `SHADOWS`.
    is_exact, last_wins : bool
        Whether the method for shadows is "exact"; whether the last of several nearest surfaces is
        visible, instead of the first.
    eye : (3, 1) array
        Position of the eye.
    lights : list of (3, 1) arrays
        Positions of the lights.
    is_sphere : list of bool
        Whether each surface is a sphere; others are boxes.
    shapes : list of pairs of arrays
        For each surface, centre (3, 1) and radius (1, 1) of a sphere, or the lower and the upper
        corner (3, 1) of a box.
    is_eye_inside : list of bool
        For each surface, whether the eye is inside of it, or on it.
    scale : number
        The largest absolute coordinate or radius in the scene.
    contact : number
        Lengths up to this, relative to another length, are treated as 0: 1e-50 in the decimal
        arithmetic, otherwise 0.
    tiny : number
        Lengths up to this are treated as 0: `contact` times `scale`.
    """

    def __init__(
        self, scene: Scene, arithmetic: str, spheres: str, shadows: str, ties: str
    ) -> None:
        """Convert a scene to numbers of an arithmetic, and choose the methods to trace it.

        Parameters
        ----------
        scene : Scene
            The scene.
        arithmetic, spheres, shadows : str
            Keys of `ARITHMETICS`, `SPHERES` and `SHADOWS`.
        ties : str
            Which of several nearest surfaces is visible: the "first" or the "last" in the file.

        Raises
        ------
        KeyError
            If a key does not exist.
        """
        self.scene, self.surfaces, self.is_exact = scene, scene.surfaces[:], shadows == "exact"
        self.last_wins = ties == "last"
        self.cast, contact = ARITHMETICS[arithmetic]
        self.intersect_sphere, self.shadow_start = SPHERES[spheres], SHADOWS[shadows]
        self.eye = self.cast(scene.camera.view_point)[:, None]
        self.lights = [self.cast(light.position)[:, None] for light in scene.lights]
        self.is_sphere = [isinstance(surface, Sphere) for surface in self.surfaces]
        pairs = [
            (s.center, [s.radius]) if isinstance(s, Sphere) else (s.min_pt, s.max_pt)
            for s in self.surfaces
        ]
        self.shapes = [(self.cast(a)[:, None], self.cast(b)[:, None]) for a, b in pairs]
        lengths = [self.eye, *self.lights, *(length for pair in self.shapes for length in pair)]
        self.contact = self.cast(contact)
        self.scale = max(np.abs(length).max() for length in lengths)
        self.tiny = self.contact * self.scale
        indices = range(len(self.shapes))
        self.is_eye_inside = [bool(self.signed_distance(i, self.eye)[0] <= 0) for i in indices]

    def snap_to_zero(self, values: Array, scale: Array) -> Array:
        """Replace values by 0 where they are tiny compared with a scale.

        Parameters
        ----------
        values : array
            Numbers of this arithmetic.
        scale : array that broadcasts to `values`
            A value is tiny if its absolute value is at most 1e-50 times this.  In float32 and
            float64, no value is tiny.

        Returns
        -------
        snapped : array
            The values, or 0, in the shape of `values`.
        """
        if not self.contact:
            return values
        return np.where(np.abs(values) <= self.contact * scale, self.cast(0), values)

    def signed_distance(self, surface: int, points: Array) -> Array:
        """Compute the signed distances of points from a surface.

        Parameters
        ----------
        surface : int
            Index of the surface in the scene.
        points : (3, n) array
            The points.

        Returns
        -------
        distance : (n,) array
            Positive outside the surface, 0 on it, negative inside.  For a box, the maximum over the
            planes of its sides, which is less than the distance outside its edges.
        """
        center_or_low, radius_or_high = self.shapes[surface]
        if self.is_sphere[surface]:
            distance = _norm(points - center_or_low) - radius_or_high[0]
        else:
            distance = np.maximum(center_or_low - points, points - radius_or_high).max(axis=0)
        return self.snap_to_zero(distance, self.scale)

    def ray_directions(self, x: Array, y: Array) -> Array:
        """Compute the directions of the camera rays through positions in the picture.

        Parameters
        ----------
        x, y : (n,) float arrays
            Positions in pixels, to the right of the upper left corner and below it.

        Returns
        -------
        direction : (3, n) array
            Vectors from the eye to the points of the camera's window.
        """
        cast, camera = self.cast, self.scene.camera
        width, height = self.scene.width, self.scene.height
        ahead, w = _normalise(cast(camera.view_dir)), _normalise(cast(camera.normal))
        w = -w if _dot(w, ahead) > 0 else w
        u = _normalise(np.cross(cast(camera.view_up), w))
        right = cast(2 * x - width) / (2 * width) * cast(camera.view_width)
        up = cast(height - 2 * y) / (2 * height) * cast(camera.view_height)
        window_center = ahead[:, None] * cast(camera.proj_distance)
        direction = window_center + np.outer(u, right) + np.outer(np.cross(w, u), up)
        # With exact zeros, a ray can be exactly parallel to the sides of a box.
        return self.snap_to_zero(direction, np.abs(direction).max(axis=0))

    def intersect_slabs(self, box: int, origin: Array, direction: Array, is_closed: bool) -> Roots:
        """Intersect rays with the three slabs between opposite sides of a box.

        Parameters
        ----------
        box : int
            Index of the box among the surfaces of the scene.
        origin : (3, 1) or (3, n) array
            Origins of the rays.
        direction : (3, n) array
            Directions of the rays.
        is_closed : bool
            Whether a ray in the plane of a side meets the slab of this side.

        Returns
        -------
        near, far : (3, n) arrays
            t where each ray enters and leaves the slab along each axis; near > far if it misses
            the slab.
        """
        low, high = (self.snap_to_zero(corner - origin, self.scale) for corner in self.shapes[box])
        is_between = (low <= 0) & (high >= 0) if is_closed else (low < 0) & (high > 0)
        far_if_parallel = np.where(is_between, self.cast(np.inf), self.cast(-np.inf))
        t_low, t_high = low / direction, high / direction
        near = np.where(direction == 0, -far_if_parallel, np.minimum(t_low, t_high))
        return near, np.where(direction == 0, far_if_parallel, np.maximum(t_low, t_high))

    def intersect(self, surface: int, origin: Array, direction: Array, is_closed: bool) -> Roots:
        """Intersect rays with a surface.

        Parameters
        ----------
        surface : int
            Index of the surface in the scene.
        origin : (3, 1) or (3, n) array
            Origins of the rays.
        direction : (3, n) array
            Directions of the rays.
        is_closed : bool
            Whether rays in the plane of a side of a box can meet the box.

        Returns
        -------
        near, far : (n,) arrays
            t of both intersections.  If the ray misses the surface, near > far, or both are NaN.
        """
        if self.is_sphere[surface]:
            center, radius = self.shapes[surface]
            return self.intersect_sphere(origin, direction, center, radius[0])
        near, far = self.intersect_slabs(surface, origin, direction, is_closed)
        return near.max(axis=0), far.min(axis=0)

    def trace(self, x: Array, y: Array) -> TracedRays:
        """Find the visible surface of each camera ray, the lights that reach it, and its radiance.

        Parameters
        ----------
        x, y : (n,) float arrays
            Positions in the picture, in pixels to the right of its upper left corner and below it.

        Returns
        -------
        traced : TracedRays
            The result for each ray.
        """
        direction = self.ray_directions(x, y)
        nearest_t, surface = self.find_nearest(direction)
        visible = np.flatnonzero(surface >= 0)
        owner, direction = surface[visible], direction.take(visible, 1)
        points = self.eye + nearest_t[visible] * direction
        normals = np.zeros_like(points)
        for i in np.unique(owner).tolist():
            index = np.flatnonzero(owner == i)
            near_surface = points.take(index, 1), direction.take(index, 1)
            points[:, index], normals[:, index] = self.project_onto_surface(i, *near_surface)
        radiance, is_lit = np.zeros((x.size, 3)), np.zeros((len(self.lights), x.size), dtype=bool)
        for light, position, is_lit_by in zip(self.scene.lights, self.lights, is_lit, strict=True):
            is_lit_by[visible] = self.is_lit(owner, points, normals, position)
            to_light, to_eye = _normalise(position - points), -_normalise(direction)
            for i in np.unique(owner[is_lit_by[visible]]).tolist():
                index = np.flatnonzero(is_lit_by[visible] & (owner == i))
                vectors = (vector.take(index, 1) for vector in (normals, to_light, to_eye))
                reflected = self.reflected_radiance(i, *vectors)
                radiance[visible[index]] += reflected * light.intensity
        return TracedRays(radiance, surface, is_lit)

    def find_nearest(self, direction: Array) -> tuple[Array, NDArray[np.intp]]:
        """Find the nearest intersection of each camera ray with all surfaces.

        Parameters
        ----------
        direction : (3, n) array
            Directions of the rays.

        Returns
        -------
        nearest_t : (n,) array
            The nearest intersection is at eye + nearest_t direction; infinity if there is none.
        surface : (n,) int array
            Index of the surface that is intersected there, or -1.
        """
        ray_count, length = direction.shape[1], _norm(direction)
        nearest_t, nearest = self.cast(np.full(ray_count, np.inf)), np.full(ray_count, -1)
        surfaces = [*enumerate(self.is_eye_inside)]
        for i, is_inside in reversed(surfaces) if self.last_wins else surfaces:
            near, far = self.intersect(i, self.eye, direction, is_closed=True)
            t = far if is_inside else near
            is_ahead = (near <= far) & (t * length > self.tiny)
            is_closer = is_ahead & (t < nearest_t * (1 - self.contact))
            nearest_t, nearest = np.where(is_closer, t, nearest_t), np.where(is_closer, i, nearest)
        return nearest_t, nearest

    def project_onto_surface(
        self, surface: int, points: Array, direction: Array
    ) -> tuple[Array, Array]:
        """Move points that are nearly on a surface exactly onto it, and compute its normals there.

        Parameters
        ----------
        surface : int
            Index of the surface in the scene.
        points, direction : (3, n) arrays
            Points where camera rays meet the surface, and the rays' directions.

        Returns
        -------
        points : (3, n) array
            The points on the surface.
        normals : (3, n) array
            Unit normals on the side of the eye.
        """
        is_inside, shape = self.is_eye_inside[surface], self.shapes[surface]
        if self.is_sphere[surface]:
            center, (radius,) = shape
            outward = (points - center) / radius
            return center + radius * outward, -outward if is_inside else outward
        low, high = shape
        near, far = self.intersect_slabs(surface, self.eye, direction, is_closed=True)
        # Through an edge or a corner, the side along the first axis is visible (or the last).
        t, visible_t = (far, far.min(axis=0)) if is_inside else (near, near.max(axis=0))
        is_tied = np.asarray(np.abs(t - visible_t) * _norm(direction) <= self.tiny)
        axis = 2 - is_tied[::-1].argmax(axis=0) if self.last_wins else is_tied.argmax(axis=0)
        ray = np.arange(direction.shape[1])
        is_forward = direction[axis, ray] > 0
        points[axis, ray] = np.where(is_forward == is_inside, high[axis, 0], low[axis, 0])
        normals = np.zeros_like(points)
        normals[axis, ray] = self.cast(np.where(is_forward, -1, 1))
        return points, normals

    def is_lit(self, owner: Array, points: Array, normals: Array, light: Array) -> Array:
        """Test whether a light reaches points on surfaces.

        Parameters
        ----------
        owner : (n,) int array
            Index of the surface on which each point lies.
        points, normals : (3, n) arrays
            The points, and the unit normals of the surfaces there.
        light : (3, 1) array
            Position of the light.

        Returns
        -------
        is_lit : (n,) bool array
            Whether the light is above the surface, and no surface blocks the segment to it.
        """
        is_lit = np.asarray(_dot(normals, light - points) > self.tiny)
        for i, is_inside in enumerate(self.is_eye_inside):
            index = np.flatnonzero(is_lit)
            start, min_length = self.shadow_start(points.take(index, 1), normals.take(index, 1))
            is_blocked = self.is_blocking(i, start, light, min_length)
            if self.is_exact:
                # A surface around the eye blocks light from outside of it; any other does not
                # block light from its own points.
                blocks_own = is_inside and self.signed_distance(i, light)[0] >= 0
                is_blocked = np.where(owner[index] == i, blocks_own, is_blocked)
            is_lit[index] = ~is_blocked
        return is_lit

    def is_blocking(self, surface: int, points: Array, light: Array, min_length: float) -> Array:
        """Test whether a surface intersects the open segments between points and a light.

        If the point or the light is on a sphere, one intersection is known exactly, and the other
        one follows from the point closest to the sphere's centre, without a square root.

        Parameters
        ----------
        surface : int
            Index of the surface in the scene.
        points : (3, n) array
            The points.
        light : (3, 1) array
            Position of the light.
        min_length : float
            Distance from the point up to which intersections are ignored.

        Returns
        -------
        is_blocking : (n,) bool array
            Whether the surface blocks the light.
        """
        distance = _norm(light - points)
        direction = (light - points) / distance
        direction = self.snap_to_zero(direction, np.abs(direction).max(axis=0))

        def is_between(t: Array) -> Any:
            """Test whether a distance t (n,) from each point lies strictly before the light."""
            return (t > self.cast(min_length) + self.tiny) & (t < distance - self.tiny)

        near, far = self.intersect(surface, points, direction, is_closed=False)
        is_blocked = (near <= far) & (is_between(near) | is_between(far))
        if self.contact and self.is_exact and self.is_sphere[surface]:
            # Both intersections are at the same distance from the closest point, at t = closest.
            closest = _dot(self.shapes[surface][0] - points, direction)
            if_light_is_on = is_between(2 * closest - distance)
            is_light_on = self.signed_distance(surface, light) == 0
            is_blocked = np.where(is_light_on, if_light_is_on, is_blocked)
            # From a point on the sphere, the segment is blocked if it leaves to the other side than
            # that of the eye, or returns to the sphere.
            outwards = (closest < -self.tiny) | is_between(2 * closest)
            if_point_is_on = outwards if self.is_eye_inside[surface] else closest > self.tiny
            is_point_on = self.signed_distance(surface, points) == 0
            is_blocked = np.where(is_point_on, if_point_is_on, is_blocked)
        return np.asarray(is_blocked)

    def reflected_radiance(
        self, surface: int, normals: Array, to_light: Array, to_eye: Array
    ) -> NDArray[np.float64]:
        """Compute the radiance that points of a surface reflect from a light of intensity 1.

        Lambert's term is the diffuse colour times n.l, with the unit normal n and the unit vector l
        to the light.  The Blinn-Phong term is the specular colour times (n.h)^exponent, with h
        halfway between l and the vector to the eye.

        Parameters
        ----------
        surface : int
            Index of the surface in the scene.
        normals, to_light, to_eye : (3, n) arrays
            Unit vectors: normals, and directions to the light and to the eye.

        Returns
        -------
        radiance : (n, 3) float array
            Linear RGB.
        """
        shader = self.surfaces[surface].shader
        radiance = np.outer(_dot(normals, to_light).astype(float), shader.diffuse)
        if isinstance(shader, Phong) and any(shader.specular):
            cosine = _dot(normals, _normalise(to_light + to_eye))
            base = np.where(cosine > 0, cosine, self.cast(0))
            # Decimal cannot raise 0 to the power of 0.
            lobe = base ** self.cast(shader.exponent) if shader.exponent else np.ones(base.size)
            radiance += np.outer(lobe.astype(float), shader.specular)
        return radiance


def trace(scene: Scene, x: ArrayLike, y: ArrayLike, **methods: str) -> TracedRays:
    """Trace one camera ray through each of n positions in the picture, by the plainest means.

    Parameters
    ----------
    scene : Scene
        The scene.
    x, y : (n,) arrays
        Positions in pixels, to the right of the upper left corner and below it.  The centre of the
        first pixel is at (0.5, 0.5).
    **methods : str
        `arithmetic` : a key of `ARITHMETICS`, by default "float64".
        `spheres` : a key of `SPHERES`, by default "closest".
        `shadows` : a key of `SHADOWS`, by default "exact".
        `ties` : whether of several nearest surfaces the "first" in the scene file is visible (the
        default), or the "last".

    Returns
    -------
    traced : TracedRays
        For each ray, the visible surface, the lights that reach it, and its radiance.

    Raises
    ------
    KeyError
        If a method does not exist.
    """
    with decimal.localcontext(_DECIMALS), np.errstate(all="ignore"):
        return _PlainTracer(scene, **_DEFAULTS | methods).trace(np.asarray(x), np.asarray(y))


def render(scene: Scene, offset: Sequence[float] = (0, 0), **methods: str) -> Array:
    """Render a scene with one sample per pixel, by the plainest means.

    Parameters
    ----------
    scene : Scene
        The scene.
    offset : sequence of two floats
        Shift of all samples from the centres of their pixels, in pixels to the right and down.
    **methods : str
        The arithmetic and the methods: see `trace`.

    Returns
    -------
    image : (height, width, 3) float array
        Linear RGB radiance, the top row first.
    """
    y, x = np.indices((scene.height, scene.width)).reshape(2, -1) + 0.5
    traced = trace(scene, x + offset[0], y + offset[1], **methods)
    return traced.radiance.reshape(scene.height, scene.width, 3)
