"""How light bends across cells: by how much a cell's mean differs from the sample in its middle."""

from __future__ import annotations

import numpy as np

from tracer.arrays import Floats, Ints, indices


def curvature(radiance: Floats, ids: Ints, width: int) -> tuple[Floats, Floats]:
    """What to add to the samples at pixels' centres for the pixels' means, and its error (n,).

    `radiance` (3, n) and `ids` (n,) are what `Classification` says, with n = height * width.

    The mean of f over a pixel is f + (f_xx + f_yy) / 24 and terms of higher order.  Derivatives
    are differences between a pixel and its neighbours, where both of these see the same as it
    does; where only one does, the difference counts as error; where neither does, that is NaN.
    Results for pixels on the rim are meaningless.
    """
    count = ids.size
    total, error = np.zeros(radiance.shape), np.zeros(count)
    for stride in (1, width):
        middle = slice(stride, count - stride)
        same = ids[stride:] == ids[:-stride]
        before, after = same[:-stride], same[stride:]
        # Edges are few: differences are taken everywhere, and those across edges put right.
        edge = indices(~same)
        one_sided, not_smooth = indices(before != after), indices(~(before & after))
        change = np.zeros(one_sided.size)
        for channel, out in zip(radiance, total, strict=True):
            step = channel[stride:] - channel[:-stride]
            step[edge] = 0
            bend = step[stride:] - step[:-stride]
            np.maximum(change, np.abs(bend[one_sided]), out=change)
            bend[not_smooth] = 0
            out[middle] += bend
        at = one_sided + stride
        error[at] = np.maximum(error[at], change)
        error[indices(~(before | after)) + stride] = np.nan
    total *= 1 / 24
    error *= 1 / 24
    for channel in total:
        np.maximum(error, np.abs(channel), out=error)
    return total, error


def extrapolated(radiance: Floats, ids: Ints, fine: Floats, idss: Ints) -> tuple[Floats, Floats]:
    """`curvature` of quarters of cells, from what the cells' centres and their own see.

    Of the cells `radiance` (3, n) and `ids` (n,); of their quarters `fine` (3, 4 n) and `idss`
    (4 n,).

    Where all see the same, the cell's mean is that of its quarters' centres, plus a third of its
    difference from the cell's centre (Richardson's extrapolation).  Elsewhere the error is NaN.
    """
    fine, idss = fine.reshape(3, -1, 4), idss.reshape(-1, 4)
    alike = (idss == ids[:, None]).all(axis=1)
    bend = np.where(alike, (fine.mean(axis=2) - radiance) / 3, 0)
    # What this leaves out is of higher order in the cells' size; half of the correction covers it.
    error = np.where(alike, np.abs(bend).max(axis=0) / 2, np.nan)
    return bend.repeat(4, axis=1), error.repeat(4)
