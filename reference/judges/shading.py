"""Bound the radiance that faces reflect in cells of the picture, light by light.

A face reflects the intensity of a light times

    diffuse n.l + specular (n.h)^exponent.

Here n is the unit normal, l and v are the unit vectors to the light and to the eye, and h is the
unit vector halfway between l and v.  All these vary with the position in the cell.  Polynomials
with error bounds (see `enclosures`) enclose n.l, n.h and the radiance.

Positions are relative to the eye.  The camera ray with direction d meets the face at p = t d, and
the light is at q.  All lengths are divided by t, because 1 / t has a narrow enclosure (see
`cell_analysis`).

A *pair* is a face that may be visible in a cell.  A light is *settled* for a pair if it is known to
reach all of the face in the cell, or none of it (see `cells`).
"""

from __future__ import annotations

from typing import Annotated as Shaped
from typing import NamedTuple

import numpy as np

from reference.judges.arrays import Bools, Ints, add_at_sorted_index
from reference.judges.cell_analysis import CellAnalysis
from reference.judges.cells import Contributions
from reference.judges.enclosures import Enclosures

# Squared distances, and |l + v|^2 of two unit vectors, are positive.  Their lower bounds are raised
# to this number before a negative power is computed.
_MIN_SQUARE = 1e-300


def shade(
    analysis: CellAnalysis, is_requested: Shaped[Bools, "pairs"], permitted_error: float
) -> Contributions:
    """Bound the radiance that requested pairs reflect from each light, and settle lights.

    The radiance of a light that becomes settled is added to `analysis.cells.radiance`.  The
    radiance of the lights that remain unsettled is returned.

    A light becomes settled for a pair if none of its shadow edges and terminators (borders between
    the lit and the dark side of a face) can cross the cell, and if the error of its radiance in
    each channel is at most `permitted_error` divided by the number of lights.
    """
    cells = analysis.cells
    contributions = _enclose_contributions(analysis, is_requested)
    max_light_error = permitted_error / cells.is_settled.shape[1]
    is_accurate = contributions.radiance.max_deviation.max(axis=0) <= max_light_error
    may_have_edge = _find_lights_with_edges(analysis)
    has_edge = may_have_edge[contributions.pair_index, contributions.light_index]
    is_newly_settled = is_accurate & ~has_edge
    pair_index, light_index, radiance = contributions.select(is_newly_settled)
    add_at_sorted_index(cells.radiance.coefficients, pair_index, radiance.coefficients)
    cells.is_settled[pair_index, light_index] = True
    return contributions.select(~is_newly_settled)


def _find_lights_with_edges(analysis: CellAnalysis) -> Shaped[Bools, "pairs lights"]:
    """Find for each pair the lights that may reach only a part of the face in the cell.

    They are lights that an object may block, and lights with an edge in the cell.
    """
    has_edge = np.zeros_like(analysis.cells.is_settled)
    pair_index, light_index, _ = analysis.cells.shadow_triples
    has_edge[pair_index, light_index] = True
    for pair_index, light_index, _ in analysis.edges:
        is_of_light = light_index >= 0  # -1: the visible face changes at the edge
        has_edge[pair_index[is_of_light], light_index[is_of_light]] = True
    return has_edge


def _enclose_contributions(
    analysis: CellAnalysis, is_requested: Shaped[Bools, "pairs"]
) -> Contributions:
    """Enclose the radiance that requested pairs reflect from each light that is not settled.

    The result is sorted by pair and light.  Whether an object blocks the light is not tested: it is
    the radiance wherever the light reaches the face.
    """
    faces, cells, lights = analysis.faces, analysis.cells, analysis.scene.lights
    scene = analysis.scene.prepared_scene
    pair_index, light_index = np.nonzero(~cells.is_settled & is_requested[:, None])
    terms = _enclose_light_terms(analysis, pair_index, light_index)
    intensity = lights.intensity[light_index].T
    object_index = faces.object_index[cells.face_index[pair_index]]
    radiance = terms.n_dot_l.coefficients[:, None] * (intensity * scene.diffuse[:, object_index])
    # Only glossy faces have a highlight.
    glossy_index = np.flatnonzero(scene.is_glossy[object_index])
    glossy_object_index = object_index[glossy_index]
    n_dot_h = _enclose_n_dot_h(analysis, pair_index[glossy_index], terms.take(glossy_index))
    exponent = scene.exponent[glossy_object_index]
    cosine_power = n_dot_h.power(exponent, 0.0, 1.0).fall_back_to_unit_interval()
    specular = intensity[:, glossy_index] * scene.specular[:, glossy_object_index]
    radiance[..., glossy_index] += cosine_power.coefficients[:, None] * specular
    return Contributions(
        pair_index=pair_index, light_index=light_index, radiance=Enclosures(radiance)
    )


class _LightTerms(NamedTuple):
    """Enclosures (8, n) of terms that depend on one light and on the point that the eye sees."""

    n_dot_l: Enclosures  # in [0, 1]
    inverse_light_distance: Enclosures  # of t / |q - p|
    light_dot_eye: Enclosures  # of (q - p).(-p) / t^2, the product of the vectors to light and eye

    def take(self, index: Shaped[Ints, "k"]) -> _LightTerms:
        return _LightTerms._make(field[index] for field in self)


def _enclose_light_terms(
    analysis: CellAnalysis, pair_index: Shaped[Ints, "n"], light_index: Shaped[Ints, "n"]
) -> _LightTerms:
    """Enclose the terms of n combinations of a pair and a light, which have the given indices."""
    cell_index = analysis.cells.cell_index[pair_index]
    position = analysis.scene.lights.from_eye[light_index].T
    squared_ray_length = analysis.squared_ray_length[cell_index]
    # With p = t d, |q - p|^2 / t^2 = d^2 - 2 q.d / t + q^2 / t^2, and (q - p).(-p) / t^2 =
    # d^2 - q.d / t.
    q_dot_d = analysis.dot_with_rays(position, cell_index)
    q_dot_d_over_t = analysis.inverse_distance[pair_index] * q_dot_d
    squared_inverse_distance = (analysis.inverse_distance * analysis.inverse_distance)[pair_index]
    squared_light_distance = squared_ray_length - q_dot_d_over_t * 2.0
    squared_light_distance += squared_inverse_distance * (position * position).sum(axis=0)
    inverse_light_distance = squared_light_distance.power(-0.5, _MIN_SQUARE)
    # The height of the light above the tangent plane, divided by t, is n.(q - p) / t.
    light_height = analysis.enclose_functions(
        analysis.express_light_height(pair_index, light_index)
    )
    return _LightTerms(
        n_dot_l=(light_height * inverse_light_distance).fall_back_to_unit_interval(),
        inverse_light_distance=inverse_light_distance,
        light_dot_eye=squared_ray_length - q_dot_d_over_t,
    )


def _enclose_n_dot_h(
    analysis: CellAnalysis, pair_index: Shaped[Ints, "n"], terms: _LightTerms
) -> Enclosures:
    """Enclose n.h (8, n), which is (n.l + n.v) / |l + v|, where |l + v|^2 = 2 + 2 l.v.

    `terms` are the terms of n combinations of a pair and a light.  `pair_index` names their pairs,
    which may occur several times, with several lights.
    """
    cell_index = analysis.cells.cell_index
    distinct_pair_index, pair_number = np.unique(pair_index, return_inverse=True)
    inverse_ray_length = analysis.squared_ray_length.power(-0.5)  # 1 / |d|
    eye_height = analysis.enclose_functions(analysis.express_light_height(distinct_pair_index, -1))
    n_dot_v = eye_height * inverse_ray_length[cell_index[distinct_pair_index]]
    scale = terms.inverse_light_distance * inverse_ray_length[cell_index[pair_index]]
    l_dot_v = terms.light_dot_eye * scale
    inverse_length_of_sum = (l_dot_v * 2.0 + 2.0).power(-0.5, _MIN_SQUARE)  # 1 / |l + v|
    n_dot_sum = terms.n_dot_l + n_dot_v[pair_number]
    return (n_dot_sum * inverse_length_of_sum).fall_back_to_unit_interval()
