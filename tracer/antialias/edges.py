"""Find the edges that may cross cells of the picture: silhouettes, creases, shadows, terminators.

A cell is a pixel or a square part of a pixel.  Each edge is described by an edge function: a smooth
function of the position in the picture that is zero on the edge.  The functions of this module
yield the values of edge functions at six points of each cell (see `edge_functions`, which lists
them).

*Silhouettes* are the outlines of objects; seen from a light, they are the edges of shadows.  They
are computed for all pixels that the outline of an object may cross, so that an object is found even
if no sample hits it.  All other edges are searched for around the *hit* of each cell, which is the
point where the ray through the centre of the cell meets a surface.  The search covers the
*footprint* of the hit, which is the part of the surface that is visible in the cell.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated as Shaped
from typing import NamedTuple

import numpy as np

from tracer.antialias.edge_functions import EdgeValues, compute_rays
from tracer.arrays import (
    Bools,
    Floats,
    Ints,
    Triple,
    dot,
    find,
    map_xyz,
    scale,
    split_indices,
    take,
    take_columns,
)
from tracer.geometry.camera import CameraFrame
from tracer.geometry.shape import CURVED_FACE, NO_AXIS, Shape
from tracer.trace.hits import Hits
from tracer.world.prepared_scene import PreparedScene


def compute_footprint_radii(hits: Hits, cell_width: float) -> Shaped[Floats, "n"]:
    """Compute the radius of the footprint of each hit, in the scene's unit of length.

    The cells are `cell_width` pixels wide.
    """
    cell_angle = _compute_cell_angle(hits.scene.frame, cell_width)
    distance = hits.distance
    footprint_radius = np.empty(distance.size)
    for group in hits.groups:
        cell_radius = hits.from_eye[2][group.interval] * cell_angle
        cosine = group.expand_to_hits(group.planes.eye_height) / distance[group.interval]
        footprint_radius[group.interval] = group.shape.compute_footprint_radii(
            group.run_object, group.run_length, cell_radius, cosine, cell_angle
        )
    return footprint_radius


def _compute_cell_angle(frame: CameraFrame, cell_width: float) -> float:
    """Compute the angle in radians that half the diagonal of a cell subtends at the eye.

    The cell is straight ahead of the eye; all others subtend smaller angles.
    """
    return 0.5 * cell_width * float(np.hypot(frame.pixel_width, frame.pixel_height)) / frame.depth


def evaluate_silhouettes(
    scene: PreparedScene,
    viewpoint: Shaped[Floats, "viewpoints 3"],
    ray: Shaped[Triple, "#6 n"],
    *,
    viewpoint_index: Shaped[Ints, "n"],
    cell_index: Shaped[Ints, "n"],
    object_index: Shaped[Ints, "n"],
) -> Iterator[EdgeValues]:
    """Yield the edges of silhouettes that may cross cells, from pairs of a cell and an object.

    Parameters
    ----------
    viewpoint
        Positions of the eye or of lights, in scene axes.
    ray
        Directions from the viewpoint to the visible surface at six points of each cell (see
        `compute_rays`), in camera axes.
    """
    for shape in scene.shapes:
        column = find(shape.objects.contains(object_index))
        if column.size:
            edges = shape.find_silhouettes(
                object_index[column],
                viewpoint.T[:, viewpoint_index[column]],
                take_columns(ray, column),
            )
            yield EdgeValues(cell_index=cell_index[column[edges.item_index]], values=edges.values)


class ExtendedFaces(NamedTuple):
    """The faces at n hits, extended beyond their rims, in a form that is fast to intersect.

    A ray d from the eye meets a planar face, with the unit normal n and the hit p, at t d where
    1 / t = d . n / (n . p).
    """

    shapes: list[Shape]  # shapes with curved faces
    scaled_normal: Shaped[Triple, "n"]  # n / (n . p)
    curved_object: Shaped[Ints, "n"]  # object index of hits on curved faces; -1 for planar faces

    @classmethod
    def from_hits(cls, hits: Hits) -> ExtendedFaces:
        """Collect the face that each hit is on."""
        scaled_normal = np.empty(hits.from_eye.shape)
        curved_object = np.empty(hits.from_eye.shape[1], dtype=np.intp)
        for group in hits.groups:
            planes = group.planes
            run_object = np.where(planes.face_axis == NO_AXIS, group.run_object, -1)
            curved_object[group.interval] = group.repeat_runs(run_object)
            # The height of the eye above the plane is -(n . p).
            for axis, component in enumerate(planes.normal):
                scaled_component = component / -planes.eye_height
                scaled_normal[axis, group.interval] = group.expand_to_hits(scaled_component)
        return cls(
            shapes=[shape for shape in hits.scene.shapes if shape.has_curved_face],
            scaled_normal=(scaled_normal[0], scaled_normal[1], scaled_normal[2]),
            curved_object=curved_object,
        )

    def take(self, face_index: Shaped[Ints, "m"]) -> ExtendedFaces:
        return self._replace(
            scaled_normal=take(self.scaled_normal, face_index),
            curved_object=self.curved_object[face_index],
        )

    def compute_inverse_t(self, ray: Shaped[Triple, "#6 n"]) -> Shaped[Floats, "6 n"]:
        """Compute 1 / t for six rays to each face, where t * ray is the point on the face."""
        inverse_t = dot(self.scaled_normal, ray)
        for shape in self.shapes:
            column = find(shape.objects.contains(self.curved_object))
            if column.size:
                curved_ray = take_columns(ray, column)
                inverse_t[:, column] = shape.compute_inverse_t(
                    CURVED_FACE, self.curved_object[column], curved_ray
                )
        return inverse_t


class CellSurfaces(NamedTuple):
    """The surfaces that are visible in cells, at hits, at most one in each cell.

    The methods find the edges that may cross the cells.
    """

    hits: Hits
    faces: ExtendedFaces  # that the hits are on
    cell_index: Shaped[Ints, "hits"]
    footprint_radius: Shaped[Floats, "hits"]
    cell_width: float  # in pixels

    def trace_rays(
        self, hit_index: Shaped[Ints, "k"]
    ) -> tuple[Shaped[Triple, "#6 k"], Shaped[Floats, "6 k"]]:
        """Compute the rays of cells (see `compute_rays`), and intersect them with their faces.

        The second result is 1 / t for each ray, where t * ray is the vector from the eye to the
        face, extended beyond its rim.
        """
        frame = self.hits.scene.frame
        x, y, z = take(self.hits.from_eye, hit_index)
        depth_ratio = frame.depth / z
        ray = compute_rays(frame, x * depth_ratio, y * depth_ratio, self.cell_width)
        return ray, self.faces.take(hit_index).compute_inverse_t(ray)

    def find_intersections(self, hidden_hits: Hits) -> Iterator[EdgeValues]:
        """Yield an edge for each cell in which the visible surface and one behind it may meet.

        The hidden hits are behind the visible hits, on the same rays.
        """
        sample_index = self.hits.sample_index
        hit_by_sample = np.empty(int(sample_index.max(initial=0)) + 1, dtype=np.intp)
        hit_by_sample[sample_index] = np.arange(sample_index.size)
        visible_hit_index = hit_by_sample[hidden_hits.sample_index]
        # Surfaces that meet within the cell are at most this far apart along the ray.
        max_gap = compute_footprint_radii(hidden_hits, self.cell_width)
        max_gap += self.footprint_radius[visible_hit_index]
        is_close = hidden_hits.distance - self.hits.distance[visible_hit_index] <= max_gap
        hidden_surfaces = ExtendedFaces.from_hits(hidden_hits)
        for hidden_index in split_indices(find(is_close)):
            hit_index = visible_hit_index[hidden_index]
            ray, inverse_t = self.trace_rays(hit_index)
            hidden_inverse_t = hidden_surfaces.take(hidden_index).compute_inverse_t(ray)
            yield EdgeValues(
                cell_index=self.cell_index[hit_index], values=inverse_t - hidden_inverse_t
            )
        yield from self._find_face_intersections(hidden_hits, visible_hit_index, is_close)

    def _find_face_intersections(
        self,
        hidden_hits: Hits,
        visible_hit_index: Shaped[Ints, "n"],
        is_close: Shaped[Bools, "n"],
    ) -> Iterator[EdgeValues]:
        """Yield an edge for each visible surface and planar face that may meet.

        The face belongs to an object behind the surface.  The ray through the centre of the cell
        hits the object, but not necessarily this face.

        Parameters
        ----------
        visible_hit_index
            Index of the visible hit in front of each hidden hit, on the same ray from the eye.
        is_close
            Whether the two surfaces may meet near the hidden hit; ignored if the eye is inside the
            object.
        """
        cell_angle = _compute_cell_angle(hidden_hits.scene.frame, self.cell_width)
        hidden_object = hidden_hits.hit_object
        hidden_distance = hidden_hits.distance
        is_candidate = is_close | hidden_hits.scene.is_eye_inside[hidden_object]
        visible_distance = self.hits.distance
        for group in hidden_hits.groups:
            if not group.shape.has_planar_faces:
                continue
            hidden_index = group.interval.start + find(is_candidate[group.interval])
            object_index = hidden_object[hidden_index]
            hit_index = visible_hit_index[hidden_index]
            to_hit = take(hidden_hits.from_eye, hidden_index)
            distance = hidden_distance[hidden_index]
            faces = group.shape.intersect_other_faces(object_index, to_hit, cell_angle)
            for face_code, item_index, t, radius in faces:
                face_hit = hit_index[item_index]
                gap = np.abs(t * distance[item_index] - visible_distance[face_hit])
                may_meet = gap <= self.footprint_radius[face_hit] + radius
                yield from self._compare_with_face(
                    group.shape, face_code, object_index[item_index[may_meet]], face_hit[may_meet]
                )

    def find_creases(self) -> Iterator[EdgeValues]:
        """Yield an edge for each cell that a crease may cross.

        A crease is an edge between two visible faces of an object, one of which is hit.
        """
        for group in self.hits.groups:
            faces = group.shape.find_near_faces(
                group.run_object,
                group.run_length,
                group.planes.face_axis,
                self.hits.from_eye[:, group.interval],
                self.footprint_radius[group.interval],
            )
            for face_code, index_in_group in faces:
                object_index = group.repeat_runs(group.run_object)[index_in_group]
                hit_index = group.interval.start + index_in_group
                yield from self._compare_with_face(group.shape, face_code, object_index, hit_index)

    def _compare_with_face(
        self,
        shape: Shape,
        face_code: int,
        object_index: Shaped[Ints, "n"],
        hit_index: Shaped[Ints, "n"],
    ) -> Iterator[EdgeValues]:
        """Yield the edge where each visible surface meets a face of an object.

        The edge function is 1 / t1 - 1 / t2: the ray through a point of the cell meets the surface
        at t1 * ray, and the face at t2 * ray.
        """
        for batch in split_indices(np.arange(hit_index.size)):
            ray, surface_inverse_t = self.trace_rays(hit_index[batch])
            face_inverse_t = shape.compute_inverse_t(face_code, object_index[batch], ray)
            yield EdgeValues(
                cell_index=self.cell_index[hit_index[batch]],
                values=surface_inverse_t - face_inverse_t,
            )

    def evaluate_shadow_edges(
        self,
        light_position: Shaped[Floats, "lights 3"],
        edge_candidates: Shaped[Ints, "3 n"],
    ) -> Iterator[EdgeValues]:
        """Yield the edges of shadows that may cross cells.

        The lights are in scene axes.  Row 0 of `edge_candidates` contains light indices, row 1 hit
        indices, and row 2 indices of occluders.
        """
        scene = self.hits.scene
        light_from_eye = scene.frame.point_to_camera(light_position)
        for batch in split_indices(np.arange(edge_candidates.shape[1])):
            light_index, hit_index, occluder_index = edge_candidates[:, batch]
            ray, inverse_t = self.trace_rays(hit_index)
            # The vector from the light to the surface is t * ray - light.  Only its direction
            # matters, so it is divided by t.
            light_over_t = scale(take(light_from_eye, light_index), inverse_t)
            ray_from_light = map_xyz(np.subtract, ray, light_over_t)
            yield from evaluate_silhouettes(
                scene,
                light_position,
                ray_from_light,
                viewpoint_index=light_index,
                cell_index=self.cell_index[hit_index],
                object_index=occluder_index,
            )

    def find_terminators(
        self,
        light_position: Shaped[Floats, "lights 3"],
        light_height: Shaped[Floats, "lights hits"],
        squared_distance: Shaped[Floats, "lights hits"],
    ) -> Iterator[EdgeValues]:
        """Yield an edge for each light and each cell that the light's terminator may cross.

        A terminator is where a curved face turns away from a light.  Its edge function is the
        cosine of the angle between the normal and the direction to the light.

        Parameters
        ----------
        light_position
            Positions of the lights, in scene axes.
        light_height
            Height of each light above the tangent plane at each hit; negative if the surface does
            not face the light.
        squared_distance
            Square of the distance from each hit to each light.
        """
        scene = self.hits.scene
        light_from_eye = scene.frame.point_to_camera(light_position)
        for group in self.hits.groups:
            if not group.shape.has_curved_face:
                continue
            is_curved = group.planes.face_axis == NO_AXIS
            curvature = np.where(is_curved, scene.curvature[group.run_object], 0)
            # The normal turns by at most this angle within the footprint, in radians.
            max_turn = self.footprint_radius[group.interval] * group.repeat_runs(curvature)
            max_squared_height = max_turn * max_turn * squared_distance[:, group.interval]
            may_cross = light_height[:, group.interval] ** 2 < max_squared_height
            hit_object = group.repeat_runs(group.run_object)
            for pair_index in split_indices(find(may_cross)):
                light_index, index_in_group = np.divmod(pair_index, max_turn.size)
                hit_index = group.interval.start + index_in_group
                ray, inverse_t = self.trace_rays(hit_index)
                # The ray meets the surface at t * ray.  All vectors are divided by t.
                normal = group.shape.compute_normals(hit_object[index_in_group], ray, inverse_t)
                light_over_t = scale(take(light_from_eye, light_index), inverse_t)
                to_light = map_xyz(np.subtract, light_over_t, ray)
                length_product = np.sqrt(dot(normal, normal) * dot(to_light, to_light))
                cosine = dot(normal, to_light) / length_product
                yield EdgeValues(cell_index=self.cell_index[hit_index], values=cosine)
