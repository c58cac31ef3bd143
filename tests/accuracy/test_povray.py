"""Every scene held against POV-Ray, pixel by pixel: a camera, shapes and lights of its own."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from conftest import need
from numpy.typing import NDArray
from scene_files import small

from reference import plain, povray
from reference.command import own_scenes
from tracer import Scene, load_scene, render

# Half a step of its 16 bits, which end at a radiance of 4, and its own rounding.
HALF_A_STEP = 1.01 * povray.WHITE / 65535 / 2


def draw(scene: Scene, folder: Path) -> NDArray[np.float64]:
    """POV-Ray's picture of a scene."""
    need("povray")
    target = folder / "picture.ppm"
    povray.trace(povray.linear(scene, target))
    return povray.picture(target)


@pytest.mark.povray
@pytest.mark.parametrize("path", own_scenes(), ids=lambda path: path.stem)
def test_draws_the_same_picture(path: Path, tmp_path: Path) -> None:
    scene = load_scene(path)
    ours = render(scene)
    differ = np.abs(draw(scene, tmp_path) - ours).max(axis=2) > HALF_A_STEP
    assert path.stem == "touching" or not differ.any()
    # A plate lies on the slab's very face, and there alone it takes one for the other or for its
    # shadow: all these pixels are right by the oracle.
    row, column = np.nonzero(differ)
    seen = plain.trace(scene, column + 0.5, row + 0.5, arithmetic="decimal")
    assert (seen.surface == 0).all()
    np.testing.assert_allclose(ours[row, column], seen.radiance, rtol=0, atol=1e-12)


@pytest.mark.povray
def test_a_light_and_a_half_pixel_show(tmp_path: Path) -> None:
    scene = small("sticks-shifted")
    theirs = draw(scene, tmp_path)
    assert np.abs(theirs - render(scene)).max() < HALF_A_STEP
    assert np.abs(theirs - render(scene, offset=(0.5, 0))).max() > 0.1


def test_scene_names_every_object_and_light() -> None:
    scene = small("sticks-perspective")
    text = povray.to_pov(scene)
    assert text.count("sphere {") == len(scene.surfaces.radius)
    assert text.count("box {") == len(scene.surfaces.min_pt)
    assert text.count("light_source {") == len(scene.lights)


@pytest.mark.parametrize(("said", "seconds"), [("0.000", 0.0005), ("1.250", 1.25)])
def test_time_that_it_says(said: str, seconds: float) -> None:
    # No time at all has no place on a logarithmic axis.
    script = f"import sys; sys.stderr.write('Trace Time: 0 hours 0 minutes ({said} seconds)')"
    assert povray.trace([sys.executable, "-c", script]) == seconds


def test_failure_is_reported() -> None:
    script = "import sys; sys.stderr.write('Parse Error: x'); sys.exit(1)"
    with pytest.raises(RuntimeError, match="Parse Error: x"):
        povray.trace([sys.executable, "-c", script])
