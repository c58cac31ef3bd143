"""Shadows on a plane, in intervals of picture rows.

A picture row meets a plane in a line, and the segments from that line to a
light lie in one plane again: they, too, form a pencil, now seen from the light.
So a convex object shades one interval of the row, between its two tangents
from the light, in the same closed form that gives its outline from the eye.

Only samples near an interval's ends need a ray; between them the shadow is
certain, if the object lies wholly on the light's side of the plane.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tracer.camera import Raster
from tracer.groups import Bools, Triple, each
from tracer.pencil import ROUNDING, expand
from tracer.scene import Floats, Ints, Surfaces

__all__ = ["Plane", "Shade", "shade_intervals"]

# Rays are tried so many samples to either side of where an interval should end.
_MARGIN = 2

# Farther than so many radii from the light, a sphere's outline is left to single rays.
_FAR = 1e4

# Radii and planes are widened by this much, relatively, so that no sliver is lost.
_SLACK = 1e-7


@dataclass(frozen=True, slots=True)
class Plane:
    """Samples that see one axis-aligned plane.

    Attributes
    ----------
    axis : int
    level : float
        The plane's coordinate along the axis.
    s : (n,)
        First component of each sample's ray, in the camera's axes.
    g : (rows,)
        Second component, of each row.
    first : (rows + 1,)
        Where each row's samples begin.
    """

    axis: int
    level: float
    s: Floats
    g: Floats
    first: Ints


@dataclass(frozen=True, slots=True)
class Shade:
    """What may be shaded on a plane, interval by interval.

    Attributes
    ----------
    certain : (n,)
        Samples in shadow beyond doubt.
    sample, occluder : (m,)
        Pairs still to be tried.
    """

    certain: Bools
    sample: Ints
    occluder: Ints


def shade_intervals(
    raster: Raster,
    plane: Plane,
    light: Floats,
    surfaces: Surfaces,
    others: Ints,
    silhouettes: Triple,
) -> Shade:
    """Intervals of a plane's samples that objects may keep from a light.

    Parameters
    ----------
    light : (3,)
    others : (k,)
        The objects, spheres first.
    silhouettes : three (6, B)
        Planes through the light around every box.
    """
    spheres = len(surfaces.radius)
    rows = plane.g.size
    # Of use is only what reaches between the plane and the light.
    side = np.sign(light[plane.axis] - plane.level)
    size = np.abs(plane.level) + np.abs(light[plane.axis])
    near, far = _extent(surfaces, others, plane, side)
    between = (far > -_SLACK * size) & (near < abs(light[plane.axis] - plane.level))
    others, near = others[between], near[between]
    clear = (near > _SLACK * size) & _clear(surfaces, others, light, silhouettes)
    # Rays from the light to the plane's points: base + s along, for each row.
    u, v, w = raster.axes
    height = plane.level - raster.eye[plane.axis]
    tilt = (raster.eye - light) / height
    along = u + tilt * u[plane.axis]
    base = np.multiply.outer(plane.g, v) + raster.depth * w
    base = base + tilt * base[:, plane.axis, None]
    # From the row's own middle on, so that little cancels.
    middle = 0.5 * (plane.s[plane.first[:-1]] + plane.s[plane.first[1:] - 1])
    base = base + middle[:, None] * along

    balls, boxes = others[others < spheres], others[others >= spheres] - spheres
    center, radius = surfaces.center[balls] - light, surfaces.radius[balls]
    wedges = _wedges(base, along, each(lambda n: n[:, boxes], silhouettes))
    # Spheres a little larger for what may be shaded, a little smaller for what is for certain.
    (low, high), (low_sure, high_sure) = (
        [
            (np.concatenate([ball, box]) + middle).ravel()
            for ball, box in zip(_discs(base, along, center, size), wedges, strict=True)
        ]
        for size in (radius * (1 + _SLACK), radius * (1 - _SLACK))
    )
    before = np.repeat(clear, rows)
    row = np.tile(np.arange(rows), others.size)
    occluder = np.repeat(np.concatenate([balls, boxes + spheres]), rows)
    hit = np.flatnonzero(low <= high)
    row, occluder, before = row[hit], occluder[hit], before[hit]
    start, stop = _located(plane, row, low[hit], high[hit])
    begin, end = plane.first[row], plane.first[row + 1]
    outer = np.maximum(start - _MARGIN, begin), np.minimum(stop + _MARGIN, end)
    start, stop = _located(plane, row, low_sure[hit], high_sure[hit])
    inner = (
        np.where(start > begin, start + _MARGIN, start),
        np.where(stop < end, stop - _MARGIN, stop),
    )
    solid = before & (low_sure <= high_sure)[hit] & (inner[0] < inner[1])
    edge = np.zeros(plane.s.size + 1, dtype=np.intp)
    np.add.at(edge, inner[0][solid], 1)
    np.add.at(edge, inner[1][solid], -1)
    certain = edge.cumsum()[:-1] > 0
    # What is not certain: all of an interval, or a few samples at either end.
    first = np.concatenate([outer[0], inner[1][solid]])
    last = np.concatenate([np.where(solid, inner[0], outer[1]), outer[1][solid]])
    owner, place = expand(np.maximum(last - first, 0))
    sample = first[owner] + place
    occluder = np.concatenate([occluder, occluder[solid]])[owner]
    open_ = np.flatnonzero(~certain[sample])
    return Shade(certain, sample[open_], occluder[open_])


def _extent(surfaces: Surfaces, others: Ints, plane: Plane, side: float) -> tuple[Floats, Floats]:
    """Least and greatest height of objects over the plane, on the light's side."""
    spheres = len(surfaces.radius)
    balls, boxes = others[others < spheres], others[others >= spheres] - spheres
    height = side * (surfaces.center[balls, plane.axis] - plane.level)
    one = side * (surfaces.min_pt[boxes, plane.axis] - plane.level)
    two = side * (surfaces.max_pt[boxes, plane.axis] - plane.level)
    return (
        np.concatenate([height - surfaces.radius[balls], np.minimum(one, two)]),
        np.concatenate([height + surfaces.radius[balls], np.maximum(one, two)]),
    )


def _clear(surfaces: Surfaces, others: Ints, light: Floats, silhouettes: Triple) -> Bools:
    """Whether objects' outlines from the light are beyond doubt: well outside, and all known."""
    spheres = len(surfaces.radius)
    balls, boxes = others[others < spheres], others[others >= spheres] - spheres
    distance = np.sqrt(((surfaces.center[balls] - light) ** 2).sum(axis=1))
    radius, size = surfaces.radius[balls], np.abs(light).sum()
    gap = np.maximum(surfaces.min_pt[boxes] - light, light - surfaces.max_pt[boxes]).max(axis=1)
    known = np.any([n[:, boxes] != 0 for n in silhouettes], axis=0).all(axis=0)
    return np.concatenate(
        [
            (distance > (radius + size * _SLACK) * (1 + _SLACK)) & (distance < _FAR * radius),
            (gap > _SLACK * size) & known,
        ]
    )


def _located(plane: Plane, row: Ints, low: Floats, high: Floats) -> tuple[Ints, Ints]:
    """Range of samples of a row between two values of s."""
    # Rows one after the other on one axis, wide enough apart never to meet.
    least, most = plane.s.min(), plane.s.max()
    stride = 2 * (most - least) + 1
    key = plane.s - least + np.repeat(np.arange(plane.g.size) * stride, np.diff(plane.first))
    # An interval off one end must not be drawn onto the last sample there.
    beside = 0.25 * (1 + most - least)
    low, high = (np.clip(x - least, -beside, most - least + beside) for x in (low, high))
    start = np.searchsorted(key, row * stride + low)
    stop = np.searchsorted(key, row * stride + high, side="right")
    return start, stop


def _discs(base: Floats, along: Floats, center: Floats, radius: Floats) -> tuple[Floats, Floats]:
    """Where lines (rows,) of rays base + s along graze spheres (k,): (k, rows) each.

    A ray q grazes where |m x q| = r |q|: a quadratic in s.
    """
    radius2 = radius**2
    turned = np.cross(center[:, None, :], base)
    turn = np.cross(center, along)
    a = (turn * turn).sum(axis=-1) - radius2 * (along @ along)
    b = (turned * turn[:, None, :]).sum(axis=-1) - radius2[:, None] * (base @ along)
    c = (turned * turned).sum(axis=-1) - radius2[:, None] * (base * base).sum(axis=-1)
    a = np.broadcast_to(a[:, None], b.shape)
    root = np.sqrt(b * b - a * c)
    ahead = center @ base.T
    drift = (center @ along)[:, None]
    q = -(b + np.copysign(root, b))
    one, two = q / a, c / q
    low, high = np.minimum(one, two), np.maximum(one, two)
    # A half-line, where the cone from the light is wider than the row.
    open_ = a < 0
    right = drift > 0
    left_end = np.where(open_ & right, high, np.where(open_, -np.inf, low))
    right_end = np.where(open_ & right, np.inf, np.where(open_, low, high))
    # Behind the light; what is not a number there misses altogether.
    tangent = np.where(np.isfinite(left_end), left_end, right_end)
    miss = np.isnan(root) & ~open_ | ((ahead + tangent * drift <= 0) & ~open_)
    distance2 = (center * center).sum(axis=-1)
    unknown = (distance2 <= radius2) | (distance2 >= _FAR**2 * radius2)
    inside = unknown[:, None] | (np.isnan(root) & open_)
    left_end = np.where(inside, -np.inf, np.where(miss, np.inf, left_end))
    right_end = np.where(inside, np.inf, np.where(miss, -np.inf, right_end))
    return left_end, right_end


def _wedges(base: Floats, along: Floats, normals: Triple) -> tuple[Floats, Floats]:
    """Where lines (rows,) of rays base + s along pass boxes (k,): (k, rows) each."""
    shape = (normals[0].shape[1], len(base))
    low, high = np.full(shape, -np.inf), np.full(shape, np.inf)
    for k in range(6):
        normal = np.column_stack([n[k] for n in normals])
        slope = np.broadcast_to((normal @ along)[:, None], shape)
        level = normal @ base.T
        level += ROUNDING * (np.abs(normal) @ np.abs(base.T))
        bound = -level / slope
        np.maximum(low, bound, out=low, where=slope > 0)
        np.minimum(high, bound, out=high, where=slope < 0)
        low[(slope == 0) & (level < 0)] = np.inf
    return low, high
