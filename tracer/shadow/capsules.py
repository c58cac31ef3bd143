"""Capsules, all that is within a thickness of a segment, against spheres and boxes.

A capsule from the centre of a ball to a light holds all segments from the ball to the light.  An
object that misses it, or holds all of it inside, shades nothing of the ball; one that cuts right
through shades all of it: a bundle of rays is tested at once, as by shafts (Haines and Wallace,
Shaft culling, 1991).  Answers are on the safe side of rounding.
"""

from __future__ import annotations

import numpy as np

from tracer.arrays import Bools, Floats, Triple, dot, each

__all__ = ["box_and_capsule", "sphere_and_capsule"]

# A squared distance from a line is the difference of two.  This part of the larger is more than
# rounding, and more than what counts as on a sphere may be off it: see `SURFACE_TOLERANCE`.
_CANCELLED = 1e-13

# What replaces a zero component of a direction, relative to the lengths around it.
_NEARLY = 1e-30


def sphere_and_capsule(
    start: Triple, end: Triple, thickness: Floats, center: Triple, radius: Floats
) -> tuple[Bools, Bools]:
    """Whether spheres meet, and whether they cut, the capsules around segments.

    A sphere that does not meet a capsule blocks no segment between the balls
    around its ends; one that holds all of it inside does not count as meeting it.
    One that cuts it blocks all of them: somewhere it holds the capsule's full
    cross-section, and the ball around its start is outside it.
    """
    d = each(np.subtract, end, start)
    to_center = each(np.subtract, center, start)
    along, length2, distance2 = dot(to_center, d), dot(d, d), dot(to_center, to_center)
    to_end2 = distance2 - 2 * along + length2
    # Squared distance from the centre to the line, and how far squares may be off.
    aside2, error = distance2 - along * along / length2, _CANCELLED * distance2
    outer, inner = (radius + thickness) ** 2 + error, np.maximum(radius - thickness, 0) ** 2 - error
    from_start, from_end = distance2 > outer, to_end2 > outer
    before, behind = along < 0, along > length2
    around = np.maximum(distance2, to_end2) < inner
    # Where the segment is a point, `aside2` is NaN: the sphere does not cut it.
    meets = ~((aside2 > outer) | (from_start & before) | (from_end & behind) | around)
    cuts = from_start & ~(before | behind) & (aside2 < inner)
    return meets, cuts


def box_and_capsule(
    start: Triple, end: Triple, thickness: Floats, low: Triple, high: Triple
) -> tuple[Bools, Bools]:
    """`sphere_and_capsule`, for boxes."""
    # Parts of the segment in a box grown by the thickness on all sides, and in one shrunk by it.
    enter, leave = np.array(-np.inf), np.array(np.inf)
    enter_inner, leave_inner = enter, leave
    for k in range(3):
        d = end[k] - start[k]
        below, above = low[k] - start[k], high[k] - start[k]
        if np.count_nonzero(d) < d.size:
            # Nearly parallel in place of parallel: no quotient is 0 / 0.
            size = np.abs(below) + np.abs(above) + thickness
            d = d + (d == 0) * (_NEARLY * size)
        inverse = 1 / d
        margin = thickness * np.abs(inverse)
        below *= inverse
        above *= inverse
        near, far = np.minimum(below, above), np.maximum(below, above)
        enter_inner = np.maximum(enter_inner, near + margin)
        leave_inner = np.minimum(leave_inner, far - margin)
        near -= margin
        far += margin
        enter, leave = np.maximum(enter, near), np.minimum(leave, far)
    around = (enter_inner < 0) & (leave_inner > 1)
    meets = (enter <= leave) & (leave >= 0) & (enter <= 1) & ~around
    cuts: Bools = (enter_inner < leave_inner) & (enter > 0) & (leave < 1)
    return meets, cuts
