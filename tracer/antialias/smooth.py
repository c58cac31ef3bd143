"""Mean radiance of smooth cells, computed from the samples at their centres.

No edge crosses a smooth cell (a pixel, or a square part of a pixel).  Its mean radiance is the
radiance at its centre plus a correction for the curvature of the radiance.  Differences between the
samples of neighbouring cells give the correction, and an estimate of the remaining error.  Only
samples with the same id are compared.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tracer.arrays import Floats, Ints


class CenterSamples(NamedTuple):
    """The samples through the centres of n cells.

    Attributes
    ----------
    radiance : (3, n) float array
        Linear RGB radiance of each sample.
    id : (n,) int array
        Id of each sample.  Two samples have the same id if they hit the same face of the same
        object, and the same lights reach both hits; -1 for the background.
    """

    radiance: Floats
    id: Ints

    def take(self, index: Ints) -> CenterSamples:
        """Select samples by index."""
        return CenterSamples(self.radiance[:, index], self.id[index])


class SmoothMeans(NamedTuple):
    """Mean radiance of n cells, valid if no edge crosses them.

    Attributes
    ----------
    radiance : (3, n) float array
        Estimated mean linear RGB radiance of each cell.
    error : (n,) float array
        Estimated error of `radiance`, in the colour channel where it is largest.  It is NaN, for
        unknown, if too few neighbouring samples have the id of the cell's own sample.
    """

    radiance: Floats
    error: Floats


def means_of_pixels(center: CenterSamples, width: int) -> SmoothMeans:
    """Estimate the mean radiance of smooth pixels from samples at the centres of pixels.

    The mean of a smooth function f over a pixel is f + (f_xx + f_yy) / 24, with the value and the
    second derivatives at the centre, plus terms of higher order.  Second differences between the
    pixel and its two neighbours, in the row and in the column, replace the second derivatives.
    They are added where both neighbours have the same id as the pixel.

    Parameters
    ----------
    center : CenterSamples
        The n samples at the centres of a rectangle of pixels, row by row.
    width : int
        Number of pixels in each row of the rectangle.

    Returns
    -------
    means : SmoothMeans
        Mean radiance of each pixel, meaningless for the pixels at the border of the rectangle.  The
        error is the larger of the absolute second differences in the row and in the column, divided
        by 24.  If only one of the two neighbours has the pixel's id, the difference to it
        replaces the second difference.  If neither has it, in the row or in the column, the error
        is NaN.
    """
    radiance, center_id = center
    correction, error = np.zeros(radiance.shape), np.zeros(center_id.size)
    for stride in (1, width):
        inner = slice(stride, -stride)
        is_same = center_id[stride:] == center_id[:-stride]
        difference = (radiance[:, stride:] - radiance[:, :-stride]) * is_same
        second_difference = (difference[:, stride:] - difference[:, :-stride]) / 24
        same_before, same_after = is_same[:-stride], is_same[stride:]
        largest = np.abs(second_difference).max(axis=0)
        line_error = np.where(same_before | same_after, largest, np.nan)
        error[inner] = np.maximum(error[inner], line_error)
        correction[:, inner] += second_difference * (same_before & same_after)
    return SmoothMeans(radiance + correction, error)


def means_of_quarters(
    center: CenterSamples, error: Floats, quarter_center: CenterSamples, tolerance: float
) -> SmoothMeans:
    """Estimate the mean radiance of smooth quarters of cells from samples at their centres.

    This is Richardson extrapolation: the difference between the mean of the four quarter samples
    and the cell's own sample, divided by 3, is added to the sample of each quarter.  It is valid if
    the five samples have the same id, that is, if they hit the same face of the same object,
    and the same lights reach all hits.

    Parameters
    ----------
    center : CenterSamples
        The samples at the centres of m cells.
    error : (m,) float array
        Estimated error of the mean radiance of each cell, if the cell is smooth; NaN if unknown.
    quarter_center : CenterSamples
        The samples at the centres of the 4 m quarters, in the order of their cells.
    tolerance : float
        Maximum error of the mean radiance of a cell.

    Returns
    -------
    means : SmoothMeans
        Mean radiance of each of the 4 m quarters.  Its error is the larger of two estimates, or the
        one that is known, or NaN:

        1. Half of the correction, because the remaining error is of higher order in the width of
           the cell.  This estimate is unknown if the five samples do not have the same id.
        2. The error of the cell, divided by 4, because the error decreases with the square of the
           width.  If the first estimate is unknown, an edge may be near.  Towards an edge, light
           may decrease like a square root, so the error of the cell is divided by 2 only.  This
           estimate is ignored if it is within the tolerance although the sample of the quarter hits
           a different surface than that of the cell, or the same surface under different lights.
    """
    cell_id, quarter_id = center.id.repeat(4), quarter_center.id
    quarter_mean = quarter_center.radiance.reshape(3, -1, 4).mean(axis=2)
    is_same = (quarter_id == cell_id).reshape(-1, 4).all(axis=1)
    correction = np.where(is_same, (quarter_mean - center.radiance) / 3, 0)
    own_error = np.where(is_same, np.abs(correction).max(axis=0) / 2, np.nan).repeat(4)
    inherited_error = error.repeat(4) / np.where(np.isnan(own_error), 2, 4)
    hits_other = (quarter_id != cell_id) & (quarter_id >= 0)
    inherited_error[hits_other & (inherited_error <= tolerance)] = np.nan
    radiance = quarter_center.radiance + correction.repeat(4, axis=1)
    return SmoothMeans(radiance, np.fmax(inherited_error, own_error))
