"""Bounds on rounding, and the sides of a surface.

Numbers are float64 with machine epsilon e = 2.2e-16: each operation errs by at most e / 2 of its
result.  Bounds that only widen a search are generous, as an exact test follows; those that
decide what is on a surface are as small as the roundings before them allow.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tracer.arrays import Floats, Triple, dot, map3

_EPSILON = float(np.finfo(np.float64).eps)

OUTSIDE, ON, INSIDE = 1, 0, -1

SURFACE_TOLERANCE = 64 * _EPSILON
"""A point this near to a surface, relative to the lengths it was computed from, is on the surface:
some twenty roundings, each of at most 2 e, lie between the scene and a hit point."""

LIGHT_TOLERANCE = 8 * _EPSILON
"""The same of a light, which is given, relative to the surface's size: its height over the surface
takes a few roundings, and the scene's numbers may have been rounded themselves."""

UNIT_ROUNDING = 2 * _EPSILON
"""Two roundings of a length of 1: an eye so near to a sphere, in radii, is on it."""

SQUARE_ROUNDING = 1e-13
"""A squared distance from a line is the difference of two squares.  This part of the larger is
more than its rounding (16 e), and than what counts as on a sphere may be off it, 2 * 64 e."""

PLANE_ROUNDING = 1e-12
"""A ray's direction, and the planes that bound boxes, err by less than this part of their size."""

NEARLY_ZERO_POWER = 1e-14
"""|c|^2 - r^2, relative to |c|^2: less is little but rounding, and tangents hold its root, the
relative error of which is larger still."""

NEARLY_PARALLEL = 1e-30
"""Replaces a zero component of a direction, relative to the lengths around it, where a segment
parallel to two planes may count as one that meets them far away: no quotient is 0 / 0."""


def side_of(height: Floats, tolerance: Floats) -> NDArray[np.int8]:
    """`OUTSIDE`, `ON` or `INSIDE`, of points so high over a surface."""
    return (height > tolerance).view(np.int8) - (height < -tolerance).view(np.int8)


def hit_tolerance(size: Floats, hit: Triple, eye: Floats) -> Floats:
    """Distances from surfaces within which hits of rays count as on them.

    Rays err in proportion to their length.  `size`: of the surfaces' coordinates, and so of points
    near them.
    """
    ray = map3(np.subtract, hit, (eye[0], eye[1], eye[2]))
    return SURFACE_TOLERANCE * (np.sqrt(dot(ray, ray)) + size)
