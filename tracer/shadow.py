"""Which points a light reaches: one pencil from each light.

All shadow segments end at a light, so seen from there an object can only block
points in the directions it covers.  Directions are sorted into the cells of an
octahedral map (Engelhardt and Dachsbacher 2008: each octant of directions onto
the plane |x| + |y| + |z| = 1), each object is listed in the cells that its
bounding box can touch, and a point is tested against its own cell's list.

The bounds are interval arithmetic and stay valid with the light beside, on or
inside an object; they only ever leave out pairs that cannot meet.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tracer.camera import Raster
from tracer.groups import Index, Vectors, select
from tracer.intersection import (
    INSIDE,
    ON,
    SURFACE_TOLERANCE,
    Bools,
    Triple,
    box_blocks,
    dot,
    sphere_blocks,
    sphere_side,
)
from tracer.pencil import box_corners, expand, silhouette_planes
from tracer.planar import Plane, shade_intervals
from tracer.scene import Floats, Ints, Surfaces

__all__ = ["LightPencil", "Occluders", "light_pencil", "occluders_of"]

# Widens bounds by more than all roundings between a point and its cell.
_SLACK = 1e-9

# Intervals on a plane's rows pay when they are this many times fewer than samples.
_PLANE_WORTH = 8

_NONE, _MANY = -1, -2

# Cells along the side of an octant: finer cells list less, and take longer to fill.
_CELLS_LEAST, _CELLS_MOST = 64, 1024


@dataclass(frozen=True, slots=True)
class Occluders:
    """All surfaces, spheres first, as whatever may cast a shadow.

    Attributes
    ----------
    raster : Raster
        The rays they are seen by.
    surfaces : Surfaces
    eye_inside : (n,)
        Which of them are seen from inside.
    seen : (n,)
        Which of them may be seen at all.
    low, high : (3, n)
        Their bounding boxes.
    size : (n,)
        What a sphere's tolerance, or a box's, scales with.
    """

    raster: Raster
    surfaces: Surfaces
    eye_inside: Bools
    seen: Bools
    low: Floats
    high: Floats
    size: Floats


@dataclass(frozen=True, slots=True)
class LightPencil:
    """One light's cells, each with a list of objects that may block in it.

    Attributes
    ----------
    position : tuple of 3 floats
    side : (n,) int8
        Where the light is to each object: outside, on or inside it.
    scale, shift : (2, 8)
        From octahedral coordinates to cells, per octant.
    cells : int
        Cells along each side of an octant.
    first : (8 * cells * cells + 1,)
        Where each cell's list begins in `listed`.
    listed : (m,)
        Objects.
    sole : (8 * cells * cells,)
        The only object listed in a cell; `_MANY` or `_NONE`.
    near : (n,)
        Each object's least distance to the light, in the 1-norm.
    safe : (n,)
        Objects none of whose points any other object can keep from the light.
    silhouettes : three (6, B)
        Planes through the light around every box.
    """

    position: tuple[float, float, float]
    side: NDArray[np.int8]
    scale: Floats
    shift: Floats
    cells: int
    first: Ints
    listed: Ints
    sole: Ints
    near: Floats
    safe: Bools
    silhouettes: Triple

    def blocked(
        self,
        occluders: Occluders,
        p: Vectors,
        to_light: Vectors,
        own: Index,
        reach: Floats,
        plane: Plane | None = None,
    ) -> Bools:
        """Whether another object than their own keeps points from the light.

        Parameters
        ----------
        p, to_light
            The points, and from there to the light.
        own
            The object each point lies on.
        reach
            Length that a point's rounding error scales with: its distances
            from the origin and from the eye.
        plane
            The plane on which all the points lie, if they do.
        """
        result = np.zeros(reach.size, dtype=np.bool_)
        if isinstance(own, int) or not np.ndim(own):
            if self.safe[own]:
                return result
            count = len(occluders.surfaces)
            if plane and count * plane.g.size * _PLANE_WORTH <= reach.size:
                others = np.delete(np.arange(count), own)
                shade = shade_intervals(
                    occluders.raster,
                    plane,
                    np.array(self.position),
                    occluders.surfaces,
                    others,
                    self.silhouettes,
                )
                result |= shade.certain
                tried = _pairs_block(
                    self, occluders, p, to_light, reach, shade.occluder, shade.sample
                )
                result[shade.sample[tried]] = True
                return result
            asked: Ints | slice = slice(None)
        else:
            asked = np.flatnonzero(~self.safe[own])
        distance, cell = self._locate(tuple(select(d, asked) for d in to_light))
        # Most cells hold nothing, or the object itself.
        sole = self.sole[cell]
        active = np.flatnonzero((sole != _NONE) & (sole != select(own, asked)))
        if not active.size:
            return result
        cell = cell[active]
        first = self.first[cell]
        owner, place = expand(self.first[cell + 1] - first)
        other = self.listed[first[owner] + place]
        point = active[owner]
        distance = distance[point]
        if not isinstance(asked, slice):
            point = asked[point]
        keep = np.flatnonzero((other != select(own, point)) & (self.near[other] <= distance))
        other, point = other[keep], point[keep]
        result[point[_pairs_block(self, occluders, p, to_light, reach, other, point)]] = True
        return result

    def _locate(self, to_light: Triple) -> tuple[Floats, Ints]:
        """Distance from the light (1-norm) and cell of points, from these to the light."""
        x, y, z = (np.abs(d) for d in to_light)
        total = x + y + z
        octant = sum(
            (np.asarray(d) < 0).astype(np.intp) << k for k, d in enumerate(to_light)
        )
        with np.errstate(invalid="ignore", divide="ignore"):
            inverse = 1 / total
            i = x * inverse * self.scale[0][octant] + self.shift[0][octant]
            j = y * inverse * self.scale[1][octant] + self.shift[1][octant]
        last = self.cells - 1
        # A point in the light itself is in no direction: any cell will do.
        i = np.fmin(np.fmax(i, 0), last).astype(np.intp)
        j = np.fmin(np.fmax(j, 0), last).astype(np.intp)
        return total * (1 + _SLACK), (octant * self.cells + i) * self.cells + j


def _pairs_block(
    light: LightPencil,
    occluders: Occluders,
    p: Vectors,
    to_light: Vectors,
    reach: Floats,
    other: Ints,
    point: Ints,
) -> Bools:
    """Whether objects `other` block the points `point`, pair by pair."""
    surfaces = occluders.surfaces
    spheres = len(surfaces.radius)
    side = light.side[other]
    tolerance = reach[point]
    if (side == ON).any():
        end = sum(abs(x) for x in light.position)
        tolerance = np.where(side == ON, np.maximum(tolerance, end), tolerance)
    tolerance = SURFACE_TOLERANCE * (tolerance + occluders.size[other])
    result = np.empty(other.size, dtype=np.bool_)

    at = np.flatnonzero(other < spheres)
    ball, i = other[at], point[at]
    result[at] = sphere_blocks(
        (select(to_light[0], i), select(to_light[1], i), select(to_light[2], i)),
        (
            surfaces.center[ball, 0] - select(p[0], i),
            surfaces.center[ball, 1] - select(p[1], i),
            surfaces.center[ball, 2] - select(p[2], i),
        ),
        surfaces.radius[ball],
        tolerance[at],
        side[at],
        occluders.eye_inside[ball],
    )
    at = np.flatnonzero(other >= spheres)
    box, i = other[at] - spheres, point[at]
    x, y, z = light.position
    result[at] = box_blocks(
        (select(p[0], i), select(p[1], i), select(p[2], i)),
        (x, y, z),
        (surfaces.min_pt[box, 0], surfaces.min_pt[box, 1], surfaces.min_pt[box, 2]),
        (surfaces.max_pt[box, 0], surfaces.max_pt[box, 1], surfaces.max_pt[box, 2]),
        tolerance[at],
    )
    return result


def occluders_of(
    raster: Raster, surfaces: Surfaces, eye_inside: Bools, seen: Bools
) -> Occluders:
    """Gather spheres and boxes."""
    center, radius = surfaces.center.T, surfaces.radius
    low = np.concatenate([center - radius, surfaces.min_pt.T], axis=1)
    high = np.concatenate([center + radius, surfaces.max_pt.T], axis=1)
    size = np.concatenate(
        [
            np.abs(center).sum(axis=0) + radius,
            np.maximum(np.abs(surfaces.min_pt), np.abs(surfaces.max_pt)).sum(axis=1),
        ]
    )
    return Occluders(raster, surfaces, eye_inside, seen, low, high, size)


def light_pencil(position: tuple[float, float, float], occluders: Occluders) -> LightPencil:
    """List the objects that may block a light, by direction."""
    surfaces = occluders.surfaces
    count = len(surfaces)
    origin = np.array(position)
    reach = np.abs(origin).sum()
    distance = np.sqrt(((surfaces.center - origin) ** 2).sum(axis=1))
    tolerance = SURFACE_TOLERANCE * (reach + occluders.size)
    spheres = len(surfaces.radius)
    strictly = ((surfaces.min_pt < origin) & (origin < surfaces.max_pt)).all(axis=1)
    side = np.concatenate(
        [
            sphere_side(distance, surfaces.radius, tolerance[:spheres]),
            np.where(strictly, INSIDE, ON).astype(np.int8),
        ]
    )

    # Rectangles of (object, octant) in octahedral coordinates.
    rectangles = []
    near = np.full(count, np.inf)
    for octant in range(8):
        low, high = np.empty((3, count)), np.empty((3, count))
        for k in range(3):
            # An octant's sign is that of the direction from the point to the light.
            slack = _SLACK * (np.abs(occluders.low[k]) + np.abs(occluders.high[k]) + reach)
            below = occluders.low[k] - slack - position[k]
            above = occluders.high[k] + slack - position[k]
            away = octant >> k & 1
            low[k], high[k] = (below, above) if away else (-above, -below)
        at = np.flatnonzero((high >= 0).all(axis=0))
        if not at.size:
            continue
        x0, y0, z0 = np.maximum(low[:, at], 0)
        x1, y1, z1 = high[:, at]
        near[at] = np.minimum(near[at], x0 + y0 + z0)
        with np.errstate(invalid="ignore", divide="ignore"):
            bounds = np.array(
                [x0 / (x0 + y1 + z1), x1 / (x1 + y0 + z0), y0 / (y0 + x1 + z1), y1 / (y1 + x0 + z0)]
            )
        bounds = np.where(np.isnan(bounds), [[0.0], [1.0], [0.0], [1.0]], bounds)
        bounds += np.array([[-_SLACK], [_SLACK], [-_SLACK], [_SLACK]])
        far = x1 + y1 + z1
        rectangles.append((octant, at, bounds, x0 + y0 + z0, far))

    cells = int(np.clip(2 * np.sqrt(count), _CELLS_LEAST, _CELLS_MOST))
    normals = _separators(origin, surfaces)
    scale, shift = np.zeros((2, 8)), np.zeros((2, 8))
    hits = np.zeros((8, cells, cells), dtype=np.intp)
    entries = []
    safe = np.ones(count, dtype=np.bool_)
    for octant, at, bounds, nearest, farthest in rectangles:
        receivers = np.flatnonzero(occluders.seen[at])
        if not receivers.size:
            continue
        # The cells cover just the directions in which there is something to light.
        left, top = bounds[0][receivers].min(), bounds[2][receivers].min()
        right, bottom = bounds[1][receivers].max(), bounds[3][receivers].max()
        scale[:, octant] = cells / (right - left), cells / (bottom - top)
        shift[:, octant] = -left * scale[0, octant], -top * scale[1, octant]
        # An object nearer to the light than no other one's farthest point blocks nothing.
        reachable = np.sort(farthest[receivers])[-2:]
        limit = np.where(
            occluders.seen[at] & (farthest >= reachable[-1]),
            reachable[0] if reachable.size == 2 else -np.inf,
            reachable[-1],
        )
        i0, i1 = (np.floor(bounds[k] * scale[0, octant] + shift[0, octant]) for k in (0, 1))
        j0, j1 = (np.floor(bounds[k] * scale[1, octant] + shift[1, octant]) for k in (2, 3))
        i0, j0 = np.maximum(i0, 0).astype(np.intp), np.maximum(j0, 0).astype(np.intp)
        i1 = np.minimum(i1, cells - 1).astype(np.intp)
        j1 = np.minimum(j1, cells - 1).astype(np.intp)
        may = np.flatnonzero((nearest <= limit * (1 + _SLACK)) & (i0 <= i1) & (j0 <= j1))
        wide, tall = i1[may] - i0[may] + 1, j1[may] - j0[may] + 1
        owner, place = expand(wide * tall)
        down, over = np.divmod(place, tall[owner])
        cell = (i0[may][owner] + down) * cells + j0[may][owner] + over
        grid = ((left, scale[0, octant]), (top, scale[1, octant]))
        touch = _touch(octant, i0[may][owner] + down, j0[may][owner] + over, grid, at[may][owner], surfaces, origin, normals)
        cell, owner = cell[touch], owner[touch]
        entries.append((octant * cells * cells + cell, at[may][owner]))
        hits[octant] = np.bincount(cell, minlength=cells * cells).reshape(cells, cells)
        # Sums over rectangles at once: is there anything listed but the object itself?
        total = np.zeros((cells + 1, cells + 1), dtype=np.intp)
        total[1:, 1:] = hits[octant].cumsum(axis=0).cumsum(axis=1)
        within = np.zeros(at.size, dtype=np.intp)
        within[may] = -np.bincount(owner, minlength=may.size)
        west, east, north, south = (m[receivers] for m in (i0, i1, j0, j1))
        others = within[receivers] + (
            total[east + 1, south + 1]
            - total[west, south + 1]
            - total[east + 1, north]
            + total[west, north]
        )
        safe[at[receivers]] &= others <= 0
    first = np.zeros(8 * cells * cells + 1, dtype=np.intp)
    np.cumsum(hits, out=first[1:])
    if entries:
        cell = np.concatenate([entry[0] for entry in entries])
        listed = np.concatenate([entry[1] for entry in entries])[np.argsort(cell, kind="stable")]
    else:
        listed = np.zeros(0, dtype=np.intp)
    many = np.diff(first)
    sole = np.where(many == 0, _NONE, _MANY)
    sole[many == 1] = listed[first[:-1][many == 1]]
    return LightPencil(
        position, side, scale, shift, cells, first, listed, sole, near * (1 - _SLACK), safe, normals
    )


def _separators(origin: Floats, surfaces: Surfaces) -> Triple:
    """Silhouette planes (6, B) of the boxes, seen from a light."""
    corners = np.array(box_corners(surfaces.min_pt, surfaces.max_pt)).reshape(8, -1, 3) - origin
    return silhouette_planes(
        (corners[:, :, 0], corners[:, :, 1], corners[:, :, 2]),
        origin,
        surfaces.min_pt,
        surfaces.max_pt,
    )


def _touch(
    octant: int,
    i: Ints,
    j: Ints,
    grid: tuple[tuple[float, float], tuple[float, float]],
    owner: Ints,
    surfaces: Surfaces,
    origin: Floats,
    normals: Triple,
) -> Ints:
    """Which cells (i, j) of an octant may meet their objects.

    A cell is the cone between four directions.  If a plane through the light
    has all four on one side and the object on the other, they do not meet: a
    box's silhouette planes, or the sphere's tangent plane towards the cell.
    """
    sign = [-1.0 if octant >> k & 1 == 0 else 1.0 for k in range(3)]
    corners = []
    for di, dj in ((-_SLACK, -_SLACK), (1 + _SLACK, -_SLACK), (-_SLACK, 1 + _SLACK), (1 + _SLACK, 1 + _SLACK)):
        a = (i + di) / grid[0][1] + grid[0][0]
        b = (j + dj) / grid[1][1] + grid[1][0]
        corners.append((sign[0] * a, sign[1] * b, sign[2] * (1 - a - b)))
    apart = np.zeros(owner.size, dtype=np.bool_)
    spheres = len(surfaces.radius)

    at = np.flatnonzero(owner < spheres)
    ball = owner[at]
    m = tuple((surfaces.center[ball, k] - origin[k]) for k in range(3))
    middle = tuple(corners[0][k][at] + corners[3][k][at] for k in range(3))
    length = np.sqrt(dot(m, m))
    with np.errstate(invalid="ignore", divide="ignore"):
        m = tuple(x / length for x in m)
        sine = surfaces.radius[ball] / length
        along = dot(middle, m)
        aside = tuple(x - along * y for x, y in zip(middle, m, strict=True))
        scale = np.sqrt(1 - sine * sine) / np.sqrt(dot(aside, aside))
        tangent = tuple(scale * x - sine * y for x, y in zip(aside, m, strict=True))
    # Not a number inside the sphere, or straight at it: then nothing is apart.
    apart[at] = np.all([dot(tangent, tuple(x[at] for x in corner)) > _SLACK for corner in corners], axis=0)

    at = np.flatnonzero(owner >= spheres)
    box = owner[at] - spheres
    for k in range(6):
        normal = tuple(m[k, box] for m in normals)
        limit = -_SLACK * (np.abs(normal[0]) + np.abs(normal[1]) + np.abs(normal[2]))
        apart[at] |= np.all([dot(normal, tuple(x[at] for x in corner)) < limit for corner in corners], axis=0)
    return np.flatnonzero(~apart)
