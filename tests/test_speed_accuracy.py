"""The speed-accuracy chart: whom it compares, and what it says of that."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from scene_files import small

from converters.variant import LLVM, use
from reference import charts, command, speed_accuracy
from reference.speed_accuracy import Lead, Point
from reference.timing import Timing
from reference.truth import Truth, truth_side
from tracer import render


def _curve(method: str, *errors_and_seconds: tuple[float, float]) -> list[Point]:
    return [
        Point("any", method, 4**k, False, error, Timing.of([seconds]))
        for k, (error, seconds) in enumerate(errors_and_seconds)
    ]


def _lead(*curves: list[Point]) -> tuple[float, float, float]:
    """Level, seconds of this tracer, seconds of its rival."""
    lead = Lead.of([point for curve in curves for point in curve])
    assert lead is not None
    return lead.level, lead.ours, lead.theirs


def test_lead_is_over_the_fastest_rival_at_the_same_error() -> None:
    ours = _curve("this tracer", (1e-2, 1.0), (5e-4, 2.0), (1e-4, 4.0))
    slow = _curve("Mitsuba scalar", (1e-2, 9.0), (1e-4, 9.0))
    fast = _curve("Mitsuba stratified", (1e-2, 3.0), (1e-5, 3.0))
    numpy = _curve("uniform grid", (1e-2, 0.1), (1e-5, 0.1))
    assert _lead(ours, slow, fast, numpy) == pytest.approx((1e-3, 2.0, 3.0))
    assert Lead(1e-3, 2.0, 3.0).speedup == 1.5
    # Rivals take any number of samples; this tracer those of its points.
    between = _curve("Mitsuba scalar", (1e-2, 1.0), (1e-4, 4.0))
    assert _lead(ours, between) == pytest.approx((1e-3, 2.0, 2.0))
    # Where a rival does not come so far, it is met where it comes; to be better is as good.
    rough = _curve("Mitsuba scalar", (1.0, 1.0), (0.1, 2.0))
    assert _lead(ours, rough) == pytest.approx((0.1, 1.0, 2.0))
    # One that ends a little above the others is met there, if it is faster; not one that ends far.
    early = _curve("Mitsuba independent", (1e-2, 0.5), (1.2e-3, 1.5))
    assert _lead(ours, fast, early) == pytest.approx((1.2e-3, 2.0, 1.5))
    far = _curve("Mitsuba independent", (1e-2, 0.5), (2e-3, 1.5))
    assert _lead(ours, fast, far) == pytest.approx((1e-3, 2.0, 3.0))
    # The first picture of ours that is as good counts, whatever the noise of later ones.
    noisy = _curve("this tracer", (5e-4, 2.0), (1e-4, 1.0))
    assert _lead(noisy, fast) == pytest.approx((1e-3, 2.0, 3.0))
    assert Lead.of([*ours, *numpy]) is None


def test_what_is_expected_to_take_too_long() -> None:
    # Four times the samples take four times as long, but for starting up; POV-Ray has thresholds.
    assert speed_accuracy._next("Mitsuba scalar", []) == 0
    assert speed_accuracy._next("Mitsuba scalar", [1.0]) == 2
    assert speed_accuracy._next("Mitsuba scalar", [1.0, 1.5]) == 3.5
    assert speed_accuracy._next("POV-Ray adaptive", [1.0, 1.5]) == 2
    assert speed_accuracy._next("POV-Ray adaptive", [1.0, 0.5]) == 0.5


def test_names_of_curves_keep_apart_and_move_no_farther_than_they_must() -> None:
    assert charts._spread([0, 5], 1) == [0, 5]
    assert charts._spread([0, 0.5, 5], 1) == [-0.25, 0.75, 5]
    assert charts._spread([0, 0, 1.2], 1) == pytest.approx([-0.6, 0.4, 1.4])


def test_the_chart_says_what_was_measured() -> None:
    def lead(speedup: float) -> Lead:
        return Lead(1e-3, 1.0, speedup)

    found = {False: [lead(0.5), lead(0.2)], True: [lead(2.0), lead(0.9), lead(1.05)]}
    title = speed_accuracy._title(found, "Mitsuba")
    assert "faster than Mitsuba" in title
    assert "in 1 of 3 pictures from file to picture, in 0 of 2 pictures at rendering alone" in title
    assert speed_accuracy._title({False: [], True: []}, "Mitsuba") == "Time against error"
    assert speed_accuracy._in_words(0.5, 0.2) == "2.0–5.0× slower"
    assert speed_accuracy._in_words(0.9, 3.0, 2.0) == "1.1× slower, 2.0–3.0× faster"
    assert speed_accuracy._in_words(0.5, 1.05, 3.0) == "2.0× slower, level, 3.0× faster"
    assert speed_accuracy._in_words(0.95) == "level"


def test_speed_accuracy_of_a_small_picture(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(command, "BUILD", tmp_path)
    scene = small("four-spheres", 32, 18)
    monkeypatch.setattr(speed_accuracy, "_scenes", lambda quick: {"small": scene})
    monkeypatch.setattr(speed_accuracy, "_ROUNDS", 2)
    monkeypatch.setattr(sys, "argv", ["speed_accuracy", "--quick"])
    if use().variant != LLVM:
        with pytest.raises(SystemExit, match="1"):
            speed_accuracy.main()
        assert LLVM in capsys.readouterr().err
        return
    speed_accuracy.main()
    drawn = tmp_path.glob("speed_accuracy.*")
    assert {path.suffix for path in drawn} == {".svg", ".png", ".csv"}
    rows = [
        line.split(",") for line in (tmp_path / "speed_accuracy.csv").read_text().splitlines()[2:]
    ]
    alone = [row for row in rows if row[1] == "this tracer" and row[3] == "False"]
    ours = {int(row[2]): float(row[4]) for row in alone}
    assert sorted(ours) == [1, 4, 9, 16, 36, 144]
    assert ours[1] > ours[4] > ours[9] >= ours[16] > ours[144]
    # The error is that of the scene as it is, not of a copy that a later round has drawn.
    truth = Truth.of(scene, truth_side(quick=True))
    assert ours[9] == pytest.approx(truth.error(render(scene, 9)), rel=1e-5)
    chart = tmp_path / "speed_accuracy.svg"
    chart.unlink()
    monkeypatch.setattr(sys, "argv", ["speed_accuracy", "--quick", "--redraw"])
    monkeypatch.delattr(speed_accuracy, "measure")
    speed_accuracy.main()
    assert chart.exists()
