"""Read the formulas of `mistakes.md`, and define the functions that they call.

A formula is a Python expression.  It becomes a function whose parameters are the names in the
expression, so that `reference.handins.drawing` can compute it from other formulas.  Vectors are
(3, n) for n pixels, (lights, 3, n) for lights and (3, surfaces, 1) for surfaces.  Rays are
o + t d, with origins `o` and directions `d`.
"""

from __future__ import annotations

import ast
from collections.abc import Callable
from functools import cache, partial
from typing import Any, TypeAlias

import numpy as np
from scipy.ndimage import map_coordinates

Array: TypeAlias = Any
Formulas: TypeAlias = dict[str, Callable[..., Any]]


def unit(v: Array, axis: int = 0) -> Array:
    """Scale vectors along an axis to length 1."""
    return v / np.sqrt((v * v).sum(axis=axis, keepdims=True))


def dot(a: Array, b: Array) -> Array:
    """Return the scalar products (..., n) of vectors (..., 3, n)."""
    return (a * b).sum(axis=-2)


def at(vectors: Array, surface: Array) -> Array:
    """Select, from the vectors (3, surfaces, 1) of surfaces, those of n indices: (3, n)."""
    return vectors[:, surface, 0]


def box_center(low: Array, high: Array, surface: Array) -> Array:
    """Return the centres (3, n) of the boxes that the indices `surface` (n,) select."""
    return (at(low, surface) + at(high, surface)) / 2


def sphere_roots(c: Array, r: Array, o: Array, d: Array, *, unit_d: bool = False) -> Array:
    """Intersect n rays with spheres.

    Parameters
    ----------
    c, r : (3, spheres, 1) and (spheres, 1) arrays
        Centres and radii.
    o, d : (3, n) arrays
        Origins and directions.
    unit_d : bool
        Whether to omit d.d, as if the directions had length 1.

    Returns
    -------
    t : (2, spheres, n) array
        Near and far t; NaN if the ray misses the sphere.
    """
    m = [c[k] - o[k] for k in range(3)]
    b = sum(m[k] * d[k] for k in range(3))
    if unit_d:
        root = np.sqrt(b * b - sum(m[k] * m[k] for k in range(3)) + r * r)
    else:
        a = (d * d).sum(axis=0)
        b = b / a
        root = np.sqrt((r * r - sum((m[k] - b * d[k]) ** 2 for k in range(3))) / a)
    return np.stack([b - root, b + root])


def box_roots(low: Array, high: Array, o: Array, d: Array, *, ordered: bool = True) -> Array:
    """Intersect n rays with boxes: near and far t (2, boxes, n), or NaN.

    Parameters
    ----------
    low, high : (3, boxes, 1) arrays
        Opposite corners.
    o, d : (3, n) arrays
        Origins and directions.
    ordered : bool
        Whether to sort the two t of each pair of faces; false is a mistake.
    """
    near, far = -np.inf, np.inf
    for k in range(3):
        ends = (low[k] - o[k]) / d[k], (high[k] - o[k]) / d[k]
        first, last = (np.minimum(*ends), np.maximum(*ends)) if ordered else ends
        near, far = np.maximum(near, first), np.minimum(far, last)
    return np.where(near <= far, np.stack([near, far]), np.nan)


def scaled(roots: Callable[..., Array], factor: float) -> Callable[..., Array]:
    """Return the function `roots`, with every t that it returns multiplied by `factor`."""
    return lambda *given: factor * roots(*given)


def far_roots(intersect: Callable[..., Array]) -> Callable[..., Array]:
    """Return the function `intersect`, with the far t in place of the near one."""
    return lambda *given: intersect(*given)[[1, 1]]


def intersection(
    is_sphere: Array, center: Array, radius: Array, low: Array, high: Array, present: Array,
    of_spheres: Callable[..., Array], of_boxes: Callable[..., Array],
) -> Callable[[Array, Array], Array]:  # fmt: skip
    """Return a function that intersects rays with all surfaces.

    Parameters
    ----------
    is_sphere, present : (surfaces,) bool array
        Whether a surface is a sphere, and whether it is in the picture at all.
    center, radius, low, high : array
        Vectors and numbers of spheres and of boxes, as `sphere_roots` and `box_roots` take them;
        each has an entry for every surface.
    of_spheres, of_boxes : callable
        Functions such as `sphere_roots` and `box_roots`.

    Returns
    -------
    intersect : callable
        Takes origins and directions (3, n), and returns near and far t (2, surfaces, n).
    """
    balls, boxes = np.flatnonzero(is_sphere & present), np.flatnonzero(~is_sphere & present)

    def intersect(o: Array, d: Array) -> Array:
        t = np.full((2, len(is_sphere), d.shape[1]), np.nan)
        if balls.size:
            t[:, balls] = of_spheres(center[:, balls], radius[balls], o, d)
        if boxes.size:
            t[:, boxes] = of_boxes(low[:, boxes], high[:, boxes], o, d)
        return t

    return intersect


def first_positive(roots: Array) -> Array:
    """Return the smallest t > 0 of near and far t (2, ...), or infinity."""
    near, far = roots
    t = np.where(near > 1e-9, near, far)
    return np.where(t > 1e-9, t, np.inf)


def each_light(intersect: Callable[[Array, Array], Array], p: Array, to_lights: Array) -> Array:
    """Intersect the rays from hits `p` (3, n) along `to_lights` (lights, 3, n).

    The result contains near and far t (lights, 2, surfaces, n).
    """
    roots = [intersect(p, d) for d in to_lights]
    return np.array(roots) if roots else np.zeros((0, 2, 1, 1))


def blockers(
    shadow_roots: Array, t_min: Array, t_max: Array, tested: Array, far_min: float | None = None
) -> Array:
    """Test which surfaces block each light from each hit: (lights, surfaces, n) bools.

    Parameters
    ----------
    shadow_roots : (lights, 2, surfaces, n) array
        Near and far t of the shadow rays.
    t_min, t_max : (lights, n) array
        A surface blocks the light if its first t beyond `t_min` is smaller than `t_max`.
    tested : (surfaces, n) bool array
        Whether the surface is tested for the hit.
    far_min : float, optional
        Replaces `t_min` for the far t.
    """
    is_blocking = np.zeros((len(shadow_roots), *tested.shape), dtype=bool)
    for k, ((near, far), low, high) in enumerate(zip(shadow_roots, t_min, t_max, strict=True)):
        t = np.where(
            near > low, near, np.where(far > (low if far_min is None else far_min), far, np.nan)
        )
        is_blocking[k] = (t < high) & tested
    return is_blocking


def last_of(values: Array, is_chosen: Array) -> Array:
    """Return the value (..., 1) of the last chosen surface, of values (..., surfaces), or 0."""
    chosen = np.flatnonzero(is_chosen)
    return values[..., chosen[-1:]] if chosen.size else 0 * values[..., :1]


def box_normals(
    p: Array, low: Array, high: Array, turn: int = 0, sign: float | None = None
) -> Array:
    """Return the outward normals (3, n) at hits on boxes.

    Parameters
    ----------
    p, low, high : (3, n) arrays
        The hits, and opposite corners of the boxes.
    turn : int
        Number that is added to the index of the normal's axis; 0 is right.
    sign : float, optional
        The sign of all normals, in place of the right one.
    """
    from_center, half = p - (low + high) / 2, (high - low) / 2
    face = np.abs(np.abs(from_center) - half).argmin(axis=0)
    side = np.where(np.take_along_axis(from_center, face[None], axis=0)[0] < 0, -1.0, 1.0)
    return np.eye(3)[:, (face + turn) % 3] * (side if sign is None else sign)


def grey(shares: tuple[float, float, float], channels: Array) -> Array:
    """Return the weighted mean of the channels (3, n) in all channels."""
    return np.tensordot(shares, channels, 1) + 1e-9 + 0 * channels


def _usual_values(handin: Array, hit: Array, expected: Array, limit: float) -> tuple[Array, Array]:
    """Select the values that show a factor, a gamma or an ambient term best.

    Parameters
    ----------
    handin : (3, n) uint8 array
        The hand-in's codes.  Codes that may be clipped, or have few digits, are not selected.
    hit : (n,) bool array
        Whether a surface is hit.
    expected : (3, n) float array
        Right values; only those above `limit` are selected.

    Returns
    -------
    index : (3, n) bool array
        Which values are selected.
    light : (k,) float array
        The hand-in's linear light at these.
    """
    usual = (handin > 8) & (handin < 247) & hit & (expected > limit)
    return usual, (handin[usual] / 255) ** 2.2


def _median(values: Array, default: float) -> float:
    """Return the median of values, or `default` if there are none."""
    return float(np.median(values)) if values.size else default


def median_factor(radiance: Array, hit: Array, handin: Array) -> float:
    """Return the factor by which most of the hand-in's values are brighter than `radiance`."""
    usual, light = _usual_values(handin, hit, radiance, 1e-3)
    return _median(light / radiance[usual], 1.0)


def median_ambient(radiance: Array, kd: Array, hit: Array, handin: Array) -> float:
    """Return the multiple of the diffuse colour `kd` that most of the hand-in's values add."""
    usual, light = _usual_values(handin, hit, kd + 0 * radiance, 0.05)
    return _median((light - radiance[usual]) / (kd + 0 * radiance)[usual], 0.0)


def median_gamma(coloured: Array, hit: Array, handin: Array) -> float:
    """Return the gamma with which most of the hand-in's values are encoded, 0.1 to 10."""
    usual, light = _usual_values(handin, hit & (coloured < 0.95), coloured, 0.01)
    gamma = _median(2.2 * np.log(coloured[usual]) / np.log(light), 2.2)
    return min(max(gamma, 0.1), 10.0)


def commonest_color(hit: Array, handin: Array) -> Array:
    """Return the hand-in's commonest colour (3, 1) where no surface is hit."""
    if hit.all():
        return np.zeros((3, 1), dtype=np.uint8)
    colors, count = np.unique(handin[:, ~hit], axis=1, return_counts=True)
    return colors[:, [count.argmax()]]


def light_in(picture: Array, x: Array, y: Array) -> Array:
    """Return the light (3, n) of a picture (h, w, 3), interpolated between the pixels' centres.

    `x` and `y` (n,) are coordinates in the window: from -0.5 to 0.5, to the right and upwards.
    """
    height, width = picture.shape[:2]
    places = (0.5 - y) * height - 0.5, (x + 0.5) * width - 0.5
    channels = (picture[:, :, k] for k in range(3))
    return np.array([map_coordinates(c, places, order=1, mode="nearest") for c in channels])


def shown_in(picture: Array, x: Array, y: Array, handin: Array) -> Array:
    """Return whether a pixel shows a surface, judged by a right picture and a hand-in (3, n).

    Only the background is black in the picture and not in the hand-in.
    """
    return light_in(picture, x, y).any(axis=0) | ~handin.any(axis=0)


_OWN: tuple[Callable[..., Any], ...] = (
    unit, dot, at, box_center, sphere_roots, box_roots, scaled, intersection, first_positive,
    far_roots, each_light, blockers, last_of, box_normals, grey, commonest_color, median_ambient,
    median_factor, median_gamma, light_in, shown_in, len, partial,
)  # fmt: skip
_NUMPY = """abs arange arccos array ceil clip cos cross exp floor full_like inf int64 isfinite log
    logical_and maximum minimum nan_to_num pi repeat round sign sin sqrt take_along_axis trunc uint8
    where zeros"""
_FUNCTIONS = {function.__name__: function for function in _OWN}
_FUNCTIONS |= {name: getattr(np, name) for name in _NUMPY.split()}


@cache
def formula(expression: str) -> Callable[..., Any]:
    """Convert an expression to a function; its parameters are the names that it uses.

    Raises
    ------
    SyntaxError
        If it is not a Python expression.
    """
    names = {n.id for n in ast.walk(ast.parse(expression, mode="eval")) if isinstance(n, ast.Name)}
    arguments = sorted(names - _FUNCTIONS.keys())
    function: Callable[..., Any] = eval(f"lambda {', '.join(arguments)}: {expression}", _FUNCTIONS)
    return function


@cache
def parameters(function: Callable[..., Any]) -> tuple[str, ...]:
    """Return the names of the values that a formula is computed from."""
    code = function.__code__
    return code.co_varnames[: code.co_argcount]
