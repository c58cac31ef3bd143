"""The functions that formulas of `mistakes.md` call, beside NumPy's; and how a formula is read.

Vectors are (3, n) for n pixels, (lights, 3, n) for lights and (3, surfaces, 1) for surfaces.
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
    """Multiply vectors (..., 3, n)."""
    return (a * b).sum(axis=-2)


def at(surfaces: Array, surface: Array) -> Array:
    """Look up vectors (3, n) of surfaces by their indices (n,)."""
    return surfaces[:, surface, 0]


def middle(low: Array, high: Array, surface: Array) -> Array:
    """Centres (3, n) of boxes."""
    return (at(low, surface) + at(high, surface)) / 2


def sphere_roots(c: Array, r: Array, o: Array, d: Array, *, unit_d: bool = False) -> Array:
    """Both t (2, spheres, n) of rays o + t d; NaN where they miss.  `unit_d` takes d.d for 1."""
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
    """Both t (2, boxes, n); NaN where rays miss."""
    near, far = -np.inf, np.inf
    for k in range(3):
        ends = (low[k] - o[k]) / d[k], (high[k] - o[k]) / d[k]
        first, last = (np.minimum(*ends), np.maximum(*ends)) if ordered else ends
        near, far = np.maximum(near, first), np.minimum(far, last)
    return np.where(near <= far, np.stack([near, far]), np.nan)


def scaled(roots: Callable[..., Array], factor: float) -> Callable[..., Array]:
    """`sphere_roots` or `box_roots` with every t multiplied."""
    return lambda *given: factor * roots(*given)


def far_roots(intersect: Callable[..., Array]) -> Callable[..., Array]:
    """`intersection` with the larger t twice."""
    return lambda *given: intersect(*given)[[1, 1]]


def intersection(
    is_sphere: Array, center: Array, radius: Array, low: Array, high: Array, present: Array,
    of_spheres: Callable[..., Array], of_boxes: Callable[..., Array],
) -> Callable[[Array, Array], Array]:  # fmt: skip
    """Return a function of origins and directions (3, n): both t (2, surfaces, n)."""
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
    """The smaller t in front of the origin; infinite if there is none."""
    near, far = roots
    t = np.where(near > 1e-9, near, far)
    return np.where(t > 1e-9, t, np.inf)


def each_light(
    intersect: Callable[[Array, Array], Array], p: Array, to_lights: Array
) -> list[Array]:
    """Both t of shadow rays towards each light."""
    return [intersect(p, d) for d in to_lights]


def blockers(shadow_roots: list[Array], t_min: Array, t_max: Array, tested: Array) -> Array:
    """Which surfaces keep each light from each point (lights, surfaces, n)."""
    found = np.zeros((len(shadow_roots), *tested.shape), dtype=bool)
    for k, ((near, far), low, high) in enumerate(zip(shadow_roots, t_min, t_max, strict=True)):
        t = np.where(near > low, near, far)
        found[k] = (t > low) & (t < high) & tested
    return found


def box_normals(
    p: Array, low: Array, high: Array, turn: int = 0, sign: float | None = None
) -> Array:
    """Normals of the faces that points lie on, or of the next axis but `turn`, or of one `sign`."""
    from_center, half = p - (low + high) / 2, (high - low) / 2
    face = np.abs(np.abs(from_center) - half).argmin(axis=0)
    side = np.where(np.take_along_axis(from_center, face[None], axis=0)[0] < 0, -1.0, 1.0)
    return np.eye(3)[:, (face + turn) % 3] * (side if sign is None else sign)


def grey(shares: tuple[float, float, float], channels: Array) -> Array:
    """One mean for all channels (3, n)."""
    return np.tensordot(shares, channels, 1) + 1e-9 + 0 * channels


def fitted_brightness(radiance: Array, hit: Array, handin: Array) -> Array:
    """Multiply by the factor that most of the hand-in's pixels show."""
    usual = (handin > 8) & (handin < 247) & hit & (radiance > 1e-3)
    factors = ((handin / 255) ** 2.2)[usual] / radiance[usual]
    return np.where(hit, radiance * (np.median(factors) if factors.size else 1), 0)


def fitted_ambient(radiance: Array, kd: Array, hit: Array, handin: Array) -> Array:
    """Add the part of kd that most of the hand-in's pixels show."""
    usual = (handin > 8) & (handin < 247) & hit & (kd > 0.05)
    parts = (((handin / 255) ** 2.2)[usual] - radiance[usual]) / kd[usual]
    return np.where(hit, radiance + kd * (np.median(parts) if parts.size else 0), 0)


def fitted_gamma(coloured: Array, hit: Array, handin: Array) -> Array:
    """Encode with the gamma that most of the hand-in's pixels show."""
    usual = (handin > 8) & (handin < 247) & hit & (coloured > 0.01) & (coloured < 0.95)
    gammas = np.log(coloured[usual]) / np.log(handin[usual] / 255)
    return coloured ** (1 / np.clip(np.median(gammas) if gammas.size else 2.2, 0.1, 10))


def fitted_background(bytes: Array, hit: Array, handin: Array) -> Array:
    """Fill the background with the hand-in's commonest colour there."""
    if hit.all():
        return bytes
    shades, count = np.unique(handin[:, ~hit], axis=1, return_counts=True)
    return np.where(hit, bytes, shades[:, count.argmax()][:, None]).astype(np.uint8)


def light_in(picture: Array, x: Array, y: Array) -> Array:
    """Look up light (3, n) in a picture's (h, w, 3), interpolated between its pixels' centres."""
    height, width = picture.shape[:2]
    places = (0.5 - y) * height - 0.5, (x + 0.5) * width - 0.5
    channels = (picture[:, :, k] for k in range(3))
    return np.array([map_coordinates(c, places, order=1, mode="nearest") for c in channels])


def shown_in(picture: Array, x: Array, y: Array, handin: Array) -> Array:
    """Where something is seen: not where a picture is black, and the hand-in is not."""
    return light_in(picture, x, y).any(axis=0) | ~handin.any(axis=0)


_OWN: tuple[Callable[..., Any], ...] = (
    unit, dot, at, middle, sphere_roots, box_roots, scaled, intersection, first_positive, far_roots,
    each_light, blockers, box_normals, grey, fitted_ambient, fitted_background, fitted_brightness,
    fitted_gamma, light_in, shown_in, len, partial,
)  # fmt: skip
_NUMPY = """abs arange arccos array clip cos cross exp floor full_like inf int64 isfinite log
    logical_and maximum minimum nan_to_num pi repeat round sign sin sqrt take_along_axis uint8 where
    zeros"""
_FUNCTIONS = {function.__name__: function for function in _OWN}
_FUNCTIONS |= {name: getattr(np, name) for name in _NUMPY.split()}


@cache
def formula(expression: str) -> Callable[..., Any]:
    """Read a formula: a function, whose parameters are named as in the expression.

    Raises SyntaxError if it is not a Python expression.
    """
    names = {n.id for n in ast.walk(ast.parse(expression, mode="eval")) if isinstance(n, ast.Name)}
    wanted = sorted(names - _FUNCTIONS.keys())
    function: Callable[..., Any] = eval(f"lambda {', '.join(wanted)}: {expression}", _FUNCTIONS)
    return function


@cache
def parameters(function: Callable[..., Any]) -> tuple[str, ...]:
    """Name what a formula is computed from."""
    code = function.__code__
    return code.co_varnames[: code.co_argcount]
