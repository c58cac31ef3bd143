"""Describe a scene for the certificate: faces, lights and shadows, in the camera's axes.

The problem: which functions decide what a pixel shows?  A *face* is a sphere, or a rectangular side
of a box.  All that the certificate needs to know about a face becomes linear or quadratic in the
direction of a camera ray, except for one square root, if it is divided by the distance to the face:

- A ray from the eye with direction d meets a face at t d.  Let a sphere have centre c and radius r,
  and let p = |c|^2 - r^2 be the power of the eye.  Then t = p / (c.d + sqrt((c.d)^2 - p d^2)): the
  near intersection if the eye is outside the sphere, the far one if it is inside.  Hence

      1 / t = k.d + s    with k = c / p, s^2 = w^2 (r^2 d^2 - |c x d|^2) and w = 1 / p.

  For a plane e.x = l, 1 / t = k.d with k = e / l, and s = 0.
- A *half-space* is the set of points x with n.x + b >= 0.  The point t d is inside if
  n.d + b / t >= 0.  A half-space is stored as five numbers: n in three, b, and the sum of the
  absolute values of the terms of b, from which rounding errors are bounded.
- The height of a light above the tangent plane of a face, divided by t, also has the form
  n.d + b / t.

Faces are numbered as follows: all spheres, then the low sides of all boxes along x, their high
sides along x, and the same for y and z.  Positions are relative to the eye and along the camera's
axes, unless said otherwise.

In the certificate, only this module uses internals of the tracer: the prepared scene, its light
grid, and single samples.  From a sample, the certificate uses only *which* face is visible and
*which* lights reach it, never the radiance.
"""

from __future__ import annotations

from typing import Annotated as Shaped
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from reference.judges.arrays import Bools, Floats, Ints
from tracer import Scene
from tracer.geometry.box import Boxes
from tracer.geometry.camera import CameraFrame
from tracer.geometry.silhouette import find_edge_planes
from tracer.geometry.sphere import Spheres
from tracer.trace.hits import Hits
from tracer.trace.lighting import compute_light_geometry
from tracer.trace.occlusion import find_shadows
from tracer.trace.samples import Scattered
from tracer.trace.visibility import find_nearest_hits
from tracer.world.prepared_scene import Lights, PreparedScene

# Maximum distance of a light, relative to the size of the smallest object.  Seen from farther away,
# both ends of an object may round to the same direction.
_MAX_LIGHT_DISTANCE = 1e14


class _BoxSides(NamedTuple):
    """The sides of boxes.

    The first axis of an array stands for the axes x, y and z of the scene, to which the sides are
    perpendicular.  The second axis stands for the low and the high side.
    """

    position: Shaped[Floats, "3 2 boxes"]  # coordinate of the side's plane on its axis
    offset: Shaped[Floats, "3 2 boxes"]  # `position` minus the coordinate of the eye
    faces_eye: Shaped[Bools, "3 2 boxes"]  # whether the eye sees the side, if nothing hides it
    has_area: Shaped[Bools, "3 1 boxes"]
    is_of_sheet: Shaped[Bools, "boxes"]  # see `Faces.sheet_face_index`


def _append_sides(
    spheres: Shaped[NDArray[Any], "..."], sides: Shaped[NDArray[Any], "..."]
) -> Shaped[NDArray[Any], "..."]:
    """Append values of all sides (..., 3, 2, boxes) to those of the spheres (..., spheres).

    The result has the shape (..., faces).
    """
    return np.append(spheres, sides.reshape(*spheres.shape[:-1], -1), axis=-1)


def _compute_height_half_spaces(
    center: Shaped[Floats, "3 spheres"],
    radius: Shaped[Floats, "spheres"],
    eye_power: Shaped[Floats, "spheres"],
    light_position: Shaped[Floats, "lights 3"],
) -> Shaped[Floats, "5 lights+1 spheres"]:
    """Compute `Faces.height_half_space` for spheres: heights of the lights, then of the eye."""

    # Let c be the centre, r the radius, p the power of the eye, and q the light.  At the point
    # t d, t^2 d^2 = 2 t c.d - p, and the normal is g (t d - c) / r, where g is 1 if the eye is
    # outside the sphere, and -1 if it is inside.
    c, r, p = center[:, None], radius, eye_power
    q = np.append(light_position, np.zeros((1, 3)), axis=0).T[:, :, None]
    g = np.where(p > 0, 1.0, -1.0)
    products = c * q
    b = p - products.sum(axis=0)
    b_abs_sum = np.abs(p) + np.abs(products).sum(axis=0)
    return np.array([*(g * (q - c)), g * b, b_abs_sum]) / r


class VisibleFaces(NamedTuple):
    """What samples show, without those that show the background."""

    hits: Hits
    sample_index: Shaped[Ints, "hits"]  # in any order
    face_index: Shaped[Ints, "hits"]


class Faces:
    """The faces, lights and objects of a scene, as numbers that do not depend on the cell."""

    frame: CameraFrame
    prepared_scene: PreparedScene
    prepared_lights: Lights
    spheres: Spheres
    boxes: Boxes
    # Objects are numbered with all spheres first.
    sphere_count: int
    object_count: int
    light_position: Shaped[Floats, "lights 3"]
    center: Shaped[Floats, "3 spheres"]
    radius: Shaped[Floats, "spheres"]
    eye_power: Shaped[Floats, "spheres"]  # negative if the eye is inside the sphere
    object_index: Shaped[Ints, "faces"]
    is_planar: Shaped[Bools, "faces"]  # whether the face is a side of a box
    # Whether the face would be visible from the eye if no other object hid it.
    may_be_visible: Shaped[Bools, "faces"]
    # For a sheet (a box without extent along one axis), the index of its only face that has area
    # and may be visible; for other objects, -1.
    sheet_face_index: Shaped[Ints, "objects"]
    # Two numbers that are equal only for faces in the same plane.  If two such faces overlap, the
    # first in the scene file is visible.
    plane_id: Shaped[Floats, "2 faces"]
    # Coefficients k and w of the inverse distance.  For a side of a box, w = 0.
    linear_coef: Shaped[Floats, "3 faces"]
    root_coef: Shaped[Floats, "faces"]
    # For a side of a box, the half-space beyond its plane.  For a sphere, the terms -2 c.x + p of
    # its equation, without the term x^2 that all spheres share.
    face_equation: Shaped[Floats, "5 faces"]
    # For each light, then the eye: the half-space with n.d + b / t equal to the height of the light
    # (or eye) above the face's tangent plane, divided by t.
    height_half_space: Shaped[Floats, "5 lights+1 faces"]
    # Four half-spaces whose intersection with the plane of a side of a box is this side.
    rim_half_spaces: Shaped[Floats, "5 4 faces"]
    # Lower and upper corners of the bounding boxes of the faces' objects, in the scene's axes.
    bounding_box: Shaped[Floats, "2 3 faces"]
    # Whether the light certainly reaches no visible point of the face: it is (1) outside an object
    # that contains the eye, (2) inside any other object, or (3) behind the face's plane.
    is_unlit: Shaped[Bools, "lights faces"]
    to_center: Shaped[Floats, "3 lights spheres"]  # from the light to the sphere's centre
    # Nine half-spaces whose intersection is the shadow volume of a box.  The first three lie behind
    # the sides that face the light.  The planes of the other six contain the light and the box's
    # silhouette.
    shadow_volume: Shaped[Floats, "5 9 lights boxes"]
    # Whether the plane of the half-space may contain an edge of the shadow.  The plane of a side
    # does so only if it contains the light.
    has_shadow_edge: Shaped[Bools, "9 lights boxes"]

    def __init__(self, scene: Scene) -> None:
        """Set all attributes, which describe a scene.

        Raise ValueError if the eye is on a surface, or if the distance of a light is more than 1e14
        times the size of the smallest object.
        """
        self.prepared_scene = prepared_scene = PreparedScene(scene)
        self.frame = prepared_scene.frame
        self.prepared_lights = prepared_scene.prepare_lights()
        self.light_position = self.prepared_lights.from_eye
        self.spheres = Spheres.from_surfaces(self.frame, scene.surfaces)
        self.boxes = Boxes.from_surfaces(self.frame, scene.surfaces)
        self.sphere_count = self.spheres.objects.size
        self.object_count = prepared_scene.is_eye_inside.size
        self.center = np.array(self.spheres.from_eye)
        self.radius = self.spheres.radius
        self.eye_power = self.spheres.power
        sides = self._describe_sides()
        self._refuse_impossible_scenes(sides)
        self._set_numbers_of_faces(sides)
        self._set_half_spaces_of_faces(sides)
        self._set_heights(sides)
        self._set_visibility(sides)
        self.to_center = self.center[:, None] - self.light_position.T[:, :, None]
        self._set_shadow_volumes(sides)
        self._set_unlit_faces()

    def _describe_sides(self) -> _BoxSides:
        """Describe the sides of all boxes, as the eye sees them."""
        boxes, eye = self.boxes, self.frame.eye[:, None]
        offset = np.stack([boxes.min_pt - eye, boxes.max_pt - eye], axis=1)
        is_eye_inside = self.prepared_scene.is_eye_inside[self.sphere_count :]
        has_extent = offset[:, 0] < offset[:, 1]
        return _BoxSides(
            position=np.stack([boxes.min_pt, boxes.max_pt], axis=1),
            offset=offset,
            faces_eye=offset * [[-1], [1]] * np.where(is_eye_inside, 1, -1) > 0,
            has_area=(has_extent[[1, 2, 0]] & has_extent[[2, 0, 1]])[:, None],
            is_of_sheet=np.asarray(~has_extent.all(axis=0)),
        )

    def _refuse_impossible_scenes(self, sides: _BoxSides) -> None:
        """Raise ValueError if the eye is on a surface, or if a light is too far away."""
        is_eye_in_box = self.prepared_scene.is_eye_inside[self.sphere_count :]
        is_on_box = is_eye_in_box & np.any(sides.offset == 0, axis=(0, 1))
        if np.any(self.eye_power == 0) or is_on_box.any():
            raise ValueError("the eye is on a surface; move it off")
        lengths = np.append(self.radius, (sides.position[:, 1] - sides.position[:, 0]).ravel())
        max_distance = _MAX_LIGHT_DISTANCE * lengths[lengths > 0].min(initial=np.inf)
        if np.abs(self.light_position).max(initial=0) > max_distance:
            limit = f"{_MAX_LIGHT_DISTANCE:g} times the size of an object"
            raise ValueError(f"a light is farther away than {limit}; move it closer")

    def _set_numbers_of_faces(self, sides: _BoxSides) -> None:
        """Set `object_index`, `is_planar`, `plane_id` and `bounding_box`."""
        sphere_index = np.arange(self.sphere_count)
        box_index = np.arange(self.sphere_count, self.object_count)
        box_index_by_side = np.broadcast_to(box_index, sides.offset.shape)
        self.object_index = _append_sides(sphere_index, box_index_by_side)
        self.is_planar = self.object_index >= self.sphere_count
        # A sphere has a number of its own on axis 3, which no side has.
        sphere_plane = np.array([np.full(self.sphere_count, 3), sphere_index])
        side_plane = np.array([np.indices(sides.position.shape)[0], sides.position])
        self.plane_id = _append_sides(sphere_plane, side_plane)
        sphere_bounds = self.spheres.center + np.multiply.outer([-1, 1], self.radius)[:, None]
        object_bounds = np.append(sphere_bounds, sides.position.swapaxes(0, 1), axis=2)
        self.bounding_box = object_bounds[:, :, self.object_index]

    def _set_half_spaces_of_faces(self, sides: _BoxSides) -> None:
        """Set `linear_coef`, `root_coef`, `face_equation` and `rim_half_spaces`."""
        axes, center, power, offset = self.frame.axes, self.center, self.eye_power, sides.offset
        self.linear_coef = _append_sides(center / power, axes[:, :, None, None] / offset)
        self.root_coef = _append_sides(1 / power, 0 * offset)
        # Half-spaces whose intersection is the box.
        half_space = np.empty((5, *offset.shape))
        half_space[:3] = axes[:, :, None, None] * [[1], [-1]]
        half_space[3:] = offset * [[-1], [1]], np.abs(offset)
        sphere_equation = np.array([*(-2 * center), power, abs(power)])
        self.face_equation = _append_sides(sphere_equation, half_space)
        # The rim of a side consists of the four sides along the two other axes.  The axes of the
        # array become: numbers of a half-space, rim, axis of the side, low or high, box.
        rim = half_space[:, [[1, 2], [2, 0], [0, 1]]].reshape(5, 3, 4, 1, -1).swapaxes(1, 2)
        no_rim = np.zeros((5, 4, self.sphere_count))
        self.rim_half_spaces = _append_sides(no_rim, rim.repeat(2, axis=3))

    def _set_heights(self, sides: _BoxSides) -> None:
        """Set `height_half_space`."""
        light_or_eye = np.append(self.prepared_lights.position, self.frame.eye[None], axis=0)
        # A height above the plane of a side is positive on the eye's side.  It is the same for all
        # rays, so n = 0.
        height = np.sign(sides.offset) * (sides.position - light_or_eye[:, :, None, None])
        side_height = np.array([*np.zeros((3, *height.shape)), height, np.abs(height)])
        sphere_height = _compute_height_half_spaces(
            self.center, self.radius, self.eye_power, self.light_position
        )
        self.height_half_space = _append_sides(sphere_height, side_height)

    def _set_visibility(self, sides: _BoxSides) -> None:
        """Set `may_be_visible` and `sheet_face_index`."""
        all_spheres = np.full(self.sphere_count, True)
        is_turned_to_eye = _append_sides(all_spheres, sides.faces_eye & sides.has_area)
        is_duplicate = self.prepared_scene.is_duplicate[self.object_index]
        self.may_be_visible = is_turned_to_eye & ~is_duplicate
        is_object_sheet = np.append(~all_spheres, sides.is_of_sheet)
        is_visible_sheet = self.may_be_visible & is_object_sheet[self.object_index]
        sheet_face_index = np.flatnonzero(is_visible_sheet)
        self.sheet_face_index = np.full(self.object_count, -1)
        self.sheet_face_index[self.object_index[sheet_face_index]] = sheet_face_index

    def _set_shadow_volumes(self, sides: _BoxSides) -> None:
        """Set `shadow_volume` and `has_shadow_edge`."""
        light_position = (self.prepared_lights.position - self.frame.eye).T[:, :, None]
        # Corners of the boxes relative to the eye, and to the lights, along the scene's axes.
        low = sides.offset[:, :1]
        high = sides.offset[:, 1:]
        to_low = low - light_position
        to_high = high - light_position
        cone_normal = np.array(find_edge_planes(to_low.reshape(3, -1), to_high.reshape(3, -1)))
        # A flat box is edge-on if the light is in its plane.
        is_edge_on = (to_low == 0) & (to_high == 0)
        is_on_plane = (to_low == 0) | (to_high == 0)
        # 1 if only the low side faces the light, -1 if only the high side does, 0 if neither does.
        side_sign = (to_low >= 0) * 1.0 - (to_high <= 0)
        side_normal = np.eye(3)[:, :, None, None] * side_sign
        normal = np.append(side_normal, cone_normal.reshape(3, 6, *to_low.shape[1:]), axis=1)
        # Each plane touches the box, so b is minus the minimum of n.x over the corners.  The
        # corners are relative to the eye, not the light, so nothing cancels for distant lights.
        products = np.array([normal * low[:, None], normal * high[:, None]])
        b = -products.min(axis=0).sum(axis=0)
        b_abs_sum = np.abs(products).max(axis=0).sum(axis=0)
        b[:3] -= is_edge_on  # an edge-on box casts no shadow
        camera_normal = self.frame.rotate_to_camera((normal[0], normal[1], normal[2]))
        self.shadow_volume = np.array([*camera_normal, b, b_abs_sum])
        is_cone_edge = np.ones((6, *is_on_plane.shape[1:]), np.bool_)
        self.has_shadow_edge = np.append(is_on_plane, is_cone_edge, axis=0)

    def _set_unlit_faces(self) -> None:
        """Set `is_unlit`."""
        is_eye_inside, lights = self.prepared_scene.is_eye_inside, self.prepared_lights
        # `side` is positive for a light outside an object, negative inside, 0 on a side of a box.
        # In `lights.side`, a light on a side counts as outside.
        side = lights.side.copy()
        box_index = self.boxes.objects.list_indices()
        light_x, light_y, light_z = lights.position.T[:, :, None]
        distance = self.boxes.measure_distance(box_index, (light_x, light_y, light_z))
        side[:, box_index] *= distance != 0
        is_separated = np.any(np.where(is_eye_inside, side > 0, side < 0), axis=1, keepdims=True)
        # In a box, the eye sees inner sides, which a light on or outside the box cannot reach.
        is_unlit = is_separated | (is_eye_inside & (lights.side >= 0))[:, self.object_index]
        self.is_unlit = is_unlit | (self.is_planar & (self.height_half_space[3, :-1] <= 0))

    def compute_rays(
        self, x: Shaped[Floats, "cells"], y: Shaped[Floats, "cells"], cell_width: float
    ) -> Shaped[Floats, "3 3 cells"]:
        """Compute the directions of camera rays in square cells, as functions of X and Y.

        The cells have their centres at x and y in the picture, in pixels.  In each cell, X and Y
        run from -1 to 1.  The first axis of the result holds the components right, down and ahead,
        and the second the coefficients of 1, X and Y.
        """
        rays = np.zeros((3, 3, x.size))
        rays[0, 0] = self.frame.to_ray_x(x)
        rays[1, 0] = self.frame.to_ray_y(y)
        rays[2, 0] = self.frame.depth
        rays[0, 1] = cell_width / 2 * self.frame.pixel_width
        rays[1, 2] = cell_width / 2 * self.frame.pixel_height
        return rays

    def find_occluders(
        self,
        center: Shaped[Floats, "3 parts"],
        half_size: Shaped[Floats, "3 parts"],
        face_index: Shaped[Ints, "parts"],
        is_requested: Shaped[Bools, "lights parts"],
    ) -> Shaped[Ints, "3 triples"]:
        """List the objects that may shade parts of faces from lights.

        The rows of the result are indices of parts, lights and objects.  Its columns are sorted and
        contain no duplicates.

        Parameters
        ----------
        center, half_size
            Bounding box of each part, aligned with the scene's axes.
        face_index
            Face of each part.
        is_requested
            Whether to search for objects between a light and a part.
        """
        grid = self.prepared_lights.grid
        triple_keys = [np.zeros(0, np.intp)]
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

    def trace_samples(
        self, x: Shaped[Floats, "samples"], y: Shaped[Floats, "samples"]
    ) -> VisibleFaces:
        """Trace camera rays to find the faces that are visible at positions in the picture.

        The positions are in pixels from the upper left corner.
        """
        samples, position_index = Scattered.from_positions(x, y)
        hits = find_nearest_hits(self.prepared_scene, samples)
        box_count = self.object_count - self.sphere_count
        face_index = np.empty(hits.sample_index.size, dtype=np.intp)
        for group in hits.groups:
            is_eye_inside = hits.scene.is_eye_inside[group.run_object]
            is_high_side = (group.planes.normal_sign > 0) ^ is_eye_inside
            side_index = 2 * group.planes.face_axis + is_high_side
            is_box = group.shape.has_planar_faces
            run_face_index = group.run_object + is_box * box_count * side_index
            face_index[group.interval] = group.repeat_runs(run_face_index)
        # A ray through the rim of a flat box may hit a side without area: use its visible face.
        sheet_face_index = self.sheet_face_index[self.object_index[face_index]]
        face_index = np.where(sheet_face_index >= 0, sheet_face_index, face_index)
        return VisibleFaces(
            hits=hits, sample_index=position_index[hits.sample_index], face_index=face_index
        )

    def test_lights(
        self, hits: Hits, is_tested: Shaped[Bools, "lights hits"]
    ) -> Shaped[Bools, "lights hits"]:
        """Find out which of the tested lights reach each hit.

        A light reaches a hit if it is in front of the surface and no object lies between them.  The
        result is False for lights that are not tested.
        """
        may_reach = is_tested & (compute_light_geometry(hits, self.prepared_lights).n_dot_l > 0)
        return may_reach & ~find_shadows(hits, self.prepared_lights, may_reach)
