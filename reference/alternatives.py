"""What the tracer does not do: the usual methods, kept for the charts that judge them.

A plain renderer of the same model (every ray against every object) whose
arithmetic, sphere intersection and shadow offset can be chosen.  In 50-digit
decimals it is the exact answer; in float32, with the textbook's quadratic or
with a fixed epsilon, it is what the charts show to fail.

It shares no code with the tracer.  The eye is outside of all objects.
"""

from __future__ import annotations

import decimal
from collections.abc import Callable
from decimal import Decimal
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tracer.arrays import Floats
from tracer.scene.model import Scene
from tracer.scene.objects import Phong

__all__ = [
    "SHADOW_STARTS",
    "Arithmetic",
    "Array",
    "Roots",
    "ShadowStart",
    "closest_approach",
    "exactly",
    "expanded",
    "float32",
    "float64",
    "render",
    "textbook",
]

Array: TypeAlias = NDArray[Any]
"""Numbers of any arithmetic: float32, float64, or Decimal objects."""

Arithmetic: TypeAlias = Callable[[ArrayLike], Array]
"""Casts to the numbers that a rendering is to be computed in."""

Roots: TypeAlias = Callable[[Array, Array, Array, Array], tuple[Array, Array]]
"""From origin, direction, centre and radius to near and far t (NaN: none)."""

ShadowStart: TypeAlias = Callable[[Array, Array], tuple[Array, float]]
"""From hit point and normal to where the shadow ray starts, and the least t that blocks."""


def float32(values: ArrayLike) -> Array:
    """Single precision, as on graphics cards and in Mitsuba's usual variants."""
    return np.asarray(values, dtype=np.float32)


def float64(values: ArrayLike) -> Array:
    """Double precision."""
    return np.asarray(values, dtype=np.float64)


def exactly(values: ArrayLike) -> Array:
    """Decimals of 50 digits: the judge."""
    cast = np.frompyfunc(Decimal, 1, 1)(np.asarray(values, dtype=np.float64))
    return np.asarray(cast, dtype=object)


def _dot(a: Array, b: Array) -> Array:
    product: Array = a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
    return product


def _unit(a: Array) -> Array:
    scaled: Array = a / np.sqrt(_dot(a, a))
    return scaled


def _cross(a: Array, b: Array) -> Array:
    return np.array(
        [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
    )


def textbook(o: Array, d: Array, c: Array, r: Array) -> tuple[Array, Array]:
    """The quadratic formula as most textbooks print it: error grows as eps D^2."""
    m = o - c
    return _quadratic(_dot(d, d), 2 * _dot(m, d), _dot(m, m) - r * r)


def expanded(o: Array, d: Array, c: Array, r: Array) -> tuple[Array, Array]:
    """The same with |o - c|^2 multiplied out: error grows as the square of an offset, too."""
    b = 2 * (_dot(o, d) - _dot(c, d))
    return _quadratic(_dot(d, d), b, _dot(o, o) - 2 * _dot(o, c) + _dot(c, c) - r * r)


def _quadratic(a: Array, b: Array, c: Array) -> tuple[Array, Array]:
    root = np.sqrt(b * b - 4 * a * c)
    return (-b - root) / (2 * a), (-b + root) / (2 * a)


def closest_approach(o: Array, d: Array, c: Array, r: Array) -> tuple[Array, Array]:
    """Haines, Günther and Akenine-Möller (Ray Tracing Gems, ch. 7): error grows as eps D.

    The roots come in the stable form (Numerical Recipes, 5.6), which does not
    cancel on a sphere much larger than the origin's distance from it.
    """
    m = c - o
    a, b = _dot(d, d), _dot(m, d)
    offset = m - b / a * d
    root = np.sqrt(a * (r * r - _dot(offset, offset)))
    q = np.where(b < 0, b - root, b + root)
    first, second = q / a, (_dot(m, m) - r * r) / q
    return np.minimum(first, second), np.maximum(first, second)


def _after(least: float) -> ShadowStart:
    return lambda p, n: (p, least)


def _along_normal(p: Array, n: Array) -> tuple[Array, float]:
    return p + 1e-4 * n, 0.0


def _ulps(p: Array, n: Array) -> tuple[Array, float]:
    """Wächter and Binder (Ray Tracing Gems, ch. 6), with their constants."""
    return p + n * np.where(np.abs(p) < 1 / 32, 1 / 65536, 256 * np.spacing(np.abs(p))), 0.0


SHADOW_STARTS: dict[str, ShadowStart] = {
    "t > 0": _after(0.0),
    "t > 1e-4": _after(1e-4),
    "t > 1e-6": _after(1e-6),
    "normal offset 1e-4": _along_normal,
    "offset of 256 ulp": _ulps,
}
"""The usual ways to keep a surface from shadowing itself."""


def render(
    scene: Scene,
    arithmetic: Arithmetic = float64,
    *,
    roots: Roots = closest_approach,
    shadow_start: ShadowStart | None = None,
    offset: tuple[float, float] = (0.0, 0.0),
) -> Floats:
    """Render a scene, one sample a pixel, every ray against every object.

    Parameters
    ----------
    scene : Scene
        The eye must lie outside of all objects.
    arithmetic : Arithmetic
        What to compute in.
    roots : Roots
        How rays meet spheres.
    shadow_start : ShadowStart, optional
        Where shadow rays start.  If absent they start at the hit point, and
        the object itself is left out, which is exact for convex objects.
    offset : (float, float)
        Moves every sample, in pixels to the right and down.

    Returns
    -------
    image : (height, width, 3) float64
        Linear RGB radiance; row 0 is the top.
    """
    with decimal.localcontext() as context, np.errstate(all="ignore"):
        context.prec = 50
        context.clear_traps()
        return _render(scene, arithmetic, roots, shadow_start, offset)


def _render(
    scene: Scene,
    cast: Arithmetic,
    roots: Roots,
    shadow_start: ShadowStart | None,
    offset: tuple[float, float],
) -> Floats:
    surfaces, count = scene.surfaces, scene.width * scene.height
    spheres = surfaces.sphere_count
    center, radius = cast(surfaces.center)[:, :, None], cast(surfaces.radius)
    low, high = cast(surfaces.min_pt)[:, :, None], cast(surfaces.max_pt)[:, :, None]

    def intersect(k: int, o: Array, d: Array) -> tuple[Array, Array]:
        if k < spheres:
            return roots(o, d, center[k], radius[k])
        return _slabs(o, d, low[k - spheres], high[k - spheres])

    o = cast(scene.camera.view_point)[:, None]
    d = _directions(scene, cast, offset)
    nearest = np.broadcast_to(cast(np.inf), count).copy()
    owner = np.full(count, -1)
    for k in np.argsort(surfaces.file_index).tolist():
        t, far = intersect(k, o, d)
        closer = (t > 0) & (t < nearest) & (t <= far)
        nearest = np.where(closer, t, nearest)
        owner[closer] = k

    seen = np.flatnonzero(owner >= 0)
    owner, d = owner[seen], d[:, seen]
    p = o + nearest[seen] * d
    n = np.empty_like(p)
    for k in np.unique(owner).tolist():
        mine = owner == k
        if k < spheres:
            n[:, mine] = (p[:, mine] - center[k]) / radius[k]
            p[:, mine] = center[k] + radius[k] * n[:, mine]
        else:
            n[:, mine] = _entered(o, d[:, mine], low[k - spheres], high[k - spheres])

    shader = surfaces.shader_index[owner]
    radiance = np.zeros((count, 3))
    for light in scene.lights:
        to_light = cast(light.position)[:, None] - p
        distance = np.sqrt(_dot(to_light, to_light))
        lit = _dot(n, to_light) > 0
        start, least = (p, 0.0) if shadow_start is None else shadow_start(p, n)
        ray = cast(light.position)[:, None] - start
        reach = np.sqrt(_dot(ray, ray))
        beyond = cast(least)
        for k in range(len(surfaces)):
            near, far = intersect(k, start, ray / reach)
            between = ((near > beyond) & (near < reach)) | ((far > beyond) & (far < reach))
            blocks = between & (near <= far)
            lit &= ~(blocks & ((owner != k) | (shadow_start is not None)))
        wi, wo = to_light / distance, -d / np.sqrt(_dot(d, d))
        for index, material in enumerate(surfaces.shaders):
            mine = np.flatnonzero(lit & (shader == index))
            value = np.outer(_dot(n, wi)[mine].astype(float), material.diffuse)
            if isinstance(material, Phong):
                cosine = _dot(n, _unit(wi + wo))[mine]
                lobe = np.where(cosine > 0, cosine, 0) ** cast(material.exponent)
                value = value + np.outer(lobe.astype(float), material.specular)
            radiance[seen[mine]] += value * light.intensity
    return radiance.reshape(scene.height, scene.width, 3)


def _directions(scene: Scene, cast: Arithmetic, offset: tuple[float, float]) -> Array:
    """Camera rays (3, pixels), from the eye to the window."""
    camera, width, height = scene.camera, scene.width, scene.height
    ahead = _unit(cast(camera.view_dir))
    w = _unit(cast(camera.normal))
    if _dot(w, ahead) > 0:
        w = -w
    u = _unit(_cross(cast(camera.view_up), w))
    v = _cross(w, u)
    right = cast(2 * (np.arange(width) + offset[0]) + 1 - width) / (2 * width)
    up = cast(height - 1 - 2 * (np.arange(height) + offset[1])) / (2 * height)
    s, g = np.meshgrid(right * cast(camera.view_width), up * cast(camera.view_height))
    middle = ahead * cast(camera.proj_distance)
    return np.array([middle[k] + s.ravel() * u[k] + g.ravel() * v[k] for k in range(3)])


def _slabs(o: Array, d: Array, low: Array, high: Array) -> tuple[Array, Array]:
    a, b = (low - o) / d, (high - o) / d
    return np.minimum(a, b).max(axis=0), np.maximum(a, b).min(axis=0)


def _entered(o: Array, d: Array, low: Array, high: Array) -> Array:
    """Normal of the face by which rays enter a box."""
    axis = np.minimum((low - o) / d, (high - o) / d).argmax(axis=0)
    return np.where(np.arange(3)[:, None] == axis, np.where(d > 0, -1, 1), 0 * d)
