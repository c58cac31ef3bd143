"""Radiance of hits: shadows, then shading, light by light."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from tracer.arrays import Bools, Floats, Ints, Triple, dot, each, indices, pick, scaled
from tracer.light.shading import highlight
from tracer.scene.model import Phong, Scene
from tracer.shadow.occluders import Occluders, occluders_of
from tracer.shadow.occlusion import occlusion
from tracer.shapes.rounding import INSIDE
from tracer.view.samples import Samples
from tracer.view.view import Group, View, Visible
from tracer.view.visibility import visible

# On the bell exp(-x^2): the most that x may change over what one sample stands for, the x where
# the bell is as good as zero, and the x where it underflows.
_SMOOTH, _FAINT, _DARK = 0.7, 3.0, 27.0


# With more lights than this, fewer samples are taken at a time.
_LIGHTS = 16


class Lighting(NamedTuple):
    """A scene's lights, and what they fall on.

    Attributes
    ----------
    view : View
    intensities : (lights, 3)
    local : (lights, 3)
        The positions in the camera's axes, seen from the eye.
    occluders : Occluders
    diffuse, specular : (3, n)
        The colours of each object, spheres first.
    exponent : (n,)
    glossy : (n,)
        Whether it has highlights at all.
    """

    view: View
    intensities: Floats
    local: Floats
    occluders: Occluders
    diffuse: Floats
    specular: Floats
    exponent: Floats
    glossy: Bools

    @property
    def positions(self) -> Floats:
        """Positions of the lights (lights, 3), in the scene's axes."""
        return self.occluders.lights

    def at_once(self, samples: int) -> int:
        """`View.at_once`, and fewer with many lights: memory grows with the pairs of both."""
        return max(1, self.view.at_once(samples) * _LIGHTS // max(_LIGHTS, len(self.local)))


class Incoming(NamedTuple):
    """Light as it comes in at hits, whatever lies between.

    Attributes
    ----------
    lighting : Lighting
    hits : Visible
    n_dot_l : (lights, n)
        n . l, with the unit normal n and the vector l to the light, not of unit length; minus
        infinity where the object is seen from inside and the light is not inside it.
    length2 : (lights, n)
        l . l
    """

    lighting: Lighting
    hits: Visible
    n_dot_l: Floats
    length2: Floats

    def highlight(self, number: int, group: Group, at: Ints) -> Floats:
        """(n.h)^exponent of a light at some points of a group."""
        p, light = pick(self.hits.p[:, group.part], at), self.lighting.local[number].tolist()
        to_light = light[0] - p[0], light[1] - p[1], light[2] - p[2]
        length = np.sqrt(self.length2[number, group.part][at])
        distance = np.sqrt(dot(p, p))

        def vectors(some: Ints) -> tuple[Triple, Triple, Triple]:
            wi = scaled(pick(to_light, some), 1 / length[some])
            wo = scaled(pick(p, some), -1 / distance[some])
            return pick(each(group.at_samples, group.n), at[some]), wi, wo

        return highlight(
            self.n_dot_l[number, group.part][at] / length,
            group.at_samples(group.height)[at] / distance,
            dot(to_light, p) / (-distance * length),
            group.of(self.lighting.exponent)[at],
            vectors,
        )


def lighting_of(scene: Scene, view: View) -> Lighting:
    """Prepare a scene's lights."""
    positions = np.array([light.position for light in scene.lights]).reshape(-1, 3)
    colors = [
        (*s.diffuse, *((*s.specular, s.exponent) if isinstance(s, Phong) else (0, 0, 0, 0)))
        for s in view.surfaces.shaders
    ]
    table = np.array(colors).reshape(-1, 7).T.take(view.surfaces.shader_index, axis=1)
    return Lighting(
        view=view,
        intensities=np.array([light.intensity for light in scene.lights]).reshape(-1, 3),
        local=np.column_stack(view.raster.to_camera(positions)),
        occluders=occluders_of(view, positions),
        diffuse=table[:3],
        specular=table[3:6],
        exponent=table[6],
        glossy=np.any(table[3:6] > 0, axis=0),
    )


def radiance_at(
    lighting: Lighting, samples: Samples, out: Floats | None = None, ids: Ints | None = None
) -> Floats:
    """Radiance (3, n) at samples, towards the eye; put into `out`, zeros, if that is given.

    If `ids` (n,) is given, `ids_of` is put there; what sees nothing is left as it is.
    """
    radiance = np.zeros((3, samples.size)) if out is None else out
    hits = visible(lighting.view, samples)
    incoming = incoming_at(lighting, hits)
    lit = incoming.n_dot_l > 0
    lit &= ~occlusion(lighting.occluders, hits, lit)
    sample = hits.sample
    for channel, values in zip(radiance, shade(incoming, lit), strict=True):
        channel[sample] = values
    if ids is not None:
        ids[sample] = ids_of(hits, lit)
    return radiance


def ids_of(hits: Visible, lit: Bools) -> Ints:
    """A number (n,) for the object, its face, and the lights that reach it: `lit` (lights, n)."""
    ids = np.empty(hits.p.shape[1], dtype=np.intp)
    for group in hits.groups:
        ids[group.part] = group.spread(group.owner * 4 + group.face)
    for bit in lit:
        # An odd factor: with more lights than bits, the first are not shifted out.
        ids = ids * 3 + bit
    return ids


def incoming_at(lighting: Lighting, hits: Visible) -> Incoming:
    """The light that comes in at all hits."""
    occluders = lighting.occluders
    result = Incoming(lighting, hits, *np.empty((2, len(lighting.local), hits.p.shape[1])))
    for number, light in enumerate(lighting.local.tolist()):
        kept_out = lighting.view.eye_inside & (occluders.side[number] != INSIDE)
        for group in hits.groups:
            n_dot_l, length2 = (m[number, group.part] for m in (result.n_dot_l, result.length2))
            p = hits.p[:, group.part]
            to_light = light[0] - p[0], light[1] - p[1], light[2] - p[2]
            group.height_of(lighting.positions[number], to_light, n_dot_l)
            dot(to_light, to_light, length2)
            # Seen from inside, an object keeps out all light that is not inside as well.
            if kept_out[group.owner].any():
                # Not zero, which would be a terminator: a place where light begins.
                n_dot_l[group.of(kept_out)] = -np.inf
    return result


def shade(incoming: Incoming, lit: Bools) -> Floats:
    """Radiance (3, n) of hits towards the eye; `lit` (lights, n): whether lights reach them."""
    lighting = incoming.lighting
    radiance = np.zeros((3, lit.shape[1]))
    for group in incoming.hits.groups:
        glossy = group.of(lighting.glossy)
        # Sums over lights of intensity times cosine, and highlight, without the shaders' colours.
        sums = [radiance[:, group.part]]
        if np.any(glossy):
            sums.append(np.zeros(sums[0].shape))
        for number, reached in enumerate(lit[:, group.part]):
            if not reached.any():
                continue
            n_dot_l, length2 = (m[number, group.part] for m in (incoming.n_dot_l, incoming.length2))
            weights = np.zeros((len(sums), reached.size))
            np.divide(n_dot_l, np.sqrt(length2), out=weights[0], where=reached)
            if len(sums) > 1:
                at = indices(reached & glossy)
                weights[1, at] = incoming.highlight(number, group, at)
            for channels, weight in zip(sums, weights, strict=True):
                for channel, strength in zip(channels, lighting.intensities[number], strict=True):
                    channel += strength * weight
        for channels, colors in zip(sums, (lighting.diffuse, lighting.specular), strict=False):
            for channel, color in zip(channels, colors, strict=True):
                channel *= group.of(color)
        if len(sums) > 1:
            sums[0] += sums[1]
    return radiance


def narrow_highlights(incoming: Incoming, facing: Bools, footprint: Floats) -> Iterator[Ints]:
    """Hits whose `footprint` (n,) may hold a highlight too narrow for one sample to stand for.

    All lights that they face count: one that does not reach a point may reach other parts of its
    footprint.  Around its middle a highlight is the bell exp(-p a^2 / 2), with exponent p, of the
    angle a between normal and half vector.  That changes as the surface curves, and as the
    directions to light and eye turn.
    """
    lighting, distance = incoming.lighting, incoming.hits.distance
    for group in incoming.hits.groups:
        glossy, part = group.of(lighting.glossy), group.part
        if not np.any(glossy):
            continue
        bending = 1 / distance[part] + group.of(lighting.view.curvature)
        scale = np.where(glossy, np.sqrt(group.of(lighting.exponent) / 2), 0)
        for number, faces in enumerate(facing[:, part]):
            turn = bending + 1 / np.sqrt(incoming.length2[number, part])
            change = footprint[part] * turn * scale
            at = indices((change > _SMOOTH) & faces)
            if at.size:
                power = incoming.highlight(number, group, at)
                shows = np.minimum(np.sqrt(-np.log(power)), _DARK) - change[at] < _FAINT
                yield part.start + at[shows]
