"""Render scenes in the plainest way: test every ray against every object.  Read this module first.

What exactly should a picture look like?  This renderer answers without any code of the tracer
except the description of the scene, so that the two can be compared.  All formulas of the format
are repeated here on purpose: a reference that shares code with what it validates would repeat its
errors.

`render` makes a picture, and `trace` traces single rays.  The number type can be chosen:

- Decimal numbers of 80 digits make this renderer the *oracle*.  The numbers of a scene have 16
  digits, so lengths that agree to 50 digits are treated as equal.  Therefore contacts and ties are
  decided exactly.
- Float32, the textbook quadratic formula, and shadow rays with an epsilon show how common ray
  tracers fail (see `reference.stability`).

Visibility: the closest intersection with t > 0 along the camera ray is visible.  If several are
equally close, the one on the first object in the file is visible and, on a single box, the one on
the side along the first axis.  If the eye is inside an object, or on its surface, the far
intersection is used, and the normal points inwards.

A point of a ray is origin + t direction.  Directions may have any length.  A `surface_index` is an
index into `scene.surfaces`.
"""

from __future__ import annotations

import decimal
from collections.abc import Callable, Sequence
from decimal import Decimal
from itertools import chain
from typing import Annotated as Shaped
from typing import Any, Literal, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tracer import Box, Phong, Scene, Sphere

Array: TypeAlias = NDArray[Any]
"""Array of numbers of any type: float32, float64, or Decimal objects.  Vectors are (3, n)."""

Roots: TypeAlias = tuple[Array, Array]
"""The smaller and the larger t at which each ray meets a surface; NaN for a miss of a sphere."""

_DECIMALS = decimal.Context(prec=80, Emax=decimal.MAX_EMAX, Emin=decimal.MIN_EMIN, traps=[])


class Arithmetic(NamedTuple):
    """A type of numbers."""

    convert: Callable[[Any], Any]  # converts numbers and arrays to this type
    # Maximum length that is treated as 0, relative to the scene's largest coordinate.
    relative_tolerance: float


ARITHMETICS = {
    "float64": Arithmetic(convert=np.float64, relative_tolerance=0),
    "float32": Arithmetic(convert=np.float32, relative_tolerance=0),
    "decimal": Arithmetic(convert=np.frompyfunc(Decimal, 1, 1), relative_tolerance=1e-50),
}
"""The number types by name."""


def _dot(a: Shaped[Array, "3 ..."], b: Shaped[Array, "3 ..."]) -> Any:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _norm(vectors: Shaped[Array, "3 ..."]) -> Any:
    return np.sqrt(_dot(vectors, vectors))


def _normalise(vectors: Shaped[Array, "3 ..."]) -> Any:
    return vectors / _norm(vectors)


def intersect_by_projection(
    origin: Shaped[Array, "3 #n"],
    direction: Shaped[Array, "3 n"],
    center: Shaped[Array, "3 1"],
    radius: Shaped[Array, "1"],
) -> Shaped[Roots, "n"]:
    """Find the smaller and the larger t at which rays meet a sphere; NaN for a miss.

    The sphere's centre is projected onto each ray.  The error grows linearly with the distance to
    the sphere (Haines, Günther and Akenine-Möller, Precision Improvements for Ray/Sphere
    Intersection, Ray Tracing Gems, chapter 7).
    """
    to_center = center - origin
    squared_length = _dot(direction, direction)
    projection = _dot(to_center, direction)
    perpendicular = to_center - projection / squared_length * direction
    half_chord = np.sqrt(squared_length * (radius * radius - _dot(perpendicular, perpendicular)))
    # Nothing cancels in this sum (Press et al., Numerical Recipes, 5.6).
    stable_sum = np.where(projection < 0, projection - half_chord, projection + half_chord)
    t = stable_sum / squared_length
    other_t = (_dot(to_center, to_center) - radius * radius) / stable_sum
    return np.minimum(t, other_t), np.maximum(t, other_t)


def intersect_by_formula(
    origin: Shaped[Array, "3 #n"],
    direction: Shaped[Array, "3 n"],
    center: Shaped[Array, "3 1"],
    radius: Shaped[Array, "1"],
) -> Shaped[Roots, "n"]:
    """Find the smaller and the larger t at which rays meet a sphere; NaN for a miss.

    The quadratic formula is that of most textbooks.  The error grows with the square of the
    distance from the origin to the sphere.
    """
    from_center = origin - center
    linear_coef = 2 * _dot(from_center, direction)
    constant_term = _dot(from_center, from_center) - radius * radius
    return _solve_quadratics(_dot(direction, direction), linear_coef, constant_term)


def intersect_by_expansion(
    origin: Shaped[Array, "3 #n"],
    direction: Shaped[Array, "3 n"],
    center: Shaped[Array, "3 1"],
    radius: Shaped[Array, "1"],
) -> Shaped[Roots, "n"]:
    """Find the smaller and the larger t at which rays meet a sphere; NaN for a miss.

    In the quadratic formula, |origin - center|^2 is expanded to |origin|^2 - 2 origin.center +
    |center|^2.  The error grows with the square of the distance between origin and sphere, and with
    the squares of their distances from the point (0, 0, 0).
    """
    squared_distance = _dot(origin, origin) - 2 * _dot(origin, center) + _dot(center, center)
    linear_coef = 2 * (_dot(origin, direction) - _dot(center, direction))
    constant_term = squared_distance - radius * radius
    return _solve_quadratics(_dot(direction, direction), linear_coef, constant_term)


def _solve_quadratics(
    a: Shaped[Array, "n"], b: Shaped[Array, "n"], c: Shaped[Array, "#n"]
) -> Shaped[Roots, "n"]:
    """Solve a t^2 + b t + c = 0 with a > 0 by the usual formula; NaN without a real solution."""
    square_root = np.sqrt(b * b - 4 * a * c)
    return (-b - square_root) / (2 * a), (-b + square_root) / (2 * a)


SPHERE_METHODS = {
    "closest": intersect_by_projection,
    "textbook": intersect_by_formula,
    "expanded": intersect_by_expansion,
}
"""Functions that intersect rays with a sphere, by name."""


def keep_origin(point: Shaped[Array, "3 n"], normal: Shaped[Array, "3 n"]) -> Shaped[Array, "3 n"]:
    """Start shadow rays at the points themselves."""
    return point


def move_along_normal(
    point: Shaped[Array, "3 n"], normal: Shaped[Array, "3 n"]
) -> Shaped[Array, "3 n"]:
    """Start shadow rays at a constant height above the surface."""
    return np.asarray(point + 1e-4 * normal)


def move_by_ulps(point: Shaped[Array, "3 n"], normal: Shaped[Array, "3 n"]) -> Shaped[Array, "3 n"]:
    """Start shadow rays at a height that grows with the coordinates, as their rounding errors do.

    The constants are those of Wächter and Binder (A Fast and Robust Method for Avoiding
    Self-Intersection, Ray Tracing Gems, chapter 6).
    """
    size = np.abs(point)
    return np.asarray(point + normal * np.where(size < 1 / 32, 1 / 65536, 256 * np.spacing(size)))


class ShadowMethod(NamedTuple):
    """A method of keeping a surface from shading its own points."""

    # Computes the origins of shadow rays from points of surfaces and their unit normals.
    move_origin: Callable[[Array, Array], Array]
    epsilon: float  # distance from the origin within which intersections are ignored
    # Whether shadow rays skip the object from which they start.  This is exact, because all objects
    # are convex.
    skips_own_object: bool = False


SHADOW_METHODS = {
    "exact": ShadowMethod(move_origin=keep_origin, epsilon=0, skips_own_object=True),
    "t>0": ShadowMethod(move_origin=keep_origin, epsilon=0),
    "t>1e-4": ShadowMethod(move_origin=keep_origin, epsilon=1e-4),
    "t>1e-6": ShadowMethod(move_origin=keep_origin, epsilon=1e-6),
    "normal": ShadowMethod(move_origin=move_along_normal, epsilon=0),
    "ulps": ShadowMethod(move_origin=move_by_ulps, epsilon=0),
}
"""Methods of keeping a surface from shading its own points, by name."""


class TracedRays(NamedTuple):
    """What camera rays meet, and the radiance that reaches the eye."""

    radiance: Shaped[NDArray[np.float64], "rays 3"]  # linear RGB
    surface_index: Shaped[NDArray[np.intp], "rays"]  # of the visible surface; -1: background
    # Whether the light reaches the visible point; False for the background.
    is_lit: Shaped[NDArray[np.bool_], "lights rays"]


def trace(
    scene: Scene,
    x: ArrayLike,
    y: ArrayLike,
    *,
    arithmetic: Literal["float64", "float32", "decimal"] = "float64",
    sphere_method: Literal["closest", "textbook", "expanded"] = "closest",
    shadow_method: Literal["exact", "t>0", "t>1e-4", "t>1e-6", "normal", "ulps"] = "exact",
    ties: Literal["first", "last"] = "first",
) -> TracedRays:
    """Trace a camera ray through each of n positions, and test it against every object.

    Raise KeyError if the name of a method is unknown.

    Parameters
    ----------
    x, y
        Positions in the picture, in pixels right and down from its upper left corner.  The first
        pixel has its centre at (0.5, 0.5).
    arithmetic
        The number type.  "decimal" has 80 digits.
    sphere_method
        How to intersect rays with spheres: accurately, by the quadratic formula of textbooks, or by
        an expanded form of it.
    shadow_method
        How to keep surfaces from shading their own points: by ignoring the object from which a
        shadow ray starts, by ignoring intersections within a distance t, or by moving the start of
        the ray along the normal by 1e-4 or by some units in the last place.
    ties
        Which of several equally close surfaces is visible: the first or the last in the scene file.
    """
    with decimal.localcontext(_DECIMALS), np.errstate(all="ignore"):
        tracer = _PlainTracer(scene, arithmetic, sphere_method, shadow_method, ties)
        return tracer.trace(np.asarray(x), np.asarray(y))


def render(
    scene: Scene, offset: Sequence[float] = (0, 0), **methods: Any
) -> Shaped[Array, "height width 3"]:
    """Render a scene with one sample per pixel, in linear RGB.

    Every ray is tested against every object.  All samples are shifted from the centres of their
    pixels by `offset`, in pixels right and down.  `methods` are keyword arguments of `trace`.
    """
    y, x = np.indices((scene.height, scene.width)).reshape(2, -1) + 0.5
    traced = trace(scene, x + offset[0], y + offset[1], **methods)
    return traced.radiance.reshape(scene.height, scene.width, 3)


class _PlainTracer:
    """A scene converted to one number type, with methods to trace rays through it."""

    scene: Scene
    surfaces: Sequence[Box | Sphere]
    to_precision: Callable[[Any], Any]  # converts numbers and arrays to the number type
    intersect_sphere: Callable[[Array, Array, Array, Array], Roots]
    shadow_method: ShadowMethod
    # Whether the last of several equally close surfaces is visible, instead of the first.
    last_wins_ties: bool
    eye: Shaped[Array, "3 1"]
    light_positions: list[Shaped[Array, "3 1"]]
    is_sphere: list[bool]  # others are boxes
    # For each surface, the centre (3, 1) and the radius (1, 1) of a sphere, or the lower and the
    # upper corner (3, 1) of a box.
    shapes: list[list[Array]]
    is_eye_inside: list[bool]  # whether the eye is inside the surface or on it
    scene_size: Any  # the largest absolute coordinate or radius in the scene
    # A length is treated as 0 if its ratio to another length is at most this number, which is 1e-50
    # in decimal arithmetic, otherwise 0.
    relative_tolerance: Any
    tolerance: Any  # `relative_tolerance` times `scene_size`

    def __init__(
        self, scene: Scene, arithmetic: str, sphere_method: str, shadow_method: str, ties: str
    ) -> None:
        """Convert a scene to a number type, and select methods (see the function `trace`)."""
        to_precision, relative_tolerance = ARITHMETICS[arithmetic]
        self.scene = scene
        self.surfaces = scene.surfaces[:]
        self.to_precision = to_precision
        self.last_wins_ties = {"first": False, "last": True}[ties]
        self.intersect_sphere = SPHERE_METHODS[sphere_method]
        self.shadow_method = SHADOW_METHODS[shadow_method]
        self.eye = to_precision(scene.camera.view_point)[:, None]
        self.light_positions = [to_precision(light.position)[:, None] for light in scene.lights]
        self.is_sphere = [isinstance(surface, Sphere) for surface in self.surfaces]
        self.shapes = []
        for each in self.surfaces:
            if isinstance(each, Sphere):
                shape: tuple[ArrayLike, ArrayLike] = each.center, [each.radius]
            else:
                shape = each.min_pt, each.max_pt
            self.shapes.append([to_precision(numbers)[:, None] for numbers in shape])
        lengths = [self.eye, *self.light_positions, *chain.from_iterable(self.shapes)]
        self.relative_tolerance = to_precision(relative_tolerance)
        self.scene_size = max(np.abs(array).max() for array in lengths)
        self.tolerance = self.relative_tolerance * self.scene_size
        surface_indices = range(len(self.shapes))
        distances = [self.compute_signed_distance(index, self.eye) for index in surface_indices]
        self.is_eye_inside = [bool(distance[0] <= 0) for distance in distances]

    def snap_to_zero(self, values: Shaped[Array, "..."], scale: Any) -> Shaped[Array, "..."]:
        """Replace decimal values with 0 where they are at most 1e-50 times a scale.

        The scale is a number, or an array that broadcasts.  Values of float types are returned as
        they are, not copied.
        """
        if not self.relative_tolerance:
            return values
        is_tiny = np.abs(values) <= self.relative_tolerance * scale
        return np.where(is_tiny, self.to_precision(0), values)

    def compute_signed_distance(
        self, surface_index: int, points: Shaped[Array, "3 n"]
    ) -> Shaped[Array, "n"]:
        """Compute distances from a surface: positive outside, 0 on the surface, negative inside.

        For a box, this is the largest of the signed distances from the planes of its sides.
        """
        if self.is_sphere[surface_index]:
            center, radius = self.shapes[surface_index]
            distance = _norm(points - center) - radius[0]
        else:
            low, high = self.shapes[surface_index]
            distance = np.maximum(low - points, points - high).max(axis=0)
        return self.snap_to_zero(distance, self.scene_size)

    def compute_ray_directions(
        self, x: Shaped[Array, "n"], y: Shaped[Array, "n"]
    ) -> Shaped[Array, "3 n"]:
        """Compute vectors from the eye to positions on the camera's window.

        The positions are in pixels right and down from the upper left corner of the picture.
        """
        to_precision, camera = self.to_precision, self.scene.camera
        width, height = self.scene.width, self.scene.height
        normal = to_precision(camera.normal)
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
        self,
        box_index: int,
        origin: Shaped[Array, "3 #n"],
        direction: Shaped[Array, "3 n"],
        is_closed: bool,
    ) -> Shaped[Roots, "3 n"]:
        """Intersect rays with the three slabs between opposite sides of a box.

        `box_index` is a surface index.  Return t at which rays enter each slab, and t at which they
        leave it.  The first t is larger if a ray misses the slab.  If `is_closed`, a ray that lies
        in the plane of a side is in the slab.
        """
        min_corner, max_corner = self.shapes[box_index]
        low = self.snap_to_zero(min_corner - origin, self.scene_size)
        high = self.snap_to_zero(max_corner - origin, self.scene_size)
        is_in_slab = (low <= 0) & (high >= 0) if is_closed else (low < 0) & (high > 0)
        # A ray parallel to the sides never enters or leaves: it is always inside, or never.
        parallel_far = np.where(is_in_slab, self.to_precision(np.inf), self.to_precision(-np.inf))
        t_low, t_high = low / direction, high / direction
        near = np.where(direction == 0, -parallel_far, np.minimum(t_low, t_high))
        return near, np.where(direction == 0, parallel_far, np.maximum(t_low, t_high))

    def intersect(
        self,
        surface_index: int,
        origin: Shaped[Array, "3 #n"],
        direction: Shaped[Array, "3 n"],
        is_closed: bool,
    ) -> Shaped[Roots, "n"]:
        """Intersect rays with a sphere or a box.

        If a ray misses the surface, the first t is larger, or both are NaN.  If `is_closed`, a ray
        that lies in the plane of a box's side may meet the box.
        """
        if self.is_sphere[surface_index]:
            center, radius = self.shapes[surface_index]
            return self.intersect_sphere(origin, direction, center, radius[0])
        near, far = self.intersect_slabs(surface_index, origin, direction, is_closed)
        return near.max(axis=0), far.min(axis=0)

    def trace(self, x: Shaped[Array, "n"], y: Shaped[Array, "n"]) -> TracedRays:
        """Trace a camera ray through each position in the picture.

        The positions are in pixels right and down from the upper left corner.
        """
        direction = self.compute_ray_directions(x, y)
        closest_t, visible_index = self.find_closest_hits(direction)
        # From here on, only rays that hit a surface.
        ray_index = np.flatnonzero(visible_index >= 0)
        own_index = visible_index[ray_index]
        direction = direction.take(ray_index, 1)
        points = self.eye + closest_t[ray_index] * direction
        points, normals = self.project_hits(own_index, points, direction)
        radiance = np.zeros((x.size, 3))
        is_lit = np.zeros((len(self.light_positions), x.size), dtype=np.bool_)
        for light_index, light in enumerate(self.scene.lights):
            light_position = self.light_positions[light_index]
            is_hit_lit = self.test_light(own_index, points, normals, light_position)
            is_lit[light_index, ray_index] = is_hit_lit
            unit_vectors = normals, _normalise(light_position - points), -_normalise(direction)
            reflected = self.reflect_light(own_index, is_hit_lit, unit_vectors)
            radiance[ray_index] += reflected * light.intensity
        return TracedRays(radiance=radiance, surface_index=visible_index, is_lit=is_lit)

    def reflect_light(
        self,
        own_index: Shaped[NDArray[np.intp], "n"],
        is_lit: Shaped[NDArray[np.bool_], "n"],
        unit_vectors: tuple[Shaped[Array, "3 n"], Shaped[Array, "3 n"], Shaped[Array, "3 n"]],
    ) -> Shaped[NDArray[np.float64], "n 3"]:
        """Compute the radiance that points reflect from a light of intensity 1; 0 if not lit.

        `own_index` is the index of the surface on which each point lies.  The unit vectors are the
        normals, and the directions to the light and to the eye.
        """
        radiance = np.zeros((own_index.size, 3))
        for surface_index in np.unique(own_index[is_lit]).tolist():
            hit_index = np.flatnonzero(is_lit & (own_index == surface_index))
            vectors = (vector.take(hit_index, 1) for vector in unit_vectors)
            radiance[hit_index] = self.compute_reflected_radiance(surface_index, *vectors)
        return radiance

    def find_closest_hits(
        self, direction: Shaped[Array, "3 n"]
    ) -> tuple[Shaped[Array, "n"], Shaped[NDArray[np.intp], "n"]]:
        """Find the smallest t at which each camera ray meets a surface, and the surface's index.

        If a ray meets none, t is infinite, and the index is -1.
        """
        direction_length = _norm(direction)
        closest_surface_index = np.full(direction.shape[1], -1)
        closest_t = self.to_precision(np.full(direction.shape[1], np.inf))
        # Of surfaces at the same t, the first one in this order remains the closest.
        surface_indices = range(len(self.shapes))
        for surface_index in reversed(surface_indices) if self.last_wins_ties else surface_indices:
            near, far = self.intersect(surface_index, self.eye, direction, is_closed=True)
            t = far if self.is_eye_inside[surface_index] else near
            is_ahead = (near <= far) & (t * direction_length > self.tolerance)
            is_closer = is_ahead & (t < closest_t * (1 - self.relative_tolerance))
            closest_t = np.where(is_closer, t, closest_t)
            closest_surface_index[is_closer] = surface_index
        return closest_t, closest_surface_index

    def project_hits(
        self,
        own_index: Shaped[NDArray[np.intp], "n"],
        points: Shaped[Array, "3 n"],
        direction: Shaped[Array, "3 n"],
    ) -> tuple[Shaped[Array, "3 n"], Shaped[Array, "3 n"]]:
        """Move hits of camera rays exactly onto their surfaces, and compute the unit normals there.

        `own_index` is the index of the surface that each ray hits.  The normals point to the side
        that the eye sees.
        """
        projected_points = np.zeros_like(points)
        normals = np.zeros_like(points)
        for surface_index in np.unique(own_index).tolist():
            hit_index = np.flatnonzero(own_index == surface_index)
            hits = points.take(hit_index, 1), direction.take(hit_index, 1)
            projected_hits = self.project_onto_surface(surface_index, *hits)
            projected_points[:, hit_index], normals[:, hit_index] = projected_hits
        return projected_points, normals

    def project_onto_surface(
        self, surface_index: int, points: Shaped[Array, "3 n"], direction: Shaped[Array, "3 n"]
    ) -> tuple[Shaped[Array, "3 n"], Shaped[Array, "3 n"]]:
        """Move hits of one surface exactly onto it, and compute the unit normals there.

        `direction` is that of the camera rays.  `points` may be changed in place.
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

    def test_light(
        self,
        own_index: Shaped[NDArray[np.intp], "n"],
        points: Shaped[Array, "3 n"],
        normals: Shaped[Array, "3 n"],
        light: Shaped[Array, "3 1"],
    ) -> Shaped[NDArray[np.bool_], "n"]:
        """Test whether a light is in front of points, and no surface blocks the segments to it.

        `own_index` is the index of the surface on which each point lies.
        """
        is_lit = np.asarray(_dot(normals, light - points) > self.tolerance)
        for occluder_index, is_eye_inside in enumerate(self.is_eye_inside):
            index = np.flatnonzero(is_lit)
            ray_origin = self.shadow_method.move_origin(points[:, index], normals[:, index])
            is_blocked = self.is_blocking(occluder_index, ray_origin, light)
            if self.shadow_method.skips_own_object:
                # A surface shades its own points only if it contains the eye, but not the light.
                is_own = own_index[index] == occluder_index
                is_blocked[is_own] = (
                    is_eye_inside and self.compute_signed_distance(occluder_index, light)[0] >= 0
                )
            is_lit[index] = ~is_blocked
        return is_lit

    def is_blocking(
        self, surface_index: int, points: Shaped[Array, "3 n"], light: Shaped[Array, "3 1"]
    ) -> Shaped[NDArray[np.bool_], "n"]:
        """Test whether a surface blocks the segment from each point to a light.

        Intersections at the ends of the segment do not count.  Neither do intersections so close to
        the point that the shadow method ignores them.
        """
        distance = _norm(light - points)
        direction = (light - points) / distance
        direction = self.snap_to_zero(direction, np.abs(direction).max(axis=0))
        min_t = self.to_precision(self.shadow_method.epsilon) + self.tolerance
        max_t = distance - self.tolerance

        def is_between(t: Array) -> Any:
            return (t > min_t) & (t < max_t)

        near, far = self.intersect(surface_index, points, direction, is_closed=False)
        is_blocked = (near <= far) & (is_between(near) | is_between(far))
        is_exact = self.relative_tolerance and self.shadow_method.skips_own_object
        if is_exact and self.is_sphere[surface_index]:
            # One intersection is known exactly if the light or the point is on the sphere.  The
            # other follows from symmetry: t = middle_t is halfway between them.
            middle_t = _dot(self.shapes[surface_index][0] - points, direction)
            is_light_on_sphere = self.compute_signed_distance(surface_index, light) == 0
            blocks_light_on_sphere = is_between(2 * middle_t - distance)
            is_blocked = np.where(is_light_on_sphere, blocks_light_on_sphere, is_blocked)
            is_point_on_sphere = self.compute_signed_distance(surface_index, points) == 0
            # A segment from a point on the sphere is blocked if it starts on the side hidden from
            # the eye, or if it meets the sphere again.
            if self.is_eye_inside[surface_index]:
                blocks_point_on_sphere = (middle_t < -self.tolerance) | is_between(2 * middle_t)
            else:
                blocks_point_on_sphere = middle_t > self.tolerance
            is_blocked = np.where(is_point_on_sphere, blocks_point_on_sphere, is_blocked)
        return np.asarray(is_blocked)

    def compute_reflected_radiance(
        self,
        surface_index: int,
        normals: Shaped[Array, "3 n"],
        to_light: Shaped[Array, "3 n"],
        to_eye: Shaped[Array, "3 n"],
    ) -> Shaped[NDArray[np.float64], "n 3"]:
        """Compute the radiance that lit points of one surface reflect from a light of intensity 1.

        All vectors are unit vectors.  The Lambert term is the diffuse colour times n.l, with the
        normal n and the vector l to the light.  The Blinn-Phong term is the specular colour times
        (n.h)^exponent, with h halfway between l and the vector to the eye.
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
