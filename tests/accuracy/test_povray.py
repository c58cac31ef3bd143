"""Every scene held against POV-Ray, pixel by pixel: a camera, shapes and lights of its own."""

import sys

import numpy as np
import pytest
from conftest import need
from scene_files import names, small

from reference import povray
from reference.command import SCENES
from reference.judges import plain
from tracer import load_scene, render

# Half a step of its 16 bits, which end at a radiance of 4, and its own rounding.
HALF_A_STEP = 1.01 * povray.WHITE / 65535 / 2


@pytest.mark.povray
@pytest.mark.parametrize("name", names("highlights", "room", "sticks-shifted", "touching"))
def test_draws_the_same_picture(name, tmp_path):
    need("povray")
    scene, picture = load_scene(SCENES / f"{name}.xml"), tmp_path / "picture.ppm"
    povray.trace(povray.linear(scene, picture))
    ours = render(scene)
    differ = np.abs(povray.picture(picture) - ours).max(axis=2) > HALF_A_STEP
    assert name == "touching" or not differ.any()
    # A plate lies on the slab's very face, and there alone it takes one for the other or for its
    # shadow: all these pixels are right by the oracle.
    row, column = np.nonzero(differ)
    seen = plain.trace(scene, column + 0.5, row + 0.5, arithmetic="decimal")
    assert (seen.surface == 0).all()
    np.testing.assert_allclose(ours[row, column], seen.radiance, rtol=0, atol=1e-12)


def test_its_scene_names_every_object_and_light():
    scene = small("sticks-perspective")
    found = [povray.to_pov(scene).count(f"{name} {{") for name in ("sphere", "box", "light_source")]
    assert found == [len(scene.surfaces.radius), len(scene.surfaces.min_pt), len(scene.lights)]


def test_time_and_failure_that_it_tells():
    # No time at all has no place on a logarithmic axis.
    for said, seconds in (("0.000", 0.0005), ("1.250", 1.25)):
        script = f"import sys; sys.stderr.write('Trace Time: 0 hours 0 minutes ({said} seconds)')"
        assert povray.trace([sys.executable, "-c", script]) == seconds
    script = "import sys; sys.stderr.write('Parse Error: x'); sys.exit(1)"
    with pytest.raises(RuntimeError, match="Parse Error: x"):
        povray.trace([sys.executable, "-c", script])
