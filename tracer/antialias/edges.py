"""Find the edges that may cross cells of the picture: silhouettes, creases, shadows, terminators.

A cell is a pixel or a square part of a pixel.  Each edge is found as an edge function: a smooth
function on the picture that is zero at the edge (see `edge_functions`).  The functions of this
module yield the values of edge functions at six points of each cell; a later step decides from the
values whether the edge does cross the cell.

Silhouettes are computed for all pixels that the outline of an object may cross, so that an object
is found even if no sample hits it.  All other edges are searched for around the *hit* of each cell,
which is the point where the ray through the centre of the cell meets a surface.  The search radius
is the *footprint*: the radius, around the hit, of the part of the surface that is visible in the
cell.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product
from typing import NamedTuple

import numpy as np

from tracer.antialias.edge_functions import EdgeValues, InverseDepth, bound_variation, cell_rays
from tracer.arrays import (
    BATCH_SIZE,
    Bools,
    Floats,
    Ints,
    Triple,
    dot,
    indices,
    map3,
    scale3,
    segment_indices,
    take3,
)
from tracer.geometry.camera import CameraFrame
from tracer.geometry.silhouette import box_edge_functions, silhouette_planes, sphere_edge_function
from tracer.trace.hits import Hits
from tracer.trace.samples import object_spans
from tracer.world.prepared_scene import PreparedScene

# Towards the horizon of a face, footprints are divided by the cosine at the far end of the cell.
# This cosine is at least this fraction of the cosine at the hit, so that footprints stay finite.
_MIN_COSINE_RATIO = 1e-3


class Apexes(NamedTuple):
    """Points from which silhouettes are seen: the eye, or m lights.

    Attributes
    ----------
    position : (m, 3) float array
        Positions in the axes of the scene.
    from_eye : (m, 3) float array
        The same positions relative to the eye, in the axes of the camera.
    """

    position: Floats
    from_eye: Floats


def edge_batches(index: Ints) -> Iterator[Ints]:
    """Divide indices of edges into batches, which limit the memory of one computation.

    Parameters
    ----------
    index : (n,) int array
        Indices of edges.

    Yields
    ------
    batch : (k,) int array
        The next elements of `index`, at most `BATCH_SIZE`.  Nothing is yielded if `index` is empty.
    """
    for start in range(0, index.size, BATCH_SIZE):
        yield index[start : start + BATCH_SIZE]


def footprints_at(hits: Hits, cell_width: float) -> Floats:
    """Compute, for each hit, the radius of the part of its surface that is visible in its cell.

    A cell is a pixel, or a square part of a pixel.  The hit is where the ray through the centre of
    the cell meets a surface.

    Parameters
    ----------
    hits : Hits
        The n hits.
    cell_width : float
        Width of the cells, in pixels.

    Returns
    -------
    footprint : (n,) float array
        Radius of the visible part around each hit, in the scene's unit of length.
    """
    frame = hits.prepared.frame
    angle = _half_diagonal(frame, cell_width)
    perpendicular_radius, distance = hits.from_eye[2] * angle, hits.distance
    footprint = np.empty(distance.size)
    for group in hits.groups:
        radius = perpendicular_radius[group.interval]
        n_dot_v = group.per_hit(group.eye_height) / distance[group.interval]
        if group.shape.is_planar:
            footprint[group.interval] = _footprint_on_face(radius, n_dot_v, angle)
            continue
        # At any angle, a strip of width r next to the silhouette of a sphere of radius R shows no
        # more of the sphere than sqrt(2 r R).
        maximum = np.sqrt(2 * radius / group.object_values(hits.prepared.curvature))
        footprint[group.interval] = np.fmin(radius / n_dot_v, maximum)
    return footprint


def _half_diagonal(frame: CameraFrame, cell_width: float) -> float:
    """Return half the diagonal of a square cell of the picture, as an angle from the eye.

    Parameters
    ----------
    frame : CameraFrame
        The camera.
    cell_width : float
        Width of the cell, in pixels.

    Returns
    -------
    angle : float
        The angle in radians, for a cell where the window's plane is nearest to the eye: there the
        angle is largest.
    """
    return 0.5 * cell_width * float(np.hypot(frame.step_u, frame.step_v)) / frame.depth


def _footprint_on_face(radius: Floats, n_dot_v: Floats, angle: float) -> Floats:
    """Compute the radius of the part of a planar face that is visible in each cell.

    A cell is a pixel, or a square part of a pixel.  The hit is where the ray through the centre of
    the cell meets the face.

    Parameters
    ----------
    radius : (n,) float array
        Half the diagonal of the cell at the distance of the hit, perpendicular to the ray, in the
        scene's unit of length.
    n_dot_v : (n,) float array
        Cosine between the normal of the face and the direction to the eye, at the hit.
    angle : float
        Half the diagonal of the cell as an angle from the eye, in radians.

    Returns
    -------
    footprint : (n,) float array
        Radius of the visible part around each hit, in the scene's unit of length.
    """
    # At the far end of the cell, the cosine is smaller by at most the angle.
    return radius / (n_dot_v * np.maximum(1 - angle / n_dot_v, _MIN_COSINE_RATIO))


def silhouette_pixels(
    prepared: PreparedScene, rows: slice, columns: slice
) -> tuple[Ints, Ints, Ints]:
    """Find all pairs of a pixel and an object whose silhouette may cross the pixel.

    Objects are convex.  So an object covers a pixel entirely if it covers both the upper and the
    lower side of the pixel.  The silhouette may cross every other pixel that the object covers in
    part.

    Parameters
    ----------
    prepared : PreparedScene
        The scene, prepared for the camera.
    rows, columns : slice
        Rows and columns of the rectangle of pixels to search.

    Returns
    -------
    row, column : (n,) int arrays
        Row and column in the picture of the pixel of each pair.
    object_index : (n,) int array
        Index of the object of each pair.
    """
    lines = np.arange(rows.start, rows.stop + 1, dtype=np.float64)
    top, bottom = prepared.bounds.top, prepared.bounds.bottom
    # For each interval: row, object, and the columns at which it starts and stops.
    intervals: list[tuple[Ints, Ints, Floats, Floats]] = []
    for shape in prepared.shapes:
        limits = columns.start, columns.stop
        owner, row, left, right = object_spans(shape, prepared, lines[:-1], limits, height=1.0)
        # The interval in which the object covers both the upper and the lower side of the row.
        inner_start, inner_stop = left, right
        for line in (row, row + 1):
            line_left, line_right = shape.row_extent(owner, lines[line], 0.0)
            inner_start = np.maximum(inner_start, line_left)
            inner_stop = np.minimum(inner_stop, line_right)
        covers_row = (top[owner] < lines[row]) & (bottom[owner] > lines[row + 1])
        covers_row &= inner_start < inner_stop
        start, stop = np.floor(left), np.floor(right) + 1
        # Pixels that are covered entirely; if there are none, the interval is empty, at the end.
        inner_start, inner_stop = np.ceil(inner_start), np.floor(inner_stop)
        inner_start = np.where(covers_row, inner_start, stop).clip(start, stop)
        inner_stop = np.where(covers_row, inner_stop, stop).clip(inner_start, stop)
        intervals += [(row, owner, start, inner_start), (row, owner, inner_stop, stop)]
    all_row, all_owner, *ends = (np.concatenate(field) for field in zip(*intervals, strict=True))
    start_column, stop_column = (x.clip(columns.start, columns.stop).astype(np.intp) for x in ends)
    interval, column = segment_indices(stop_column - start_column, start_column)
    return all_row[interval] + rows.start, column, all_owner[interval]


def silhouettes(
    prepared: PreparedScene, apexes: Apexes, apex: Ints, cell: Ints, owner: Ints, ray: Triple
) -> Iterator[EdgeValues]:
    """Yield the edge functions of the silhouettes of objects, as seen from apexes.

    An apex is the eye or a light.  An edge function is a smooth function on the picture that is
    zero at an edge.  It is evaluated at six points of a cell (a pixel, or a square part of a
    pixel): the centre; the centres of the right, left, lower and upper side; and the lower right
    corner.

    Parameters
    ----------
    prepared : PreparedScene
        The scene, prepared for the camera.
    apexes : Apexes
        The points from which silhouettes are seen.
    apex, cell, owner : (n,) int arrays
        Indices of n triples: an apex, a cell, and an object whose silhouette may cross the cell.
    ray : tuple of three (6, n) float arrays
        Components, in the axes of the camera, of the vectors from the apex towards the surface
        points that are visible at the six points of the cell.  An array may have one row, which
        is then that of all six points.

    Yields
    ------
    cell : (k,) int array
        Index of the cell of each silhouette.  A box has up to six silhouettes, one for each edge.
        Silhouettes of boxes that do not cross the cell are excluded.
    values : (6, k) float array
        Values of the edge function of the silhouette at the six points of the cell.
    """
    spheres, boxes = prepared.spheres, prepared.boxes
    of_sphere = indices(spheres.objects.contains(owner))
    if of_sphere.size:
        sphere, sphere_ray = owner[of_sphere], map3(lambda component: component[:, of_sphere], ray)
        sphere_apex = take3(apexes.from_eye.T, apex[of_sphere])
        center = map3(np.subtract, take3(spheres.from_eye, sphere), sphere_apex)
        yield cell[of_sphere], sphere_edge_function(sphere_ray, center, spheres.radius[sphere])
    of_box = indices(boxes.objects.contains(owner))
    if of_box.size:
        # Planes are computed once for each pair of an apex and a box.
        box, count = boxes.objects.positions(owner[of_box]), boxes.objects.size
        pair_key, pair_index = np.unique(apex[of_box] * count + box, return_inverse=True)
        pair_apex, pair_box = np.divmod(pair_key, count)
        position = apexes.position.T[:, pair_apex]
        low, high = boxes.min_pt[:, pair_box] - position, boxes.max_pt[:, pair_box] - position
        planes = prepared.frame.vector_to_camera(silhouette_planes(low, high))
        box_ray = map3(lambda component: component[:, of_box], ray)
        planes = map3(lambda component: component[:, pair_index], planes)
        values = box_edge_functions(planes, box_ray)
        variation, center_value = bound_variation(values), values[0]
        # An edge of the box ends where the planes through the neighbouring edges begin.
        is_near = (np.abs(center_value) <= variation) & (center_value >= -variation).all(axis=0)
        # A plane that is zero bounds nothing.  If all six are zero, nothing is known of the box.
        is_near &= (variation > 0) | ~(variation > 0).any(axis=0)
        yield cell[of_box[is_near.nonzero()[1]]], values[:, is_near]


class CellSurfaces(NamedTuple):
    """The surfaces that are visible in cells (pixels, or square parts of pixels), at n hits.

    A hit is where the ray through the centre of a cell meets a surface.  The methods yield the
    edges on the surfaces that may cross the cells, as edge functions.  An edge function is a smooth
    function on the picture that is zero at an edge.

    Attributes
    ----------
    hits : Hits
        The hits, at most one in each cell.
    inverse_depth : InverseDepth
        The surface at each hit, as a function on the picture.
    cell : (n,) int array
        Index of the cell of each hit.
    footprint : (n,) float array
        Radius, around each hit, of the part of the surface that is visible in its cell.
    cell_width : float
        Width of the cells, in pixels.
    """

    hits: Hits
    inverse_depth: InverseDepth
    cell: Ints
    footprint: Floats
    cell_width: float

    def trace_rays(self, index: Ints) -> tuple[Triple, Floats]:
        """Compute rays through six points of cells, and where they meet the surfaces of the hits.

        A cell is a pixel, or a square part of a pixel, with a hit at its centre.  The six points
        are: the centre; the centres of the right, left, lower and upper side; and the lower right
        corner.  Each ray is intersected with the surface of the cell's hit only.

        Parameters
        ----------
        index : (k,) int array
            Indices of the hits.

        Returns
        -------
        ray : tuple of three (6, k) float arrays
            Components of the rays from the eye, in the axes of the camera.  The third array has one
            row, which is that of all six points.
        inverse_t : (6, k) float array
            1 / t for each ray: t times the ray is the vector from the eye to the surface.
        """
        frame, (x, y, z) = self.hits.prepared.frame, take3(self.hits.from_eye, index)
        scale = frame.depth / z
        ray = cell_rays(frame, x * scale, y * scale, self.cell_width)
        return ray, self.inverse_depth.take(index).evaluate(ray)

    def intersections(self, hidden: Hits) -> Iterator[EdgeValues]:
        """Yield the edges where the visible surface of a cell may meet the surface behind it.

        A cell is a pixel, or a square part of a pixel, with a visible hit at its centre.  An edge
        function is a smooth function on the picture that is zero at an edge.

        Parameters
        ----------
        hidden : Hits
            Hits of other surfaces, behind the visible hits of the same samples.

        Yields
        ------
        cell : (k,) int array
            Index of the cell of each edge.
        values : (6, k) float array
            Values of the edge function at six points of the cell: the centre; the centres of the
            right, left, lower and upper side; and the lower right corner.  The function is the
            difference of 1 / t of the two surfaces, where a ray meets each surface at t times the
            ray.
        """
        sample = self.hits.sample
        hit_of_sample = np.empty(int(sample.max(initial=0)) + 1, dtype=np.intp)
        hit_of_sample[sample] = np.arange(sample.size)
        visible = hit_of_sample[hidden.sample]
        # Two surfaces that meet within the cell are no farther from each other than this.
        max_gap = self.footprint[visible] + footprints_at(hidden, self.cell_width)
        is_close = hidden.distance - self.hits.distance[visible] <= max_gap
        hidden_depth = InverseDepth.from_hits(hidden)
        for batch in edge_batches(indices(is_close)):
            ray, inverse_t = self.trace_rays(visible[batch])
            hidden_inverse_t = hidden_depth.take(batch).evaluate(ray)
            yield self.cell[visible[batch]], inverse_t - hidden_inverse_t
        yield from self._intersections_with_other_faces(hidden, visible, is_close)

    def _intersections_with_other_faces(
        self, hidden: Hits, visible: Ints, is_close: Bools
    ) -> Iterator[EdgeValues]:
        """Yield the edges where visible surfaces of cells may meet other faces of hidden boxes.

        A cell is a pixel, or a square part of a pixel, with a visible hit at its centre.  Behind
        it, the same ray has a hidden hit on a face of a box.  A crease between this face and
        another face of the box may be hidden as well, so the other face can be visible in the cell
        although no sample hits it.  The face of the hidden hit is one of those tested, so its edge
        may be yielded a second time.

        Parameters
        ----------
        hidden : Hits
            The n hidden hits.
        visible : (n,) int array
            Index of the visible hit of the same sample as each hidden hit.
        is_close : (n,) bool array
            Whether the face of the hidden hit may meet the visible surface in the cell.  Other hits
            are skipped, except for those on boxes that contain the eye.

        Yields
        ------
        cell : (k,) int array
            Index of the cell of each edge.
        values : (6, k) float array
            Values of the edge function (a smooth function that is zero at the edge) at six points
            of the cell: the centre; the centres of the right, left, lower and upper side; and the
            lower right corner.  The function is the difference of 1 / t of the visible surface and
            the face, where a ray meets each of them at t times the ray.
        """
        prepared, owner = hidden.prepared, hidden.hit_object
        frame, boxes = prepared.frame, prepared.boxes
        angle = _half_diagonal(frame, self.cell_width)
        index = indices(boxes.objects.contains(owner) & (is_close | prepared.is_eye_inside[owner]))
        owner, hit, distance = owner[index], take3(hidden.from_eye, index), hidden.distance[index]
        visible = visible[index]
        visible_distance, footprint = self.hits.distance[visible], self.footprint[visible]
        box = boxes.objects.positions(owner)
        for axis in range(3):
            height = frame.scene_component(hit, axis)
            low, high = boxes.min_pt[axis, box], boxes.max_pt[axis, box]
            is_high = prepared.is_eye_inside[owner] == (height > 0)
            face_height = np.where(is_high, high, low) - frame.eye[axis]
            # The ray meets the plane of the other face at this factor times the hidden hit.
            factor = face_height / height
            n_dot_v = np.abs(height) / distance
            face_footprint = _footprint_on_face(factor * hit[2] * angle, n_dot_v, angle)
            gap = np.abs(factor * distance - visible_distance)
            for batch in edge_batches(indices(gap <= footprint + face_footprint)):
                ray, inverse_t = self.trace_rays(visible[batch])
                face_inverse_t = frame.scene_component(ray, axis) / face_height[batch]
                yield self.cell[visible[batch]], inverse_t - face_inverse_t

    def shadow_silhouettes(
        self, apexes: Apexes, light_index: Ints, hit_index: Ints, occluder: Ints
    ) -> Iterator[EdgeValues]:
        """Yield the edges of shadows: the silhouettes of occluders, as seen from lights.

        A cell is a pixel, or a square part of a pixel, with a hit at its centre.

        Parameters
        ----------
        apexes : Apexes
            Positions of the lights.
        light_index, hit_index, occluder : (n,) int arrays
            Indices of n triples: a light, a hit, and an object whose shadow may have an edge within
            the footprint of the hit (the part of the surface that is visible in the cell).

        Yields
        ------
        cell : (k,) int array
            Index of the cell of each edge.
        values : (6, k) float array
            Values of the edge function (a smooth function that is zero at the edge) at six points
            of the cell: the centre; the centres of the right, left, lower and upper side; and the
            lower right corner.
        """
        prepared = self.hits.prepared
        for batch in edge_batches(np.arange(light_index.size)):
            light, cell = light_index[batch], self.cell[hit_index[batch]]
            ray, inverse_t = self.trace_rays(hit_index[batch])
            # Vectors from the light to the surface, divided by t.
            scaled_light = scale3(take3(apexes.from_eye.T, light), inverse_t)
            light_ray = map3(np.subtract, ray, scaled_light)
            yield from silhouettes(prepared, apexes, light, cell, occluder[batch], light_ray)

    def terminators(self, apexes: Apexes, n_dot_l: Floats, length2: Floats) -> Iterator[EdgeValues]:
        """Yield the edges where spheres turn away from lights, called terminators.

        A cell is a pixel, or a square part of a pixel, with a hit at its centre.  Terminators are
        searched for within the footprint of the hit (the part of the surface that is visible in
        the cell).

        Parameters
        ----------
        apexes : Apexes
            Positions of the lights.
        n_dot_l : (lights, n) float array
            n . l, with the unit normal n at each hit, and the vector l from the hit to the light.
        length2 : (lights, n) float array
            l . l

        Yields
        ------
        cell : (k,) int array
            Index of the cell of each edge.
        values : (6, k) float array
            Values of the edge function (a smooth function that is zero at the edge) at six points
            of the cell: the centre; the centres of the right, left, lower and upper side; and the
            lower right corner.  The function is the cosine between n and l.
        """
        prepared, owner = self.hits.prepared, self.hits.hit_object
        # The normal turns by this angle within the footprint, in radians.
        turn = self.footprint * prepared.curvature[owner]
        for pair in edge_batches(indices(n_dot_l**2 < turn * turn * length2)):
            light_index, hit_index = np.divmod(pair, turn.size)
            ray, inverse_t = self.trace_rays(hit_index)
            # The rays meet the sphere at ray / inverse_t.  All vectors are multiplied by inverse_t.
            center = scale3(take3(prepared.spheres.from_eye, owner[hit_index]), inverse_t)
            normal = map3(np.subtract, ray, center)
            light = scale3(take3(apexes.from_eye.T, light_index), inverse_t)
            to_light = map3(np.subtract, light, ray)
            length = np.sqrt(dot(normal, normal) * dot(to_light, to_light))
            yield self.cell[hit_index], dot(normal, to_light) / length

    def creases(self) -> Iterator[EdgeValues]:
        """Yield the creases near hits: the edges between two visible faces of the same box.

        A cell is a pixel, or a square part of a pixel, with a hit at its centre.

        Yields
        ------
        cell : (k,) int array
            Index of the cell of each crease.
        values : (6, k) float array
            Values of the edge function (a smooth function that is zero at the edge) at six points
            of the cell: the centre; the centres of the right, left, lower and upper side; and the
            lower right corner.  The function is the difference of 1 / t of the two faces, where a
            ray meets each of them at t times the ray.
        """
        prepared, frame = self.hits.prepared, self.hits.prepared.frame
        corners = prepared.boxes.min_pt, prepared.boxes.max_pt
        for group, axis in product(self.hits.groups, range(3)):
            is_other_face = group.face != axis
            if not group.shape.is_planar or not np.any(is_other_face):
                continue
            height = frame.scene_component(take3(self.hits.from_eye, group.interval), axis)
            box = prepared.boxes.objects.positions(group.run_object)
            for corner, sign in zip(corners, (-1, 1), strict=True):
                run_height = corner[axis, box] - frame.eye[axis]
                is_visible = prepared.is_eye_inside[group.run_object] | (sign * run_height < 0)
                is_visible = group.repeat_runs(is_visible & is_other_face)
                face_height = group.repeat_runs(run_height)
                is_near = np.abs(height - face_height) < self.footprint[group.interval]
                for batch in edge_batches(indices(is_near & is_visible)):
                    ray, inverse_t = self.trace_rays(group.interval.start + batch)
                    face_inverse_t = frame.scene_component(ray, axis) / face_height[batch]
                    yield self.cell[group.interval][batch], inverse_t - face_inverse_t
