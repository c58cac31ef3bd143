"""Silhouettes of boxes and spheres, seen from an apex: the eye or a light.

An edge function of a silhouette is a smooth function of a ray from the apex, whose sign changes
where the ray crosses the silhouette.
"""

from __future__ import annotations

import numpy as np

from tracer.arrays import Floats, Triple, cross, dot


def silhouette_planes(low: Floats, high: Floats) -> Triple:
    """Compute the planes through an apex (the eye or a light) and the silhouette edges of boxes.

    Seen along a coordinate axis, a box is a rectangle, and a box edge parallel to the axis is a
    corner of this rectangle.  The edge belongs to the silhouette if a tangent from the apex touches
    the rectangle at this corner.  Each axis has two such corners, or none if the apex is inside the
    rectangle.

    Parameters
    ----------
    low, high : (3, n) float arrays
        Vectors from the apex to opposite corners of each of n boxes, in scene axes.

    Returns
    -------
    normals : tuple of three (6, n) float arrays
        Components x, y and z of the normals of six planes for each box.  Every direction d from the
        apex to a point of the box satisfies d . normal >= 0.  Planes 2 k and 2 k + 1 belong to
        edges parallel to axis k; their normals are 0 if no such edge is in the silhouette.  The
        components are coordinates of corners, up to sign, so they have no cancellation errors.
    """
    # For each axis: 1 if the box lies above the apex, -1 if it lies below, and otherwise 0.
    side = (low > 0).astype(np.int8) - (high < 0)
    x, y, z = normals = np.zeros((3, 6, low.shape[1]))
    for axis, is_mirrored in np.ndindex(3, 2):
        i, j = (axis + 1) % 3, (axis + 2) % 3
        # Find the last corner of the rectangle in counterclockwise order, as seen from the apex.
        # The first corner is the last one of the mirror image.
        side_i, side_j = side[i], -side[j] if is_mirrored else side[j]
        corner_i = np.where((side_j < 0) | ((side_j == 0) & (side_i < 0)), high[i], low[i])
        takes_high_j = (side_i > 0) | ((side_i == 0) & (side_j < 0))
        corner_j = np.where(takes_high_j ^ bool(is_mirrored), high[j], low[j])
        sign = np.where((side_i != 0) | (side_j != 0), 1 - 2 * is_mirrored, 0)
        plane = 2 * axis + is_mirrored
        normals[i, plane], normals[j, plane] = sign * corner_j, -sign * corner_i
    return x, y, z


def box_edge_functions(planes: Triple, ray: Triple) -> Floats:
    """Evaluate the edge functions of boxes for rays from an apex (the eye or a light).

    The sign of an edge function changes where a ray crosses an edge of the box's silhouette.  Each
    function belongs to the plane through the apex and one edge.

    Parameters
    ----------
    planes : tuple of three (6, n) float arrays
        Normals of the six planes of each of n boxes, from `silhouette_planes`.
    ray : tuple of three (m, n) float arrays
        Directions of m rays for each box, in the same axes as the normals.

    Returns
    -------
    values : (m, 6, n) float array
        Dot product of each ray and each normal: positive if the ray is on the box's side of the
        plane.
    """
    return np.array([dot(normal, ray) for normal in zip(*planes, strict=True)]).swapaxes(0, 1)


def sphere_edge_function(ray: Triple, center: Triple, radius: Floats) -> Floats:
    """Compute the angles by which rays from an apex (the eye or a light) miss spheres.

    The angle is an edge function: its sign changes where a ray crosses the sphere's silhouette.

    Parameters
    ----------
    ray : tuple of three (m, n) float arrays
        Directions of m rays for each of n spheres.
    center : tuple of three (n,) float arrays
        Vectors from the apex to the centres of the spheres, in the same axes.
    radius : (n,) float array
        Radii of the spheres.

    Returns
    -------
    angle : (m, n) float array
        Angle from the silhouette to the ray, in radians: negative if the ray meets the sphere; NaN
        if the apex is inside the sphere.
    """
    perpendicular, distance = cross(center, ray), np.sqrt(dot(center, center))
    center_angle = np.arctan2(np.sqrt(dot(perpendicular, perpendicular)), dot(center, ray))
    tangent_length = np.sqrt((distance - radius) * (distance + radius))
    angle: Floats = center_angle - np.arctan2(radius, tangent_length)
    return angle
