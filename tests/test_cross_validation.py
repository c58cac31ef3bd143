"""The tracer, live Mitsuba and Mitsuba's stored pictures: each against each, on every scene.

What differs leaves its comparison behind, in ``build/comparisons``.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from random_scenes import random_scene

from converters.rendering import Rendering, render_mitsuba
from converters.variant import SCALAR, use
from reference.check import (
    EDGE_CHANGE,
    EDGE_SHIFT,
    MAX_MASKED,
    CheckResult,
    check_scene,
    compare,
    edge_mask,
    faults,
)
from reference.command import SCENES, own_scenes
from reference.compare import figures, write_comparison
from reference.regenerate import FOLDER, WIDTH, load_small, main, manifest, scene_hash, stored
from tracer import Scene, load_scene, render

pytestmark = pytest.mark.cross_validation

PATHS = own_scenes()
NAMES = [path.stem for path in PATHS]
BUILD = Path(__file__).resolve().parent.parent / "build" / "comparisons"


@cache
def live(name: str) -> CheckResult:
    """The tracer against Mitsuba, both rendering now."""
    return check_scene(load_small(SCENES / f"{name}.xml"), name)


@cache
def kept(name: str) -> CheckResult:
    """The tracer against Mitsuba's stored picture."""
    rendering = Rendering(stored(name), "stored", 0.0)
    return compare(load_small(SCENES / f"{name}.xml"), name, rendering)


def hold(result: CheckResult) -> None:
    """Fail where a comparison is out of tolerance, leaving its picture behind."""
    if result.faults:
        BUILD.mkdir(parents=True, exist_ok=True)
        picture = BUILD / f"{result.name}-{result.variant}.check.png"
        labels = ("tracer", f"Mitsuba {result.variant}")
        write_comparison(picture, result.tracer, result.reference, labels)
        pytest.fail(f"{result.report()}\n  see {picture}")


def test_the_mask_is_no_excuse() -> None:
    assert EDGE_SHIFT <= 0.03
    assert EDGE_CHANGE <= 1e-2
    assert MAX_MASKED <= 0.015


def test_mitsuba_agrees_with_itself_in_another_variant() -> None:
    scene, now = load_small(SCENES / "four-spheres.xml"), live("four-spheres")
    scalar = render_mitsuba(scene, variant=SCALAR)
    use()
    edges = edge_mask(scene, now.tracer)
    assert faults(figures(scalar, now.mitsuba, edges), edges) == ()


@pytest.mark.parametrize("name", NAMES)
def test_tracer_agrees_with_live_mitsuba(name: str) -> None:
    hold(live(name))


@pytest.mark.parametrize("name", NAMES)
def test_tracer_agrees_with_stored_mitsuba(name: str) -> None:
    hold(kept(name))


@pytest.mark.parametrize("name", NAMES)
def test_live_mitsuba_agrees_with_stored_mitsuba(name: str) -> None:
    now, then = live(name), kept(name)
    edges = edge_mask(load_small(SCENES / f"{name}.xml"), now.tracer)
    assert faults(figures(now.reference, then.reference, edges), edges) == ()


@pytest.mark.parametrize("name", NAMES)
def test_stored_picture_is_of_the_scene_as_it_is_now(name: str) -> None:
    told = manifest()
    assert told["scenes"][name]["sha256"] == scene_hash(SCENES / f"{name}.xml"), (
        "the scene has changed; python -m reference.regenerate renders it again"
    )
    assert (told["width"], told["samples"]) == (WIDTH, 1)
    assert {"mitsuba", "drjit", "variant", "command"} <= told.keys()


def test_nothing_is_stored_that_has_no_scene() -> None:
    assert sorted(path.stem for path in FOLDER.glob("*.exr")) == NAMES
    assert sorted(manifest()["scenes"]) == NAMES


def test_a_missing_reference_fails() -> None:
    with pytest.raises(FileNotFoundError, match=r"no-such-scene\.exr is missing; python -m"):
        stored("no-such-scene")


def test_regenerate_makes_what_is_stored(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scenes = tmp_path / "scenes"
    scenes.mkdir()
    (scenes / "one-box.xml").write_bytes((SCENES / "one-box.xml").read_bytes())
    (tmp_path / "of-another.exr").touch()
    monkeypatch.setattr("reference.command.SCENES", scenes)
    assert main(["-o", str(tmp_path)]) == 0
    made = manifest(tmp_path)["scenes"]
    assert made.keys() == {"one-box"}
    assert made["one-box"]["sha256"] == scene_hash(SCENES / "one-box.xml")
    np.testing.assert_allclose(stored("one-box", tmp_path), stored("one-box"), atol=1e-4)
    assert (tmp_path / "of-another.exr").exists()


@pytest.mark.parametrize("name", ["four-spheres", "sticks-axonometric", "touching"])
def test_scenes_agree_at_their_own_size(name: str) -> None:
    result = check_scene(load_scene(SCENES / f"{name}.xml"), name)
    hold(result)
    assert result.mask.mean() <= 0.003


@pytest.mark.parametrize("kind", ["scattered", "rooms", "far", "walled", "crowd"])
@pytest.mark.parametrize("seed", range(3))
def test_random_scenes_agree(kind: str, seed: int) -> None:
    scene = random_scene(kind, seed, 64, 48)
    hold(check_scene(scene, f"{kind}-{seed}"))


def test_a_failed_comparison_leaves_its_picture_behind(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys.modules[__name__], "BUILD", tmp_path / "build")
    scene = small(load_scene(SCENES / "one-sphere.xml"))
    wrong = Rendering(render(scene) * 1.02, "stored", 0.0)
    with pytest.raises(pytest.fail.Exception, match=r"DIFFERS[\s\S]*wrong-stored\.check\.png"):
        hold(compare(scene, "wrong", wrong))
    assert (tmp_path / "build" / "wrong-stored.check.png").exists()


def test_mitsuba_converges_to_the_smooth_picture() -> None:
    """Edges included, each pixel of which is off by about 1 / 8 of its contrast at 64 samples."""
    scene = small(load_scene(SCENES / "one-sphere.xml"))
    assert figures(render(scene, 64), render_mitsuba(scene, 64)).rmse < 5e-3


def small(scene: Scene) -> Scene:
    """32 pixels square."""
    return replace(scene, width=32, height=32)
