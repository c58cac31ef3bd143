"""Decide by exact arithmetic which of two pictures is wrong: the tracer's or Mitsuba's.

The pixels in which the pictures differ are traced in decimal arithmetic (see `plain`).  A pixel is
*right* if its radiance is exact within a tolerance.  A pixel that is right in both pictures is a
*tie*.  There are ties for two reasons.  Where surfaces coincide, the tracer must show the one that
comes first in the scene file, but Mitsuba may also show the last.  And beside an edge, rounding may
decide on which side of it a sample lies.  So a pixel is also right if it is right in a scene so
similar that float64 may be unable to tell the two apart.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from typing import Annotated as Shaped
from typing import NamedTuple

import numpy as np

from reference.judges import plain
from reference.judges.arrays import Bools, Floats
from tracer import Scene, Sphere, Surfaces

# Number of pixels that are traced in one batch of exact arithmetic, which is slow.  Each batch is
# spread over the whole picture, so the first batch often suffices.
_PIXELS_PER_BATCH = 100

# If the radius of a sphere changes by this fraction, float64 may be unable to tell the difference.
_MAX_GROWTH = 1e-12

# If a sample moves by this many pixels, float64 may be unable to tell the difference.
_MAX_SHIFT = 1e-6


class JudgedPixels(NamedTuple):
    """Masks of the pixels that exact arithmetic has judged."""

    is_tie: Shaped[Bools, "height width"]  # right in both pictures
    is_examined: Shaped[Bools, "height width"]  # wrong in at least one of the pictures
    is_wrong: Shaped[Bools, "height width"]  # wrong in the tracer's picture


def judge_differing_pixels(
    scene: Scene,
    tracer_image: Shaped[Floats, "height width 3"],
    mitsuba_image: Shaped[Floats, "height width 3"],
    is_different: Shaped[Bools, "height width"],
    tolerance: float,
) -> JudgedPixels:
    """Decide by exact arithmetic which of two pictures is wrong where they differ.

    Pixels are judged in batches, until a batch contains one that is not a tie.  In the masks that
    are returned, all other pixels are False.

    Parameters
    ----------
    is_different
        Whether the pictures differ in a pixel.  Only such pixels are judged.
    tolerance
        Maximum error of a channel's radiance that counts as right.
    """
    is_tie, is_examined, is_wrong = np.zeros((3, *is_different.shape), dtype=np.bool_)
    positions = np.argwhere(is_different)
    batch_count = -(-len(positions) // _PIXELS_PER_BATCH)
    for batch_index in range(batch_count):
        rows, columns = positions[batch_index::batch_count].T
        radiance = np.stack([tracer_image[rows, columns], mitsuba_image[rows, columns]])
        x, y = columns + 0.5, rows + 0.5  # the centres of the pixels
        tracer_is_right, mitsuba_is_right = _find_right_pixels(scene, x, y, radiance, tolerance)
        is_batch_tie = tracer_is_right & mitsuba_is_right
        is_tie[rows, columns] = is_batch_tie
        if not is_batch_tie.all():
            is_examined[rows, columns] = ~is_batch_tie
            is_wrong[rows, columns] = ~tracer_is_right
            break
    return JudgedPixels(is_tie=is_tie, is_examined=is_examined, is_wrong=is_wrong)


def _find_right_pixels(
    scene: Scene,
    x: Shaped[Floats, "n"],
    y: Shaped[Floats, "n"],
    radiance: Shaped[Floats, "2 n 3"],
    tolerance: float,
) -> tuple[Shaped[Bools, "n"], Shaped[Bools, "n"]]:
    """Find out where the tracer's and where Mitsuba's radiance is right, in exact arithmetic.

    `radiance` is first the tracer's and then Mitsuba's, at the positions (x, y) in the picture.  It
    is right if it is exact within the tolerance for the scene or for one of the similar scenes.
    Once the tracer is right at all positions, no more scenes are tried.
    """
    tracer_is_right, mitsuba_is_right = np.zeros((2, x.size), dtype=np.bool_)
    for similar_scene, shift in _generate_similar_scenes(scene):
        trace = partial(plain.trace, similar_scene, x + shift, y + shift, arithmetic="decimal")
        tracer_shows_first, mitsuba_shows_first = _is_close(
            trace(ties="first"), radiance, tolerance
        )
        _, mitsuba_shows_last = _is_close(trace(ties="last"), radiance, tolerance)
        tracer_is_right |= tracer_shows_first
        mitsuba_is_right |= mitsuba_shows_first | mitsuba_shows_last
        if tracer_is_right.all():
            break
    return tracer_is_right, mitsuba_is_right


def _is_close(
    rays: plain.TracedRays, radiance: Shaped[Floats, "2 n 3"], tolerance: float
) -> Shaped[Bools, "2 n"]:
    """Test whether each radiance equals that of its ray within the tolerance, in all channels."""
    return np.asarray(np.abs(radiance - rays.radiance).max(axis=2) <= tolerance)


def _generate_similar_scenes(scene: Scene) -> Iterator[tuple[Scene, float]]:
    """Yield a scene, and variations so similar that float64 may be unable to tell them apart.

    Yield with each scene the distance in pixels by which to shift its samples right and down.  In
    some variations, only the samples are shifted; in others, all spheres are smaller or larger.
    """
    for shift in (0.0, -_MAX_SHIFT, _MAX_SHIFT):
        yield scene, shift
    for radius_factor in (1 - _MAX_GROWTH, 1 + _MAX_GROWTH):
        surfaces = (
            replace(item, radius=item.radius * radius_factor) if isinstance(item, Sphere) else item
            for item in scene.surfaces
        )
        yield replace(scene, surfaces=Surfaces.from_objects(surfaces)), 0.0
