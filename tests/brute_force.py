"""The tracer without its culling: every ray against every object, one object at a time.

It takes the tracer's own rays, shapes and highlight, and nothing that decides which pairs to test;
in the same arithmetic, so that its picture must be the same to the last bit.
"""

from __future__ import annotations

from functools import partial

import numpy as np
from probe import Surface, Vector

from tracer.arrays import Bools, Floats, Ints, Triple, dot, pick
from tracer.light.shading import highlight
from tracer.scene.model import Scene, Surfaces
from tracer.scene.objects import Phong
from tracer.shapes.rounding import INSIDE
from tracer.view.camera import Raster, raster_of
from tracer.view.hits import Group
from tracer.view.view import Shape, view_of


@np.errstate(all="ignore")
def brute_force(scene: Scene) -> Floats:
    """The picture (height, width, 3) of a scene, by all pairs."""
    surfaces = scene.surfaces[:]
    raster = raster_of(scene.camera, scene.width, scene.height)
    shapes = [shape_of(surface, raster) for surface in surfaces]
    x, y = (0.5 + np.arange(n, dtype=np.float64) for n in (scene.width, scene.height))
    s, g = np.tile(raster.across(x), scene.height), np.repeat(raster.down(y), scene.width)
    nearest, details = np.full(s.size, np.inf), np.zeros(s.size)
    owner = np.full(s.size, -1)
    for i, shape in enumerate(shapes):
        t, detail = shape.hit(raster, 0, g, s, None)
        first = t < nearest
        nearest[first], owner[first], details[first] = t[first], i, detail[first]
    image = np.zeros((s.size, 3))
    for i in np.unique(owner[owner >= 0]).tolist():
        shape, at = shapes[i], np.flatnonzero(owner == i)
        t, detail = nearest[at], details[at].astype(np.int8) if shape.flat else details[at]
        seen = np.array([t * s[at], t * g[at], t * raster.depth])
        surface = shape.surface(raster, np.zeros(at.size, dtype=np.intp), None, seen, t, detail)
        group = Group(shape, slice(0, at.size), at, np.zeros(at.size, np.intp), None, *surface)
        others = shapes[:i] + shapes[i + 1 :]
        image[at] = _radiance(scene, raster, group, _triple(seen), others, surfaces[i])
    return image.reshape(scene.height, scene.width, 3)


def _radiance(
    scene: Scene, raster: Raster, group: Group, seen: Triple, others: list[Shape], own: Surface
) -> Floats:
    """Radiance (n, 3) at points of one object."""
    p, distance = raster.point_to_scene(seen), np.sqrt(dot(seen, seen))
    n_dot_v, shader = group.height / distance, own.shader
    n = _triple([np.broadcast_to(m, distance.shape) for m in group.n])
    diffuse, specular = np.zeros((2, distance.size, 3))
    for light in scene.lights:
        x, y, z = (float(c[0]) for c in raster.to_camera(np.array([light.position])))
        to_light = _triple([x - seen[0], y - seen[1], z - seen[2]])
        falls = np.empty(distance.size)
        group.height_of(np.array(light.position), to_light, falls)
        lit = falls > 0
        if group.shape.eye_inside[0] and light_side(group.shape, light.position) != INSIDE:
            lit[:] = False
        for other in others:
            at = np.flatnonzero(lit)
            lit[at] = ~blocks(other, raster.eye, pick(p, at), light.position)
        at = np.flatnonzero(lit)
        far = np.sqrt(dot(to_light, to_light))
        cosine, l_dot_v = falls / far, dot(to_light, seen) / (-distance * far)
        diffuse[at] += cosine[at, None] * light.intensity
        if isinstance(shader, Phong) and any(shader.specular):
            wi = _triple([c[at] * (1 / far[at]) for c in to_light])
            v = _triple([c[at] * (-1 / distance[at]) for c in seen])
            vectors = partial(_vectors, pick(n, at), wi, v)
            exponent = np.asarray(shader.exponent)
            power = highlight(cosine[at], n_dot_v[at], l_dot_v[at], exponent, vectors)
            specular[at] += power[:, None] * light.intensity
    radiance = diffuse * shader.diffuse
    return radiance + specular * shader.specular if isinstance(shader, Phong) else radiance


def _vectors(n: Triple, light: Triple, view: Triple, some: Ints) -> tuple[Triple, Triple, Triple]:
    return pick(n, some), pick(light, some), pick(view, some)


def _triple(values: list[Floats] | Floats) -> Triple:
    x, y, z = values
    return x, y, z


def shape_of(surface: Surface, raster: Raster) -> Shape:
    """The shape that holds one surface alone, as object 0."""
    (shape,) = view_of(raster, Surfaces.of([surface])).shapes
    return shape


def light_side(shape: Shape, light: Vector) -> int:
    """Where a light is: outside a lone object, on it, or inside."""
    return int(shape.side(np.zeros(1, dtype=np.intp), _triple(np.array([light]).T))[0])


def blocks(shape: Shape, eye: Floats, p: Triple, light: Vector) -> Bools:
    """Whether a lone object keeps each point, seen from an eye, from the light."""
    every = np.ones(p[0].size, dtype=np.bool_)
    end = _triple([np.full(every.size, c) for c in light])
    return shape.occludes(eye, np.zeros(every.size, dtype=np.intp), p, end, every)
