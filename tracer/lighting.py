"""Light on what is seen: shadows, then shading, light by light."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tracer.intersection import Bools, Triple, dot
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


def lighting_of(scene: Scene, eye_inside: Bools, seen: Bools) -> Lighting:
    """Prepare a scene's lights; of its objects, `seen` (n,) may be in the picture."""
    surfaces = scene.surfaces
    occluders = occluders_of(surfaces, eye_inside, seen)
    return Lighting(
        tuple(
            (light_pencil(light.position, occluders), np.array(light.intensity))
            for light in scene.lights
        ),
        occluders,
        np.concatenate([surfaces.sphere_shader, surfaces.box_shader]),
        Materials(surfaces.shaders),
    )


def shade(lighting: Lighting, hits: Hits) -> tuple[Floats, NDArray[np.int64]]:
    """Radiance towards the eye, and a key of what was decided on the way.

    Returns
    -------
    radiance : (n, 3)
    key : (n,)
        Equal where the same face of the same object is lit by the same lights
        (up to chance collisions, past 50 lights).
    """
    occluders, materials = lighting.occluders, lighting.materials
    shader = lighting.shader[hits.owner]
    total = np.zeros((3, hits.owner.size))
    key = hits.owner * 4 + hits.face
    length = np.sqrt(dot(hits.direction, hits.direction))
    view: Triple = tuple(-m / length for m in hits.direction)  # type: ignore[assignment]
    reach = np.abs(hits.p[0]) + np.abs(hits.p[1]) + np.abs(hits.p[2]) + hits.t * length
    for light, intensity in lighting.lights:
        to_light: Triple = tuple(  # type: ignore[assignment]
            x - m for x, m in zip(light.position, hits.p, strict=True)
        )
        projected = dot(hits.n, to_light)
        # Seen from inside, an object keeps out all light that is not inside as well.
        kept_out = occluders.eye_inside & (light.side >= 0)
        lit = np.flatnonzero((projected > 0) & ~kept_out[hits.owner])
        to_light = tuple(m[lit] for m in to_light)  # type: ignore[assignment]
        blocked = light.blocked(
            occluders,
            tuple(m[lit] for m in hits.p),  # type: ignore[arg-type]
            to_light,
            hits.owner[lit],
            reach[lit],
        )
        free = np.flatnonzero(~blocked)
        lit = lit[free]
        key *= 2
        key[lit] += 1
        distance = np.sqrt(dot(*[tuple(m[free] for m in to_light)] * 2))  # type: ignore[arg-type]
        cosine = projected[lit] / distance
        material = shader[lit]
        for k in range(3):
            total[k, lit] += intensity[k] * materials.diffuse[k][material] * cosine
        shiny = np.flatnonzero(materials.glossy[material])
        if shiny.size:
            at, material = lit[shiny], material[shiny]
            power = highlight(
                tuple(m[at] for m in hits.n),  # type: ignore[arg-type]
                tuple(m[free[shiny]] / distance[shiny] for m in to_light),  # type: ignore[arg-type]
                tuple(m[at] for m in view),  # type: ignore[arg-type]
                materials.exponent[material],
            )
            for k in range(3):
                total[k, at] += intensity[k] * materials.specular[k][material] * power
    return total.T, key
