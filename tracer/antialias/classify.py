"""Classify cells of the picture: can the sample at the centre represent the whole cell?

`classify_cells` traces one sample through the centre of each cell, and finds the edges that may
cross the cell: silhouettes, creases, intersections of surfaces, shadow edges and terminators.

cell
    A pixel, or a square part of a pixel.
center sample
    The sample whose ray passes through the centre of a cell.
footprint
    The part of a surface that is visible in a cell, around the hit of the cell's center sample.
id
    An integer that two samples share if they hit the same face of the same object, and the same
    lights are visible from both hits; -1 for the background.
smooth
    A cell is smooth if no edge crosses it.  Its mean radiance follows from center samples alone.
unresolved
    A cell is unresolved if it may contain something other than straight edges.
crowded
    A cell is crowded if finding all its edges would take longer than sampling it densely.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import chain
from typing import NamedTuple

import numpy as np

from tracer.antialias.edge_functions import EdgeValues, InverseDepth, Lines, compute_rays, fit_lines
from tracer.antialias.edges import CellSurfaces, compute_footprint_radii, evaluate_silhouettes
from tracer.antialias.lattice import Lattice, Points2D
from tracer.antialias.smooth import CenterSamples
from tracer.arrays import Bools, Floats, Ints, find, split_indices
from tracer.trace.lighting import Shading, compute_light_geometry, find_narrow_highlights
from tracer.trace.occlusion import find_shadow_edges
from tracer.trace.samples import Samples
from tracer.trace.visibility import find_nearest_and_hidden_hits
from tracer.world.prepared_scene import Lights, PreparedScene

# Shadow edges are searched for if a footprint's radius is at most this fraction of its distance
# from the light.  Tuned on the project's scenes: half as much increases errors by up to 1.4 times,
# twice as much by up to 1.2 times, and the time is the same.
_MAX_FOOTPRINT = 0.1

# Maximum number of lines that divide a cell into regions.  A cell may have more lines; samples must
# then show whether they matter.  Tuned on the project's scenes: with 2 lines errors are up to 1.6
# times as large, with 6 lines the time is up to 1.4 times as long.
MAX_LINES = 4

# In a scene with more than this many lights, each light contributes little, and a cell with more
# than `MAX_LINES` lines is crowded.  Tuned on a scene with 200 lights, where 16 samples per pixel
# would otherwise take twice as long.
_MAX_DETAILED_LIGHTS = 24


class Cells(NamedTuple):
    """Square cells of the picture (pixels, or parts of pixels), all of the same width.

    Attributes
    ----------
    width : float
        Width of each cell, in pixels.
    samples_per_side : int
        The result should be as accurate as a uniform grid of this many samples along each side.
    tolerance : float
        Maximum error of the mean radiance of a cell.
    center_x, center_y : (n,) float arrays
        Centres of the cells, in pixels from the upper left corner of the picture.
    pair_cell_index, pair_object_index : (m,) int arrays
        Indices of the cell and the object in each of m pairs: the object's silhouette may cross the
        cell.
    """

    width: float
    samples_per_side: int
    tolerance: float
    center_x: Floats
    center_y: Floats
    pair_cell_index: Ints
    pair_object_index: Ints

    def to_picture(self, cell_index: Ints, point_in_cell: Points2D) -> tuple[Floats, Floats]:
        """Convert points from cell coordinates to picture coordinates.

        Parameters
        ----------
        cell_index : (k,) int array
            Index of the cell (a pixel, or a square part of a pixel) that contains each point.
        point_in_cell : (k,) complex array
            Points x + iy relative to the centre of the cell, in units of the cell's width: x and y
            lie between -1/2 and 1/2.

        Returns
        -------
        x, y : (k,) float arrays
            The same points in pixels from the upper left corner of the picture.
        """
        x = self.center_x[cell_index] + self.width * point_in_cell.real
        return x, self.center_y[cell_index] + self.width * point_in_cell.imag

    def divide(self, cell_index: Ints) -> Cells:
        """Divide cells of the picture into quarters.

        Parameters
        ----------
        cell_index : (k,) int array
            Indices of the cells to divide, all different.

        Returns
        -------
        quarters : Cells
            The 4 k quarters: the four of the first cell, then the four of the second cell, and so
            on.  Each quarter has half the width and half the samples along each side, rounded up.
            It is paired with the same objects as the divided cell.
        """
        quarter_centers = np.tile(Lattice(2, 2).list_points(), cell_index.size)
        x, y = self.to_picture(cell_index.repeat(4), quarter_centers)
        divided_index = np.full(self.center_x.size, -1)  # of each cell; -1 if it is not divided
        divided_index[cell_index] = np.arange(cell_index.size)
        pair_divided_index = divided_index[self.pair_cell_index]
        kept_index = find(pair_divided_index >= 0)
        pair_quarter_index = (4 * pair_divided_index[kept_index, None] + np.arange(4)).ravel()
        pairs = pair_quarter_index, self.pair_object_index[kept_index].repeat(4)
        return Cells(self.width / 2, (self.samples_per_side + 1) // 2, self.tolerance, x, y, *pairs)


class Classification(NamedTuple):
    """Properties of n cells (pixels, or square parts of pixels).

    Attributes
    ----------
    cells : Cells
        The cells.
    center_samples : CenterSamples
        Radiance and id of the samples through the centres of the cells.
    lines : Lines
        Straight lines that divide the cells, at most `MAX_LINES` for each cell, sorted by cell.
    is_unresolved : (n,) bool array
        Whether the cell may contain something other than straight edges.
    is_crowded : (n,) bool array
        Whether finding all edges in the cell would take longer than sampling the cell densely.
    """

    cells: Cells
    center_samples: CenterSamples
    lines: Lines
    is_unresolved: Bools
    is_crowded: Bools


def classify_cells(
    scene: PreparedScene, cells: Cells, samples: Samples, sample_cell_index: Ints
) -> Classification:
    """Classify cells by the edges that may cross them.

    A cell is a pixel, or a square part of a pixel.  Edges are silhouettes, creases between faces,
    intersections of surfaces, shadow edges, and terminators (where a surface turns away from a
    light).  Silhouettes are computed for all (cell, object) pairs in `cells`.  All other edges are
    searched for around the hits of the samples.

    Parameters
    ----------
    scene : PreparedScene
        The scene, prepared for the camera.
    cells : Cells
        The n cells.
    samples : Rows or Scattered
        The n samples through the centres of the cells, in any order.
    sample_cell_index : (n,) int array
        Index of the cell of each sample.

    Returns
    -------
    classification : Classification
        The cells, their samples, and at most `MAX_LINES` straight lines for each cell.  A cell is
        unresolved if it may contain something other than straight edges.  It is crowded if finding
        all its edges would take longer than sampling it densely.
    """
    cell_count, tolerance = sample_cell_index.size, cells.tolerance
    radiance, center_id = np.empty((3, cell_count)), np.full(cell_count, -1)
    is_unresolved, is_crowded = np.zeros((2, cell_count), dtype=np.bool_)
    hits, hidden_hits = find_nearest_and_hidden_hits(scene, samples)
    hit_cell_index = sample_cell_index[hits.sample_index]
    inverse_depth, radius = InverseDepth.from_hits(hits), compute_footprint_radii(hits, cells.width)
    surfaces = CellSurfaces(hits, inverse_depth, hit_cell_index, radius, cells.width)
    silhouettes = _find_silhouettes_from_eye(scene, cells)
    edges = chain(silhouettes, surfaces.find_intersections(hidden_hits), surfaces.find_creases())
    geometry_lines, curved_cell_index = fit_lines(edges, tolerance)
    is_unresolved[curved_cell_index] = True
    shading, all_lines = Shading(hits, with_ids=True), [geometry_lines]
    for lights in scene.light_batches:
        light_lines, unresolved_index, crowded_index = _shade_and_find_edges(
            shading, surfaces, lights, tolerance
        )
        all_lines.append(light_lines)
        is_unresolved[unresolved_index], is_crowded[crowded_index] = True, True
    radiance[:, sample_cell_index] = shading.compute_radiance()
    # An id encodes the face that is hit, and the lights that are visible; -1 is the background.
    center_id[hit_cell_index] = shading.visibility_ids
    lines = Lines.concatenate(all_lines).sort_and_deduplicate()
    if scene.light_count > _MAX_DETAILED_LIGHTS:
        is_crowded |= np.bincount(lines.cell_index, minlength=cell_count) > MAX_LINES
    lines = lines.limit_per_cell(MAX_LINES)
    center_samples = CenterSamples(radiance, center_id)
    return Classification(cells, center_samples, lines, is_unresolved, is_crowded)


def _shade_and_find_edges(
    shading: Shading, surfaces: CellSurfaces, lights: Lights, tolerance: float
) -> tuple[Lines, Ints, Ints]:
    """Add lights to the radiance of hits, and find the edges that these lights cause.

    A cell is a pixel, or a square part of a pixel, with a hit at its centre.  The edges that may
    cross it are shadow edges and terminators (where a surface turns away from a light).

    Parameters
    ----------
    shading : Shading
        The radiance that the hits reflect, summed over lights.  The lights are added to it.
    surfaces : CellSurfaces
        The hit in each cell, and the surface around the hit.
    lights : Lights
        The lights to add.
    tolerance : float
        Maximum error of the mean radiance of a cell.

    Returns
    -------
    light_lines : Lines
        Straight lines that represent the edges.
    unresolved_index : (k,) int array
        Indices of cells that may contain a narrow highlight, or an edge that no line represents.
        An index may be repeated.
    crowded_index : (j,) int array
        Indices of cells in which finding all edges would take longer than dense sampling.
    """
    hits, hit_cell_index = surfaces.hits, surfaces.cell_index
    footprint_radius = surfaces.footprint_radius
    geometry = compute_light_geometry(hits, lights)
    faces_light = geometry.n_dot_l > 0
    # Cells with wide footprints are always divided, so their shadow edges are not needed.
    min_squared_distance = (footprint_radius / _MAX_FOOTPRINT) ** 2
    has_wide_footprint = np.any(geometry.squared_distance < min_squared_distance, axis=0)
    search_radius = np.where(has_wide_footprint, 0, footprint_radius)
    is_blocked, shadow_edges, is_crowded = find_shadow_edges(
        hits, lights, faces_light, search_radius
    )
    shading.add(geometry, faces_light & ~is_blocked)
    terminators = surfaces.find_terminators(geometry)
    edges = chain(surfaces.evaluate_shadow_edges(lights.near_position, shadow_edges), terminators)
    light_lines, curved_cell_index = fit_lines(edges, tolerance)
    highlights = find_narrow_highlights(geometry, faces_light, footprint_radius)
    highlight_indices = [hit_cell_index[hit_index] for hit_index in highlights]
    unsearched_index = hit_cell_index[has_wide_footprint | is_crowded]
    unresolved_index = np.concatenate([unsearched_index, curved_cell_index, *highlight_indices])
    return light_lines, unresolved_index, hit_cell_index[is_crowded]


def _find_silhouettes_from_eye(scene: PreparedScene, cells: Cells) -> Iterator[EdgeValues]:
    """Yield edge-function values for each silhouette edge that may cross a cell.

    A silhouette edge is part of the outline of an object, seen from the eye.  A sphere has one
    silhouette edge, a box has up to six.  The edge function is a function of the position in the
    picture that is zero on the edge.

    Parameters
    ----------
    scene : PreparedScene
        The scene, prepared for the camera.
    cells : Cells
        The cells (pixels, or square parts of pixels), and the (cell, object) pairs to search.

    Yields
    ------
    edge_values : EdgeValues
        For each edge, the index of the cell, and the edge function at six points of the cell (see
        `compute_rays`).
    """
    frame = scene.frame
    for batch in split_indices(np.arange(cells.pair_cell_index.size)):
        cell_index, object_index = cells.pair_cell_index[batch], cells.pair_object_index[batch]
        ray_x = frame.to_ray_x(cells.center_x[cell_index])
        ray_y = frame.to_ray_y(cells.center_y[cell_index])
        ray = compute_rays(frame, ray_x, ray_y, cells.width)
        candidates = np.array([np.zeros_like(cell_index), cell_index, object_index])
        yield from evaluate_silhouettes(scene, frame.eye[None], candidates, ray)
