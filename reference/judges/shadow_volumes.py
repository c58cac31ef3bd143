"""Compute the shadow volumes of boxes: the half-spaces whose intersection is in shadow."""

from __future__ import annotations

from typing import Annotated as Shaped
from typing import NamedTuple

import numpy as np

from reference.judges.arrays import Bools, Floats
from reference.judges.box_sides import BoxSides
from tracer.geometry.camera import CameraFrame
from tracer.geometry.silhouette import find_edge_planes


class ShadowVolumes(NamedTuple):
    """The shadow volume of each box and light, as nine half-spaces (see `faces`).

    The first three half-spaces lie behind the sides that face the light.  The planes of the other
    six contain the light and the box's silhouette.
    """

    half_space: Shaped[Floats, "9 5 lights boxes"]
    # Whether the plane of the half-space may contain an edge of the shadow.  The plane of a side
    # does so only if it contains the light.
    has_edge: Shaped[Bools, "9 lights boxes"]


def compute_shadow_volumes(
    sides: BoxSides, light_position: Shaped[Floats, "lights 3"], frame: CameraFrame
) -> ShadowVolumes:
    """Compute the shadow volumes of boxes; light positions are in the scene's axes."""
    light_offset = (light_position - frame.eye).T[:, :, None]
    # Corners of the boxes relative to the eye, and to the lights, along the scene's axes.
    low = sides.offset[:, :1]
    high = sides.offset[:, 1:]
    to_low = low - light_offset
    to_high = high - light_offset
    cone_normal = np.array(find_edge_planes(to_low.reshape(3, -1), to_high.reshape(3, -1)))
    # A flat box is edge-on if the light is in its plane.
    is_edge_on = (to_low == 0) & (to_high == 0)
    is_on_plane = (to_low == 0) | (to_high == 0)
    # 1 if only the low side faces the light, -1 if only the high side does, 0 if neither does.
    side_sign = (to_low >= 0) * 1.0 - (to_high <= 0)
    side_normal = np.eye(3)[:, :, None, None] * side_sign
    normal = np.append(side_normal, cone_normal.reshape(3, 6, *to_low.shape[1:]), axis=1)
    # Each plane touches the box, so b is minus the minimum of n.x over the corners.  The corners
    # are relative to the eye, not the light, so nothing cancels for distant lights.
    products = np.array([normal * low[:, None], normal * high[:, None]])
    b = -products.min(axis=0).sum(axis=0)
    b_abs_sum = np.abs(products).max(axis=0).sum(axis=0)
    b[:3] -= is_edge_on  # an edge-on box casts no shadow
    camera_normal = frame.rotate_to_camera((normal[0], normal[1], normal[2]))
    is_cone_edge = np.ones((6, *is_on_plane.shape[1:]), np.bool_)
    return ShadowVolumes(
        half_space=np.array([*camera_normal, b, b_abs_sum]).swapaxes(0, 1),
        has_edge=np.append(is_on_plane, is_cone_edge, axis=0),
    )
