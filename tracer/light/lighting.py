"""Radiance of hits: shadows, then shading, light by light."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from tracer.arrays import (
    Bools,
    Floats,
    Ints,
    Triple,
    dot,
    each,
    index_where,
    indices,
    pick,
    scaled,
    select,
)
from tracer.light.shading import Materials, highlight
from tracer.scene.model import Scene
from tracer.shadow.occluders import Occluders, occluders_of
from tracer.shadow.occlusion import occlusion
from tracer.shapes.rounding import INSIDE
from tracer.view.hits import Group, Visible
from tracer.view.samples import Samples
from tracer.view.view import View
from tracer.view.visibility import visible

# On the bell exp(-x^2): the most that x may change over what one sample stands for, the x where
# the bell is as good as zero, and the x where it underflows.
_SMOOTH, _FAINT, _DARK = 0.7, 3.0, 27.0


class Lighting(NamedTuple):
    """A scene's lights, and what they fall on.

    Attributes
    ----------
    view : View
    intensities : (lights, 3)
    local : (lights, 3)
        The positions in the camera's axes, seen from the eye.
    occluders : Occluders
    shader : (n,)
        Each object's index into `materials`.
    materials : Materials
    """

    view: View
    intensities: Floats
    local: Floats
    occluders: Occluders
    shader: Ints
    materials: Materials

    @property
    def positions(self) -> Floats:
        """Positions of the lights (lights, 3), in the scene's axes."""
        return self.occluders.lights


class Incoming(NamedTuple):
    """Light as it comes in at points, whatever lies between.

    Attributes
    ----------
    n_dot_l : (lights, n)
        n . l, with the unit normal n and the vector l to the light, not of unit length; minus
        infinity where the object is seen from inside and the light is not inside it.
    length2 : (lights, n)
        l . l
    """

    n_dot_l: Floats
    length2: Floats

    def part(self, place: slice) -> Incoming:
        """The light at some of the points."""
        return Incoming(*(m[:, place] for m in self))


class Highlights(NamedTuple):
    """Highlights on a group.

    Attributes
    ----------
    lighting : Lighting
    p : (3, n)
        See `Visible`.
    group : Group
    present : bool
        Whether there are any.
    glossy, exponent
        Numbers, or (n,).
    distance, n_dot_v : (n,)
        See `Visible.distance_and_cosine`; empty without highlights.
    """

    lighting: Lighting
    p: Floats
    group: Group
    present: bool
    glossy: Bools
    exponent: Floats
    distance: Floats
    n_dot_v: Floats

    @classmethod
    def of(cls, lighting: Lighting, hits: Visible, group: Group) -> Highlights:
        """Gather what is needed."""
        p, shader = hits.p[:, group.part], lighting.shader[group.owner]
        glossy, exponent = lighting.materials.glossy[shader], lighting.materials.exponent[shader]
        present, none = bool(glossy.any()), np.zeros(0)
        of_eye = hits.distance_and_cosine(group) if present else (none, none)
        spread = group.spread
        return cls(lighting, p, group, present, spread(glossy), spread(exponent), *of_eye)

    def of_light(self, number: int, incoming: Incoming, at: Ints | slice) -> Floats:
        """(n.h)^exponent of a light at some points; `incoming`: at all of the group."""
        p, light = pick(self.p, at), self.lighting.local[number].tolist()
        to_light = light[0] - p[0], light[1] - p[1], light[2] - p[2]
        length, distance = np.sqrt(incoming.length2[number][at]), self.distance[at]

        def vectors(some: Ints) -> tuple[Triple, Triple, Triple]:
            n = pick(pick(self.group.n, at), some)
            wi = scaled(pick(to_light, some), 1 / length[some])
            return n, wi, scaled(pick(p, some), -1 / distance[some])

        return highlight(
            incoming.n_dot_l[number][at] / length,
            self.n_dot_v[at],
            dot(to_light, p) / (-distance * length),
            select(self.exponent, at),
            vectors,
        )


def lighting_of(scene: Scene, view: View) -> Lighting:
    """Prepare a scene's lights."""
    surfaces, lights = view.surfaces, scene.lights
    positions = np.array([light.position for light in lights]).reshape(-1, 3)
    return Lighting(
        view=view,
        intensities=np.array([light.intensity for light in lights]).reshape(-1, 3),
        local=np.column_stack(view.raster.to_camera(positions)),
        occluders=occluders_of(view, positions),
        shader=surfaces.shader_index,
        materials=Materials.of(surfaces.shaders),
    )


def radiance_at(
    lighting: Lighting,
    samples: Samples,
    out: Floats | None = None,
    key: Ints | None = None,
) -> Floats:
    """Radiance (3, n) at samples, towards the eye; put into `out`, zeros, if that is given.

    If `key` (n,) is given, what `key_of` says is put there; what sees nothing is left as it is.
    """
    radiance = np.zeros((3, samples.size)) if out is None else out
    hits = visible(lighting.view, samples)
    incoming = incoming_at(lighting, hits)
    lit = incoming.n_dot_l > 0
    lit &= ~occlusion(lighting.occluders, hits, lit)
    for group in hits.groups:
        part = group.part
        shaded = shade(Highlights.of(lighting, hits, group), incoming.part(part), lit[:, part])
        for channel, values in zip(radiance, shaded, strict=True):
            channel[group.sample] = values
        if key is not None:
            key[group.sample] = key_of(group, lit[:, part])
    return radiance


def key_of(group: Group, lit: Bools) -> Ints:
    """A number (n,) for the object, its face, and the lights that reach it: `lit` (lights, n)."""
    key: Ints = group.spread(group.owner * 4) + group.face
    for bit in lit:
        # An odd factor: with more lights than bits, the first are not shifted out.
        key = key * 3 + bit
    return key


def incoming_at(lighting: Lighting, hits: Visible) -> Incoming:
    """The light that comes in at all hits."""
    occluders = lighting.occluders
    result = Incoming(*np.empty((2, len(lighting.local), hits.p.shape[1])))
    for number, light in enumerate(lighting.local.tolist()):
        kept_out = lighting.view.eye_inside & (occluders.side[number] != INSIDE)
        for group in hits.groups:
            n_dot_l, length2 = (m[number, group.part] for m in result)
            p = hits.p[:, group.part]
            to_light = light[0] - p[0], light[1] - p[1], light[2] - p[2]
            group.height_of(lighting.positions[number], to_light, n_dot_l)
            dot(to_light, to_light, length2)
            # Seen from inside, an object keeps out all light that is not inside as well.
            if kept_out[group.owner].any():
                # Not zero, which would be a terminator: a place where light begins.
                n_dot_l[np.broadcast_to(group.of(kept_out), n_dot_l.shape)] = -np.inf
    return result


def shade(highlights: Highlights, incoming: Incoming, lit: Bools) -> Triple:
    """Radiance, three (n,), of a group towards the eye.

    `highlights`: of the group.  `incoming`, `lit` (lights, n): what comes in there, and whether it
    reaches the points.
    """
    lighting, group = highlights.lighting, highlights.group
    # Sums over the lights, without the shaders' colours: intensity times n.l, and times highlight.
    diffuse: list[Floats] = []
    specular: list[Floats] = []
    for number, reached in enumerate(lit):
        if not reached.any():
            continue
        intensity = lighting.intensities[number].tolist()
        cosine = incoming.n_dot_l[number] / np.sqrt(incoming.length2[number])
        _add(diffuse, intensity, cosine if reached.all() else np.where(reached, cosine, 0.0))
        if highlights.present:
            at = index_where(reached & highlights.glossy)
            power = highlights.of_light(number, incoming, at)
            if not isinstance(at, slice):
                everywhere = np.zeros(cosine.size)
                everywhere[at] = power
                power = everywhere
            _add(specular, intensity, power)
    materials, shader = lighting.materials, lighting.shader[group.owner]
    radiance = _reflected(diffuse, materials.diffuse[:, shader], group)
    if specular:
        glossy = _reflected(specular, materials.specular[:, shader], group)
        radiance = each(np.add, radiance, glossy)
    return radiance


def _add(total: list[Floats], intensity: list[float], weight: Floats) -> None:
    """Add one more light, with a weight (n,) for each point, to three channels."""
    if not total:
        total.extend(strength * weight for strength in intensity)
        return
    for channel, strength in zip(total, intensity, strict=True):
        channel += strength * weight


def _reflected(total: list[Floats], colors: Floats, group: Group) -> Triple:
    """The light, if there is any, times the surfaces' colours, (3,) or (3, spans)."""
    total = total or [np.zeros(group.sample.size)] * 3
    r, g, b = (light * group.spread(color) for light, color in zip(total, colors, strict=True))
    return r, g, b


def narrow_highlights(
    highlights: Highlights, incoming: Incoming, facing: Bools, footprint: Floats
) -> Iterator[Ints]:
    """Points whose `footprint` (n,) may hold a highlight too narrow for one sample to stand for.

    All lights that they face count: one that does not reach a point may reach
    other parts of its footprint.

    Around its middle a highlight is the bell exp(-p a^2 / 2), with exponent p, of
    the angle a between normal and half vector.  That changes as the surface
    curves, and as the directions to light and eye turn.
    """
    if not highlights.present:
        return
    group = highlights.group
    bending = 1 / highlights.distance + group.of(highlights.lighting.view.curvature)
    scale = np.where(highlights.glossy, np.sqrt(highlights.exponent / 2), 0)
    for number, faces in enumerate(facing):
        change = footprint * (bending + 1 / np.sqrt(incoming.length2[number])) * scale
        at = indices((change > _SMOOTH) & faces)
        if at.size:
            power = highlights.of_light(number, incoming, at)
            yield at[np.minimum(np.sqrt(-np.log(power)), _DARK) - change[at] < _FAINT]
