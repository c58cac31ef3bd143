"""Silhouettes of boxes and spheres, seen from an apex: the eye or a light.

Those of boxes are their edges between a face that the apex sees and one that it does not.
"""

from __future__ import annotations

from itertools import product

import numpy as np

from tracer.arrays import Floats, Ints, Triple, cross, dot, each
from tracer.shapes.rounding import END_ON, PRODUCT_ROUNDING


def box_corners(min_pt: Floats, max_pt: Floats, apex: Floats) -> Triple:
    """Corners seen from an apex: three (8, n); i is high along axis k where bit k of i is set."""
    ends = (min_pt - apex).T, (max_pt - apex).T
    x, y, z = (np.array([ends[i >> k & 1][k] for i in range(8)]) for k in range(3))
    return x, y, z


def _silhouette_table() -> tuple[Ints, Ints, Ints]:
    """Corner pairs (27, 6) of the silhouette edges a b, by where the eye is; sides of the box.

    A side is 1 where a x b, seen from the eye, points to the box's side of the edge, else -1.

    The eye is below, between or above the two planes of each axis: 27 regions
    (Schmalstieg and Tobler, Real-time bounding box area computation, 1999).
    Corner i has bit k set where it is high along axis k.  Regions with four
    edges repeat the first two; the middle region has none (corners 0 and 0).
    """
    start = np.zeros((27, 6), dtype=np.intp)
    end = np.zeros((27, 6), dtype=np.intp)
    side = np.ones((27, 6), dtype=np.intp)
    for region, code in enumerate(product((-1, 0, 1), repeat=3)):
        pairs = []
        for k, corner in product(range(3), range(8)):
            i, j = (k + 1) % 3, (k + 2) % 3
            outward_i, outward_j = (1 if corner >> m & 1 else -1 for m in (i, j))
            # Of the two faces at an edge along k, one is seen and one is not.
            seen = code[i] == outward_i
            if not corner >> k & 1 and seen != (code[j] == outward_j):
                pairs.append((corner, corner | 1 << k, outward_i * outward_j * (-1) ** seen))
        if pairs:
            start[region], end[region], side[region] = np.transpose((pairs * 2)[:6])
    return start, end, side


_EDGE_START, _EDGE_END, _EDGE_SIDE = _silhouette_table()


def silhouette_planes(
    corners: Triple, apex: Floats, min_pt: Floats, max_pt: Floats
) -> tuple[Triple, tuple[Floats, Floats]]:
    """Planes through an apex and the silhouette edges of boxes seen from there.

    Parameters
    ----------
    corners : three (8, n)
        The boxes' corners seen from the apex, in any axes that are right-handed.
    apex : (3,), or (n, 3)
    min_pt, max_pt : (n, 3)

    Returns
    -------
    normals : three (6, n)
        In the same axes; directions d towards the box have d . normal >= 0.
        Zero, which bounds nothing, where there is no silhouette (apex inside), or where an edge
        is so short, or so nearly end-on, that rounding decides its direction.
    rounding : two (6, n)
        How much of d . normal that may be: so much for each unit of d's length, and so much more
        for each unit that d lies beside the line to the edge's nearer end, which the plane holds.
    """
    code = (apex > max_pt).astype(np.intp) - (apex < min_pt)
    region = (code + 1) @ np.array([9, 3, 1])
    every = np.arange(len(min_pt))
    start, end = _EDGE_START[region].T, _EDGE_END[region].T
    a = each(lambda m: m[start, every], corners)
    b = each(lambda m: m[end, every], corners)
    # a x b, from the edge and its nearer end: the two ends of what is far away hardly differ.
    a2, b2 = dot(a, a), dot(b, b)
    near = each(lambda a, b: np.asarray(np.where(a2 < b2, a, b)), a, b)
    edge = each(np.subtract, b, a)
    normal = cross(near, edge)
    doubtful = dot(normal, normal) <= END_ON**2 * a2 * b2
    # Not by where the box's middle is: seen from near a vast box, that is little but rounding.
    sign = np.where(doubtful, 0, _EDGE_SIDE[region].T)
    # What products lose as their sum cancels; then what the edge's ends lose as one is subtracted.
    products = PRODUCT_ROUNDING * np.sqrt(np.minimum(a2, b2) * dot(edge, edge))
    return each(lambda n: sign * n, normal), (products, PRODUCT_ROUNDING * np.sqrt(a2 * b2))


def box_margins(planes: Triple, d: Triple) -> Floats:
    """Signed distances (m, 6, n), but for scale, of rays from the planes of silhouettes.

    `planes`: three (6, n), see `silhouette_planes`; `d`: rays from the apex, three (m, n).
    """
    return np.array([dot(normal, d) for normal in zip(*planes, strict=True)]).swapaxes(0, 1)


def sphere_margins(d: Triple, center: Triple, radius: Floats) -> Floats:
    """Angles (m, n) by which rays miss spheres, negative where they meet them; NaN from inside.

    `d`: rays from the apex, three (m, n); `center`: three (n,), as seen from there.
    """
    aside, distance = cross(center, d), np.sqrt(dot(center, center))
    angle = np.arctan2(np.sqrt(dot(aside, aside)), dot(center, d))
    tangent = np.sqrt((distance - radius) * (distance + radius))
    margins: Floats = angle - np.arctan2(radius, tangent)
    return margins
