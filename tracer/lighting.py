"""Light on what is seen: shadows, then shading, light by light."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tracer.camera import Raster
from tracer.groups import Bools, Triple, dot, pick, scaled, select, where
from tracer.intersection import INSIDE
from tracer.scene import Floats, Ints, Scene
from tracer.shading import Materials, highlight
from tracer.shadow import LightPencil, Occluders, Points, light_pencil, occluders_of
from tracer.visibility import Hits

__all__ = ["UNDECIDED", "Lighting", "lighting_of", "shade"]


UNDECIDED = -2


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


def shade(lighting: Lighting, hits: Hits, footprint: Floats | None = None) -> tuple[Triple, Ints]:
    """Radiance towards the eye, and a key of what was decided on the way.

    Parameters
    ----------
    footprint : (n,), optional
        Radius around each point in which nothing must change: where a shadow's
        edge comes as near as that, the key is `UNDECIDED`.

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
    radiance = np.zeros(count), np.zeros(count), np.zeros(count)
    key = np.full(count, hits.owner * 4 + hits.face)
    undecided = np.zeros(count, dtype=np.bool_)
    length = np.sqrt(dot(hits.direction, hits.direction))
    reach = hits.t * length + sum(np.abs(x) for x in hits.p)
    for light, intensity in lighting.lights:
        key *= 2
        x, y, z = light.position
        to_light: Triple = x - hits.p[0], y - hits.p[1], z - hits.p[2]
        if hits.face < 3:
            projected = hits.n[hits.face] * to_light[hits.face]
        else:
            projected = dot(hits.n, to_light)
        # Seen from inside, an object keeps out all light that is not inside as well.
        kept_out = occluders.eye_inside[hits.owner] & (light.side[hits.owner] != INSIDE)
        facing = np.broadcast_to((projected > 0) & ~kept_out, (count,))
        if not facing.any():
            continue
        lit = where(facing)
        to_light = pick(to_light, lit)
        points = Points(pick(hits.p, lit), to_light, select(hits.owner, lit), reach[lit])
        if footprint is None:
            blocked = light.blocked(occluders, points, hits.plane)
        else:
            blocked, grazed = light.grazed(occluders, points, footprint[lit])
            undecided[lit] |= grazed
        if blocked.any():
            free = np.flatnonzero(~blocked)
            lit = free if isinstance(lit, slice) else lit[free]
            to_light = pick(to_light, free)
        key[lit] += 1
        inverse = 1 / np.sqrt(dot(to_light, to_light))
        cosine = select(projected, lit) * inverse
        material = select(shader, lit)
        for k in range(3):
            radiance[k][lit] += (intensity[k] * materials.diffuse[k][material]) * cosine
        glossy = materials.glossy[material]
        if glossy.any():
            at = where(np.broadcast_to(glossy, cosine.shape))
            shiny = at if isinstance(lit, slice) else lit[at]
            material = select(material, at)
            power = highlight(
                pick(hits.n, shiny),
                scaled(pick(to_light, at), inverse[at]),
                scaled(pick(hits.direction, shiny), -1 / length[shiny]),
                materials.exponent[material],
            )
            for k in range(3):
                radiance[k][shiny] += (intensity[k] * materials.specular[k][material]) * power
    key[undecided] = UNDECIDED
    return radiance, key
