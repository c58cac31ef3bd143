"""Enclose the radiance that faces reflect in cells of the picture, light by light.

Pairs, settled lights and triples are defined in `cells`, and visible points in `cell_analysis`.
"""

from __future__ import annotations

from typing import Annotated as Shaped

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
    """Compute the radiance from unsettled lights, and settle those with accurate results.

    A light is settled if no terminator or shadow edge of the light can cross the cell, and the
    error of its radiance, in each channel, is at most `permitted_error` divided by the number of
    lights.  Its radiance is then added to `analysis.cells.radiance`.  Return the radiance that each
    remaining unsettled light adds to each requested pair.
    """
    contributions = _enclose_contributions(analysis, is_requested)
    cells = analysis.cells
    has_edge = np.zeros_like(cells.is_settled)
    has_edge[cells.shadow_triples[0], cells.shadow_triples[1]] = True
    for pair_index, light_index, _ in analysis.edges:
        has_edge[pair_index[light_index >= 0], light_index[light_index >= 0]] = True
    max_light_error = permitted_error / cells.is_settled.shape[1]
    is_newly_settled = ~has_edge[contributions.pair_index, contributions.light_index]
    is_newly_settled &= contributions.radiance.max_deviation.max(axis=0) <= max_light_error
    pair_index, light_index, radiance = contributions.select(is_newly_settled)
    add_at_sorted_index(cells.radiance.coefficients, pair_index, radiance.coefficients)
    cells.is_settled[pair_index, light_index] = True
    return contributions.select(~is_newly_settled)


def _enclose_contributions(
    analysis: CellAnalysis, is_requested: Shaped[Bools, "pairs"]
) -> Contributions:
    """Enclose the radiance that lit points of a face reflect from each unsettled light."""
    faces, cells, scene = analysis.faces, analysis.cells, analysis.faces.prepared_scene
    pair_index, light_index = np.nonzero(~cells.is_settled & is_requested[:, None])
    cell_index = cells.cell_index[pair_index]
    object_index = faces.object_index[cells.face_index[pair_index]]
    light_position = faces.light_position[light_index].T
    squared_ray_length = analysis.squared_ray_length[cell_index]
    # The ray with direction d meets the face at p = t d, relative to the eye.  All lengths are
    # divided by t, and squared lengths by t^2.  For a light at q, this gives
    #     |q - p|^2 = d^2 - 2 q.d / t + q^2 / t^2  and  (q - p).(-p) = d^2 - q.d / t.
    q_dot_d = analysis.dot_with_rays(light_position, cell_index)
    q_dot_d_over_t = analysis.inverse_distance[pair_index] * q_dot_d
    inverse_distance2 = (analysis.inverse_distance * analysis.inverse_distance)[pair_index]
    light_distance2 = squared_ray_length - q_dot_d_over_t * 2.0
    light_distance2 += inverse_distance2 * (light_position * light_position).sum(axis=0)
    inverse_light_distance = light_distance2.power(-0.5, _MIN_SQUARE)  # t / |q - p|
    light_height = analysis.enclose_functions(
        analysis.express_light_height(pair_index, light_index)
    )
    n_dot_l = (light_height * inverse_light_distance).fall_back_to_unit_interval()
    intensity = faces.prepared_lights.intensity[light_index].T
    radiance = n_dot_l.coefficients[:, None] * (intensity * scene.diffuse[:, object_index])
    # Only glossy faces have a highlight.
    glossy_index = np.flatnonzero(scene.is_glossy[object_index])
    glossy_object_index = object_index[glossy_index]
    n_dot_h = _enclose_n_dot_h(
        analysis,
        pair_index[glossy_index],
        n_dot_l[glossy_index],
        inverse_light_distance[glossy_index],
        (squared_ray_length - q_dot_d_over_t)[glossy_index],
    )
    exponent = scene.exponent[glossy_object_index]
    cosine_power = n_dot_h.power(exponent, 0.0, 1.0).fall_back_to_unit_interval()
    specular = intensity[:, glossy_index] * scene.specular[:, glossy_object_index]
    radiance[..., glossy_index] += cosine_power.coefficients[:, None] * specular
    return Contributions(
        pair_index=pair_index, light_index=light_index, radiance=Enclosures(radiance)
    )


def _enclose_n_dot_h(
    analysis: CellAnalysis,
    pair_index: Shaped[Ints, "n"],
    n_dot_l: Enclosures,
    inverse_light_distance: Enclosures,
    light_dot_eye: Enclosures,
) -> Enclosures:
    """Enclose n.h (8, n) at the visible point, for some pairs and lights, sorted by pair.

    Let n be the unit normal, l and v the unit vectors to the light and to the eye, and h the unit
    vector halfway between l and v.  Then n.h = (n.l + n.v) / |l + v|, and |l + v|^2 = 2 + 2 l.v.
    `light_dot_eye` encloses (q - p).(-p) / t^2, with the visible point p = t d and the light q.
    """
    cell_index = analysis.cells.cell_index
    distinct_pair_index, pair_number = np.unique(pair_index, return_inverse=True)
    inverse_ray_length = analysis.squared_ray_length.power(-0.5)  # 1 / |d|
    eye_height = analysis.enclose_functions(analysis.express_light_height(distinct_pair_index, -1))
    n_dot_v = eye_height * inverse_ray_length[cell_index[distinct_pair_index]]
    scale = inverse_light_distance * inverse_ray_length[cell_index[pair_index]]
    l_dot_v = light_dot_eye * scale
    inverse_sum = (l_dot_v * 2.0 + 2.0).power(-0.5, _MIN_SQUARE)  # 1 / |l + v|
    n_dot_sum = n_dot_l + n_dot_v[pair_number]
    return (n_dot_sum * inverse_sum).fall_back_to_unit_interval()
