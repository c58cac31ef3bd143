"""Compute the shadow volumes of boxes.

The *shadow volume* of a box and a light is the set of points that the box hides from the light.  It
is an intersection of half-spaces.  Three of them, one per axis, lie behind the sides of the box
that face the light.  The planes of six others contain the light and an edge of the box's
silhouette, as seen from the light.

A half-space is the set of points x with n.x + b >= 0 (see `faces`), relative to the eye.
"""

from __future__ import annotations

from typing import Annotated as Shaped
from typing import NamedTuple

import numpy as np

from reference.judges.arrays import Bools, Floats
from reference.judges.box_sides import BoxSides
from tracer.geometry.camera import CameraFrame
from tracer.geometry.silhouette import find_edge_planes


class ShadowVolumes(NamedTuple):
    """The shadow volumes of boxes, as nine half-spaces for each light and box.

    Three half-spaces belong to the sides along x, y and z, and six to the silhouette.  A half-space
    that the shadow volume does not need has the numbers 0, so it contains all points.
    """

    # The five numbers of a half-space (see `faces`) are on the second axis.
    half_space: Shaped[Floats, "9 5 lights boxes"]
    # Whether the plane of the half-space may contain an edge of the shadow.  The plane of a side
    # does so only if it contains the light.
    has_edge: Shaped[Bools, "9 lights boxes"]


def compute_shadow_volumes(
    sides: BoxSides, light_position: Shaped[Floats, "lights 3"], frame: CameraFrame
) -> ShadowVolumes:
    """Compute the shadow volume of each box and light; light positions are in the scene's axes."""
    # Lower and upper corners of the boxes relative to the eye, along the scene's axes.
    low = sides.offset[:, :1]
    high = sides.offset[:, 1:]
    # The same corners relative to the lights.
    light_offset = (light_position - frame.eye).T[:, :, None]
    to_low = low - light_offset
    to_high = high - light_offset
    edge_normal = np.array(find_edge_planes(to_low.reshape(3, -1), to_high.reshape(3, -1)))
    edge_normal = edge_normal.reshape(3, 6, *to_low.shape[1:])
    normal = np.append(_orient_sides(to_low, to_high), edge_normal, axis=1)
    half_space = _express_half_spaces(normal, low, high, frame)
    # A flat box casts no shadow if the light is in its plane.  The normal of this side is 0, so its
    # half-space contains no point if b = -1.
    is_edge_on = (to_low == 0) & (to_high == 0)
    half_space[:3, 3] -= is_edge_on
    is_light_on_side = (to_low == 0) | (to_high == 0)
    return ShadowVolumes(
        half_space=half_space,
        has_edge=np.append(is_light_on_side, np.full((6, *to_low.shape[1:]), True), axis=0),
    )


def _orient_sides(
    to_low: Shaped[Floats, "3 lights boxes"], to_high: Shaped[Floats, "3 lights boxes"]
) -> Shaped[Floats, "3 3 lights boxes"]:
    """Return, for each axis, the inward normal of the side of a box that faces a light, or 0.

    `to_low` and `to_high` are the corners of the boxes relative to the lights.  The first axis of
    the result holds the components of a normal, and the second the axes of the scene.  A normal is
    0 if both sides or neither side along the axis face the light.
    """
    low_faces_light = to_low >= 0
    high_faces_light = to_high <= 0
    sign = low_faces_light * 1.0 - high_faces_light
    return np.eye(3)[:, :, None, None] * sign


def _express_half_spaces(
    normal: Shaped[Floats, "3 9 lights boxes"],
    low: Shaped[Floats, "3 1 boxes"],
    high: Shaped[Floats, "3 1 boxes"],
    frame: CameraFrame,
) -> Shaped[Floats, "9 5 lights boxes"]:
    """Make half-spaces that contain a box and whose planes touch it, from the planes' normals.

    `low` and `high` are the corners of the boxes.  All arguments are along the scene's axes, and
    the result is along the camera's axes.
    """
    # If the plane touches the box, b is minus the minimum of n.x over the corners.  The corners are
    # relative to the eye, not to the light, so nothing cancels if the light is distant.
    products = np.array([normal * low[:, None], normal * high[:, None]])
    b = -products.min(axis=0).sum(axis=0)
    b_abs_sum = np.abs(products).max(axis=0).sum(axis=0)
    camera_normal = frame.rotate_to_camera((normal[0], normal[1], normal[2]))
    return np.array([*camera_normal, b, b_abs_sum]).swapaxes(0, 1)
