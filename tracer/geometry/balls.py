"""Whether spheres block segments: those of a capsule, or one that begins or ends at a sphere.

A sphere blocks a segment if the segment enters or leaves the sphere between its ends.  A *capsule*
is the set of all points that are at most its radius away from a segment, its axis.  All positions
are in scene axes.
"""

from __future__ import annotations

from typing import Annotated as Shaped

import numpy as np

from tracer.arrays import Bools, Floats, Sides, Triple, dot, map_xyz
from tracer.geometry.rounding import ON, OUTSIDE, SQUARE_ROUNDING


def test_capsules_on_balls(
    center: Shaped[Triple, "n"],
    radius: Shaped[Floats, "n"],
    axis_start: Shaped[Triple, "n"],
    axis_end: Shaped[Triple, "n"],
    capsule_radius: Shaped[Floats, "n"],
) -> tuple[Shaped[Bools, "n"], Shaped[Bools, "n"]]:
    """Test whether the surface of each sphere crosses some, or all, segments in a capsule.

    All segments lie in the capsule around the axis from `axis_start` to `axis_end` (see
    `Shape.test_capsules`).
    """
    axis = map_xyz(np.subtract, axis_end, axis_start)
    to_center = map_xyz(np.subtract, center, axis_start)
    projection = dot(to_center, axis)
    squared_length = dot(axis, axis)
    squared_start_distance = dot(to_center, to_center)
    squared_end_distance = squared_start_distance - 2 * projection + squared_length
    # Distance of the center from the line that contains the axis.
    squared_line_distance = squared_start_distance - projection * projection / squared_length
    # If the axis misses the grown sphere, all segments miss the sphere.  Where the axis is inside
    # the shrunk sphere, all segments are inside the sphere.  The bound on the rounding errors of
    # squared distances makes both sure.
    square_error = SQUARE_ROUNDING * squared_start_distance
    squared_grown_radius = (radius + capsule_radius) ** 2 + square_error
    squared_shrunk_radius = np.maximum(radius - capsule_radius, 0) ** 2 - square_error
    starts_outside = squared_start_distance > squared_grown_radius
    ends_outside = squared_end_distance > squared_grown_radius
    # Whether the center projects to a point before the start of the axis, or past its end.
    is_before_start = projection < 0
    is_past_end = projection > squared_length
    # If the axis is a single point, `squared_line_distance` is NaN, so both of these are False.
    misses_line = squared_line_distance > squared_grown_radius
    cuts_line = squared_line_distance < squared_shrunk_radius
    misses = misses_line | (starts_outside & is_before_start) | (ends_outside & is_past_end)
    max_squared_distance = np.maximum(squared_start_distance, squared_end_distance)
    is_capsule_inside = max_squared_distance < squared_shrunk_radius
    # All segments start outside the sphere, and are inside it where they pass its center.
    crosses_all = starts_outside & ~(is_before_start | is_past_end) & cuts_line
    return ~(misses | is_capsule_inside), crosses_all


def decide_by_sides(
    hit_side: Shaped[Sides, "n"],
    light_side: Shaped[Sides, "n"],
    projection: Shaped[Floats, "n"],
    squared_length: Shaped[Floats, "n"],
    is_eye_inside: Shaped[Bools, "n"],
) -> Shaped[Bools, "n"]:
    """Decide whether spheres block segments of which an end is inside or on the sphere.

    Each segment leads from a hit to a light.

    Parameters
    ----------
    hit_side, light_side
        On which side of the sphere the ends of the segment are: `OUTSIDE`, `ON` or `INSIDE`.
    projection
        Dot product of the vectors from the hit to the center of the sphere and to the light.
    squared_length
        Dot product of the vector from the hit to the light with itself.
    """
    # A hit on the surface lies on the eye's side.  From inside, the segment must not leave the
    # sphere; from outside, it must not enter the sphere.
    leaves_sphere = (projection < 0) | (light_side == OUTSIDE)
    blocks_from_surface = np.where(is_eye_inside, leaves_sphere, projection > 0)
    # A segment to a light on the surface is blocked if it arrives from inside.
    arrives_from_inside = projection < squared_length
    blocks_to_surface = (hit_side == OUTSIDE) & arrives_from_inside
    return np.select(
        [hit_side == ON, light_side == ON],
        [blocks_from_surface, blocks_to_surface],
        default=hit_side != light_side,
    )
