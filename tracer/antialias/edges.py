"""Find the edges that may cross cells of the picture, and evaluate their edge functions.

A *cell* is a pixel or a square part of a pixel.  An *edge function* is a smooth function of the
position in the picture that is zero on an edge.  The functions of this module yield the values of
edge functions at six points of each cell, from which `fit_lines` makes lines.  Each value is
computed from the ray from the eye through the point:

==========================  ======================================================================
silhouette of a sphere      the angle between the ray and the direction to the sphere's center,
                            minus the angular radius of the sphere
silhouette edge of a box    n . ray, with the normal n of the plane through viewpoint and edge
intersection of surfaces,   1 / t1 - 1 / t2, where the points t1 * ray and t2 * ray lie on the two
or crease                   surfaces
terminator                  the cosine between the normal and the direction to the light
==========================  ======================================================================

For planar faces, n . ray and 1 / t are linear functions of the position in the picture, so their
edges are exactly straight.

A *silhouette* is the outline of an object, seen from a *viewpoint*: the eye or a light.  An outline
seen from a light is the edge of a shadow; the ray in the table then leads from the light to the
surface that is visible in the cell.

Except for silhouettes seen from the eye, edges are searched for around the *hit* of a cell, which
is the point where the ray through the center of the cell meets a surface.  The search covers the
*footprint* of the hit, which is the part of the surface that is visible in the cell.

Vectors are in camera axes, relative to the eye, unless scene axes are mentioned.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated as Shaped
from typing import NamedTuple

import numpy as np

from tracer.antialias.cells import Cells
from tracer.antialias.edge_functions import EdgeValues, compute_rays
from tracer.antialias.extended_faces import ExtendedFaces
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
from tracer.geometry.shape import NO_AXIS, Shape, compute_footprint_radii
from tracer.trace.hits import Hits
from tracer.world.prepared_scene import PreparedScene


def find_silhouettes_from_eye(scene: PreparedScene, cells: Cells) -> Iterator[EdgeValues]:
    """Yield the silhouettes, seen from the eye, of the objects that `cells` pairs with cells."""
    frame = scene.frame
    for batch in split_indices(np.arange(cells.pair_cell_index.size)):
        cell_index = cells.pair_cell_index[batch]
        ray_x = frame.to_ray_x(cells.center_x[cell_index])
        ray_y = frame.to_ray_y(cells.center_y[cell_index])
        yield from _evaluate_silhouettes(
            scene,
            frame.eye[None],
            compute_rays(frame, ray_x, ray_y, cells.width),
            viewpoint_index=np.zeros_like(cell_index),
            cell_index=cell_index,
            object_index=cells.pair_object_index[batch],
        )


def _evaluate_silhouettes(
    scene: PreparedScene,
    viewpoint: Shaped[Floats, "viewpoints 3"],
    ray: Shaped[Triple, "#6 n"],
    *,
    viewpoint_index: Shaped[Ints, "n"],
    cell_index: Shaped[Ints, "n"],
    object_index: Shaped[Ints, "n"],
) -> Iterator[EdgeValues]:
    """Yield the silhouettes of objects that may cross cells, for n pairs of a cell and an object.

    Parameters
    ----------
    viewpoint
        Positions of the eye or of lights, in scene axes.
    ray
        For each pair, directions from its viewpoint to what the eye sees at the six points of the
        cell (see `compute_rays`), in camera axes.
    viewpoint_index
        Index of the viewpoint of each pair.
    """
    for shape in scene.shapes:
        pair_index = find(shape.objects.contains(object_index))
        if pair_index.size:
            edges = shape.find_silhouettes(
                object_index[pair_index],
                viewpoint.T[:, viewpoint_index[pair_index]],
                take_columns(ray, pair_index),
            )
            edge_pair_index = pair_index[edges.item_index]
            yield EdgeValues(cell_index=cell_index[edge_pair_index], values=edges.values)


class CellSurfaces(NamedTuple):
    """What is visible at the centers of cells, with at most one hit for each cell.

    The methods yield edges that may cross the cells, in batches.
    """

    hits: Hits
    faces: ExtendedFaces  # the faces that the hits are on
    cell_index: Shaped[Ints, "hits"]
    footprint_radius: Shaped[Floats, "hits"]
    cell_width: float  # width of all cells, in pixels

    @classmethod
    def from_hits(
        cls, hits: Hits, cell_index: Shaped[Ints, "hits"], cell_width: float
    ) -> CellSurfaces:
        """Collect the surfaces at the hits of cells, which are `cell_width` pixels wide."""
        return cls(
            hits=hits,
            faces=ExtendedFaces.from_hits(hits),
            cell_index=cell_index,
            footprint_radius=_compute_footprint_radii(hits, cell_width),
            cell_width=cell_width,
        )

    def find_intersections(self, hidden_hits: Hits) -> Iterator[EdgeValues]:
        """Yield edges where the visible surface of a cell may meet a surface behind it.

        The hidden hits lie behind the visible hits, on the same rays from the eye.
        """
        visible_hit_index = self._find_hits_in_front(hidden_hits)
        # Surfaces that meet within the cell are at most this far apart along the ray.
        max_gap = _compute_footprint_radii(hidden_hits, self.cell_width)
        max_gap += self.footprint_radius[visible_hit_index]
        is_close = hidden_hits.distance - self.hits.distance[visible_hit_index] <= max_gap
        hidden_faces = ExtendedFaces.from_hits(hidden_hits)
        for hidden_index in split_indices(find(is_close)):
            hit_index = visible_hit_index[hidden_index]
            ray, inverse_t = self._trace_rays(hit_index)
            hidden_inverse_t = hidden_faces.take(hidden_index).compute_inverse_t(ray)
            yield EdgeValues(
                cell_index=self.cell_index[hit_index], values=inverse_t - hidden_inverse_t
            )
        yield from self._find_face_intersections(hidden_hits, visible_hit_index, is_close)

    def _find_hits_in_front(self, hidden_hits: Hits) -> Shaped[Ints, "n"]:
        """Return, for each hidden hit, the index of the visible hit on the same ray."""
        hit_by_sample = np.empty(self.hits.samples.size, dtype=np.intp)
        hit_by_sample[self.hits.sample_index] = np.arange(self.cell_index.size)
        return hit_by_sample[hidden_hits.sample_index]

    def _find_face_intersections(
        self,
        hidden_hits: Hits,
        visible_hit_index: Shaped[Ints, "n"],
        is_close: Shaped[Bools, "n"],
    ) -> Iterator[EdgeValues]:
        """Yield edges where the visible surface may meet a face that no hidden hit is on.

        A hidden hit is on one face of its object, but the visible surface may meet the other planar
        faces of this object, too.  The ray through the center of the cell meets the plane of such a
        face somewhere.  The edge is yielded if this point is close enough to the visible hit.

        Parameters
        ----------
        visible_hit_index
            Index of the visible hit in front of each hidden hit, on the same ray from the eye.
        is_close
            Whether the visible surface may meet the face that the hidden hit is on.  Only such
            hidden hits, and hidden hits on objects that contain the eye, are examined.
        """
        cell_angle = _compute_cell_angle(hidden_hits.scene.frame, self.cell_width)
        hidden_object = hidden_hits.hit_object
        hidden_distance = hidden_hits.distance
        visible_distance = self.hits.distance
        is_candidate = is_close | hidden_hits.scene.is_eye_inside[hidden_object]
        for group in hidden_hits.groups:
            if not group.shape.has_planar_faces:
                continue
            hidden_index = group.interval.start + find(is_candidate[group.interval])
            object_index = hidden_object[hidden_index]
            front_hit_index = visible_hit_index[hidden_index]
            to_hit = take(hidden_hits.from_eye, hidden_index)
            distance = hidden_distance[hidden_index]
            for face in group.shape.intersect_other_faces(object_index, to_hit, cell_angle):
                hit_index = front_hit_index[face.item_index]
                face_distance = face.t * distance[face.item_index]
                gap = np.abs(face_distance - visible_distance[hit_index])
                may_meet = gap <= self.footprint_radius[hit_index] + face.footprint_radius
                yield from self._intersect_with_face(
                    group.shape,
                    face.face_code,
                    object_index[face.item_index[may_meet]],
                    hit_index[may_meet],
                )

    def find_creases(self) -> Iterator[EdgeValues]:
        """Yield edges that may cross cells, between the face hit at the center and another one.

        Both faces belong to one object.
        """
        for group in self.hits.groups:
            faces = group.shape.find_near_faces(
                group.run_object,
                group.run_length,
                group.planes.face_axis,
                self.hits.from_eye[:, group.interval],
                self.footprint_radius[group.interval],
            )
            hit_object = group.repeat_runs(group.run_object)
            for face_code, index_in_group in faces:
                hit_index = group.interval.start + index_in_group
                yield from self._intersect_with_face(
                    group.shape, face_code, hit_object[index_in_group], hit_index
                )

    def _intersect_with_face(
        self,
        shape: Shape,
        face_code: int,
        object_index: Shaped[Ints, "n"],
        hit_index: Shaped[Ints, "n"],
    ) -> Iterator[EdgeValues]:
        """Yield the edges where the surface at each hit meets a face of the object paired with it.

        `face_code` is the code of this face (see `tracer.geometry.shape`).
        """
        for batch in split_indices(np.arange(hit_index.size)):
            ray, surface_inverse_t = self._trace_rays(hit_index[batch])
            face_inverse_t = shape.compute_inverse_t(face_code, object_index[batch], ray)
            yield EdgeValues(
                cell_index=self.cell_index[hit_index[batch]],
                values=surface_inverse_t - face_inverse_t,
            )

    def find_shadow_edges(
        self,
        light_position: Shaped[Floats, "lights 3"],
        edge_candidates: Shaped[Ints, "3 n"],
    ) -> Iterator[EdgeValues]:
        """Yield the shadow edges that may cross cells.

        `light_position` is in scene axes.  The rows of `edge_candidates` are indices of lights, of
        hits, and of objects that may block the light near the hit.
        """
        scene = self.hits.scene
        light_from_eye = scene.frame.point_to_camera(light_position)
        for batch in split_indices(np.arange(edge_candidates.shape[1])):
            light_index, hit_index, occluder_index = edge_candidates[:, batch]
            ray, inverse_t = self._trace_rays(hit_index)
            # The vector from the light to the surface is t * ray - light.  Only its direction
            # matters, so it is divided by t.
            light_over_t = scale(take(light_from_eye, light_index), inverse_t)
            ray_from_light = map_xyz(np.subtract, ray, light_over_t)
            yield from _evaluate_silhouettes(
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
        """Yield the edges at which curved faces turn away from a light, if they may cross cells.

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
            # The normal turns by at most this angle within the footprint, in radians.  The height
            # of the light above the tangent plane then changes by at most max_turn * distance.
            max_turn = self.footprint_radius[group.interval] * group.repeat_runs(curvature)
            max_squared_height = max_turn * max_turn * squared_distance[:, group.interval]
            may_cross = light_height[:, group.interval] ** 2 < max_squared_height
            hit_object = group.repeat_runs(group.run_object)
            for pair_index in split_indices(find(may_cross)):
                light_index, index_in_group = np.divmod(pair_index, max_turn.size)
                hit_index = group.interval.start + index_in_group
                cosine = self._compute_light_cosines(
                    group.shape,
                    hit_object[index_in_group],
                    hit_index,
                    take(light_from_eye, light_index),
                )
                yield EdgeValues(cell_index=self.cell_index[hit_index], values=cosine)

    def _compute_light_cosines(
        self,
        shape: Shape,
        object_index: Shaped[Ints, "n"],
        hit_index: Shaped[Ints, "n"],
        light: Shaped[Triple, "n"],
    ) -> Shaped[Floats, "6 n"]:
        """Compute the cosine between the normal and the direction to a light at six points.

        These are the points of the surface that the rays through the six points of a cell meet.
        `object_index` and `light` are the object at each hit, and the position of a light.
        """
        ray, inverse_t = self._trace_rays(hit_index)
        # The ray meets the surface at t * ray.  All vectors are divided by t.
        normal = shape.compute_normals(object_index, ray, inverse_t)
        to_light = map_xyz(np.subtract, scale(light, inverse_t), ray)
        length_product = np.sqrt(dot(normal, normal) * dot(to_light, to_light))
        return dot(normal, to_light) / length_product

    def _trace_rays(
        self, hit_index: Shaped[Ints, "k"]
    ) -> tuple[Shaped[Triple, "#6 k"], Shaped[Floats, "6 k"]]:
        """Compute the six rays of the cell of each hit, and 1 / t where they meet its surface.

        The rays pass through the six points of the cell (see `compute_rays`).  The vector t * ray
        leads from the eye to the face at the hit, which is extended beyond its rim.
        """
        frame = self.hits.scene.frame
        x, y, z = take(self.hits.from_eye, hit_index)
        depth_ratio = frame.depth / z
        ray = compute_rays(frame, x * depth_ratio, y * depth_ratio, self.cell_width)
        return ray, self.faces.take(hit_index).compute_inverse_t(ray)


def _compute_footprint_radii(hits: Hits, cell_width: float) -> Shaped[Floats, "n"]:
    """Compute the radius of the part of the surface that is visible in the cell of each hit.

    It is in the scene's unit of length.  The cells are `cell_width` pixels wide.
    """
    cell_angle = _compute_cell_angle(hits.scene.frame, cell_width)
    cell_radius = hits.from_eye[2] * cell_angle
    cosine = hits.eye_height / hits.distance
    return compute_footprint_radii(cell_radius, cosine, cell_angle)


def _compute_cell_angle(frame: CameraFrame, cell_width: float) -> float:
    """Compute the angle, in radians, that half the diagonal of a cell subtends at the eye.

    The cell is straight ahead of the eye.  The angles of all other cells are smaller.
    """
    return 0.5 * cell_width * float(np.hypot(frame.pixel_width, frame.pixel_height)) / frame.depth
