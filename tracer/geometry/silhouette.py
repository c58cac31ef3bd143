"""Silhouettes of boxes and spheres, seen from a *viewpoint*: the eye or a light.

An *edge function* is a smooth function of a ray from the viewpoint that is zero on the silhouette.
To find the edges that may cross a cell of the picture (a pixel, or a square part of a pixel), edge
functions are evaluated for six rays, through six *points of the cell*: the center; the centers of
the right, left, lower and upper sides; and the lower right corner.
"""

from __future__ import annotations

from typing import Annotated as Shaped

import numpy as np

from tracer.arrays import Bools, Floats, Sides, Triple, cross, dot


def find_edge_planes(
    low: Shaped[Floats, "3 n"], high: Shaped[Floats, "3 n"]
) -> Shaped[Triple, "6 n"]:
    """Compute the normals of planes through a viewpoint and the silhouette edges of boxes.

    The silhouette of a box contains at most two edges parallel to each axis.  The planes of axis k
    have the indices 2 k and 2 k + 1.  Their normals point towards the box, and are 0 where there is
    no edge.

    Parameters
    ----------
    low, high
        Corners of the boxes with the smallest and the largest coordinates, relative to the
        viewpoint, in scene axes.
    """
    # For each axis: 1 if the box lies above the viewpoint, -1 if it lies below, and otherwise 0.
    box_side = (low > 0).astype(np.int8) - (high < 0)
    normals = np.zeros((3, 6, low.shape[1]))
    for axis, is_first in np.ndindex(3, 2):
        # Seen along the axis, the box is a rectangle with the axes u and v.  Its first and last
        # corners, in counterclockwise order around the viewpoint, are silhouette edges.
        u, v = (axis + 1) % 3, (axis + 2) % 3
        if is_first:
            # The first corner is the last corner of the mirror image, in which v is reversed.
            is_high_u, is_low_v = _find_last_corner(box_side[u], -box_side[v])
            is_high_v = ~is_low_v
        else:
            is_high_u, is_high_v = _find_last_corner(box_side[u], box_side[v])
        corner_u = np.where(is_high_u, high[u], low[u])
        corner_v = np.where(is_high_v, high[v], low[v])
        # If the viewpoint is inside the rectangle, there is no edge.
        is_outside = (box_side[u] != 0) | (box_side[v] != 0)
        sign = np.where(is_outside, -1 if is_first else 1, 0)
        # The normal is a cross product with the axis: no subtraction, so no cancellation.
        normals[u, 2 * axis + is_first] = sign * corner_v
        normals[v, 2 * axis + is_first] = -sign * corner_u
    return normals[0], normals[1], normals[2]


def _find_last_corner(
    side_u: Shaped[Sides, "n"], side_v: Shaped[Sides, "n"]
) -> tuple[Shaped[Bools, "n"], Shaped[Bools, "n"]]:
    """Find the last corner of rectangles, counterclockwise around a viewpoint outside of them.

    The sides tell where a rectangle lies along its axes u and v, relative to the viewpoint: 1 if
    above, -1 if below, 0 if on both sides.  The results tell whether the corner has the larger u,
    and whether it has the larger v.
    """
    is_high_u = (side_v < 0) | ((side_v == 0) & (side_u < 0))
    is_high_v = (side_u > 0) | ((side_u == 0) & (side_v < 0))
    return is_high_u, is_high_v


def evaluate_box_edges(
    normals: Shaped[Triple, "6 n"], ray: Shaped[Triple, "#m n"]
) -> Shaped[Floats, "m 6 n"]:
    """Evaluate the edge functions of boxes for m rays from a viewpoint to each of n boxes.

    An edge function is the dot product of the ray and the normal of one of the six planes from
    `find_edge_planes`.  It is positive on the box's side of the plane.  Rays and normals must be in
    the same axes.
    """
    return np.array([dot(normal, ray) for normal in zip(*normals, strict=True)]).swapaxes(0, 1)


def compute_miss_angles(
    ray: Shaped[Triple, "#m n"], center: Shaped[Triple, "n"], radius: Shaped[Floats, "n"]
) -> Shaped[Floats, "m n"]:
    """Compute the angles, in radians, by which m rays from a viewpoint miss each of n spheres.

    The angle is an edge function of the sphere, because it is 0 if the ray touches the sphere.  It
    is negative if the ray meets the sphere, and NaN if the viewpoint is inside the sphere.  The
    centers are relative to the viewpoint.
    """
    cross_product = cross(center, ray)
    distance = np.sqrt(dot(center, center))
    center_angle = np.arctan2(np.sqrt(dot(cross_product, cross_product)), dot(center, ray))
    tangent_length = np.sqrt((distance - radius) * (distance + radius))
    angle: Floats = center_angle - np.arctan2(radius, tangent_length)
    return angle


def bound_variation(values: Shaped[Floats, "6 ..."]) -> Shaped[Floats, "..."]:
    """Bound how much edge functions differ, anywhere in a cell, from their values at the center.

    Each function is replaced by the quadratic polynomial through its values at the six points of
    the cell, which are in the order of this module's docstring.  With x and y from -1 to 1 across
    the cell, the polynomial differs from its value at the center by a x + b y + c x^2 + d y^2 +
    e x y, so by at most |a| + |b| + |c| + |d| + |e|.
    """
    center, right, left, lower, upper, corner = values
    linear_part = np.abs(right - left) + np.abs(lower - upper)
    square_part = np.abs(right + left - 2 * center) + np.abs(lower + upper - 2 * center)
    mixed_part = np.abs(corner - right - lower + center)
    return np.asarray(0.5 * linear_part + 0.5 * square_part + mixed_part)
