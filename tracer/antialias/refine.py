"""Antialiasing by adaptive subdivision (Whitted 1980): compute the mean radiance of each pixel.

A *cell* is a pixel or a square part of a pixel.  Its *center sample* is traced through its centre.
`classify_cells` traces the center samples, and finds the edges that may cross each cell.
These decide how the mean radiance of the cell is computed:

1. A *smooth* cell shows one face under the same lights.  Its center sample, corrected for the
   curvature of the radiance, is as accurate as a grid of samples.
2. A cell that is crossed only by straight lines is sampled on a lattice if few samples are
   requested in it, because sampling then costs less than subdivision.  The lines divide the cell
   into regions; the samples in a region together represent its exact area.  If samples in one
   region hit different faces, or the same face under different lights, then an edge was missed,
   and the cell is divided after all.
3. All other cells are divided into quarters, down to a smallest size.  Cells of this size are
   sampled, and sampled again on a finer lattice if the first samples show that an edge was
   missed.  The table below lists the lattices.  If all quarters of a cell are *unresolved* (they
   may contain something other than straight edges), a lattice of samples tests whether the cell
   is smooth nevertheless.
4. *Crowded* pixels, in which finding all edges would take longer than dense sampling, are
   sampled immediately.  So are all pixels of a picture that is full of edges: see
   `is_supersampling_cheaper`.

How a cell that edges cross is refined depends on the number n of samples that are requested along
each of its sides, and on whether it is a pixel or a part of one (`_choose_lattices`).  A cell goes
on to the second step unless the samples of the first step show that no edge was missed:

==============  =======================================  ===========================
cells           first step                               second step
==============  =======================================  ===========================
n > 6           none                                     division into quarters
3 < n <= 6      25 samples in cells with straight edges  division into quarters
n <= 3, pixels  5 samples in cells with straight edges   lattice for a grid of n x n
n <= 3, parts   13 samples in all cells                  lattice for a grid of 5 x 5
==============  =======================================  ===========================

Whitted, An improved illumination model for shaded display, Communications of the ACM 23, 1980.
"""

from __future__ import annotations

import numpy as np

from tracer.antialias.classify import Cells, Classification, classify_cells
from tracer.antialias.edges import find_silhouette_pixels
from tracer.antialias.lattice import PIXEL_CENTERS, Lattice
from tracer.antialias.regions import find_samples_in_mixed_regions, place_weighted_points
from tracer.antialias.smooth import SmoothMeans, estimate_pixel_means, estimate_quarter_means
from tracer.arrays import BATCH_SIZE, Bools, Floats, Ints, find, split_indices
from tracer.trace.radiance import compute_radiance_and_visibility
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
_MAX_PAIRS_PER_SAMPLE = 0.006


def is_supersampling_cheaper(scene: PreparedScene, samples_per_side: int) -> bool:
    """Estimate whether sampling all pixels uniformly is cheaper than searching for edges.

    Parameters
    ----------
    scene : PreparedScene
        The scene, prepared for the camera.
    samples_per_side : int
        Number of uniform samples along each side of a pixel.

    Returns
    -------
    is_cheaper : bool
        Whether uniform samples are cheaper.  The cost of the search grows with the number of pairs
        of silhouettes that cross the same pixel.
    """
    pairs_per_pixel = scene.bounds.estimate_silhouette_pairs(scene.frame)
    return pairs_per_pixel > _MAX_PAIRS_PER_SAMPLE * samples_per_side**2


def _choose_lattices(cells: Cells) -> tuple[Lattice | None, bool, Lattice | None]:
    """Choose how to refine cells that edges cross.

    A cell is a pixel, or a square part of a pixel.  It is refined in up to two steps.  The first
    step samples the cell on a lattice.  If the samples reveal an edge that was missed, the second
    step samples the cell on another lattice, or divides it into quarters.

    Parameters
    ----------
    cells : Cells
        The cells, which all have the same width.

    Returns
    -------
    first_lattice : Lattice or None
        Sample points of the first step; None if there is no first step.
    includes_unresolved : bool
        Whether the first step includes cells that may contain something other than straight edges.
    second_lattice : Lattice or None
        Sample points of the second step; None if it divides cells into quarters instead.
    """
    # Tuned on the project's scenes.
    if cells.samples_per_side > 2 * _MAX_SAMPLED_SIDE:
        return None, False, None
    if cells.samples_per_side > _MAX_SAMPLED_SIDE:
        return Lattice(1, 25), False, None  # Without the first step, the time is 1.1 times as long.
    if cells.width == 1:  # Without the first step, errors are up to 1.7 times as large.
        return Lattice(1, 5), False, Lattice.choose(cells.samples_per_side)
    # Without the first step, such cells take 1.6 to 2.2 times as long.  Without the second step,
    # their errors are up to 1.5 times as large.
    return Lattice(1, 13), True, Lattice.choose(5)


def average_pixels(scene: PreparedScene, rows: slice, columns: slice, grid_side: int) -> Floats:
    """Compute the mean radiance of each pixel in a rectangle of the picture.

    The aim is an RMS error no larger than that of a uniform grid of samples in each pixel.

    Parameters
    ----------
    scene : PreparedScene
        The scene, prepared for the camera.
    rows, columns : slice
        Rows and columns of the rectangle's pixels.  Neither range is empty.
    grid_side : int
        Number of samples along each side of the uniform grid, at least 2.

    Returns
    -------
    pixel_mean : (rows, columns, 3) float array
        Mean linear RGB radiance of each pixel.
    """
    # Add a border of one pixel: `estimate_pixel_means` needs the neighbours of each pixel.
    first_row, first_column = rows.start - 1, columns.start - 1
    bordered_columns = slice(first_column, columns.stop + 1)
    samples = PIXEL_CENTERS.place_in_pixels(slice(first_row, rows.stop + 1), bordered_columns)
    height, width = samples.y.size, samples.x.size
    pair_row, pair_column, pair_object = find_silhouette_pixels(scene, rows, columns)
    pair_pixel = (pair_row - first_row) * width + pair_column - first_column
    pixel_index = np.arange(samples.size)
    tolerance = _TOLERANCE / grid_side**1.5
    center_x, center_y = samples.get_positions(pixel_index)
    pixels = Cells(1.0, grid_side, tolerance, center_x, center_y, pair_pixel, pair_object)
    classification = classify_cells(scene, pixels, samples, pixel_index)
    estimate = estimate_pixel_means(classification.center_samples, width)
    is_inner = np.pad(np.ones((height - 2, width - 2), dtype=np.bool_), 1).ravel()
    is_refinable = is_inner & ~classification.is_crowded
    pixel_mean = _compute_cell_means(scene, classification, estimate, is_refinable)
    crowded_index = find(is_inner & classification.is_crowded)
    lattice = Lattice.choose(grid_side, min_ratio=1)
    pixel_mean[:, crowded_index], _ = _sample_cells(scene, classification, crowded_index, lattice)
    # Some samples have negative weights, so the mean of a pixel may be less than 0.
    return np.stack([*pixel_mean.reshape(3, height, width)[:, 1:-1, 1:-1].clip(0)], axis=2)


def _compute_cell_means(
    scene: PreparedScene, classification: Classification, estimate: SmoothMeans, is_refinable: Bools
) -> Floats:
    """Compute the mean radiance of cells, refining the cells that edges may cross.

    A cell is a pixel, or a square part of a pixel.  A cell without edges keeps its estimated mean
    if the estimated error is within the tolerance.  All other cells are sampled on a lattice or
    divided into quarters.

    Parameters
    ----------
    scene : PreparedScene
        The scene, prepared for the camera.
    classification : Classification
        The n cells, and the edges that may cross them.
    estimate : SmoothMeans
        Estimated mean radiance of each cell, valid if no edge crosses the cell.
    is_refinable : (n,) bool array
        Whether the cell may be refined.  All other cells keep their estimated mean.

    Returns
    -------
    cell_mean : (3, n) float array
        Mean linear RGB radiance of each cell.
    """
    cells, cell_mean = classification.cells, estimate.radiance.copy()
    first_lattice, includes_unresolved, second_lattice = _choose_lattices(cells)
    has_lines = np.zeros(cells.center_x.size, dtype=np.bool_)
    has_lines[classification.lines.cell_index] = True
    # If the error is unknown (NaN), both are False.
    is_accurate, is_inaccurate = estimate.error <= cells.tolerance, estimate.error > cells.tolerance
    is_pending = is_refinable & (has_lines | classification.is_unresolved | ~is_accurate)
    if first_lattice is not None:
        has_only_lines = is_pending & has_lines & ~(classification.is_unresolved | is_inaccurate)
        cell_index = find(is_pending if includes_unresolved else has_only_lines)
        sampled_mean, misses_edge = _sample_cells(scene, classification, cell_index, first_lattice)
        finished_index = cell_index[~misses_edge]
        cell_mean[:, finished_index] = sampled_mean[:, ~misses_edge]
        is_pending[finished_index] = False
    pending_index = find(is_pending)
    if second_lattice is not None:
        sampled_mean, _ = _sample_cells(scene, classification, pending_index, second_lattice)
        cell_mean[:, pending_index] = sampled_mean
        return cell_mean
    for batch in split_indices(pending_index, _choose_batch_size(scene, samples_per_cell=4)):
        cell_mean[:, batch] = _divide_and_average(scene, classification, estimate.error, batch)
    return cell_mean


def _choose_batch_size(scene: PreparedScene, samples_per_cell: int) -> int:
    """Choose how many cells to sample in one batch, to limit memory use.

    Parameters
    ----------
    scene : PreparedScene
        The scene.  If many of its objects overlap in the picture, fewer cells are sampled together.
    samples_per_cell : int
        Number of samples in each cell (a pixel, or a square part of a pixel).

    Returns
    -------
    cell_count : int
        Number of cells, at least 1.
    """
    return max(1, scene.choose_batch_size(_SAMPLES_PER_BATCH) // samples_per_cell)


def _sample_cells(
    scene: PreparedScene, classification: Classification, cell_index: Ints, lattice: Lattice
) -> tuple[Floats, Bools]:
    """Estimate the mean radiance of cells from a lattice of samples in each cell.

    A cell is a pixel, or a square part of a pixel.  Straight lines, which represent edges, divide
    it into regions.  The samples in a region are weighted by the area of the region.

    Parameters
    ----------
    scene : PreparedScene
        The scene, prepared for the camera.
    classification : Classification
        All cells, and the lines that cross them.
    cell_index : (m,) int array
        Indices of the cells to sample, all different.
    lattice : Lattice
        The sample points, which are the same in all cells.

    Returns
    -------
    cell_mean : (3, m) float array
        Mean linear RGB radiance of each sampled cell.
    misses_edge : (m,) bool array
        Whether the lines of the cell miss an edge.  This is the case if samples in the same region
        hit different faces, or the same face under different lights.
    """
    cells, lines, cell_count = classification.cells, classification.lines, cell_index.size
    cell_mean, misses_edge = np.empty((3, cell_count)), np.zeros(cell_count, dtype=np.bool_)
    for batch in split_indices(np.arange(cell_count), _choose_batch_size(scene, lattice.size)):
        index_in_batch = np.full(cells.center_x.size, -1)  # of each cell; -1 outside the batch
        index_in_batch[cell_index[batch]] = np.arange(batch.size)
        batch_lines = lines.take(find(index_in_batch[lines.cell_index] >= 0))
        batch_lines = batch_lines._replace(cell_index=index_in_batch[batch_lines.cell_index])
        points = place_weighted_points(batch_lines, batch.size, lattice.list_points())
        x, y = cells.to_picture(cell_index[batch][points.cell_index], points.position)
        samples, order = Scattered.from_positions(x, y)
        local_index, weight = points.cell_index[order], points.weight[order]
        radiance, sample_id = compute_radiance_and_visibility(scene, samples)
        for channel_mean, channel_radiance in zip(cell_mean, radiance, strict=True):
            channel_mean[batch] = np.bincount(local_index, weight * channel_radiance, batch.size)
        mixed_index = find_samples_in_mixed_regions(points.region_index[order], sample_id)
        misses_edge[batch[local_index[mixed_index]]] = True
    return cell_mean, misses_edge


def _divide_and_average(
    scene: PreparedScene, classification: Classification, error: Floats, cell_index: Ints
) -> Floats:
    """Divide cells into quarters, and average the mean radiance of the quarters of each cell.

    A cell is a pixel, or a square part of a pixel.  If no quarter contains a straight edge, but all
    may contain something else, the cell may still be smooth.  So it is also sampled on a lattice.
    If the samples confirm that it is smooth, their mean is used.

    Parameters
    ----------
    scene : PreparedScene
        The scene, prepared for the camera.
    classification : Classification
        All n cells, and the edges that may cross them.
    error : (n,) float array
        Estimated error of each cell's mean radiance, if no edge crosses the cell; NaN if unknown.
    cell_index : (m,) int array
        Indices of the cells to divide, all different.

    Returns
    -------
    cell_mean : (3, m) float array
        Mean linear RGB radiance of each divided cell.
    """
    cell_count, tolerance = cell_index.size, classification.cells.tolerance
    quarters = classification.cells.divide(cell_index)
    samples, order = Scattered.from_positions(quarters.center_x, quarters.center_y)
    classified_quarters = classify_cells(scene, quarters, samples, order)
    parent_samples = classification.center_samples.take(cell_index)
    quarter_samples = classified_quarters.center_samples
    estimate = estimate_quarter_means(parent_samples, error[cell_index], quarter_samples, tolerance)
    is_all_unresolved = classified_quarters.is_unresolved.reshape(cell_count, 4).all(axis=1)
    line_count = np.bincount(classified_quarters.lines.cell_index // 4, minlength=cell_count)
    tested_index = find(is_all_unresolved & (line_count == 0))
    tested_cell = cell_index[tested_index]
    lattice = Lattice.choose(classification.cells.samples_per_side, min_ratio=1)
    sampled_mean, misses_edge = _sample_cells(scene, classification, tested_cell, lattice)
    expected_mean = estimate.radiance.reshape(3, -1, 4).take(tested_index, axis=1).mean(axis=2)
    is_confirmed = ~misses_edge & (np.abs(sampled_mean - expected_mean).max(axis=0) <= tolerance)
    is_smooth = np.zeros(cell_count, dtype=np.bool_)
    is_smooth[tested_index[is_confirmed]] = True
    quarter_mean = _compute_cell_means(scene, classified_quarters, estimate, ~is_smooth.repeat(4))
    cell_mean: Floats = quarter_mean.reshape(3, cell_count, 4).mean(axis=2)
    cell_mean[:, is_smooth] = sampled_mean[:, is_confirmed]
    return cell_mean
