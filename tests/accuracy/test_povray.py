"""Compare every scene pixel by pixel with POV-Ray, which has its own camera, shapes and lights."""

import sys

import numpy as np
import pytest
from conftest import find_program
from scene_files import scene_parameters, small_scene

from reference import povray
from reference.command import SCENES
from reference.judges import plain
from tracer import load_scene, render

# POV-Ray's picture has 16 bits per channel, up to a radiance of 4.  The tolerance is half a step,
# and 1 % more for POV-Ray's own rounding errors.
TOLERANCE = 1.01 * povray.MAX_RADIANCE / 65535 / 2


@pytest.mark.povray
@pytest.mark.parametrize(
    "name", scene_parameters("highlights", "room", "sticks-shifted", "touching")
)
def test_povray_renders_the_same_picture(name, tmp_path):
    find_program("povray")
    scene, path = load_scene(SCENES / f"{name}.xml"), tmp_path / "picture.ppm"
    povray.render_and_time(povray.prepare_linear_command(scene, path))
    image = render(scene)
    differs = np.abs(povray.read_linear_picture(path) - image).max(axis=2) > TOLERANCE
    assert name == "touching" or not differs.any()
    # Here a plate lies exactly on a face of a slab, and only there POV-Ray confuses the two, or
    # their shadows.  The oracle confirms the tracer in all these pixels.
    row, column = np.nonzero(differs)
    exact = plain.trace(scene, column + 0.5, row + 0.5, arithmetic="decimal")
    assert (exact.surface_index == 0).all()
    np.testing.assert_allclose(image[row, column], exact.radiance, rtol=0, atol=1e-12)


def test_all_objects_and_lights_are_converted():
    scene = small_scene("sticks-perspective")
    text = povray.convert_scene(scene)
    counts = [text.count(f"{name} {{") for name in ("sphere", "box", "light_source")]
    assert counts == [len(scene.surfaces.radius), len(scene.surfaces.min_pt), len(scene.lights)]


def test_the_reported_time_is_read_and_failures_are_raised():
    for reported, seconds in (("0.000", 0.0005), ("1.250", 1.25)):
        line = f"Trace Time: 0 hours 0 minutes ({reported} seconds)"
        script = f"import sys; sys.stderr.write('{line}')"
        assert povray.render_and_time([sys.executable, "-c", script]) == seconds
    script = "import sys; sys.stderr.write('Parse Error: x'); sys.exit(1)"
    with pytest.raises(RuntimeError, match="POV-Ray failed:\nParse Error: x"):
        povray.render_and_time([sys.executable, "-c", script])
