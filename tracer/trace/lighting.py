"""Shading: the light that arrives at hits, and the radiance that the hits reflect to the eye.

The model is that of Blinn (Models of light reflection for computer synthesized pictures, 1977), as
in Shirley, Fundamentals of Computer Graphics, 2nd ed., 9.1 and 9.2.  Each light that is visible
from the hit adds I (kd max(0, n.l) + ks (n.h)^p) to the radiance, with

- the intensity I of the light;
- the diffuse colour kd, the specular colour ks and the exponent p of the surface;
- the unit normal n, the direction l to the light, and the unit half vector h, which is halfway
  between the directions to the light and to the eye.

Light does not fall off with distance, and the highlight has no further cosine.  The number (n.h)^p,
from 0 to 1, is the *strength* of a highlight.  All radiance is linear RGB.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated as Shaped
from typing import NamedTuple

import numpy as np

from tracer.arrays import Bools, Floats, Ints, Triple, dot, find, map_xyz, scale, take
from tracer.geometry.rounding import INSIDE, MAX_AMPLIFICATION, MIN_HALF_SQUARE, MIN_SQUARED_SUM
from tracer.geometry.shape import NO_AXIS
from tracer.trace.hits import Hits
from tracer.world.prepared_scene import Lights

# A highlight has the shape of the bell exp(-x^2).

# Maximum change of x over a part of a surface that one sample can represent.  Tuned on the
# project's scenes: with half or twice as much, errors of single pictures are up to 1.1 times as
# large.
_MAX_LOBE_STEP = 0.7

# The x beyond which the bell is negligible.  Tuned on the project's scenes: with 2, errors of
# single pictures are up to 1.1 times as large.
_LOBE_CUTOFF = 3.0

# The x at which the bell underflows.
_LOBE_UNDERFLOW = 27.0

# Number of different values of `Hits.face_axis`, which is a part of `Shading.visibility_ids`.
_FACE_AXES = NO_AXIS + 1


class ChannelRadiance(NamedTuple):
    """The radiance of hits in one colour channel, summed over the lights."""

    channel: int  # 0 for red, 1 for green, 2 for blue
    diffuse: Shaped[Floats, "n"]
    specular: Shaped[Floats, "n"]


class LightGeometry(NamedTuple):
    """Dot products of normals and vectors to lights, for n hits and a batch of lights.

    Here l is the whole vector from the hit to the light, and n is the unit normal.  Whether an
    object blocks the light is ignored.
    """

    hits: Hits
    lights: Lights
    # n . l; -inf if the eye is inside the hit's object and the light is outside, because no light
    # enters the object.
    n_dot_l: Shaped[Floats, "lights n"]
    squared_distance: Shaped[Floats, "lights n"]  # l . l

    def compute_highlight_strength(
        self, light_index: int, hit_index: Shaped[Ints, "k"]
    ) -> Shaped[Floats, "k"]:
        """Compute the strength, (n.h)^p, of the highlight of one light at selected hits.

        The surface must face the light at these hits.
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
        cosine_sum = light_cosine + eye_cosine
        squared_cosine = cosine_sum * cosine_sum / (2 * half_square)
        exponent = hits.get_object_values(hits.scene.exponent)[hit_index]
        strength: Floats = np.exp(0.5 * exponent * np.log(squared_cosine))
        # The rounding error is large if l and v almost cancel, or if the exponent amplifies it.
        is_inaccurate = (half_square < MIN_HALF_SQUARE) | (exponent * strength > MAX_AMPLIFICATION)
        redo_index = find(is_inaccurate)
        if redo_index.size:
            light_direction = scale(take(to_light, redo_index), 1 / light_distance[redo_index])
            eye_direction = scale(take(from_eye, redo_index), -1 / eye_distance[redo_index])
            normal = take(hits.normal, hit_index[redo_index])
            strength[redo_index] = _compute_accurate_highlight(
                normal, light_direction, eye_direction, exponent[redo_index]
            )
        return strength


def compute_light_geometry(hits: Hits, lights: Lights) -> LightGeometry:
    """Compute the dot products of each pair of a light and a hit."""
    pair_shape = len(lights.from_eye), hits.from_eye.shape[1]
    geometry = LightGeometry(
        hits=hits,
        lights=lights,
        n_dot_l=np.empty(pair_shape),
        squared_distance=np.empty(pair_shape),
    )
    for light_index, (x, y, z) in enumerate(lights.from_eye.tolist()):
        # An object that contains the eye blocks all lights outside it.
        is_blocker = hits.scene.is_eye_inside & (lights.side[light_index] != INSIDE)
        for group in hits.groups:
            from_eye = hits.from_eye[:, group.interval]
            to_light = x - from_eye[0], y - from_eye[1], z - from_eye[2]
            n_dot_l = group.compute_height(lights.position[light_index], to_light)
            if is_blocker[group.run_object].any():
                # The number is not 0, because this would mean that the light is exactly on the
                # horizon of the hit.
                n_dot_l[group.repeat_runs(is_blocker[group.run_object])] = -np.inf
            geometry.n_dot_l[light_index, group.interval] = n_dot_l
            geometry.squared_distance[light_index, group.interval] = dot(to_light, to_light)
    return geometry


def _compute_accurate_highlight(
    normal: Shaped[Triple, "n"],
    light_direction: Shaped[Triple, "n"],
    eye_direction: Shaped[Triple, "n"],
    exponent: Shaped[Floats, "n"],
) -> Shaped[Floats, "n"]:
    """Compute the strength, (n.h)^p, of the highlight at each hit, without cancellation of digits.

    All vectors are unit vectors from the hit.  The strength is 0 if the light and the eye are in
    opposite directions.
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
    return np.where(squared_length > MIN_SQUARED_SUM, strength, 0.0)


class Shading:
    """The radiance that n hits reflect towards the eye, summed over lights that are added."""

    # For each hit, an integer that encodes the object, the axis of its face, and the lights that
    # are visible from the hit.  The array is empty unless `with_ids` is true.
    visibility_ids: Shaped[Ints, "ids"]

    def __init__(self, hits: Hits, *, with_ids: bool) -> None:
        self._hits = hits
        self._with_ids = with_ids
        self._is_glossy = hits.get_object_values(hits.scene.is_glossy)
        # Sums over lights of I n.l, and of I (n.h)^p, where I is the light's intensity; None before
        # the first light.
        self._diffuse_sum: Floats | None = None
        self._specular_sum: Floats | None = None
        self.visibility_ids = np.zeros(0, dtype=np.intp)
        if with_ids:
            self.visibility_ids = _FACE_AXES * hits.hit_object + hits.face_axis

    def add(self, geometry: LightGeometry, is_lit: Shaped[Bools, "lights n"]) -> None:
        """Add the light of a batch of lights; `is_lit` tells which of them each hit reflects."""
        for light_index, is_hit_lit in enumerate(is_lit):
            if self._with_ids:
                # Multiplying by an odd number never shifts a light's bit out of the integer, so
                # all lights affect the id, even if there are more lights than bits.
                self.visibility_ids = self.visibility_ids * 3 + is_hit_lit
            if not is_hit_lit.any():
                continue
            intensity = geometry.lights.intensity[light_index]
            distance = np.sqrt(geometry.squared_distance[light_index])
            cosine = np.zeros(is_hit_lit.size)
            np.divide(geometry.n_dot_l[light_index], distance, out=cosine, where=is_hit_lit)
            self._diffuse_sum = _add_light(self._diffuse_sum, intensity, cosine)
            lit_index = find(is_hit_lit & self._is_glossy)
            if lit_index.size:
                strength = np.zeros(is_hit_lit.size)
                strength[lit_index] = geometry.compute_highlight_strength(light_index, lit_index)
                self._specular_sum = _add_light(self._specular_sum, intensity, strength)

    def compute_channels(self) -> Iterator[ChannelRadiance]:
        """Yield the radiance of all hits, channel by channel; nothing if no hit is lit."""
        if self._diffuse_sum is None:
            return
        hits = self._hits
        scene = hits.scene
        for channel, diffuse_sum in enumerate(self._diffuse_sum):
            diffuse = hits.get_object_values(scene.diffuse[channel])
            diffuse *= diffuse_sum
            if self._specular_sum is None:
                specular = np.zeros(diffuse.size)
            else:
                specular = hits.get_object_values(scene.specular[channel])
                specular *= self._specular_sum[channel]
            yield ChannelRadiance(channel=channel, diffuse=diffuse, specular=specular)

    def compute_radiance(
        self, out: Shaped[Floats, "3 samples"] | None = None
    ) -> Shaped[Floats, "3 samples"]:
        """Compute the radiance towards the eye at each sample; 0 for samples without a hit.

        If `out` is given, it must contain zeros; it is filled and returned.
        """
        out = np.zeros((3, self._hits.samples.size)) if out is None else out
        for channel, diffuse, specular in self.compute_channels():
            out[channel][self._hits.sample_index] = diffuse + specular
        return out


def _add_light(
    total: Shaped[Floats, "3 n"] | None,
    intensity: Shaped[Floats, "3"],
    factor: Shaped[Floats, "n"],
) -> Shaped[Floats, "3 n"]:
    """Add the intensity of one light, times a factor for each hit, to a sum over lights.

    `total` is None before the first light; otherwise it is changed in place, and returned.
    """
    if total is None:  # faster than creating zeros and adding to them
        return np.multiply.outer(intensity, factor)
    for channel_total, channel_intensity in zip(total, intensity.tolist(), strict=True):
        channel_total += channel_intensity * factor
    return total


def find_narrow_highlights(
    geometry: LightGeometry,
    faces_light: Shaped[Bools, "lights n"],
    footprint_radius: Shaped[Floats, "n"],
) -> Iterator[Shaped[Ints, "k"]]:
    """Find hits near which a highlight is so narrow that one sample may miss it.

    Yields arrays of indices of hits, each for one light.  Hits are skipped if the surface does not
    face the light, but not if they are in shadow, because the light may be visible nearby.

    Parameters
    ----------
    footprint_radius
        Radius of the part of the surface, around each hit, that is visible in a cell of the picture
        (a pixel or a square part of it); in the scene's unit of length.
    """
    hits = geometry.hits
    scene = hits.scene
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
