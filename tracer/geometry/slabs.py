"""Where lines, segments and capsules cross boxes whose edges are parallel to the axes.

A box is what three *slabs* have in common.  A slab is the space between the planes of two opposite
faces (Kay and Kajiya, Ray tracing complex scenes, 1986).  A line is inside a box while it is inside
all three slabs: from the last position at which it enters a slab to the first at which it leaves a
slab.  If these two positions are in the wrong order, the line misses the box.

Positions on a line are numbers t, which stand for the points start + t * direction.  For a segment,
the direction leads from its start to its end, so t runs from 0 to 1.  `low` and `high` are the
corners of each box with the smallest and with the largest coordinates.
"""

from __future__ import annotations

from typing import Annotated as Shaped
from typing import NamedTuple

import numpy as np

from tracer.arrays import Bools, Floats, Triple, map_xyz
from tracer.geometry.rounding import MIN_COMPONENT


class Crossings(NamedTuple):
    """Where n lines, each with its own slab or box, enter and leave it.

    The line misses the slab or box if `enter_t` is larger than `leave_t`.
    """

    enter_t: Shaped[Floats, "n"]
    leave_t: Shaped[Floats, "n"]

    def intersect(self, other: Crossings) -> Crossings:
        """Compute where the lines enter and leave what two slabs or boxes have in common."""
        return Crossings(
            enter_t=np.maximum(self.enter_t, other.enter_t),
            leave_t=np.minimum(self.leave_t, other.leave_t),
        )


def intersect_slab(
    low: Shaped[Floats, "n"],
    high: Shaped[Floats, "n"],
    direction: Shaped[Floats, "n"],
    *,
    is_closed: bool = False,
) -> Crossings:
    """Compute where lines enter and leave slabs, as multiples of each line's direction.

    A line parallel to the slab enters at -inf and leaves at inf if it is inside; otherwise it
    enters at inf and leaves at -inf.

    Parameters
    ----------
    low, high
        Coordinates of the two planes along their normal, relative to the start of the line.
    direction
        Component of the line's direction along this normal.
    is_closed
        Whether a line that lies in one of the planes counts as inside the slab.
    """
    low_t, high_t = low / direction, high / direction
    enter_t, leave_t = np.minimum(low_t, high_t), np.maximum(low_t, high_t)
    if np.count_nonzero(direction) < direction.size:
        is_parallel = direction == 0
        is_inside = (low <= 0) & (high >= 0) if is_closed else (low < 0) & (high > 0)
        enter_t = np.where(is_parallel, np.where(is_inside, -np.inf, np.inf), enter_t)
        leave_t = np.where(is_parallel, np.where(is_inside, np.inf, -np.inf), leave_t)
    return Crossings(enter_t, leave_t)


def crosses_surface(
    start: Shaped[Triple, "n"],
    end: Shaped[Triple, "n"],
    low: Shaped[Triple, "n"],
    high: Shaped[Triple, "n"],
) -> Shaped[Bools, "n"]:
    """Test whether segments enter or leave boxes strictly between the segments' ends.

    Each segment is tested with its own box, which has the corners `low` and `high`.
    """
    # Coordinate i is x in the first pass, then y, then z.
    x, y, z = (
        intersect_slab(low_i - start_i, high_i - start_i, end_i - start_i)
        for start_i, end_i, low_i, high_i in zip(start, end, low, high, strict=True)
    )
    enter_t, leave_t = x.intersect(y).intersect(z)
    is_within_segment = ((enter_t > 0) & (enter_t < 1)) | ((leave_t > 0) & (leave_t < 1))
    crosses: Bools = (enter_t <= leave_t) & is_within_segment
    return crosses


def test_capsules_on_boxes(
    low: Shaped[Triple, "n"],
    high: Shaped[Triple, "n"],
    axis_start: Shaped[Triple, "n"],
    axis_end: Shaped[Triple, "n"],
    radius: Shaped[Floats, "n"],
) -> tuple[Shaped[Bools, "n"], Shaped[Bools, "n"]]:
    """Test whether the surface of each box crosses some, or all, segments in a capsule.

    All segments stay within `radius` from the *axis* of the capsule, which leads from `axis_start`
    to `axis_end` (see `Shape.test_capsules`).
    """
    # The box grown by the radius contains all points at most this far from the box.  Around each
    # point of the shrunk box, the box contains all points at most this far away.  Both begin as the
    # whole space, and lose what is outside of one slab after the other: with the slabs of all axes
    # in memory, tests of 3,000 to 5,000 capsules take three times as long.
    no_bound = np.full(radius.size, np.inf)
    grown = shrunk = Crossings(-no_bound, no_bound)
    # Coordinate i is x in the first pass, then y, then z.
    for start_i, end_i, low_i, high_i in zip(axis_start, axis_end, low, high, strict=True):
        direction = end_i - start_i
        to_low, to_high = low_i - start_i, high_i - start_i
        if np.count_nonzero(direction) < direction.size:
            # An axis parallel to a slab is treated as one that meets the planes far away.
            length_scale = np.abs(to_low) + np.abs(to_high) + radius
            direction = direction + (direction == 0) * (MIN_COMPONENT * length_scale)
        enter_t, leave_t = intersect_slab(to_low, to_high, direction)
        # If the planes are moved by the radius, the axis crosses them this much earlier or later.
        shift = radius / np.abs(direction)
        grown = grown.intersect(Crossings(enter_t - shift, leave_t + shift))
        shrunk = shrunk.intersect(Crossings(enter_t + shift, leave_t - shift))
    meets_grown = (grown.enter_t <= grown.leave_t) & (grown.leave_t >= 0) & (grown.enter_t <= 1)
    is_capsule_inside = (shrunk.enter_t < 0) & (shrunk.leave_t > 1)
    are_ends_outside = (grown.enter_t > 0) & (grown.leave_t < 1)
    crosses_all: Bools = (shrunk.enter_t < shrunk.leave_t) & are_ends_outside
    return meets_grown & ~is_capsule_inside, crosses_all


def snap_to_faces(
    point: Shaped[Triple, "n"],
    low: Shaped[Triple, "n"],
    high: Shaped[Triple, "n"],
    tolerance: Shaped[Floats, "n"],
) -> Shaped[Triple, "n"]:
    """Move points that are at most `tolerance` away from the plane of a face onto this plane.

    Each point has its own box, which has the corners `low` and `high`.
    """

    def snap_coordinate(
        x: Shaped[Floats, "n"], low_x: Shaped[Floats, "n"], high_x: Shaped[Floats, "n"]
    ) -> Shaped[Floats, "n"]:
        is_on_low = np.abs(x - low_x) <= tolerance
        is_on_high = np.abs(x - high_x) <= tolerance
        return np.where(is_on_low, low_x, np.where(is_on_high, high_x, x))

    return map_xyz(snap_coordinate, point, low, high)
