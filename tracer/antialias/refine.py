"""Antialiasing by adaptive subdivision (Whitted 1980): compute the mean radiance of each pixel.

A *cell* is a pixel or a square part of a pixel.  `classify_cells` traces the sample through the
center of each cell, and finds the edges that may cross the cell (see `classify`).  These decide how
the mean radiance of the cell is computed:

1. A *smooth* cell, which no edge crosses, shows one face under the same lights.  Its center sample,
   corrected for the curvature of the radiance, is as accurate as a grid of samples.
2. If few samples are requested in a cell that only straight lines cross, it is sampled on a
   lattice, because sampling then costs less than subdivision.  The lines divide the cell into
   regions; the samples in a region together represent its exact area.  If samples in one region hit
   different faces, or the same face under different lights, then an edge was missed, and the cell
   is divided after all.
3. All other cells are divided into quarters, down to a smallest size.  Cells of this size are
   sampled, and sampled again on a finer lattice if the first samples show that an edge was missed.
4. *Crowded* pixels, in which finding all edges would take longer than dense sampling, are
   sampled immediately.  So are all pixels of a picture that is full of edges: see
   `is_supersampling_cheaper`.

How a cell that edges cross is refined depends on the number n of samples that are requested along
each of its sides, and on whether it is a pixel or a part of one (see `_choose_steps`).  A cell goes
on to the second step if the first step does not apply to it, or shows that an edge was missed:

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

from math import floor
from typing import Annotated as Shaped
from typing import NamedTuple

import numpy as np

from tracer.antialias.cells import Cells
from tracer.antialias.classify import Classification, classify_cells
from tracer.antialias.edge_functions import Lines
from tracer.antialias.lattice import PIXEL_CENTERS, Lattice
from tracer.antialias.regions import find_samples_in_mixed_regions, place_weighted_points
from tracer.antialias.silhouette_pixels import PixelObjects, find_silhouette_pixels
from tracer.antialias.smooth import SmoothMeans, estimate_pixel_means, estimate_quarter_means
from tracer.arrays import BATCH_SIZE, Bools, Floats, Ints, find, split_indices
from tracer.trace.radiance import compute_radiance_and_visibility
from tracer.trace.samples import Rows, Scattered
from tracer.world.prepared_scene import PreparedScene

# Maximum number of samples that are traced together in cells that edges cross.  It limits memory.
_SAMPLES_PER_BATCH = BATCH_SIZE

# Maximum error of the mean radiance of a cell if one sample per pixel is requested.  If n x n are
# requested, the limit is divided by n^(3/2), because the error of a grid decreases at this rate.
# Tuned on the project's scenes: with twice the limit, errors of 4 samples are up to twice as large;
# with half the limit, 64 samples take up to 1.4 times as long.
_TOLERANCE = 8e-3

# Cells in which at most this many samples along each side are requested are sampled, not divided,
# because classifying their quarters would cost more than it saves.  Tuned on the project's scenes:
# with 4, errors of 16 samples are up to 3 times as large.
_MAX_SAMPLED_SIDE = 3

# If a pixel has more than this many pairs of silhouettes for each sample per pixel, then samples in
# all pixels cost less than classification.  Tuned on the project's scenes: with half the limit,
# errors are up to 3 times as large; with twice the limit, the times of 16 samples are up to 5 times
# as long.
_MAX_PAIRS_PER_SAMPLE = 0.006


def is_supersampling_cheaper(scene: PreparedScene, samples_per_side: int) -> bool:
    """Estimate whether sampling all pixels on a grid takes less time than searching for edges.

    The grid has `samples_per_side` samples along each side of a pixel.  The time of the search
    grows with the number of pairs of silhouettes that cross the same pixel.
    """
    pairs_per_pixel = scene.bounds.estimate_silhouette_pairs(scene.frame)
    return pairs_per_pixel > _MAX_PAIRS_PER_SAMPLE * samples_per_side**2


class _Steps(NamedTuple):
    """How to refine cells that edges cross: a row of the table in this module's docstring."""

    first_lattice: Lattice | None = None  # None: there is no first step
    # Whether the first step includes cells that may contain something other than straight edges.
    includes_unresolved: bool = False
    second_lattice: Lattice | None = None  # None: the second step divides cells into quarters


def _choose_steps(cells: Cells) -> _Steps:
    """Choose how to refine cells that edges cross, from their width and the samples requested."""
    # All times and errors in this function were measured on the project's scenes.
    if cells.samples_per_side > 2 * _MAX_SAMPLED_SIDE:
        return _Steps()
    if cells.samples_per_side > _MAX_SAMPLED_SIDE:
        # Without the first step, the time is 1.1 times as long.
        return _Steps(first_lattice=Lattice(1, 25))
    if cells.width == 1:
        # Without the first step, boxes take up to 1.1 times as long.
        grid_lattice = Lattice.choose(cells.samples_per_side)
        return _Steps(first_lattice=Lattice(1, 5), second_lattice=grid_lattice)
    # Without the first step, such cells take 1.6 to 2.2 times as long.  Without the second step,
    # their errors are up to 1.5 times as large.
    return _Steps(
        first_lattice=Lattice(1, 13), includes_unresolved=True, second_lattice=Lattice.choose(5)
    )


def average_pixels(
    scene: PreparedScene, rows: slice, columns: slice, grid_side: int
) -> Shaped[Floats, "height width 3"]:
    """Compute the mean linear RGB radiance of each pixel in a rectangle that is not empty.

    The aim is an RMS error no larger than that of a uniform grid of `grid_side` x `grid_side`
    samples in each pixel; `grid_side` is at least 2.
    """
    # Add a border of one pixel: `estimate_pixel_means` needs the neighbours of each pixel.
    samples = PIXEL_CENTERS.place_in_pixels(
        slice(rows.start - 1, rows.stop + 1), slice(columns.start - 1, columns.stop + 1)
    )
    height = samples.y.size
    width = samples.x.size
    pixels = _make_pixel_cells(samples, grid_side, find_silhouette_pixels(scene, rows, columns))
    classification = classify_cells(scene, pixels, samples, np.arange(samples.size))
    estimate = estimate_pixel_means(classification.center_samples, width)
    is_inner = np.pad(np.ones((height - 2, width - 2), dtype=np.bool_), 1).ravel()
    is_refinable = is_inner & ~classification.is_crowded
    pixel_mean = _compute_cell_means(scene, classification, estimate, is_refinable)
    # Sample crowded pixels immediately.
    crowded_index = find(is_inner & classification.is_crowded)
    dense_lattice = Lattice.choose(grid_side, min_ratio=1)
    crowded = _sample_cells(scene, classification, crowded_index, dense_lattice)
    pixel_mean[:, crowded_index] = crowded.mean
    inner_mean = pixel_mean.reshape(3, height, width)[:, 1:-1, 1:-1]
    # Some samples have negative weights, so the mean of a pixel may be less than 0.
    return np.stack([*inner_mean.clip(0)], axis=2)


def _make_pixel_cells(samples: Rows, grid_side: int, pairs: PixelObjects) -> Cells:
    """Make a cell of each pixel, in the order of `samples`, which are the centers of the pixels.

    The result should be as accurate as a grid of `grid_side` x `grid_side` samples in each pixel.
    `pairs` contains the objects whose silhouettes may cross each pixel.
    """
    center_x, center_y = samples.get_positions(np.arange(samples.size))
    # The center of a pixel is half a pixel from its upper and left edges.
    row = pairs.row - floor(samples.y[0])
    column = pairs.column - floor(samples.x[0])
    return Cells(
        width=1.0,
        samples_per_side=grid_side,
        tolerance=_TOLERANCE / grid_side**1.5,
        center_x=center_x,
        center_y=center_y,
        pair_cell_index=row * samples.x.size + column,
        pair_object_index=pairs.object_index,
    )


def _compute_cell_means(
    scene: PreparedScene,
    classification: Classification,
    estimate: SmoothMeans,
    is_refinable: Shaped[Bools, "cells"],
) -> Shaped[Floats, "3 cells"]:
    """Compute the mean radiance of cells; sample or divide those that edges may cross.

    A cell keeps its estimated mean if no edge may cross it and the estimated error is within the
    tolerance.  A cell that is not refinable keeps its estimated mean in any case.
    """
    cells = classification.cells
    cell_mean = estimate.radiance.copy()
    pending = _find_pending_cells(classification, estimate.error)
    is_pending = is_refinable & pending.is_pending
    steps = _choose_steps(cells)
    if steps.first_lattice is not None:
        is_in_first_step = is_pending
        if not steps.includes_unresolved:
            is_in_first_step = is_pending & pending.has_only_lines
        first_index = find(is_in_first_step)
        sampled = _sample_cells(scene, classification, first_index, steps.first_lattice)
        finished_index = first_index[~sampled.misses_edge]
        cell_mean[:, finished_index] = sampled.mean[:, ~sampled.misses_edge]
        is_pending[finished_index] = False
    second_index = find(is_pending)
    if steps.second_lattice is not None:
        sampled = _sample_cells(scene, classification, second_index, steps.second_lattice)
        cell_mean[:, second_index] = sampled.mean
    else:
        for batch in split_indices(second_index, _choose_batch_size(scene, samples_per_cell=4)):
            cell_mean[:, batch] = _divide_and_average(scene, classification, estimate.error, batch)
    return cell_mean


class _PendingCells(NamedTuple):
    """Which cells must be sampled or divided."""

    is_pending: Shaped[Bools, "cells"]  # the cell must be sampled or divided
    has_only_lines: Shaped[Bools, "cells"]  # it has lines, and no other reason is known


def _find_pending_cells(
    classification: Classification, error: Shaped[Floats, "cells"]
) -> _PendingCells:
    """Find cells that edges may cross, or whose estimated error is too large or unknown (NaN)."""
    has_lines = np.zeros(error.size, dtype=np.bool_)
    has_lines[classification.lines.cell_index] = True
    # If the error is unknown, both are False.
    is_accurate = error <= classification.cells.tolerance
    is_inaccurate = error > classification.cells.tolerance
    is_unresolved = classification.is_unresolved
    return _PendingCells(
        is_pending=has_lines | is_unresolved | ~is_accurate,
        has_only_lines=has_lines & ~(is_unresolved | is_inaccurate),
    )


def _choose_batch_size(scene: PreparedScene, samples_per_cell: int) -> int:
    """Choose how many cells, at least 1, to sample in one batch, so that memory is limited.

    If many of the scene's objects overlap in the picture, fewer cells are sampled together.
    """
    return max(1, scene.choose_batch_size(_SAMPLES_PER_BATCH) // samples_per_cell)


class _SampledCells(NamedTuple):
    """What lattices of samples show in n cells."""

    mean: Shaped[Floats, "3 n"]  # linear RGB radiance
    # Whether samples in one of the regions between the cell's lines have different ids.  Then the
    # lines miss an edge.
    misses_edge: Shaped[Bools, "n"]


def _sample_cells(
    scene: PreparedScene,
    classification: Classification,
    cell_index: Shaped[Ints, "n"],
    lattice: Lattice,
) -> _SampledCells:
    """Estimate the mean radiance of the given cells from a lattice of samples in each.

    Lines divide a cell into regions, and the samples in a region are weighted by its area.
    `cell_index` must be in ascending order, and must not contain duplicates.
    """
    cell_count = cell_index.size
    sampled = _SampledCells(
        mean=np.empty((3, cell_count)), misses_edge=np.empty(cell_count, dtype=np.bool_)
    )
    for batch in split_indices(np.arange(cell_count), _choose_batch_size(scene, lattice.size)):
        batch_sampled = _sample_batch(scene, classification, cell_index[batch], lattice)
        sampled.mean[:, batch] = batch_sampled.mean
        sampled.misses_edge[batch] = batch_sampled.misses_edge
    return sampled


def _sample_batch(
    scene: PreparedScene,
    classification: Classification,
    cell_index: Shaped[Ints, "n"],
    lattice: Lattice,
) -> _SampledCells:
    """Do what `_sample_cells` does, for cells whose samples are traced together."""
    lines = _select_lines(classification, cell_index)
    points = place_weighted_points(lines, cell_index.size, lattice.list_points())
    x, y = classification.cells.to_picture(cell_index[points.cell_index], points.position)
    # Below, arrays of samples are in the order in which `Scattered` sorts them.
    samples, order = Scattered.from_positions(x, y)
    radiance, sample_id = compute_radiance_and_visibility(scene, samples)
    index_in_batch = points.cell_index[order]
    weight = points.weight[order]
    mean = np.empty((3, cell_index.size))
    for channel in range(3):
        mean[channel] = np.bincount(index_in_batch, weight * radiance[channel], cell_index.size)
    mixed_index = find_samples_in_mixed_regions(points.region_index[order], sample_id)
    misses_edge = np.zeros(cell_index.size, dtype=np.bool_)
    misses_edge[index_in_batch[mixed_index]] = True
    return _SampledCells(mean=mean, misses_edge=misses_edge)


def _select_lines(classification: Classification, cell_index: Shaped[Ints, "n"]) -> Lines:
    """Select the lines of the given cells, and renumber the cells from 0 to n - 1 in this order.

    `cell_index` must be in ascending order, and must not contain duplicates.
    """
    lines = classification.lines
    # For each cell, its number in the result; -1 if the cell is not selected.
    new_index = np.full(classification.cells.center_x.size, -1)
    new_index[cell_index] = np.arange(cell_index.size)
    line_cell_index = new_index[lines.cell_index]
    selected = find(line_cell_index >= 0)
    return lines.take(selected)._replace(cell_index=line_cell_index[selected])


def _divide_and_average(
    scene: PreparedScene,
    classification: Classification,
    error: Shaped[Floats, "cells"],
    cell_index: Shaped[Ints, "n"],
) -> Shaped[Floats, "3 n"]:
    """Compute the mean radiance of the given cells from that of their quarters.

    `cell_index` must not contain duplicates.  `error` is the estimated error of the mean radiance
    of each classified cell; NaN if it is unknown.
    """
    quarters = classification.cells.divide(cell_index)
    samples, order = Scattered.from_positions(quarters.center_x, quarters.center_y)
    classified_quarters = classify_cells(scene, quarters, samples, order)
    estimate = estimate_quarter_means(
        classification.center_samples.take(cell_index),
        error[cell_index],
        classified_quarters.center_samples,
        quarters.tolerance,
    )
    is_refinable = np.ones(order.size, dtype=np.bool_)
    quarter_mean = _compute_cell_means(scene, classified_quarters, estimate, is_refinable)
    return np.asarray(quarter_mean.reshape(3, -1, 4).mean(axis=2))
