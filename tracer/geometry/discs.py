"""Discs in planes through the eye: what the rays of such a plane see of spheres.

The rays of a row of the picture lie in a plane, which cuts a disc from each sphere that it meets.
A point in the plane has a rightward and a forward coordinate, relative to the eye.
"""

from __future__ import annotations

from typing import Annotated as Shaped
from typing import NamedTuple

import numpy as np

from tracer.arrays import Floats, Triple
from tracer.geometry.camera import CameraFrame
from tracer.geometry.rounding import MIN_POWER


class Discs(NamedTuple):
    """The discs that planes through the eye cut from spheres."""

    center_right: Shaped[Floats, "n"]
    center_ahead: Shaped[Floats, "n"]
    squared_radius: Shaped[Floats, "n"]  # negative if the plane misses the sphere
    ray_ahead: Shaped[Floats, "n"]  # forward component of the directions of all rays in the plane


def cut_discs(
    frame: CameraFrame,
    center: Shaped[Triple, "n"],
    radius: Shaped[Floats, "n"],
    ray_y: Shaped[Floats, "n"],
) -> Discs:
    """Compute the disc that the plane of all rays with the given `ray_y` cuts from each sphere.

    The centers are vectors from the eye, in camera axes.
    """
    right, down, ahead = center
    depth = frame.depth
    # In camera axes, the plane contains the directions (1, 0, 0) and (0, ray_y, depth).
    ray_ahead = np.sqrt(ray_y * ray_y + depth * depth)
    plane_distance = (down * depth - ahead * ray_y) / ray_ahead
    return Discs(
        center_right=right,
        center_ahead=(down * ray_y + ahead * depth) / ray_ahead,
        squared_radius=(radius - plane_distance) * (radius + plane_distance),
        ray_ahead=ray_ahead,
    )


def find_slope_range(
    center_right: Shaped[Floats, "n"],
    center_ahead: Shaped[Floats, "n"],
    squared_radius: Shaped[Floats, "n"],
    power: Shaped[Floats, "n"],
) -> tuple[Shaped[Floats, "n"], Shaped[Floats, "n"]]:
    """Compute the smallest and the largest slope of rays that point ahead and meet each disc.

    The slope is right / ahead.  It is infinite if the ray points straight to the right or to the
    left.  It is NaN if `squared_radius` is negative or NaN, which means that there is no disc.
    `power` is the squared distance of the disc's center from the eye, minus `squared_radius`.
    """
    # The rays with these slopes are the tangents from the eye.  Both make the same angle with the
    # direction of the center: set to infinity if the eye is inside the disc, and to pi / 2 if the
    # eye is almost on its edge.
    squared_distance = center_right * center_right + center_ahead * center_ahead
    min_power = np.maximum(power - MIN_POWER * squared_distance, 0)
    half_angle = np.arctan2(np.sqrt(squared_radius), np.sqrt(min_power))
    center_angle = np.arctan2(center_right, center_ahead)
    half_angle[power < 0] = np.inf
    angle = np.array([center_angle - half_angle, center_angle + half_angle])
    angle = angle.clip(-np.pi / 2, np.pi / 2)
    # `np.tan` returns only 1.6e16 for pi / 2, but the slopes of rays may be larger.
    slope = np.where(abs(angle) >= np.pi / 2, np.copysign(np.inf, angle), np.tan(angle))
    return slope[0], slope[1]
