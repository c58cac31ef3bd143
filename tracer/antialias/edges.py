"""Edges that may cross cells, as margins: silhouettes, shadows, creases, terminators.

The *footprint* of a cell is the radius of what it sees of a surface.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from tracer.antialias.margins import Margins, Sheets, rays, span
from tracer.arrays import Floats, Ints, Triple, columns, dot, each, indices, pick, select
from tracer.shapes.silhouette import box_margins, silhouette_planes, sphere_margins
from tracer.view.view import View, Visible

# Towards a face's horizon footprints are lengthened, by a factor of at most one over this.
_NEARLY = 1e-3


def footprints_of(hits: Visible, size: float) -> Floats:
    """Footprints (n,): radii, around all points, of what cells of a size see."""
    raster = hits.view.raster
    # Under this angle, in radians, the eye sees half the diagonal of a cell.
    angle = 0.5 * size * float(np.hypot(raster.step_u, raster.step_v)) / raster.depth
    halves, distance = hits.p[2] * angle, hits.distance
    footprints = np.empty(halves.size)
    for group in hits.groups:
        half, footprint = halves[group.part], footprints[group.part]
        n_dot_v = group.height / distance[group.part]
        np.divide(half, n_dot_v, out=footprint)
        if group.flat:
            # The far end of the cell sees the face at a smaller cosine: by up to the angle.
            footprint /= np.maximum(1 - angle / n_dot_v, _NEARLY)
            continue
        # However small the cosine, from the silhouette a width of `half` covers no more of the
        # sphere than sqrt(2 half radius): a bound that only the few points next to it need.
        curvature = group.of(hits.view.curvature)
        at = indices(n_dot_v <= np.sqrt(half.max() * np.max(curvature) / 2))
        footprint[at] = np.fmin(footprint[at], np.sqrt(2 * half[at] / select(curvature, at)))
    return footprints


def silhouettes(
    view: View, cell: Ints, owner: Ints, x: Floats, y: Floats, size: float
) -> Iterator[Margins]:
    """Silhouettes of objects seen from the eye, in pairs of a cell and its object.

    `x`, `y` (n,): the cells' middles in the picture, in pixels; `size`: their width.
    """
    d = rays(view.raster, view.raster.across(x), view.raster.down(y), size)
    zero = np.zeros(cell.size)
    a, b, c = view.boxes.planes

    def planes(at: Ints) -> Triple:
        box = owner[at] - view.boxes.first
        return a[:, box], b[:, box], c[:, box] / view.raster.depth

    yield from _silhouettes(view, cell, owner, d, (zero, zero, zero), planes)


def _silhouettes(
    view: View, cell: Ints, owner: Ints, q: Triple, apex: Triple, planes: Callable[[Ints], Triple]
) -> Iterator[Margins]:
    """Silhouettes that objects show to rays `q` from an apex.

    `planes`: the silhouettes' planes, three (6, m), of some of the pairs that are of boxes.
    """
    at = indices(owner < view.boxes.first)
    if at.size:
        center = each(np.subtract, pick(view.spheres.local, owner[at]), pick(apex, at))
        some, radius = each(lambda m: m[:, at], q), view.spheres.radius[owner[at]]
        yield cell[at], sphere_margins(some, center, radius)
    at = indices(owner >= view.boxes.first)
    if at.size:
        some = planes(at)
        value = box_margins(some, each(lambda m: m[:, at], q))
        most, middle = span(value), value[0]
        # An edge ends where the planes beside it begin.
        near = (np.abs(middle) <= most) & (middle >= -most).all(axis=0)
        # Of six planes those that are zero count if all are: nothing is known of the box.
        near &= (most > 0) | ~(most > 0).any(axis=0)
        yield cell[at[near.nonzero()[1]]], value[:, near]


class Seen(NamedTuple):
    """The surfaces that cells see, each at the hit in its middle.

    Attributes
    ----------
    hits : Visible
    lights, local : (lights, 3)
        Where the lights are: in the scene's axes, and in the camera's, seen from the eye.
    sheets : Sheets
        The surfaces that are seen.
    cell : (n,)
        The cell of each hit.
    footprint : (n,)
        See `footprints_of`.
    size : float
        Width of the cells, in pixels.
    """

    hits: Visible
    lights: Floats
    local: Floats
    sheets: Sheets
    cell: Ints
    footprint: Floats
    size: float

    def rays(self, at: Ints) -> tuple[Triple, Floats]:
        """Rays through the cells of some hits, three (6, n), and 1 / t (6, n) of what is seen."""
        raster = self.hits.view.raster
        ahead = raster.depth / self.hits.p[2][at]
        d = rays(raster, self.hits.p[0][at] * ahead, self.hits.p[1][at] * ahead, self.size)
        return d, self.sheets.take(at).inverse(d)

    def intersections(self, hidden: Visible) -> Iterator[Margins]:
        """Where surfaces meet those `hidden` behind them."""
        sample = self.hits.sample
        place = np.empty(int(sample.max(initial=0)) + 1, dtype=np.intp)
        place[sample] = np.arange(sample.size)
        at = place[hidden.sample]
        # What a cell sees of two surfaces that meet there is as near as both footprints reach.
        reach = self.footprint[at] + footprints_of(hidden, self.size)
        near = indices(hidden.distance - self.hits.distance[at] <= reach)
        d, inverse = self.rays(at[near])
        yield self.cell[at[near]], inverse - Sheets.of(hidden).take(near).inverse(d)

    def shadows(self, light: Ints, point: Ints, occluder: Ints) -> Iterator[Margins]:
        """Edges of shadows, given lights, hits and objects that may shade around these."""
        view, surfaces = self.hits.view, self.hits.view.surfaces
        d, inverse = self.rays(point)
        apex = columns(self.local, light)
        q = each(lambda d, place: d - place * inverse, d, apex)

        def planes(at: Ints) -> Triple:
            # Found once for each pair of a light and a box.
            pair, place = np.unique(light[at] * len(surfaces) + occluder[at], return_inverse=True)
            number, box = np.divmod(pair, len(surfaces))
            box, position = box - surfaces.sphere_count, self.lights.T[:, number]
            low, high = (m[:, box] - position for m in (view.boxes.min_pt, view.boxes.max_pt))
            u, v, w = view.raster.vector_to_camera(silhouette_planes(low, high))
            return u[:, place], v[:, place], w[:, place]

        yield from _silhouettes(view, self.cell[point], occluder, q, apex, planes)

    def terminators(self, n_dot_l: Floats, length2: Floats) -> Iterator[Margins]:
        """Lines at which lights, and their highlights, begin on spheres: see `Incoming`."""
        view, own = self.hits.view, self.hits.own
        turn = self.footprint * view.curvature[own]
        number, at = np.nonzero(n_dot_l**2 < turn * turn * length2)
        d, inverse = self.rays(at)
        center, light = pick(view.spheres.local, own[at]), columns(self.local, number)
        # The rays meet the sphere at d / inverse: normal and way to the light, times inverse.
        n = each(lambda d, c: d - c * inverse, d, center)
        to_light = each(lambda d, c: c * inverse - d, d, light)
        yield self.cell[at], dot(n, to_light) / np.sqrt(dot(n, n) * dot(to_light, to_light))

    def creases(self) -> Iterator[Margins]:
        """Edges between faces of boxes that are both seen."""
        view, eye = self.hits.view, self.hits.view.raster.eye
        for group in self.hits.groups:
            if not group.flat:
                continue
            x, y, z = self.hits.p[:, group.part]
            for k, axis in enumerate(view.raster.axes.T):
                across_face = group.face != k
                if not np.any(across_face):
                    continue
                height = view.raster.scene_component((x, y, z), k)
                for corner, sign in ((view.boxes.min_pt, -1), (view.boxes.max_pt, 1)):
                    level = corner[k, group.owner - view.boxes.first] - eye[k]
                    shown = view.eye_inside[group.owner] | (sign * level < 0)
                    level = group.spread(level)
                    near = np.abs(height - level) < self.footprint[group.part]
                    at = indices(near & across_face & group.spread(shown))
                    if at.size:
                        d, inverse = self.rays(group.part.start + at)
                        u, v, w = axis
                        value = inverse - dot((u, v, w), d) / select(level, at)
                        yield self.cell[group.part][at], value
