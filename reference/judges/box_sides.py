"""Describe the sides of boxes as the eye sees them, and number them after the spheres.

Every *face* is a sphere or a side of a box.  Faces are numbered as follows: all spheres, then the
low sides of all boxes along x, their high sides along x, and the same for y and z.
"""

from __future__ import annotations

from typing import Annotated as Shaped
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from reference.judges.arrays import Bools, Floats


class BoxSides(NamedTuple):
    """The sides of boxes.

    The first axis of an array stands for the axes x, y and z of the scene, to which the sides are
    perpendicular.  The second axis stands for the low side, then the high side.
    """

    position: Shaped[Floats, "3 2 boxes"]  # coordinate of the side's plane on its axis
    offset: Shaped[Floats, "3 2 boxes"]  # `position` minus the coordinate of the eye
    faces_eye: Shaped[Bools, "3 2 boxes"]  # whether the eye sees the side, if nothing hides it
    has_area: Shaped[Bools, "3 1 boxes"]  # the same for the low and the high side
    # Whether the box is a *sheet*, which has no extent along one axis at least.
    is_of_sheet: Shaped[Bools, "boxes"]


def describe_sides(
    min_pt: Shaped[Floats, "3 boxes"],
    max_pt: Shaped[Floats, "3 boxes"],
    eye: Shaped[Floats, "3"],
    is_eye_inside: Shaped[Bools, "boxes"],
) -> BoxSides:
    """Describe the sides of boxes, given their lower and upper corners and the eye.

    All positions are in the scene's axes.
    """
    position = np.stack([min_pt, max_pt], axis=1)
    offset = np.stack([min_pt - eye[:, None], max_pt - eye[:, None]], axis=1)
    has_extent = offset[:, 0] < offset[:, 1]  # along each axis
    # A low side is seen from below, and a high side from above; from inside the box, vice versa.
    visible_sign = np.array([[-1], [1]]) * np.where(is_eye_inside, 1, -1)
    return BoxSides(
        position=position,
        offset=offset,
        faces_eye=offset * visible_sign > 0,
        # A side has area if the box has an extent along both other axes.
        has_area=(has_extent[[1, 2, 0]] & has_extent[[2, 0, 1]])[:, None],
        is_of_sheet=np.asarray(~has_extent.all(axis=0)),
    )


def append_sides(
    spheres: Shaped[NDArray[Any], "..."], sides: Shaped[NDArray[Any], "..."]
) -> Shaped[NDArray[Any], "..."]:
    """Append values of the sides of boxes to values of the spheres, in the order of the faces.

    The arguments have the shapes (..., spheres) and (..., 3, 2, boxes), where the last three axes
    are those of `BoxSides`.  The result has the shape (..., faces).
    """
    return np.append(spheres, sides.reshape(*spheres.shape[:-1], -1), axis=-1)
