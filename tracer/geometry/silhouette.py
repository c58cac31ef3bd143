"""Silhouettes of boxes and spheres, seen from a *viewpoint*: the eye or a light.

An *edge function* is a smooth function of a ray from the viewpoint that is zero on the silhouette.
To find the edges that may cross a cell of the picture (a pixel, or a square part of a pixel), edge
functions are evaluated for six rays, through six *points of the cell*: the centre; the centres of
the right, left, lower and upper sides; and the lower right corner.
"""

from __future__ import annotations

from typing import Annotated as Shaped

import numpy as np

from tracer.arrays import Floats, Triple, cross, dot


def find_edge_planes(low: Floats, high: Floats) -> Triple:
    """Compute planes through a viewpoint (the eye or a light) and the silhouette edges of boxes.

    The silhouette of a box contains at most two edges parallel to each axis.

    Parameters
    ----------
    low, high : (3, n) float arrays
        Smallest and largest coordinates of n boxes, relative to the viewpoint, in scene axes.

    Returns
    -------
    normals : tuple of three (6, n) float arrays
        Components x, y and z of the normals of six planes for each box.  Planes 2 k and 2 k + 1
        belong to edges parallel to axis k.  A normal is 0 if there is no such edge.  All other
        normals point towards the box.
    """
    # For each axis: 1 if the box lies above the viewpoint, -1 if it lies below, and otherwise 0.
    box_side = (low > 0).astype(np.int8) - (high < 0)
    x, y, z = normals = np.zeros((3, 6, low.shape[1]))
    for axis, is_mirrored in np.ndindex(3, 2):
        u, v = (axis + 1) % 3, (axis + 2) % 3
        # Seen along the axis, the box is a rectangle with the axes u and v.  Its first and last
        # corners, in counterclockwise order around the viewpoint, are silhouette edges.  The first
        # corner is computed as the last corner of the mirror image.
        side_u, side_v = box_side[u], -box_side[v] if is_mirrored else box_side[v]
        corner_u = np.where((side_v < 0) | ((side_v == 0) & (side_u < 0)), high[u], low[u])
        is_high_v = (side_u > 0) | ((side_u == 0) & (side_v < 0))
        corner_v = np.where(is_high_v ^ bool(is_mirrored), high[v], low[v])
        sign = np.where((side_u != 0) | (side_v != 0), 1 - 2 * is_mirrored, 0)
        plane_index = 2 * axis + is_mirrored
        # The normal is a cross product with the axis: no subtraction, so no cancellation.
        normals[u, plane_index], normals[v, plane_index] = sign * corner_v, -sign * corner_u
    return x, y, z


def evaluate_box_edges(normals: Triple, ray: Triple) -> Floats:
    """Evaluate the edge functions of boxes for rays from a viewpoint (the eye or a light).

    An edge function belongs to one silhouette edge of a box.  It is zero where the ray lies in the
    plane through the viewpoint and this edge.

    Parameters
    ----------
    normals : tuple of three (6, n) float arrays
        Normals of the six planes of each of n boxes, from `find_edge_planes`.
    ray : tuple of three (m, n) or (1, n) float arrays
        Directions of m rays for each box, in the axes of the normals.  A single row is repeated.

    Returns
    -------
    values : (m, 6, n) float array
        Dot product of each ray and each normal: positive if the ray is on the box's side of the
        plane.
    """
    return np.array([dot(normal, ray) for normal in zip(*normals, strict=True)]).swapaxes(0, 1)


def compute_miss_angles(ray: Triple, center: Triple, radius: Floats) -> Floats:
    """Compute the angles by which rays from a viewpoint (the eye or a light) miss spheres.

    The angle is an edge function: it is zero where a ray touches the sphere's silhouette.

    Parameters
    ----------
    ray : tuple of three (m, n) or (1, n) float arrays
        Directions of m rays for each of n spheres.  A single row is repeated.
    center : tuple of three (n,) float arrays
        Vectors from the viewpoint to the centres of the spheres, in the same axes.
    radius : (n,) float array
        Radii of the spheres.

    Returns
    -------
    angle : (m, n) float array
        Angle between the ray and the nearest tangent, in radians: negative if the ray meets the
        sphere; NaN if the viewpoint is inside the sphere.
    """
    cross_product, distance = cross(center, ray), np.sqrt(dot(center, center))
    center_angle = np.arctan2(np.sqrt(dot(cross_product, cross_product)), dot(center, ray))
    tangent_length = np.sqrt((distance - radius) * (distance + radius))
    angle: Floats = center_angle - np.arctan2(radius, tangent_length)
    return angle


def bound_variation(values: Shaped[Floats, "6 ..."]) -> Floats:
    """Bound how much edge functions differ, in a cell, from their values at the centre.

    The bound applies to the quadratic polynomials through the values at the six points of the cell.
    """
    center, right, left, lower, upper, corner = values
    linear_part = np.abs(right - left) + np.abs(lower - upper)
    square_part = np.abs(right + left - 2 * center) + np.abs(lower + upper - 2 * center)
    mixed_part = np.abs(corner - right - lower + center)
    return np.asarray(0.5 * linear_part + 0.5 * square_part + mixed_part)
