"""Silhouettes of boxes and spheres, seen from an apex: the eye or a light."""

from __future__ import annotations

import numpy as np

from tracer.arrays import Floats, Triple, cross, dot


def silhouette_planes(low: Floats, high: Floats) -> Triple:
    """Planes through an apex and the edges of the silhouettes that boxes show there.

    Seen along an axis, a box is a rectangle, and its edges that are silhouettes are the corners
    where tangents touch it: two for each axis, or none where the apex is between its other faces.

    Parameters
    ----------
    low, high : (3, n)
        The boxes' lower and upper corners as seen from the apex, in the scene's axes.

    Returns
    -------
    normals : three (6, n)
        In the same axes; directions d towards the box have d . normal >= 0.  Their components are
        coordinates of corners, so nothing cancels.  Zero, which bounds nothing, where there is no
        such edge.
    """
    side = (low > 0).astype(np.int8) - (high < 0)
    x, y, z = normals = np.zeros((3, 6, low.shape[1]))
    for k, mirrored in np.ndindex(3, 2):
        i, j = (k + 1) % 3, (k + 2) % 3
        # Of the rectangle the last corner counterclockwise; of its mirror image, clockwise.
        right, up = side[i], -side[j] if mirrored else side[j]
        a = np.where((up < 0) | ((up == 0) & (right < 0)), high[i], low[i])
        top = (right > 0) | ((right == 0) & (up < 0))
        b = np.where(top ^ bool(mirrored), high[j], low[j])
        sign = np.where((right != 0) | (up != 0), 1 - 2 * mirrored, 0)
        normals[i, 2 * k + mirrored], normals[j, 2 * k + mirrored] = sign * b, -sign * a
    return x, y, z


def box_edge_functions(planes: Triple, d: Triple) -> Floats:
    """Signed distances (m, 6, n), but for scale, of rays from the planes of silhouettes.

    `planes`: three (6, n), see `silhouette_planes`; `d`: rays from the apex, three (m, n).
    """
    return np.array([dot(normal, d) for normal in zip(*planes, strict=True)]).swapaxes(0, 1)


def sphere_edge_function(d: Triple, center: Triple, radius: Floats) -> Floats:
    """Angles (m, n) by which rays miss spheres, negative where they meet them; NaN from inside.

    `d`: rays from the apex, three (m, n); `center`: three (n,), as seen from there.
    """
    aside, distance = cross(center, d), np.sqrt(dot(center, center))
    angle = np.arctan2(np.sqrt(dot(aside, aside)), dot(center, d))
    tangent = np.sqrt((distance - radius) * (distance + radius))
    values: Floats = angle - np.arctan2(radius, tangent)
    return values
