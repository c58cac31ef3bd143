"""The comparison can fail: it catches each of these mistakes of a tracer; SSIM alone does not.

Each mistake is made by changing the scene or the picture, so that the tracer itself stays as it
is.  The reference is Mitsuba's stored picture.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from mistakes import no_highlights, no_shadows, visible

from reference.check import MAX_DIFFERENCE, MIN_SSIM, edge_mask, faults
from reference.command import SCENES
from reference.compare import figures
from reference.regenerate import load_small, stored
from tracer import Box, Scene, render
from tracer.arrays import Floats

pytestmark = pytest.mark.cross_validation


def wrong_gamma(scene: Scene) -> Floats:
    """Encoded with 1.8 and, like all pictures, shown with 2.2."""
    image: Floats = np.clip(render(scene), 0, 1) ** (2.2 / 1.8)
    return image


def falling_off(scene: Scene) -> Floats:
    """Lights as strong as they should be at the middle distance, but falling off."""
    points = visible(scene).point.reshape(scene.height, scene.width, 3)
    image = np.zeros((scene.height, scene.width, 3))
    for light in scene.lights:
        distance2 = ((points - light.position) ** 2).sum(axis=2)
        falloff = np.nanmedian(distance2) / distance2
        alone = render(replace(scene, lights=(light,)))
        image += np.where(np.isnan(falloff), 0, falloff)[:, :, None] * alone
    return image


def brighter(scene: Scene) -> Floats:
    """All of it by 2 %."""
    return render(scene) * 1.02


def half_pixel(scene: Scene) -> Floats:
    """Samples at the pixels' corners."""
    return render(scene, offset=(0.5, 0.5))


def mirrored(scene: Scene) -> Floats:
    """Right is left."""
    return render(scene)[:, ::-1]


def boxes_out(scene: Scene) -> Floats:
    """Boxes one unit beside where they should be."""

    def moved(box: Box) -> Box:
        (x0, y0, z0), (x1, y1, z1) = box.min_pt, box.max_pt
        return replace(box, min_pt=(x0 + 1, y0, z0), max_pt=(x1 + 1, y1, z1))

    surfaces = [moved(s) if isinstance(s, Box) else s for s in scene.surfaces]
    return render(replace(scene, surfaces=surfaces))


# What is usually asked of SSIM between two renderers.  The last column: whether the mistake passes.
USUAL_SSIM = 0.98
MUTATIONS = [
    pytest.param(wrong_gamma, "non-square-pixels", True, id="wrong gamma"),
    pytest.param(no_highlights, "non-square-pixels", True, id="no highlight"),
    pytest.param(falling_off, "non-square-pixels", True, id="lights fall off"),
    pytest.param(brighter, "non-square-pixels", True, id="2 % brighter"),
    pytest.param(half_pixel, "non-square-pixels", False, id="half a pixel out"),
    pytest.param(mirrored, "non-square-pixels", False, id="mirrored window"),
    pytest.param(no_shadows, "non-square-pixels", False, id="no shadows"),
    pytest.param(boxes_out, "two-boxes", False, id="boxes one unit out"),
]


@pytest.mark.parametrize(("mutation", "name", "ssim_misses"), MUTATIONS)
def test_the_comparison_catches(
    mutation: Callable[[Scene], Floats], name: str, ssim_misses: bool
) -> None:
    scene = load_small(SCENES / f"{name}.xml")
    reference, right = stored(name), render(scene)
    mask = edge_mask(scene, right)
    assert faults(figures(right, reference, mask), mask) == ()
    wrong = figures(mutation(scene), reference, mask)
    assert wrong.max > 100 * MAX_DIFFERENCE
    assert faults(wrong, mask) != ()
    assert (wrong.ssim >= USUAL_SSIM) == ssim_misses


def test_even_a_strict_ssim_misses_what_is_a_little_brighter() -> None:
    scene = load_small(SCENES / "four-spheres.xml")
    assert figures(brighter(scene), stored("four-spheres")).ssim >= MIN_SSIM
