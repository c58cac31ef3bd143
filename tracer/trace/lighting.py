"""Radiance of hits: shadows, then shading, light by light."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from tracer.arrays import Bools, Floats, Ints, Triple, dot, indices, map3, scaled, take3
from tracer.geometry.rounding import INSIDE
from tracer.trace.hits import Hits, ShapeHits
from tracer.trace.occlusion import occlusion
from tracer.trace.samples import Samples
from tracer.trace.shading import highlight
from tracer.trace.visibility import nearest_hits
from tracer.world.prepared_scene import PreparedScene

# On the bell exp(-x^2): the most that x may change over what one sample stands for, the x where
# the bell is as good as zero, and the x where it underflows.
_SMOOTH, _FAINT, _DARK = 0.7, 3.0, 27.0


class LightGeometry(NamedTuple):
    """Light as it comes in at hits, whatever lies between.

    Attributes
    ----------
    hits : Hits
    n_dot_l : (lights, n)
        n . l, with the unit normal n and the vector l to the light, not of unit length; minus
        infinity where the object is seen from inside and the light is not inside it.
    length2 : (lights, n)
        l . l
    """

    hits: Hits
    n_dot_l: Floats
    length2: Floats

    def highlight(self, number: int, group: ShapeHits, at: Ints) -> Floats:
        """(n.h)^exponent of a light at some points of a group."""
        p, light = take3(self.hits.p[:, group.part], at), self.hits.prepared.local[number].tolist()
        to_light = light[0] - p[0], light[1] - p[1], light[2] - p[2]
        length = np.sqrt(self.length2[number, group.part][at])
        distance = np.sqrt(dot(p, p))

        def vectors(some: Ints) -> tuple[Triple, Triple, Triple]:
            wi = scaled(take3(to_light, some), 1 / length[some])
            wo = scaled(take3(p, some), -1 / distance[some])
            return take3(map3(group.at_samples, group.n), at[some]), wi, wo

        return highlight(
            self.n_dot_l[number, group.part][at] / length,
            group.at_samples(group.height)[at] / distance,
            dot(to_light, p) / (-distance * length),
            group.of(self.hits.prepared.exponent)[at],
            vectors,
        )


def radiance_at(prepared: PreparedScene, samples: Samples, out: Floats | None = None) -> Floats:
    """Radiance (3, n) at samples, towards the eye; put into `out`, zeros, if that is given."""
    geometry, lit = _lit_hits(prepared, samples)
    return _at_samples(geometry, lit, np.zeros((3, samples.size)) if out is None else out)


def radiance_and_ids(prepared: PreparedScene, samples: Samples) -> tuple[Floats, Ints]:
    """`radiance_at` and `ids_of` samples; -1 where nothing is seen."""
    geometry, lit = _lit_hits(prepared, samples)
    ids = np.full(samples.size, -1)
    ids[geometry.hits.sample] = ids_of(geometry.hits, lit)
    return _at_samples(geometry, lit, np.zeros((3, samples.size))), ids


def _lit_hits(prepared: PreparedScene, samples: Samples) -> tuple[LightGeometry, Bools]:
    """What samples see, and whether lights reach it (lights, n)."""
    hits = nearest_hits(prepared, samples)
    geometry = light_geometry(hits)
    lit = geometry.n_dot_l > 0
    lit &= ~occlusion(hits, lit)
    return geometry, lit


def _at_samples(geometry: LightGeometry, lit: Bools, out: Floats) -> Floats:
    for channel, values in zip(out, shade(geometry, lit), strict=True):
        channel[geometry.hits.sample] = values
    return out


def ids_of(hits: Hits, lit: Bools) -> Ints:
    """A number (n,) for the object, its face, and the lights that reach it: `lit` (lights, n)."""
    ids = np.empty(hits.p.shape[1], dtype=np.intp)
    for group in hits.groups:
        ids[group.part] = group.repeat_runs(group.obj * 4 + group.face)
    for bit in lit:
        # An odd factor: with more lights than bits, the first are not shifted out.
        ids = ids * 3 + bit
    return ids


def light_geometry(hits: Hits) -> LightGeometry:
    """The light that comes in at all hits."""
    prepared = hits.prepared
    result = LightGeometry(hits, *np.empty((2, len(prepared.local), hits.p.shape[1])))
    for number, light in enumerate(prepared.local.tolist()):
        kept_out = prepared.eye_inside & (prepared.side[number] != INSIDE)
        for group in hits.groups:
            n_dot_l, length2 = (m[number, group.part] for m in (result.n_dot_l, result.length2))
            p = hits.p[:, group.part]
            to_light = light[0] - p[0], light[1] - p[1], light[2] - p[2]
            group.height_of(prepared.lights[number], to_light, n_dot_l)
            dot(to_light, to_light, length2)
            # Seen from inside, an object keeps out all light that is not inside as well.
            if kept_out[group.obj].any():
                # Not zero, which would be a terminator: a place where light begins.
                n_dot_l[group.of(kept_out)] = -np.inf
    return result


def shade(geometry: LightGeometry, lit: Bools) -> Floats:
    """Radiance (3, n) of hits towards the eye; `lit` (lights, n): whether lights reach them."""
    prepared = geometry.hits.prepared
    radiance = np.zeros((3, lit.shape[1]))
    for group in geometry.hits.groups:
        glossy = group.of(prepared.glossy)
        # Sums over lights of intensity times cosine, and highlight, without the shaders' colours.
        sums = [radiance[:, group.part]]
        if np.any(glossy):
            sums.append(np.zeros(sums[0].shape))
        for number, reached in enumerate(lit[:, group.part]):
            if not reached.any():
                continue
            n_dot_l, length2 = (m[number, group.part] for m in (geometry.n_dot_l, geometry.length2))
            weights = np.zeros((len(sums), reached.size))
            np.divide(n_dot_l, np.sqrt(length2), out=weights[0], where=reached)
            if len(sums) > 1:
                at = indices(reached & glossy)
                weights[1, at] = geometry.highlight(number, group, at)
            for channels, weight in zip(sums, weights, strict=True):
                for channel, strength in zip(channels, prepared.intensities[number], strict=True):
                    channel += strength * weight
        for channels, colors in zip(sums, (prepared.diffuse, prepared.specular), strict=False):
            for channel, color in zip(channels, colors, strict=True):
                channel *= group.of(color)
        if len(sums) > 1:
            sums[0] += sums[1]
    return radiance


def narrow_highlights(geometry: LightGeometry, facing: Bools, footprint: Floats) -> Iterator[Ints]:
    """FirstHits whose `footprint` (n,) may hold a highlight too narrow for one sample to stand for.

    All lights that they face count: one that does not reach a point may reach other parts of its
    footprint.  Around its middle a highlight is the bell exp(-p a^2 / 2), with exponent p, of the
    angle a between normal and half vector.  That changes as the surface curves, and as the
    directions to light and eye turn.
    """
    prepared, distance = geometry.hits.prepared, geometry.hits.distance
    for group in geometry.hits.groups:
        glossy, part = group.of(prepared.glossy), group.part
        if not np.any(glossy):
            continue
        bending = 1 / distance[part] + group.of(prepared.curvature)
        scale = np.where(glossy, np.sqrt(group.of(prepared.exponent) / 2), 0)
        for number, faces in enumerate(facing[:, part]):
            turn = bending + 1 / np.sqrt(geometry.length2[number, part])
            change = footprint[part] * turn * scale
            at = indices((change > _SMOOTH) & faces)
            if at.size:
                power = geometry.highlight(number, group, at)
                shows = np.minimum(np.sqrt(-np.log(power)), _DARK) - change[at] < _FAINT
                yield part.start + at[shows]
