"""Shading: the light that arrives at hits, and the radiance that it causes towards the eye.

The model is that of Blinn (Models of light reflection for computer synthesized pictures, 1977), as
in Shirley, Fundamentals of Computer Graphics, 2nd ed., 9.1 and 9.2: each light that reaches the hit
adds I (kd max(0, n.l) + ks (n.h)^p).  The vector h is halfway between the directions to the light
and to the eye.  Light does not fall off with distance, and the highlight has no further cosine.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from tracer.arrays import Bools, Floats, Ints, Triple, dot, indices, map3, scale3, take3
from tracer.geometry.rounding import INSIDE, MAX_AMPLIFICATION, MIN_HALF_LENGTH2, MIN_HALF_SQUARE
from tracer.trace.hits import Hits, ShapeHits
from tracer.world.prepared_scene import Lights

# A highlight is the bell exp(-x^2).  Maximum change of x over the part of the surface for which one
# sample can stand; the x from which on the bell is negligible; and the x where it underflows.
# Tuned on the project's scenes: with half or twice the first, and with 2 for the second, errors of
# single pictures are up to 1.1 times as large.
_MAX_LOBE_STEP, _LOBE_CUTOFF, _LOBE_UNDERFLOW = 0.7, 3.0, 27.0


class LightGeometry(NamedTuple):
    """Dot products of normals and light vectors, for n hits and a batch of lights.

    Here n is the unit normal at the hit, and l the vector from the hit to the light, which is not
    of unit length.  Occluders are ignored.

    Attributes
    ----------
    hits : Hits
        The hits.
    lights : Lights
        The lights.
    n_dot_l : (lights, n) float array
        n . l for each pair.  It is -inf if the eye is inside the hit's object and the light is
        outside: no light enters the object.
    length2 : (lights, n) float array
        l . l for each pair: the squared distance of the light.
    """

    hits: Hits
    lights: Lights
    n_dot_l: Floats
    length2: Floats

    def highlight_strength(self, light_index: int, group: ShapeHits, index: Ints) -> Floats:
        """Compute the strength (n.h)^exponent of one light's highlight at k hits.

        Here n is the unit normal, and h the unit half vector between the directions to the light
        and to the eye.

        Parameters
        ----------
        light_index : int
            Index of the light in this batch.
        group : ShapeHits
            Hits on objects of one shape, which contain the k hits.
        index : (k,) int array
            Indices of the k hits within the group.  Their surfaces must face the light.

        Returns
        -------
        strength : (k,) float array
            The strength at each hit.
        """
        from_eye = take3(self.hits.from_eye[:, group.interval], index)
        x, y, z = self.lights.from_eye[light_index].tolist()
        to_light = x - from_eye[0], y - from_eye[1], z - from_eye[2]
        length = np.sqrt(self.length2[light_index, group.interval][index])
        distance = np.sqrt(dot(from_eye, from_eye))

        def unit_vectors(selected: Ints) -> tuple[Triple, Triple, Triple]:
            """Compute unit vectors at selected hits.

            `selected` (j,) contains indices into the k hits.  The result has three items: the
            normals, the directions to the light, and the directions to the eye, each as a tuple of
            three (j,) arrays.
            """
            light_direction = scale3(take3(to_light, selected), 1 / length[selected])
            eye_direction = scale3(take3(from_eye, selected), -1 / distance[selected])
            normal = take3(map3(group.per_hit, group.normal), index[selected])
            return normal, light_direction, eye_direction

        return _stable_highlight(
            self.n_dot_l[light_index, group.interval][index] / length,
            group.per_hit(group.eye_height)[index] / distance,
            dot(to_light, from_eye) / (-distance * length),
            group.object_values(self.hits.prepared.exponent)[index],
            unit_vectors,
        )


class Shading:
    """The radiance that n hits reflect towards the eye, summed over lights.

    Parameters
    ----------
    hits : Hits
        The hits.
    with_ids : bool
        Whether to compute `ids`.

    Attributes
    ----------
    ids : (n,) int array
        For each hit, a number that encodes the object, its face, and the lights visible from the
        hit.  If `with_ids` is False, the array is empty.
    """

    def __init__(self, hits: Hits, *, with_ids: bool) -> None:
        self._hits, self._with_ids = hits, with_ids
        self._is_glossy = [group.object_values(hits.prepared.is_glossy) for group in hits.groups]
        # For each group of hits, the sum over lights of intensity times n.l, and of intensity times
        # (n.h)^exponent, without the colours of the surfaces; None before the first light.
        self._diffuse: list[Floats | None] = [None] * len(hits.groups)
        self._specular: list[Floats | None] = [None] * len(hits.groups)
        faces = [g.repeat_runs(4 * g.run_object + g.face) for g in hits.groups if with_ids]
        self.ids: Ints = np.concatenate([np.zeros(0, dtype=np.intp), *faces])

    def add(self, geometry: LightGeometry, is_lit: Bools) -> None:
        """Add the light of a batch of lights to the sum, and encode their visibility in `ids`.

        Parameters
        ----------
        geometry : LightGeometry
            The lights, and the hits of this object.
        is_lit : (lights, n) bool array
            Whether the light is visible from the hit.
        """
        for light_is_lit in is_lit if self._with_ids else ():
            # The factor is odd: with more lights than bits, the first lights still count.
            self.ids = self.ids * 3 + light_is_lit
        for number, (group, is_glossy) in enumerate(
            zip(self._hits.groups, self._is_glossy, strict=True)
        ):
            interval, any_glossy = group.interval, is_glossy.any()
            for light_index, is_hit_lit in enumerate(is_lit[:, interval]):
                if not is_hit_lit.any():
                    continue
                intensity = geometry.lights.intensity[light_index]
                length = np.sqrt(geometry.length2[light_index, interval])
                n_dot_l, cosine = geometry.n_dot_l[light_index, interval], np.zeros(length.size)
                np.divide(n_dot_l, length, out=cosine, where=is_hit_lit)
                self._diffuse[number] = _add_light(self._diffuse[number], intensity, cosine)
                if any_glossy:
                    strength, index = np.zeros(length.size), indices(is_hit_lit & is_glossy)
                    strength[index] = geometry.highlight_strength(light_index, group, index)
                    self._specular[number] = _add_light(self._specular[number], intensity, strength)

    def reflection_terms(self) -> Iterator[tuple[Ints, int, Floats, Floats | None]]:
        """Yield the diffuse and the specular radiance, for each shape and each colour channel.

        Nothing is yielded for a shape that no light reaches.

        Yields
        ------
        sample : (k,) int array
            Indices of the samples whose rays hit objects of one shape.
        channel : int
            0 for red, 1 for green, 2 for blue.
        diffuse : (k,) float array
            Sum over visible lights of I kd n.l, where I is the light's intensity, kd the object's
            diffuse colour, n the normal, and l the direction to the light.
        specular : (k,) float array or None
            Sum over visible lights of I ks (n.h)^exponent, where ks is the object's specular
            colour, and h the half vector; None if none of the lit objects has highlights.
        """
        prepared = self._hits.prepared
        for group, diffuse_sum, specular_sum in zip(
            self._hits.groups, self._diffuse, self._specular, strict=True
        ):
            if diffuse_sum is None:
                continue
            for channel in range(3):
                diffuse, specular = group.object_values(prepared.diffuse[channel]), None
                diffuse *= diffuse_sum[channel]
                if specular_sum is not None:
                    specular = group.object_values(prepared.specular[channel])
                    specular *= specular_sum[channel]
                yield group.sample, channel, diffuse, specular

    def radiance(self, out: Floats | None = None) -> Floats:
        """Compute the radiance towards the eye, at each sample.

        Parameters
        ----------
        out : (3, samples) float array of zeros, optional
            Array that receives the result, and is returned.

        Returns
        -------
        radiance : (3, samples) float array
            Linear RGB radiance; 0 for samples without a hit.
        """
        out = np.zeros((3, self._hits.samples.size)) if out is None else out
        for sample, channel, diffuse, specular in self.reflection_terms():
            if specular is not None:
                diffuse += specular
            out[channel][sample] = diffuse
        return out


def _add_light(total: Floats | None, intensity: Floats, factor: Floats) -> Floats:
    """Add the light of one source to the sum over lights.

    Parameters
    ----------
    total : (3, n) float array or None
        The sum for each colour channel and each of n hits, which is overwritten; None if this is
        the first light.
    intensity : (3,) float array
        The light's RGB intensity.
    factor : (n,) float array
        What the intensity is multiplied by at each hit: a cosine, or the strength of a highlight.

    Returns
    -------
    total : (3, n) float array
        The new sum.
    """
    if total is None:  # to create zeros and to add to them would take longer
        return np.multiply.outer(intensity, factor)
    for channel, strength in zip(total, intensity.tolist(), strict=True):
        channel += strength * factor
    return total


def light_geometry(hits: Hits, lights: Lights) -> LightGeometry:
    """Compute n . l and l . l for all pairs of a light and a hit, regardless of occluders.

    Here n is the unit normal at the hit, and l the vector from the hit to the light.

    Parameters
    ----------
    hits : Hits
        The hits.
    lights : Lights
        A batch of lights.

    Returns
    -------
    geometry : LightGeometry
        The dot products, as arrays (lights, hits).
    """
    geometry = LightGeometry(
        hits, lights, *np.empty((2, len(lights.from_eye), hits.from_eye.shape[1]))
    )
    for light_index, (x, y, z) in enumerate(lights.from_eye.tolist()):
        # If the eye is inside an object, the object blocks all lights outside of it.
        is_blocked = hits.prepared.is_eye_inside & (lights.side[light_index] != INSIDE)
        for group in hits.groups:
            from_eye = hits.from_eye[:, group.interval]
            to_light = x - from_eye[0], y - from_eye[1], z - from_eye[2]
            n_dot_l = group.height_of(lights.position[light_index], to_light)
            if is_blocked[group.run_object].any():
                # 0 would count as a terminator: a line at which light begins.
                n_dot_l[group.object_values(is_blocked)] = -np.inf
            geometry.n_dot_l[light_index, group.interval] = n_dot_l
            geometry.length2[light_index, group.interval] = dot(to_light, to_light)
    return geometry


def find_narrow_highlights(
    geometry: LightGeometry, frontlit: Bools, footprint: Floats
) -> Iterator[Ints]:
    """Find hits whose footprint may contain a highlight too narrow for a single sample.

    The footprint is the part of the surface around the hit that a cell of the picture covers.
    Around the centre of a highlight, its strength is about exp(-p a^2 / 2), with the exponent p and
    the angle a between the normal and the half vector.  The angle changes over the footprint
    because the surface curves, and because the directions to the light and to the eye turn.

    Parameters
    ----------
    geometry : LightGeometry
        The n hits and the lights.
    frontlit : (lights, n) bool array
        Whether the surface at the hit faces the light.  Occluders are ignored: a light that is not
        visible from the hit may still be visible from other points of the footprint.
    footprint : (n,) float array
        Radius of each footprint, in the scene's unit of length.

    Yields
    ------
    index : (k,) int array
        Indices of hits with such a highlight of one light.  A hit is yielded again for each further
        light that causes one.
    """
    prepared, distance = geometry.hits.prepared, geometry.hits.distance
    for group in geometry.hits.groups:
        is_glossy, interval = group.object_values(prepared.is_glossy), group.interval
        if not np.any(is_glossy):
            continue
        eye_turn = 1 / distance[interval] + group.object_values(prepared.curvature)
        scale = np.where(is_glossy, np.sqrt(group.object_values(prepared.exponent) / 2), 0)
        for light_index, is_frontlit in enumerate(frontlit[:, interval]):
            turn = eye_turn + 1 / np.sqrt(geometry.length2[light_index, interval])
            step = footprint[interval] * turn * scale
            index = indices((step > _MAX_LOBE_STEP) & is_frontlit)
            if index.size:
                strength = geometry.highlight_strength(light_index, group, index)
                position = np.minimum(np.sqrt(-np.log(strength)), _LOBE_UNDERFLOW)
                is_visible = position - step[index] < _LOBE_CUTOFF
                yield interval.start + index[is_visible]


def _stable_highlight(
    n_dot_l: Floats,
    n_dot_v: Floats,
    l_dot_v: Floats,
    exponent: Floats,
    unit_vectors: Callable[[Ints], tuple[Triple, Triple, Triple]],
) -> Floats:
    """Compute (n.h)^p accurately, with the unit normal n, the unit half vector h and exponent p.

    Let l and v be the directions to the light and to the eye.  As n.h = (n.l + n.v) / |l + v| and
    |l + v|^2 = 2 + 2 l.v, three cosines suffice for most hits.  They do not suffice if (1) a large
    exponent amplifies the rounding error of n.h, or (2) l and v almost cancel.  In both cases, the
    result is computed from the vectors: with e = n - h, the cosine is 1 - e.e / 2, and
    exp(p log1p(-e.e / 2)) keeps the digits that n.h has lost.

    For exponents up to 1e6, the error is at most 1e-12 if |l + v| > 0.3, and at most 1e-10 if
    |l + v| > 0.002.

    Parameters
    ----------
    n_dot_l, n_dot_v, l_dot_v : (n,) float arrays
        Dot products of the unit vectors n, l and v; n.l is positive.
    exponent : (n,) float array
        The exponent p at each hit.
    unit_vectors : callable
        Takes the indices (k,) of hits, and returns the unit vectors n, l and v at these hits, each
        as a tuple of three (k,) arrays.

    Returns
    -------
    strength : (n,) float array
        (n.h)^p at each hit.
    """
    half_square = 1 + l_dot_v  # |l + v|^2 / 2
    cosine2 = n_dot_l + n_dot_v
    cosine2 *= cosine2
    cosine2 /= 2 * half_square
    strength: Floats = np.exp(0.5 * exponent * np.log(cosine2))
    index = indices((half_square < MIN_HALF_SQUARE) | (exponent * strength > MAX_AMPLIFICATION))
    if not index.size:
        return strength
    normal, to_light, to_eye = unit_vectors(index)
    l_plus_v = map3(np.add, to_light, to_eye)
    length2, p = dot(l_plus_v, l_plus_v), exponent[index]
    e = map3(np.subtract, normal, scale3(l_plus_v, 1 / np.sqrt(length2)))
    # With the exponent 0, the highlight is 1 everywhere, even if the logarithm is infinite.
    accurate = np.where(p == 0, 1.0, np.exp(p * np.log1p(-0.5 * dot(e, e))))
    # If l = -v, the light grazes the surface, and l + v consists of rounding errors.
    strength[index] = np.where(length2 > MIN_HALF_LENGTH2, accurate, 0.0)
    return strength
