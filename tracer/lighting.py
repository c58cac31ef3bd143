"""Light on what is seen: shadows, then shading, light by light."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from tracer.arrays import Bools, Floats, Ints, Triple, dot, each, pick, rows, scaled, select, where
from tracer.intersection import INSIDE
from tracer.occluders import occluders_of
from tracer.sampling import Samples
from tracer.scene import Scene
from tracer.shading import Materials, highlight
from tracer.shadow import Shadows, shadows_of
from tracer.visibility import Group, Hits, View, visible

__all__ = [
    "Gloss",
    "Incoming",
    "Lighting",
    "incoming",
    "lighting_of",
    "narrow",
    "radiance_at",
    "shade",
]


# On the bell exp(-x^2): the change of x that one sample still follows, where it is as good as
# zero, and where it underflows.
_SMOOTH, _FAINT, _DARK = 0.7, 3.0, 27.0


class Lighting(NamedTuple):
    """The scene's lights and what they fall on.

    Attributes
    ----------
    positions, intensities : (lights, 3)
    local : (lights, 3)
        The positions in the camera's axes, seen from the eye.
    shadows : Shadows
    shader : (n,)
        Each object's index into `materials`.
    materials : Materials
    """

    positions: Floats
    intensities: Floats
    local: Floats
    shadows: Shadows
    shader: Ints
    materials: Materials


class Incoming(NamedTuple):
    """Light as it comes in at points, whatever lies between: all (lights, n).

    With n the normal, l the way to the light and p that from the eye, none of
    them of unit length but n:

    Attributes
    ----------
    falls
        n . l; minus infinity where the object is seen from inside and keeps the light outside.
    length2
        l . l.
    along
        l . p, where there are highlights.
    """

    falls: Floats
    length2: Floats
    along: Floats

    def part(self, place: slice) -> Incoming:
        """That at some of the points."""
        return Incoming(*(m[:, place] for m in self))


def lighting_of(scene: Scene, view: View, split: bool) -> Lighting:
    """Prepare a scene's lights, for pixels that may be split."""
    surfaces, lights = scene.surfaces, scene.lights
    positions = np.array([light.position for light in lights]).reshape(-1, 3)
    return Lighting(
        positions,
        np.array([light.intensity for light in lights]).reshape(-1, 3),
        np.column_stack(view.raster.local(positions)),
        shadows_of(occluders_of(view, positions), view.raster, split),
        np.concatenate([surfaces.sphere_shader, surfaces.box_shader]),
        Materials(surfaces.shaders),
    )


def incoming(lighting: Lighting, hits: Hits) -> Incoming:
    """What comes in at all hits."""
    occluders, glossy = lighting.shadows.occluders, lighting.materials.glossy[lighting.shader]
    result = Incoming(*np.empty((3, len(lighting.local), hits.p.shape[1])))
    for number, light in enumerate(lighting.local.tolist()):
        kept_out = occluders.eye_inside & (occluders.side[number] != INSIDE)
        for group in hits.groups:
            falls, length2, along = (m[number, group.part] for m in result)
            p = hits.p[:, group.part]
            to_light = light[0] - p[0], light[1] - p[1], light[2] - p[2]
            if group.flat:
                place = lighting.positions[number, group.face]
                falls[:] = group.sign * (place - group.level)
            else:
                dot(group.n, to_light, falls)
            dot(to_light, to_light, length2)
            if glossy[group.owner].any():
                dot(to_light, (p[0], p[1], p[2]), along)
            # Seen from inside, an object keeps out all light that is not inside as well.
            if kept_out[group.owner].any():
                # Nowhere is that light about to begin, as it is where n . l is zero.
                falls[np.broadcast_to(group.of(kept_out), falls.shape)] = -np.inf
    return result


def shade(gloss: Gloss, light: Incoming, lit: Bools) -> Triple:
    """Radiance, three (n,), of a group towards the eye.

    `light`, `lit` (lights, n): what comes in there, and whether it reaches the points.
    """
    lighting, group = gloss.lighting, gloss.group
    # Light that falls on the points, and its highlights: what shaders make of it comes last.
    fallen: list[Floats] = []
    mirrored: list[Floats] = []
    for number, (intensity, reached) in enumerate(
        zip(lighting.intensities.tolist(), lit, strict=True)
    ):
        if not reached.any():
            continue
        length = np.sqrt(light.length2[number])
        cosine = light.falls[number] / length
        if not reached.all():
            cosine = np.where(reached, cosine, 0.0)
        _add(fallen, intensity, cosine)
        if gloss.any:
            at = where(reached & gloss.glossy)
            power = gloss.highlight(number, at, cosine[at], length[at], light.along[number][at])
            if not isinstance(at, slice):
                everywhere = np.zeros(cosine.size)
                everywhere[at] = power
                power = everywhere
            _add(mirrored, intensity, power)
    materials, shader = lighting.materials, lighting.shader[group.owner]
    radiance = _returned(fallen, materials.diffuse[:, shader], group)
    if gloss.any:
        highlights = _returned(mirrored, materials.specular[:, shader], group)
        radiance = each(np.add, radiance, highlights)
    return radiance


def narrow(gloss: Gloss, light: Incoming, facing: Bools, footprint: Floats) -> Iterator[Ints]:
    """Points where there may be a highlight too narrow for one sample of so large a footprint.

    Light that they face may reach some of it, even where it does not reach them.

    Around its middle a highlight is the bell exp(-p a^2 / 2) of the angle a
    between normal and half vector, which bends with the surface and with the
    directions to light and eye.
    """
    if not gloss.any:
        return
    group = gloss.group
    bending = 1 / gloss.distance
    if not group.flat:
        bending += 1 / group.of(gloss.lighting.shadows.occluders.radius)
    scale = np.where(gloss.glossy, np.sqrt(gloss.exponent / 2), 0)
    most = footprint.max(), bending.max(), scale.max()
    for number, faces in enumerate(facing):
        length = np.sqrt(light.length2[number])
        if most[0] * (most[1] + 1 / length.min()) * most[2] <= _SMOOTH:
            continue
        change = footprint * (bending + 1 / length) * scale
        at = np.flatnonzero((change > _SMOOTH) & faces)
        if at.size:
            cosine = light.falls[number][at] / length[at]
            power = gloss.highlight(number, at, cosine, length[at], light.along[number][at])
            yield at[np.minimum(np.sqrt(-np.log(power)), _DARK) - change[at] < _FAINT]


class Gloss(NamedTuple):
    """Highlights on a group.

    Attributes
    ----------
    lighting : Lighting
    p : (3, n)
    group : Group
    any : bool
        Whether there are any.
    glossy, exponent
        Numbers, or (n,).
    distance, slope : (n,)
        See `Hits.sights`; nothing without highlights.
    """

    lighting: Lighting
    p: Floats
    group: Group
    any: bool
    glossy: Bools
    exponent: Floats
    distance: Floats
    slope: Floats

    @classmethod
    def of(
        cls,
        lighting: Lighting,
        hits: Hits,
        group: Group,
        sights: tuple[Floats, Floats] | None = None,
    ) -> Gloss:
        """Gather what is needed; `sights` of the hits are used if they are there."""
        materials, shader = lighting.materials, lighting.shader[group.owner]
        glossy = materials.glossy[shader]
        shines = bool(glossy.any())
        return cls(
            lighting,
            hits.p[:, group.part],
            group,
            shines,
            group.spread(glossy),
            group.spread(materials.exponent[shader]),
            *(sights or (hits.sights(group) if shines else np.zeros((2, 0)))),
        )

    def highlight(
        self, number: int, at: Ints | slice, cosine: Floats, length: Floats, along: Floats
    ) -> Floats:
        """(n.h)^p of a light at some of the points; what follows `at` is of these alone."""
        group, distance = self.group, self.distance[at]

        def vectors(some: Ints) -> tuple[Triple, Triple, Triple]:
            place = some if isinstance(at, slice) else at[some]
            p = rows(self.p, place)
            x, y, z = self.lighting.local[number].tolist()
            to_light = scaled((x - p[0], y - p[1], z - p[2]), 1 / length[some])
            return pick(group.n, place), to_light, scaled(p, -1 / distance[some])

        between = along / (-distance * length)
        return highlight(cosine, self.slope[at], between, select(self.exponent, at), vectors)


def radiance_at(
    view: View, lighting: Lighting, samples: Samples, out: Floats | None = None
) -> Floats:
    """Radiance (3, n) at samples, towards the eye; into zeros, if they are given."""
    radiance = np.zeros((3, samples.size)) if out is None else out
    hits = visible(view, samples)
    light = incoming(lighting, hits)
    lit = light.falls > 0
    lit &= ~lighting.shadows.blocked(hits, lit)
    for group in hits.groups:
        part = group.part
        shaded = shade(Gloss.of(lighting, hits, group), light.part(part), lit[:, part])
        for channel, values in zip(radiance, shaded, strict=True):
            channel[group.sample] = values
    return radiance


def _add(total: list[Floats], intensity: list[float], weight: Floats) -> None:
    """Add the light of one more source, as seen by each point (n,), to three channels."""
    if not total:
        total.extend(strength * weight for strength in intensity)
        return
    for channel, strength in zip(total, intensity, strict=True):
        channel += strength * weight


def _returned(total: list[Floats], colors: Floats, group: Group) -> Triple:
    """The light, if there is any, that surfaces return, of colours (3,) or (3, spans)."""
    if not total:
        nothing = np.zeros(group.sample.size)
        return nothing, nothing, nothing
    r, g, b = (light * group.spread(color) for light, color in zip(total, colors, strict=True))
    return r, g, b
