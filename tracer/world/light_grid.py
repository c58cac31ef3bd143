"""A light buffer: for each light, a grid of directions that lists the objects in each cell.

Which objects may lie between a point and a light?  Only those that, as seen from the light, lie in
the same direction as the point (Haines and Greenberg, The light buffer, 1986).  Here a query is for
all points of a ball together.

The directions of a light are divided into eight octants, and each object into *parts*, one for each
octant that it lies in.  Each part has a rectangle of octahedral coordinates, and direction bounds
(see `directions`).  In an octant, a *patch* covers most of the objects that the camera may see (see
`patches`).  It is divided into cells, which list the parts whose rectangles overlap them (see
`cell_lists`).

For a query, the ball is divided into parts, too.  Each of them is compared with the parts that are
listed in the cells that it overlaps.  Rectangles are loose bounds for long objects, so the
direction bounds of the two parts are compared.  The query excludes only objects that cannot lie
between the ball and the light.

Positions are in scene axes, and vectors lead from points to the light.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated as Shaped
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tracer.arrays import Bools, Floats, Ints, find
from tracer.geometry.rounding import DIRECTION_ROUNDING
from tracer.world.cell_lists import CellLists, build_cell_lists
from tracer.world.directions import MIN_DISTANCE_ROW, BoxParts, reverse_bounds, split_by_octant
from tracer.world.patches import Patches, choose_patches

# A light farther away than this many times the scene's size is moved to this distance.  Directions
# to the light turn by at most the reciprocal, in radians.
_MAX_LIGHT_DISTANCE = 2.0**22

# Eight bools that are all True, read as one integer.
_EIGHT_TRUE = 0x0101010101010101


class LightGrid(NamedTuple):
    """Lists of objects by their direction from each light."""

    # Distant lights are moved closer: see `_MAX_LIGHT_DISTANCE`.
    light_position: Shaped[Floats, "3 lights 1"]
    patches: Patches
    cell_lists: CellLists  # of the objects' parts
    # Reversed direction bounds.  A part of an object may block segments from a part of a ball only
    # if each of the eight bounds of the ball's part is at most the bound here.
    part_bounds: Shaped[Floats, "parts 8"]
    part_object: Shaped[Ints, "parts"]

    def query(
        self,
        centers: Shaped[Floats, "3 n"],
        radii: Shaped[Floats, "... n"],
        own_object_index: Shaped[Ints, "n"],
        is_active: Shaped[Bools, "lights n"],
    ) -> Iterator[Shaped[Ints, "3 k"]]:
        """Find the objects that may lie between each ball and each light.

        Yields batches with indices of lights in row 0, of balls in row 1, and of objects in row 2.
        Every object that blocks a segment from a point of a ball to a light is found.  Objects that
        block none may be found, too, and an object may be found several times.

        Parameters
        ----------
        radii
            Radii (n,) of the balls.  To search around boxes instead, pass half their widths along
            each axis, (3, 1, n).
        own_object_index
            The object on whose surface the points of each ball lie; it is excluded.
        is_active
            Whether to search between the light and the ball.
        """
        ball_count = own_object_index.size
        to_light = self.light_position - centers[:, None]
        ball_parts = split_by_octant(
            to_light - radii, to_light + radii, self.patches.of_octant >= 0, is_active
        )
        for ball_part, object_part in self._match_parts(ball_parts):
            light_index, ball_index = np.divmod(ball_parts.box_index.take(ball_part), ball_count)
            object_index = self.part_object.take(object_part)
            kept_index = find(object_index != own_object_index.take(ball_index))
            rows = light_index, ball_index, object_index
            yield np.array([row.take(kept_index) for row in rows])

    def _match_parts(
        self, ball_parts: BoxParts
    ) -> Iterator[tuple[Shaped[Ints, "k"], Shaped[NDArray[np.uint32], "k"]]]:
        """Find the parts of objects that have directions in common with each part of a ball.

        A part is what lies in one octant, as seen from a light.  Yields batches of two arrays:
        indices of parts of balls, and of parts of objects.  No pair occurs twice.
        """
        # An object may be closer to the light than all of the ball.  So the minimum distance of
        # the ball excludes nothing.
        ball_bounds = ball_parts.bounds.T.copy()
        ball_bounds[:, MIN_DISTANCE_ROW] = -np.inf
        patch_index = self.patches.of_octant.take(ball_parts.octant_index)
        rectangles = self.patches.to_relative(ball_parts.rectangles, patch_index)
        for ball_part, object_part in self.cell_lists.find_pairs(rectangles, patch_index):
            meets_bound = self.part_bounds.take(object_part, 0) >= ball_bounds.take(ball_part, 0)
            # The same as meets_bound.all(axis=1), but much faster.
            match_index = find(meets_bound.view(np.uint64) == _EIGHT_TRUE)
            yield ball_part.take(match_index), object_part.take(match_index)


def build_light_grid(
    light_position: Shaped[Floats, "lights 3"],
    box_min: Shaped[Floats, "3 objects"],
    box_max: Shaped[Floats, "3 objects"],
    position_error: Shaped[Floats, "objects"],
    is_visible: Shaped[Bools, "objects"],
    is_occluder: Shaped[Bools, "objects"],
) -> LightGrid | None:
    """Build a light grid; return None if no object can be in the shadow of another object.

    Parameters
    ----------
    box_min, box_max
        Smallest and largest coordinates of each object.
    position_error
        Bound on the rounding errors of points on each object.
    is_visible
        Whether the camera may see the object.  Shadows on all other objects are ignored.
    is_occluder
        Whether the object may cast a shadow on other objects.
    """
    light_count, object_count = len(light_position), position_error.size
    if not (light_count and object_count > 1 and is_visible.any()):
        return None
    box_min, box_max = box_min - position_error, box_max + position_error
    near_position, vector_error = _move_far_lights(light_position, box_min, box_max)
    parts = _split_objects(near_position, vector_error, box_min, box_max)
    object_index = parts.box_index % object_count
    visible_part = find(is_visible[object_index])
    patches = choose_patches(
        parts.octant_index[visible_part], parts.rectangles[:, visible_part], 8 * light_count
    )
    has_patch = patches.of_octant[parts.octant_index] >= 0
    listed_parts = parts.take(find(has_patch & is_occluder[object_index]))
    # Free arrays that are large if there are many objects.
    del parts, object_index, has_patch
    patch_index = patches.of_octant[listed_parts.octant_index]
    rectangles = patches.to_relative(listed_parts.rectangles, patch_index)
    return LightGrid(
        light_position=near_position,
        patches=patches,
        cell_lists=build_cell_lists(
            rectangles, patch_index, patches.origin.shape[1], object_count, light_count
        ),
        part_bounds=np.ascontiguousarray(reverse_bounds(listed_parts.bounds).T),
        part_object=listed_parts.box_index % object_count,
    )


def _move_far_lights(
    positions: Shaped[Floats, "lights 3"],
    box_min: Shaped[Floats, "3 objects"],
    box_max: Shaped[Floats, "3 objects"],
) -> tuple[Shaped[Floats, "3 lights 1"], Shaped[Floats, "lights 1"]]:
    """Move lights farther away than `_MAX_LIGHT_DISTANCE` closer to the scene.

    The first result contains the positions of all lights.  The second bounds the error of each
    component of a vector from the scene to the light, due to the move and to rounding.
    """
    scene_min = box_min.min(axis=1, keepdims=True)
    scene_max = box_max.max(axis=1, keepdims=True)
    scene_size = (scene_max - scene_min).sum()
    center = scene_min / 2 + scene_max / 2
    from_center = positions.T - center
    shrink_factor = _MAX_LIGHT_DISTANCE * scene_size / np.abs(from_center).sum(axis=0)
    is_far = shrink_factor < 1
    near_positions = np.where(is_far, center + shrink_factor * from_center, positions.T)
    move_error = np.where(is_far, 2 * scene_size / _MAX_LIGHT_DISTANCE, 0)
    vector_error = DIRECTION_ROUNDING * np.abs(near_positions).sum(axis=0) + move_error
    return near_positions[:, :, None], vector_error[:, None]


def _split_objects(
    light_position: Shaped[Floats, "3 lights 1"],
    vector_error: Shaped[Floats, "lights 1"],
    box_min: Shaped[Floats, "3 objects"],
    box_max: Shaped[Floats, "3 objects"],
) -> BoxParts:
    """Divide each object, as seen from each light, into its parts in all octants."""
    return split_by_octant(
        vector_min=(light_position - vector_error) - box_max[:, None],
        vector_max=(light_position + vector_error) - box_min[:, None],
        keeps_octant=np.ones(8 * vector_error.size, dtype=np.bool_),
        keeps_box=np.array([[True]]),
    )
