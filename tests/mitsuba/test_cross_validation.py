"""The tracer, live Mitsuba and Mitsuba's stored pictures: each against each, on every scene.

What differs leaves its comparison behind, in ``build/comparisons``.
"""

import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from random_scenes import random_scene
from scene_files import NAMES

from converters.rendering import Rendering, render_mitsuba
from converters.variant import SCALAR, use
from reference import check
from reference.command import HERE, SCENES
from reference.figures import figures, write_comparison
from reference.regenerate import FOLDER, WIDTH, load_small, main, manifest, scene_hash, stored
from tracer import load_scene, render

pytestmark = pytest.mark.cross_validation

BUILD = HERE.parent / "build" / "comparisons"

# Faces of boxes that touch are ties, which float32 decides otherwise in so many pixels.
TIES = {"touching": 0.03}


@cache
def live(name: str) -> check.CheckResult:
    """The tracer against Mitsuba, both rendering now."""
    return check.check_scene(load_small(SCENES / f"{name}.xml"), name)


def hold(result: check.CheckResult, overruled: float = 0) -> None:
    """Fail where a comparison is out of tolerance, leaving its picture behind.

    `overruled`: of which share of the pixels exact arithmetic may say that Mitsuba errs.
    """
    if result.faults or result.differing > overruled * result.mask.size:
        BUILD.mkdir(parents=True, exist_ok=True)
        picture = BUILD / f"{result.name}-{result.variant}.check.png"
        labels = ("tracer", f"Mitsuba {result.variant}")
        write_comparison(picture, result.tracer, result.mitsuba, labels)
        pytest.fail(f"{result.report()}\n  see {picture}")


def test_the_mask_is_no_excuse():
    assert (check.EDGE_SHIFT, check.EDGE_CHANGE, check.MAX_MASKED) <= (0.03, 1e-2, 0.015)


@pytest.mark.slow
def test_mitsuba_agrees_with_itself_in_another_variant():
    scene, now = load_small(SCENES / "four-spheres.xml"), live("four-spheres")
    edges, scalar = check.edge_mask(scene, now.tracer), render_mitsuba(scene, variant=SCALAR)
    use()
    assert check.faults(figures(scalar, now.mitsuba, edges), edges) == ()


@pytest.mark.parametrize("name", NAMES)
def test_diffuse_light_agrees_with_that_by_stock_plugins_alone(name):
    result = check.check_diffuse(load_small(SCENES / f"{name}.xml"), name)
    # The stock camera is float32, and shadow rays start above the surface: 1 % for those far away.
    hold(result, TIES.get(name, 0.01))
    assert result.mask.mean() <= 0.001
    assert result.tracer.max() > 0.1


@pytest.mark.parametrize("name", NAMES)
def test_tracer_live_mitsuba_and_the_stored_picture_agree(name):
    scene, now = load_small(SCENES / f"{name}.xml"), live(name)
    then = check.compare(scene, name, Rendering(stored(name), "stored", 0.0))
    hold(now, TIES.get(name, 0))
    hold(then, TIES.get(name, 0))
    edges = check.edge_mask(scene, now.tracer)
    assert check.faults(figures(now.reference, then.reference, edges), edges) == ()


def test_what_is_stored_is_of_these_scenes():
    assert sorted(path.stem for path in FOLDER.glob("*.exr")) == NAMES
    told, now = manifest(), {name: scene_hash(SCENES / f"{name}.xml") for name in NAMES}
    then = {name: scene["sha256"] for name, scene in told["scenes"].items()}
    assert then == now, "scenes have changed; python -m reference.regenerate renders them again"
    assert (told["width"], told["samples"]) == (WIDTH, 1)
    assert {"mitsuba", "drjit", "variant", "command"} <= told.keys()
    with pytest.raises(FileNotFoundError, match=r"no-such-scene\.exr is missing; python -m"):
        stored("no-such-scene")


def test_regenerate_makes_what_is_stored(tmp_path, monkeypatch):
    scene, other = tmp_path / "scenes" / "one-box.xml", tmp_path / "of-another.exr"
    scene.parent.mkdir()
    scene.write_bytes((SCENES / scene.name).read_bytes())
    other.touch()
    monkeypatch.setattr("reference.command.SCENES", scene.parent)
    assert main(["-o", str(tmp_path)]) == 0
    made = manifest(tmp_path)["scenes"]
    assert made.keys() == {"one-box"}
    assert made["one-box"]["sha256"] == scene_hash(scene)
    np.testing.assert_allclose(stored("one-box", tmp_path), stored("one-box"), atol=1e-4)
    assert other.exists()


@pytest.mark.slow
@pytest.mark.parametrize("name", ["four-spheres", "sticks-axonometric", "touching"])
def test_scenes_agree_at_their_own_size(name):
    result = check.check_scene(load_scene(SCENES / f"{name}.xml"), name)
    hold(result, TIES.get(name, 0))
    assert result.mask.mean() <= 0.003


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["scattered", "rooms", "far", "walled", "crowd"])
@pytest.mark.parametrize("seed", range(3))
def test_random_scenes_agree(kind, seed):
    scene = random_scene(kind, seed, 64, 48)
    # In rooms, faces of boxes may touch.
    hold(check.check_scene(scene, f"{kind}-{seed}"), 0.2 if kind == "rooms" else 0)


def table() -> dict[str, tuple[str, str]]:
    """SSIM of the flavours `stock` and `stock-lights` of each scene, as a page shows it."""
    text = (HERE / "mitsuba.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| ([-\w]+) \| ([\d.]+) \| ([\d.]+) \|$", text, re.M)
    return {name: ssim for name, *ssim in rows}


def test_the_table_has_all_scenes():
    assert list(table()) == NAMES


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("flavour", ["stock", "stock-lights"])
def test_stock_flavours_are_as_similar_as_the_table_says(name, flavour):
    scene = load_small(SCENES / f"{name}.xml")
    found = check.resemblance(scene, name, None, flavour).figures.ssim
    shown = float(table()[name][flavour == "stock-lights"])
    assert found == pytest.approx(shown, abs=0.005), "python -m reference.check prints the table"
    # What the project asks of lights that do not fall off; their highlights are only similar.
    assert flavour == "stock" or found >= (0.95 if name == "highlights" else 0.98)


def test_mitsuba_converges_to_the_smooth_picture():
    """Edges included, each pixel of which is off by about 1 / 8 of its contrast at 64 samples."""
    scene = replace(load_scene(SCENES / "one-sphere.xml"), width=32, height=32)
    assert figures(render(scene, 64), render_mitsuba(scene, 64)).rmse < 5e-3
