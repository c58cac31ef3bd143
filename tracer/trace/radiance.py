"""Radiance at samples: find hits, then shadows, then add the light of each batch of lights."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from tracer.arrays import Floats, Ints
from tracer.trace.hits import Hits
from tracer.trace.lighting import Shading, light_geometry
from tracer.trace.occlusion import occlusion
from tracer.trace.samples import Samples
from tracer.trace.visibility import nearest_hits
from tracer.world.prepared_scene import Lights, PreparedScene


def radiance_at(prepared: PreparedScene, samples: Samples, out: Floats | None = None) -> Floats:
    """Compute the radiance that reaches the eye along the ray of each sample.

    Parameters
    ----------
    prepared : PreparedScene
        The scene.
    samples : Rows or Scattered
        The n samples.
    out : (3, n) float array of zeros, optional
        Receives the result: a picture is too large for a copy.

    Returns
    -------
    radiance : (3, n) float array
        Linear RGB radiance; 0 if the ray meets no surface.
    """
    hits = nearest_hits(prepared, samples)
    return shade(hits, prepared.light_batches).radiance(out)


def radiance_and_ids(prepared: PreparedScene, samples: Samples) -> tuple[Floats, Ints]:
    """Compute the radiance, and an id, of each of n samples.

    Parameters
    ----------
    prepared : PreparedScene
        The scene.
    samples : Rows or Scattered
        The samples.

    Returns
    -------
    radiance : (3, n) float array
        The same as from `radiance_at`.
    ids : (n,) int array
        Two samples have the same id if they see the same face of the same object, and the same
        lights reach both; -1 if the ray meets no surface.
    """
    hits = nearest_hits(prepared, samples)
    shading = shade(hits, prepared.light_batches, with_ids=True)
    ids = np.full(samples.size, -1)
    ids[hits.sample] = shading.ids
    return shading.radiance(), ids


def shade(hits: Hits, light_batches: Iterable[Lights], *, with_ids: bool = False) -> Shading:
    """Add up the light that reaches hits.

    Parameters
    ----------
    hits : Hits
        The hits.
    light_batches : iterable of Lights
        The lights, in batches.
    with_ids : bool
        Whether `Shading.ids` is needed.
    """
    shading = Shading(hits, with_ids=with_ids)
    for lights in light_batches:
        geometry = light_geometry(hits, lights)
        is_lit = geometry.n_dot_l > 0
        is_lit &= ~occlusion(hits, lights, is_lit)
        shading.add(geometry, is_lit)
    return shading
