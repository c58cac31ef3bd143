"""Where rays meet spheres and boxes, and which segments they block.

Every function works on arrays of (ray, object) pairs, element by element, and
decides each pair alone: what else is in the scene, and in which order or
batches the pairs come, changes no bit of an answer.

Infinities and NaN arise on the way and are meant: the caller turns off
floating-point warnings.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tracer.arrays import Bools, Floats, Triple, dot, each, indices, pick

__all__ = [
    "INSIDE",
    "ON",
    "OUTSIDE",
    "SURFACE_TOLERANCE",
    "Disc",
    "box_blocks",
    "box_hit",
    "disc_in_row",
    "power_of",
    "sphere_blocks",
    "sphere_crosses",
    "sphere_hit",
    "sphere_side",
]

OUTSIDE, ON, INSIDE = 1, 0, -1

# Two roundings of a length of 1.
_TOUCHING = 2 * float(np.finfo(np.float64).eps)

SURFACE_TOLERANCE = 64 * float(np.finfo(np.float64).eps)
"""A point this near to a surface, relative to the lengths it was computed from,
is on the surface: some twenty roundings lie between the scene and a hit point."""


class Disc(NamedTuple):
    """A sphere's section by the plane of a pixel row's rays, as numbers or arrays.

    Attributes
    ----------
    hypot2
        Square of the rays' second component in that plane; the first, s, is along the row.
    u, w
        The centre: along the row, and ahead.
    u_hypot, w_hypot
        These times the rays' second component.
    chord2
        The disc's squared radius; negative where the plane misses the sphere.
    power
        |centre - eye|^2 - radius^2 of the sphere: see `power_of`.
    """

    hypot2: Floats
    u: Floats
    w: Floats
    u_hypot: Floats
    w_hypot: Floats
    chord2: Floats
    power: Floats


def power_of(distance: Floats, radius: Floats) -> Floats:
    """The eye's power with respect to spheres: positive outside, 0 on them.

    `distance`, `radius` (n,): from the eye to their centres, and theirs.
    """
    height = distance - radius
    # Rounding alone does not lift the eye off a sphere that it is on.
    on = np.abs(height) <= _TOUCHING * radius
    power: Floats = np.where(on, 0, height * (distance + radius))
    return power


def disc_in_row(g: Floats, depth: float, center: Triple, radius: Floats, power: Floats) -> Disc:
    """Discs in the planes of rays (s, g, depth), for all s.

    `center`, `radius` and `power` are those of spheres seen from the eye.
    """
    u, v, w = center
    hypot2 = g * g + depth * depth
    hypot = np.sqrt(hypot2)
    aside, ahead = (v * depth - w * g) / hypot, (v * g + w * depth) / hypot
    chord2 = (radius - aside) * (radius + aside)
    return Disc(hypot2, u, ahead, u * hypot, ahead * hypot, chord2, power)


def sphere_hit(s: Floats, disc: Disc) -> tuple[Floats, Floats]:
    """Distance at which rays of one pixel row meet spheres, or infinity.

    The rays of a row lie in a plane through the eye, so a sphere is a disc
    there: closest approach (Haines, Günther, Akenine-Möller, Ray Tracing
    Gems, ch. 7) in two dimensions, with the near root in the stable form
    t = C / (B + sqrt(B^2 - A C)).

    Parameters
    ----------
    s
        First component of the rays' directions, along the row.
    disc : Disc

    Returns
    -------
    t
        In units of the direction's length.  With the eye inside (or on) the
        sphere it is the far root.
    rise
        The cosine of the angle between the normal there and the ray, without
        its sign, times the radius and the direction's length.
    """
    length2 = s * s + disc.hypot2
    # Of the centre (u, w) and the ray (s, hypot) the cross product and the dot product.
    cross = disc.u_hypot - disc.w * s
    rise = np.sqrt(length2 * disc.chord2 - cross * cross)
    middle = disc.u * s + disc.w_hypot
    root = middle + rise
    power = disc.power
    if np.all(power > 0):
        t = power / root
    else:  # the far root, in the form that cancels less
        far = np.where(middle > 0, root / length2, power / (middle - rise))
        t = np.where(power > 0, power / root, far)
    # Not a number where there is no root; negative behind the eye.
    t[~(t > 0)] = np.inf
    return t, rise


def box_hit(d: Triple, low: Triple, high: Triple) -> tuple[Floats, NDArray[np.int8]]:
    """Distance at which rays meet boxes, or infinity, and the axis of the face.

    Slabs (Kay and Kajiya 1986); the face is that of the entry (of the exit,
    with the eye inside).  Slabs are closed: a ray lying in a face meets the box.

    Parameters
    ----------
    d
        Ray direction.
    low, high
        The box's corners, seen from the eye.

    Returns
    -------
    t, axis
        In units of the direction's length; 0, 1 or 2.
    """
    # If every pair has the eye on the same side of a slab, the plane on that side is the entry.
    below = [bool(np.all(m > 0)) for m in low]
    above = [bool(np.all(m < 0)) for m in high]
    near: list[Floats] = []
    far: list[Floats] = []
    for k in range(3):
        if below[k] or above[k]:
            entry, leave = low[k] / d[k], high[k] / d[k]
            if above[k]:
                entry, leave = leave, entry
        else:
            entry, leave = _slab(low[k], high[k], d[k], closed=True)
        near.append(entry)
        far.append(leave)
    outside = [k for k in range(3) if below[k] or above[k]]
    # With a single box, the eye is between the planes of every other slab: no ray enters these.
    entries = outside if outside and not np.ndim(low[0]) else [0, 1, 2]
    enter = near[entries[0]]
    axis = np.full(enter.shape, entries[-1], dtype=np.int8)
    for k in entries[1:]:
        enter = np.maximum(enter, near[k])
    # Of planes entered at once, through an edge or a corner, the first axis counts.
    for k in entries[-2::-1]:
        axis[near[k] == enter] = k
    leave = np.minimum(np.minimum(far[0], far[1]), far[2])
    t = np.where(enter <= leave, enter, np.inf)
    if not outside:
        inside = (enter <= 0) & (leave > 0)
        if inside.any():
            t = np.where(inside, leave, t)
            last = np.where(far[0] == leave, 0, np.where(far[1] == leave, 1, 2)).astype(np.int8)
            axis = np.where(inside, last, axis)
    t[~(t > 0)] = np.inf
    return t, axis


def _slab(low: Floats, high: Floats, d: Floats, *, closed: bool) -> tuple[Floats, Floats]:
    """Where rays enter and leave the slab between two planes, in units of `d`.

    `low`, `high`: the planes' places seen from the rays' origins; `d`: the rays' component across.
    A ray parallel to the planes is between them for ever, or never; one that lies in a plane is
    if the slab is `closed`.
    """
    a, b = low / d, high / d
    entry, leave = np.minimum(a, b), np.maximum(a, b)
    if np.count_nonzero(d) < d.size:
        parallel = d == 0
        between = (low <= 0) & (high >= 0) if closed else (low < 0) & (high > 0)
        entry = np.where(parallel, np.where(between, -np.inf, np.inf), entry)
        leave = np.where(parallel, np.where(between, np.inf, -np.inf), leave)
    return entry, leave


def sphere_side(distance: Floats, radius: Floats, tolerance: Floats) -> NDArray[np.int8]:
    """`OUTSIDE`, `ON` or `INSIDE`, for points at this distance from the centre."""
    gap = distance - radius
    side = (gap > tolerance).view(np.int8) - (gap < -tolerance).view(np.int8)
    return side


def sphere_crosses(to_light: Triple, to_center: Triple, radius: Floats) -> Bools:
    """Whether spheres cross segments from points to a light whose ends are well outside them.

    They do where the closest approach to the centre lies between the ends and within the sphere.
    """
    b = dot(to_center, to_light)
    length2 = dot(to_light, to_light)
    t = b / length2
    offset = each(lambda c, d: c - t * d, to_center, to_light)
    crosses: Bools = (dot(offset, offset) < radius * radius) & (b > 0) & (b < length2)
    return crosses


def sphere_blocks(
    to_light: Triple,
    to_center: Triple,
    radius: Floats,
    tolerance: Floats,
    light_side: NDArray[np.int8],
    eye_inside: Bools,
) -> Bools:
    """Whether spheres block the open segments from points to a light.

    Parameters
    ----------
    to_light, to_center
        From the point to the light, and to the sphere's centre.
    radius, tolerance
        The sphere's radius; how near to it a point counts as on it.
    light_side
        Where the light is: `OUTSIDE`, `ON` or `INSIDE`.
    eye_inside
        Whether the point is seen from inside the sphere: if it is on the
        surface, it is then on its inner side.
    """
    blocked = sphere_crosses(to_light, to_center, radius)
    side = sphere_side(np.sqrt(dot(to_center, to_center)), radius, tolerance)
    odd = indices((side != OUTSIDE) | (light_side != OUTSIDE))
    if odd.size:
        side, light = side[odd], light_side[odd]
        inner = eye_inside[odd]
        to_light, to_center = pick(to_light, odd), pick(to_center, odd)
        b, length2 = dot(to_center, to_light), dot(to_light, to_light)
        blocked[odd] = np.where(
            side == ON,
            np.where(inner, (b < 0) | (light == OUTSIDE), b > 0),
            np.where(light == ON, (side == OUTSIDE) & (b < length2), side != light),
        )
    return blocked


def box_blocks(
    p: Triple,
    light: Triple,
    low: Triple,
    high: Triple,
    tolerances: tuple[Floats, Floats] | None = None,
) -> Bools:
    """Whether boxes block the open segments from points `p` to `light`.

    A root strictly between the ends blocks.  Slabs are open: a segment in a
    face is not blocked; a flat plate blocks.  An end within its tolerance of a
    face's plane is on it: `tolerances` are the points' and the light's.  Without
    them, no end may be as near as that.
    """
    enter, leave = np.array(-np.inf), np.array(np.inf)
    for k in range(3):
        start, end = p[k], light[k]
        if tolerances is not None:
            start, end = (
                _snap(x, low[k], high[k], tolerance)
                for x, tolerance in zip((start, end), tolerances, strict=True)
            )
        near, far = _slab(low[k] - start, high[k] - start, end - start, closed=False)
        enter, leave = np.maximum(enter, near), np.minimum(leave, far)
    blocked: Bools = (enter <= leave) & (((enter > 0) & (enter < 1)) | ((leave > 0) & (leave < 1)))
    return blocked


def _snap(x: Floats, low: Floats, high: Floats, tolerance: Floats) -> Floats:
    on_low, on_high = np.abs(x - low) <= tolerance, np.abs(x - high) <= tolerance
    return np.where(on_low, low, np.where(on_high, high, x))
