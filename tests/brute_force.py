"""The tracer without its culling: every ray against every object, one object at a time.

It takes the tracer's own rays, exact pair tests and highlight, and nothing
that decides which pairs to test; in the same arithmetic, so that its picture
must be the same to the last bit.
"""

from __future__ import annotations

from functools import partial

import numpy as np
from probe import Surface, Vector

from tracer.arrays import Bools, Floats, Ints, Triple, dot
from tracer.light.shading import highlight
from tracer.scene.model import Box, Phong, Scene, Sphere
from tracer.shapes.intersection import (
    INSIDE,
    ON,
    SURFACE_TOLERANCE,
    box_blocks,
    box_hit,
    disc_in_row,
    power_of,
    sphere_blocks,
    sphere_hit,
    sphere_side,
)
from tracer.view.camera import Raster, raster_of


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

    nearest, rise = np.full(s.size, np.inf), np.zeros(s.size)
    owner, face = np.full(s.size, -1), np.full(s.size, 3)
    for i, surface in enumerate(surfaces):
        t, axis, its_rise = _hit(raster, s, g, d, surface)
        first = t < nearest
        nearest[first], owner[first], face[first] = t[first], i, axis[first]
        rise[first] = its_rise[first]

    at = np.flatnonzero(owner >= 0)
    own, face, t, s, g = owner[at], face[at], nearest[at], s[at], g[at]
    seen = _triple([t * s, t * g, t * raster.depth])
    distance = np.sqrt(dot(seen, seen))
    n, n_dot_v, sign, level = np.zeros((3, at.size)), *np.zeros((3, at.size))
    for i in np.unique(own).tolist():
        surface, mine = surfaces[i], np.flatnonzero(own == i)
        if isinstance(surface, Sphere):
            center, inverse = raster.to_camera(np.array([surface.center])), 1 / surface.radius
            for k in range(3):
                outward = (seen[k][mine] - center[k]) * inverse
                n[k, mine] = -outward if inside[i] else outward
            lift = rise[at[mine]] * inverse
            n_dot_v[mine] = lift * seen[2][mine] / (distance[mine] * raster.depth)
            continue
        for axis in range(3):
            on = np.flatnonzero((own == i) & (face == axis))
            forward = d[axis][at[on]] > 0
            low, high = surface.min_pt[axis], surface.max_pt[axis]
            sign[on], level[on] = (
                np.where(forward, -1.0, 1.0),
                np.where(forward == inside[i], high, low),
            )
            n[:, on] = sign[on] * raster.axes[:, axis, None]
            n_dot_v[on] = sign[on] * (raster.eye[axis] - level[on]) / distance[on]

    eye, turned = raster.eye.tolist(), raster.vector_to_scene(seen)
    p = _triple([eye[k] + turned[k] for k in range(3)])
    ray = _triple([p[k] - eye[k] for k in range(3)])
    reach = np.sqrt(dot(ray, ray)) + sum(np.abs(c) for c in p)
    fallen, mirrored = np.zeros((2, at.size, 3))
    for light in scene.lights:
        x, y, z = (float(c[0]) for c in raster.to_camera(np.array([light.position])))
        to_light = _triple([x - seen[0], y - seen[1], z - seen[2]])
        falls = dot(_triple([*n]), to_light)
        for axis in range(3):
            on = np.flatnonzero(face == axis)
            falls[on] = sign[on] * (light.position[axis] - level[on])
        sides = np.array([light_side(surface, light.position) for surface in surfaces])
        lit = (falls > 0) & ~(inside & (sides != INSIDE))[own]
        for i, occluder in enumerate(surfaces):
            open_ = np.flatnonzero(lit & (own != i))
            lit[open_] = ~blocks(
                occluder,
                bool(inside[i]),
                int(sides[i]),
                _part(p, open_),
                light.position,
                reach[open_],
            )
        far = np.sqrt(dot(to_light, to_light))
        cosine, l_dot_v = falls / far, dot(to_light, seen) / (-distance * far)
        for i in np.unique(own[lit]).tolist():
            mine, shader = np.flatnonzero(lit & (own == i)), surfaces[i].shader
            for k in range(3):
                fallen[mine, k] += light.intensity[k] * cosine[mine]
            if isinstance(shader, Phong) and any(shader.specular):
                wi = _triple([c[mine] * (1 / far[mine]) for c in to_light])
                v = _triple([c[mine] * (-1 / distance[mine]) for c in seen])
                vectors = partial(_vectors, _part(_triple([*n]), mine), wi, v)
                exponent = np.asarray(shader.exponent)
                power = highlight(cosine[mine], n_dot_v[mine], l_dot_v[mine], exponent, vectors)
                for k in range(3):
                    mirrored[mine, k] += light.intensity[k] * power
    image = np.zeros((scene.width * scene.height, 3))
    for i in np.unique(own).tolist():
        mine, shader = np.flatnonzero(own == i), surfaces[i].shader
        image[at[mine]] = fallen[mine] * shader.diffuse
        if isinstance(shader, Phong):
            image[at[mine]] += mirrored[mine] * shader.specular
    return image.reshape(scene.height, scene.width, 3)


def _vectors(n: Triple, light: Triple, view: Triple, some: Ints) -> tuple[Triple, Triple, Triple]:
    return _part(n, some), _part(light, some), _part(view, some)


def _triple(values: list[Floats]) -> Triple:
    x, y, z = values
    return x, y, z


def _part(vector: Triple, index: Ints) -> Triple:
    return vector[0][index], vector[1][index], vector[2][index]


def _power(raster: Raster, sphere: Sphere) -> Floats:
    """|centre - eye|^2 - radius^2 (1,)."""
    u, v, w = raster.to_camera(np.array([sphere.center]))
    distance = np.sqrt(u * u + v * v + w * w)
    return power_of(distance, np.array([sphere.radius]))


def _eye_inside(raster: Raster, surface: Surface) -> bool:
    if isinstance(surface, Sphere):
        return bool(_power(raster, surface)[0] <= 0)
    low, high = np.array(surface.min_pt), np.array(surface.max_pt)
    return bool(((low <= raster.eye) & (raster.eye <= high)).all())


def _hit(
    raster: Raster, s: Floats, g: Floats, d: Triple, surface: Surface
) -> tuple[Floats, Ints, Floats]:
    """Distance at which each ray meets the surface, or infinity; a box's axis; a sphere's rise."""
    if isinstance(surface, Box):
        low = np.array(surface.min_pt) - raster.eye
        high = np.array(surface.max_pt) - raster.eye
        return *box_hit(d, _triple([*low]), _triple([*high])), np.zeros(s.size)
    center, radius = raster.to_camera(np.array([surface.center])), np.array([surface.radius])
    disc = disc_in_row(g, raster.depth, center, radius, _power(raster, surface))
    t, rise = sphere_hit(s, disc)
    return t, np.full(s.size, 3), rise


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
    surface: Surface, eye_inside: bool, light_side: int, p: Triple, light: Vector, reach: Floats
) -> Bools:
    """Whether the surface keeps each point from the light."""
    tolerance = SURFACE_TOLERANCE * (reach + size_of(surface))
    there = SURFACE_TOLERANCE * (np.abs(np.array(light)).sum() + size_of(surface))
    at_light = np.maximum(tolerance, there) if light_side == ON else tolerance
    if isinstance(surface, Box):
        low, high, end = (
            _triple([np.asarray(c) for c in v]) for v in (surface.min_pt, surface.max_pt, light)
        )
        return box_blocks(p, end, low, high, (tolerance, at_light))
    return sphere_blocks(
        _triple([light[k] - p[k] for k in range(3)]),
        _triple([surface.center[k] - p[k] for k in range(3)]),
        np.full(reach.size, surface.radius),
        tolerance,
        np.full(reach.size, light_side, dtype=np.int8),
        np.full(reach.size, eye_inside),
    )
