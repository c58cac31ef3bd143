"""Estimate the mean radiance of smooth cells from their center samples.

A cell (a pixel or a square part of a pixel) is *smooth* if no edge crosses it.  Its mean radiance
is the radiance of its *center sample*, plus a correction for the curvature of the radiance.
Differences between the samples of neighbouring cells give the correction, and an estimate of the
remaining error.  Only samples with the same *id* are compared: their rays hit the same face of the
same object, and the same lights are visible from both hits.
"""

from __future__ import annotations

from typing import Annotated as Shaped
from typing import NamedTuple

import numpy as np

from tracer.arrays import Floats, Ints


class CenterSamples(NamedTuple):
    """The radiance and the id at the centers of n cells."""

    radiance: Shaped[Floats, "3 n"]  # linear RGB
    id: Shaped[Ints, "n"]  # -1 for the background

    def take(self, sample_index: Shaped[Ints, "k"]) -> CenterSamples:
        return CenterSamples(radiance=self.radiance[:, sample_index], id=self.id[sample_index])


class SmoothMeans(NamedTuple):
    """Estimated mean radiance of n cells, valid for those that no edge crosses."""

    radiance: Shaped[Floats, "3 n"]  # linear RGB
    # Estimated error of `radiance` in the channel where it is largest; NaN if too few neighbouring
    # samples have the same id.
    error: Shaped[Floats, "n"]


def estimate_pixel_means(pixel_samples: CenterSamples, width: int) -> SmoothMeans:
    """Estimate the mean radiance of the pixels of a rectangle, which is `width` pixels wide.

    The samples and the results are ordered row by row, from left to right.  The error of a pixel is
    NaN if neither of its neighbours in the row has the id of the pixel, or neither of those in the
    column.  Results at the border of the rectangle are meaningless.
    """
    # Over a pixel, the mean of a smooth function is about f + (f_xx + f_yy) / 24, from the value at
    # the center and the second derivatives there.
    radiance = pixel_samples.radiance
    correction = np.zeros(radiance.shape)
    error = np.zeros(pixel_samples.id.size)
    for neighbor_step in (1, width):  # along the row, then along the column
        inner_pixels = slice(neighbor_step, -neighbor_step)
        along_axis = _estimate_curvature(pixel_samples, neighbor_step)
        correction[:, inner_pixels] += along_axis.correction
        error[inner_pixels] = np.maximum(error[inner_pixels], along_axis.error)
    return SmoothMeans(radiance=radiance + correction, error=error)


class _AxisCurvature(NamedTuple):
    """Corrections for the curvature of the radiance along one axis, in m pixels."""

    correction: Shaped[Floats, "3 m"]  # 0 unless the pixel has both neighbours' id
    error: Shaped[Floats, "m"]  # NaN if the pixel has neither neighbour's id


def _estimate_curvature(samples: CenterSamples, neighbor_step: int) -> _AxisCurvature:
    """Compare each pixel with the previous and the next pixel along a row or a column.

    The index of the next pixel is larger by `neighbor_step`.  The results omit the first and the
    last `neighbor_step` pixels.
    """
    has_same_id = samples.id[neighbor_step:] == samples.id[:-neighbor_step]
    difference = samples.radiance[:, neighbor_step:] - samples.radiance[:, :-neighbor_step]
    difference *= has_same_id
    # The second derivative is about the difference between two differences.
    correction = (difference[:, neighbor_step:] - difference[:, :-neighbor_step]) / 24
    matches_previous = has_same_id[:-neighbor_step]
    matches_next = has_same_id[neighbor_step:]
    # If only one neighbour has the same id, its difference from the pixel estimates the error.
    max_correction = np.abs(correction).max(axis=0)
    correction *= matches_previous & matches_next
    error = np.where(matches_previous | matches_next, max_correction, np.nan)
    return _AxisCurvature(correction=correction, error=error)


def estimate_quarter_means(
    cell_samples: CenterSamples,
    error: Shaped[Floats, "cells"],
    quarter_samples: CenterSamples,
    tolerance: float,
) -> SmoothMeans:
    """Estimate the mean radiance of the quarters of cells by Richardson extrapolation.

    The sample of the cell is subtracted from the mean of the samples of its four quarters, and a
    third of the difference is added to each of the four.  If the five samples do not have the same
    id, the samples of the quarters remain as they are.

    Parameters
    ----------
    error
        Estimated error of each cell's mean radiance; NaN if it is unknown.
    quarter_samples
        Four samples of each cell, cell by cell.
    tolerance
        Maximum error of the mean radiance of a cell.
    """
    cell_id = cell_samples.id.repeat(4)
    quarter_id = quarter_samples.id
    mean_of_quarters = quarter_samples.radiance.reshape(3, -1, 4).mean(axis=2)
    has_same_id = (quarter_id == cell_id).reshape(-1, 4).all(axis=1)
    correction = np.where(has_same_id, (mean_of_quarters - cell_samples.radiance) / 3, 0)
    # The remaining error is of higher order in the width of the cell than the correction.
    quarter_error = np.where(has_same_id, np.abs(correction).max(axis=0) / 2, np.nan).repeat(4)
    # Halving the width of a cell divides its error by 4.  But near an edge, which different ids
    # suggest, the error may decrease more slowly.
    inherited_error = error.repeat(4) / np.where(np.isnan(quarter_error), 2, 4)
    # A small error of the cell says nothing about a quarter that shows a different surface.
    hits_other_surface = (quarter_id != cell_id) & (quarter_id >= 0)
    inherited_error[hits_other_surface & (inherited_error <= tolerance)] = np.nan
    return SmoothMeans(
        radiance=quarter_samples.radiance + correction.repeat(4, axis=1),
        error=np.fmax(inherited_error, quarter_error),
    )
