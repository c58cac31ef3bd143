"""Classify cells of the picture: can the center sample of a cell represent all of it?

A *cell* is a pixel, or a square part of a pixel.  `classify_cells` traces one *center sample*
through the center of each cell, and finds the edges that may cross the cell: silhouettes, creases
between faces, intersections of surfaces, shadow edges, and terminators (where a surface turns away
from a light).

An edge that is almost straight within the cell is represented by a *line*.

- A cell is *smooth* if no edge crosses it.  Its mean radiance follows from center samples alone.
- It is *unresolved* if it may contain something that no line represents: a curved edge, a narrow
  highlight, or a shadow edge where shadow edges were not searched for.
- It is *crowded* if very many shadow edges of one light, or very many lines in a scene of many
  lights, may cross it.  Sampling it densely then takes less time than dividing it at all of them.

The *id* of a sample is an integer that two samples share if they hit the same face of the same
object, and the same lights are visible from both hits; -1 for the background.
"""

from __future__ import annotations

from collections.abc import Iterable
from itertools import chain
from typing import Annotated as Shaped
from typing import NamedTuple

import numpy as np

from tracer.antialias.cells import Cells
from tracer.antialias.edge_functions import Lines, fit_lines
from tracer.antialias.edges import CellSurfaces, find_silhouettes_from_eye
from tracer.antialias.smooth import CenterSamples
from tracer.arrays import Bools, Ints
from tracer.trace.hits import Hits
from tracer.trace.light_geometry import LightGeometry, compute_light_geometry
from tracer.trace.lighting import Shading
from tracer.trace.narrow_highlights import find_narrow_highlights
from tracer.trace.occlusion import ShadowEdges, find_shadow_edges
from tracer.trace.samples import Samples
from tracer.trace.visibility import find_nearest_and_hidden_hits
from tracer.world.prepared_scene import Lights, PreparedScene

# Shadow edges are searched for if the radius of the surface that is visible in the cell is at most
# this fraction of its distance from the light.  On the project's scenes, half as much increases
# errors by up to 1.4 times, twice as much by up to 1.2 times, and the time is the same.
_MAX_FOOTPRINT = 0.1

# Maximum number of lines that divide a cell into regions.  A cell may have more lines; samples must
# then show whether they matter.  On the project's scenes, errors with 2 lines are up to 1.6 times
# as large, and the time with 6 lines is up to 1.4 times as long.
MAX_LINES = 4

# In a scene with more than this many lights, each light contributes little, and a cell with more
# than `MAX_LINES` lines is crowded.  Otherwise, a scene with 200 lights would take twice as long as
# with 16 samples in every pixel.
_MAX_DETAILED_LIGHTS = 24


class Classification(NamedTuple):
    """What `classify_cells` finds in cells; the docstring of this module defines the terms."""

    cells: Cells
    center_samples: CenterSamples
    lines: Lines  # sorted by cell, at most `MAX_LINES` for each cell
    is_unresolved: Shaped[Bools, "cells"]
    is_crowded: Shaped[Bools, "cells"]


def classify_cells(
    scene: PreparedScene,
    cells: Cells,
    samples: Samples,
    sample_cell_index: Shaped[Ints, "cells"],
) -> Classification:
    """Trace the center samples of cells, and classify the cells by the edges that may cross them.

    `samples` are the center samples of all cells, in any order.  `sample_cell_index` contains the
    index of the cell of each sample.
    """
    hits, hidden_hits = find_nearest_and_hidden_hits(scene, samples)
    hit_cell_index = sample_cell_index[hits.sample_index]
    surfaces = CellSurfaces.from_hits(hits, hit_cell_index, cells.width)
    shading = Shading(hits, with_ids=True)
    found = [_find_edges_of_surfaces(scene, cells, surfaces, hidden_hits)]
    for lights in scene.iterate_light_batches():
        lit_surfaces = _LitSurfaces.from_lights(surfaces, lights)
        shading.add(lit_surfaces.geometry, lit_surfaces.is_lit)
        found.append(lit_surfaces.find_edges(cells.tolerance))
        del lit_surfaces  # before the arrays of the next lights take memory, too
    lines = Lines.concatenate([each.lines for each in found]).sort_and_deduplicate()
    cell_count = sample_cell_index.size
    is_crowded = _mark_cells(cell_count, [each.crowded_index for each in found])
    if scene.light_count > _MAX_DETAILED_LIGHTS:
        is_crowded |= np.bincount(lines.cell_index, minlength=cell_count) > MAX_LINES
    return Classification(
        cells=cells,
        center_samples=_collect_center_samples(shading, sample_cell_index, hit_cell_index),
        lines=lines.limit_per_cell(MAX_LINES),
        is_unresolved=_mark_cells(cell_count, [each.unresolved_index for each in found]),
        is_crowded=is_crowded,
    )


class _FoundEdges(NamedTuple):
    """The edges of one kind that may cross cells.

    In the arrays of cell indices, an index may be repeated.
    """

    lines: Lines
    unresolved_index: Shaped[Ints, "k"]  # cells in which lines do not represent everything
    crowded_index: Shaped[Ints, "j"]  # cells with too many shadow edges of one light


def _find_edges_of_surfaces(
    scene: PreparedScene, cells: Cells, surfaces: CellSurfaces, hidden_hits: Hits
) -> _FoundEdges:
    """Find the edges that do not depend on lights: silhouettes, intersections and creases.

    The hidden hits lie behind the hits of `surfaces`, on the same rays from the eye.
    """
    silhouettes = find_silhouettes_from_eye(scene, cells)
    intersections = surfaces.find_intersections(hidden_hits)
    edges = chain(silhouettes, intersections, surfaces.find_creases())
    lines, curved_cell_index = fit_lines(edges, cells.tolerance)
    no_index = np.zeros(0, dtype=np.intp)
    return _FoundEdges(lines=lines, unresolved_index=curved_cell_index, crowded_index=no_index)


class _LitSurfaces(NamedTuple):
    """How a batch of lights illuminates the surfaces that are visible at the centers of cells."""

    surfaces: CellSurfaces
    geometry: LightGeometry  # of the lights and of the hits on the surfaces
    faces_light: Shaped[Bools, "lights hits"]  # whether the surface faces the light at the hit
    # Whether a light is so near that shadow edges are not searched for (see `_MAX_FOOTPRINT`).
    is_near_light: Shaped[Bools, "hits"]
    shadow_edges: ShadowEdges

    @classmethod
    def from_lights(cls, surfaces: CellSurfaces, lights: Lights) -> _LitSurfaces:
        """Find out which lights illuminate each hit, and which shadow edges may be near the hit."""
        geometry = compute_light_geometry(surfaces.hits, lights)
        faces_light = geometry.n_dot_l > 0
        min_squared_distance = (surfaces.footprint_radius / _MAX_FOOTPRINT) ** 2
        is_near_light = np.any(geometry.squared_distance < min_squared_distance, axis=0)
        search_radius = np.where(is_near_light, 0, surfaces.footprint_radius)
        return cls(
            surfaces=surfaces,
            geometry=geometry,
            faces_light=faces_light,
            is_near_light=is_near_light,
            shadow_edges=find_shadow_edges(surfaces.hits, lights, faces_light, search_radius),
        )

    @property
    def is_lit(self) -> Shaped[Bools, "lights hits"]:
        """Whether the light illuminates the hit."""
        return self.faces_light & ~self.shadow_edges.is_blocked

    def find_edges(self, tolerance: float) -> _FoundEdges:
        """Find the shadow edges and the terminators that may cross cells.

        `tolerance` is the maximum error of the mean radiance of a cell.
        """
        surfaces = self.surfaces
        geometry = self.geometry
        light_position = geometry.lights.near_position
        edges = chain(
            surfaces.find_shadow_edges(light_position, self.shadow_edges.edges),
            surfaces.find_terminators(light_position, geometry.n_dot_l, geometry.squared_distance),
        )
        lines, curved_cell_index = fit_lines(edges, tolerance)
        hit_cell_index = surfaces.cell_index
        highlights = find_narrow_highlights(geometry, self.faces_light, surfaces.footprint_radius)
        highlight_indices = [hit_cell_index[hit_index] for hit_index in highlights]
        # `shadow_edges` omits some edges of crowded hits, which have too many.
        is_crowded = self.shadow_edges.is_crowded
        unsearched_index = hit_cell_index[self.is_near_light | is_crowded]
        return _FoundEdges(
            lines=lines,
            unresolved_index=np.concatenate(
                [unsearched_index, curved_cell_index, *highlight_indices]
            ),
            crowded_index=hit_cell_index[is_crowded],
        )


def _mark_cells(
    cell_count: int, index_arrays: Iterable[Shaped[Ints, "k"]]
) -> Shaped[Bools, "cell_count"]:
    """Return True for each cell whose index is in at least one of the arrays."""
    is_marked = np.zeros(cell_count, dtype=np.bool_)
    for cell_index in index_arrays:
        is_marked[cell_index] = True
    return is_marked


def _collect_center_samples(
    shading: Shading,
    sample_cell_index: Shaped[Ints, "cells"],
    hit_cell_index: Shaped[Ints, "hits"],
) -> CenterSamples:
    """Collect the radiance and the id of each center sample, in the order of the cells.

    `hit_cell_index` contains the cell of each hit in `shading`.  Add all lights to `shading` first.
    Samples without a hit get the id -1.
    """
    radiance = np.empty((3, sample_cell_index.size))
    radiance[:, sample_cell_index] = shading.compute_radiance()
    sample_id = np.full(sample_cell_index.size, -1)
    sample_id[hit_cell_index] = shading.visibility_ids
    return CenterSamples(radiance=radiance, id=sample_id)
