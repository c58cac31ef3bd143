"""Light on what is seen: shadows, then shading, light by light."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tracer.camera import Raster
from tracer.groups import Bools, Index, Triple, dot, each, pick, scaled, select, where
from tracer.intersection import INSIDE
from tracer.scene import Floats, Ints, Scene
from tracer.shading import Materials, highlight
from tracer.shadow import LightPencil, Occluders, Points, light_pencil, occluders_of
from tracer.visibility import Hits

__all__ = ["Keys", "Lighting", "lighting_of", "shade"]


# On the bell exp(-x^2): the change of x that one sample still follows, where it is as good as
# zero, and where it underflows.
_SMOOTH, _FAINT, _DARK = 0.15, 3.0, 27.0


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
    occluders = occluders_of(raster.eye, surfaces, eye_inside, seen)
    return Lighting(
        tuple(
            (light_pencil(light.position, occluders), np.array(light.intensity))
            for light in scene.lights
        ),
        occluders,
        np.concatenate([surfaces.sphere_shader, surfaces.box_shader]),
        Materials(surfaces.shaders),
    )


@dataclass(frozen=True, slots=True)
class Keys:
    """What was decided for samples that stand for pixels; filled in by `shade`.

    Attributes
    ----------
    footprint : (n,)
        Radius around each point, on its surface, of what the pixel sees.
    key : (n,) int
        Equal where the same face of the same object is lit by the same lights
        (up to chance collisions, past 50 lights).
    undecided : (n,)
        Whether the edge of a shadow comes as near as the footprint.
    """

    footprint: Floats
    key: Ints
    undecided: Bools


def _bending(
    lighting: Lighting, hits: Hits, index: Ints | slice, inverse: Floats
) -> Floats:
    """How much the angle between normal and half vector may change, by length on the surface.

    `inverse`: of the distance to the light.
    """
    surfaces = lighting.occluders.surfaces
    ray = pick(hits.direction, index)
    bending = inverse + 1 / (hits.t[index] * np.sqrt(dot(ray, ray)))
    if hits.face == 3:
        bending = bending + 1 / surfaces.radius[select(hits.owner, index)]
    return bending


def _narrow(power: Floats, exponent: Floats, change: Floats) -> Bools:
    """Whether a highlight may be within the change of angle, and narrow against it.

    Around its middle a highlight is the bell exp(-p a^2 / 2) of the angle a.
    """
    scale = np.sqrt(exponent / 2)
    off = np.minimum(np.sqrt(-np.log(power)), _DARK) / scale
    return (change * scale > _SMOOTH) & ((off - change) * scale < _FAINT)


def shade(lighting: Lighting, hits: Hits, keys: Keys | None = None) -> Triple:
    """Radiance, three (n,), towards the eye; and `keys`, if asked for."""
    occluders, materials = lighting.occluders, lighting.materials
    count = hits.t.size
    shader = lighting.shader[hits.owner]
    glossy = np.broadcast_to(materials.glossy[shader], (count,))
    gloss = bool(glossy.any())
    if gloss:
        view = scaled(hits.direction, -1 / np.sqrt(dot(hits.direction, hits.direction)))
    if keys:
        keys.key[:] = hits.owner * 4 + hits.face
    # Light that falls on the points, and its highlights: what shaders make of it comes last.
    fallen = _Sum(count)
    mirrored = _Sum(count)
    for light, intensity in lighting.lights:
        x, y, z = light.position
        to_light: Triple = x - hits.p[0], y - hits.p[1], z - hits.p[2]
        if hits.face < 3:
            projected = hits.n[hits.face] * to_light[hits.face]
        else:
            projected = dot(hits.n, to_light)
        # Seen from inside, an object keeps out all light that is not inside as well.
        kept_out = occluders.eye_inside[hits.owner] & (light.side[hits.owner] != INSIDE)
        lit = np.broadcast_to((projected > 0) & ~kept_out, (count,)).copy()
        if keys:
            keys.key[:] *= 2
        facing = where(lit)
        points = Points(hits, facing, pick(to_light, facing))
        if not points.size:
            continue
        lit[facing] = ~light.blocked(occluders, points)
        if keys:
            keys.undecided[facing] |= light.grazed(occluders, points, keys.footprint[facing])
            keys.key[:] += lit
        inverse = 1 / np.sqrt(dot(to_light, to_light))
        cosine = np.where(lit, projected * inverse, 0.0)
        fallen.add(intensity, cosine)
        if gloss:
            shiny = where(lit & glossy)
            exponent = materials.exponent[select(shader, shiny)]
            inverse = inverse[shiny]
            power = highlight(
                pick(hits.n, shiny),
                scaled(pick(to_light, shiny), inverse),
                pick(view, shiny),
                exponent,
            )
            if keys:
                change = keys.footprint[shiny] * _bending(lighting, hits, shiny, inverse)
                keys.undecided[shiny] |= _narrow(power, exponent, change)
            if not isinstance(shiny, slice):
                everywhere = np.zeros(count)
                everywhere[shiny] = power
                power = everywhere
            mirrored.add(intensity, power)
    radiance = fallen.times(materials.diffuse, shader)
    if gloss:
        radiance = each(np.add, radiance, mirrored.times(materials.specular, shader))
    return radiance


class _Sum:
    """Light of several sources, three (n,)."""

    __slots__ = ("channels", "count")

    def __init__(self, count: int) -> None:
        self.count = count
        self.channels: Triple | None = None

    def add(self, intensity: Floats, weight: Floats) -> None:
        """One more source, (3,), as seen by each point (n,)."""
        more: Triple = scaled((intensity[0], intensity[1], intensity[2]), weight)
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
