"""Edge functions of what may cross cells: silhouettes, shadows, creases, terminators.

Silhouettes are sought along all of the objects' outlines across the picture, so that objects are
found as well that the samples in the middles of pixels miss; the others around these samples.
The *footprint* of a cell is the radius of what it sees of a surface.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product
from typing import NamedTuple, TypeAlias

import numpy as np

from tracer.antialias.edge_functions import EdgeValues, InverseDepth, rays, span
from tracer.arrays import (
    BATCH_SIZE,
    Bools,
    Floats,
    Ints,
    Triple,
    dot,
    indices,
    map3,
    scaled,
    segment_indices,
    take3,
)
from tracer.geometry.camera import CameraFrame
from tracer.geometry.silhouette import box_edge_functions, silhouette_planes, sphere_edge_function
from tracer.trace.hits import Hits
from tracer.trace.samples import spans
from tracer.world.prepared_scene import PreparedScene

Apexes: TypeAlias = tuple[Floats, Floats]
"""Where lights are, or the eye (m, 3): in the scene's axes, and in the camera's."""

# Towards a face's horizon footprints are lengthened, by a factor of at most one over this.
_NEARLY = 1e-3


def pieces(index: Ints) -> Iterator[Ints]:
    """Some of an index at a time: edge functions are six numbers for each."""
    for start in range(0, index.size, BATCH_SIZE):
        yield index[start : start + BATCH_SIZE]


def footprints_of(hits: Hits, size: float) -> Floats:
    """Footprints (n,): radii, around all points, of what cells of a size see."""
    frame = hits.prepared.frame
    angle = _angle(frame, size)
    halves, distance = hits.local[2] * angle, hits.distance
    footprints = np.empty(halves.size)
    for group in hits.groups:
        half = halves[group.interval]
        n_dot_v = group.expand(group.eye_height) / distance[group.interval]
        if group.shape.is_planar:
            footprints[group.interval] = _on_face(half, n_dot_v, angle)
            continue
        # However small the cosine, from the silhouette a width of `half` covers no more of a
        # sphere than sqrt(2 half radius).
        most = np.sqrt(2 * half / group.per_sample(hits.prepared.curvature))
        footprints[group.interval] = np.fmin(half / n_dot_v, most)
    return footprints


def _angle(frame: CameraFrame, size: float) -> float:
    """Under this angle, in radians, the eye sees half the diagonal of a cell."""
    return 0.5 * size * float(np.hypot(frame.step_u, frame.step_v)) / frame.depth


def _on_face(half: Floats, n_dot_v: Floats, angle: float) -> Floats:
    """Footprints on faces: half the cell's diagonal at their distance, over the cosine."""
    # The far end of the cell sees the face at a smaller cosine: by up to the angle.
    return half / (n_dot_v * np.maximum(1 - angle / n_dot_v, _NEARLY))


def silhouette_pixels(
    prepared: PreparedScene, rows: slice, columns: slice
) -> tuple[Ints, Ints, Ints]:
    """Row, column and object: the pixels of a rectangle that an outline may cross.

    Being convex, an object fills the pixels of a row whose upper and lower sides it covers.  Its
    outline may cross the others in which it is seen.
    """
    lines = np.arange(rows.start, rows.stop + 1, dtype=np.float64)
    top, bottom = prepared.bounds.top, prepared.bounds.bottom
    found: list[tuple[Ints, Ints, Floats, Floats]] = []
    for shape in prepared.shapes:
        between = columns.start, columns.stop
        obj, row, left, right = spans(shape, prepared, lines[:-1], between, height=1.0)
        full, full_end = left, right
        for line in (row, row + 1):
            begin, end = shape.row_extent(obj, lines[line], 0.0)
            full, full_end = np.maximum(full, begin), np.minimum(full_end, end)
        fills = (top[obj] < lines[row]) & (bottom[obj] > lines[row + 1]) & (full < full_end)
        left, stop = np.floor(left), np.floor(right) + 1
        full, full_end = (np.where(fills, m, stop) for m in (np.ceil(full), np.floor(full_end)))
        full = np.clip(full, left, stop)
        full_end = np.clip(full_end, full, stop)
        found += [(row, obj, left, full), (row, obj, full_end, stop)]
    row, obj, start, stop = (np.concatenate(m) for m in zip(*found, strict=True))
    start, stop = (m.clip(columns.start, columns.stop).astype(np.intp) for m in (start, stop))
    span, column = segment_indices(stop - start, start)
    return row[span] + rows.start, column, obj[span]


def silhouettes(
    prepared: PreparedScene, apexes: Apexes, number: Ints, cell: Ints, obj: Ints, q: Triple
) -> Iterator[EdgeValues]:
    """Silhouettes of objects, given pairs (n,) of a cell and an object.

    `number` (n,): of the apex they are seen from; `q`: rays from there through the cells, three
    (6, n).
    """
    spheres, boxes, (positions, local) = prepared.spheres, prepared.boxes, apexes
    at = indices(spheres.objects.contains(obj))
    if at.size:
        center = map3(np.subtract, take3(spheres.local, obj[at]), take3(local.T, number[at]))
        some, radius = map3(lambda m: m[:, at], q), spheres.radius[obj[at]]
        yield cell[at], sphere_edge_function(some, center, radius)
    at = indices(boxes.objects.contains(obj))
    if at.size:
        # Planes are found once for each pair of an apex and a box.
        pair = number[at] * boxes.objects.size + boxes.objects.positions(obj[at])
        pair, inverse = np.unique(pair, return_inverse=True)
        which, box = np.divmod(pair, boxes.objects.size)
        low, high = (m[:, box] - positions.T[:, which] for m in (boxes.min_pt, boxes.max_pt))
        planes = prepared.frame.vector_to_camera(silhouette_planes(low, high))
        some = map3(lambda m: m[:, at], q)
        value = box_edge_functions(map3(lambda m: m[:, inverse], planes), some)
        most, middle = span(value), value[0]
        # An edge ends where the planes beside it begin.
        near = (np.abs(middle) <= most) & (middle >= -most).all(axis=0)
        # Of six planes those that are zero count if all are: nothing is known of the box.
        near &= (most > 0) | ~(most > 0).any(axis=0)
        yield cell[at[near.nonzero()[1]]], value[:, near]


class CellSurfaces(NamedTuple):
    """The surfaces that cells see, each at the hit in its middle.

    Attributes
    ----------
    hits : Hits
    inverse_depth : InverseDepth
        The surfaces that are seen.
    cell : (n,)
        The cell of each hit.
    footprint : (n,)
        See `footprints_of`.
    size : float
        Width of the cells, in pixels.
    """

    hits: Hits
    inverse_depth: InverseDepth
    cell: Ints
    footprint: Floats
    size: float

    def rays(self, at: Ints) -> tuple[Triple, Floats]:
        """Rays through the cells of some hits, three (6, n), and 1 / t (6, n) of what is seen."""
        frame = self.hits.prepared.frame
        ahead = frame.depth / self.hits.local[2][at]
        d = rays(frame, self.hits.local[0][at] * ahead, self.hits.local[1][at] * ahead, self.size)
        return d, self.inverse_depth.take(at).inverse(d)

    def intersections(self, hidden: Hits) -> Iterator[EdgeValues]:
        """Where surfaces meet those `hidden` behind them."""
        sample = self.hits.sample
        hit = np.empty(int(sample.max(initial=0)) + 1, dtype=np.intp)
        hit[sample] = np.arange(sample.size)
        at = hit[hidden.sample]
        # What a cell sees of two surfaces that meet there is as near as both footprints reach.
        reach = self.footprint[at] + footprints_of(hidden, self.size)
        close, behind = hidden.distance - self.hits.distance[at] <= reach, InverseDepth.of(hidden)
        for near in pieces(indices(close)):
            d, inverse = self.rays(at[near])
            yield self.cell[at[near]], inverse - behind.take(near).inverse(d)
        yield from self._other_faces(hidden, at, close)

    def _other_faces(self, hidden: Hits, at: Ints, close: Bools) -> Iterator[EdgeValues]:
        """Where hidden boxes may come forward with another face, whose crease is hidden as well.

        Seen from inside, that face may be near where the hidden one is not `close` (n,).
        """
        prepared, owner = hidden.prepared, hidden.hit_object
        boxes, eye, angle = prepared.boxes, prepared.frame.eye, _angle(prepared.frame, self.size)
        flat = indices(boxes.objects.contains(owner) & (close | prepared.eye_inside[owner]))
        obj, p, distance = owner[flat], hidden.local[:, flat], hidden.distance[flat]
        seen, reach = self.hits.distance[at[flat]], self.footprint[at[flat]]
        for k in range(3):
            height = prepared.frame.scene_component(take3(p, slice(None)), k)
            low, high = (
                m[k, boxes.objects.positions(obj)] - eye[k] for m in (boxes.min_pt, boxes.max_pt)
            )
            level = np.where(prepared.eye_inside[obj] == (height > 0), high, low)
            farther = level / height
            footprint = _on_face(farther * p[2] * angle, np.abs(height) / distance, angle)
            near = np.abs(farther * distance - seen) <= reach + footprint
            for some in pieces(indices(near)):
                d, inverse = self.rays(at[flat[some]])
                across = prepared.frame.scene_component(d, k)
                yield self.cell[at[flat[some]]], inverse - across / level[some]

    def shadows(
        self, apexes: Apexes, light: Ints, point: Ints, occluder: Ints
    ) -> Iterator[EdgeValues]:
        """Edges of shadows, given lights, hits and objects that may shade around these."""
        for pair in pieces(np.arange(light.size)):
            at, number = point[pair], light[pair]
            d, inverse = self.rays(at)
            q = map3(np.subtract, d, scaled(take3(apexes[1].T, number), inverse))
            pairs = number, self.cell[at], occluder[pair]
            yield from silhouettes(self.hits.prepared, apexes, *pairs, q)

    def terminators(self, apexes: Apexes, n_dot_l: Floats, length2: Floats) -> Iterator[EdgeValues]:
        """Lines at which lights, and their highlights, begin on spheres: see `LightGeometry`."""
        prepared, obj = self.hits.prepared, self.hits.hit_object
        turn = self.footprint * prepared.curvature[obj]
        for pair in pieces(indices(n_dot_l**2 < turn * turn * length2)):
            light, at = np.divmod(pair, turn.size)
            d, inverse = self.rays(at)
            center, apex = take3(prepared.spheres.local, obj[at]), take3(apexes[1].T, light)
            # The rays meet the sphere at d / inverse: normal and way to the light, times inverse.
            n = map3(np.subtract, d, scaled(center, inverse))
            to_light = map3(np.subtract, scaled(apex, inverse), d)
            yield self.cell[at], dot(n, to_light) / np.sqrt(dot(n, n) * dot(to_light, to_light))

    def creases(self) -> Iterator[EdgeValues]:
        """Edges between faces of boxes that are both seen."""
        prepared, eye = self.hits.prepared, self.hits.prepared.frame.eye
        ends = (prepared.boxes.min_pt, -1), (prepared.boxes.max_pt, 1)
        for group, k in product(self.hits.groups, range(3)):
            across_face = group.face != k
            if not group.shape.is_planar or not np.any(across_face):
                continue
            height = prepared.frame.scene_component(take3(self.hits.local, group.interval), k)
            for corner, sign in ends:
                level = corner[k, prepared.boxes.objects.positions(group.run_object)] - eye[k]
                shown = prepared.eye_inside[group.run_object] | (sign * level < 0)
                level, shown = group.repeat_runs(level), group.repeat_runs(shown & across_face)
                near = np.abs(height - level) < self.footprint[group.interval]
                for at in pieces(indices(near & shown)):
                    d, inverse = self.rays(group.interval.start + at)
                    value = inverse - prepared.frame.scene_component(d, k) / level[at]
                    yield self.cell[group.interval][at], value
