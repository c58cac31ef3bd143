"""The stability chart: the alternatives err as theory says, and the tracer does not."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scene_files import small

from converters.variant import LLVM, SCALAR, mi, use
from reference import alternatives, command, stability
from reference.alternatives import closest_approach, exactly, float32, float64, textbook
from tracer import Scene, render
from tracer.arrays import Floats


@pytest.mark.parametrize(
    ("roots", "arithmetic", "distances", "power"),
    [
        (textbook, float64, 10.0 ** np.arange(2, 6.6, 0.5), 2),
        (closest_approach, float64, 10.0 ** np.arange(2, 6.6, 0.5), 1),
        (textbook, float32, 10.0 ** np.arange(1, 3.1, 0.25), 2),
        (closest_approach, float32, 10.0 ** np.arange(1, 5.1, 0.5), 1),
    ],
)
def test_error_grows_with_distance_as_eps_times_its_power(
    roots: alternatives.Roots, arithmetic: alternatives.Arithmetic, distances: Floats, power: int
) -> None:
    errors = []
    for distance in distances.tolist():
        scene = stability.distant(distance)
        image = alternatives.render(scene, arithmetic, roots=roots)
        errors.append(np.abs(image - alternatives.render(scene, exactly)).max())
    slope = np.polyfit(np.log(distances), np.log(errors), 1)[0]
    # Rounding errors are as good as random: a fit over a few decades comes within a third.
    assert abs(slope - power) < 1 / 3
    # The constant in front is a small number.
    eps = np.finfo(arithmetic(0.0).dtype).eps
    assert 0.1 < np.median(errors / (eps * distances**power)) < 30


@pytest.mark.parametrize("name", ["four-spheres", "sticks-perspective", "highlights"])
def test_the_judge_and_the_tracer_agree(name: str) -> None:
    scene = small(name)
    exact = alternatives.render(scene, exactly)
    assert exact.max() > 0.1
    # A few hundred roundings between the scene and the picture.
    np.testing.assert_allclose(render(scene), exact, rtol=0, atol=1e-12)
    np.testing.assert_allclose(alternatives.render(scene), exact, rtol=0, atol=1e-12)


def test_offset_moves_the_samples_of_both_renderers_alike() -> None:
    scene = small("four-spheres")
    for offset in [(0.25, 0.0), (0.0, -0.5)]:
        moved = alternatives.render(scene, offset=offset)
        assert np.abs(moved - render(scene)).max() > 0.01
        np.testing.assert_allclose(moved, render(scene, offset=offset), rtol=0, atol=1e-12)


@pytest.mark.parametrize(
    ("start", "scale", "wrong"),
    [
        ("t > 0", 1.0, 1.0),  # self-shadows, by rounding alone
        ("t > 1e-4", 2.0**-30, 1.0),  # all of the scene is smaller than the epsilon
        ("t > 1e-6", 2.0**30, 1.0),  # rounding is larger than the epsilon
        ("normal offset 1e-4", 2.0**-30, 1.0),
        ("offset of 256 ulp", 2.0**20, 1.0),  # close to a plane of coordinates an ulp is nothing
    ],
)
def test_shadow_epsilons_fail_where_the_chart_says(start: str, scale: float, wrong: float) -> None:
    scene = stability.ball_on_ground(scale=scale)
    exact = alternatives.render(scene, exactly)
    image = alternatives.render(scene, shadow_start=alternatives.SHADOW_STARTS[start])
    assert stability.wrong_share(image, exact) > wrong
    assert stability.wrong_share(render(scene), exact) == 0


def test_shadow_rays_start_where_their_names_say() -> None:
    p, n = np.array([3.0, 0.0, -0.01]), np.array([0.6, 0.0, 0.8])
    offsets = {
        name: ((start(p, n)[0] - p).tolist(), start(p, n)[1])
        for name, start in alternatives.SHADOW_STARTS.items()
    }
    ulp = 2.0**-51  # of 3
    assert offsets == {
        "t > 0": ([0, 0, 0], 0),
        "t > 1e-4": ([0, 0, 0], 1e-4),
        "t > 1e-6": ([0, 0, 0], 1e-6),
        "normal offset 1e-4": (pytest.approx([6e-5, 0, 8e-5]), 0),
        # Near a plane of coordinates, a fixed length.
        "offset of 256 ulp": (
            pytest.approx([0.6 * 256 * ulp, 0, 0.8 / 65536], rel=0.01, abs=0),
            0,
        ),
    }


@pytest.mark.parametrize("panel", stability.PANELS, ids=lambda panel: panel.title)
def test_the_tracer_holds_at_the_hard_end_of_every_axis(panel: stability.Panel) -> None:
    found = stability.measure(panel, {"this tracer": render}, panel.at[-1:])["this tracer"]
    # Shares are exact decisions; radiance keeps seven digits at 1e8, and six at 1e9.
    assert found <= (2e-7 if panel.judge is stability.largest_error else 0.0)


def test_what_the_stability_chart_shows_by_hand() -> None:
    exact = np.array([[[0.5] * 3, [0.0] * 3], [[0.25] * 3, [1.0] * 3]])
    off = exact + np.array([[[0.0], [0.125]], [[-0.25], [0.0]]])
    assert stability.largest_error(off, exact) == 0.25
    assert stability.wrong_share(off, exact) == 50
    lost = exact.copy()
    lost[0, 0, 1] = np.nan
    assert stability.largest_error(lost, exact) == 1
    assert stability.wrong_share(lost, exact) == 25
    # Of the scenes near a point the worst counts.
    panel = replace(stability.PANELS[0], nearby=(1.0, 3.0, 2.0))
    dark = {"this tracer": lambda scene: render(scene) * (scene.camera.proj_distance < 25)}
    found = stability.measure(panel, dark, [10.0])["this tracer"]
    assert found > 0.5


def test_stability_chart_of_a_few_points(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(command, "BUILD", tmp_path)
    monkeypatch.setattr(sys, "argv", ["stability", "--quick"])
    panels = [replace(panel, at=panel.at[[0, 1, 2, -1]]) for panel in stability.PANELS]
    monkeypatch.setattr(stability, "PANELS", panels)
    stability.main()
    assert {path.suffix for path in tmp_path.iterdir()} == {".svg", ".png", ".csv"}
    table = (tmp_path / "stability.csv").read_text()
    names = ["this tracer", "Mitsuba scalar", *(["Mitsuba LLVM"] if use().variant == LLVM else [])]
    assert all(table.count(f",{name},") >= 5 for name in names)
    chart = tmp_path / "stability.svg"
    drawn = chart.read_text()
    # Names are texts: written as outlines, they would be most of a file of a megabyte.
    assert drawn.count(">this tracer</text>") == len(panels)
    monkeypatch.setattr(sys, "argv", ["stability", "--quick", "--redraw"])
    monkeypatch.delattr(stability, "measure")
    chart.unlink()
    stability.main()
    assert chart.read_text() == drawn


@pytest.mark.parametrize("scene", [stability.distant(10), stability.ball_on_ground()])
def test_mitsuba_draws_the_scenes_of_the_chart(scene: Scene) -> None:
    image = stability.mitsuba_render(scene, SCALAR)
    # It shadows some points of the ground by themselves.
    assert np.mean(np.abs(image - render(scene)) < 1e-4) > 0.95
    # And stays usable for others in the variant that they use.
    assert use().variant == mi.variant()
