"""Pictures as the tracers of beginners make them: a small tracer of the format, with mistakes.

It draws what `tracer` does but for the mistakes that it is asked for, by the names in its code.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tracer import Box, Lambertian, Phong, Scene, Sphere, render

Array = NDArray[np.float64]
Image8 = NDArray[np.uint8]


def unit(vector: ArrayLike) -> Array:
    vectors: Array = np.asarray(vector, dtype=float)
    return vectors / np.sqrt((vectors**2).sum(axis=-1, keepdims=True))


def rays(scene: Scene, *mistakes: str) -> tuple[Array, Array]:
    """The eye (3,) and a direction (h, w, 3) for each pixel."""
    c, width, height = scene.camera, scene.width, scene.height
    normal = c.view_dir if "projNormal ignored" in mistakes else c.proj_normal or c.view_dir
    up = (0, 1, 0) if "viewUp ignored" in mistakes else c.view_up
    w = unit(normal) * -np.sign(np.dot(normal, c.view_dir))
    u = unit(np.cross(up, w))
    v = np.cross(w, u)
    across, down = c.view_width, c.view_height
    if "window's sides exchanged" in mistakes:
        across, down = down, across
    if "viewHeight ignored" in mistakes:
        down = across
    if "window ignored" in mistakes:
        across = down = 1
    corners, ends = "corners" in mistakes, "ends" in mistakes
    x, y = (
        (np.arange(n) + (0 if corners or ends else 0.5)) / (n - ends) - 0.5 for n in (width, height)
    )
    y = -y
    x = -x if "mirrored" in mistakes else x
    y = -y if "upside down" in mistakes else y
    ahead = np.array(c.view_dir) if "viewDir not normalised" in mistakes else unit(c.view_dir)
    distance = 1 if "projDistance ignored" in mistakes else c.proj_distance
    window = x[None, :, None] * across * u + y[:, None, None] * down * v
    return np.array(c.view_point), window + distance * ahead


@np.errstate(all="ignore")
def meet(surface: Sphere | Box, origin: Array, d: Array, least: float = 1e-6) -> Array:
    """Distances (h, w) over `least` where rays meet a surface, infinite where not at all."""
    if isinstance(surface, Sphere):
        o = origin - surface.center
        a, b, c = (d * d).sum(-1), (d * o).sum(-1), (o * o).sum(-1) - surface.radius**2
        root = np.sqrt(b * b - a * c)
        near, far = (-b - root) / a, (-b + root) / a
    else:
        slabs = np.sort([(side - origin) / d for side in (surface.min_pt, surface.max_pt)], axis=0)
        near, far = slabs[0].max(-1), slabs[1].min(-1)
        far = np.where(near <= far, far, -np.inf)
        near = np.where(near <= far, near, -np.inf)
    t = np.where(near > least, near, far)
    return np.where(t > least, t, np.inf)


def visible(scene: Scene, *mistakes: str) -> tuple[Array, Array]:
    """What is seen: points (h, w, 3) and the places of their surfaces (h, w); NaN for nothing."""
    eye, d = rays(scene, *mistakes)
    nearest = np.full(d.shape[:2], np.inf)
    owner = np.full(d.shape[:2], np.nan)
    for index, surface in enumerate(scene.surfaces):
        t = meet(surface, eye, d)
        closer = np.isfinite(t) if "last surface wins" in mistakes else t < nearest
        nearest[closer], owner[closer] = t[closer], index
    with np.errstate(invalid="ignore"):
        points = eye + nearest[:, :, None] * d
    return np.where(np.isfinite(points), points, np.nan), owner


def normals(surface: Sphere | Box, p: Array, *mistakes: str) -> Array:
    if isinstance(surface, Sphere):
        n = p - surface.center
        return n if "normals not normalised" in mistakes else n / surface.radius
    low, high = np.array(surface.min_pt), np.array(surface.max_pt)
    near = np.stack([np.abs(p - low), np.abs(p - high)])
    face = near == near.min(axis=(0, -1))[None, ..., None]
    return unit(face[1].astype(float) - face[0])


@np.errstate(all="ignore")
def radiance(scene: Scene, *mistakes: str) -> Array:
    points, owner = visible(scene, *mistakes)
    image = np.zeros(points.shape)
    if "background" in mistakes:
        image[:] = (0.1, 0.2, 0.5)
    eye = np.array(scene.camera.view_point)
    surfaces, lights = list(scene.surfaces), list(scene.lights)
    if "first light only" in mistakes:
        lights = lights[:1]
    for index, surface in enumerate(surfaces):
        own = owner == index
        p, shader = points[own], surface.shader
        n = normals(surface, p, *mistakes)
        n *= np.sign((n * (eye - p)).sum(-1))[:, None]  # a box may be seen from within
        if "normals inwards" in mistakes:
            n = -n
        kd = np.array(shader.diffuse if "white" not in mistakes else (1, 1, 1))
        light_up = np.zeros(p.shape)
        everywhere = {"ambient": 0.1 * kd, "one colour": (1, 0.5, 0), "no shading": kd}
        for mistake in {*everywhere} & {*mistakes}:
            light_up += everywhere[mistake]
        unlit = "one colour" in mistakes or "no shading" in mistakes
        for light in () if unlit else lights:
            way = np.array(light.position) - p
            distance = np.sqrt((way * way).sum(-1))
            to_light, to_eye = way / distance[:, None], unit(eye - p)
            if "light not normalised" in mistakes:
                to_light = way
            cosine = (n * to_light).sum(-1)
            facing = cosine > 0
            if "absolute cosine" in mistakes:
                cosine, facing = np.abs(cosine), True
            if "no clamp" not in mistakes:
                cosine = np.maximum(cosine, 0)
            lit = np.ones(len(p), dtype=bool)
            for other in range(len(surfaces)) if "no shadows" not in mistakes else ():
                if other == index and "acne" in mistakes:
                    # Rounding has put some of the points behind their own surface.
                    t = meet(surface, p.astype(np.float32).astype(float), way, 0)
                elif other == index:
                    continue
                else:
                    t = meet(surfaces[other], p, way)
                lit &= ~(t < (np.inf if "shadows behind the light" in mistakes else 1))
            returned = kd * cosine[:, None]
            if isinstance(shader, Phong) and "no highlights" not in mistakes:
                half = to_light + to_eye
                mirror = 2 * (n * to_light).sum(-1)[:, None] * n - to_light
                angle = n * (half if "half vector not normalised" in mistakes else unit(half))
                if "Phong" in mistakes:
                    angle = mirror * to_eye
                exponent = 2 if "exponent ignored" in mistakes else shader.exponent
                power = np.maximum(angle.sum(-1), 0) ** exponent
                returned += np.where(facing, power, 0)[:, None] * np.array(shader.specular)
            if "falls off" in mistakes:
                returned /= distance[:, None] ** 2
            light_up += np.where(lit[:, None], returned * light.intensity, 0)
        image[own] = light_up
    return image


CURVES: dict[str, Callable[[Array], Array]] = {
    "no gamma": lambda x: x,
    "gamma 1.8": lambda x: x ** (1 / 1.8),
    "gamma twice": lambda x: x ** (1 / 4.84),
    "gamma upside down": lambda x: x**2.2,
    "sRGB": lambda x: np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055),
}


def picture(scene: Scene, *mistakes: str) -> Image8:
    """Codes (h, w, 3) of a scene, drawn with mistakes."""
    light = np.nan_to_num(radiance(scene, *mistakes))
    if "whole numbers" in mistakes:
        light = np.floor(light)
    if "scaled" in mistakes:
        light = light / light.max()
    if "darker" in mistakes:
        light = light * 0.5
    curve = next((CURVES[name] for name in mistakes if name in CURVES), lambda x: x ** (1 / 2.2))
    levels = 255 * curve(np.maximum(light, 0) if "wraps" in mistakes else np.clip(light, 0, 1))
    codes = (levels if "cut off" in mistakes else np.round(levels)).astype(int) % 256
    codes = codes.astype(np.uint8)
    codes = codes[:, :, ::-1] if "BGR" in mistakes else codes
    codes = codes.transpose(1, 0, 2) if "transposed" in mistakes else codes
    return np.ascontiguousarray(codes)


def no_highlights(scene: Scene) -> Array:
    """Every shader's diffuse part alone."""
    matte = [replace(s, shader=Lambertian(diffuse=s.shader.diffuse)) for s in scene.surfaces]
    return render(replace(scene, surfaces=matte))


def no_shadows(scene: Scene) -> Array:
    """Each surface as if it were alone in the world."""
    return radiance(scene, "no shadows")
