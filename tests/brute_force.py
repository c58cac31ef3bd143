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
from tracer.scene.model import Phong, Scene, Surfaces
from tracer.shapes.rounding import INSIDE
from tracer.view.camera import Raster, raster_of
from tracer.view.view import Group, Shape, view_of


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
        t, detail = shape.hit(raster, 0, g, s, slice(None))
        first = t < nearest
        nearest[first], owner[first], details[first] = t[first], i, detail[first]
    at = np.flatnonzero(owner >= 0)
    own, t = owner[at], nearest[at]
    seen = np.array([t * s[at], t * g[at], t * raster.depth])
    groups = []
    for i in np.unique(own).tolist():
        shape, mine = shapes[i], np.flatnonzero(own == i)
        detail = details[at[mine]].astype(np.int8) if shape.flat else details[at[mine]]
        zeros = np.zeros(mine.size, dtype=np.intp)
        surface = shape.surface(raster, zeros, zeros, seen[:, mine], t[mine], detail)
        groups.append((i, mine, Group(shape, slice(0, mine.size), mine, zeros, zeros, *surface)))
    diffuse, specular = np.zeros((2, at.size, 3))
    p = raster.point_to_scene(_triple(seen))
    for light in scene.lights:
        x, y, z = (float(c[0]) for c in raster.to_camera(np.array([light.position])))
        to_light, falls = _triple([x - seen[0], y - seen[1], z - seen[2]]), np.empty(at.size)
        for _, mine, group in groups:
            height = np.empty(mine.size)
            group.height_of(np.array(light.position), pick(to_light, mine), height)
            falls[mine] = height
            if group.shape.eye_inside[0] and light_side(group.shape, light.position) != INSIDE:
                falls[mine] = -1
        lit = falls > 0
        for i, shape in enumerate(shapes):
            open_ = np.flatnonzero(lit & (own != i))
            lit[open_] = ~blocks(shape, raster.eye, pick(p, open_), light.position)
        far, distance = np.sqrt(dot(to_light, to_light)), np.sqrt(dot(_triple(seen), _triple(seen)))
        cosine, l_dot_v = falls / far, dot(to_light, _triple(seen)) / (-distance * far)
        diffuse[lit] += cosine[lit, None] * light.intensity
        for i, mine, group in groups:
            shader, here = surfaces[i].shader, np.flatnonzero(lit[mine])
            if isinstance(shader, Phong) and any(shader.specular):
                on = mine[here]
                n = [np.broadcast_to(m, mine.shape)[here] for m in group.n]
                wi = [c[on] * (1 / far[on]) for c in to_light]
                v = [c[on] * (-1 / distance[on]) for c in seen]
                vectors = partial(_vectors, _triple(n), _triple(wi), _triple(v))
                n_dot_v = (group.height / distance[mine])[here]
                exponent = np.asarray(shader.exponent)
                power = highlight(cosine[on], n_dot_v, l_dot_v[on], exponent, vectors)
                specular[on] += power[:, None] * light.intensity
    image = np.zeros((s.size, 3))
    for i, mine, _ in groups:
        shader = surfaces[i].shader
        image[at[mine]] = diffuse[mine] * shader.diffuse
        if isinstance(shader, Phong):
            image[at[mine]] += specular[mine] * shader.specular
    return image.reshape(scene.height, scene.width, 3)


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
