"""Classify cells of the picture: can the center sample of a cell represent all of it?

A *cell* is a pixel, or a square part of a pixel.  `classify_cells` traces one *center sample*
through the centre of each cell, and finds the edges that may cross the cell: silhouettes, creases
between faces, intersections of surfaces, shadow edges, and terminators (where a surface turns away
from a light).  Silhouettes are computed for pairs of a cell and an object.  All other edges are
searched for in the *footprint* of a hit: the part of the surface that is visible in the cell.

- A cell is *smooth* if no edge crosses it.  Its mean radiance follows from center samples alone.
- It is *unresolved* if it may contain something other than straight edges.
- It is *crowded* if finding all its edges would take longer than sampling it densely.

The *id* of a sample is an integer that two samples share if they hit the same face of the same
object, and the same lights are visible from both hits; -1 for the background.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import chain
from typing import Annotated as Shaped
from typing import NamedTuple

import numpy as np

from tracer.antialias.edge_functions import (
    EdgeValues,
    Lines,
    compute_rays,
    fit_lines,
)
from tracer.antialias.edges import (
    CellSurfaces,
    ExtendedFaces,
    compute_footprint_radii,
    evaluate_silhouettes,
)
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
    """Square cells of the picture, all of the same width."""

    width: float  # of each cell, in pixels
    # The result should be as accurate as a uniform grid of this many samples along each side.
    samples_per_side: int
    tolerance: float  # maximum error of the mean radiance of a cell
    center_x: Shaped[Floats, "cells"]  # in pixels from the left edge of the picture
    center_y: Shaped[Floats, "cells"]  # in pixels from its upper edge
    # Pairs of a cell and an object whose silhouette may cross the cell.
    pair_cell_index: Shaped[Ints, "pairs"]
    pair_object_index: Shaped[Ints, "pairs"]

    def to_picture(
        self, cell_index: Shaped[Ints, "n"], point_in_cell: Shaped[Points2D, "n"]
    ) -> tuple[Shaped[Floats, "n"], Shaped[Floats, "n"]]:
        """Convert points in cells to x and y in the picture."""
        x = self.center_x[cell_index] + self.width * point_in_cell.real
        y = self.center_y[cell_index] + self.width * point_in_cell.imag
        return x, y

    def divide(self, cell_index: Shaped[Ints, "n"]) -> Cells:
        """Divide cells (all different) into quarters: the four of the first cell come first.

        Each quarter has half of the samples along each side, rounded up.  It is paired with the
        same objects as the divided cell.
        """
        quarter_centers = np.tile(Lattice(2, 2).list_points(), cell_index.size)
        x, y = self.to_picture(cell_index.repeat(4), quarter_centers)
        divided_index = np.full(self.center_x.size, -1)  # of each cell; -1 if it is not divided
        divided_index[cell_index] = np.arange(cell_index.size)
        pair_divided_index = divided_index[self.pair_cell_index]
        kept_index = find(pair_divided_index >= 0)
        return Cells(
            width=self.width / 2,
            samples_per_side=(self.samples_per_side + 1) // 2,
            tolerance=self.tolerance,
            center_x=x,
            center_y=y,
            pair_cell_index=(4 * pair_divided_index[kept_index, None] + np.arange(4)).ravel(),
            pair_object_index=self.pair_object_index[kept_index].repeat(4),
        )


class Classification(NamedTuple):
    """What `classify_cells` finds in cells, in the terms of this module's docstring."""

    cells: Cells
    center_samples: CenterSamples
    lines: Lines  # sorted by cell, at most `MAX_LINES` for each
    is_unresolved: Shaped[Bools, "cells"]
    is_crowded: Shaped[Bools, "cells"]


def classify_cells(
    scene: PreparedScene,
    cells: Cells,
    samples: Samples,
    sample_cell_index: Shaped[Ints, "cells"],
) -> Classification:
    """Classify cells by the edges that may cross them.

    The samples pass through the centres of the cells, in any order; `sample_cell_index` is the cell
    of each.
    """
    hits, hidden_hits = find_nearest_and_hidden_hits(scene, samples)
    surfaces = CellSurfaces(
        hits=hits,
        faces=ExtendedFaces.from_hits(hits),
        cell_index=sample_cell_index[hits.sample_index],
        footprint_radius=compute_footprint_radii(hits, cells.width),
        cell_width=cells.width,
    )
    geometry_edges = chain(
        _find_silhouettes_from_eye(scene, cells),
        surfaces.find_intersections(hidden_hits),
        surfaces.find_creases(),
    )
    geometry_fits = fit_lines(geometry_edges, cells.tolerance)
    shading = Shading(hits, with_ids=True)
    light_edges = [
        _shade_and_find_edges(shading, surfaces, lights, cells.tolerance)
        for lights in scene.iterate_light_batches()
    ]
    all_lines = Lines.concatenate([geometry_fits.lines, *(each.lines for each in light_edges)])
    lines = all_lines.sort_and_deduplicate()
    cell_count = sample_cell_index.size
    is_unresolved = _mark_cells(cell_count, (each.unresolved_index for each in light_edges))
    is_unresolved[geometry_fits.curved_cell_index] = True
    is_crowded = _mark_cells(cell_count, (each.crowded_index for each in light_edges))
    if scene.light_count > _MAX_DETAILED_LIGHTS:
        is_crowded |= np.bincount(lines.cell_index, minlength=cell_count) > MAX_LINES
    return Classification(
        cells=cells,
        center_samples=_collect_center_samples(shading, sample_cell_index, surfaces.cell_index),
        lines=lines.limit_per_cell(MAX_LINES),
        is_unresolved=is_unresolved,
        is_crowded=is_crowded,
    )


def _mark_cells(
    cell_count: int, index_arrays: Iterable[Shaped[Ints, "k"]]
) -> Shaped[Bools, "cell_count"]:
    is_marked = np.zeros(cell_count, dtype=np.bool_)
    for cell_index in index_arrays:
        is_marked[cell_index] = True
    return is_marked


def _collect_center_samples(
    shading: Shading,
    sample_cell_index: Shaped[Ints, "cells"],
    hit_cell_index: Shaped[Ints, "hits"],
) -> CenterSamples:
    """Collect the center samples in the order of the cells, once all lights have been added."""
    radiance = np.empty((3, sample_cell_index.size))
    radiance[:, sample_cell_index] = shading.compute_radiance()
    sample_id = np.full(sample_cell_index.size, -1)
    sample_id[hit_cell_index] = shading.visibility_ids
    return CenterSamples(radiance=radiance, id=sample_id)


class _LightEdges(NamedTuple):
    """The edges that lights cause: shadow edges and terminators.

    An index of a cell may be repeated.
    """

    lines: Lines
    # Cells that may contain a narrow highlight, or an edge that no line represents.
    unresolved_index: Shaped[Ints, "k"]
    crowded_index: Shaped[Ints, "j"]


def _shade_and_find_edges(
    shading: Shading, surfaces: CellSurfaces, lights: Lights, tolerance: float
) -> _LightEdges:
    """Add lights to the radiance of hits (`shading`), and find the edges that they cause."""
    hits = surfaces.hits
    hit_cell_index = surfaces.cell_index
    footprint_radius = surfaces.footprint_radius
    geometry = compute_light_geometry(hits, lights)
    faces_light = geometry.n_dot_l > 0
    # Cells with wide footprints become unresolved (`unsearched_index` below), whatever edges they
    # contain, so no shadow edges are searched for there.
    min_squared_distance = (footprint_radius / _MAX_FOOTPRINT) ** 2
    has_wide_footprint = np.any(geometry.squared_distance < min_squared_distance, axis=0)
    search_radius = np.where(has_wide_footprint, 0, footprint_radius)
    shadow_edges = find_shadow_edges(hits, lights, faces_light, search_radius)
    shading.add(geometry, faces_light & ~shadow_edges.is_blocked)
    terminators = surfaces.find_terminators(
        lights.near_position, geometry.n_dot_l, geometry.squared_distance
    )
    shadow_edge_values = surfaces.evaluate_shadow_edges(lights.near_position, shadow_edges.edges)
    edges = chain(shadow_edge_values, terminators)
    lines, curved_cell_index = fit_lines(edges, tolerance)
    highlights = find_narrow_highlights(geometry, faces_light, footprint_radius)
    highlight_indices = [hit_cell_index[hit_index] for hit_index in highlights]
    unsearched_index = hit_cell_index[has_wide_footprint | shadow_edges.is_crowded]
    return _LightEdges(
        lines=lines,
        unresolved_index=np.concatenate([unsearched_index, curved_cell_index, *highlight_indices]),
        crowded_index=hit_cell_index[shadow_edges.is_crowded],
    )


def _find_silhouettes_from_eye(scene: PreparedScene, cells: Cells) -> Iterator[EdgeValues]:
    """Yield the silhouette edges, seen from the eye, that may cross cells."""
    frame = scene.frame
    for batch in split_indices(np.arange(cells.pair_cell_index.size)):
        cell_index = cells.pair_cell_index[batch]
        object_index = cells.pair_object_index[batch]
        ray_x = frame.to_ray_x(cells.center_x[cell_index])
        ray_y = frame.to_ray_y(cells.center_y[cell_index])
        ray = compute_rays(frame, ray_x, ray_y, cells.width)
        yield from evaluate_silhouettes(
            scene,
            frame.eye[None],
            ray,
            viewpoint_index=np.zeros_like(cell_index),
            cell_index=cell_index,
            object_index=object_index,
        )
