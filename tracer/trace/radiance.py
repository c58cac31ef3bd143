"""Radiance at samples: hits, then shadows, then shading, some lights at a time."""

from __future__ import annotations

import numpy as np

from tracer.arrays import Floats, Ints
from tracer.trace.hits import Hits
from tracer.trace.lighting import Shading, light_geometry
from tracer.trace.occlusion import occlusion
from tracer.trace.samples import Samples
from tracer.trace.visibility import nearest_hits
from tracer.world.prepared_scene import PreparedScene


def radiance_at(prepared: PreparedScene, samples: Samples, out: Floats | None = None) -> Floats:
    """Radiance (3, n) at samples, towards the eye; put into `out`, zeros, if that is given."""
    shading = _shading(nearest_hits(prepared, samples), with_ids=False)
    return shading.at_samples(np.zeros((3, samples.size)) if out is None else out)


def radiance_and_ids(prepared: PreparedScene, samples: Samples) -> tuple[Floats, Ints]:
    """`radiance_at` and `Shading.ids` of samples; -1 where nothing is seen."""
    hits = nearest_hits(prepared, samples)
    shading, ids = _shading(hits, with_ids=True), np.full(samples.size, -1)
    ids[hits.sample] = shading.ids
    return shading.at_samples(np.zeros((3, samples.size))), ids


def _shading(hits: Hits, *, with_ids: bool) -> Shading:
    shading = Shading(hits, with_ids=with_ids)
    for lights in hits.prepared.light_batches:
        geometry = light_geometry(hits, lights)
        lit = geometry.n_dot_l > 0
        lit &= ~occlusion(hits, lights, lit)
        shading.add(geometry, lit)
    return shading
