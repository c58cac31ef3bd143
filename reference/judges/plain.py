"""Render scenes in the plainest way: test every ray against every object.  Read this module first.

The problem: what exactly should a picture look like?  This renderer answers without any code of the
tracer except the description of the scene, so that the two can be compared.  All formulas of the
format are repeated here on purpose: a reference that shares code with what it validates would
repeat its errors.

The number type can be chosen:

- Decimal numbers of 80 digits make this renderer the *oracle*.  The numbers of a scene have 16
  digits, so lengths that agree to 50 digits are treated as equal.  Therefore contacts and ties are
  decided exactly.
- Float32, the textbook quadratic formula, and shadow rays with an epsilon show how common ray
  tracers fail (see `reference.stability`).

Visibility: the closest intersection with t > 0 along the camera ray is visible.  If several are
equally close, the one on the first object in the file is visible and, on a single box, the one on
the side along the first axis.  If the eye is inside an object, or on its surface, the far
intersection is used, and the normal points inwards.
"""

from __future__ import annotations

import decimal
from collections.abc import Callable, Sequence
from decimal import Decimal
from itertools import chain
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tracer import Phong, Scene, Sphere

Array: TypeAlias = NDArray[Any]
"""Array of numbers of any type: float32, float64, or Decimal objects.  Vectors are (3, n)."""

Roots: TypeAlias = tuple[Array, Array]
"""The smaller and the larger t at which each ray, origin + t direction, meets a surface."""

_DECIMALS = decimal.Context(prec=80, Emax=decimal.MAX_EMAX, Emin=decimal.MIN_EMIN, traps=[])

ARITHMETICS: dict[str, tuple[Callable[[Any], Any], float]] = {
    "float64": (np.float64, 0),
    "float32": (np.float32, 0),
    "decimal": (np.frompyfunc(Decimal, 1, 1), 1e-50),
}
"""For each number type, the function that converts numbers to it, and the maximum length that is
treated as 0, relative to the scene's largest coordinate."""


def _dot(a: Array, b: Array) -> Any:
    """Compute the dot products of vectors (3, n) with numbers of any type."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _norm(vectors: Array) -> Any:
    """Compute the lengths of vectors (3, n) with numbers of any type."""
    return np.sqrt(_dot(vectors, vectors))


def _normalise(vectors: Array) -> Any:
    """Divide each vector (3, n) by its length."""
    return vectors / _norm(vectors)


def intersect_by_projection(origin: Array, direction: Array, center: Array, radius: Array) -> Roots:
    """Intersect rays with a sphere by projecting the sphere's centre onto each ray.

    The error grows linearly with the distance to the sphere (Haines, Günther and Akenine-Möller,
    Precision Improvements for Ray/Sphere Intersection, Ray Tracing Gems, chapter 7).

    Parameters
    ----------
    origin, direction : (3, n) arrays
        Origins and directions of the rays.  Directions may have any length.
    center, radius : (3, 1) and () arrays
        Centre and radius of the sphere.

    Returns
    -------
    near, far : (n,) arrays
        The ray meets the sphere at origin + t direction for t = near and far; NaN if it misses.
    """
    to_center = center - origin
    squared_length, projection = _dot(direction, direction), _dot(to_center, direction)
    perpendicular = to_center - projection / squared_length * direction
    half_chord = np.sqrt(squared_length * (radius * radius - _dot(perpendicular, perpendicular)))
    # Nothing cancels in this sum (Press et al., Numerical Recipes, 5.6).
    stable_sum = np.where(projection < 0, projection - half_chord, projection + half_chord)
    t = stable_sum / squared_length
    other_t = (_dot(to_center, to_center) - radius * radius) / stable_sum
    return np.minimum(t, other_t), np.maximum(t, other_t)


def intersect_by_formula(origin: Array, direction: Array, center: Array, radius: Array) -> Roots:
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
        The ray meets the sphere at origin + t direction for t = near and far; NaN if it misses.
    """
    from_center = origin - center
    linear_coef = 2 * _dot(from_center, direction)
    constant_term = _dot(from_center, from_center) - radius * radius
    return _solve_quadratics(_dot(direction, direction), linear_coef, constant_term)


def intersect_by_expansion(origin: Array, direction: Array, center: Array, radius: Array) -> Roots:
    """Intersect rays with a sphere by an expanded form of the quadratic formula.

    |origin - center|^2 is computed as |origin|^2 - 2 origin.center + |center|^2.  The error grows
    with the square of the distance between origin and sphere, and with the squares of their
    distances from the point (0, 0, 0).

    Parameters
    ----------
    origin, direction : (3, n) arrays
        Origins and directions of the rays.  Directions may have any length.
    center, radius : (3, 1) and () arrays
        Centre and radius of the sphere.

    Returns
    -------
    near, far : (n,) arrays
        The ray meets the sphere at origin + t direction for t = near and far; NaN if it misses.
    """
    distance2 = _dot(origin, origin) - 2 * _dot(origin, center) + _dot(center, center)
    linear_coef = 2 * (_dot(origin, direction) - _dot(center, direction))
    return _solve_quadratics(_dot(direction, direction), linear_coef, distance2 - radius * radius)


def _solve_quadratics(a: Array, b: Array, c: Array) -> Roots:
    """Solve the quadratic equations a t^2 + b t + c = 0 by the usual formula.

    Parameters
    ----------
    a, b, c : (n,) arrays
        Coefficients of the equations; a > 0.

    Returns
    -------
    low, high : (n,) arrays
        The smaller and the larger solution; NaN if there is no real one.
    """
    square_root = np.sqrt(b * b - 4 * a * c)
    return (-b - square_root) / (2 * a), (-b + square_root) / (2 * a)


SPHERE_METHODS = {
    "closest": intersect_by_projection,
    "textbook": intersect_by_formula,
    "expanded": intersect_by_expansion,
}
"""Methods of intersecting rays with a sphere."""

SHADOW_METHODS: dict[str, Callable[[Array, Array], tuple[Array, float]]] = {
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
"""Methods of keeping a surface from shading its own points.  From points and normals (3, n), each
computes the origins (3, n) of shadow rays, and the distance within which to ignore intersections.

The first method also skips the point's own object.  This is exact, because all objects are convex.
"""


_DEFAULTS = {"arithmetic": "float64", "sphere_method": "closest"}
_DEFAULTS |= {"shadow_method": "exact", "ties": "first"}


class TracedRays(NamedTuple):
    """Results of n camera rays: visible surfaces, the lights that reach them, and radiance.

    Attributes
    ----------
    radiance : (n, 3) float array
        Linear RGB radiance that reaches the eye.
    surface_index : (n,) int array
        Index of the visible surface in `scene.surfaces`, or -1 for the background.
    is_lit : (lights, n) bool array
        Whether the light reaches the visible point; False for the background.
    """

    radiance: NDArray[np.float64]
    surface_index: NDArray[np.intp]
    is_lit: NDArray[np.bool_]


class _PlainTracer:
    """A scene converted to one number type, with methods to trace rays through it.

    Attributes
    ----------
    scene, surfaces : Scene, list of Surface
        The scene and its surfaces, in the order of the file.
    to_precision : callable
        Converts a number, or an array of numbers, to the number type of this tracer.
    intersect_sphere, start_shadow_rays : callables
        The chosen items of `SPHERE_METHODS` and `SHADOW_METHODS`.
    skips_own_object, last_wins_ties : bool
        Whether shadow rays skip the surface from which they start (method "exact"); whether the
        last of several equally close surfaces is visible instead of the first.
    eye : (3, 1) array
        Position of the eye.
    light_positions : list of (3, 1) arrays
        Positions of the lights.
    is_sphere : list of bool
        Whether each surface is a sphere; others are boxes.
    shapes : list of pairs of arrays
        For each surface, the centre (3, 1) and radius (1, 1) of a sphere, or the lower and upper
        corners (3, 1) of a box.
    is_eye_inside : list of bool
        For each surface, whether the eye is inside it or on it.
    scene_size : number
        The largest absolute coordinate or radius in the scene.
    relative_tolerance : number
        A length is treated as 0 if its ratio to another length is at most this number: 1e-50 in
        decimal arithmetic, otherwise 0.
    tolerance : number
        Maximum length that is treated as 0: `relative_tolerance` times `scene_size`.
    """

    def __init__(
        self, scene: Scene, arithmetic: str, sphere_method: str, shadow_method: str, ties: str
    ) -> None:
        """Convert a scene to a number type, and select the methods for tracing it.

        Parameters
        ----------
        scene : Scene
            The scene.
        arithmetic, sphere_method, shadow_method : str
            Keys of `ARITHMETICS`, `SPHERE_METHODS` and `SHADOW_METHODS`.
        ties : str
            Which of several equally close surfaces is visible: "first" or "last" in the file.

        Raises
        ------
        KeyError
            If a key does not exist.
        """
        to_precision, relative_tolerance = ARITHMETICS[arithmetic]
        self.scene, self.surfaces, self.to_precision = scene, scene.surfaces[:], to_precision
        self.skips_own_object, self.last_wins_ties = shadow_method == "exact", ties == "last"
        self.intersect_sphere = SPHERE_METHODS[sphere_method]
        self.start_shadow_rays = SHADOW_METHODS[shadow_method]
        self.eye = to_precision(scene.camera.view_point)[:, None]
        self.light_positions = [to_precision(light.position)[:, None] for light in scene.lights]
        self.is_sphere = [isinstance(surface, Sphere) for surface in self.surfaces]
        shapes = [
            (each.center, [each.radius]) if isinstance(each, Sphere) else (each.min_pt, each.max_pt)
            for each in self.surfaces
        ]
        self.shapes = [[to_precision(numbers)[:, None] for numbers in shape] for shape in shapes]
        lengths = [self.eye, *self.light_positions, *chain.from_iterable(self.shapes)]
        self.relative_tolerance = to_precision(relative_tolerance)
        self.scene_size = max(np.abs(array).max() for array in lengths)
        self.tolerance = self.relative_tolerance * self.scene_size
        surface_indices = range(len(self.shapes))
        distances = [self.compute_signed_distance(index, self.eye) for index in surface_indices]
        self.is_eye_inside = [bool(distance[0] <= 0) for distance in distances]

    def snap_to_zero(self, values: Array, scale: Array) -> Array:
        """Replace values with 0 where they are tiny in relation to a scale.

        Parameters
        ----------
        values : array
            Numbers of the tracer's number type.
        scale : array that broadcasts to `values`
            A decimal value is tiny if its absolute value is at most 1e-50 times the scale.  Values
            in float32 or float64 are never tiny.

        Returns
        -------
        snapped : array
            `values`, with 0 in place of tiny values.
        """
        if not self.relative_tolerance:
            return values
        is_tiny = np.abs(values) <= self.relative_tolerance * scale
        return np.where(is_tiny, self.to_precision(0), values)

    def compute_signed_distance(self, surface_index: int, points: Array) -> Array:
        """Compute the signed distance of each point from a surface.

        Parameters
        ----------
        surface_index : int
            Index of the surface in the scene.
        points : (3, n) array
            The points.

        Returns
        -------
        distance : (n,) array
            Positive outside the surface, 0 on it, negative inside.  For a box, this is the largest
            of the signed distances from the planes of its sides.
        """
        if self.is_sphere[surface_index]:
            center, radius = self.shapes[surface_index]
            distance = _norm(points - center) - radius[0]
        else:
            low, high = self.shapes[surface_index]
            distance = np.maximum(low - points, points - high).max(axis=0)
        return self.snap_to_zero(distance, self.scene_size)

    def compute_ray_directions(self, x: Array, y: Array) -> Array:
        """Compute the directions of camera rays through given positions in the picture.

        Parameters
        ----------
        x, y : (n,) float arrays
            Positions in the picture, in pixels right and down from its upper left corner.

        Returns
        -------
        direction : (3, n) array
            Vectors from the eye to the positions on the camera's window.
        """
        to_precision, camera = self.to_precision, self.scene.camera
        width, height, normal = self.scene.width, self.scene.height, to_precision(camera.normal)
        view_direction = _normalise(to_precision(camera.view_dir))
        back = _normalise(-normal if _dot(normal, view_direction) > 0 else normal)
        right = _normalise(np.cross(to_precision(camera.view_up), back))
        up = np.cross(back, right)
        shift_right = to_precision(2 * x - width) / (2 * width) * to_precision(camera.view_width)
        shift_up = to_precision(height - 2 * y) / (2 * height) * to_precision(camera.view_height)
        eye_to_window_center = view_direction[:, None] * to_precision(camera.proj_distance)
        direction = eye_to_window_center + np.outer(right, shift_right) + np.outer(up, shift_up)
        # With exact zeros, a ray can be exactly parallel to the sides of a box.
        return self.snap_to_zero(direction, np.abs(direction).max(axis=0))

    def intersect_slabs(
        self, box_index: int, origin: Array, direction: Array, is_closed: bool
    ) -> Roots:
        """Intersect rays with the three slabs between opposite sides of a box.

        Parameters
        ----------
        box_index : int
            Index of the box among the surfaces of the scene.
        origin : (3, 1) or (3, n) array
            Origins of the rays.
        direction : (3, n) array
            Directions of the rays.
        is_closed : bool
            Whether a ray that lies in the plane of a side counts as being in the slab.

        Returns
        -------
        near, far : (3, n) arrays
            For each axis, the ray enters the slab at origin + near direction, and leaves it at
            origin + far direction.  If the ray misses the slab, near > far.
        """
        corners = (corner - origin for corner in self.shapes[box_index])
        low, high = (self.snap_to_zero(corner, self.scene_size) for corner in corners)
        is_in_slab = (low <= 0) & (high >= 0) if is_closed else (low < 0) & (high > 0)
        parallel_far = np.where(is_in_slab, self.to_precision(np.inf), self.to_precision(-np.inf))
        t_low, t_high = low / direction, high / direction
        near = np.where(direction == 0, -parallel_far, np.minimum(t_low, t_high))
        return near, np.where(direction == 0, parallel_far, np.maximum(t_low, t_high))

    def intersect(
        self, surface_index: int, origin: Array, direction: Array, is_closed: bool
    ) -> Roots:
        """Intersect rays with a sphere or a box.

        Parameters
        ----------
        surface_index : int
            Index of the surface in the scene.
        origin : (3, 1) or (3, n) array
            Origins of the rays.
        direction : (3, n) array
            Directions of the rays.
        is_closed : bool
            Whether a ray that lies in the plane of a box's side counts as meeting the box.

        Returns
        -------
        near, far : (n,) arrays
            The ray meets the surface at origin + t direction for t = near and far.  If it misses
            the surface, near > far, or both are NaN.
        """
        if self.is_sphere[surface_index]:
            center, radius = self.shapes[surface_index]
            return self.intersect_sphere(origin, direction, center, radius[0])
        near, far = self.intersect_slabs(surface_index, origin, direction, is_closed)
        return near.max(axis=0), far.min(axis=0)

    def trace(self, x: Array, y: Array) -> TracedRays:
        """Trace a camera ray through each of n positions in the picture.

        Parameters
        ----------
        x, y : (n,) float arrays
            Positions in the picture, in pixels right and down from its upper left corner.

        Returns
        -------
        traced : TracedRays
            For each ray, the visible surface, the lights that reach this surface, and the radiance.
        """
        direction = self.compute_ray_directions(x, y)
        closest_t, visible_index = self.find_closest_hits(direction)
        ray_index = np.flatnonzero(visible_index >= 0)
        hit_surface_index, direction = visible_index[ray_index], direction.take(ray_index, 1)
        points = self.eye + closest_t[ray_index] * direction
        normals = np.zeros_like(points)
        for surface_index in np.unique(hit_surface_index).tolist():
            hit_index = np.flatnonzero(hit_surface_index == surface_index)
            hits = points.take(hit_index, 1), direction.take(hit_index, 1)
            projected_hits = self.project_onto_surface(surface_index, *hits)
            points[:, hit_index], normals[:, hit_index] = projected_hits
        radiance = np.zeros((x.size, 3))
        is_lit = np.zeros((len(self.light_positions), x.size), dtype=np.bool_)
        lights = zip(self.scene.lights, self.light_positions, is_lit, strict=True)
        for light, light_position, is_lit_by_light in lights:
            is_hit_lit = self.test_light(hit_surface_index, points, normals, light_position)
            is_lit_by_light[ray_index] = is_hit_lit
            to_light, to_eye = _normalise(light_position - points), -_normalise(direction)
            for surface_index in np.unique(hit_surface_index[is_hit_lit]).tolist():
                hit_index = np.flatnonzero(is_hit_lit & (hit_surface_index == surface_index))
                unit_vectors = (vector.take(hit_index, 1) for vector in (normals, to_light, to_eye))
                reflected = self.compute_reflected_radiance(surface_index, *unit_vectors)
                radiance[ray_index[hit_index]] += reflected * light.intensity
        return TracedRays(radiance, visible_index, is_lit)

    def find_closest_hits(self, direction: Array) -> tuple[Array, NDArray[np.intp]]:
        """Find the closest intersection of each camera ray with any surface.

        Parameters
        ----------
        direction : (3, n) array
            Directions of the rays.

        Returns
        -------
        closest_t : (n,) array
            The smallest t at which each ray, eye + t direction, meets a surface, or infinity.
        closest_surface_index : (n,) int array
            Index of the surface that the ray meets there, or -1.
        """
        direction_length, closest_surface_index = _norm(direction), np.full(direction.shape[1], -1)
        closest_t = self.to_precision(np.full(direction.shape[1], np.inf))
        for surface_index in range(len(self.shapes))[:: -1 if self.last_wins_ties else 1]:
            near, far = self.intersect(surface_index, self.eye, direction, is_closed=True)
            t = far if self.is_eye_inside[surface_index] else near
            is_ahead = (near <= far) & (t * direction_length > self.tolerance)
            is_closer = is_ahead & (t < closest_t * (1 - self.relative_tolerance))
            closest_t = np.where(is_closer, t, closest_t)
            closest_surface_index[is_closer] = surface_index
        return closest_t, closest_surface_index

    def project_onto_surface(
        self, surface_index: int, points: Array, direction: Array
    ) -> tuple[Array, Array]:
        """Move points near a surface exactly onto it, and compute the normals there.

        Parameters
        ----------
        surface_index : int
            Index of the surface in the scene.
        points, direction : (3, n) arrays
            Points where camera rays meet the surface, and the directions of these rays.  The points
            may be changed in place.

        Returns
        -------
        points : (3, n) array
            The points on the surface.
        normals : (3, n) array
            Unit normals on the side of the surface that is visible to the eye.
        """
        is_eye_inside, shape = self.is_eye_inside[surface_index], self.shapes[surface_index]
        if self.is_sphere[surface_index]:
            center, (radius,) = shape
            outward = (points - center) / radius
            return center + radius * outward, -outward if is_eye_inside else outward
        low, high = shape
        near, far = self.intersect_slabs(surface_index, self.eye, direction, is_closed=True)
        # At an edge or a corner, several sides are tied.  The first or the last axis wins.
        side_t, visible_t = (far, far.min(axis=0)) if is_eye_inside else (near, near.max(axis=0))
        is_tied = np.asarray(np.abs(side_t - visible_t) * _norm(direction) <= self.tolerance)
        axis = 2 - is_tied[::-1].argmax(axis=0) if self.last_wins_ties else is_tied.argmax(axis=0)
        ray_index = np.arange(direction.shape[1])
        is_forward = direction[axis, ray_index] > 0
        points[axis, ray_index] = np.where(is_forward == is_eye_inside, high[axis, 0], low[axis, 0])
        normals = np.zeros_like(points)
        normals[axis, ray_index] = self.to_precision(np.where(is_forward, -1, 1))
        return points, normals

    def test_light(self, own_index: Array, points: Array, normals: Array, light: Array) -> Array:
        """Test whether a light reaches each of n surface points.

        Parameters
        ----------
        own_index : (n,) int array
            Index of the surface on which each point lies.
        points, normals : (3, n) arrays
            The points, and the unit normals of the surfaces there.
        light : (3, 1) array
            Position of the light.

        Returns
        -------
        is_lit : (n,) bool array
            Whether the light is in front of the surface, and no surface blocks the segment from the
            point to the light.
        """
        is_lit = np.asarray(_dot(normals, light - points) > self.tolerance)
        for occluder_index, is_eye_inside in enumerate(self.is_eye_inside):
            index = np.flatnonzero(is_lit)
            ray_origin, epsilon = self.start_shadow_rays(points[:, index], normals[:, index])
            is_blocked = self.is_blocking(occluder_index, ray_origin, light, epsilon)
            if self.skips_own_object:
                # A surface shades its own points only if it contains the eye, but not the light.
                is_own = own_index[index] == occluder_index
                is_blocked[is_own] = (
                    is_eye_inside and self.compute_signed_distance(occluder_index, light)[0] >= 0
                )
            is_lit[index] = ~is_blocked
        return is_lit

    def is_blocking(self, surface_index: int, points: Array, light: Array, epsilon: float) -> Array:
        """Test whether a surface blocks the segment from each point to a light.

        Intersections at the ends of the segment do not count.

        Parameters
        ----------
        surface_index : int
            Index of the surface in the scene.
        points : (3, n) array
            The points.
        light : (3, 1) array
            Position of the light.
        epsilon : float
            Distance from the point within which intersections are ignored.

        Returns
        -------
        is_blocked : (n,) bool array
            Whether the surface blocks the segment.
        """
        distance = _norm(light - points)
        direction = (light - points) / distance
        direction = self.snap_to_zero(direction, np.abs(direction).max(axis=0))
        min_t, max_t = self.to_precision(epsilon) + self.tolerance, distance - self.tolerance

        def is_between(t: Array) -> Any:
            """Test which distances t (n,) lie strictly between the point and the light."""
            return (t > min_t) & (t < max_t)

        near, far = self.intersect(surface_index, points, direction, is_closed=False)
        is_blocked = (near <= far) & (is_between(near) | is_between(far))
        if self.relative_tolerance and self.skips_own_object and self.is_sphere[surface_index]:
            # If the light or the point is on the sphere, one intersection is known exactly.  The
            # other follows from symmetry: t = middle_t is halfway between them.
            middle_t = _dot(self.shapes[surface_index][0] - points, direction)
            blocks_light_on_sphere = is_between(2 * middle_t - distance)
            is_light_on_sphere = self.compute_signed_distance(surface_index, light) == 0
            is_blocked = np.where(is_light_on_sphere, blocks_light_on_sphere, is_blocked)
            # A segment from a point on the sphere is blocked if it starts on the side hidden from
            # the eye, or if it meets the sphere again.
            blocks_point_on_sphere = middle_t > self.tolerance
            if self.is_eye_inside[surface_index]:
                blocks_point_on_sphere = (middle_t < -self.tolerance) | is_between(2 * middle_t)
            is_point_on_sphere = self.compute_signed_distance(surface_index, points) == 0
            is_blocked = np.where(is_point_on_sphere, blocks_point_on_sphere, is_blocked)
        return np.asarray(is_blocked)

    def compute_reflected_radiance(
        self, surface_index: int, normals: Array, to_light: Array, to_eye: Array
    ) -> NDArray[np.float64]:
        """Compute the radiance that surface points reflect from a light of intensity 1.

        The Lambert term is the diffuse colour times n.l, with the unit normal n and the unit vector
        l to the light.  The Blinn-Phong term is the specular colour times (n.h)^exponent, with h
        halfway between l and the vector to the eye.

        Parameters
        ----------
        surface_index : int
            Index of the surface in the scene.
        normals, to_light, to_eye : (3, n) arrays
            Unit vectors: normals, and directions to the light and to the eye.

        Returns
        -------
        radiance : (n, 3) float array
            Reflected linear RGB radiance.
        """
        shader = self.surfaces[surface_index].shader
        radiance = np.outer(_dot(normals, to_light).astype(float), shader.diffuse)
        if isinstance(shader, Phong) and any(shader.specular):
            cosine = _dot(normals, _normalise(to_light + to_eye))
            clamped_cosine = np.where(cosine > 0, cosine, self.to_precision(0))
            # Decimal cannot compute 0 to the power of 0.
            exponent = self.to_precision(shader.exponent)
            cosine_power = clamped_cosine**exponent if exponent else np.ones(clamped_cosine.size)
            radiance += np.outer(cosine_power.astype(float), shader.specular)
        return radiance


def trace(scene: Scene, x: ArrayLike, y: ArrayLike, **methods: str) -> TracedRays:
    """Trace a camera ray through each of n positions, and test it against every object.

    Parameters
    ----------
    scene : Scene
        The scene.
    x, y : (n,) arrays
        Positions in the picture, in pixels right and down from its upper left corner.  The first
        pixel has its centre at (0.5, 0.5).
    **methods : str
        `arithmetic` : the number type, a key of `ARITHMETICS`; by default "float64".
        `sphere_method` : how to intersect rays with spheres, a key of `SPHERE_METHODS`; by
        default "closest".
        `shadow_method` : how to keep surfaces from shading their own points, a key of
        `SHADOW_METHODS`; by default "exact".
        `ties` : which of several equally close surfaces is visible, the "first" or the "last" in
        the scene file; by default "first".

    Returns
    -------
    traced : TracedRays
        For each ray, the visible surface, the lights that reach this surface, and the radiance.

    Raises
    ------
    KeyError
        If a number type or method does not exist.
    """
    with decimal.localcontext(_DECIMALS), np.errstate(all="ignore"):
        return _PlainTracer(scene, **_DEFAULTS | methods).trace(np.asarray(x), np.asarray(y))


def render(scene: Scene, offset: Sequence[float] = (0, 0), **methods: str) -> Array:
    """Render a scene with one sample per pixel, testing every ray against every object.

    Parameters
    ----------
    scene : Scene
        The scene.
    offset : sequence of two floats
        Shift of all samples from the centres of their pixels, in pixels right and down.
    **methods : str
        Keyword arguments of `trace`: the number type and the methods.

    Returns
    -------
    image : (height, width, 3) float array
        Linear RGB radiance, top row first.
    """
    y, x = np.indices((scene.height, scene.width)).reshape(2, -1) + 0.5
    traced = trace(scene, x + offset[0], y + offset[1], **methods)
    return traced.radiance.reshape(scene.height, scene.width, 3)
