"""Directions to lights: bounds on the vectors from an object, or from a ball, to a light.

The vectors from all points of an object to a light lie in a *box*, whose edges are parallel to the
axes of the scene.  An *octant* is the set of all directions for which x, y and z have given signs.
The *part* of a box in an octant consists of the vectors that have these signs, so there are up to
eight parts.  Two kinds of bounds describe the directions of a part:

rectangle
    Bounds on the octahedral coordinates u = |x| / s and v = |y| / s, with s = |x| + |y| + |z|
    (Engelhardt and Dachsbacher, 2008).  They run from 0 to 1, and u + v is at most 1.
direction bounds
    Bounds on s, and on the ratios |x| / (|x| + |y|), |y| / (|y| + |z|) and |z| / (|z| + |x|), each
    of which is constant in a plane through the light.  They are tighter for long objects.

All bounds are computed by interval arithmetic.  Each ratio has the form a / (a + b) with a, b >= 0.
It increases with a and decreases with b, so it is least for the smallest a and the largest b.  The
light may be outside, on or inside an object.  All bounds are widened by more than their rounding
errors.
"""

from __future__ import annotations

from itertools import product
from typing import Annotated as Shaped
from typing import NamedTuple

import numpy as np

from tracer.arrays import Bools, Floats, Ints, find
from tracer.geometry.rounding import DIRECTION_ROUNDING, MIN_DIVISOR, POSITION_ROUNDING

# Row of the direction bounds that contains the minimum of s.
MIN_DISTANCE_ROW = 7


class BoxParts(NamedTuple):
    """The parts of boxes in octants.

    The n boxes of each light are numbered consecutively, light by light.
    """

    # Index, octant * lights + light, of an octant of one light; in ascending order.
    octant_index: Shaped[Ints, "parts"]
    box_index: Shaped[Ints, "parts"]  # light * n + box
    rectangles: Shaped[Floats, "4 parts"]  # minimum and maximum of u, then of v
    bounds: Shaped[Floats, "8 parts"]  # direction bounds, row by row as in `_bound_directions`

    def take(self, part_index: Shaped[Ints, "k"]) -> BoxParts:
        return BoxParts._make(field.take(part_index, axis=-1) for field in self)


class _Range(NamedTuple):
    """Smallest and largest absolute values of one component of the vectors in each part."""

    low: Shaped[Floats, "parts"]
    high: Shaped[Floats, "parts"]  # above 0, so no bound is 0 / 0


def split_by_octant(
    vector_min: Shaped[Floats, "3 lights n"],
    vector_max: Shaped[Floats, "3 lights n"],
    keeps_octant: Shaped[Bools, "8*lights"],
    keeps_box: Shaped[Bools, "#lights #n"],
) -> BoxParts:
    """Split boxes of vectors into parts, and bound the directions of each part.

    Parameters
    ----------
    vector_min, vector_max
        Smallest and largest components of the vectors in each box.
    keeps_octant
        Whether the result contains parts in the octant of a light; element octant * lights + light.
    keeps_box
        Whether the result contains parts of the box.
    """
    _, light_count, box_count = vector_min.shape
    pair_count = light_count * box_count  # pairs of a light and a box
    # Row 0: whether each box contains vectors with x >= 0.  Row 1: whether with x <= 0.
    has_x, has_y, has_z = np.array([vector_max >= 0, vector_min <= 0]).swapaxes(0, 1)
    # Row i: whether each box may have a part in the octant with the signs i.  Bit 0 of i is set if
    # x is negative, bit 1 if y is, and bit 2 if z is.
    has_part = np.array([z & y & x & keeps_box for z, y, x in product(has_z, has_y, has_x)])
    # The index in the flattened array is (sign_bits * lights + light) * n + box.
    flat_index = find(has_part & keeps_octant.reshape(8, -1, 1))
    sign_bits = flat_index // pair_count
    box_index = flat_index - sign_bits * pair_count
    x, y, z = (
        _bound_component(
            vector_min[axis].take(box_index),
            vector_max[axis].take(box_index),
            is_negative=(sign_bits >> axis & 1).astype(np.bool_),
        )
        for axis in range(3)
    )
    return BoxParts(
        octant_index=flat_index // box_count,
        box_index=box_index,
        rectangles=np.array([*_bound_share(x, y, z), *_bound_share(y, x, z)]),
        bounds=_bound_directions(x, y, z),
    )


def _bound_component(
    low: Shaped[Floats, "parts"], high: Shaped[Floats, "parts"], is_negative: Shaped[Bools, "parts"]
) -> _Range:
    """Bound the absolute value of a component that has the given sign.

    The component itself, with its sign, lies between `low` and `high`.
    """
    return _Range(
        low=np.maximum(np.where(is_negative, -high, low), 0),
        high=np.where(is_negative, -low, high) + MIN_DIVISOR,
    )


def _bound_share(
    a: _Range, b: _Range, c: _Range
) -> tuple[Shaped[Floats, "parts"], Shaped[Floats, "parts"]]:
    """Compute the minimum and the maximum of a / (a + b + c) from absolute values of components.

    The ratio is the octahedral coordinate u if a is |x|, and v if a is |y|.
    """
    min_share = a.low / (a.low + (b.high + c.high)) - DIRECTION_ROUNDING
    max_share = a.high / (a.high + (b.low + c.low)) + DIRECTION_ROUNDING
    return min_share, max_share


def _bound_directions(x: _Range, y: _Range, z: _Range) -> Shaped[Floats, "8 parts"]:
    """Compute the direction bounds of each part from the absolute values x, y and z of components.

    Rows 0 to 5 contain the minimum and the negated maximum of x / (x + y), of y / (y + z) and of
    z / (z + x).  Row 6 contains the negated maximum of s = x + y + z, and row 7 the minimum.
    Maxima are negated, so that all bounds are lower bounds.
    """
    bounds = np.empty((8, x.low.size))
    for pair_index, (a, b) in enumerate(((x, y), (y, z), (z, x))):
        bounds[2 * pair_index] = a.low / (a.low + b.high) - DIRECTION_ROUNDING
        bounds[2 * pair_index + 1] = -(a.high / (a.high + b.low)) - DIRECTION_ROUNDING
    bounds[6] = -(1 + POSITION_ROUNDING) * (x.high + y.high + z.high)
    bounds[MIN_DISTANCE_ROW] = (1 - POSITION_ROUNDING) * (x.low + y.low + z.low)
    return bounds


def reverse_bounds(bounds: Shaped[Floats, "8 n"]) -> Shaped[Floats, "8 n"]:
    """Swap the minimum and the negated maximum of each quantity, and negate both.

    So a row with a minimum then contains the maximum.  Two parts may have a direction in common
    only if each bound of one part is at most the reversed bound of the other part.
    """
    return -bounds.reshape(4, 2, -1)[:, ::-1].reshape(8, -1)
