"""Estimate the mean radiance of smooth cells from the samples at their centres.

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
    """The samples through the centres of n cells (pixels, or square parts of pixels).

    Attributes
    ----------
    radiance : (3, n) float array
        Linear RGB radiance of each sample.
    id : (n,) int array
        Id of each sample.  Two samples have the same id if they hit the same face of the same
        object, and the same lights are visible from both hits.  The id of the background is -1.
    """

    radiance: Floats
    id: Ints

    def take(self, sample_index: Ints) -> CenterSamples:
        """Select samples by index.

        Parameters
        ----------
        sample_index : (k,) int array
            Indices of the samples to select.

        Returns
        -------
        selected : CenterSamples
            The k selected samples, in the order of `sample_index`.
        """
        return CenterSamples(self.radiance[:, sample_index], self.id[sample_index])


class SmoothMeans(NamedTuple):
    """Mean radiance of n cells (pixels, or square parts of pixels), valid if no edge crosses them.

    Attributes
    ----------
    radiance : (3, n) float array
        Estimated mean linear RGB radiance of each cell.
    error : (n,) float array
        Estimated error of `radiance`, in the colour channel where it is largest.  NaN means that
        the error is unknown, because too few neighbouring samples hit the same face under the same
        lights as the cell's own sample.
    """

    radiance: Floats
    error: Floats


def estimate_pixel_means(center: CenterSamples, width: int) -> SmoothMeans:
    """Estimate the mean radiance of pixels without edges from samples at their centres.

    The mean of a smooth function f over a pixel is f + (f_xx + f_yy) / 24, plus terms of higher
    order.  Here f, f_xx and f_yy are the value and the second derivatives at the centre.  Second
    differences between a pixel and its two neighbours approximate f_xx (in the row) and f_yy (in
    the column).  A second difference is used only if both neighbours have the same id as the pixel,
    that is, if all three samples hit the same face of the same object, and the same lights are
    visible from the three hits.

    Parameters
    ----------
    center : CenterSamples
        Radiance and id of the samples at the centres of a rectangle of pixels, row by row.
    width : int
        Number of pixels in each row of the rectangle.

    Returns
    -------
    means : SmoothMeans
        Estimated mean radiance of each pixel (`radiance`) and its estimated error (`error`).  Both
        are meaningless for pixels at the border of the rectangle.  The error is the larger of two
        numbers, one from the row and one from the column:

        1. If both neighbours have the pixel's id, the number is the absolute second difference,
           divided by 24.
        2. If only one of them has the id, the number is the absolute difference between this
           neighbour and the pixel, divided by 24.
        3. If neither has the id, the number is NaN, and so is the error.
    """
    radiance, center_id = center
    correction, error = np.zeros(radiance.shape), np.zeros(center_id.size)
    for stride in (1, width):
        inner_pixels = slice(stride, -stride)
        has_same_id = center_id[stride:] == center_id[:-stride]
        difference = (radiance[:, stride:] - radiance[:, :-stride]) * has_same_id
        second_difference = (difference[:, stride:] - difference[:, :-stride]) / 24
        same_id_before, same_id_after = has_same_id[:-stride], has_same_id[stride:]
        max_difference = np.abs(second_difference).max(axis=0)
        axis_error = np.where(same_id_before | same_id_after, max_difference, np.nan)
        error[inner_pixels] = np.maximum(error[inner_pixels], axis_error)
        correction[:, inner_pixels] += second_difference * (same_id_before & same_id_after)
    return SmoothMeans(radiance + correction, error)


def estimate_quarter_means(
    center: CenterSamples, error: Floats, quarter_center: CenterSamples, tolerance: float
) -> SmoothMeans:
    """Estimate the mean radiance of quarters of cells from samples at their centres.

    A cell is a pixel or a square part of a pixel.  The method is Richardson extrapolation: the
    difference between the mean of the four quarter samples and the cell's own sample is divided by
    3, and added to the sample of each quarter.  This correction is made only if all five samples
    have the same id, that is, if they hit the same face of the same object, and the same lights are
    visible from all five hits.

    Parameters
    ----------
    center : CenterSamples
        Radiance and id of the samples at the centres of m cells.
    error : (m,) float array
        Estimated error of the mean radiance of each cell, if no edge crosses it; NaN if unknown.
    quarter_center : CenterSamples
        Radiance and id of the samples at the centres of the 4 m quarters: the four of the first
        cell, then the four of the second cell, and so on.
    tolerance : float
        Maximum error of the mean radiance of a cell.

    Returns
    -------
    means : SmoothMeans
        Estimated mean radiance of each of the 4 m quarters (`radiance`), valid if no edge crosses
        the quarter, and its estimated error (`error`): the larger of the following two estimates,
        the only known one, or NaN if both are unknown.

        1. The *own* error is half the correction, because the remaining error is of higher order in
           the width of the cell.  It is unknown if the five samples have different ids.
        2. The *inherited* error is a quarter of the cell's error, because errors decrease with the
           square of the width.  If the own error is unknown, an edge may be near, where light may
           decrease like a square root; then it is half the cell's error.  The inherited error is
           ignored if it is at most the tolerance, and the quarter's sample hits a surface but has a
           different id from the cell's sample.
    """
    cell_id, quarter_id = center.id.repeat(4), quarter_center.id
    mean_of_quarters = quarter_center.radiance.reshape(3, -1, 4).mean(axis=2)
    has_same_id = (quarter_id == cell_id).reshape(-1, 4).all(axis=1)
    correction = np.where(has_same_id, (mean_of_quarters - center.radiance) / 3, 0)
    own_error = np.where(has_same_id, np.abs(correction).max(axis=0) / 2, np.nan).repeat(4)
    inherited_error = error.repeat(4) / np.where(np.isnan(own_error), 2, 4)
    hits_other_surface = (quarter_id != cell_id) & (quarter_id >= 0)
    inherited_error[hits_other_surface & (inherited_error <= tolerance)] = np.nan
    radiance = quarter_center.radiance + correction.repeat(4, axis=1)
    return SmoothMeans(radiance, np.fmax(inherited_error, own_error))
