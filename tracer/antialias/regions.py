"""Divide cells by straight lines into regions, and find the points that represent each region.

A cell is a pixel or a square part of a pixel.  Points are spread evenly over it.  The points in a
region together represent the exact area of the region (post-stratification: Cochran, Sampling
Techniques, 1977, ch. 5A).  Their weights are such that their weighted mean is the centroid of the
region.  So a function that is linear in each region has the exact mean.

Each line is extended across the whole cell.  If the edge that it represents ends within the cell,
then one region is divided into two, which does no harm.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tracer.antialias.edge_functions import Lines
from tracer.antialias.lattice import Points2D
from tracer.arrays import Bools, Floats, Ints, indices

# Regions with at most this fraction of the cell's area are ignored if they contain too few points.
# They change the mean radiance of a cell by at most this fraction of the largest radiance.
_MIN_AREA = 1e-9

# The points in a region represent it if the determinant of their covariance, in widths of the cell,
# is more than this.  It is 0 for one or two points, or points in a row, and 1 / (27 m^2) for three
# neighbouring points of a lattice with m points: 9e-6 for 65 points.
_MIN_DETERMINANT = 1e-6


class Points(NamedTuple):
    """Weighted points in regions of cells.

    Attributes
    ----------
    cell : (n,) int array
        The cell of each point.
    point : (n,) complex array
        Position x + iy of each point relative to the centre of its cell, in widths of the cell: x
        and y are between -1/2 and 1/2.
    weight : (n,) float array
        The part of the cell's area that each point represents; negative for a few points.
    region : (n,) int array
        Number of the region that contains each point; different for regions of different cells.
    """

    cell: Ints
    point: Points2D
    weight: Floats
    region: Ints


def stratified(lines: Lines, cell_count: int, points: Points2D) -> Points:
    """Place points in cells, and weight them so that they represent the regions of the cells.

    Parameters
    ----------
    lines : Lines
        Lines that divide the cells into regions, sorted by cell.
    cell_count : int
        Number of cells.
    points : (m,) complex array
        Positions of the points, the same in all cells.

    Returns
    -------
    weighted : Points
        The m points of the first cell, then those of the second cell, and so on.  At the end follow
        points for regions that contain too few of these points: the centroids of triangles into
        which the region is divided.
    """
    cell, line_start = np.arange(cell_count), lines.cell.searchsorted(np.arange(cell_count + 1))
    max_lines = int(np.diff(line_start).max(initial=0))
    # The number of a region has one bit for each line of its cell: 1 on the line's positive side.
    point: Points2D = np.repeat(points[:, None], cell_count, axis=1)
    region = np.repeat(cell[None] << max_lines, points.size, axis=0)
    for bit in range(max_lines):
        index, values = _line_values(lines, line_start, bit, cell, point)
        region[:, index] |= (values > 0) << bit
    point, region = point.T.ravel(), region.T.ravel()
    triangles = _triangles(lines, line_start, max_lines)
    weight, is_represented = _weights(point, region, triangles, cell_count << max_lines)
    needed = indices(~is_represented[triangles.region] & (triangles.weight > _MIN_AREA))
    spread = Points(cell.repeat(points.size), point, weight, region)
    return Points(*(np.append(a, b[needed]) for a, b in zip(spread, triangles, strict=True)))


def mixed_regions(region: Ints, sample_id: Ints) -> Ints:
    """Find regions that contain different ids, which shows that an edge was missed.

    Parameters
    ----------
    region : (n,) int array
        Number of the region of each sample.
    sample_id : (n,) int array
        Id of each sample.  Two samples have the same id if they hit the same face of the same
        object, and the same lights reach both hits.

    Returns
    -------
    index : (k,) int array
        Indices of samples, at least one for each region with different ids.
    """
    any_id = np.empty(int(region.max(initial=0)) + 1, dtype=np.intp)
    any_id[region] = sample_id
    return indices(any_id[region] != sample_id)


def _line_values(
    lines: Lines, line_start: Ints, bit: int, cell: Ints, point: Points2D
) -> tuple[Ints, Floats]:
    """Evaluate one line of each cell at points in the cell.

    Parameters
    ----------
    lines : Lines
        All lines, sorted by cell.
    line_start : (cells + 1,) int array
        Index of the first line of each cell.
    bit : int
        Number of the line among the lines of its cell.
    cell : (n,) int array
        Cells; cells with at most `bit` lines are skipped.
    point : (m, n) complex array
        m points in each of these cells.

    Returns
    -------
    index : (k,) int array
        Indices into `cell` of the cells that are not skipped.
    values : (m, k) float array
        Value c + a x + b y of the line at each point in these cells.
    """
    line = line_start[cell] + bit
    index = indices(line < line_start[cell + 1])
    cell_line, cell_point = lines.take(line[index]), point[:, index]
    return index, cell_line.a * cell_point.real + cell_line.b * cell_point.imag + cell_line.c


def _triangles(lines: Lines, line_start: Ints, max_lines: int) -> Points:
    """Divide cells into triangles along their lines.

    Parameters
    ----------
    lines : Lines
        All lines, sorted by cell.
    line_start : (cells + 1,) int array
        Index of the first line of each cell.
    max_lines : int
        Maximum number of lines in a cell.

    Returns
    -------
    triangles : Points
        The centroids of the triangles, each weighted by the area of its triangle.
    """
    cell = np.arange(line_start.size - 1).repeat(2)
    region = cell << max_lines
    square = np.array([-1 - 1j, 1 - 1j, 1 + 1j, -1 + 1j]) / 2
    corner: Points2D = np.tile(square[[[0, 0], [1, 2], [2, 3]]], line_start.size - 1)
    for bit in range(max_lines):
        index, values = _line_values(lines, line_start, bit, cell, corner)
        is_above = values > 0
        above_count = is_above.sum(axis=0)
        region[index[above_count == 3]] |= 1 << bit
        cut = indices((above_count == 1) | (above_count == 2))
        # Rotate the corners so that the first corner is the one that is alone on its side.
        is_first_above, index = above_count[cut] == 1, index[cut]
        first = np.argmax(is_above[:, cut] == is_first_above, axis=0)
        order = (first + np.arange(3)[:, None]) % 3
        (a, b, c), (a_value, b_value, c_value) = corner[order, index], values[order, cut]
        # The line cuts the sides from a to b and from a to c in these points.
        p = a + a_value / (a_value - b_value) * (b - a)
        q = a + a_value / (a_value - c_value) * (c - a)
        corner[:, index] = a, p, q
        corner = np.concatenate([corner, (p, b, c), (p, c, q)], axis=1)
        parent = region[index]
        region[index] = parent | is_first_above << bit
        region = np.concatenate([region, *[parent | ~is_first_above << bit] * 2])
        cell = np.concatenate([cell, cell[index], cell[index]])
    u, v = corner[1] - corner[0], corner[2] - corner[0]
    # No product of complex numbers: NumPy rounds it differently at the end of an array.
    area = np.abs(u.real * v.imag - u.imag * v.real) / 2
    return Points(cell, corner.sum(axis=0) / 3, area, region)


def _weights(
    point: Points2D, region: Ints, triangles: Points, region_count: int
) -> tuple[Floats, Bools]:
    """Compute weights for points so that the points in each region represent it.

    Let p be a point, q the mean of all points in its region, and S their covariance.  The weights
    w (1 + t . (p - q)) have the weighted mean q + S t if w is the area of the region divided by the
    number of points.  With t = S^-1 (centroid - q), this mean is the centroid of the region.

    Parameters
    ----------
    point : (n,) complex array
        Positions of the points in their cells.
    region : (n,) int array
        Number of the region of each point.
    triangles : Points
        Triangles that together cover all regions.
    region_count : int
        All numbers of regions are less than this.

    Returns
    -------
    weight : (n,) float array
        Weight of each point; 0 in regions that the points cannot represent.
    is_represented : (region_count,) bool array
        Whether the points in the region represent it: at least three, not in a row.
    """

    def total(regions: Ints, values: Floats) -> Floats:
        """Sum values (n,) by region."""
        return np.bincount(regions, values, minlength=region_count).astype(np.float64, copy=False)

    points = np.maximum(np.bincount(region, minlength=region_count), 1)
    area = total(triangles.region, triangles.weight)
    q_x, q_y = total(region, point.real) / points, total(region, point.imag) / points
    x, y = point.real - q_x[region], point.imag - q_y[region]
    xx, xy, yy = (total(region, product) / points for product in (x * x, x * y, y * y))
    determinant = xx * yy - xy * xy
    is_represented: Bools = determinant > _MIN_DETERMINANT
    # The vector from q to the centroid, multiplied by the area.
    to_x = total(triangles.region, triangles.weight * triangles.point.real) - area * q_x
    to_y = total(triangles.region, triangles.weight * triangles.point.imag) - area * q_y
    divisor = np.where(is_represented, points * determinant, np.inf)
    t_x, t_y = (yy * to_x - xy * to_y) / divisor, (xx * to_y - xy * to_x) / divisor
    weight = np.where(is_represented, area / points, 0)[region]
    return weight + t_x[region] * x + t_y[region] * y, is_represented
