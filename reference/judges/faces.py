"""Compute what the certificate needs to know about each face of a scene.

The *certificate* is a picture with proven bounds on every pixel (see `certificate`).  To prove
them, it divides the picture into square *cells*, and asks which functions of the camera ray decide
what a cell shows.  A *face* is a sphere, or a rectangular side of a box.

A ray from the eye with direction d meets a face at t d.  Divided by t, every function that matters
is a polynomial of degree one or two in d, plus one square root:

- Inverse distance.  Let a sphere have the centre c and the radius r.  A point t d lies on it if
  t^2 d^2 - 2 t c.d + p = 0, where p = |c|^2 - r^2 is the *power* of the eye.  The root that the eye
  sees is the near one if the eye is outside the sphere, and the far one if it is inside.  In both
  cases, t = p / (c.d + sqrt((c.d)^2 - p d^2)).  Hence

      1 / t = k.d + s    with k = c / p, s^2 = w^2 (r^2 d^2 - |c x d|^2) and w = 1 / p.

  For a plane e.x = l, 1 / t = k.d with k = e / l, and s = 0.
- A *half-space* is the set of points x with n.x + b >= 0.  The point t d is inside if
  n.d + b / t >= 0.  A half-space is stored as five numbers: n in three, b, and the sum of the
  absolute values of the terms of b, from which rounding errors are bounded.
- The height of a light above the tangent plane of a face at t d, divided by t, also has the form
  n.d + b / t.  So it is stored like a half-space.

Faces are numbered as in `box_sides`, and objects with all spheres first.  Positions are relative to
the eye and along the camera's axes, unless said otherwise.
"""

from __future__ import annotations

from typing import Annotated as Shaped
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from reference.judges.arrays import Bools, Floats, Ints
from reference.judges.box_sides import BoxSides, append_sides


class SphereShapes(NamedTuple):
    """The spheres of a scene."""

    center: Shaped[Floats, "3 spheres"]
    scene_center: Shaped[Floats, "3 spheres"]  # in the scene's axes, and not relative to the eye
    radius: Shaped[Floats, "spheres"]
    eye_power: Shaped[Floats, "spheres"]  # negative if the eye is inside the sphere


class Viewpoint(NamedTuple):
    """The camera and the lights of a scene."""

    eye: Shaped[Floats, "3"]  # in the scene's axes
    camera_axes: Shaped[Floats, "3 3"]  # each row is an axis of the camera in the scene's axes
    light_position: Shaped[Floats, "lights 3"]
    scene_light_position: Shaped[Floats, "lights 3"]  # in the scene's axes, not relative to the eye


class Faces(NamedTuple):
    """The faces of a scene, as numbers that do not depend on the cell."""

    object_index: Shaped[Ints, "faces"]
    is_planar: Shaped[Bools, "faces"]  # whether the face is a side of a box
    # Whether the face would be visible from the eye if no other object hid it.
    may_be_visible: Shaped[Bools, "faces"]
    # Two numbers per face.  Two faces have the same numbers only if they are in the same plane.  If
    # such faces overlap, the first in the scene file is visible.
    plane_id: Shaped[Floats, "2 faces"]
    linear_coef: Shaped[Floats, "3 faces"]  # k of the inverse distance
    root_coef: Shaped[Floats, "faces"]  # w of the inverse distance; 0 for a side of a box
    # For a side of a box, the half-space on the box's side of its plane.  For a sphere, the terms
    # -2 c.x + p of its equation x^2 - 2 c.x + p = 0, as n.x + b.
    face_equation: Shaped[Floats, "5 faces"]
    # n and b for each light, and at last for the eye: n.d + b / t is the height of the light or the
    # eye above the face's tangent plane at t d, divided by t.
    height_half_space: Shaped[Floats, "5 lights+1 faces"]
    # Four half-spaces whose intersection with the plane of a side of a box is this side.
    rim_half_spaces: Shaped[Floats, "5 4 faces"]
    # Lower and upper corners of the bounding boxes of the faces' objects, in the scene's axes.
    bounding_box: Shaped[Floats, "2 3 faces"]


def describe_faces(
    spheres: SphereShapes,
    sides: BoxSides,
    viewpoint: Viewpoint,
    is_duplicate: Shaped[Bools, "objects"],
) -> Faces:
    """Describe all faces of a scene.

    `is_duplicate` marks objects that are equal to an earlier one in the scene file, and therefore
    invisible.
    """
    sphere_count = spheres.radius.size
    side_object_index = np.arange(sphere_count, is_duplicate.size)
    object_index = append_sides(
        np.arange(sphere_count), np.broadcast_to(side_object_index, sides.offset.shape)
    )
    all_spheres = np.full(sphere_count, True)
    is_turned_to_eye = append_sides(all_spheres, sides.faces_eye & sides.has_area)
    side_linear_coef = viewpoint.camera_axes[:, :, None, None] / sides.offset
    side_half_space = _compute_side_half_spaces(sides, viewpoint.camera_axes)
    return Faces(
        object_index=object_index,
        is_planar=object_index >= sphere_count,
        may_be_visible=is_turned_to_eye & ~is_duplicate[object_index],
        plane_id=_identify_planes(sphere_count, sides),
        linear_coef=append_sides(spheres.center / spheres.eye_power, side_linear_coef),
        root_coef=append_sides(1 / spheres.eye_power, 0 * sides.offset),
        face_equation=append_sides(_compute_sphere_equations(spheres), side_half_space),
        height_half_space=append_sides(
            _compute_sphere_heights(spheres, viewpoint.light_position),
            _compute_side_heights(sides, viewpoint),
        ),
        rim_half_spaces=_collect_rims(sphere_count, side_half_space),
        bounding_box=_bound_objects(spheres, sides)[:, :, object_index],
    )


def _identify_planes(sphere_count: int, sides: BoxSides) -> Shaped[Floats, "2 faces"]:
    """Return two numbers per face that are equal only for faces in the same plane.

    For a side of a box, they are the index of the perpendicular axis (0 to 2) and the coordinate of
    the side on this axis.  For a sphere, they are 3 and the index of the sphere.
    """
    sphere_plane = np.array([np.full(sphere_count, 3), np.arange(sphere_count)])
    side_plane = np.array([np.indices(sides.position.shape)[0], sides.position])
    return append_sides(sphere_plane, side_plane)


def _bound_objects(spheres: SphereShapes, sides: BoxSides) -> Shaped[Floats, "2 3 objects"]:
    """Return the lower and upper corners of each object's bounding box, in the scene's axes."""
    half_size = np.multiply.outer([-1, 1], spheres.radius)
    sphere_bounds = spheres.scene_center + half_size[:, None]
    return np.append(sphere_bounds, sides.position.swapaxes(0, 1), axis=2)


def _compute_sphere_equations(spheres: SphereShapes) -> Shaped[Floats, "5 spheres"]:
    """Compute the terms -2 c.x + p of each sphere's equation, in the form of a half-space."""
    power = spheres.eye_power
    return np.array([*(-2 * spheres.center), power, abs(power)])


def _compute_side_half_spaces(
    sides: BoxSides, camera_axes: Shaped[Floats, "3 3"]
) -> Shaped[Floats, "5 3 2 boxes"]:
    """Compute for each side the half-space that its plane bounds, and that contains the box."""
    half_space = np.empty((5, *sides.offset.shape))
    half_space[:3] = camera_axes[:, :, None, None] * [[1], [-1]]
    half_space[3] = sides.offset * [[-1], [1]]
    half_space[4] = np.abs(sides.offset)
    return half_space


def _collect_rims(
    sphere_count: int, side_half_space: Shaped[Floats, "5 3 2 boxes"]
) -> Shaped[Floats, "5 4 faces"]:
    """Collect for each side of a box the half-spaces of the four sides that it touches.

    These are the sides along the two other axes.  The half-spaces of a sphere are zero.
    """
    # For each of the three axes, select the sides along the two other axes: (5, 3, 2, 2, boxes).
    other_sides = side_half_space[:, [[1, 2], [2, 0], [0, 1]]]
    # The four half-spaces come before the axis of the side.  Its low and its high side share them.
    rim_by_axis = other_sides.reshape(5, 3, 4, 1, -1).swapaxes(1, 2)
    side_rim = rim_by_axis.repeat(2, axis=3)
    return append_sides(np.zeros((5, 4, sphere_count)), side_rim)


def _compute_side_heights(
    sides: BoxSides, viewpoint: Viewpoint
) -> Shaped[Floats, "5 lights+1 3 2 boxes"]:
    """Compute `Faces.height_half_space` for sides: heights of the lights, then of the eye.

    A height is positive on the eye's side of the plane.  It is the same for all rays, so n = 0 and
    b is the height.
    """
    light_or_eye = np.append(viewpoint.scene_light_position, viewpoint.eye[None], axis=0)
    height = np.sign(sides.offset) * (sides.position - light_or_eye[:, :, None, None])
    return np.array([*np.zeros((3, *height.shape)), height, np.abs(height)])


def _compute_sphere_heights(
    spheres: SphereShapes, light_position: Shaped[Floats, "lights 3"]
) -> Shaped[Floats, "5 lights+1 spheres"]:
    """Compute `Faces.height_half_space` for spheres: heights of the lights, then of the eye."""
    # Let c be the centre, r the radius, p the power of the eye, and q the light.  The normal at t d
    # is g (t d - c) / r, where g is 1 if the eye is outside the sphere, and -1 if it is inside.
    # The height of the light is the dot product of the normal and q - t d.  Because t d is on the
    # sphere, t^2 d^2 = 2 t c.d - p, so the height is g (t (q - c).d + p - c.q) / r.  Divided by t,
    # this is n.d + b / t with n = g (q - c) / r and b = g (p - c.q) / r.
    c = spheres.center[:, None]
    p = spheres.eye_power
    q = np.append(light_position, np.zeros((1, 3)), axis=0).T[:, :, None]
    g = np.where(p > 0, 1.0, -1.0)
    products = c * q
    b = p - products.sum(axis=0)
    b_abs_sum = np.abs(p) + np.abs(products).sum(axis=0)
    return np.array([*(g * (q - c)), g * b, b_abs_sum]) / spheres.radius


def find_sheet_faces(faces: Faces, is_sheet: Shaped[Bools, "objects"]) -> Shaped[Ints, "objects"]:
    """Find the only face of each flat box that has area and may be visible.

    `is_sheet` marks the flat boxes.  The result is -1 for other objects, and for flat boxes without
    such a face.
    """
    visible_face_index = np.flatnonzero(faces.may_be_visible & is_sheet[faces.object_index])
    sheet_face_index = np.full(is_sheet.size, -1)
    sheet_face_index[faces.object_index[visible_face_index]] = visible_face_index
    return sheet_face_index


def find_unlit_faces(
    faces: Faces,
    light_side: Shaped[NDArray[Any], "lights objects"],
    is_eye_inside: Shaped[Bools, "objects"],
) -> Shaped[Bools, "lights faces"]:
    """Find the faces on which each light certainly reaches no visible point.

    There are three reasons.  The surface of an object may lie between the light and everything that
    the eye sees, because one of them is inside it and the other is outside.  The eye may be inside
    the face's box, and the light on its surface.  Or the light is not in front of a side of a box.

    Parameters
    ----------
    light_side
        Positive for a light outside an object, negative inside, and 0 on a side of a box.
    """
    is_separated = np.where(is_eye_inside, light_side > 0, light_side < 0)
    reaches_nothing = is_separated.any(axis=1, keepdims=True)
    # In a box, the eye sees inner sides, which a light on the box cannot reach.
    is_cut_off = (is_eye_inside & (light_side >= 0))[:, faces.object_index]
    is_behind_plane = faces.is_planar & (faces.height_half_space[3, :-1] <= 0)
    return np.asarray(reaches_nothing | is_cut_off | is_behind_plane)
