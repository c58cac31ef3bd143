"""Bounds on rounding errors, and the test on which side of a surface a point lies.

Numbers are float64 with machine epsilon e = 2.2e-16, so the relative error of each operation is at
most e / 2.  There are three kinds of bounds, and all of them are here:

1. Bounds that decide whether a point is on a surface (`..._TOLERANCE`) are as small as the rounding
   errors of the point allow, because a larger bound would treat distinct surfaces as one.
2. Bounds that only enlarge a search (`..._ROUNDING`) are generous, because an exact test follows
   the search.  The comment of each names the rounding error that it exceeds.
3. Bounds below which a number consists of rounding errors (`MIN_...`), so that another formula is
   needed.
"""

from __future__ import annotations

from typing import Annotated as Shaped

import numpy as np

from tracer.arrays import Floats, Sides, Triple, dot, map_xyz

_EPSILON = float(np.finfo(np.float64).eps)

# Sides of a surface: the sign of the height of a point above the surface.
OUTSIDE = 1
ON = 0
INSIDE = -1

# A hit counts as on a surface if its distance from the surface is at most this fraction of the
# lengths from which the hit was computed.  About twenty operations, each with an error of at most 2
# e, lead from the scene to a hit.
SURFACE_TOLERANCE = 64 * _EPSILON

# A light counts as on a surface if its distance from the surface is at most this fraction of the
# surface's coordinates.  The position of a light is given, so only a few operations lead to its
# height above a surface; but the numbers in the scene file may have been rounded themselves.
LIGHT_TOLERANCE = 8 * _EPSILON

# The eye counts as on a sphere if its distance from the surface is at most this fraction of the
# radius: two rounding errors of a length of 1.
UNIT_TOLERANCE = 2 * _EPSILON

# Bound on the error of the squared distance of a point from a line, relative to the larger of the
# two squares whose difference it is.  It exceeds the rounding error, 16 e, and the tolerance of
# spheres, 2 * 64 e, together: 144 e = 3.2e-14.
SQUARE_ROUNDING = 1e-13

# Bound on the errors of ray directions, and of planes that bound boxes, relative to their size.
# Fewer than 100 operations lead to them, so their errors are at most 50 e = 1.1e-14.
PLANE_ROUNDING = 1e-12

# Bound on the errors of directions from a light, and of points that are snapped to planes, relative
# to the distance from the light.  It exceeds 64 e = 1.4e-14, and is small enough for distant lights
# such as the sun, from which the whole scene may have an angular size of 1e-9 radians.
DIRECTION_ROUNDING = 1e-13

# Bounds on positions are widened by this fraction of the coordinates from which they are computed:
# 10,000 times as much as all rounding errors together, 450 e = 1e-13.
POSITION_ROUNDING = 1e-9

# If the power |c|^2 - r^2 of the eye with respect to a sphere is less than this fraction of |c|^2,
# then it consists mostly of rounding errors, which are 4 e = 9e-16.  Here c is the vector from the
# eye to the sphere's center, and r is the radius.  The directions of tangents depend on the square
# root of the power, whose error may be as large as sqrt(4 e) |c| = 3e-8 |c|.
MIN_POWER = 1e-14

# Let l and v be unit vectors to a light and to the eye.  If 1 + l.v is less than this, cancellation
# has increased its relative rounding error, 2 e, to more than 2,000 e = 4.4e-13.
MIN_HALF_SQUARE = 1e-3

# If |l + v|^2 is less than this, with the same unit vectors, then rounding errors dominate it.  In
# the components of l + v they are at most 2 e, so |l + v|^2 = 1e-24 is known to two in 1,000.
MIN_SQUARED_SUM = 1e-24

# Maximum factor by which a power may amplify the rounding error of its base, which is 4 e in a
# highlight: the power is then known to 1,024 e = 2.3e-13.
MAX_AMPLIFICATION = 256.0

# Replaces a zero component of a direction, relative to the lengths around it, to avoid 0 / 0.  It
# is used only in tests that may treat a segment parallel to two planes as one that meets the planes
# far away.
MIN_COMPONENT = 1e-30

# Added to divisors of at least 0 to avoid 0 / 0.  It is negligible compared with any length in a
# scene, because the least is 1e-75.
MIN_DIVISOR = 1e-300


def determine_side(
    distance: Shaped[Floats, "... n"], tolerance: Shaped[Floats, "n"]
) -> Shaped[Sides, "... n"]:
    """Determine whether points are `OUTSIDE`, `ON` or `INSIDE` surfaces.

    The distances from the surfaces are negative inside.  Points count as on the surface if they are
    at most `tolerance` away from it.
    """
    return (distance > tolerance).view(np.int8) - (distance < -tolerance).view(np.int8)


def compute_hit_tolerance(
    coordinate_bound: Shaped[Floats, "n"], hit: Shaped[Triple, "n"], eye: Shaped[Floats, "3"]
) -> Shaped[Floats, "n"]:
    """Compute how far each hit may be from a surface and still count as on it.

    The rounding error of a hit grows with its distance from the eye, and with the coordinates of
    the surface.  `coordinate_bound` is an upper bound on |x| + |y| + |z| of the points of each
    surface.  Positions are in scene axes.
    """
    eye_to_hit = map_xyz(np.subtract, hit, (eye[0], eye[1], eye[2]))
    return SURFACE_TOLERANCE * (np.sqrt(dot(eye_to_hit, eye_to_hit)) + coordinate_bound)
