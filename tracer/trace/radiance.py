"""Radiance at samples: find hits, then shadows, then add the light of each batch of lights."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Annotated as Shaped

import numpy as np

from tracer.arrays import Floats, Ints
from tracer.trace.hits import Hits
from tracer.trace.light_geometry import compute_light_geometry
from tracer.trace.lighting import Shading
from tracer.trace.occlusion import find_shadows
from tracer.trace.samples import Samples
from tracer.trace.visibility import find_nearest_hits
from tracer.world.prepared_scene import Lights, PreparedScene


def compute_radiance(
    scene: PreparedScene, samples: Samples, out: Shaped[Floats, "3 n"] | None = None
) -> Shaped[Floats, "3 n"]:
    """Compute the linear RGB radiance that reaches the eye along the ray through each sample.

    The radiance is 0 if the ray meets no surface.  If `out` is given, it must contain zeros, and is
    filled and returned.
    """
    hits = find_nearest_hits(scene, samples)
    return shade(hits, scene.iterate_light_batches()).compute_radiance(out)


def compute_radiance_and_visibility(
    scene: PreparedScene, samples: Samples
) -> tuple[Shaped[Floats, "3 n"], Shaped[Ints, "n"]]:
    """Compute the radiance of each sample, and an id of what is visible there.

    Two samples have the same id if their rays hit the same face of the same object, and the same
    lights are visible from both hits.  The id is -1 if the ray meets no surface.
    """
    hits = find_nearest_hits(scene, samples)
    shading = shade(hits, scene.iterate_light_batches(), with_ids=True)
    visibility_ids = np.full(samples.size, -1)
    visibility_ids[hits.sample_index] = shading.visibility_ids
    return shading.compute_radiance(), visibility_ids


def shade(hits: Hits, light_batches: Iterable[Lights], *, with_ids: bool = False) -> Shading:
    """Compute the light that each hit reflects to the eye, from lights that no object blocks.

    With `with_ids`, also compute `Shading.visibility_ids`.
    """
    shading = Shading(hits, with_ids=with_ids)
    for lights in light_batches:
        geometry = compute_light_geometry(hits, lights)
        is_lit = geometry.n_dot_l > 0
        is_lit &= ~find_shadows(hits, lights, is_lit)
        shading.add(geometry, is_lit)
    return shading
