"""How hits see lights: the dot products of Blinn's model, and the strength of highlights.

In the model (Blinn, Models of light reflection for computer synthesized pictures, 1977, as in
Shirley, Fundamentals of Computer Graphics, 2nd ed., 9.1 and 9.2), each light that is visible from a
hit adds I (kd max(0, n.l) + ks (n.h)^p) to the radiance, with

- the intensity I of the light;
- the diffuse colour kd, the specular colour ks and the exponent p of the surface;
- the unit normal n, the direction l to the light, and the unit half vector h, which is halfway
  between the directions to the light and to the eye.

Light does not fall off with distance, and the highlight is not multiplied by n.l.  The number
(n.h)^p, from 0 to 1, is the *strength* of a highlight.
"""

from __future__ import annotations

from typing import Annotated as Shaped
from typing import NamedTuple

import numpy as np

from tracer.arrays import Floats, Ints, Triple, dot, find, map_xyz, scale, take
from tracer.geometry.rounding import INSIDE, MAX_AMPLIFICATION, MIN_HALF_SQUARE, MIN_SQUARED_SUM
from tracer.trace.hits import Hits
from tracer.world.prepared_scene import Lights


class LightGeometry(NamedTuple):
    """Dot products of normals and vectors to lights, for n hits and a batch of lights.

    Here l is the whole vector from the hit to the light, and n is the unit normal.  Objects that
    may block the light are ignored, except that no light enters an object that contains the eye.
    """

    hits: Hits
    lights: Lights
    # n . l; -inf if the eye is inside the hit's object and the light is outside.
    n_dot_l: Shaped[Floats, "lights n"]
    squared_distance: Shaped[Floats, "lights n"]  # l . l

    def compute_highlight_strength(
        self, light_index: int, hit_index: Shaped[Ints, "k"]
    ) -> Shaped[Floats, "k"]:
        """Compute the strength, (n.h)^p, of the highlight of one light at selected hits.

        The surface must face the light at these hits.  See the start of the module for the symbols.
        """
        hits = self.hits
        from_eye = take(hits.from_eye, hit_index)
        x, y, z = self.lights.from_eye[light_index].tolist()  # position of the light
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
    """Compute the dot products of each pair of a light and a hit (see `LightGeometry`)."""
    pair_shape = len(lights.from_eye), hits.from_eye.shape[1]
    geometry = LightGeometry(
        hits=hits,
        lights=lights,
        n_dot_l=np.empty(pair_shape),
        squared_distance=np.empty(pair_shape),
    )
    for light_index, (x, y, z) in enumerate(lights.from_eye.tolist()):
        # An object that contains the eye lets in no light from outside.
        is_dark_inside = hits.scene.is_eye_inside & (lights.side[light_index] != INSIDE)
        for group in hits.groups:
            from_eye = hits.from_eye[:, group.interval]
            to_light = x - from_eye[0], y - from_eye[1], z - from_eye[2]
            n_dot_l = group.compute_height(lights.position[light_index], to_light)
            is_run_dark = is_dark_inside[group.run_object]
            if is_run_dark.any():
                # The number is not 0, because this would mean that the light is exactly on the
                # horizon of the hit.
                n_dot_l[group.repeat_runs(is_run_dark)] = -np.inf
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

    All vectors are unit vectors from the hit, and h is the unit vector in the direction of the sum
    of `light_direction` and `eye_direction`.  The strength is 0 if these two are opposite.
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
