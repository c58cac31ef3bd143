"""What divides the surface that a cell of the picture sees: shadows, ridges and terminators.

Where each is follows from the point in the cell's middle, and from how points on
the plane that touches the surface there move across the cell.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from tracer.arrays import (
    Bools,
    Triple,
    columns,
    dot,
    each,
    entries,
    pick,
    rows,
    scaled,
    select,
)
from tracer.camera import Raster
from tracer.edges import BEND, Kind, Lines, Pencil, bowed, joined
from tracer.intersection import OUTSIDE
from tracer.lighting import Incoming, Lighting
from tracer.outlines import box_corners, silhouette_planes
from tracer.scene import Floats, Ints
from tracer.visibility import Group, Hits, View

__all__ = ["Surface", "footprint_of"]

# What a cell sees may reach so far from its middle, as a part of the way to a light.
_WIDE = 0.1


def _half_angle(raster: Raster, size: float) -> float:
    """Under which half of a cell of a size is seen, from corner to corner, in radians."""
    return 0.5 * size * float(np.hypot(raster.step_u, raster.step_v)) / raster.depth


def footprint_of(hits: Hits, group: Group, slope: Floats, size: float) -> Floats:
    """Radius (n,) on the surface, around each point, of what a cell of a size sees."""
    # Nearly edge-on, outlines mark the pixel anyway.
    return hits.p[2, group.part] * _half_angle(hits.raster, size) / np.maximum(slope, 0.02)


class Surface(NamedTuple):
    """What the centres of cells see, of one group.

    Attributes
    ----------
    view, lighting, hits, group
    cell : (n,)
        The cell of each point.
    footprint : (n,)
        See `footprint_of`.
    size : float
        Of the cells, in pixels.
    """

    view: View
    lighting: Lighting
    hits: Hits
    group: Group
    cell: Ints
    footprint: Floats
    size: float

    def height(self, at: Ints) -> Floats:
        """Height of the eye over the surface's tangent planes at some points: a number, or (n,)."""
        lift = select(self.group.lift, at)
        if self.group.flat:
            return lift
        p = rows(self.hits.p, self.group.part.start + at)
        return lift * p[2] / self.hits.raster.depth

    def steps(self, at: Ints, rays: Triple | None = None) -> tuple[Triple, Triple]:
        """How some points move on the planes that touch their surface, across their cells and down.

        With `rays` to them from elsewhere: how these change, but for their length.
        """
        raster, group = self.hits.raster, self.group
        p, n, height = rows(self.hits.p, group.part.start + at), pick(group.n, at), self.height(at)
        steps = []
        for k, step in enumerate((raster.step_u, raster.step_v)):
            # Along the window, and then along the sight as far as the plane needs.
            aside = p[2] / raster.depth * (step * self.size)
            ahead = aside * n[k] / height
            x, y, z = scaled(p, ahead)
            move = raster.turned((x + aside, y, z) if k == 0 else (x, y + aside, z))
            # At x across the cell the point is (p + x aside) / (1 - x ahead): times that divisor,
            # a ray to it is linear in x.
            steps.append(each(np.subtract, move, scaled(rays, ahead)) if rays else move)
        return steps[0], steps[1]

    def bow(self, at: Ints) -> Triple | None:
        """How far the steps leave the surface in the corners of some cells; on a plane, nowhere."""
        if self.group.flat:
            return None
        p = rows(self.hits.p, self.group.part.start + at)
        radius = select(self.group.of(self.view.surfaces.radius), at)
        # As far as the surface has turned from its tangent plane, along the ray.
        along = self.footprint[at] ** 2 / (2 * radius * self.height(at))
        return self.hits.raster.turned(scaled(p, along))

    def from_light(self, light: Ints | int, at: Ints) -> Triple:
        """Rays from lights to some points."""
        x, y, z = self.lighting.positions[light].T
        p = self.hits.points(self.group.part.start + at)
        return p[0] - x, p[1] - y, p[2] - z

    def shadows(self, light: Ints, at: Ints, other: Ints, several: Bools) -> Lines:
        """Edges of shadows; marks `several` where they are not straight."""
        surfaces, lights = self.view.surfaces, self.lighting.positions
        spheres = len(surfaces.radius)
        rays = self.from_light(light, at)
        pencil = Pencil(Kind.SHADOW, self.cell[at], rays, *self.steps(at, rays), self.bow(at))
        on = np.flatnonzero(other < spheres)
        ball = other[on]
        center = columns(surfaces.center[ball] - lights[light[on]], slice(None))
        radius = surfaces.radius[ball]
        discs, turn, near = pencil.take(on).discs(center, radius)
        side = entries(self.lighting.shadows.occluders.side, light[on], ball)
        # A cell that sees more than the sphere is large may hold all of its shadow.
        odd = (turn > BEND) | (side != OUTSIDE) | (self.footprint[at[on]] > radius)
        several[discs.cell[odd & near]] = True
        on = np.flatnonzero(other >= spheres)
        if not on.size:
            return discs.crossing()
        # Every box and light once.
        pair, place = np.unique(light[on] * len(surfaces) + other[on], return_inverse=True)
        number, box = np.divmod(pair, len(surfaces))
        box, apex = box - spheres, lights[number]
        low, high = surfaces.min_pt[box], surfaces.max_pt[box]
        planes = silhouette_planes(box_corners(low, high, apex), apex, low, high)
        planes = each(lambda m: m.take(place, axis=1), planes)
        unknown = ~np.any([m != 0 for m in planes], axis=0).all(axis=0)
        several[pencil.cell[on[unknown]]] = True
        edges, turn = pencil.take(on).boxes(planes)
        several[edges.cell[turn > BEND]] = True
        return joined([discs.crossing(), edges])

    def wide(self, light: Incoming, slope: Floats) -> Iterator[Ints]:
        """Points around which a cell sees so much of the surface, as a light is near.

        `slope`: cosines between the normal and the way to the eye.
        """
        width = self.hits.p[2, self.group.part] * (_half_angle(self.hits.raster, self.size) / _WIDE)
        for length2 in light.length2:
            # Most points are told by the most that any of them needs.
            at = np.flatnonzero(slope <= width.max() / np.sqrt(length2.min()))
            yield at[width[at] ** 2 > slope[at] ** 2 * length2[at]]

    def turning(self, light: Incoming) -> tuple[Ints, Ints]:
        """Lights, and points at which a sphere turns away from them."""
        reach = self.footprint / self.group.of(self.view.surfaces.radius)
        # Most points are told by the least that any of them needs.
        most = reach.max() * np.sqrt(light.length2.max(initial=0))
        number, at = np.divmod(np.flatnonzero(np.abs(light.falls) <= most), reach.size)
        falls, length2 = light.falls[number, at], light.length2[number, at]
        turns = np.flatnonzero(falls**2 < reach[at] ** 2 * length2)
        return number[turns], at[turns]

    def kinks(self, light: Ints, at: Ints, tolerance: float) -> Ints:
        """Where light begins so fast, as spheres are `turning`, that one sample is off by more."""
        lighting, group = self.lighting, self.group
        # On either side of the middle by a quarter of the cell, half of the time.
        radius = select(group.of(self.view.surfaces.radius), at)
        diffuse = lighting.materials.diffuse.max(axis=0)[lighting.shader]
        change = self.footprint[at] / radius / 8 * select(group.of(diffuse), at)
        kinks: Ints = at[change * lighting.intensities.max(axis=1)[light] > tolerance]
        return kinks

    def terminators(
        self, incoming: Incoming, light: Ints, at: Ints, several: Bools
    ) -> Iterator[Lines]:
        """Where a highlight ends because spheres are `turning` away from its light.

        Marks `several` where that is no straight line.
        """
        lighting, group = self.lighting, self.group
        glossy = group.of(lighting.materials.glossy[lighting.shader])
        shines = np.flatnonzero(np.broadcast_to(select(glossy, at), at.shape))
        if not shines.size:
            return
        light, at = light[shines], at[shines]
        ray, r = self.from_light(light, at), -select(group.of(self.view.surfaces.radius), at)
        across, down = self.steps(at)
        kind = np.full(at.size, Kind.SHADOW)
        a, b, c = dot(across, ray) / r, dot(down, ray) / r, incoming.falls[light, at]
        lines = Lines(self.cell[at], kind, a, b, c)
        slope = each(lambda d, n: d / r - n, ray, self.hits.raster.turned(pick(group.n, at)))
        several[lines.cell[bowed(lines, slope, self.bow(at)) > BEND]] = True
        yield lines.crossing()

    def ridges(self) -> Iterator[Lines]:
        """Where a box's face meets another that is seen as well."""
        surfaces, eye, group = self.view.surfaces, self.view.raster.eye, self.group
        p = rows(self.hits.p, group.part)
        box = group.owner - len(surfaces.radius)
        for k in range(3):
            across_face = group.face != k
            if not np.any(across_face):
                continue
            for corner, sign in ((surfaces.min_pt, -1), (surfaces.max_pt, 1)):
                shown = self.view.eye_inside[group.owner] | (sign * (eye[k] - corner[box, k]) > 0)
                if not shown.any():
                    continue
                offset = eye[k] + self.hits.raster.component(p, k) - group.spread(corner[box, k])
                near = (np.abs(offset) < self.footprint) & across_face
                at = np.flatnonzero(near & group.spread(shown))
                offset, kind = offset[at], np.full(at.size, Kind.RIDGE)
                across, down = self.steps(at, (offset, offset, offset))
                yield Lines(self.cell[at], kind, across[k], down[k], offset).crossing()
