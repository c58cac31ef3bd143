"""Silhouettes of boxes and spheres, seen from an apex: the eye or a light.

An edge function of a silhouette is a smooth function of a ray from the apex, whose sign changes
where the ray crosses the silhouette.
"""

from __future__ import annotations

import numpy as np

from tracer.arrays import Floats, Triple, cross, dot


def silhouette_planes(low: Floats, high: Floats) -> Triple:
    """Compute the planes through an apex and the edges of the silhouettes of boxes.

    Seen along an axis, a box is a rectangle.  An edge of the box that is parallel to the axis is
    one of the rectangle's corners.  It belongs to the silhouette if a tangent from the apex touches
    the rectangle at this corner.  There are two such corners for each axis, or none if the apex is
    inside the rectangle.

    Parameters
    ----------
    low, high : (3, n) float arrays
        Vectors from the apex to opposite corners of each box, in the axes of the scene.

    Returns
    -------
    normals : tuple of three (6, n) float arrays
        Normals of six planes for each box, in the axes of the scene.  All directions d towards the
        box have d . normal >= 0.  The components of the normals are coordinates of corners, so they
        have no cancellation errors.  A normal is zero, which bounds nothing, if there is no such
        edge.
    """
    side = (low > 0).astype(np.int8) - (high < 0)
    x, y, z = normals = np.zeros((3, 6, low.shape[1]))
    for k, mirrored in np.ndindex(3, 2):
        i, j = (k + 1) % 3, (k + 2) % 3
        # The last corner of the rectangle in counterclockwise order, as seen from the apex.  The
        # first corner is the last one of the mirror image.
        right, up = side[i], -side[j] if mirrored else side[j]
        a = np.where((up < 0) | ((up == 0) & (right < 0)), high[i], low[i])
        is_top = (right > 0) | ((right == 0) & (up < 0))
        b = np.where(is_top ^ bool(mirrored), high[j], low[j])
        sign = np.where((right != 0) | (up != 0), 1 - 2 * mirrored, 0)
        normals[i, 2 * k + mirrored], normals[j, 2 * k + mirrored] = sign * b, -sign * a
    return x, y, z


def box_edge_functions(planes: Triple, d: Triple) -> Floats:
    """Compute the edge functions of boxes for rays.

    Parameters
    ----------
    planes : tuple of three (6, n) float arrays
        Normals of the planes through the apex and the edges of the silhouette of each box, from
        `silhouette_planes`.
    d : tuple of three (m, n) float arrays
        m rays from the apex for each box, in the same axes.

    Returns
    -------
    values : (m, 6, n) float array
        Signed distances of the rays from the planes, multiplied by the lengths of the normals;
        positive on the side of the box.
    """
    return np.array([dot(normal, d) for normal in zip(*planes, strict=True)]).swapaxes(0, 1)


def sphere_edge_function(d: Triple, center: Triple, radius: Floats) -> Floats:
    """Compute the edge functions of spheres for rays: the angles by which the rays miss them.

    Parameters
    ----------
    d : tuple of three (m, n) float arrays
        m rays from the apex for each sphere.
    center : tuple of three (n,) float arrays
        Vectors from the apex to the centres of the spheres, in the same axes.
    radius : (n,) float array
        Radii of the spheres.

    Returns
    -------
    values : (m, n) float array
        Angles between the rays and the silhouettes, in radians: negative for rays that meet the
        sphere; NaN if the apex is inside the sphere.
    """
    perpendicular, distance = cross(center, d), np.sqrt(dot(center, center))
    angle = np.arctan2(np.sqrt(dot(perpendicular, perpendicular)), dot(center, d))
    tangent = np.sqrt((distance - radius) * (distance + radius))
    values: Floats = angle - np.arctan2(radius, tangent)
    return values
