"""The ablation: without any of its parts the tracer draws the same, or nearly."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from scene_files import small

from reference import ablation, command
from reference.tables import Table
from reference.timing import Timing
from reference.workloads import crowd, resized, rods
from tracer import render


@pytest.mark.parametrize("part", ablation.ONE_SAMPLE, ids=lambda part: part.name)
def test_no_part_changes_a_picture_of_one_sample(part: ablation.Part) -> None:
    for scene in (small("highlights", 96, 54), crowd(300, width=96, height=54)):
        picture = render(scene, threads=1)
        with ablation.without(part):
            other = render(scene, threads=1)
        # Highlights from vectors round differently.
        assert np.abs(other - picture).max() <= 1e-12


@pytest.mark.parametrize("part", ablation.ANTIALIASING, ids=lambda part: part.name)
def test_antialiasing_without_a_part_is_another_way_to_the_same(part: ablation.Part) -> None:
    scene = small("sunflower", 96, 54)
    picture = render(scene, samples=16, threads=1)
    with ablation.without(part):
        other = render(scene, samples=16, threads=1)
    assert np.array_equal(render(scene, samples=16, threads=1), picture)
    error = np.abs(other - picture)
    # Several edges cross most of its pixels, in which 16 samples err by a few hundredths.
    assert np.sqrt((error**2).mean()) < 0.01
    assert error.max() < 0.2


def test_ablation_of_small_pictures(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(command, "BUILD", tmp_path)
    monkeypatch.setattr(
        ablation, "resized", lambda scene, width, height: resized(scene, width // 20, height // 20)
    )
    monkeypatch.setattr(ablation, "crowd", lambda count, **_: crowd(50, width=16, height=9))
    monkeypatch.setattr(ablation, "rods", lambda count: rods(70, width=16, height=9))
    monkeypatch.setattr(sys, "argv", ["ablation", "--quick"])
    ablation.main()
    shown = capsys.readouterr().out
    parts = [*ablation.ONE_SAMPLE, *ablation.ANTIALIASING]
    assert all(shown.count(f"| {part.name} |") == 1 for part in parts)
    lines = (tmp_path / "ablation.csv").read_text().splitlines()[2:]
    assert len(lines) == 6 * (1 + len(ablation.ONE_SAMPLE)) + 8 * (1 + len(ablation.ANTIALIASING))


def test_a_part_is_shown_by_its_fastest_round_over_that_of_all() -> None:
    rows: list[tuple[object, ...]] = [
        ("all as it is", Timing.of([0.04, 0.05, 0.09]), 0.25),
        ("no looks", Timing.of([0.06, 0.2, 0.4]), 1e-6),
    ]
    shown = ablation._shown(Table("Title", "", ("change", "room", "room: RMSE"), rows))
    assert shown.header == ("change", "room", "RMSE")
    lines = shown.markdown().splitlines()[-2:]
    assert lines == ["| all as it is | 40.0 | 0.250000 |", "| no looks | 1.5× | 0.000001 |"]
