"""Shading: the light that arrives at hits, and the radiance that the hits reflect to the eye.

The model is that of Blinn (Models of light reflection for computer synthesized pictures, 1977), as
in Shirley, Fundamentals of Computer Graphics, 2nd ed., 9.1 and 9.2.  Each light that is visible
from the hit adds I (kd max(0, n.l) + ks (n.h)^p) to the radiance, with

- the intensity I of the light;
- the diffuse colour kd, the specular colour ks and the exponent p of the surface;
- the unit normal n, the direction l to the light, and the unit half vector h, which is halfway
  between the directions to the light and to the eye.

Light does not fall off with distance, and the highlight has no further cosine.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from tracer.arrays import Bools, Floats, Ints, Triple, dot, find, map_xyz, scale, take
from tracer.geometry.rounding import INSIDE, MAX_AMPLIFICATION, MIN_HALF_SQUARE, MIN_SUM_LENGTH2
from tracer.trace.hits import Hits
from tracer.world.prepared_scene import Lights

# A highlight has the shape of the bell exp(-x^2).  The maximum change of x over a part of a surface
# that one sample can represent; the x beyond which the bell is negligible; and the x at which it
# underflows.  Tuned on the project's scenes: with half or twice the first number, or with 2 for the
# second, errors of single pictures are up to 1.1 times as large.
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
        n . l for each pair; -inf if the eye is inside the hit's object and the light is outside,
        because no light enters the object.
    squared_distance : (lights, n) float array
        l . l for each pair: the squared distance of the light.
    """

    hits: Hits
    lights: Lights
    n_dot_l: Floats
    squared_distance: Floats

    def compute_highlight_strength(self, light_index: int, hit_index: Ints) -> Floats:
        """Compute the strength of one light's highlight at selected hits.

        The strength is (n.h)^p, where n is the unit normal, h the unit half vector between the
        directions to the light and to the eye, and p the exponent of the surface.

        Parameters
        ----------
        light_index : int
            Index of the light in this batch.
        hit_index : (k,) int array
            Indices of the hits.  Their surfaces must face the light.

        Returns
        -------
        strength : (k,) float array
            The strength at each selected hit, from 0 to 1.
        """
        hits = self.hits
        from_eye = take(hits.from_eye, hit_index)
        x, y, z = self.lights.from_eye[light_index].tolist()
        to_light = x - from_eye[0], y - from_eye[1], z - from_eye[2]
        light_distance = np.sqrt(self.squared_distance[light_index][hit_index])
        eye_distance = np.sqrt(dot(from_eye, from_eye))
        light_cosine = self.n_dot_l[light_index][hit_index] / light_distance
        eye_cosine = hits.eye_height[hit_index] / eye_distance
        # With unit vectors l to the light and v to the eye, n.h = (n.l + n.v) / |l + v|, and
        # |l + v|^2 = 2 + 2 l.v.  With exponents up to 1e6, the error of this formula is at most
        # 1e-12 if |l + v| > 0.3, and at most 1e-10 if |l + v| > 0.002.
        half_square = 1 + dot(to_light, from_eye) / (-eye_distance * light_distance)  # |l + v|^2/2
        squared_cosine = light_cosine + eye_cosine
        squared_cosine *= squared_cosine
        squared_cosine /= 2 * half_square
        exponent = hits.get_object_values(hits.scene.exponent)[hit_index]
        strength: Floats = np.exp(0.5 * exponent * np.log(squared_cosine))
        # The rounding error is large if l and v almost cancel, or if the exponent amplifies it.
        is_inaccurate = (half_square < MIN_HALF_SQUARE) | (exponent * strength > MAX_AMPLIFICATION)
        redo_index = find(is_inaccurate)
        if redo_index.size:
            light_direction = scale(take(to_light, redo_index), 1 / light_distance[redo_index])
            eye_direction = scale(take(from_eye, redo_index), -1 / eye_distance[redo_index])
            unit_vectors = take(hits.normal, hit_index[redo_index]), light_direction, eye_direction
            strength[redo_index] = _compute_accurate_highlight(*unit_vectors, exponent[redo_index])
        return strength


def _compute_accurate_highlight(
    normal: Triple, light_direction: Triple, eye_direction: Triple, exponent: Floats
) -> Floats:
    """Compute the strengths of highlights from unit vectors, without loss of accuracy.

    The strength is (n.h)^p, where n is the normal, h the unit half vector between the directions to
    the light and to the eye, and p the exponent.

    Parameters
    ----------
    normal, light_direction, eye_direction : tuples of three (n,) float arrays
        Unit normals, and unit vectors to the light and to the eye, all in the same coordinate
        system.
    exponent : (n,) float array
        Exponent p of each highlight.

    Returns
    -------
    strength : (n,) float array
        Strength at each of n points; 0 if the light and the eye are in opposite directions.
    """
    direction_sum = map_xyz(np.add, light_direction, eye_direction)
    squared_length = dot(direction_sum, direction_sum)
    # The cosine n.h is 1 - |n - h|^2 / 2.  log1p keeps the digits that n.h would lose.
    half = scale(direction_sum, 1 / np.sqrt(squared_length))
    normal_minus_half = map_xyz(np.subtract, normal, half)
    log_cosine = np.log1p(-0.5 * dot(normal_minus_half, normal_minus_half))
    # With the exponent 0, the highlight is 1 everywhere, even if the logarithm is infinite.
    strength = np.where(exponent == 0, 1.0, np.exp(exponent * log_cosine))
    # If the directions are opposite, their sum consists of rounding errors.  Both then lie in the
    # tangent plane, because neither the light nor the eye is behind it.
    return np.where(squared_length > MIN_SUM_LENGTH2, strength, 0.0)


class Shading:
    """The radiance that n hits reflect towards the eye, summed over lights.

    Parameters
    ----------
    hits : Hits
        The hits.
    with_ids : bool
        Whether to compute `visibility_ids`.

    Attributes
    ----------
    visibility_ids : (n,) int array
        For each hit, a number that encodes the object, its face, and the lights that are visible
        from the hit.  The array is empty if `with_ids` is False.
    """

    def __init__(self, hits: Hits, *, with_ids: bool) -> None:
        self._hits, self._with_ids = hits, with_ids
        self._is_glossy = hits.get_object_values(hits.scene.is_glossy)
        # Sums over lights of I n.l, and of I (n.h)^p, where I is the light's intensity; None before
        # the first light.
        self._diffuse_sum: Floats | None = None
        self._specular_sum: Floats | None = None
        self.visibility_ids: Ints = (
            4 * hits.hit_object + hits.face_axis if with_ids else hits.sample_index[:0]
        )

    def add(self, geometry: LightGeometry, is_lit: Bools) -> None:
        """Add the reflected light of a batch of lights to the sums, and update `visibility_ids`.

        Parameters
        ----------
        geometry : LightGeometry
            The lights, and the n hits.
        is_lit : (lights, n) bool array
            Whether each light is visible from each hit.
        """
        for light_index, is_hit_lit in enumerate(is_lit):
            if self._with_ids:
                # Multiplying by an odd number never shifts a light's bit out of the integer, so
                # all lights affect the id, even if there are more lights than bits.
                self.visibility_ids = self.visibility_ids * 3 + is_hit_lit
            if not is_hit_lit.any():
                continue
            cosine, intensity = np.zeros(is_hit_lit.size), geometry.lights.intensity[light_index]
            distance = np.sqrt(geometry.squared_distance[light_index])
            np.divide(geometry.n_dot_l[light_index], distance, out=cosine, where=is_hit_lit)
            self._diffuse_sum = _add_light(self._diffuse_sum, intensity, cosine)
            lit_index = find(is_hit_lit & self._is_glossy)
            if lit_index.size:
                strength = np.zeros(is_hit_lit.size)
                strength[lit_index] = geometry.compute_highlight_strength(light_index, lit_index)
                self._specular_sum = _add_light(self._specular_sum, intensity, strength)

    def compute_channels(self) -> Iterator[tuple[int, Floats, Floats]]:
        """Yield the diffuse and the specular radiance of n hits, channel by channel.

        If no hit is lit, nothing is yielded.

        Yields
        ------
        channel : int
            0 for red, 1 for green, 2 for blue.
        diffuse : (n,) float array
            Diffuse radiance of each hit, summed over the lights.
        specular : (n,) float array
            Specular radiance of each hit, summed over the lights.
        """
        if self._diffuse_sum is None:
            return
        hits, scene = self._hits, self._hits.scene
        for channel, diffuse_sum in enumerate(self._diffuse_sum):
            diffuse = hits.get_object_values(scene.diffuse[channel])
            diffuse *= diffuse_sum
            specular = np.zeros(diffuse.size)
            if self._specular_sum is not None:
                specular = hits.get_object_values(scene.specular[channel])
                specular *= self._specular_sum[channel]
            yield channel, diffuse, specular

    def compute_radiance(self, out: Floats | None = None) -> Floats:
        """Compute the radiance towards the eye at each sample.

        Parameters
        ----------
        out : (3, samples) float array of zeros, optional
            Array in which to store the result; it is returned.

        Returns
        -------
        radiance : (3, samples) float array
            Linear RGB radiance; 0 for samples without a hit.
        """
        out = np.zeros((3, self._hits.samples.size)) if out is None else out
        for channel, diffuse, specular in self.compute_channels():
            out[channel][self._hits.sample_index] = diffuse + specular
        return out


def _add_light(total: Floats | None, intensity: Floats, factor: Floats) -> Floats:
    """Add one light to a sum over lights.

    Parameters
    ----------
    total : (3, n) float array or None
        Sum over the lights before this one, for each colour channel and each of n hits.  The array
        is overwritten.  None for the first light.
    intensity : (3,) float array
        The light's RGB intensity.
    factor : (n,) float array
        Number by which to multiply the intensity at each hit: a cosine, or the strength of a
        highlight.

    Returns
    -------
    total : (3, n) float array
        The new sum.
    """
    if total is None:  # faster than creating zeros and adding to them
        return np.multiply.outer(intensity, factor)
    for channel_total, channel_intensity in zip(total, intensity.tolist(), strict=True):
        channel_total += channel_intensity * factor
    return total


def compute_light_geometry(hits: Hits, lights: Lights) -> LightGeometry:
    """Compute the dot products that shading needs for each hit and each light.

    Parameters
    ----------
    hits : Hits
        The n hits.
    lights : Lights
        A batch of lights.  Occluders are ignored.

    Returns
    -------
    geometry : LightGeometry
        The (lights, n) arrays `n_dot_l` and `squared_distance` contain n . l and l . l.  Here n is
        the unit normal at the hit, and l the vector from the hit to the light.  If the eye is
        inside the hit's object and the light is outside, `n_dot_l` is -inf.
    """
    pair_shape = len(lights.from_eye), hits.from_eye.shape[1]
    geometry = LightGeometry(hits, lights, np.empty(pair_shape), np.empty(pair_shape))
    for light_index, (x, y, z) in enumerate(lights.from_eye.tolist()):
        # An object that contains the eye blocks all lights outside it.
        is_blocker = hits.scene.is_eye_inside & (lights.side[light_index] != INSIDE)
        for group in hits.groups:
            from_eye = hits.from_eye[:, group.interval]
            to_light = x - from_eye[0], y - from_eye[1], z - from_eye[2]
            n_dot_l = group.compute_height(lights.position[light_index], to_light)
            if is_blocker[group.run_object].any():
                # Not 0, which would mean that the light is exactly on the hit's horizon.
                n_dot_l[group.repeat_runs(is_blocker[group.run_object])] = -np.inf
            geometry.n_dot_l[light_index, group.interval] = n_dot_l
            geometry.squared_distance[light_index, group.interval] = dot(to_light, to_light)
    return geometry


def find_narrow_highlights(
    geometry: LightGeometry, faces_light: Bools, footprint_radius: Floats
) -> Iterator[Ints]:
    """Yield, light by light, indices of hits near which one sample may miss a narrow highlight.

    The footprint of a hit is the part of the surface around it that is visible in one cell of the
    picture (a pixel or a part of it).

    Parameters
    ----------
    geometry : LightGeometry
        The n hits and the lights.
    faces_light : (lights, n) bool array
        Whether the surface at the hit faces the light.  Occluders are ignored, because the light
        may be visible from other points of the footprint.
    footprint_radius : (n,) float array
        Radius of each footprint, in the scene's unit of length.

    Yields
    ------
    hit_index : (k,) int array
        For one light, indices of the hits whose footprint may contain a narrow highlight.
    """
    hits, scene = geometry.hits, geometry.hits.scene
    is_glossy = hits.get_object_values(scene.is_glossy)
    if not is_glossy.any():
        return
    # A highlight's strength is about exp(-x^2) with x = a sqrt(p / 2), where p is the exponent, and
    # a the angle between the normal and the half vector.  Across the footprint, a changes because
    # the normal and the directions to the eye and to the light turn.
    turn_rate = 1 / hits.distance + hits.get_object_values(scene.curvature)
    x_per_angle = np.where(is_glossy, np.sqrt(hits.get_object_values(scene.exponent) / 2), 0)
    for light_index, hit_faces_light in enumerate(faces_light):
        max_turn_rate = turn_rate + 1 / np.sqrt(geometry.squared_distance[light_index])
        max_step = footprint_radius * max_turn_rate * x_per_angle  # maximum change of x
        hit_index = find((max_step > _MAX_LOBE_STEP) & hit_faces_light)
        if hit_index.size:
            strength = geometry.compute_highlight_strength(light_index, hit_index)
            x = np.minimum(np.sqrt(-np.log(strength)), _LOBE_UNDERFLOW)
            yield hit_index[x - max_step[hit_index] < _LOBE_CUTOFF]
