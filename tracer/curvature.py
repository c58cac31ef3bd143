"""How light bends across cells: what the mean of one differs from the sample in its middle."""

from __future__ import annotations

import numpy as np

from tracer.arrays import Floats, Ints

__all__ = ["curvature", "extrapolated"]


def curvature(radiance: Floats, key: Ints, width: int) -> tuple[Floats, Floats]:
    """What to add to centres (3, height * width) for the mean of pixels, and how far it may be off.

    The mean of f over a pixel is f + (f_xx + f_yy) / 24 and more of higher order.  Derivatives are
    differences, where both neighbours see the same.  What is said of pixels on the rim has no
    meaning.
    """
    count = key.size
    total, error = np.empty(radiance.shape), np.zeros(count)
    isolated = np.ones(count, dtype=np.bool_)
    for stride in (1, width):
        middle = slice(stride, count - stride)
        same = key[stride:] == key[:-stride]
        before, after = same[:-stride], same[stride:]
        isolated[middle] &= ~(before | after)
        # There are few edges: what is wrong there is put right there.
        edge = np.flatnonzero(~same)
        one_sided, not_smooth = np.flatnonzero(before != after), np.flatnonzero(~(before & after))
        change = np.zeros(one_sided.size)
        for channel, out in zip(radiance, total, strict=True):
            step = channel[stride:] - channel[:-stride]
            step[edge] = 0
            bend = step[stride:] - step[:-stride]
            np.maximum(change, np.abs(bend[one_sided]), out=change)
            bend[not_smooth] = 0
            if stride == 1:
                out[0], out[middle], out[-1] = 0, bend, 0
            else:
                out[middle] += bend
        at = one_sided + stride
        error[at] = np.maximum(error[at], change)
    total *= 1 / 24
    error *= 1 / 24
    for channel in total:
        np.maximum(error, np.abs(channel), out=error)
    # Surfaces that coincide may change from one ray to the next.
    error[isolated] = np.inf
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
