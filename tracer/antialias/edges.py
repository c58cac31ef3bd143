"""Edges that may cross cells, as margins: silhouettes, shadows, creases, terminators.

Silhouettes are sought along all of the objects' outlines across the picture, so that objects are
found as well that the samples in the middles of pixels miss; the others around these samples.
The *footprint* of a cell is the radius of what it sees of a surface.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product
from typing import NamedTuple, TypeAlias

import numpy as np

from tracer.antialias.margins import Margins, Sheets, rays, span
from tracer.arrays import Floats, Ints, Triple, dot, each, expand, indices, pick
from tracer.shapes.silhouette import box_margins, silhouette_planes, sphere_margins
from tracer.view.samples import spans
from tracer.view.view import View, Visible

Apexes: TypeAlias = tuple[Floats, Floats]
"""Where lights are, and last the eye (m, 3): in the scene's axes, and in the camera's."""

# Towards a face's horizon footprints are lengthened, by a factor of at most one over this.
_NEARLY = 1e-3

# A line so near to the top or bottom of an object, in pixels, may touch it and no more.
_TOUCHING = 1e-6


def footprints_of(hits: Visible, size: float) -> Floats:
    """Footprints (n,): radii, around all points, of what cells of a size see."""
    raster = hits.view.raster
    # Under this angle, in radians, the eye sees half the diagonal of a cell.
    angle = 0.5 * size * float(np.hypot(raster.step_u, raster.step_v)) / raster.depth
    halves, distance = hits.p[2] * angle, hits.distance
    footprints = np.empty(halves.size)
    for group in hits.groups:
        half = halves[group.part]
        n_dot_v = group.at_samples(group.height) / distance[group.part]
        if group.shape.flat:
            # The far end of the cell sees the face at a smaller cosine: by up to the angle.
            n_dot_v *= np.maximum(1 - angle / n_dot_v, _NEARLY)
        # However small the cosine, from the silhouette a width of `half` covers no more of a
        # sphere than sqrt(2 half radius).
        most = np.sqrt(2 * half / group.of(hits.view.curvature))
        footprints[group.part] = np.fmin(half / n_dot_v, most)
    return footprints


def crossed(view: View, rows: slice, columns: slice) -> tuple[Ints, Ints, Ints]:
    """Row, column and object: the pixels of a rectangle that an outline may cross.

    Being convex, an object fills the pixels of a row whose upper and lower sides it covers.  Its
    outline may cross the others in which it is seen.
    """
    lines = np.arange(rows.start, rows.stop + 1, dtype=np.float64)
    top, bottom = view.frames.top, view.frames.bottom
    found: list[tuple[Ints, Ints, Floats, Floats]] = []
    for shape in view.shapes:
        between = columns.start, columns.stop
        owner, row, left, right = spans(shape, view, lines[:-1], between, height=1.0)
        full, full_end = left, right
        for line in (row, row + 1):
            begin, end = shape.ends(view.raster, owner, lines[line], 0.0)
            full, full_end = np.maximum(full, begin), np.minimum(full_end, end)
        # Where a line just touches an object, rounding decides what that covers of it.
        fills = (top[owner] < lines[row] - _TOUCHING) & (full < full_end)
        fills &= bottom[owner] > lines[row + 1] + _TOUCHING
        left, stop = np.floor(left), np.floor(right) + 1
        full, full_end = (np.where(fills, m, stop) for m in (np.ceil(full), np.floor(full_end)))
        full = np.clip(full, left, stop)
        full_end = np.clip(full_end, full, stop)
        found += [(row, owner, left, full), (row, owner, full_end, stop)]
    row, owner, start, stop = (np.concatenate(m) for m in zip(*found, strict=True))
    start, stop = (m.clip(columns.start, columns.stop).astype(np.intp) for m in (start, stop))
    span, column = expand(stop - start, start)
    return row[span] + rows.start, column, owner[span]


def silhouettes(
    view: View, apexes: Apexes, number: Ints, cell: Ints, owner: Ints, q: Triple
) -> Iterator[Margins]:
    """Silhouettes of objects, given pairs (n,) of a cell and an object.

    `number` (n,): of the apex they are seen from; `q`: rays from there through the cells, three
    (6, n).
    """
    spheres, boxes, (positions, local) = view.spheres, view.boxes, apexes
    at = indices(owner < boxes.first)
    if at.size:
        center = each(np.subtract, pick(spheres.local, owner[at]), pick(local.T, number[at]))
        some, radius = each(lambda m: m[:, at], q), spheres.radius[owner[at]]
        yield cell[at], sphere_margins(some, center, radius)
    at = indices(owner >= boxes.first)
    if at.size:
        # Planes are found once for each pair of an apex and a box.
        pair = number[at] * boxes.count + owner[at] - boxes.first
        pair, place = np.unique(pair, return_inverse=True)
        which, box = np.divmod(pair, boxes.count)
        low, high = (m[:, box] - positions.T[:, which] for m in (boxes.min_pt, boxes.max_pt))
        planes = view.raster.vector_to_camera(silhouette_planes(low, high))
        some = each(lambda m: m[:, at], q)
        value = box_margins(each(lambda m: m[:, place], planes), some)
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
    apexes : Apexes
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
    apexes: Apexes
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
        # A hidden box may come forward with another face, whose crease is hidden as well.
        view, own = hidden.view, hidden.own[near]
        flat = indices(own >= view.boxes.first)
        box, some = own[flat] - view.boxes.first, each(lambda m: m[:, flat], d)
        inside, eye = view.eye_inside[own[flat]], view.raster.eye
        for k in range(3):
            across = view.raster.scene_component(some, k)
            low, high = view.boxes.min_pt[k, box] - eye[k], view.boxes.max_pt[k, box] - eye[k]
            level = np.where(inside == (across[0] > 0), high, low)
            yield self.cell[at[near[flat]]], inverse[:, flat] - across / level

    def shadows(self, light: Ints, point: Ints, occluder: Ints) -> Iterator[Margins]:
        """Edges of shadows, given lights, hits and objects that may shade around these."""
        d, inverse = self.rays(point)
        q = each(lambda d, place: d - place * inverse, d, pick(self.apexes[1].T, light))
        cell = self.cell[point]
        yield from silhouettes(self.hits.view, self.apexes, light, cell, occluder, q)

    def terminators(self, n_dot_l: Floats, length2: Floats) -> Iterator[Margins]:
        """Lines at which lights, and their highlights, begin on spheres: see `Incoming`."""
        view, own = self.hits.view, self.hits.own
        turn = self.footprint * view.curvature[own]
        light, at = np.nonzero(n_dot_l**2 < turn * turn * length2)
        d, inverse = self.rays(at)
        center, apex = pick(view.spheres.local, own[at]), pick(self.apexes[1].T, light)
        # The rays meet the sphere at d / inverse: normal and way to the light, times inverse.
        n = each(lambda d, c: d - c * inverse, d, center)
        to_light = each(lambda d, c: c * inverse - d, d, apex)
        yield self.cell[at], dot(n, to_light) / np.sqrt(dot(n, n) * dot(to_light, to_light))

    def creases(self) -> Iterator[Margins]:
        """Edges between faces of boxes that are both seen."""
        view, eye = self.hits.view, self.hits.view.raster.eye
        ends = (view.boxes.min_pt, -1), (view.boxes.max_pt, 1)
        for group, k in product(self.hits.groups, range(3)):
            across_face = group.face != k
            if not group.shape.flat or not np.any(across_face):
                continue
            height = view.raster.scene_component(pick(self.hits.p, group.part), k)
            for corner, sign in ends:
                level = corner[k, group.owner - view.boxes.first] - eye[k]
                shown = view.eye_inside[group.owner] | (sign * level < 0)
                level, shown = group.spread(level), group.spread(shown & across_face)
                near = np.abs(height - level) < self.footprint[group.part]
                at = indices(near & shown)
                if at.size:
                    d, inverse = self.rays(group.part.start + at)
                    value = inverse - view.raster.scene_component(d, k) / level[at]
                    yield self.cell[group.part][at], value
