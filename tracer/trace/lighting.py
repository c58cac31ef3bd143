"""Light at hits: where it comes from, and the radiance that it makes of them.

Blinn, Models of light reflection for computer synthesized pictures, 1977, as in Shirley,
Fundamentals of Computer Graphics, 2nd ed., 9.1 and 9.2: each light that is seen adds
I (kd max(0, n.l) + ks (n.h)^p), h halfway between the directions to the light and to the eye.
Light does not fall off with distance, and the highlight carries no further cosine.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from tracer.arrays import Bools, Floats, Ints, Triple, dot, indices, map3, scaled, take3
from tracer.geometry.rounding import INSIDE
from tracer.trace.hits import Hits, ShapeHits
from tracer.world.prepared_scene import Lights

# On the bell exp(-x^2): the most that x may change over what one sample stands for, the x where
# the bell is as good as zero, and the x where it underflows.
_SMOOTH, _FAINT, _DARK = 0.7, 3.0, 27.0

# If 1 + l.v is less, too many of its digits have cancelled.
_CANCELLED = 1e-3

# If |l + v|^2 is less, it is rounding alone.
_OPPOSITE = 1e-24

# How many times larger the rounding of n.h may become in a highlight.
_AMPLIFIED = 256.0


class LightGeometry(NamedTuple):
    """Light as it comes in at hits, whatever lies between.

    Attributes
    ----------
    hits, lights
    n_dot_l : (lights, n)
        n . l, with the unit normal n and the vector l to the light, not of unit length; minus
        infinity where the object is seen from inside and the light is not inside it.
    length2 : (lights, n)
        l . l
    """

    hits: Hits
    lights: Lights
    n_dot_l: Floats
    length2: Floats

    def highlight(self, number: int, group: ShapeHits, at: Ints) -> Floats:
        """(n.h)^exponent of a light at some points of a group."""
        p, light = take3(self.hits.p[:, group.part], at), self.lights.local[number].tolist()
        to_light = light[0] - p[0], light[1] - p[1], light[2] - p[2]
        length = np.sqrt(self.length2[number, group.part][at])
        distance = np.sqrt(dot(p, p))

        def vectors(some: Ints) -> tuple[Triple, Triple, Triple]:
            wi = scaled(take3(to_light, some), 1 / length[some])
            wo = scaled(take3(p, some), -1 / distance[some])
            return take3(map3(group.at_samples, group.n), at[some]), wi, wo

        return _highlight(
            self.n_dot_l[number, group.part][at] / length,
            group.at_samples(group.height)[at] / distance,
            dot(to_light, p) / (-distance * length),
            group.of(self.hits.prepared.exponent)[at],
            vectors,
        )


class Shading:
    """Radiance of hits towards the eye, summed up over lights.

    Attributes
    ----------
    ids : (n,)
        A number for the object, its face, and the lights that reach it; only `with_ids`.
    """

    def __init__(self, hits: Hits, *, with_ids: bool) -> None:
        self._hits, self._with_ids = hits, with_ids
        self._glossy = [group.of(hits.prepared.glossy) for group in hits.groups]
        # Of each group the sums over lights of intensity times cosine, and times highlight, without
        # the shaders' colours.
        self._diffuse: dict[int, Floats] = {}
        self._specular: dict[int, Floats] = {}
        ids = [group.repeat_runs(4 * group.obj + group.face) for group in hits.groups if with_ids]
        self.ids: Ints = np.concatenate([np.zeros(0, dtype=np.intp), *ids])

    def add(self, geometry: LightGeometry, lit: Bools) -> None:
        """Add some lights; `lit` (lights, n): whether they reach hits."""
        for bit in lit if self._with_ids else ():
            # An odd factor: with more lights than bits, the first are not shifted out.
            self.ids = self.ids * 3 + bit
        for index, (group, glossy) in enumerate(zip(self._hits.groups, self._glossy, strict=True)):
            shiny = glossy.any()
            for number, reached in enumerate(lit[:, group.part]):
                if not reached.any():
                    continue
                intensity = geometry.lights.intensity[number]
                n_dot_l, length2 = (
                    m[number, group.part] for m in (geometry.n_dot_l, geometry.length2)
                )
                weight = np.zeros(reached.size)
                np.divide(n_dot_l, np.sqrt(length2), out=weight, where=reached)
                _add(self._diffuse, index, intensity, weight)
                if shiny:
                    weight, at = np.zeros(reached.size), indices(reached & glossy)
                    weight[at] = geometry.highlight(number, group, at)
                    _add(self._specular, index, intensity, weight)

    def at_samples(self, out: Floats) -> Floats:
        """Put the radiance into `out` (3, samples); `add` nothing afterwards."""
        prepared = self._hits.prepared
        for index, diffuse in self._diffuse.items():
            group, specular = self._hits.groups[index], self._specular.get(index)
            for k, channel in enumerate(out):
                diffuse[k] *= group.of(prepared.diffuse[k])
                if specular is not None:
                    diffuse[k] += specular[k] * group.of(prepared.specular[k])
                channel[group.sample] = diffuse[k]
        return out


def _add(sums: dict[int, Floats], index: int, intensity: Floats, weight: Floats) -> None:
    """Add a light to the sum of a group: its first light is the sum."""
    if index not in sums:
        sums[index] = np.multiply.outer(intensity, weight)
        return
    for channel, strength in zip(sums[index], intensity, strict=True):
        channel += strength * weight


def light_geometry(hits: Hits, lights: Lights) -> LightGeometry:
    """The light that comes in at all hits."""
    result = LightGeometry(hits, lights, *np.empty((2, len(lights.local), hits.p.shape[1])))
    for number, light in enumerate(lights.local.tolist()):
        kept_out = hits.prepared.eye_inside & (lights.side[number] != INSIDE)
        for group in hits.groups:
            n_dot_l, length2 = (m[number, group.part] for m in (result.n_dot_l, result.length2))
            p = hits.p[:, group.part]
            to_light = light[0] - p[0], light[1] - p[1], light[2] - p[2]
            group.height_of(lights.position[number], to_light, n_dot_l)
            dot(to_light, to_light, length2)
            # Seen from inside, an object keeps out all light that is not inside as well.
            if kept_out[group.obj].any():
                # Not zero, which would be a terminator: a place where light begins.
                n_dot_l[group.of(kept_out)] = -np.inf
    return result


def narrow_highlights(geometry: LightGeometry, facing: Bools, footprint: Floats) -> Iterator[Ints]:
    """Hits whose `footprint` (n,) may hold a highlight too narrow for one sample to stand for.

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


def _highlight(
    n_dot_l: Floats,
    n_dot_v: Floats,
    l_dot_v: Floats,
    exponent: Floats,
    vectors: Callable[[Ints], tuple[Triple, Triple, Triple]],
) -> Floats:
    """(n.h)^exponent.

    It is right to 1e-12 where |l + v| > 0.3, and to 1e-10 where that is more than 0.002, for
    exponents up to 1e6.

    As n.h is (n.l + n.v) / |l + v|, and |l + v|^2 = 2 + 2 l.v, cosines alone do for most points.
    Where a high exponent amplifies the rounding of n.h, and where l and v almost cancel, it is
    found from vectors: with e = n - h the cosine is 1 - e.e / 2, and exp(p log1p(-e.e / 2)) keeps
    the digits that n.h itself has lost.

    Parameters
    ----------
    n_dot_l, n_dot_v, l_dot_v : (n,)
        n.l (more than zero), n.v, and l.v, of unit vectors.
    exponent : (n,)
    vectors : callable
        Given the index of some of the points, unit vectors n, l and v there.
    """
    half2 = 1 + l_dot_v
    square = n_dot_l + n_dot_v
    square *= square
    square /= 2 * half2
    power: Floats = np.exp(0.5 * exponent * np.log(square))
    at = indices((half2 < _CANCELLED) | (exponent * power > _AMPLIFIED))
    if not at.size:
        return power
    n, light, view = vectors(at)
    h = map3(np.add, light, view)
    length2, some = dot(h, h), exponent[at]
    e = map3(np.subtract, n, scaled(h, 1 / np.sqrt(length2)))
    # With a zero exponent the highlight is 1 everywhere, whatever the logarithm.
    closer = np.where(some == 0, 1.0, np.exp(some * np.log1p(-0.5 * dot(e, e))))
    # Where l = -v, light can only graze the surface, and h is nothing but rounding.
    power[at] = np.where(length2 > _OPPOSITE, closer, 0.0)
    return power
