"""Find the edges that may cross cells of the picture: silhouettes, creases, shadows, terminators.

A cell is a pixel or a square part of a pixel.  Each edge is described by an edge function: a smooth
function on the picture that is zero at the edge (see `edge_functions`).  The functions of this
module yield the values of edge functions at six points of each cell.  A later step decides from
these values whether the edge crosses the cell.

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
    Bools,
    Floats,
    Ints,
    Triple,
    dot,
    enumerate_ranges,
    index_batches,
    indices,
    map3,
    scale3,
    take3,
)
from tracer.geometry.camera import CameraFrame
from tracer.geometry.silhouette import box_edge_functions, silhouette_planes, sphere_edge_function
from tracer.trace.hits import Hits
from tracer.trace.samples import find_object_spans
from tracer.world.prepared_scene import PreparedScene

# Footprints on a face are divided by the cosine at the far end of the cell, which tends to 0 at the
# horizon.  At least this fraction of the cosine at the hit is used, so footprints are finite.
_MIN_COSINE_RATIO = 1e-3


def compute_footprints(hits: Hits, cell_width: float) -> Floats:
    """Compute the radius, around each hit, of the part of the surface visible in its cell.

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
    frame = hits.scene.frame
    angle = _compute_cell_angle(frame, cell_width)
    radius_at_hit, distance = hits.from_eye[2] * angle, hits.distance
    footprint = np.empty(distance.size)
    for group in hits.groups:
        radius = radius_at_hit[group.interval]
        cosine = group.expand(group.eye_height) / distance[group.interval]
        if group.shape.is_planar:
            footprint[group.interval] = _compute_footprint_on_face(radius, cosine, angle)
            continue
        # However oblique the view, a strip of width r along the silhouette of a sphere of radius R
        # shows a part of the sphere that is at most sqrt(2 r R) wide.
        curvature = group.repeat_runs(hits.scene.curvature[group.run_object])
        footprint[group.interval] = np.fmin(radius / cosine, np.sqrt(2 * radius / curvature))
    return footprint


def _compute_cell_angle(frame: CameraFrame, cell_width: float) -> float:
    """Compute the angle that half the diagonal of a square cell subtends at the eye.

    Parameters
    ----------
    frame : CameraFrame
        The camera.
    cell_width : float
        Width of the cell, in pixels.

    Returns
    -------
    angle : float
        The angle in radians, for a cell at the point of the image plane that is nearest to the eye.
        Cells elsewhere subtend smaller angles.
    """
    return 0.5 * cell_width * float(np.hypot(frame.pixel_width, frame.pixel_height)) / frame.depth


def _compute_footprint_on_face(cell_radius: Floats, cosine: Floats, cell_angle: float) -> Floats:
    """Compute the radius of the part of a planar face that is visible in each of n cells.

    A cell is a pixel, or a square part of a pixel.  The hit is where the ray through the centre of
    the cell meets the face.

    Parameters
    ----------
    cell_radius : (n,) float array
        Half the diagonal of the cell, perpendicular to the ray and at the distance of the hit, in
        the scene's unit of length.
    cosine : (n,) float array
        Cosine of the angle between the normal of the face and the direction to the eye, at the hit.
    cell_angle : float
        Angle that half the diagonal of the cell subtends at the eye, in radians.

    Returns
    -------
    footprint : (n,) float array
        Radius of the visible part around each hit, in the scene's unit of length.
    """
    # At the far end of the cell, the cosine is smaller by at most `cell_angle`.
    return cell_radius / (cosine * np.maximum(1 - cell_angle / cosine, _MIN_COSINE_RATIO))


def find_silhouette_pixels(
    scene: PreparedScene, rows: slice, columns: slice
) -> tuple[Ints, Ints, Ints]:
    """Find the (pixel, object) pairs in which the object's silhouette may cross the pixel.

    All objects are convex.  So an object that covers the upper and the lower side of a pixel covers
    the whole pixel.  Its silhouette may cross every other pixel that it overlaps.

    Parameters
    ----------
    scene : PreparedScene
        The scene, prepared for the camera.
    rows, columns : slice
        Rows and columns of the rectangle of pixels to search.

    Returns
    -------
    row, column : (n,) int arrays
        Position of each pair's pixel in the picture.
    object_index : (n,) int array
        Index of each pair's object.
    """
    borders = np.arange(rows.start, rows.stop + 1, dtype=np.float64)  # between rows of pixels
    top, bottom = scene.bounds.top, scene.bounds.bottom
    # For each interval of pixels: its row, its object, and the columns where it starts and stops.
    intervals: list[tuple[Ints, Ints, Floats, Floats]] = []
    limits = columns.start, columns.stop
    for shape in scene.shapes:
        spans = find_object_spans(shape, scene, borders[:-1], limits, height=1.0)
        object_index, row, left, right = spans
        # Find the interval in which the object covers both the upper and the lower side of the row.
        inner_start, inner_stop = left, right
        for border_index in (row, row + 1):
            border_left, border_right = shape.row_extent(object_index, borders[border_index], 0.0)
            inner_start = np.maximum(inner_start, border_left)
            inner_stop = np.minimum(inner_stop, border_right)
        covers_row = (top[object_index] < borders[row]) & (bottom[object_index] > borders[row + 1])
        covers_row &= inner_start < inner_stop
        start, stop = np.floor(left), np.floor(right) + 1
        # Keep only pixels that are covered entirely; an empty interval lies at the end.
        inner_start, inner_stop = np.ceil(inner_start), np.floor(inner_stop)
        inner_start = np.where(covers_row, inner_start, stop).clip(start, stop)
        inner_stop = np.where(covers_row, inner_stop, stop).clip(inner_start, stop)
        for interval_start, interval_stop in ((start, inner_start), (inner_stop, stop)):
            intervals.append((row, object_index, interval_start, interval_stop))
    fields = (np.concatenate(field) for field in zip(*intervals, strict=True))
    interval_row, interval_object, *ends = fields
    start_column, stop_column = (end.clip(*limits).astype(np.intp) for end in ends)
    interval_index, column = enumerate_ranges(stop_column - start_column, start_column)
    return interval_row[interval_index] + rows.start, column, interval_object[interval_index]


def evaluate_silhouettes(
    scene: PreparedScene, apex_position: Floats, triples: Ints, ray: Triple
) -> Iterator[EdgeValues]:
    """Yield the edge functions of silhouettes of objects, seen from the eye or from lights.

    The point from which an object is seen is called the apex.  An edge function is a smooth
    function on the picture that is zero at an edge.  It is evaluated at six points of a cell (a
    pixel, or a square part of a pixel): the centre; the centres of the right, left, lower and upper
    side; and the lower right corner.

    Parameters
    ----------
    scene : PreparedScene
        The scene, prepared for the camera.
    apex_position : (m, 3) float array
        Positions of the apexes, in the axes of the scene.
    triples : (3, n) int array
        Row 0 contains apex indices, row 1 cell indices, and row 2 indices of objects whose
        silhouette may cross the cell.
    ray : tuple of three (6, n) float arrays
        Components, in the axes of the camera, of vectors from the apex towards the surface points
        that are visible at the six points of the cell.  An array with a single row applies to all
        six points.

    Yields
    ------
    cell : (k,) int array
        Index of the cell of each silhouette.  A box has up to six silhouettes, one for each edge of
        its outline; those that miss the cell are excluded.
    values : (6, k) float array
        Values of each silhouette's edge function at the six points of the cell.
    """
    frame, spheres, boxes = scene.frame, scene.spheres, scene.boxes
    apex_index, cell, object_index = triples
    on_sphere = indices(spheres.objects.contains(object_index))
    if on_sphere.size:
        sphere_index = spheres.objects.positions(object_index[on_sphere])
        sphere_ray = map3(lambda component: component[:, on_sphere], ray)
        sphere_apex = take3(frame.points_to_camera(apex_position), apex_index[on_sphere])
        center = map3(np.subtract, take3(spheres.from_eye, sphere_index), sphere_apex)
        values = sphere_edge_function(sphere_ray, center, spheres.radius[sphere_index])
        yield cell[on_sphere], values
    on_box = indices(boxes.objects.contains(object_index))
    if on_box.size:
        # Compute the planes once for each (apex, box) pair.
        box_index, box_count = boxes.objects.positions(object_index[on_box]), boxes.objects.size
        pair_key = apex_index[on_box] * box_count + box_index
        distinct_key, pair_index = np.unique(pair_key, return_inverse=True)
        pair_apex, pair_box = np.divmod(distinct_key, box_count)
        apex = apex_position.T[:, pair_apex]
        low, high = boxes.min_pt[:, pair_box] - apex, boxes.max_pt[:, pair_box] - apex
        planes = frame.vector_to_camera(silhouette_planes(low, high))
        box_ray = map3(lambda component: component[:, on_box], ray)
        values = box_edge_functions(map3(lambda part: part[:, pair_index], planes), box_ray)
        variation, center_value = bound_variation(values), values[0]
        # An edge of the outline ends where the planes through its neighbours become negative.
        is_near = (np.abs(center_value) <= variation) & (center_value >= -variation).all(axis=0)
        # A plane of zeros bounds nothing.  If all six are zeros, the outline may be anywhere.
        is_near &= (variation > 0) | ~(variation > 0).any(axis=0)
        yield cell[on_box[is_near.nonzero()[1]]], values[:, is_near]


class CellSurfaces(NamedTuple):
    """The surfaces that are visible in cells (pixels, or square parts of pixels), at n hits.

    A hit is where the ray through the centre of a cell meets a surface.  The methods yield those
    edges on the surfaces that may cross the cells, each described by its edge function: a smooth
    function on the picture that is zero at the edge.

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

    def trace_rays(self, hit_index: Ints) -> tuple[Triple, Floats]:
        """Compute rays through six points of cells, and intersect them with the visible surfaces.

        A cell is a pixel, or a square part of a pixel, with a hit at its centre.  The six points
        are: the centre; the centres of the right, left, lower and upper side; and the lower right
        corner.  Each ray is intersected with the surface of the cell's hit only.

        Parameters
        ----------
        hit_index : (k,) int array
            Indices of the hits whose cells to use.

        Returns
        -------
        ray : tuple of three float arrays
            Components of the rays from the eye, in the axes of the camera: two arrays (6, k), and
            an array (1, k) that applies to all six points.
        inverse_t : (6, k) float array
            1 / t for each ray, where t * ray is the vector from the eye to the surface.
        """
        frame, (x, y, z) = self.hits.scene.frame, take3(self.hits.from_eye, hit_index)
        scale = frame.depth / z
        ray = cell_rays(frame, x * scale, y * scale, self.cell_width)
        return ray, self.inverse_depth.take(hit_index).compute_inverse_t(ray)

    def find_intersections(self, hidden_hits: Hits) -> Iterator[EdgeValues]:
        """Yield the edges where a visible surface may meet the surface behind it.

        A cell is a pixel, or a square part of a pixel, with a visible hit at its centre.

        Parameters
        ----------
        hidden_hits : Hits
            Hits on other surfaces, behind the visible hits of the same samples.

        Yields
        ------
        cell : (k,) int array
            Index of the cell of each edge.
        values : (6, k) float array
            Values of the edge function (a smooth function that is zero at the edge) at six points
            of the cell: the centre; the centres of the right, left, lower and upper side; and the
            lower right corner.  The function is 1 / t1 - 1 / t2: the ray meets one surface at
            t1 * ray, and the other at t2 * ray.
        """
        sample = self.hits.sample
        hit_of_sample = np.empty(int(sample.max(initial=0)) + 1, dtype=np.intp)
        hit_of_sample[sample] = np.arange(sample.size)
        visible_index = hit_of_sample[hidden_hits.sample]
        # Surfaces that meet within the cell are at most this far apart along the ray.
        max_gap = self.footprint[visible_index] + compute_footprints(hidden_hits, self.cell_width)
        is_close = hidden_hits.distance - self.hits.distance[visible_index] <= max_gap
        hidden_depth = InverseDepth.from_hits(hidden_hits)
        for hidden_index in index_batches(indices(is_close)):
            ray, inverse_t = self.trace_rays(visible_index[hidden_index])
            hidden_inverse_t = hidden_depth.take(hidden_index).compute_inverse_t(ray)
            yield self.cell[visible_index[hidden_index]], inverse_t - hidden_inverse_t
        yield from self._intersect_other_faces(hidden_hits, visible_index, is_close)

    def _intersect_other_faces(
        self, hidden_hits: Hits, visible_index: Ints, is_close: Bools
    ) -> Iterator[EdgeValues]:
        """Yield the edges where a visible surface may meet other faces of a box behind it.

        A cell is a pixel, or a square part of a pixel, with a visible hit at its centre.  Behind
        it, the same ray has a hidden hit on a face of a box.  Another face of the box may emerge
        from the visible surface within the cell although no sample hits it.  The face of the hidden
        hit is tested, too, so its edge may be yielded a second time.

        Parameters
        ----------
        hidden_hits : Hits
            The n hidden hits.  Hits on spheres are skipped.
        visible_index : (n,) int array
            Index of the visible hit in front of each hidden hit, on the same ray.
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
            lower right corner.  The function is 1 / t1 - 1 / t2: the ray meets the visible
            surface at t1 * ray, and the face at t2 * ray.
        """
        scene, hit_object = hidden_hits.scene, hidden_hits.hit_object
        frame, boxes = scene.frame, scene.boxes
        cell_angle = _compute_cell_angle(frame, self.cell_width)
        is_candidate = is_close | scene.is_eye_inside[hit_object]
        on_box = indices(is_candidate & boxes.objects.contains(hit_object))
        hit_object, front_index = hit_object[on_box], visible_index[on_box]
        from_eye, distance = take3(hidden_hits.from_eye, on_box), hidden_hits.distance[on_box]
        visible_distance, footprint = self.hits.distance[front_index], self.footprint[front_index]
        box_index = boxes.objects.positions(hit_object)
        is_eye_inside = scene.is_eye_inside[hit_object]
        for axis in range(3):
            hit_height = frame.scene_component(from_eye, axis)
            low_face, high_face = boxes.min_pt[axis, box_index], boxes.max_pt[axis, box_index]
            is_high_face = is_eye_inside == (hit_height > 0)
            face_height = np.where(is_high_face, high_face, low_face) - frame.eye[axis]
            # The ray meets the plane of the face at this multiple of the hidden hit.
            multiple = face_height / hit_height
            cell_radius, cosine = multiple * from_eye[2] * cell_angle, np.abs(hit_height) / distance
            max_gap = footprint + _compute_footprint_on_face(cell_radius, cosine, cell_angle)
            is_near = np.abs(multiple * distance - visible_distance) <= max_gap
            yield from self._intersect_planes(axis, front_index, face_height, is_near)

    def find_creases(self) -> Iterator[EdgeValues]:
        """Yield the edges between two visible faces of the same box that may cross cells.

        A cell is a pixel, or a square part of a pixel, with a hit at its centre.

        Yields
        ------
        cell : (k,) int array
            Index of the cell of each crease.
        values : (6, k) float array
            Values of the edge function (a smooth function that is zero at the edge) at six points
            of the cell: the centre; the centres of the right, left, lower and upper side; and the
            lower right corner.  The function is 1 / t1 - 1 / t2: the ray meets the planes of the
            two faces at t1 * ray and t2 * ray.
        """
        scene, frame = self.hits.scene, self.hits.scene.frame
        corners = scene.boxes.min_pt, scene.boxes.max_pt
        for group, axis in product(self.hits.groups, range(3)):
            is_other_face = group.face != axis
            if not group.shape.is_planar or not np.any(is_other_face):
                continue
            hit_index = np.arange(group.interval.start, group.interval.stop)
            hit_height = frame.scene_component(take3(self.hits.from_eye, group.interval), axis)
            box_index = scene.boxes.objects.positions(group.run_object)
            for corner, sign in zip(corners, (-1, 1), strict=True):
                run_height = corner[axis, box_index] - frame.eye[axis]
                is_visible = scene.is_eye_inside[group.run_object] | (sign * run_height < 0)
                is_visible = group.repeat_runs(is_visible & is_other_face)
                face_height = group.repeat_runs(run_height)
                is_near = np.abs(hit_height - face_height) < self.footprint[group.interval]
                is_near &= is_visible
                yield from self._intersect_planes(axis, hit_index, face_height, is_near)

    def _intersect_planes(
        self, axis: int, hit_index: Ints, face_height: Floats, is_near: Bools
    ) -> Iterator[EdgeValues]:
        """Yield the edges where visible surfaces may meet the planes of box faces.

        A cell is a pixel, or a square part of a pixel, with a visible hit at its centre.

        Parameters
        ----------
        axis : int
            Axis of the scene to which all planes are perpendicular: 0, 1 or 2.
        hit_index : (n,) int array
            Index of the visible hit in each of n pairs of a hit and a plane.
        face_height : (n,) float array
            Coordinate of each pair's plane along the axis, minus that of the eye.
        is_near : (n,) bool array
            Whether the plane may meet the visible surface in the cell.  Other pairs are skipped.

        Yields
        ------
        cell : (k,) int array
            Index of the cell of each edge.
        values : (6, k) float array
            Values of the edge function (a smooth function that is zero at the edge) at six points
            of the cell: the centre; the centres of the right, left, lower and upper side; and the
            lower right corner.  The function is 1 / t1 - 1 / t2: the ray meets the visible
            surface at t1 * ray, and the plane at t2 * ray.
        """
        for batch in index_batches(indices(is_near)):
            ray, inverse_t = self.trace_rays(hit_index[batch])
            face_component = self.hits.scene.frame.scene_component(ray, axis)
            yield self.cell[hit_index[batch]], inverse_t - face_component / face_height[batch]

    def evaluate_shadow_edges(
        self, light_position: Floats, edge_triples: Ints
    ) -> Iterator[EdgeValues]:
        """Yield the edges of shadows: the silhouettes of occluders, seen from the lights.

        A cell is a pixel, or a square part of a pixel, with a hit at its centre.

        Parameters
        ----------
        light_position : (m, 3) float array
            Positions of the lights, in the axes of the scene.
        edge_triples : (3, n) int array
            Row 0 contains light indices, row 1 hit indices, and row 2 indices of objects whose
            shadow may have an edge within the footprint of the hit (the part of the surface that is
            visible in the cell).

        Yields
        ------
        cell : (k,) int array
            Index of the cell of each edge.
        values : (6, k) float array
            Values of the edge function (a smooth function that is zero at the edge) at six points
            of the cell: the centre; the centres of the right, left, lower and upper side; and the
            lower right corner.
        """
        scene = self.hits.scene
        light_from_eye = scene.frame.points_to_camera(light_position)
        for batch in index_batches(np.arange(edge_triples.shape[1])):
            light_index, hit_index, occluder_index = edge_triples[:, batch]
            ray, inverse_t = self.trace_rays(hit_index)
            # The vector from the light to the surface is t * ray - light.  Divide it by t.
            scaled_light = scale3(take3(light_from_eye, light_index), inverse_t)
            light_ray = map3(np.subtract, ray, scaled_light)
            triples = np.array([light_index, self.cell[hit_index], occluder_index])
            yield from evaluate_silhouettes(scene, light_position, triples, light_ray)

    def find_terminators(
        self, light_position: Floats, n_dot_l: Floats, length2: Floats
    ) -> Iterator[EdgeValues]:
        """Yield the terminators: the edges where spheres turn away from lights.

        A cell is a pixel, or a square part of a pixel, with a hit at its centre.  Terminators are
        searched for within the footprint of the hit (the part of the surface that is visible in
        the cell).

        Parameters
        ----------
        light_position : (m, 3) float array
            Positions of the lights, in the axes of the scene.
        n_dot_l : (m, n) float array
            n . l for each light and each of n hits, where n is the unit normal, and l the vector
            from the hit to the light.
        length2 : (m, n) float array
            l . l: the squared distance of the light from the hit.

        Yields
        ------
        cell : (k,) int array
            Index of the cell of each edge.
        values : (6, k) float array
            Values of the edge function (a smooth function that is zero at the edge) at six points
            of the cell: the centre; the centres of the right, left, lower and upper side; and the
            lower right corner.  The function is the cosine of the angle between n and l.
        """
        scene, spheres = self.hits.scene, self.hits.scene.spheres
        hit_object = self.hits.hit_object
        light_from_eye = scene.frame.points_to_camera(light_position)
        # The normal turns by at most this angle within the footprint, in radians.
        max_turn = self.footprint * scene.curvature[hit_object]
        for pair_index in index_batches(indices(n_dot_l**2 < max_turn * max_turn * length2)):
            light_index, hit_index = np.divmod(pair_index, max_turn.size)
            ray, inverse_t = self.trace_rays(hit_index)
            # The ray meets the sphere at ray / inverse_t.  Multiply all vectors by inverse_t.
            sphere_index = spheres.objects.positions(hit_object[hit_index])
            center = take3(spheres.from_eye, sphere_index)
            normal = map3(np.subtract, ray, scale3(center, inverse_t))
            light = scale3(take3(light_from_eye, light_index), inverse_t)
            to_light = map3(np.subtract, light, ray)
            length_product = np.sqrt(dot(normal, normal) * dot(to_light, to_light))
            yield self.cell[hit_index], dot(normal, to_light) / length_product
