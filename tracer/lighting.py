"""Light on what is seen: shadows, then shading, light by light."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tracer.camera import Raster
from tracer.groups import select, where
from tracer.intersection import INSIDE, Bools, Triple, dot
from tracer.scene import Floats, Ints, Scene
from tracer.shading import Materials, highlight
from tracer.shadow import LightPencil, Occluders, light_pencil, occluders_of
from tracer.visibility import Hits

__all__ = ["Lighting", "lighting_of", "shade"]


@dataclass(frozen=True, slots=True)
class Lighting:
    """The scene's lights, each with its pencil, and what they fall on.

    Attributes
    ----------
    lights : tuple of (LightPencil, (3,) intensity)
    occluders : Occluders
    shader : (n,)
        Each object's index into `materials`.
    materials : Materials
    """

    lights: tuple[tuple[LightPencil, Floats], ...]
    occluders: Occluders
    shader: Ints
    materials: Materials


def lighting_of(scene: Scene, raster: Raster, eye_inside: Bools, seen: Bools) -> Lighting:
    """Prepare a scene's lights; of its objects, `seen` (n,) may be in the picture."""
    surfaces = scene.surfaces
    occluders = occluders_of(raster, surfaces, eye_inside, seen)
    return Lighting(
        tuple(
            (light_pencil(light.position, occluders), np.array(light.intensity))
            for light in scene.lights
        ),
        occluders,
        np.concatenate([surfaces.sphere_shader, surfaces.box_shader]),
        Materials(surfaces.shaders),
    )


def shade(lighting: Lighting, hits: Hits) -> tuple[Triple, Ints]:
    """Radiance towards the eye, and a key of what was decided on the way.

    Returns
    -------
    radiance : three (n,)
    key : (n,)
        Equal where the same face of the same object is lit by the same lights
        (up to chance collisions, past 50 lights).
    """
    occluders, materials = lighting.occluders, lighting.materials
    count = hits.t.size
    shader = lighting.shader[hits.owner]
    diffuse = [table[shader] for table in materials.diffuse]
    radiance = [np.zeros(count) for _ in range(3)]
    key = np.full(count, hits.owner * 4 + hits.face)
    length = np.sqrt(dot(hits.direction, hits.direction))
    reach = hits.t * length
    for x in hits.p:
        reach = reach + np.abs(x)
    for light, intensity in lighting.lights:
        key *= 2
        # Seen from inside, an object keeps out all light that is not inside as well.
        kept_out = occluders.eye_inside[hits.owner] & (light.side[hits.owner] != INSIDE)
        away = [x - m for x, m in zip(light.position, hits.p, strict=True)]
        projected = sum(m * d for m, d in zip(hits.n, away, strict=True) if np.ndim(m) or m)
        if not np.ndim(projected):
            # A whole plane at once: it faces the light or it does not.
            if projected <= 0 or kept_out:
                continue
            projected = float(projected)
        lit = where(np.broadcast_to((projected > 0) & ~kept_out, (count,)))
        to_light = tuple(select(d, lit) for d in away)
        blocked = light.blocked(
            occluders,
            tuple(select(x, lit) for x in hits.p),
            to_light,
            select(hits.owner, lit),
            reach[lit],
            hits.plane,
        )
        if blocked.any():
            free = np.flatnonzero(~blocked)
            lit = free if isinstance(lit, slice) else lit[free]
            to_light = tuple(select(d, free) for d in to_light)
        key[lit] += 1
        inverse = 1 / np.sqrt(dot(to_light, to_light))
        cosine = select(projected, lit) * inverse
        material = select(shader, lit)
        for k in range(3):
            radiance[k][lit] += (intensity[k] * select(diffuse[k], lit)) * cosine
        glossy = materials.glossy[material]
        if not glossy.any():
            continue
        at = where(np.broadcast_to(glossy, cosine.shape))
        shiny = at if isinstance(lit, slice) else lit[at]
        scale = inverse[at]
        view_scale = -1 / length[shiny]
        material = select(material, at)
        power = highlight(
            tuple(select(m, shiny) for m in hits.n),
            tuple(select(d, at) * scale for d in to_light),
            tuple(d[shiny] * view_scale for d in hits.direction),
            materials.exponent[material],
        )
        for k in range(3):
            radiance[k][shiny] += (intensity[k] * materials.specular[k][material]) * power
    return (radiance[0], radiance[1], radiance[2]), key
