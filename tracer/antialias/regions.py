"""Divide cells by straight lines into regions, and weight points to represent the regions.

A *cell* is a pixel or a square part of a pixel.  Points are spread evenly over it.  The weights of
the points in a region add up to the exact area of the region (post-stratification: Cochran,
Sampling Techniques, 1977, ch. 5A), and the weighted mean of the points is the centroid of the
region.  So the weighted mean of a function that is linear in each region is exact.

Each line is extended across the whole cell.  If the edge that it represents ends within the cell,
then one region is divided into two, which does no harm.

A point is a complex number x + iy, relative to the center of its cell, with x and y between -1/2
and 1/2 of the cell's width, and y pointing down.  Areas are fractions of the cell's area.

Regions are numbered over all cells.  In the binary digits of a region's index, bit k is 1 if the
region is on the positive side of line k of its cell.  The bits from `max_lines` on are the index of
the cell, where `max_lines` is the maximum number of lines in a cell.  Arrays have an element for
every index up to the largest, so the caller must limit the number of lines in a cell to a few.
"""

from __future__ import annotations

from typing import Annotated as Shaped
from typing import NamedTuple, TypeAlias

import numpy as np

from tracer.antialias.edge_functions import Lines
from tracer.antialias.lattice import Points2D
from tracer.arrays import Bools, Floats, Ints, find

# Regions of at most this fraction of the cell's area are ignored if they contain too few points.
# Each changes the mean radiance of a cell by at most this fraction of the largest radiance.
_MIN_AREA = 1e-9

# The points in a region represent it if the determinant of their covariance matrix, in units of the
# cell's width, is more than this.  It is 0 for one or two points or points on a straight line, and
# 1 / (27 m^2) for three neighbouring points of a lattice with m points: 9e-6 for 65 points.
_MIN_DETERMINANT = 1e-6

_Corners: TypeAlias = tuple[Points2D, Points2D, Points2D]
"""The first, second and third corners of triangles."""


class WeightedPoints(NamedTuple):
    """Points in cells, with weights and regions."""

    cell_index: Shaped[Ints, "n"]
    position: Shaped[Points2D, "n"]
    # Weight in the mean over the cell.  The weights in a region add up to its area.  Weights may be
    # negative if the centroid of the region is far from the mean of its points.
    weight: Shaped[Floats, "n"]
    region_index: Shaped[Ints, "n"]


def place_weighted_points(
    lines: Lines, cell_count: int, points: Shaped[Points2D, "m"]
) -> WeightedPoints:
    """Place the same points in every cell, and weight them to represent the regions between lines.

    The lines must be sorted by cell.  The result contains the points of one cell after the other.
    Points in regions with too few points have the weight 0.  Such a region is divided into
    triangles, whose centroids are added at the end of the result.
    """
    cell_lines = _CellLines.from_lines(lines, cell_count)
    position: Points2D = np.tile(points, cell_count)
    region_index = _find_regions(cell_lines, cell_count, points)
    centroids = _divide_into_triangles(cell_lines, cell_count).compute_centroids()
    region_count = cell_count << cell_lines.max_lines
    moments = _compute_point_moments(position, region_index, region_count)
    is_represented = moments.determinant > _MIN_DETERMINANT
    region_weights = _compute_region_weights(
        moments, is_represented, _compute_area_moments(centroids, region_count)
    )
    placed_points = WeightedPoints(
        cell_index=np.arange(cell_count).repeat(points.size),
        position=position,
        weight=region_weights.evaluate(position, region_index),
        region_index=region_index,
    )
    # Add the centroids of triangles in regions that the points do not represent.
    added_index = find(~is_represented[centroids.region_index] & (centroids.weight > _MIN_AREA))
    added_points = WeightedPoints._make(field[added_index] for field in centroids)
    return WeightedPoints._make(map(np.append, placed_points, added_points))


def find_samples_in_mixed_regions(
    region_index: Shaped[Ints, "n"], sample_id: Shaped[Ints, "n"]
) -> Shaped[Ints, "k"]:
    """Return the index of at least one sample in each region whose samples have different ids.

    Samples have different ids if they hit different faces, or the same face under different lights.
    Then an edge that no line represents crosses the region.
    """
    reference_id = np.empty(int(region_index.max(initial=0)) + 1, dtype=np.intp)
    reference_id[region_index] = sample_id  # the id of an arbitrary sample in the region
    return find(reference_id[region_index] != sample_id)


class _CellLines(NamedTuple):
    """Lines sorted by cell; a `line_number` counts the lines of one cell from 0."""

    lines: Lines
    # The lines of cell i have the indices start[i] to start[i + 1] - 1.
    start: Shaped[Ints, "cells+1"]
    max_lines: int  # maximum number of lines in a cell

    @classmethod
    def from_lines(cls, lines: Lines, cell_count: int) -> _CellLines:
        start = lines.cell_index.searchsorted(np.arange(cell_count + 1))
        return cls(lines=lines, start=start, max_lines=int(np.diff(start).max(initial=0)))

    def evaluate(
        self,
        line_number: int,
        cell_index: Shaped[Ints, "n"],
        position: Shaped[Points2D, "m n"],
    ) -> tuple[Shaped[Ints, "k"], Shaped[Floats, "m k"]]:
        """Evaluate c + a x + b y for one line of each cell, at m points in the cell.

        Column i of `position` contains m points in the cell `cell_index[i]`, and `line_number`
        selects a line of this cell.  Return the indices of the k columns whose cell has such a
        line, and the values at the points in these columns.
        """
        line_index = self.start[cell_index] + line_number
        column_index = find(line_index < self.start[cell_index + 1])
        line = self.lines.take(line_index[column_index])
        point = position[:, column_index]
        return column_index, line.a * point.real + line.b * point.imag + line.c


def _find_regions(
    cell_lines: _CellLines, cell_count: int, points: Shaped[Points2D, "m"]
) -> Shaped[Ints, "n"]:
    """Return the indices of the regions in which the m points lie, for one cell after the other."""
    cell_index = np.arange(cell_count)
    position: Points2D = np.repeat(points[:, None], cell_count, axis=1)
    region_index = np.repeat(cell_index[None] << cell_lines.max_lines, points.size, axis=0)
    for line_number in range(cell_lines.max_lines):
        column_index, values = cell_lines.evaluate(line_number, cell_index, position)
        region_index[:, column_index] |= (values > 0) << line_number
    return region_index.T.ravel()


class _Triangles(NamedTuple):
    """Triangles that together cover all cells."""

    corners: Shaped[Points2D, "3 n"]
    cell_index: Shaped[Ints, "n"]
    region_index: Shaped[Ints, "n"]

    def divide(self, cell_lines: _CellLines, line_number: int) -> _Triangles:
        """Divide each triangle that a certain line of its cell crosses into three triangles.

        The line has the number `line_number`.  It crosses none of the returned triangles.  Bit
        `line_number` is set in the region indices of all triangles on its positive side.
        """
        column_index, values = cell_lines.evaluate(line_number, self.cell_index, self.corners)
        is_positive = values > 0
        # The line crosses a triangle unless all three corners are on one side.
        positive_count = is_positive.sum(axis=0)
        crossed_index = find((positive_count == 1) | (positive_count == 2))
        # Rotate the corners of each crossed triangle so that the first is alone on its side.
        is_lone_positive = positive_count[crossed_index] == 1
        lone_index = np.argmax(is_positive[:, crossed_index] == is_lone_positive, axis=0)
        corner_index = (lone_index + np.arange(3)[:, None]) % 3
        parent_index = column_index[crossed_index]
        lone_part, near_part, far_part = _cut_off_corner(
            self.corners[corner_index, parent_index], values[corner_index, crossed_index]
        )
        # The part with the lone corner replaces the triangle.  The others are appended.
        corners = np.concatenate([self.corners, near_part, far_part], axis=1)
        corners[:, parent_index] = lone_part
        other_region = self.region_index[parent_index] | (~is_lone_positive << line_number)
        region_index = np.concatenate([self.region_index, other_region, other_region])
        region_index[parent_index] |= is_lone_positive << line_number
        region_index[column_index[positive_count == 3]] |= 1 << line_number
        other_cell = self.cell_index[parent_index]
        return _Triangles(
            corners=corners,
            cell_index=np.concatenate([self.cell_index, other_cell, other_cell]),
            region_index=region_index,
        )

    def compute_centroids(self) -> WeightedPoints:
        """Return the centroid of each triangle, with the area of the triangle as its weight."""
        side_ab = self.corners[1] - self.corners[0]
        side_ac = self.corners[2] - self.corners[0]
        # Avoid products of complex numbers: NumPy rounds them differently at the end of an array.
        area = np.abs(side_ab.real * side_ac.imag - side_ab.imag * side_ac.real) / 2
        return WeightedPoints(
            cell_index=self.cell_index,
            position=self.corners.sum(axis=0) / 3,
            weight=area,
            region_index=self.region_index,
        )


def _cut_off_corner(
    corners: Shaped[Points2D, "3 n"], values: Shaped[Floats, "3 n"]
) -> tuple[Shaped[_Corners, "n"], Shaped[_Corners, "n"], Shaped[_Corners, "n"]]:
    """Divide each triangle into three, by a line that separates the first corner from the others.

    `values` are the values at the corners of a linear function that is zero on the line.  The
    triangle with the first corner is returned first.
    """
    a, b, c = corners
    a_value, b_value, c_value = values
    # The line crosses the sides ab and ac at these points.
    on_ab = a + a_value / (a_value - b_value) * (b - a)
    on_ac = a + a_value / (a_value - c_value) * (c - a)
    return (a, on_ab, on_ac), (on_ab, b, c), (on_ab, c, on_ac)


def _divide_into_triangles(cell_lines: _CellLines, cell_count: int) -> _Triangles:
    """Divide cells into triangles that no line crosses.

    A diagonal divides each cell into two triangles, which are divided line by line.
    """
    square_corners = np.array([-1 - 1j, 1 - 1j, 1 + 1j, -1 + 1j]) / 2
    cell_index = np.arange(cell_count).repeat(2)
    triangles = _Triangles(
        corners=np.tile(square_corners[[[0, 0], [1, 2], [2, 3]]], cell_count),
        cell_index=cell_index,
        region_index=cell_index << cell_lines.max_lines,
    )
    for line_number in range(cell_lines.max_lines):
        triangles = triangles.divide(cell_lines, line_number)
    return triangles


def _sum_by_region(
    region_index: Shaped[Ints, "n"], values: Shaped[Floats, "n"], region_count: int
) -> Shaped[Floats, "region_count"]:
    """Sum the values in each region."""
    # Convert the result: NumPy returns integers if there are no values.
    return np.bincount(region_index, values, region_count).astype(float, copy=False)


class _PointMoments(NamedTuple):
    """Number, mean and covariance of the points in each region.

    In a region without points, all numbers are 0.
    """

    point_count: Shaped[Ints, "regions"]
    mean_x: Shaped[Floats, "regions"]
    mean_y: Shaped[Floats, "regions"]
    # The elements and the determinant of the covariance matrix.
    cov_xx: Shaped[Floats, "regions"]
    cov_xy: Shaped[Floats, "regions"]
    cov_yy: Shaped[Floats, "regions"]
    determinant: Shaped[Floats, "regions"]


def _compute_point_moments(
    position: Shaped[Points2D, "n"], region_index: Shaped[Ints, "n"], region_count: int
) -> _PointMoments:
    """Compute the mean and the covariance of the points in each region."""

    def average(values: Shaped[Floats, "n"]) -> Shaped[Floats, "region_count"]:
        return _sum_by_region(region_index, values, region_count) / divisor

    point_count = np.bincount(region_index, minlength=region_count)
    divisor = np.maximum(point_count, 1)
    mean_x = average(position.real)
    mean_y = average(position.imag)
    x = position.real - mean_x[region_index]
    y = position.imag - mean_y[region_index]
    cov_xx = average(x * x)
    cov_xy = average(x * y)
    cov_yy = average(y * y)
    return _PointMoments(
        point_count=point_count,
        mean_x=mean_x,
        mean_y=mean_y,
        cov_xx=cov_xx,
        cov_xy=cov_xy,
        cov_yy=cov_yy,
        determinant=cov_xx * cov_yy - cov_xy * cov_xy,
    )


class _AreaMoments(NamedTuple):
    """The area of each region, and the integrals of x and y over the region."""

    area: Shaped[Floats, "regions"]
    integral_x: Shaped[Floats, "regions"]
    integral_y: Shaped[Floats, "regions"]


def _compute_area_moments(centroids: WeightedPoints, region_count: int) -> _AreaMoments:
    """Add up triangles that cover each region exactly, given by centroids weighted by area."""
    region_index = centroids.region_index
    area = centroids.weight
    return _AreaMoments(
        area=_sum_by_region(region_index, area, region_count),
        integral_x=_sum_by_region(region_index, area * centroids.position.real, region_count),
        integral_y=_sum_by_region(region_index, area * centroids.position.imag, region_count),
    )


class _RegionWeights(NamedTuple):
    """The weight of the points in each region, as a linear function of their position."""

    mean_x: Shaped[Floats, "regions"]  # mean position of the points
    mean_y: Shaped[Floats, "regions"]
    weight_at_mean: Shaped[Floats, "regions"]
    gradient_x: Shaped[Floats, "regions"]
    gradient_y: Shaped[Floats, "regions"]

    def evaluate(
        self, position: Shaped[Points2D, "n"], region_index: Shaped[Ints, "n"]
    ) -> Shaped[Floats, "n"]:
        """Compute the weight of each point as a sample of the region with the given index."""
        x = position.real - self.mean_x[region_index]
        y = position.imag - self.mean_y[region_index]
        weight = self.weight_at_mean[region_index]
        return weight + self.gradient_x[region_index] * x + self.gradient_y[region_index] * y


def _compute_region_weights(
    moments: _PointMoments, is_represented: Shaped[Bools, "regions"], area_moments: _AreaMoments
) -> _RegionWeights:
    """Choose weights so that points have the area and the centroid of the region that they are in.

    The points in a region that is not represented have the weight 0.
    """
    # Let S be the covariance matrix of the points in a region, and w the region's area divided by
    # the number of points.  With the weights w (1 + t . (point - mean)), the weighted mean of the
    # points is mean + S t.  It is the region's centroid if t = S^-1 (centroid - mean).
    area = area_moments.area
    # The vector area (centroid - mean).
    offset_x = area_moments.integral_x - area * moments.mean_x
    offset_y = area_moments.integral_y - area * moments.mean_y
    # Division by infinity gives the weight 0 to points in regions that are not represented.
    point_count = np.where(is_represented, moments.point_count, np.inf)
    divisor = np.where(is_represented, point_count * moments.determinant, np.inf)
    # The gradient of the weight is w t.  The inverse of S is [[yy, -xy], [-xy, xx]] / determinant.
    return _RegionWeights(
        mean_x=moments.mean_x,
        mean_y=moments.mean_y,
        weight_at_mean=area / point_count,
        gradient_x=(moments.cov_yy * offset_x - moments.cov_xy * offset_y) / divisor,
        gradient_y=(moments.cov_xx * offset_y - moments.cov_xy * offset_x) / divisor,
    )
