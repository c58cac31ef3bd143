"""What divides the surface that a cell of the picture sees: shadows, ridges and terminators.

A ridge is where two faces of a box meet, a terminator where light begins on a
sphere.  The *footprint* of a cell is the radius of what it sees of a surface.

Each line's place follows from the point seen in the cell's middle, and from how
points of the tangent plane there move across the cell.  Where straight lines do
not tell all, the cell is marked `unresolved`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tracer.antialias.edges import Kind, Lines, Pencil, joined, sagitta_error
from tracer.arrays import (
    Bools,
    Floats,
    Ints,
    Triple,
    columns,
    dot,
    each,
    entries,
    indices,
    pick,
    rows,
    scaled,
    select,
)
from tracer.light.lighting import Incoming, Lighting
from tracer.scene.model import Surfaces
from tracer.shadow.occluders import ShadowEdges
from tracer.shapes.rounding import OUTSIDE
from tracer.shapes.silhouette import box_corners, silhouette_planes
from tracer.view.camera import Raster
from tracer.view.hits import Group, Hits

__all__ = ["Patches", "footprints_of", "intersections", "near_lights"]

# Cells with a larger footprint than this, as a part of the distance to a light, are split.
_WIDE = 0.1

# Towards a face's horizon footprints are lengthened, by a factor of at most one over this.
_NEARLY = 1e-3


def _half_angle(raster: Raster, size: float) -> float:
    """Angle under which the eye sees half the diagonal of a cell of a size, in radians."""
    return 0.5 * size * float(np.hypot(raster.step_u, raster.step_v)) / raster.depth


def footprints_of(hits: Hits, radius: Floats, size: float) -> Floats:
    """Footprints (n,): radii, around all points, of what cells of a size see.

    `radius`: of all spheres.
    """
    angle = _half_angle(hits.view.raster, size)
    halves = hits.p[2] * angle
    footprints = np.empty(halves.size)
    for group in hits.groups:
        half, footprint = halves[group.part], footprints[group.part]
        _, n_dot_v = hits.distance_and_cosine(group)
        if group.flat:
            # The far end of the cell sees the face at a smaller cosine: by up to the angle.
            footprint[:] = half / n_dot_v / np.maximum(1 - angle / n_dot_v, _NEARLY)
            continue
        footprint[:] = half / n_dot_v
        # However small the cosine, from the limb a width of `half` covers no more of the sphere
        # than sqrt(2 half radius): a bound that only the few points next to the limb need.
        of_sphere = group.of(radius)
        at = indices(n_dot_v <= np.sqrt(half.max() / (2 * np.min(of_sphere))))
        footprint[at] = np.fmin(footprint[at], np.sqrt(2 * half[at] * select(of_sphere, at)))
    return footprints


def near_lights(incoming: Incoming, footprint: Floats) -> Ints:
    """Points with so large a `footprint` (n,), or so near to a light, that cells must be split."""
    return indices(np.any(incoming.length2 < (footprint / _WIDE) ** 2, axis=0))


def intersections(
    hits: Hits,
    behind: Hits,
    surfaces: Surfaces,
    cell: Ints,
    size: float,
    tolerance: float,
    unresolved: Bools,
) -> Lines:
    """Where surfaces meet those close `behind`; marks `unresolved` where that is no straight line.

    In units of the ray's direction d, the distance t of a plane is n.p / n.d: 1 / t is linear in
    the picture.  The two surfaces meet on the line where their 1 / t are equal.

    `cell`: the cell of each sample, as in `unresolved`.
    """
    if not behind.groups:
        return joined([])
    raster = hits.view.raster
    place = np.empty(cell.size, dtype=np.intp)
    place[hits.sample] = np.arange(hits.p.shape[1])
    sample = behind.sample
    first, off_first = _inverse(hits, surfaces, place[sample], size)
    second, off_second = _inverse(behind, surfaces, np.arange(sample.size), size)
    d = scaled(rows(behind.p, slice(None)), raster.depth / behind.p[2])
    u, v, w = each(np.subtract, first, second)
    a, b, c = u * raster.step_u * size, v * raster.step_v * size, dot((u, v, w), d)
    lines = Lines(cell[sample], np.full(sample.size, Kind.EDGE), a, b, c)
    off = off_first + off_second
    return lines.straightened(lines.turn(off), tolerance, unresolved)


def _inverse(hits: Hits, surfaces: Surfaces, at: Ints, size: float) -> tuple[Triple, Floats]:
    """Vectors whose product with a ray is 1 / t on its surface; errors of that in cells' corners.

    `at` (n,): which of the hits; a sphere counts as its tangent plane, which causes the errors.
    """
    vectors, off = np.empty((3, at.size)), np.zeros(at.size)
    for group in hits.groups:
        here = indices((at >= group.part.start) & (at < group.part.stop))
        p, n = rows(hits.p, at[here]), pick(group.n, at[here] - group.part.start)
        height = dot(n, p)
        for out, component in zip(vectors, n, strict=True):
            out[here] = component / height
        if not group.flat:
            radius = select(group.of(surfaces.radius), at[here] - group.part.start)
            # By how much the sphere leaves its tangent plane, measured along the ray.
            reach2 = (p[2] * _half_angle(hits.view.raster, size)) ** 2 * dot(p, p) / height**2
            off[here] = reach2 / (2 * radius * np.abs(height)) * hits.view.raster.depth / p[2]
    return (vectors[0], vectors[1], vectors[2]), off


class Patches(NamedTuple):
    """What cells see of one group of hits: the surface around the point in each cell's middle.

    Attributes
    ----------
    lighting, hits, group
    cell : (n,)
        The cell of each point.
    footprint : (n,)
        See `footprints_of`.
    size : float
        Width of the cells, in pixels.
    tolerance : float
        See `looks.Cells`.
    """

    lighting: Lighting
    hits: Hits
    group: Group
    cell: Ints
    footprint: Floats
    size: float
    tolerance: float

    def height(self, at: Ints) -> Floats:
        """Height of the eye over the surface's tangent planes at some points: a number, or (n,)."""
        return select(self.group.height, at)

    def steps(self, at: Ints, rays: Triple | None = None) -> tuple[Triple, Triple]:
        """Steps of some points on their tangent planes, across their cells and down.

        They are ray differentials (Igehy 1999), in the scene's axes.  With `rays`, which lead to
        the points from elsewhere: steps of these rays, up to their length.
        """
        raster, group = self.hits.view.raster, self.group
        p, n, height = rows(self.hits.p, group.part.start + at), pick(group.n, at), self.height(at)
        steps = []
        for k, step in enumerate((raster.step_u, raster.step_v)):
            # Parallel to the window, and then along the sight until back on the plane.
            aside = p[2] / raster.depth * (step * self.size)
            ahead = aside * n[k] / height
            x, y, z = scaled(p, ahead)
            move = raster.vector_to_scene((x + aside, y, z) if k == 0 else (x, y + aside, z))
            # At x across the cell the point is (p + x aside) / (1 - x ahead): times that divisor,
            # a ray to it is linear in x.
            steps.append(each(np.subtract, move, scaled(rays, ahead)) if rays else move)
        return steps[0], steps[1]

    def sagitta(self, at: Ints) -> Triple | None:
        """Vectors from the tangent plane to the surface in some cells' corners; None if flat."""
        if self.group.flat:
            return None
        p = rows(self.hits.p, self.group.part.start + at)
        radius = select(self.group.of(self.lighting.view.surfaces.radius), at)
        # By how much the sphere leaves its tangent plane, measured along the ray.
        along = self.footprint[at] ** 2 / (2 * radius * self.height(at))
        return self.hits.view.raster.vector_to_scene(scaled(p, along))

    def from_light(self, light: Ints, at: Ints) -> Triple:
        """Rays from lights to some points."""
        x, y, z = self.lighting.positions[light].T
        p = self.hits.points(self.group.part.start + at)
        return p[0] - x, p[1] - y, p[2] - z

    def shadows(self, found: ShadowEdges, unresolved: Bools) -> Lines:
        """Edges of shadows, given what may shade around all hits.

        Marks `unresolved` where they are not straight.
        """
        part = self.group.part
        here = indices((found.point >= part.start) & (found.point < part.stop))
        if not here.size:
            return joined([])
        light, at, occluder = (
            found.light[here],
            found.point[here] - part.start,
            found.occluder[here],
        )
        surfaces, lights = self.lighting.view.surfaces, self.lighting.positions
        spheres = surfaces.sphere_count
        rays = self.from_light(light, at)
        pencil = Pencil(Kind.SHADOW, self.cell[at], rays, *self.steps(at, rays), self.sagitta(at))
        on = indices(occluder < spheres)
        ball = occluder[on]
        center = columns(surfaces.center[ball] - lights[light[on]], slice(None))
        radius = surfaces.radius[ball]
        discs, turn, near = pencil.take(on).discs(center, radius)
        side = entries(self.lighting.shadows.occluders.side, light[on], ball)
        # A footprint larger than the sphere may hold the whole of its shadow.
        turn[(side != OUTSIDE) | (self.footprint[at[on]] > radius)] = np.inf
        discs = discs.straightened(turn, self.tolerance, unresolved, near)
        on = indices(occluder >= spheres)
        if not on.size:
            return discs
        # Silhouettes are found once for each pair of a light and a box.
        pair, place = np.unique(light[on] * len(surfaces) + occluder[on], return_inverse=True)
        number, box = np.divmod(pair, len(surfaces))
        box, apex = box - spheres, lights[number]
        low, high = surfaces.min_pt[box], surfaces.max_pt[box]
        planes, _ = silhouette_planes(box_corners(low, high, apex), apex, low, high)
        planes = each(lambda m: m.take(place, axis=1), planes)
        edges, turn, unknown = pencil.take(on).boxes(planes)
        unresolved[pencil.cell[on[unknown]]] = True
        return joined([discs, edges.straightened(turn, self.tolerance, unresolved)])

    def _near_terminator(self, incoming: Incoming) -> tuple[Ints, Ints]:
        """Pairs of a light and a point of a sphere whose footprint the terminator may cross."""
        reach = self.footprint / self.group.of(self.lighting.view.surfaces.radius)
        # One bound for all points leaves few of them to look at one by one.
        most = reach.max() * np.sqrt(incoming.length2.max(initial=0))
        number, at = np.divmod(indices(np.abs(incoming.n_dot_l) <= most), reach.size)
        n_dot_l, length2 = incoming.n_dot_l[number, at], incoming.length2[number, at]
        turns = indices(n_dot_l**2 < reach[at] ** 2 * length2)
        return number[turns], at[turns]

    def terminators(self, incoming: Incoming, unresolved: Bools) -> Lines:
        """Lines at which lights, and their highlights, begin on spheres.

        Marks `unresolved` where they are not straight.
        """
        light, at = self._near_terminator(incoming)
        if not at.size:
            return joined([])
        lighting, group = self.lighting, self.group
        ray, r = self.from_light(light, at), -select(group.of(lighting.view.surfaces.radius), at)
        across, down = self.steps(at)
        a, b, c = dot(across, ray) / r, dot(down, ray) / r, incoming.n_dot_l[light, at]
        # The look has sought what may shade the surface only for lights that its middle faces.
        kind = np.where(c > 0, Kind.SHADOW, Kind.EDGE)
        lines = Lines(self.cell[at], kind, a, b, c)
        normal = self.hits.view.raster.vector_to_scene(pick(group.n, at))
        gradient = each(lambda d, n: d / r + n, ray, normal)
        off = sagitta_error(gradient, self.sagitta(at))
        return lines.straightened(lines.turn(off), self.tolerance, unresolved)

    def ridges(self) -> Lines:
        """Where a box's face meets another that is seen as well."""
        view, group = self.lighting.view, self.group
        surfaces, eye = view.surfaces, view.raster.eye
        p = rows(self.hits.p, group.part)
        box = group.owner - surfaces.sphere_count
        lines = []
        for k in range(3):
            across_face = group.face != k
            if not np.any(across_face):
                continue
            for corner, sign in ((surfaces.min_pt, -1), (surfaces.max_pt, 1)):
                shown = view.eye_inside[group.owner] | (sign * (eye[k] - corner[box, k]) > 0)
                if not shown.any():
                    continue
                offset = eye[k] + view.raster.scene_component(p, k) - group.spread(corner[box, k])
                near = (np.abs(offset) < self.footprint) & across_face
                at = indices(near & group.spread(shown))
                offset, kind = offset[at], np.full(at.size, Kind.EDGE)
                # Of a ray from the plane to the point only component k is known, and used.
                across, down = self.steps(at, (offset, offset, offset))
                ridge = Lines(self.cell[at], kind, across[k], down[k], offset)
                lines.append(ridge.crossing())
        return joined(lines)
