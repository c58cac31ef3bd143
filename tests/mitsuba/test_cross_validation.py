"""Compare the tracer, Mitsuba, and Mitsuba's stored pictures with each other, on every scene.

`python -m reference.check SCENE.xml` shows what differs.
"""

import json
import sys
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image
from scene_files import NAMES

from converters.rendering import Rendering, render_with_mitsuba, write_exr
from converters.variant import SCALAR, use_variant
from reference import check, regenerate
from reference.command import REFERENCE_FOLDER, SCENES
from reference.figures import measure_differences
from reference.regenerate import hash_scene_file, load_small_scene, read_stored_picture
from tracer import load_scene, render

pytestmark = pytest.mark.cross_validation


@pytest.mark.parametrize("name", NAMES)
def test_diffuse_light_agrees_with_stock_plugins(name):
    # In the LLVM variant, a ray through the diagonal of a cube's face may miss the cube.
    result = check.check_diffuse_light(load_small_scene(SCENES / f"{name}.xml"), name, SCALAR)
    use_variant()
    assert result.verdict == "agrees", result.format_report()
    assert result.differs_at_edge.mean() <= 0.001
    assert result.tracer_image.max() > 0.1


@pytest.mark.parametrize("name", NAMES)
def test_tracer_live_mitsuba_and_the_stored_picture_agree(name):
    scene = load_small_scene(SCENES / f"{name}.xml")
    now = check.check_scene(scene, name)
    then = check.compare(scene, name, Rendering(read_stored_picture(name), "stored", 0.0))
    for result in (now, then):
        assert result.verdict == "agrees", result.format_report()
        assert (name == "touching") == bool(result.is_tie.any())
        assert result.differs_at_edge.mean() <= 0.003
    is_excluded = now.is_excluded | then.is_excluded
    # Variants of Mitsuba may decide ties differently: such pixels do not count in SSIM either.
    shown = np.where(is_excluded[:, :, None], then.mitsuba.image, now.mitsuba.image)
    measured = measure_differences(shown, then.mitsuba.image, is_excluded)
    assert check.describe_exceeded_tolerances(measured) == []
    assert measured.max <= check.EXACT.difference


def test_the_stored_pictures_are_of_these_scenes():
    assert sorted(path.stem for path in regenerate.MITSUBA_FOLDER.glob("*.exr")) == NAMES
    manifest = json.loads((regenerate.MITSUBA_FOLDER / "manifest.json").read_text())
    then = {name: scene["sha256"] for name, scene in manifest["scenes"].items()}
    now = {name: hash_scene_file(SCENES / f"{name}.xml") for name in NAMES}
    assert then == now, "scenes have changed; python -m reference.regenerate renders them again"


def test_regenerate_renders_the_stored_pictures(tmp_path, monkeypatch):
    then = read_stored_picture("one-box")
    monkeypatch.setattr(regenerate, "REFERENCE_FOLDER", tmp_path)
    monkeypatch.setattr(regenerate, "MITSUBA_FOLDER", tmp_path)
    monkeypatch.setattr(regenerate, "list_scene_files", lambda: [SCENES / "one-box.xml"])
    monkeypatch.setattr(sys, "argv", ["regenerate"])
    regenerate.main()
    np.testing.assert_allclose(read_stored_picture("one-box"), then, atol=1e-4)
    names = {"one-box.exr", "manifest.json", "sheet.png", "sunflower.png"}
    assert {path.name for path in tmp_path.iterdir()} == names
    stored = json.loads((REFERENCE_FOLDER / "mitsuba/manifest.json").read_text())
    assert json.loads((tmp_path / "manifest.json").read_text()).keys() == stored.keys()


def test_regenerate_replaces_only_what_differs_by_more_than_rounding(tmp_path, monkeypatch):
    monkeypatch.setattr(regenerate, "REFERENCE_FOLDER", tmp_path)
    monkeypatch.setattr(regenerate, "MITSUBA_FOLDER", tmp_path)
    monkeypatch.setattr(regenerate, "list_scene_files", lambda: [SCENES / "one-box.xml"])
    monkeypatch.setattr(regenerate, "_SAMPLES_PER_PIXEL", 1)
    monkeypatch.setattr(sys, "argv", ["regenerate"])
    regenerate.main()
    sheet, picture, manifest = (
        tmp_path / name for name in ("sheet.png", "one-box.exr", "manifest.json")
    )
    then, codes = read_stored_picture("one-box"), np.array(Image.open(sheet))
    for code_mask, radiance_step, pixel_share, is_kept in (
        (1, 0.9e-4, 1.0, True),
        (1, 1.0, 0.01, True),
        (2, 1.1e-4, 1.0, False),
        (2, 1.0, 0.02, False),
    ):
        Image.fromarray(codes ^ code_mask).save(sheet)
        changed = then.copy()
        changed.reshape(-1, 3)[: int(pixel_share * then.size / 3)] += radiance_step
        write_exr(picture, changed)
        manifest.write_text(manifest.read_text().replace('"machine"', '"other"'))
        before = [path.read_bytes() for path in (sheet, picture, manifest)]
        regenerate.main()
        for path, content in zip((sheet, picture, manifest), before, strict=True):
            assert (path.read_bytes() == content) == is_kept, path.name


def test_mitsuba_converges_to_the_smooth_picture():
    """Pixels at edges count, too: at 64 samples, their error is about 1/8 of their contrast."""
    scene = replace(load_scene(SCENES / "one-sphere.xml"), width=32, height=32)
    assert measure_differences(render(scene, 64), render_with_mitsuba(scene, 64)).rmse < 5e-3
