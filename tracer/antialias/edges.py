"""Edges that may cross cells, with their margins: silhouettes, shadows, creases, terminators.

The *footprint* of a cell is the radius of what it sees of a surface.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tracer.antialias.lines import Kind
from tracer.antialias.margins import (
    Margins,
    Sheets,
    box_margins,
    rays,
    sheets,
    sphere_margins,
    terminator_margins,
)
from tracer.arrays import Floats, Ints, Triple, columns, dot, each, entries, indices, pick, select
from tracer.light.lighting import Incoming, Lighting
from tracer.scene.model import Surfaces
from tracer.shadow.occlusion import ShadowEdges
from tracer.shapes.rounding import INSIDE
from tracer.shapes.silhouette import box_corners, silhouette_planes
from tracer.view.camera import Raster
from tracer.view.hits import Group, Visible
from tracer.view.view import View

__all__ = ["Views", "footprints_of", "silhouettes"]

# Towards a face's horizon footprints are lengthened, by a factor of at most one over this.
_NEARLY = 1e-3


def _half_angle(raster: Raster, size: float) -> float:
    """Angle under which the eye sees half the diagonal of a cell of a size, in radians."""
    return 0.5 * size * float(np.hypot(raster.step_u, raster.step_v)) / raster.depth


def footprints_of(hits: Visible, radius: Floats, size: float) -> Floats:
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


def silhouettes(
    view: View, cell: Ints, owner: Ints, x: Floats, y: Floats, size: float
) -> list[Margins]:
    """Silhouettes of objects seen from the eye, in pairs of a cell and its object.

    `x`, `y` (n,): the cells' middles in the picture, in pixels; `size`: their width.
    """
    spheres, boxes = view.spheres, view.boxes
    d = rays(view.raster, view.raster.across(x), view.raster.down(y), size)
    found = []
    at = indices(owner < boxes.first)
    if at.size:
        ball = owner[at]
        value = sphere_margins(
            _columns(d, at),
            pick(spheres.local, ball),
            spheres.radius[ball],
            spheres.power[ball],
        )
        found.append(_margins(cell[at], Kind.SILHOUETTE, value))
    at = indices(owner >= boxes.first)
    if at.size:
        a, b, c = each(lambda m: m.take(owner[at] - boxes.first, axis=1), boxes.planes)
        which, value = box_margins((a, b, c / view.raster.depth), _columns(d, at))
        found.append(_margins(cell[at[which]], Kind.EDGE, value))
    return found


def _columns(d: Triple, at: Ints) -> Triple:
    """Some of the rays."""
    return d[0][:, at], d[1][:, at], d[2][..., at]


def _margins(cell: Ints, kind: Kind, value: Floats) -> Margins:
    return Margins(cell, np.full(cell.size, kind), value)


class Views(NamedTuple):
    """Cells that see surfaces: of each hit, the cell and what it sees.

    Attributes
    ----------
    lighting, hits
    sheets : Sheets
        The surfaces that are seen.
    cell : (n,)
        The cell of each hit.
    footprint : (n,)
        See `footprints_of`.
    size : float
        Width of the cells, in pixels.
    """

    lighting: Lighting
    hits: Visible
    sheets: Sheets
    cell: Ints
    footprint: Floats
    size: float

    @property
    def surfaces(self) -> Surfaces:
        """Those of the scene."""
        return self.lighting.view.surfaces

    def rays(self, at: Ints) -> tuple[Triple, Floats]:
        """Rays through the cells of some hits, three (6, n), and where they meet what is seen.

        The latter (6, n) as `Sheets.inverse` says.
        """
        raster = self.hits.view.raster
        ahead = raster.depth / self.hits.p[2][at]
        s, g = self.hits.p[0][at] * ahead, self.hits.p[1][at] * ahead
        d = rays(raster, s, g, self.size)
        return d, self.sheets.take(at).inverse(d)

    def intersections(self, behind: Visible) -> list[Margins]:
        """Where surfaces meet those close `behind`."""
        if not behind.groups:
            return []
        place = np.empty(int(self.hits.sample.max()) + 1, dtype=np.intp)
        place[self.hits.sample] = np.arange(self.hits.p.shape[1])
        at = place[behind.sample]
        d, inverse = self.rays(at)
        value = inverse - sheets(behind).inverse(d)
        return [_margins(self.cell[at], Kind.EDGE, value)]

    def shadows(self, found: ShadowEdges) -> list[Margins]:
        """Edges of shadows, given what may shade around hits."""
        if not found.point.size:
            return []
        lighting, spheres = self.lighting, self.surfaces.sphere_count
        point, number, occluder = found.point, found.light, found.occluder
        d, inverse = self.rays(point)
        light = columns(lighting.local, number)
        q = each(lambda d, place: d - place * inverse, d, light)
        margins = []
        on = indices(occluder < spheres)
        if on.size:
            ball = occluder[on]
            center = each(np.subtract, pick(lighting.view.spheres.local, ball), pick(light, on))
            radius = self.surfaces.radius[ball]
            distance = np.sqrt(dot(center, center))
            power = (distance - radius) * (distance + radius)
            inside = entries(lighting.occluders.side, number[on], ball) == INSIDE
            power = np.where(inside, np.nan, np.maximum(power, 0))
            value = sphere_margins(_columns(q, on), center, radius, power)
            margins.append(_margins(self.cell[point[on]], Kind.SHADOW, value))
        on = indices(occluder >= spheres)
        if on.size:
            planes = self._silhouettes_from_lights(number[on], occluder[on] - spheres)
            at, value = box_margins(planes, _columns(q, on))
            margins.append(_margins(self.cell[point[on[at]]], Kind.SHADOW, value))
        return margins

    def _silhouettes_from_lights(self, light: Ints, box: Ints) -> Triple:
        """Planes, three (6, n), through lights and silhouettes of boxes, in the camera's axes."""
        # Found once for each pair of a light and a box.
        pair, place = np.unique(light * len(self.surfaces) + box, return_inverse=True)
        light, box = np.divmod(pair, len(self.surfaces))
        apex = self.lighting.positions[light]
        low, high = self.surfaces.min_pt[box], self.surfaces.max_pt[box]
        planes, _ = silhouette_planes(box_corners(low, high, apex), apex, low, high)
        u, v, w = (dot((x, y, z), planes) for x, y, z in self.hits.view.raster.axes)
        return each(lambda m: m.take(place, axis=1), (u, v, w))

    def terminators(self, group: Group, incoming: Incoming) -> list[Margins]:
        """Lines at which lights, and their highlights, begin on the spheres of a group.

        `incoming`: at all hits.
        """
        n_dot_l, length2 = incoming.n_dot_l[:, group.part], incoming.length2[:, group.part]
        turn = self.footprint[group.part] / group.of(self.surfaces.radius)
        number, at = np.nonzero(n_dot_l * n_dot_l < turn * turn * length2)
        if not at.size:
            return []
        lit = n_dot_l[number, at] > 0
        d, inverse = self.rays(group.part.start + at)
        center = each(lambda m: select(group.of(m), at), self.lighting.view.spheres.local)
        value = terminator_margins(d, inverse, center, columns(self.lighting.local, number))
        # What may shade the surface has been sought only for lights that the cell's middle faces.
        kind = np.where(lit, Kind.SHADOW, Kind.EDGE)
        return [Margins(self.cell[group.part][at], kind, value)]

    def creases(self, group: Group) -> list[Margins]:
        """Where faces of boxes, those of a group, meet others that are seen as well."""
        view, raster, surfaces = self.lighting.view, self.hits.view.raster, self.surfaces
        eye = raster.eye
        x, y, z = self.hits.p[:, group.part]
        footprint = self.footprint[group.part]
        box = group.owner - surfaces.sphere_count
        found = []
        for k in range(3):
            across_face = group.face != k
            if not np.any(across_face):
                continue
            u, v, w = raster.axes[:, k]
            height = raster.scene_component((x, y, z), k)
            for corner, sign in ((surfaces.min_pt, -1), (surfaces.max_pt, 1)):
                level = corner[box, k] - eye[k]
                shown = view.eye_inside[group.owner] | (sign * level < 0)
                if not shown.any():
                    continue
                near = np.abs(height - group.spread(level)) < footprint
                at = indices(near & across_face & group.spread(shown))
                if at.size:
                    d, inverse = self.rays(group.part.start + at)
                    value = inverse - dot((u, v, w), d) / select(group.spread(level), at)
                    found.append(_margins(self.cell[group.part][at], Kind.EDGE, value))
        return found
