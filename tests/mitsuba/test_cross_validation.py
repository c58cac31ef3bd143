"""The tracer, live Mitsuba and Mitsuba's stored pictures: each against each, on every scene.

`python -m reference.check SCENE.xml` shows what differs.
"""

import json
import sys
from dataclasses import replace

import numpy as np
import pytest
from scene_files import NAMES

from converters.rendering import Rendering, render_mitsuba
from converters.variant import SCALAR, use
from reference import check, regenerate
from reference.command import HERE, SCENES
from reference.figures import figures
from reference.regenerate import load_small, scene_hash, stored
from tracer import load_scene, render

pytestmark = pytest.mark.cross_validation


@pytest.mark.parametrize("name", NAMES)
def test_diffuse_light_agrees_with_that_by_stock_plugins_alone(name):
    # In the LLVM variant, a ray through the diagonal of a cube's face may miss it.
    result = check.check_diffuse(load_small(SCENES / f"{name}.xml"), name, SCALAR)
    use()
    assert result.verdict == "agrees", result.report()
    assert result.edges.mean() <= 0.001
    assert result.tracer.max() > 0.1


@pytest.mark.parametrize("name", NAMES)
def test_tracer_live_mitsuba_and_the_stored_picture_agree(name):
    scene = load_small(SCENES / f"{name}.xml")
    now = check.check_scene(scene, name)
    then = check.compare(scene, name, Rendering(stored(name), "stored", 0.0))
    for result in (now, then):
        assert result.verdict == "agrees", result.report()
        assert (name == "touching") == bool(result.ties.any())
        assert result.edges.mean() <= 0.003
    excluded = now.excluded | then.excluded
    # Variants may decide ties in other ways: such pixels do not count in SSIM either.
    again = np.where(excluded[:, :, None], then.mitsuba, now.mitsuba)
    found = figures(again, then.mitsuba, excluded)
    assert check.out_of_tolerance(found) == []
    assert found.max <= check.EXACT.difference


def test_what_is_stored_is_of_these_scenes():
    assert sorted(path.stem for path in regenerate.FOLDER.glob("*.exr")) == NAMES
    told = json.loads((regenerate.FOLDER / "manifest.json").read_text())
    then = {name: scene["sha256"] for name, scene in told["scenes"].items()}
    now = {name: scene_hash(SCENES / f"{name}.xml") for name in NAMES}
    assert then == now, "scenes have changed; python -m reference.regenerate renders them again"


def test_regenerate_makes_what_is_stored(tmp_path, monkeypatch):
    then = stored("one-box")
    monkeypatch.setattr(regenerate, "HERE", tmp_path)
    monkeypatch.setattr(regenerate, "FOLDER", tmp_path)
    monkeypatch.setattr(regenerate, "own_scenes", lambda: [SCENES / "one-box.xml"])
    monkeypatch.setattr(sys, "argv", ["regenerate"])
    regenerate.main()
    np.testing.assert_allclose(stored("one-box"), then, atol=1e-4)
    names = {"one-box.exr", "manifest.json", "sheet.png", "sunflower.png"}
    assert {path.name for path in tmp_path.iterdir()} == names
    made = json.loads((tmp_path / "manifest.json").read_text())
    assert made.keys() == json.loads((HERE / "mitsuba/manifest.json").read_text()).keys()


def test_mitsuba_converges_to_the_smooth_picture():
    """Edges included, each pixel of which is off by about 1 / 8 of its contrast at 64 samples."""
    scene = replace(load_scene(SCENES / "one-sphere.xml"), width=32, height=32)
    assert figures(render(scene, 64), render_mitsuba(scene, 64)).rmse < 5e-3
