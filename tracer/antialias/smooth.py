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


def estimate_pixel_means(pixel_samples: CenterSamples, width: int) -> SmoothMeans:
    """Estimate the mean radiance of pixels without edges from samples at their centres.

    The mean of a smooth function f over a pixel is about f + (f_xx + f_yy) / 24, with the value and
    the second derivatives of f at the centre.  The derivatives are approximated by differences
    between neighbouring pixels.  Only pixels with the same id are compared: their samples hit the
    same face of the same object, under the same lights.

    Parameters
    ----------
    pixel_samples : CenterSamples
        Radiance and id of the samples at the centres of a rectangle of pixels, row by row.
    width : int
        Number of pixels in each row of the rectangle.

    Returns
    -------
    means : SmoothMeans
        Estimated mean radiance of each pixel (`radiance`), and its estimated error (`error`).  The
        error is NaN if no neighbour in the row, or none in the column, has the same id.  Both
        estimates are meaningless at the border of the rectangle.
    """
    radiance, pixel_id = pixel_samples
    correction, error = np.zeros(radiance.shape), np.zeros(pixel_id.size)
    for stride in (1, width):
        inner_pixels = slice(stride, -stride)
        has_same_id = pixel_id[stride:] == pixel_id[:-stride]
        difference = (radiance[:, stride:] - radiance[:, :-stride]) * has_same_id
        axis_correction = (difference[:, stride:] - difference[:, :-stride]) / 24
        same_id_before, same_id_after = has_same_id[:-stride], has_same_id[stride:]
        # If only one neighbour has the id, its difference from the pixel estimates the error.
        max_correction = np.abs(axis_correction).max(axis=0)
        axis_error = np.where(same_id_before | same_id_after, max_correction, np.nan)
        error[inner_pixels] = np.maximum(error[inner_pixels], axis_error)
        correction[:, inner_pixels] += axis_correction * (same_id_before & same_id_after)
    return SmoothMeans(radiance + correction, error)


def estimate_quarter_means(
    cell_samples: CenterSamples, error: Floats, quarter_samples: CenterSamples, tolerance: float
) -> SmoothMeans:
    """Estimate the mean radiance of quarters of cells from samples at their centres.

    A cell is a pixel or a square part of a pixel.  The method is Richardson extrapolation: subtract
    the sample of the cell from the mean of the four quarter samples, and add a third of the
    difference to each quarter sample.  This correction is made only if all five samples have the
    same id: they hit the same face of the same object, under the same lights.

    Parameters
    ----------
    cell_samples : CenterSamples
        Radiance and id of the samples at the centres of m cells.
    error : (m,) float array
        Estimated error of the mean radiance of each cell, if no edge crosses it; NaN if unknown.
    quarter_samples : CenterSamples
        Radiance and id of the samples at the centres of the 4 m quarters: the four of the first
        cell, then the four of the second cell, and so on.
    tolerance : float
        Maximum error of the mean radiance of a cell.

    Returns
    -------
    means : SmoothMeans
        Estimated mean radiance of each of the 4 m quarters (`radiance`), valid if no edge crosses
        the quarter, and its estimated error (`error`), which is NaN if unknown.
    """
    cell_id, quarter_id = cell_samples.id.repeat(4), quarter_samples.id
    mean_of_quarters = quarter_samples.radiance.reshape(3, -1, 4).mean(axis=2)
    has_same_id = (quarter_id == cell_id).reshape(-1, 4).all(axis=1)
    correction = np.where(has_same_id, (mean_of_quarters - cell_samples.radiance) / 3, 0)
    # The remaining error is of higher order in the width of the cell than the correction.
    own_error = np.where(has_same_id, np.abs(correction).max(axis=0) / 2, np.nan).repeat(4)
    # Errors decrease with the square of the width.  But if ids differ, an edge may be near, where
    # light may decrease like a square root.
    inherited_error = error.repeat(4) / np.where(np.isnan(own_error), 2, 4)
    # A small error of the cell says nothing about a quarter with a different surface.
    hits_other_surface = (quarter_id != cell_id) & (quarter_id >= 0)
    inherited_error[hits_other_surface & (inherited_error <= tolerance)] = np.nan
    radiance = quarter_samples.radiance + correction.repeat(4, axis=1)
    return SmoothMeans(radiance, np.fmax(inherited_error, own_error))
