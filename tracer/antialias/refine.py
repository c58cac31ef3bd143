"""Antialiasing by adaptive subdivision (Whitted 1980): compute the mean radiance of each pixel.

A *cell* is a pixel or a square part of a pixel.  Its *center sample* is traced through its centre.
`classify` traces the center samples of many cells, and finds the edges that may cross each cell.
These decide how the mean radiance of the cell is computed:

1. A *smooth* cell shows one face under the same lights.  Its center sample, corrected for the
   curvature of the radiance, is as accurate as a grid of samples.
2. A cell that is crossed only by straight lines is sampled on a lattice if few samples are
   requested in it, because sampling then costs less than subdivision.  The lines divide the cell
   into regions; the samples in a region together represent its exact area.  If samples in one
   region hit different faces, or the same face under different lights, then an edge was missed,
   and the cell is divided after all.
3. All other cells are divided into quarters, down to a smallest size.  Cells of this size are
   sampled, a second time on a finer lattice if the first one shows that an edge was missed.
   `_choose_lattices` lists the lattices.  If all quarters of a cell are *unresolved* (they may
   contain something other than straight edges), then a lattice of samples tests whether the cell
   is smooth nevertheless.
4. *Crowded* pixels, in which finding all edges would cost more than a lattice of samples, are
   sampled immediately.  So are all pixels of a picture that is full of edges: see
   `is_supersampling_cheaper`.

Whitted, An improved illumination model for shaded display, Communications of the ACM 23, 1980.
"""

from __future__ import annotations

import numpy as np

from tracer.antialias.classify import Cells, Classification, classify
from tracer.antialias.edges import find_silhouette_pixels
from tracer.antialias.lattice import CENTERS, Lattice
from tracer.antialias.regions import find_samples_in_mixed_regions, place_weighted_points
from tracer.antialias.smooth import SmoothMeans, estimate_pixel_means, estimate_quarter_means
from tracer.arrays import BATCH_SIZE, Bools, Floats, Ints, index_batches, indices
from tracer.trace.radiance import compute_radiance_and_ids
from tracer.trace.samples import Scattered
from tracer.world.prepared_scene import PreparedScene

# Maximum number of samples that are traced together in cells that edges cross: it limits memory.
_SAMPLES_PER_BATCH = BATCH_SIZE

# Maximum error of the mean radiance of a cell if one sample per pixel is requested.  If n x n are
# requested, the limit is divided by n^(3/2), because the error of a grid decreases at this rate.
# Tuned on the project's scenes: with twice the limit, errors of 4 samples are up to twice as large;
# with half the limit, 64 samples take up to 1.4 times as long.
_TOLERANCE = 8e-3

# Cells in which at most this many samples along each side are requested are sampled, not divided:
# classifying their quarters would cost more than it saves.  Tuned on the project's scenes: with 4,
# errors of 16 samples are up to 3 times as large.
_MAX_SAMPLED_SIDE = 3

# Maximum number of pairs of silhouettes in a pixel, divided by the number of samples per pixel: in
# pictures with more, samples in all pixels cost less than classification.  Tuned on the project's
# scenes: with half the limit, errors are up to 3 times as large; with twice the limit, the times of
# 16 samples are up to 5 times as long.
_MAX_SILHOUETTE_PAIRS = 0.006


def is_supersampling_cheaper(scene: PreparedScene, samples_per_side: int) -> bool:
    """Estimate whether uniform samples in all pixels cost less than searching for edges.

    Parameters
    ----------
    scene : PreparedScene
        The scene, prepared for the camera.
    samples_per_side : int
        Number of uniform samples along each side of a pixel.

    Returns
    -------
    is_cheaper : bool
        True if the mean number of pairs of silhouettes that cross the same pixel is large relative
        to the number of samples per pixel.
    """
    pairs_per_pixel = scene.bounds.silhouette_density(scene.frame)
    return pairs_per_pixel > _MAX_SILHOUETTE_PAIRS * samples_per_side**2


def _choose_lattices(cells: Cells) -> tuple[Lattice | None, bool, Lattice | None]:
    """Choose how to refine cells that edges cross: by lattices of samples, or by division.

    A cell is a pixel, or a square part of a pixel.  The choice depends on whether the cells are
    pixels, and on the number n of samples that are requested along each side of a cell:

    ==============  =======================================  ===========================
    cells           first step                               second step
    ==============  =======================================  ===========================
    n > 6           none                                     division into quarters
    3 < n <= 6      25 samples in cells with straight edges  division into quarters
    n <= 3, pixels  5 samples in cells with straight edges   lattice for a grid of n x n
    n <= 3, parts   13 samples in all cells                  lattice for a grid of 5 x 5
    ==============  =======================================  ===========================

    A cell is finished after the first step if its samples do not reveal an edge that was missed.
    All other cells go on to the second step.

    Parameters
    ----------
    cells : Cells
        The cells, which all have the same width.

    Returns
    -------
    first_lattice : Lattice or None
        Sample points of the first step; None if there is no first step.
    is_first_for_all : bool
        If False, the first step is only for cells that contain nothing but straight edges.
    second_lattice : Lattice or None
        Sample points of the second step; None if the cells are divided into quarters instead.
    """
    # Tuned on the project's scenes.  Without the first step, cells with 3 < n <= 6 take 1.1 times
    # as long; pixels with n <= 3 have up to 1.7 times the error; and parts of pixels with n <= 3
    # take 1.6 to 2.2 times as long.  Without the second step, such parts have up to 1.5 times the
    # error.
    if cells.samples_per_side > 2 * _MAX_SAMPLED_SIDE:
        return None, False, None
    if cells.samples_per_side > _MAX_SAMPLED_SIDE:
        return Lattice(1, 25), False, None
    if cells.width == 1:
        return Lattice(1, 5), False, Lattice.at_least(cells.samples_per_side)
    return Lattice(1, 13), True, Lattice.at_least(5)


def refine_pixels(scene: PreparedScene, rows: slice, columns: slice, per_side: int) -> Floats:
    """Compute the mean radiance of each pixel in a rectangle of the picture.

    Pixels that edges cross are divided or sampled.  The root-mean-square error is meant to be at
    most that of per_side x per_side uniform samples in each pixel.

    Parameters
    ----------
    scene : PreparedScene
        The scene, prepared for the camera.
    rows, columns : slice
        Rows and columns of the rectangle's pixels.  Neither range is empty.
    per_side : int
        Number of samples requested along each side of a pixel, at least 2.

    Returns
    -------
    mean : (rows, columns, 3) float array
        Mean linear RGB radiance of each pixel.
    """
    # Add one pixel on every side: `estimate_pixel_means` needs the neighbours of each pixel.
    top, height = rows.start - 1, rows.stop + 2 - rows.start
    first_column, width = columns.start - 1, columns.stop + 2 - columns.start
    samples = CENTERS.samples(slice(top, top + height), slice(first_column, first_column + width))
    pair_row, pair_column, object_index = find_silhouette_pixels(scene, rows, columns)
    pair_pixel = (pair_row - top) * width + pair_column - first_column
    all_pixels = np.arange(samples.size)
    tolerance = _TOLERANCE / per_side**1.5
    center_x, center_y = samples.get_positions(all_pixels)
    pixels = Cells(1.0, per_side, tolerance, center_x, center_y, pair_pixel, object_index)
    classified = classify(scene, pixels, samples, all_pixels)
    estimate = estimate_pixel_means(classified.center, width)
    is_inner = np.pad(np.ones((height - 2, width - 2), dtype=np.bool_), 1).ravel()
    is_refinable = is_inner & ~classified.is_crowded
    mean = _compute_cell_means(scene, classified, estimate, is_refinable)
    crowded_index = indices(is_inner & classified.is_crowded)
    lattice = Lattice.at_least(per_side, ratio=1)
    mean[:, crowded_index], _ = _sample_cells(scene, classified, crowded_index, lattice)
    # Some samples have negative weights, so the mean of a pixel may be less than 0.
    return np.stack([*mean.reshape(3, height, width)[:, 1:-1, 1:-1].clip(0)], axis=2)


def _compute_cell_means(
    scene: PreparedScene, classified: Classification, estimate: SmoothMeans, is_refinable: Bools
) -> Floats:
    """Compute the mean radiance of cells, and refine those that edges may cross.

    A cell is a pixel, or a square part of a pixel.  Its mean is taken from `estimate` if (1) no
    edge was found in the cell, and (2) the estimated error is at most the tolerance.  All other
    cells are sampled on a lattice or divided into quarters (see `_choose_lattices`).

    Parameters
    ----------
    scene : PreparedScene
        The scene, prepared for the camera.
    classified : Classification
        The n cells, and the edges that may cross them.
    estimate : SmoothMeans
        Estimated mean radiance of each cell, valid if no edge crosses the cell.
    is_refinable : (n,) bool array
        False for cells whose mean is taken from `estimate` in any case.

    Returns
    -------
    mean : (3, n) float array
        Mean linear RGB radiance of each cell.
    """
    cells, mean = classified.cells, estimate.radiance.copy()
    first_lattice, is_first_for_all, second_lattice = _choose_lattices(cells)
    has_lines = np.zeros(cells.center_x.size, dtype=np.bool_)
    has_lines[classified.lines.cell] = True
    # An unknown error (NaN) makes a cell neither accurate nor inaccurate.
    is_accurate, is_inaccurate = estimate.error <= cells.tolerance, estimate.error > cells.tolerance
    is_pending = is_refinable & (has_lines | classified.is_unresolved | ~is_accurate)
    if first_lattice is not None:
        has_only_lines = is_pending & has_lines & ~(classified.is_unresolved | is_inaccurate)
        sampled_index = indices(is_pending if is_first_for_all else has_only_lines)
        sampled_mean, missed_edge = _sample_cells(scene, classified, sampled_index, first_lattice)
        finished_index = sampled_index[~missed_edge]
        mean[:, finished_index], is_pending[finished_index] = sampled_mean[:, ~missed_edge], False
    pending_index = indices(is_pending)
    if second_lattice is not None:
        mean[:, pending_index], _ = _sample_cells(scene, classified, pending_index, second_lattice)
        return mean
    for batch_index in index_batches(pending_index, _cells_per_batch(scene, samples_per_cell=4)):
        mean[:, batch_index] = _refine_quarters(scene, classified, estimate.error, batch_index)
    return mean


def _cells_per_batch(scene: PreparedScene, samples_per_cell: int) -> int:
    """Choose how many cells to sample together, so that memory is limited.

    Parameters
    ----------
    scene : PreparedScene
        The scene.  If many objects overlap in the picture, fewer samples are traced together.
    samples_per_cell : int
        Number of samples in each cell (a pixel, or a square part of a pixel).

    Returns
    -------
    cell_count : int
        Number of cells, at least 1.
    """
    return max(1, scene.limit_batch(_SAMPLES_PER_BATCH) // samples_per_cell)


def _sample_cells(
    scene: PreparedScene, classified: Classification, cell_index: Ints, lattice: Lattice
) -> tuple[Floats, Bools]:
    """Estimate the mean radiance of cells from a lattice of samples in each cell.

    A cell is a pixel, or a square part of a pixel.  Lines along its edges divide it into regions.
    The weights of the samples in a region add up to the exact area of the region.

    Parameters
    ----------
    scene : PreparedScene
        The scene, prepared for the camera.
    classified : Classification
        All cells, and the lines that cross them.
    cell_index : (m,) int array
        Indices of the cells to sample, all different.
    lattice : Lattice
        The sample points, which are the same in all cells.

    Returns
    -------
    mean : (3, m) float array
        Mean linear RGB radiance of each sampled cell.
    missed_edge : (m,) bool array
        Whether an edge in the cell was missed.  This is True if two samples in the same region hit
        different faces or objects, or the same face under different lights.
    """
    cells, lines, cell_count = classified.cells, classified.lines, cell_index.size
    mean, missed_edge = np.empty((3, cell_count)), np.zeros(cell_count, dtype=np.bool_)
    for batch in index_batches(np.arange(cell_count), _cells_per_batch(scene, lattice.size)):
        index_in_batch = np.full(cells.center_x.size, -1)  # of each cell; -1 outside the batch
        index_in_batch[cell_index[batch]] = np.arange(batch.size)
        batch_lines = lines.take(indices(index_in_batch[lines.cell] >= 0))
        batch_lines = batch_lines._replace(cell=index_in_batch[batch_lines.cell])
        points = place_weighted_points(batch_lines, batch.size, lattice.points())
        x, y = cells.positions(cell_index[batch][points.cell], points.position)
        samples, order = Scattered.from_positions(x, y)
        cell, region, weight = points.cell[order], points.region[order], points.weight[order]
        radiance, sample_id = compute_radiance_and_ids(scene, samples)
        for channel_mean, channel_radiance in zip(mean, radiance, strict=True):
            channel_mean[batch] = np.bincount(cell, weight * channel_radiance, batch.size)
        missed_edge[batch[cell[find_samples_in_mixed_regions(region, sample_id)]]] = True
    return mean, missed_edge


def _refine_quarters(
    scene: PreparedScene, classified: Classification, error: Floats, cell_index: Ints
) -> Floats:
    """Divide cells into quarters, and compute the mean radiance of each cell.

    A cell is a pixel, or a square part of a pixel.  It is *unresolved* if it may contain something
    other than straight edges.  A cell whose quarters are all unresolved, with no straight edge in
    any of them, may turn out to have no edge at all.  Such a cell is sampled on a lattice.  If (1)
    the samples show no edge, and (2) the mean of the lattice agrees with the mean of the quarters'
    centre samples, then the mean of the lattice is used, and the quarters are not refined.

    Parameters
    ----------
    scene : PreparedScene
        The scene, prepared for the camera.
    classified : Classification
        All n cells, and the edges that may cross them.
    error : (n,) float array
        Estimated error of each cell's mean radiance, if no edge crosses the cell; NaN if unknown.
    cell_index : (m,) int array
        Indices of the cells to divide, all different.

    Returns
    -------
    mean : (3, m) float array
        Mean linear RGB radiance of each divided cell.
    """
    count, tolerance = cell_index.size, classified.cells.tolerance
    quarters = classified.cells.quarters(cell_index)
    samples, order = Scattered.from_positions(quarters.center_x, quarters.center_y)
    classified_quarters = classify(scene, quarters, samples, order)
    center, quarter_center = classified.center.take(cell_index), classified_quarters.center
    estimate = estimate_quarter_means(center, error[cell_index], quarter_center, tolerance)
    is_unresolved = classified_quarters.is_unresolved.reshape(count, 4).all(axis=1)
    line_count = np.bincount(classified_quarters.lines.cell // 4, minlength=count)
    tested_index = indices(is_unresolved & (line_count == 0))
    lattice = Lattice.at_least(classified.cells.samples_per_side, ratio=1)
    sampled_mean, missed_edge = _sample_cells(scene, classified, cell_index[tested_index], lattice)
    expected_mean = estimate.radiance.reshape(3, count, 4).take(tested_index, axis=1).mean(axis=2)
    is_confirmed = ~missed_edge & (np.abs(sampled_mean - expected_mean).max(axis=0) <= tolerance)
    is_smooth = np.zeros(count, dtype=np.bool_)
    is_smooth[tested_index[is_confirmed]] = True
    is_refinable = ~is_smooth.repeat(4)
    quarter_mean = _compute_cell_means(scene, classified_quarters, estimate, is_refinable)
    mean: Floats = quarter_mean.reshape(3, count, 4).mean(axis=2)
    mean[:, is_smooth] = sampled_mean[:, is_confirmed]
    return mean
