"""Which points a light reaches: one pencil from each light.

All shadow segments end at a light, so seen from there an object can only block
points in the directions it covers.  Two ways lead to the few pairs that can
meet: the cells around the light, for points anywhere, and for a large plane
the intervals of its picture rows.  Both end in the same exact test.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from tracer.camera import Raster
from tracer.cells import NONE, Cells, Extents, list_objects
from tracer.groups import Bools, Index, Triple, dot, each, pick, select
from tracer.intersection import (
    INSIDE,
    ON,
    SURFACE_TOLERANCE,
    box_blocks,
    sphere_blocks,
    sphere_side,
)
from tracer.pencil import box_corners, silhouette_planes
from tracer.planar import shade_intervals
from tracer.scene import Floats, Ints, Surfaces
from tracer.visibility import Hits

__all__ = ["LightPencil", "Occluders", "Points", "light_pencil", "occluders_of"]

# Intervals on a plane's rows pay when they are this many times fewer than samples.
_PLANE_WORTH = 8


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
    extents : Extents
    size : (n,)
        What a point's tolerance at each object scales with.
    """

    raster: Raster
    surfaces: Surfaces
    eye_inside: Bools
    extents: Extents
    size: Floats


@dataclass(frozen=True, slots=True)
class Points:
    """Those points of some hits that face a light.

    Attributes
    ----------
    hits : Hits
    facing
        Which of them.
    to_light : three (n,)
        From these points to the light.
    """

    hits: Hits
    facing: Ints | slice
    to_light: Triple

    @property
    def size(self) -> int:
        """How many."""
        return self.hits.t.size if isinstance(self.facing, slice) else self.facing.size

    @property
    def own(self) -> Index:
        """The object that each lies on."""
        return select(self.hits.owner, self.facing)

    def take(self, index: Ints) -> tuple[Triple, Triple, Floats]:
        """Some points, their way to the light, and what their rounding scales with.

        That is, for each, its distances from the origin and from the eye.
        """
        of = index if isinstance(self.facing, slice) else self.facing[index]
        p, ray = pick(self.hits.p, of), pick(self.hits.direction, of)
        reach = self.hits.t[of] * np.sqrt(dot(ray, ray)) + sum(each(np.abs, p))
        return p, pick(self.to_light, index), reach


@dataclass(frozen=True, slots=True)
class LightPencil:
    """What a light may be kept from, and by what.

    Attributes
    ----------
    position : (3,)
    side : (n,)
        Where the light is to each sphere: `OUTSIDE`, `ON` or `INSIDE`; to each
        box `INSIDE`, or else `ON`.
    silhouettes : three (6, B)
        Planes through the light around every box.
    cells : Cells
    """

    position: Floats
    side: NDArray[np.int8]
    silhouettes: Triple
    cells: Cells

    def blocked(self, occluders: Occluders, points: Points, *, by_rows: bool) -> Bools:
        """Whether another object than their own keeps points from the light.

        `by_rows`: by intervals of rows, where they all lie on a large plane.
        """
        result = np.zeros(points.size, dtype=np.bool_)
        plane, count = points.hits.plane, len(occluders.surfaces)
        if by_rows and plane and count * plane.g.size * _PLANE_WORTH <= result.size:
            own = points.hits.owner
            if self.cells.safe[own]:
                return result
            shade = shade_intervals(
                occluders.raster,
                plane,
                self.position,
                occluders.surfaces,
                np.delete(np.arange(count), own),
                self.silhouettes,
            )
            result |= shade.certain
            point, other = shade.sample, shade.occluder
        else:
            point, other = self._candidates(points)
        result[point[self._blocks(occluders, points, point, other)]] = True
        return result

    def grazed(self, occluders: Occluders, points: Points, footprint: Floats) -> Bools:
        """Whether `blocked` may change within a distance (n,) of each point.

        An object that blocks when it is larger by as much, and does not when
        smaller by as much, has the edge of its shadow there.
        """
        result = np.zeros(footprint.size, dtype=np.bool_)
        point, other = self._candidates(points, footprint)
        may = self._blocks(occluders, points, point, other, footprint[point])
        point, other = point[may], other[may]
        must = self._blocks(occluders, points, point, other, -footprint[point])
        result[point[~must]] = True
        return result

    def _candidates(self, points: Points, footprint: Floats | None = None) -> tuple[Ints, Ints]:
        """Pairs (point, object) that the cells do not rule out.

        With a footprint (n,), also those of cells as far away as that.
        """
        if footprint is not None:
            pairs = [self._candidates(points)]
            for signs in product((-1.0, 1.0), repeat=3):
                x, y, z = (
                    d + sign * footprint for d, sign in zip(points.to_light, signs, strict=True)
                )
                pairs.append(self._candidates(Points(points.hits, points.facing, (x, y, z))))
            point, other = (np.concatenate(part) for part in zip(*pairs, strict=True))
            # Each pair once.
            pair = np.unique(point * len(self.side) + other)
            return np.divmod(pair, len(self.side))
        own = points.own
        asked = ~self.cells.safe[own]
        if not asked.any():
            none = np.zeros(0, dtype=np.intp)
            return none, none
        distance, cell = self.cells.locate(points.to_light)
        # Most cells hold nothing, or the object itself.
        sole = self.cells.sole[cell]
        point = np.flatnonzero(asked & (sole != NONE) & (sole != own))
        owner, other = self.cells.objects(cell[point])
        point = point[owner]
        keep = other != select(own, point)
        keep &= self.cells.near[other] <= distance[point]
        return point[keep], other[keep]

    def _blocks(
        self,
        occluders: Occluders,
        points: Points,
        point: Ints,
        other: Ints,
        larger: Floats | None = None,
    ) -> Bools:
        """Whether objects keep points from the light, pair by pair.

        `larger` (pairs,) is added to the objects' sizes on all sides.
        """
        surfaces = occluders.surfaces
        p, to_light, reach = points.take(point)
        side = self.side[other]
        reach = np.where(side == ON, np.maximum(reach, np.abs(self.position).sum()), reach)
        tolerance = SURFACE_TOLERANCE * (reach + occluders.size[other])
        larger = np.zeros(other.size) if larger is None else larger
        result = np.empty(other.size, dtype=np.bool_)
        spheres = len(surfaces.radius)

        at = np.flatnonzero(other < spheres)
        ball = other[at]
        center = surfaces.center[ball]
        result[at] = sphere_blocks(
            pick(to_light, at),
            each(np.subtract, (center[:, 0], center[:, 1], center[:, 2]), pick(p, at)),
            np.maximum(surfaces.radius[ball] + larger[at], 0),
            tolerance[at],
            side[at],
            occluders.eye_inside[ball],
        )
        at = np.flatnonzero(other >= spheres)
        low = surfaces.min_pt[other[at] - spheres] - larger[at, None]
        high = surfaces.max_pt[other[at] - spheres] + larger[at, None]
        result[at] = box_blocks(
            pick(p, at),
            (self.position[0], self.position[1], self.position[2]),
            (low[:, 0], low[:, 1], low[:, 2]),
            (high[:, 0], high[:, 1], high[:, 2]),
            tolerance[at],
        )
        # A box smaller than nothing is none.
        result[at] &= (low <= high).all(axis=1)
        return result


def occluders_of(raster: Raster, surfaces: Surfaces, eye_inside: Bools, seen: Bools) -> Occluders:
    """Gather spheres and boxes; `seen` (n,) are those that may be in the picture."""
    center, radius = surfaces.center.T, surfaces.radius
    extents = Extents(
        np.concatenate([center - radius, surfaces.min_pt.T], axis=1),
        np.concatenate([center + radius, surfaces.max_pt.T], axis=1),
        seen,
    )
    corner = np.maximum(np.abs(surfaces.min_pt), np.abs(surfaces.max_pt))
    size = np.concatenate([np.abs(center).sum(axis=0) + radius, corner.sum(axis=1)])
    return Occluders(raster, surfaces, eye_inside, extents, size)


def light_pencil(position: tuple[float, float, float], occluders: Occluders) -> LightPencil:
    """Prepare a light for its shadows."""
    surfaces, light = occluders.surfaces, np.array(position)
    x, y, z = (surfaces.center - light).T
    spheres = len(surfaces.radius)
    size = np.abs(light).sum() + occluders.size[:spheres]
    strictly = ((surfaces.min_pt < light) & (light < surfaces.max_pt)).all(axis=1)
    side = np.concatenate(
        [
            sphere_side(np.sqrt(x * x + y * y + z * z), surfaces.radius, SURFACE_TOLERANCE * size),
            np.where(strictly, INSIDE, ON).astype(np.int8),
        ]
    )
    x, y, z = np.moveaxis(np.array(box_corners(surfaces.min_pt, surfaces.max_pt)) - light, 2, 0)
    silhouettes = silhouette_planes((x, y, z), light, surfaces.min_pt, surfaces.max_pt)
    cells = list_objects(light, surfaces, occluders.extents, silhouettes)
    return LightPencil(light, side, silhouettes, cells)
