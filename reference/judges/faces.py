"""Describe a scene for the certificate: faces, lights and shadows, in the camera's axes.

Which functions decide what a pixel shows, and how can they be bounded?  A *face* is a sphere, or a
rectangular side of a box.  Divided by the distance to the face, all that the certificate needs to
know about a face is linear or quadratic in the direction of a camera ray, except for one square
root:

- A ray from the eye with direction d meets a face at t d.  Let a sphere have centre c and radius r,
  and let p = |c|^2 - r^2 be the power of the eye.  Then t = p / (c.d + sqrt((c.d)^2 - p d^2)): the
  near intersection if the eye is outside the sphere, the far one if it is inside.  Hence

      1 / t = k.d + s    with k = c / p, s^2 = w^2 (r^2 d^2 - |c x d|^2) and w = 1 / p.

  For a plane e.x = l, 1 / t = k.d with k = e / l, and s = 0.
- A *half-space* is the set of points x with n.x + b >= 0.  The point t d is inside if
  n.d + b / t >= 0.  A half-space is stored as five numbers: n, b, and the sum of the absolute
  values of the terms of b, from which rounding errors are bounded.
- The height of a light above the tangent plane of a face, divided by t, also has the form
  n.d + b / t.

In the certificate, only this module uses internals of the tracer: the prepared scene, its light
grid, and single samples.  From a sample, the certificate uses only *which* face is visible and
*which* lights reach it, never the radiance.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from reference.judges.arrays import Bools, Floats, Ints
from tracer import Scene
from tracer.geometry.box import Boxes
from tracer.geometry.silhouette import find_edge_planes
from tracer.geometry.sphere import Spheres
from tracer.trace.hits import Hits
from tracer.trace.lighting import compute_light_geometry
from tracer.trace.occlusion import find_shadows
from tracer.trace.samples import Scattered
from tracer.trace.visibility import find_nearest_hits
from tracer.world.prepared_scene import PreparedScene

# Maximum distance of a light, relative to the size of the smallest object.  Seen from farther away,
# both ends of an object may round to the same direction.
_MAX_LIGHT_DISTANCE = 1e14


class Faces:
    """The f faces, m lights and n objects (spheres first) of a scene, in the camera's axes.

    A face is a sphere, or a side of a box.  Faces are numbered as follows: all spheres, then the
    low sides of all boxes along x, their high sides along x, and the same for y and z.

    A camera ray with direction d meets a face at t d, relative to the eye, with 1 / t = k.d + s.
    For a side of a box, s = 0.  For a sphere with centre c and radius r,
    s^2 = w^2 (r^2 d^2 - |c x d|^2).

    A half-space is the set of points x with n.x + b >= 0.  It is stored as five numbers: the three
    components of n, then b, then the sum of the absolute values of the terms of b.

    Attributes
    ----------
    frame, prepared_scene : CameraFrame, PreparedScene
        The camera, and the scene that the tracer prepared for it.
    prepared_lights : Lights
        The lights that the tracer prepared.
    sphere_count, object_count : int
        Number of spheres, and of all objects.
    light_position : (m, 3) float array
        Positions of the lights relative to the eye.
    center, radius : (3, spheres) and (spheres,) float arrays
        Centres, relative to the eye, and radii of the spheres.
    eye_power : (spheres,) float array
        Power of the eye, |center|^2 - radius^2, which is negative if the eye is inside the sphere.
    object_index : (f,) int array
        Index of the object to which a face belongs.
    is_planar : (f,) bool array
        Whether the face is a side of a box.
    may_be_visible : (f,) bool array
        Whether the face would be visible from the eye if no other object hid it.
    sheet_face_index : (n,) int array
        For a sheet (a box without extent along one axis), the index of its only face that has area
        and may be visible; for other objects, -1.
    plane_id : (2, f) float array
        Two numbers that are equal only for faces in the same plane.  If two such faces overlap, the
        first in the scene file is visible.
    linear_coef, root_coef : (3, f) and (f,) float arrays
        Coefficients k and w of the inverse distance (see above).  For a side of a box, w = 0.
    face_equation : (5, f) float array
        For a side of a box, the half-space beyond its plane.  For a sphere, the terms -2 c.x + p of
        its equation, without the term x^2 that all spheres share.
    height_half_space : (5, m + 1, f) float array
        For each light, then the eye: the half-space with n.d + b / t equal to the height of the
        light (or eye) above the face's tangent plane, divided by t.
    rim_half_spaces : (5, 4, f) float array
        Four half-spaces whose intersection with the plane of a side of a box is this side.
    bounding_box : (2, 3, f) float array
        Lower and upper corners of the bounding boxes of the faces' objects, in the scene's axes.
    is_unlit : (m, f) bool array
        Whether the light certainly reaches no visible point of the face: it is (1) outside an
        object that contains the eye, (2) inside any other object, or (3) behind the face's plane.
    to_center : (3, m, spheres) float array
        Vectors from the lights to the spheres' centres.
    shadow_volume : (5, 9, m, boxes) float array
        Nine half-spaces whose intersection is the shadow volume of a box.  The first three lie
        behind the sides that face the light.  The planes of the other six contain the light and the
        box's silhouette.
    has_shadow_edge : (9, m, boxes) bool array
        Whether the plane of the half-space may contain an edge of the shadow.  The plane of a side
        does so only if it contains the light.
    """

    def __init__(self, scene: Scene) -> None:
        """Compute the attributes of all faces, objects and lights of a scene.

        Parameters
        ----------
        scene : Scene
            The scene.

        Raises
        ------
        ValueError
            If the eye is on a surface, or the distance of a light is more than 1e14 times the size
            of the smallest object.
        """
        self.prepared_scene = prepared_scene = PreparedScene(scene)
        self.frame, is_eye_inside = prepared_scene.frame, prepared_scene.is_eye_inside
        self.prepared_lights = lights = prepared_scene.prepare_lights()
        self.spheres = spheres = Spheres.from_surfaces(self.frame, scene.surfaces)
        self.boxes = boxes = Boxes.from_surfaces(self.frame, scene.surfaces)
        self.sphere_count, self.object_count = spheres.objects.size, is_eye_inside.size
        self.light_position, self.center = lights.from_eye, np.array(spheres.from_eye)
        self.radius, self.eye_power = spheres.radius, spheres.power
        low, high = (corner - self.frame.eye[:, None] for corner in (boxes.min_pt, boxes.max_pt))
        is_on_box = is_eye_inside[self.sphere_count :] & np.any((low == 0) | (high == 0), axis=0)
        if np.any(self.eye_power == 0) or is_on_box.any():
            raise ValueError("the eye is on a surface; move it off")
        lengths = np.append(spheres.radius, (boxes.max_pt - boxes.min_pt).ravel())
        max_distance = _MAX_LIGHT_DISTANCE * lengths[lengths > 0].min(initial=np.inf)
        if np.abs(self.light_position).max(initial=0) > max_distance:
            limit = f"{_MAX_LIGHT_DISTANCE:g} times the size of an object"
            raise ValueError(f"a light is farther away than {limit}; move it closer")
        self._set_face_attributes(low, high)
        self.to_center = self.center[:, None] - self.light_position.T[:, :, None]
        self._set_shadow_volumes(low, high)
        # `side` is positive for a light outside an object, negative inside, 0 on a side of a box.
        # In `lights.side`, a light on a side counts as outside.
        side, (light_x, light_y, light_z) = lights.side.copy(), lights.position.T[:, :, None]
        box_index = boxes.objects.list_indices()
        side[:, box_index] *= boxes.measure_distance(box_index, (light_x, light_y, light_z)) != 0
        is_separated = np.any(np.where(is_eye_inside, side > 0, side < 0), axis=1, keepdims=True)
        # In a box, the eye sees inner sides, which a light on or outside the box cannot reach.
        is_unlit = is_separated | (is_eye_inside & (lights.side >= 0))[:, self.object_index]
        self.is_unlit = is_unlit | (self.is_planar & (self.height_half_space[3, :-1] <= 0))

    def _set_face_attributes(self, low: Floats, high: Floats) -> None:
        """Set the attributes that describe faces (spheres and sides of boxes).

        They are `face_equation`, `linear_coef`, `root_coef`, `height_half_space`,
        `rim_half_spaces`, `plane_id`, `object_index`, `is_planar`, `bounding_box`, `may_be_visible`
        and `sheet_face_index`.  The docstring of the class describes them.

        Parameters
        ----------
        low, high : (3, boxes) float arrays
            Lower and upper corners of the boxes relative to the eye, along the scene's axes.
        """
        scene, axes, sphere_count = self.prepared_scene, self.frame.axes, self.sphere_count
        center, radius, power = self.center, self.radius, self.eye_power
        # Positions of the sides' planes, and their offsets from the eye.  The last three axes of
        # every array for boxes are: coordinate (x, y, z), side (low, high), box.
        offset = np.stack([low, high], axis=1)
        side_position = np.stack([self.boxes.min_pt, self.boxes.max_pt], axis=1)
        faces_eye = offset * [[-1], [1]] * np.where(scene.is_eye_inside[sphere_count:], 1, -1) > 0
        has_extent = low < high
        has_area = (has_extent[[1, 2, 0]] & has_extent[[2, 0, 1]])[:, None]
        light_or_eye = np.append(self.prepared_lights.position, self.frame.eye[None], axis=0)
        # Heights of the lights, and of the eye, above the planes of the sides.
        height = np.sign(offset) * (side_position - light_or_eye[:, :, None, None])
        side_height = np.array([*np.zeros((3, *height.shape)), height, np.abs(height)])
        half_space = np.empty((5, *offset.shape))  # half-spaces whose intersection is the box
        half_space[:3] = axes[:, :, None, None] * [[1], [-1]]
        half_space[3:] = offset * [[-1], [1]], np.abs(offset)
        rim = half_space[:, [[1, 2], [2, 0], [0, 1]]].reshape(5, 3, 4, 1, -1).swapaxes(1, 2)
        side_plane = np.array([np.indices(side_position.shape)[0], side_position])

        def append_sides(spheres: NDArray[Any], sides: NDArray[Any]) -> NDArray[Any]:
            """Append the values of all box sides to those of the spheres: an array (..., f)."""
            return np.append(spheres, sides.reshape(*spheres.shape[:-1], -1), axis=-1)

        self.face_equation = append_sides(np.array([*(-2 * center), power, abs(power)]), half_space)
        self.linear_coef = append_sides(center / power, axes[:, :, None, None] / offset)
        self.root_coef = append_sides(1 / power, 0 * offset)
        self.height_half_space = append_sides(self._compute_height_half_spaces(), side_height)
        self.rim_half_spaces = append_sides(np.zeros((5, 4, sphere_count)), rim.repeat(2, axis=3))
        sphere_index = np.arange(sphere_count)
        sphere_plane = np.array([np.full(sphere_count, 3), sphere_index])
        self.plane_id = append_sides(sphere_plane, side_plane)
        box_index = np.broadcast_to(np.arange(sphere_count, self.object_count), offset.shape)
        self.object_index = append_sides(sphere_index, box_index)
        self.is_planar = self.object_index >= sphere_count
        sphere_bounds = self.spheres.center + np.multiply.outer([-1, 1], radius)[:, None]
        object_bounds = np.append(sphere_bounds, side_position.swapaxes(0, 1), axis=2)
        self.bounding_box = object_bounds[:, :, self.object_index]
        may_be_visible = append_sides(np.full(sphere_count, True), faces_eye & has_area)
        self.may_be_visible = may_be_visible & ~scene.is_duplicate[self.object_index]
        is_sheet = np.append(np.zeros(sphere_count, np.bool_), ~has_extent.all(axis=0))
        sheet_face_index = np.flatnonzero(self.may_be_visible & is_sheet[self.object_index])
        self.sheet_face_index = np.full(self.object_count, -1)
        self.sheet_face_index[self.object_index[sheet_face_index]] = sheet_face_index

    def _compute_height_half_spaces(self) -> Floats:
        """Express the heights of the lights, and of the eye, above spheres as half-spaces.

        A camera ray with direction d meets a sphere at t d.  The height of a light above the
        sphere's tangent plane at this point, divided by t, is n.d + b / t.

        Returns
        -------
        half_spaces : (5, m + 1, spheres) float array
            The three components of n, then b, then the sum of the absolute values of the terms of
            b.  The second axis holds the m lights, then the eye.
        """
        # Let c be the centre, r the radius, p the power of the eye, and q the light.  At the point
        # t d, t^2 d^2 = 2 t c.d - p, and the normal is g (t d - c) / r, where g is 1 if the eye is
        # outside the sphere, and -1 if it is inside.
        c, r, p = self.center[:, None], self.radius, self.eye_power
        q = np.append(self.light_position, np.zeros((1, 3)), axis=0).T[:, :, None]
        g, products = np.where(p > 0, 1.0, -1.0), c * q
        b, b_abs_sum = p - products.sum(axis=0), np.abs(p) + np.abs(products).sum(axis=0)
        return np.array([*(g * (q - c)), g * b, b_abs_sum]) / r

    def _set_shadow_volumes(self, low: Floats, high: Floats) -> None:
        """Set `shadow_volume` and `has_shadow_edge`: the shadow of each box for each light.

        The shadow volume of a box is the intersection of at most nine half-spaces n.x + b >= 0.  Up
        to three of them lie behind the sides that face the light.  The planes of the other six
        contain the light and touch the silhouette of the box.  Edges of the shadow lie in these
        six planes, or in the plane of a side that contains the light.

        Parameters
        ----------
        low, high : (3, boxes) float arrays
            Lower and upper corners of the boxes relative to the eye, along the scene's axes.
        """
        light_position = (self.prepared_lights.position - self.frame.eye).T[:, :, None]
        low, high = low[:, None], high[:, None]
        to_low, to_high = low - light_position, high - light_position
        cone_normal = np.array(find_edge_planes(to_low.reshape(3, -1), to_high.reshape(3, -1)))
        is_edge_on, is_on_plane = (to_low == 0) & (to_high == 0), (to_low == 0) | (to_high == 0)
        side_sign = np.where(is_edge_on, 0, np.where(to_low >= 0, 1, np.where(to_high <= 0, -1, 0)))
        side_normal = np.eye(3)[:, :, None, None] * side_sign
        normal = np.append(side_normal, cone_normal.reshape(3, 6, *to_low.shape[1:]), axis=1)
        # Each plane touches the box, so b is minus the minimum of n.x over the corners.  The
        # corners are relative to the eye, not the light, so nothing cancels for distant lights.
        products = np.array([normal * low[:, None], normal * high[:, None]])
        b, b_abs_sum = -products.min(axis=0).sum(axis=0), np.abs(products).max(axis=0).sum(axis=0)
        b[:3] -= is_edge_on  # a flat box casts no shadow if the light is in its plane
        camera_normal = self.frame.rotate_to_camera((normal[0], normal[1], normal[2]))
        self.shadow_volume = np.array([*camera_normal, b, b_abs_sum])
        is_cone_edge = np.ones((6, *is_on_plane.shape[1:]), np.bool_)
        self.has_shadow_edge = np.append(is_on_plane, is_cone_edge, axis=0)

    def find_occluders(
        self, center: Floats, half_size: Floats, face_index: Ints, is_requested: Bools
    ) -> Ints:
        """List the objects that may shade parts of faces from lights.

        A face is a sphere or a side of a box.

        Parameters
        ----------
        center, half_size : (3, k) float arrays
            Centres and half sizes of the parts' bounding boxes, along the scene's axes.
        face_index : (k,) int array
            Index of the face to which each part belongs.
        is_requested : (m, k) bool array
            Whether to list the objects between each light and each part.

        Returns
        -------
        triples : (3, q) int array
            Row 0 contains indices of parts, row 1 of lights, and row 2 of objects.  The triples are
            distinct and sorted.
        """
        grid, triple_keys = self.prepared_lights.grid, [np.zeros(0, np.intp)]
        may_block = ~self.prepared_scene.is_eye_inside & ~self.prepared_scene.is_duplicate
        key_shape = (*is_requested.T.shape, self.object_count)
        if grid is not None and is_requested.any():
            object_index = self.object_index[face_index]
            triples = grid.query(center, half_size[:, None], object_index, is_requested)
            for light_index, part_index, occluder_index in triples:
                keys = np.ravel_multi_index((part_index, light_index, occluder_index), key_shape)
                triple_keys.append(keys[may_block[occluder_index]])
        # The grid may find an object in several octants, so remove duplicates.
        return np.array(np.unravel_index(np.unique(np.concatenate(triple_keys)), key_shape))

    def trace_samples(self, x: Floats, y: Floats) -> tuple[Hits, Ints, Ints]:
        """Trace camera rays to find the faces visible at given positions in the picture.

        Parameters
        ----------
        x, y : (k,) float arrays
            Positions in the picture, in pixels right and down from its upper left corner.

        Returns
        -------
        hits : Hits
            The nearest intersections of the h rays that meet an object.
        sample_index : (h,) int array
            For each hit, the index of its position in `x` and `y`.
        face_index : (h,) int array
            For each hit, the index of its face (a sphere, or a side of a box).
        """
        samples, position_index = Scattered.from_positions(x, y)
        hits = find_nearest_hits(self.prepared_scene, samples)
        box_count = self.object_count - self.sphere_count
        face_index = np.empty(hits.sample_index.size, dtype=np.intp)
        for group in hits.groups:
            is_high_side = (group.planes.normal_sign > 0) ^ hits.scene.is_eye_inside[
                group.run_object
            ]
            side_index = 2 * group.planes.face_axis + is_high_side
            run_face_index = (
                group.run_object + group.shape.has_planar_faces * box_count * side_index
            )
            face_index[group.interval] = group.repeat_runs(run_face_index)
        # A ray through the rim of a flat box may hit a side without area: use its visible face.
        sheet_face_index = self.sheet_face_index[self.object_index[face_index]]
        face_index = np.where(sheet_face_index >= 0, sheet_face_index, face_index)
        return hits, position_index[hits.sample_index], face_index

    def test_lights(self, hits: Hits, is_tested: Bools) -> Bools:
        """Test which lights reach each hit (a point where a camera ray meets a face).

        Parameters
        ----------
        hits : Hits
            The h hits.
        is_tested : (m, h) bool array
            Whether to test each light for each hit.

        Returns
        -------
        is_lit : (m, h) bool array
            Whether a tested light reaches the hit: the light is in front of the surface, and no
            object lies between the light and the hit.
        """
        may_reach = is_tested & (compute_light_geometry(hits, self.prepared_lights).n_dot_l > 0)
        return may_reach & ~find_shadows(hits, self.prepared_lights, may_reach)
