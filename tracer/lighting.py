"""Light on what is seen: shadows, then shading, light by light."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tracer.groups import Bools, Index, Triple, dot, each, pick, scaled, select, where
from tracer.intersection import INSIDE
from tracer.occluders import occluders_of
from tracer.scene import Floats, Ints, Scene
from tracer.shading import Materials, highlight
from tracer.shadow import Shadows, shadows_of
from tracer.visibility import Group, Hits, Samples, View, visible

__all__ = ["Lighting", "lighting_of", "narrow", "projected", "radiance_at", "shade"]


# On the bell exp(-x^2): the change of x that one sample still follows, where it is as good as
# zero, and where it underflows.
_SMOOTH, _FAINT, _DARK = 0.5, 3.0, 27.0


class Lighting(NamedTuple):
    """The scene's lights and what they fall on.

    Attributes
    ----------
    positions, intensities : (lights, 3)
    shadows : Shadows
    shader : (n,)
        Each object's index into `materials`.
    materials : Materials
    """

    positions: Floats
    intensities: Floats
    shadows: Shadows
    shader: Ints
    materials: Materials


def lighting_of(scene: Scene, view: View, samples: int) -> Lighting:
    """Prepare a scene's lights, for so many samples a pixel."""
    surfaces, lights = scene.surfaces, scene.lights
    positions = np.array([light.position for light in lights]).reshape(-1, 3)
    return Lighting(
        positions,
        np.array([light.intensity for light in lights]).reshape(-1, 3),
        shadows_of(occluders_of(view, positions), scene.width * scene.height * samples),
        np.concatenate([surfaces.sphere_shader, surfaces.box_shader]),
        Materials(surfaces.shaders),
    )


def incidence(lighting: Lighting, hits: Hits) -> Floats:
    """n.l times the distance of each light, (lights, n); zero where it does not reach."""
    falls = projected(lighting, hits)
    facing = falls > 0
    facing &= ~lighting.shadows.blocked(hits, facing)
    return np.where(facing, falls, 0.0)


def projected(lighting: Lighting, hits: Hits) -> Floats:
    """n.l times the distance of each light, (lights, n), whatever lies between."""
    occluders = lighting.shadows.occluders
    falls = np.empty((len(lighting.positions), hits.p.shape[1]))
    for light, side, row in zip(lighting.positions.tolist(), occluders.side, falls, strict=True):
        for group in hits.groups:
            out = row[group.part]
            if group.face < 3:
                np.subtract(light[group.face], hits.p[group.face, group.part], out=out)
                out *= group.n[group.face]
            else:
                out[:] = dot(group.n, _to(light, hits.p[:, group.part]))
            # Seen from inside, an object keeps out all light that is not inside as well.
            kept_out = occluders.eye_inside[group.owner] & (side[group.owner] != INSIDE)
            if kept_out.any():
                out[np.broadcast_to(kept_out, out.shape)] = 0
    return falls


def shade(lighting: Lighting, hits: Hits, group: Group, falls: Floats) -> Triple:
    """Radiance, three (n,), of some of the hits towards the eye.

    `falls` (lights, n): their `incidence`.
    """
    materials, p = lighting.materials, hits.p[:, group.part]
    shader = lighting.shader[group.owner]
    glossy = materials.glossy[shader]
    gloss = bool(np.any(glossy))
    if gloss:
        view = scaled(group.direction, -1 / np.sqrt(dot(group.direction, group.direction)))
    # Light that falls on the points, and its highlights: what shaders make of it comes last.
    fallen, mirrored = _Sum(group.t.size), _Sum(group.t.size)
    for light, intensity, cosine in zip(
        lighting.positions.tolist(), lighting.intensities.tolist(), falls, strict=True
    ):
        lit = cosine > 0
        if not lit.any():
            continue
        to_light = _to(light, p)
        inverse = 1 / np.sqrt(dot(to_light, to_light))
        fallen.add(intensity, cosine * inverse)
        if gloss:
            shiny = where(lit & glossy)
            power = highlight(
                pick(group.n, shiny),
                scaled(pick(to_light, shiny), inverse[shiny]),
                pick(view, shiny),
                materials.exponent[select(shader, shiny)],
            )
            if not isinstance(shiny, slice):
                everywhere = np.zeros(lit.size)
                everywhere[shiny] = power
                power = everywhere
            mirrored.add(intensity, power)
    radiance = fallen.times(materials.diffuse, shader)
    if gloss:
        radiance = each(np.add, radiance, mirrored.times(materials.specular, shader))
    return radiance


def narrow(lighting: Lighting, hits: Hits, group: Group, falls: Floats, footprint: Floats) -> Bools:
    """Whether there may be a highlight (n,) too narrow for one sample of so large a footprint.

    Around its middle a highlight is the bell exp(-p a^2 / 2) of the angle a
    between normal and half vector, which bends with the surface and with the
    directions to light and eye.
    """
    materials, p, surfaces = lighting.materials, hits.p[:, group.part], lighting.shadows.occluders
    result = np.zeros(group.t.size, dtype=np.bool_)
    shader = lighting.shader[group.owner]
    if not np.any(materials.glossy[shader]):
        return result
    distance = group.t * np.sqrt(dot(group.direction, group.direction))
    bending = 1 / distance
    if group.face == 3:
        bending = bending + 1 / surfaces.surfaces.radius[group.owner]
    scale = np.where(materials.glossy[shader], np.sqrt(materials.exponent[shader] / 2), 0)
    for light, cosine in zip(lighting.positions.tolist(), falls, strict=True):
        to_light = _to(light, p)
        inverse = 1 / np.sqrt(dot(to_light, to_light))
        change = footprint * (bending + inverse) * scale
        at = np.flatnonzero((change > _SMOOTH) & (cosine > 0))
        if at.size:
            power = highlight(
                pick(group.n, at),
                scaled(pick(to_light, at), inverse[at]),
                scaled(pick(group.direction, at), -group.t[at] / distance[at]),
                materials.exponent[select(shader, at)],
            )
            result[at] |= np.minimum(np.sqrt(-np.log(power)), _DARK) - change[at] < _FAINT
    return result


def radiance_at(view: View, lighting: Lighting, samples: Samples) -> Floats:
    """Radiance (3, n) at samples, towards the eye."""
    radiance = np.zeros((3, samples.x.size))
    hits = visible(view, samples)
    falls = incidence(lighting, hits)
    for group in hits.groups:
        for k, values in enumerate(shade(lighting, hits, group, falls[:, group.part])):
            radiance[k, group.sample] = values
    return radiance


def _to(light: list[float], p: Floats) -> Triple:
    """From points (3, n) to a light."""
    return light[0] - p[0], light[1] - p[1], light[2] - p[2]


class _Sum:
    """Light of several sources, three (n,)."""

    __slots__ = ("channels", "count")

    def __init__(self, count: int) -> None:
        self.count = count
        self.channels: Triple | None = None

    def add(self, intensity: list[float], weight: Floats) -> None:
        """One more source, (3,), as seen by each point (n,)."""
        more: Triple = (intensity[0] * weight, intensity[1] * weight, intensity[2] * weight)
        if self.channels is None:
            self.channels = more
        else:
            for total, channel in zip(self.channels, more, strict=True):
                total += channel

    def times(self, colors: Floats, index: Index) -> Triple:
        """The light that surfaces return, whose colours are some of (3, m)."""
        if self.channels is None:
            nothing = np.zeros(self.count)
            return nothing, nothing, nothing
        for total, color in zip(self.channels, colors, strict=True):
            total *= color[index]
        return self.channels
