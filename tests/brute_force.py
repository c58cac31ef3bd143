"""The tracer without its culling: every ray against every object, one object at a time.

It takes the tracer's own rays, exact pair tests and highlight, and nothing
that decides which pairs to test; in the same arithmetic, so that its picture
must be the same to the last bit.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from probe import Surface, Vector

from tracer.camera import Raster, raster_of
from tracer.groups import Bools, Triple, dot
from tracer.intersection import (
    INSIDE,
    ON,
    SURFACE_TOLERANCE,
    box_blocks,
    box_hit,
    sphere_blocks,
    sphere_hit,
    sphere_side,
)
from tracer.scene import Box, Floats, Ints, Phong, Scene, Sphere
from tracer.shading import highlight

__all__ = ["blocks", "brute_force", "light_side", "size_of"]


@np.errstate(all="ignore")
def brute_force(scene: Scene) -> Floats:
    """The picture (height, width, 3) of a scene, by all pairs."""
    surfaces = scene.surfaces[:]
    raster = raster_of(scene.camera, scene.width, scene.height)
    inside = np.array([_eye_inside(raster, surface) for surface in surfaces], dtype=np.bool_)
    x, y = (0.5 + np.arange(n, dtype=np.float64) for n in (scene.width, scene.height))
    s, g = np.tile(raster.across(x), scene.height), np.repeat(raster.down(y), scene.width)
    u, v, w = raster.axes.tolist()
    d = _triple([s * u[k] + (g * v[k] + raster.depth * w[k]) for k in range(3)])

    nearest = np.full(s.size, np.inf)
    owner, face = np.full(s.size, -1), np.full(s.size, 3)
    for i, surface in enumerate(surfaces):
        t, axis = _hit(raster, s, g, d, surface)
        first = t < nearest
        nearest[first], owner[first], face[first] = t[first], i, axis[first]

    at = np.flatnonzero(owner >= 0)
    own, face, t, d = owner[at], face[at], nearest[at], _part(d, at)
    p, n = _points(raster, surfaces, own, face, t, d, inside)
    length = np.sqrt(dot(d, d))
    view = _triple([c * (-1 / length) for c in d])
    ray = _triple([p[k] - raster.eye[k] for k in range(3)])
    reach = np.sqrt(dot(ray, ray)) + sum(np.abs(c) for c in p)
    fallen, mirrored = np.zeros((2, at.size, 3))
    for light in scene.lights:
        to_light = _triple([light.position[k] - p[k] for k in range(3)])
        projected = dot(n, to_light)
        sides = np.array([light_side(surface, light.position) for surface in surfaces])
        lit = (projected > 0) & ~(inside & (sides != INSIDE))[own]
        for i, other in enumerate(surfaces):
            open_ = np.flatnonzero(lit & (own != i))
            lit[open_] = ~blocks(
                other,
                bool(inside[i]),
                int(sides[i]),
                _part(p, open_),
                _part(to_light, open_),
                light.position,
                reach[open_],
            )
        inverse = 1 / np.sqrt(dot(to_light, to_light))
        cosine = projected * inverse
        wi = _triple([c * inverse for c in to_light])
        for i in np.unique(own[lit]).tolist():
            seen, shader = np.flatnonzero(lit & (own == i)), surfaces[i].shader
            for k in range(3):
                fallen[seen, k] += light.intensity[k] * cosine[seen]
            if isinstance(shader, Phong) and any(shader.specular):
                exponent = np.asarray(shader.exponent)
                power = highlight(_part(n, seen), _part(wi, seen), _part(view, seen), exponent)
                for k in range(3):
                    mirrored[seen, k] += light.intensity[k] * power
    image = np.zeros((s.size, 3))
    for i in np.unique(own).tolist():
        seen, shader = np.flatnonzero(own == i), surfaces[i].shader
        image[at[seen]] = fallen[seen] * shader.diffuse
        if isinstance(shader, Phong):
            image[at[seen]] += mirrored[seen] * shader.specular
    return image.reshape(scene.height, scene.width, 3)


def _triple(values: list[Floats]) -> Triple:
    x, y, z = values
    return x, y, z


def _part(vector: Triple, index: Ints) -> Triple:
    return vector[0][index], vector[1][index], vector[2][index]


def _power(raster: Raster, sphere: Sphere) -> Floats:
    """|centre - eye|^2 - radius^2 (1,)."""
    u, v, w = raster.local(np.array([sphere.center]))
    distance = np.sqrt(u * u + v * v + w * w)
    power: Floats = (distance - sphere.radius) * (distance + sphere.radius)
    return power


def _eye_inside(raster: Raster, surface: Surface) -> bool:
    if isinstance(surface, Sphere):
        return bool(_power(raster, surface)[0] <= 0)
    low, high = np.array(surface.min_pt), np.array(surface.max_pt)
    return bool(((low <= raster.eye) & (raster.eye <= high)).all())


def _hit(raster: Raster, s: Floats, g: Floats, d: Triple, surface: Surface) -> tuple[Floats, Ints]:
    """Distance at which each ray meets the surface, or infinity, and the face's axis."""
    if isinstance(surface, Box):
        low = np.array(surface.min_pt) - raster.eye
        high = np.array(surface.max_pt) - raster.eye
        return box_hit(d, _triple([*low]), _triple([*high]))
    u, v, w = raster.local(np.array([surface.center]))
    hypot = np.sqrt(g * g + raster.depth * raster.depth)
    aside = (v * raster.depth - w * g) / hypot
    ahead = (v * g + w * raster.depth) / hypot
    chord2 = (surface.radius - aside) * (surface.radius + aside)
    t = sphere_hit(s, hypot, u, ahead, chord2, _power(raster, surface))
    return t, np.full(s.size, 3)


def _points(
    raster: Raster,
    surfaces: Sequence[Surface],
    own: Ints,
    face: Ints,
    t: Floats,
    d: Triple,
    inside: Bools,
) -> tuple[Triple, Triple]:
    """Points put back on their surfaces, and normals towards the eye."""
    eye = raster.eye.tolist()
    p, n = np.empty((3, t.size)), np.zeros((3, t.size))
    for i in np.unique(own).tolist():
        surface = surfaces[i]
        if isinstance(surface, Sphere):
            at = np.flatnonzero(own == i)
            inverse = 1 / surface.radius
            for k in range(3):
                outward = (t[at] * d[k][at] - (surface.center[k] - eye[k])) * inverse
                p[k, at] = surface.center[k] + surface.radius * outward
                n[k, at] = -outward if inside[i] else outward
            continue
        for axis in range(3):
            at = np.flatnonzero((own == i) & (face == axis))
            for k in range(3):
                p[k, at] = eye[k] + t[at] * d[k][at]
            forward = d[axis][at] > 0
            low, high = surface.min_pt[axis], surface.max_pt[axis]
            p[axis, at] = np.where(forward == inside[i], high, low)
            n[axis, at] = np.where(forward, -1.0, 1.0)
    return _triple([*p]), _triple([*n])


def size_of(surface: Surface) -> Floats:
    """What a point's tolerance at a surface scales with."""
    if isinstance(surface, Sphere):
        size: Floats = np.abs(np.array(surface.center)).sum() + surface.radius
    else:
        corners = np.abs(np.array([surface.min_pt, surface.max_pt]))
        size = corners.max(axis=0).sum()
    return size


def light_side(surface: Surface, light: Vector) -> int:
    position = np.array(light)
    if isinstance(surface, Box):
        low, high = np.array(surface.min_pt), np.array(surface.max_pt)
        return INSIDE if ((low < position) & (position < high)).all() else ON
    distance = np.sqrt(((np.array([surface.center]) - position) ** 2).sum(axis=1))
    tolerance = SURFACE_TOLERANCE * (np.abs(position).sum() + size_of(surface))
    return int(sphere_side(distance, np.array([surface.radius]), np.array([tolerance]))[0])


def blocks(
    surface: Surface,
    eye_inside: bool,
    light_side: int,
    p: Triple,
    to_light: Triple,
    light: Vector,
    reach: Floats,
) -> Bools:
    """Whether the surface keeps each point from the light."""
    if light_side == ON:
        reach = np.maximum(reach, np.abs(np.array(light)).sum())
    tolerance = SURFACE_TOLERANCE * (reach + size_of(surface))
    if isinstance(surface, Box):
        low, high, end = (
            _triple([np.asarray(c) for c in v]) for v in (surface.min_pt, surface.max_pt, light)
        )
        return box_blocks(p, end, low, high, tolerance)
    return sphere_blocks(
        to_light,
        _triple([surface.center[k] - p[k] for k in range(3)]),
        np.full(reach.size, surface.radius),
        tolerance,
        np.full(reach.size, light_side, dtype=np.int8),
        np.full(reach.size, eye_inside),
    )
