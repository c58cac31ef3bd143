"""Render a picture with a proof: an upper and a lower bound on the mean radiance of every pixel.

The idea: objects are convex and lights are points.  So every edge in the picture is the zero of a
smooth function, and radiance is smooth between edges.  Enclose the radiance by a polynomial where
it is smooth, enclose each edge in a narrow strip, and assume the worst case inside the strips.
If the bounds are too wide, divide the picture into smaller cells.

Sources: the subdivision is that of Warnock (1969; see `cells`).  The bounds are affine arithmetic
of second order (Comba and Stolfi, 1993; see `enclosures`).  This project combines the two.

A *pair* is a face that may be visible in a cell.  A light is *settled* for a pair if it reaches all
of the face in the cell, or none of it.  A cell of the picture is treated as follows:

1. A light that reaches all of a face in the cell adds radiance that a polynomial encloses.  The
   polynomial's mean over the cell is computed exactly, so the estimate is much better than the
   bounds.  The quarters of the cell inherit this radiance.
2. If no other face is visible in the cell, it is finished, and so are all pixels in it.
3. Otherwise each edge lies in a *strip* between two parallel lines (see `regions`).  The centre
   lines of the strips divide the cell into convex *regions*.  Outside the strips, nothing changes
   within a region.  So one sample at the centroid of a region shows which face is visible and which
   lights reach it.
4. A cell is divided into quarters if it has too many edges, or if the error of its mean radiance is
   too large.

Why the bounds are sound: each point of a region either shows what the centroid shows, or lies in a
strip.  Two errors remain:

- In a strip, radiance differs from that of the region by at most the strip's *jump*: the radiance
  of the light that the edge cuts off, or the maximum radiance in the cell if the face changes.
- If the centroid itself is in a strip, its sample may be on the wrong side of the edge.  Then
  the radiance of the whole region may be off by the jump.  This is the region's *sample error*.

The error of a pixel is at most the sum of these errors over its cells, weighted by areas.  A cell
is finished if its error is at most the average that its pixel can still afford.  Other cells are
divided.

The samples are traced by the tracer, but only to find which surface is visible and which lights
reach it.  The tracer's radiance is not used.  If a sample shows a face that is not listed for its
cell, the certificate or the tracer has an error, and a RuntimeError is raised.

Rounding: positions of samples and cells have rounding errors smaller than the error bounds of the
enclosures, which contain 1e-13 times the coordinates involved.  Areas and means of regions take
about a hundred roundings.  Let radiance be at most R, and e = 2^-53.  If all roundings have the
same sign, the sum over at most 4^10 cells of a pixel errs by 4^10 e R, and the sum over n lights by
n e R.  Therefore the bounds are widened by 1e-9 R.

Radiance is linear RGB.  Errors are maxima over the three channels.  `Contributions` are what each
unsettled light, which may reach only a part of the face, adds to the radiance of a pair there.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated as Shaped
from typing import NamedTuple

import numpy as np

from reference.judges.arrays import (
    Bools,
    Floats,
    Ints,
    add_at_sorted_index,
    find_in_sorted,
    list_segment_elements,
    sum_by_index,
)
from reference.judges.cell_analysis import CellAnalysis
from reference.judges.cells import MAX_WIDTH, Cells, Contributions, make_initial_cells
from reference.judges.certified_scene import CertifiedScene
from reference.judges.enclosures import UNKNOWN_Z, Enclosures, enclose_constants
from reference.judges.ray_functions import concatenate_edges
from reference.judges.regions import Regions, Strips, divide_into_regions, enclose_in_strips
from reference.judges.shading import shade
from tracer import Scene, to_codes

# Maximum number of pairs, triples (see `cells`) and unsettled lights of pairs in one batch, whose
# arrays fit into the CPU cache.  Half or twice this number takes 3 to 7 % longer in two scenes.
_MAX_ITEMS_PER_BATCH = 12000

# Maximum number of edges that divide a cell into regions.  A cell with more edges is divided into
# quarters, because each edge may double the number of regions.
_MAX_LINES = 5

# Fraction of the permitted error that all settled lights of a pair may cause together.
_SETTLED_ERROR = 0.25

# Minimum width of a cell in pixels.
_MIN_WIDTH = 2.0**-10

# A pixel with this many pending cells of one width is finished, although its bounds are too wide.
# There are so many if the focal length is so large that rounding errors hide every edge.
_MAX_PENDING_CELLS = 1 << 11

# The bounds are widened by this fraction of the largest radiance, for rounding errors.
_ROUNDING = 1e-9

# Fraction of the permitted error that the cells may cause.  The rest is for rounding errors.
_ERROR_FOR_CELLS = 0.999


@dataclass(frozen=True)
class Certificate:
    """A picture with proven bounds on the mean radiance of every pixel."""

    low: Shaped[Floats, "height width 3"]
    high: Shaped[Floats, "height width 3"]
    image: Shaped[Floats, "height width 3"]  # best estimate, between the bounds
    cell_count: int  # number of cells that were examined

    @property
    def error(self) -> Shaped[Floats, "height width"]:
        """Upper bound on the error of each pixel of `image`."""
        return np.asarray((self.high - self.image).max(axis=2))

    @property
    def is_certain(self) -> Shaped[Bools, "height width"]:
        """Whether the two bounds of a pixel have the same 8-bit codes."""
        return np.asarray((to_codes(self.low) == to_codes(self.high)).all(axis=2))


class CellEstimates(NamedTuple):
    """Estimates of the mean radiance of cells, with the regions on which they are based."""

    strips: Strips  # the strips whose centre lines divide cells
    regions: Regions
    # (8, 3, regions).  The radiance of all points of each region that lie in no strip, if the
    # region's sample is right.
    radiance: Enclosures
    # Sum of the jumps of all strips that contain the region's centroid.
    sample_error: Shaped[Floats, "regions"]
    max_radiance: Shaped[Floats, "3 cells"]  # upper bound on the radiance anywhere in a cell
    mean: Shaped[Floats, "3 cells"]
    error: Shaped[Floats, "cells"]  # upper bound on the error of the mean


def estimate_means(
    analysis: CellAnalysis, contributions: Contributions, is_requested: Shaped[Bools, "cells"]
) -> CellEstimates:
    """Estimate the mean radiance of each cell of the picture, and bound the error of the estimate.

    Strips that contain the edges divide a cell into regions.  One sample is traced at the centroid
    of each region.  In cells that are not requested, in cells with too many edges, and in black
    cells, no sample is traced, and half the maximum radiance is the estimate.
    """
    cell_count = analysis.cells.x.size
    max_radiance = _bound_radiance(analysis.cells, contributions)
    # Divide cells into regions.
    all_strips = _enclose_edges(analysis, contributions, max_radiance, is_requested)
    has_many_edges = np.bincount(all_strips.cell_index, minlength=cell_count) > _MAX_LINES
    is_black = max_radiance.max(axis=0) == 0
    is_sampled = is_requested & ~has_many_edges & ~is_black
    strips = all_strips.take(is_sampled[all_strips.cell_index])
    regions = _divide_cells(strips, is_sampled)
    # Estimate the mean of each region, and then of each cell, with their errors.
    sample_error = _bound_sample_errors(strips, regions, cell_count)
    radiance = _enclose_region_radiance(analysis, contributions, regions)
    region_mean, region_error = _bound_region_means(regions, radiance, sample_error, max_radiance)
    weighted_mean = regions.area * region_mean
    mean = np.array([sum_by_index(regions.cell_index, row, cell_count) for row in weighted_mean])
    mean[:, ~is_sampled] = max_radiance[:, ~is_sampled] / 2
    cell_error = sum_by_index(regions.cell_index, regions.area * region_error, cell_count)
    cell_error += sum_by_index(strips.cell_index, strips.area * strips.jump, cell_count)
    cell_error[~is_sampled] = np.inf
    # No error is larger than the distance from the mean to 0 or to the maximum.  This bound also
    # replaces an error of NaN.
    cell_error = np.fmin(cell_error, np.maximum(mean, max_radiance - mean).max(axis=0))
    return CellEstimates(
        strips=strips,
        regions=regions,
        radiance=radiance,
        sample_error=sample_error,
        max_radiance=max_radiance,
        mean=mean,
        error=cell_error,
    )


def _bound_region_means(
    regions: Regions,
    radiance: Enclosures,
    sample_error: Shaped[Floats, "regions"],
    max_radiance: Shaped[Floats, "3 cells"],
) -> tuple[Shaped[Floats, "3 regions"], Shaped[Floats, "regions"]]:
    """Estimate the mean radiance of each region outside the strips, and bound its error.

    The estimate is the mean of the polynomial that encloses the radiance.  The error is at most the
    deviation from the polynomial plus `sample_error`, and at most `max_radiance` of the cell.
    """
    mean = (radiance.coefficients[:UNKNOWN_Z] * regions.moments[:, None]).sum(axis=0)
    # The true mean is between 0 and the maximum radiance in the cell.
    max_error = np.maximum(mean, max_radiance[:, regions.cell_index] - mean)
    error = np.minimum(radiance.max_deviation + sample_error, max_error).max(axis=0)
    return mean, error


def _bound_radiance(cells: Cells, contributions: Contributions) -> Shaped[Floats, "3 cells"]:
    """Compute an upper bound on the radiance anywhere in each cell, as if no light were blocked.

    The bound is the maximum over the faces in the cell, or 0 if there are none.
    """
    _, face_bounds = cells.radiance.find_bounds()
    add_at_sorted_index(face_bounds, contributions.pair_index, contributions.radiance.max_abs)
    max_radiance = np.zeros((3, cells.x.size))
    for channel, channel_bounds in zip(max_radiance, face_bounds, strict=True):
        np.maximum.at(channel, cells.cell_index, channel_bounds)
    return max_radiance


def _enclose_edges(
    analysis: CellAnalysis,
    contributions: Contributions,
    max_radiance: Shaped[Floats, "3 cells"],
    is_requested: Shaped[Bools, "cells"],
) -> Strips:
    """Enclose each edge of the picture in a strip, and bound the jump in radiance across the edge.

    `max_radiance` bounds the radiance anywhere in a cell.  Edges without a jump, and edges in
    cells that are not requested, get no strip.
    """
    cells, edges = analysis.cells, concatenate_edges(analysis.edges)
    cell_index = cells.cell_index[edges.pair_index]
    contribution_index = _find_contributions(
        contributions, edges.pair_index, edges.light_index, cells.is_settled.shape[1]
    )
    # Index -1 selects the appended 0, for lights without a contribution.
    light_jump = np.append(contributions.radiance.max_abs.max(axis=0), 0)[contribution_index]
    # Where the face changes (light index -1), the radiance may change by the maximum in the cell.
    jump = np.where(edges.light_index < 0, max_radiance.max(axis=0)[cell_index], light_jump)
    edge_index = np.flatnonzero((jump > 0) & is_requested[cell_index])
    functions = edges.functions[edge_index]
    return enclose_in_strips(cell_index[edge_index], functions, jump[edge_index])


def _find_contributions(
    contributions: Contributions,
    pair_index: Shaped[Ints, "n"],
    light_index: Shaped[Ints, "n"],
    light_count: int,
) -> Shaped[Ints, "n"]:
    """Find the index in `contributions` of each combination of a pair and a light; -1 for none.

    Where `light_index` is -1, the result has no meaning.
    """
    # Each combination of a pair and a light has its own key.
    keys = contributions.pair_index * light_count + contributions.light_index
    return find_in_sorted(keys, pair_index * light_count + light_index)


def _divide_cells(strips: Strips, is_sampled: Shaped[Bools, "cells"]) -> Regions:
    """Divide the sampled cells, which contain all strips, into regions."""
    sampled_cell_index = np.flatnonzero(is_sampled)
    new_index = np.cumsum(is_sampled) - 1
    renumbered_strips = strips._replace(cell_index=new_index[strips.cell_index])
    regions = divide_into_regions(renumbered_strips, sampled_cell_index.size)
    return regions._replace(cell_index=sampled_cell_index[regions.cell_index])


def _bound_sample_errors(
    strips: Strips, regions: Regions, cell_count: int
) -> Shaped[Floats, "regions"]:
    """Bound the error that results if the sample at a region's centroid is beyond an edge.

    The bound is the sum of the jumps in radiance across the edges in all strips that contain the
    centroid.  It is infinite if the region is too small for an accurate centroid.
    """
    _, x, y, *_ = regions.moments
    strip_start = strips.cell_index.searchsorted(np.arange(cell_count + 1))
    strip_count = np.diff(strip_start)[regions.cell_index]
    # Compare each region with all strips of its cell.
    region_index, strip_index = list_segment_elements(strip_count, strip_start[regions.cell_index])
    strip = strips.take(strip_index)
    height = strip.compute_height(x[region_index], y[region_index])
    is_in_strip = np.abs(height) <= strip.half_width
    sample_error = sum_by_index(region_index, is_in_strip * strip.jump, regions.area.size)
    sample_error[regions.is_tiny] = np.inf
    return sample_error


def _enclose_region_radiance(
    analysis: CellAnalysis, contributions: Contributions, regions: Regions
) -> Enclosures:
    """Enclose the radiance (8, 3, regions) of what a sample at each region's centroid shows.

    It is the radiance that the visible face reflects from all settled lights, and from the
    unsettled lights that reach the centroid.  The background has radiance 0.
    """
    pair_index, is_lit = _trace_samples(analysis, regions)
    radiance = analysis.cells.radiance[pair_index]
    radiance.coefficients[..., pair_index < 0] = 0
    region_index, light_index = np.nonzero(is_lit.T)
    contribution_index = _find_contributions(
        contributions, pair_index[region_index], light_index, len(is_lit)
    )
    added_radiance = contributions.radiance[contribution_index]
    add_at_sorted_index(radiance.coefficients, region_index, added_radiance.coefficients)
    return radiance


class _RegionSamples(NamedTuple):
    """What the centroids of regions show."""

    pair_index: Shaped[Ints, "regions"]  # of the visible face, or -1 for the background
    is_lit: Shaped[Bools, "lights regions"]  # by which unsettled lights; False for settled ones


def _trace_samples(analysis: CellAnalysis, regions: Regions) -> _RegionSamples:
    """Trace one sample at the centroid of each region.

    Raise RuntimeError if a sample shows a face that is not listed for its cell.
    """
    cells, scene = analysis.cells, analysis.scene
    cell_index, (_, x, y, *_) = regions.cell_index, regions.moments
    half_width = cells.width / 2
    sample_x = cells.x[cell_index] + half_width * x
    sample_y = cells.y[cell_index] + half_width * y
    hits, sample_index, face_index = scene.trace_samples(sample_x, sample_y)
    # Each combination of a cell and a face has its own key.
    face_count = scene.faces.object_index.size
    pair_keys = cells.cell_index * face_count + cells.face_index
    sample_keys = cell_index[sample_index] * face_count + face_index
    sorted_index = pair_keys.argsort()
    key_index = find_in_sorted(pair_keys[sorted_index], sample_keys)
    if (key_index < 0).any():
        raise RuntimeError("a sample contradicts its cell: the certificate or the tracer is wrong")
    visible_pair_index = sorted_index[key_index]
    pair_index = np.full(cell_index.size, -1)
    pair_index[sample_index] = visible_pair_index
    is_lit = np.zeros((cells.is_settled.shape[1], cell_index.size), dtype=np.bool_)
    is_lit[:, sample_index] = scene.test_lights(hits, ~cells.is_settled[visible_pair_index].T)
    return _RegionSamples(pair_index=pair_index, is_lit=is_lit)


class _Picture:
    """A picture to which cells are added once their mean radiance is known accurately enough."""

    scene: CertifiedScene
    permitted_error: float  # of each pixel's mean radiance
    # Sum, in each pixel, of the mean radiance of its finished cells, weighted by area.  There are
    # `MAX_WIDTH` additional rows and columns, because cells may extend beyond the picture.
    image: Shaped[Floats, "3 rows columns"]
    error_bound: Shaped[Floats, "rows columns"]  # upper bound on the error of `image`
    cell_count: int  # number of cells examined so far

    def __init__(self, scene: Scene, permitted_error: float) -> None:
        """Create a black picture; raise ValueError if `CertifiedScene` refuses the scene."""
        self.scene = CertifiedScene(scene)
        self.permitted_error = permitted_error
        self.cell_count = 0
        padded_size = scene.height + MAX_WIDTH, scene.width + MAX_WIDTH
        self.image = np.zeros((3, *padded_size))
        self.error_bound = np.zeros(padded_size)

    def split_if_large(self, cells: Cells) -> list[Cells]:
        """Divide the cells into two groups if there are too many for one batch.

        All cells of a pixel are in the same group.  If all cells are in one pixel, there is one
        group.
        """
        unsettled_light_count = np.count_nonzero(~cells.is_settled)
        item_count = cells.cell_index.size + cells.shadow_triples.shape[1] + unsettled_light_count
        if item_count <= _MAX_ITEMS_PER_BATCH:
            return [cells]
        pixel_index = self.find_pixel_index(cells)
        is_below_median = pixel_index < np.sort(pixel_index)[pixel_index.size // 2]
        groups = [cells.select_cells(is_below_median), cells.select_cells(~is_below_median)]
        return groups if is_below_median.any() else [cells]

    def find_pixel_index(self, cells: Cells) -> Shaped[Ints, "cells"]:
        """Find the pixel that contains each cell, as an index into the flattened `error_bound`.

        For a cell that covers several pixels, this is the upper left pixel.
        """
        # From a cell's centre to its upper left corner, along both axes.  Both are exact.
        shift = cells.width / 2
        row, column = (np.floor(center - shift).astype(np.intp) for center in (cells.y, cells.x))
        return np.asarray(row * self.error_bound.shape[1] + column)

    def add_cells(self, cells: Cells, cell_index: Shaped[Ints, "n"], radiance: Enclosures) -> None:
        """Add the mean radiance of some cells, and its error, to the pixels that they cover.

        `radiance`, of shape (8, 3, n), is that of the cells with the given indices.  A cell that is
        smaller than a pixel is weighted by its area in pixels.
        """
        pixels_across = max(int(cells.width), 1)
        area = min(cells.width, 1) ** 2  # of the part of a cell in one pixel
        first_pixel_index = self.find_pixel_index(cells)[cell_index][:, None, None]
        first_row, first_column = np.divmod(first_pixel_index, self.error_bound.shape[1])
        row, column = np.indices((pixels_across, pixels_across))  # in the cell
        pixels = first_row + row, first_column + column
        # X and Y run from -1 to 1 in a cell.  Compute the means of 1, X, Y, X^2, X Y and Y^2 over
        # each pixel of a cell, or over the whole cell if it is smaller than a pixel.  The pixel has
        # the centre (x, y) and the half width 1 / pixels_across, so the mean of X^2 is x^2 plus a
        # third of the square of the half width.
        x = (2 * column + 1) / pixels_across - 1
        y = (2 * row + 1) / pixels_across - 1
        variance = 1 / (3 * pixels_across * pixels_across)
        term_means = np.array([x * 0 + 1, x, y, x * x + variance, x * y, y * y + variance])
        for index, channel in enumerate(self.image):
            pixel_means = np.tensordot(radiance.coefficients[:UNKNOWN_Z, index], term_means, (0, 0))
            np.add.at(channel, pixels, area * pixel_means)
        error_bound = radiance.max_deviation.max(axis=0)
        np.add.at(self.error_bound, pixels, area * error_bound[:, None, None])

    def add_accurate_cells(self, cells: Cells) -> Cells:
        """Add the cells that are accurate enough to the picture, and return the remaining ones.

        No part of the cells may have been added yet.  A cell is accurate enough if it shows a
        single face for which each light is settled.  Of the remaining cells, if they are not larger
        than a pixel, those that `find_final_cells` selects are also added.
        """
        self.cell_count += cells.x.size
        analysis = CellAnalysis(self.scene, cells)
        cells = analysis.cells
        pair_count = np.bincount(cells.cell_index, minlength=cells.x.size)
        is_only_pair = pair_count[cells.cell_index] == 1
        may_finish_cell = cells.covers_cell & is_only_pair & (cells.width <= MAX_WIDTH)
        settled_error = _SETTLED_ERROR * self.permitted_error
        contributions = shade(analysis, may_finish_cell | (cells.width <= 1), settled_error)
        # Cells that show a single face, for which each light is settled.
        finished_pair_index = np.flatnonzero(may_finish_cell & cells.is_settled.all(axis=1))
        finished_cell_index = cells.cell_index[finished_pair_index]
        self.add_cells(cells, finished_cell_index, cells.radiance[finished_pair_index])
        is_pending = pair_count > 0  # cells without pairs are black
        is_pending[finished_cell_index] = False
        if cells.width <= 1:
            is_pending &= ~self._add_cells_with_edges(analysis, contributions, is_pending)
        return cells.select_cells(is_pending)

    def _add_cells_with_edges(
        self,
        analysis: CellAnalysis,
        contributions: Contributions,
        is_pending: Shaped[Bools, "cells"],
    ) -> Shaped[Bools, "cells"]:
        """Add those pending cells that `find_final_cells` selects, and return which these are.

        No cell may be larger than a pixel.  The mean radiance of a cell is estimated from samples
        in it (see `estimate_means`).
        """
        cells = analysis.cells
        estimates = estimate_means(analysis, contributions, is_pending)
        is_final = is_pending & self.find_final_cells(cells, estimates.error, is_pending)
        cell_index = np.flatnonzero(is_final)
        mean_radiance = enclose_constants(estimates.mean, estimates.error)
        self.add_cells(cells, cell_index, mean_radiance[cell_index])
        return is_final

    def find_final_cells(
        self, cells: Cells, cell_error: Shaped[Floats, "cells"], is_pending: Shaped[Bools, "cells"]
    ) -> Shaped[Bools, "cells"]:
        """Decide which cells to add to the picture undivided; no cell may be larger than a pixel.

        The remaining error of a pixel is its permitted error minus the error of its finished cells.
        If the pending cells of the pixel together cause at most this error, all of them are added.
        Otherwise, a cell is added if its error is at most the average that the pixel can afford.
        The smallest cells are always added, and so are all cells of a pixel with too many cells.
        """
        pending_area = is_pending * np.float64(cells.width**2)
        pixel_index, pixel_number = np.unique(self.find_pixel_index(cells), return_inverse=True)
        remaining_error = self.permitted_error - self.error_bound.reshape(-1)[pixel_index]
        total_error = sum_by_index(pixel_number, pending_area * cell_error, pixel_index.size)
        average_error = remaining_error / sum_by_index(pixel_number, pending_area, pixel_index.size)
        max_error = np.where(total_error <= remaining_error, np.inf, average_error)
        max_error[np.bincount(pixel_number) >= _MAX_PENDING_CELLS] = np.inf
        return np.asarray((cell_error <= max_error[pixel_number]) | (cells.width <= _MIN_WIDTH))


@np.errstate(all="ignore")
def certify(
    scene: Scene, error: float, progress: Callable[[float], object] = lambda fraction: None
) -> Certificate:
    """Render a scene, and prove bounds on the mean radiance of every pixel.

    The picture is divided into smaller and smaller cells until the bounds are narrow enough.

    Parameters
    ----------
    scene : Scene
        The scene.
    error : float
        Permitted error of each pixel's mean linear radiance; more than 0.  The error may be
        larger where edges touch each other: see `Certificate.error`.
    progress : callable
        Called repeatedly with the finished fraction of the picture.

    Returns
    -------
    certificate : Certificate
        The picture with its bounds.

    Raises
    ------
    ValueError
        If `error` is not positive, the eye is on a surface, or the distance of a light is more than
        1e14 times the size of the smallest object.
    RuntimeError
        If a sample contradicts the bounds: the certificate or the tracer is wrong.
    """
    if not error > 0:
        raise ValueError(f"the error must be more than 0, not {error}")
    picture = _Picture(scene, _ERROR_FOR_CELLS * error)
    stack = [make_initial_cells(picture.scene, scene.width, scene.height)]
    total_area = stack[0].area
    finished_area = 0.0
    while stack:
        cells = stack.pop()
        groups = picture.split_if_large(cells)
        if len(groups) > 1:
            stack += groups
            continue
        quarters = cells.split_into_quarters(scene.width, scene.height)
        pending_cells = picture.add_accurate_cells(quarters)
        finished_area += cells.area - pending_cells.area
        progress(finished_area / total_area)
        if pending_cells.x.size:
            stack.append(pending_cells)
    visible_part = slice(scene.height), slice(scene.width)
    # Radiance is never negative, but rounding errors can make a sum of enclosures negative.
    image = picture.image[(slice(None), *visible_part)].transpose(1, 2, 0).copy().clip(0)
    bound = picture.error_bound[visible_part][:, :, None] + _ROUNDING * image.max(initial=0)
    return Certificate(
        low=np.maximum(image - bound, 0),
        high=image + bound,
        image=image,
        cell_count=picture.cell_count,
    )
