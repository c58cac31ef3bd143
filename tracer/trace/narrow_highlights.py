"""Highlights so narrow that one sample in a cell of the picture may miss them.

The strength of a highlight is cos(a)^p, where a is the angle between the normal and the half
vector, and p the exponent of the surface (see `light_geometry`).  Because log(cos a) is about
-a^2 / 2, the strength is about exp(-q^2) with q = a sqrt(p / 2).  So it has the shape of a bell,
and q is the position on this bell: 0 at its center, whatever the exponent.  A sample may miss the
bell if q changes by much across the part of the surface that is visible in the cell.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated as Shaped

import numpy as np

from tracer.arrays import Bools, Floats, Ints, find
from tracer.trace.light_geometry import LightGeometry

# Maximum change of q over a part of a surface that one sample can represent.  Tuned on the
# project's scenes: with half or twice as much, errors of single pictures are up to 1.1 times as
# large.
_MAX_STEP = 0.7

# The q beyond which the highlight is negligible.  Tuned on the project's scenes: with 2, errors of
# single pictures are up to 1.1 times as large.
_CUTOFF = 3.0

# The q at which the strength underflows to 0.
_UNDERFLOW = 27.0


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
    q_per_angle = np.where(is_glossy, np.sqrt(hits.get_object_values(scene.exponent) / 2), 0)
    # Over a length r on the surface, the normal turns by at most r * curvature, and the direction
    # to a point by about r / (distance of the point).  The angle a is assumed to change by at most
    # the sum of the turns of the normal and of the directions to the eye and to the light.
    turn_without_light = 1 / hits.distance + hits.get_object_values(scene.curvature)
    for light_index, hit_faces_light in enumerate(faces_light):
        turn_per_length = turn_without_light + 1 / np.sqrt(geometry.squared_distance[light_index])
        max_step = footprint_radius * turn_per_length * q_per_angle  # maximum change of q
        hit_index = find((max_step > _MAX_STEP) & hit_faces_light)
        if hit_index.size:
            strength = geometry.compute_highlight_strength(light_index, hit_index)
            q = np.minimum(np.sqrt(-np.log(strength)), _UNDERFLOW)
            yield hit_index[q - max_step[hit_index] < _CUTOFF]
