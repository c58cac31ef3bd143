"""How light bends across cells: what the mean of one differs from the sample in its middle."""

from __future__ import annotations

import numpy as np

from tracer.arrays import Floats, Ints

__all__ = ["curvature", "extrapolated"]


def curvature(radiance: Floats, key: Ints, width: int) -> tuple[Floats, Floats]:
    """What to add to centres (3, height * width) for the mean of pixels, and how far it may be off.

    It is a 24th of the second differences along the row and the column, where both neighbours
    see the same.  What it says of pixels on the rim has no meaning.
    """
    count = key.size
    total, error = np.empty(radiance.shape), np.zeros(count)
    lone = np.ones(count, dtype=np.bool_)
    for stride in (1, width):
        middle = slice(stride, count - stride)
        same = key[stride:] == key[:-stride]
        before, after = same[:-stride], same[stride:]
        lone[middle] &= ~(before | after)
        # There are few edges: what is wrong there is put right there.
        other = np.flatnonzero(~same)
        one, none = np.flatnonzero(before != after), np.flatnonzero(~(before & after))
        off = np.zeros(one.size)
        for channel, out in zip(radiance, total, strict=True):
            step = channel[stride:] - channel[:-stride]
            step[other] = 0
            bend = step[stride:] - step[:-stride]
            np.maximum(off, np.abs(bend[one]), out=off)
            bend[none] = 0
            if stride == 1:
                out[0], out[middle], out[-1] = 0, bend, 0
            else:
                out[middle] += bend
        error[one + stride] = np.maximum(error[one + stride], off)
    total *= 1 / 24
    error *= 1 / 24
    for channel in total:
        np.maximum(error, np.abs(channel), out=error)
    # Surfaces that coincide may change from one ray to the next.
    error[lone] = np.inf
    return total, error


def extrapolated(radiance: Floats, key: Ints, fine: Floats, keys: Ints) -> tuple[Floats, Floats]:
    """`curvature` of quarters of cells, from what the cells' centres and theirs see.

    Of the cells radiance (3, n) and key (n,); of their quarters fine (3, 4 n) and keys (4 n,).

    Where all see the same, the mean lies beyond that of the quarters' centres by a third of the
    way there from the cell's (Richardson's extrapolation).
    """
    fine, keys = fine.reshape(3, -1, 4), keys.reshape(-1, 4)
    alike = (keys == key[:, None]).all(axis=1)
    bend = np.where(alike, (fine.mean(axis=2) - radiance) / 3, 0)
    # What that leaves out is of higher order in their size.
    error = np.abs(bend).max(axis=0) / 2
    return np.repeat(bend, 4, axis=1), np.repeat(error, 4)
