"""Benchmark and the speed-accuracy chart: complete, and honest in what they compare.

No time is asserted.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Callable
from pathlib import Path
from time import sleep

import pytest
from scene_files import small

from converters.variant import LLVM, use
from reference import benchmark, command, speed_accuracy
from reference.judges.true_picture import rmse, true_picture
from reference.measured import measurements
from reference.measured.measurements import (
    Ratio,
    Table,
    Timing,
    interleaved,
    measured_on,
    peak,
    write_tables,
)
from tracer import render


def test_ratios_have_two_digits() -> None:
    assert [str(Ratio(ratio)) for ratio in (0.5, 0.998, 42.4)] == ["0.50×", "1.0×", "42×"]


def test_tasks_run_in_turns_and_only_short_ones_go_on() -> None:
    order: list[str] = []

    def task(name: str, seconds: float) -> Callable[[], None]:
        return lambda: (order.append(name), sleep(seconds))[1]

    timings = interleaved({"a": task("a", 0.03), "b": task("b", 0)}, 2, enough=0.05)
    assert order[:6] == ["a", "b"] * 3  # after one of each to warm up
    assert set(order[6:]) == {"b"}
    assert all(0 < t.low <= t.median <= t.high for t in timings.values())


def test_a_page_and_its_csv_say_where_they_were_measured(tmp_path: Path) -> None:
    row = ("room", Timing.of([0.04, 0.05, 0.09]), Ratio(0.25))
    table = Table("Title", "A note.", ("scene", "time", "ratio"), [row])
    where = measured_on()
    assert re.search(r"commit [0-9a-f]{7}\b|no commit", where)
    write_tables(tmp_path / "page.md", "# Page\n\nMade so.", where, [table])
    assert (tmp_path / "page.md").read_text() == (
        f"# Page\n\nMade so. Measured on {where}.\n\n## Title\n\nA note.\n\n"
        "| scene | time | ratio |\n| --- | --- | --- |\n| room | 50.0 (40.0–90.0) | 0.25× |\n"
    )
    time, ratio = ("time", "0.05", "0.04", "0.09"), ("ratio", "0.25", "", "")
    cells = [["Title", "room", *cell] for cell in (time, ratio)]
    assert measurements.read_csv(tmp_path / "page.csv") == (where, cells)


def test_memory_is_that_of_a_process_or_its_largest_worker() -> None:
    here = peak(sys.executable, "-c", "")
    script = "import os; os.fork() or bytearray(50_000_000); os.wait()"
    # A bare interpreter takes about ten, this process with Mitsuba hundreds.
    assert here < 40
    assert peak(sys.executable, "-c", script) - here == pytest.approx(50, abs=10)


@pytest.mark.slow
@pytest.mark.parametrize("section", benchmark.SECTIONS, ids=lambda section: section.__name__)
def test_benchmark_tables_are_complete(
    section: benchmark.Section, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(benchmark, "ROUNDS", 1)
    table = section(True)
    lines = [line for line in table.markdown().splitlines() if line.startswith("|")]
    assert len(lines) == 2 + len(table.rows) > 2
    assert {line.count("|") for line in lines} == {len(table.header) + 1}


@pytest.mark.slow
def test_speed_accuracy_of_a_small_picture(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(command, "BUILD", tmp_path)
    scene = small("four-spheres", 32, 18)
    monkeypatch.setattr(speed_accuracy, "_scenes", lambda quick: {"small": scene})
    monkeypatch.setattr(sys, "argv", ["speed_accuracy", "--quick"])
    if use().variant != LLVM:
        with pytest.raises(ImportError, match=LLVM):
            speed_accuracy.main()
        return
    speed_accuracy.main()
    _, rows = measurements.read_csv(tmp_path / "speed_accuracy.csv")
    ours = {int(row[2]): float(row[3]) for row in rows if row[1] == "this tracer"}
    assert sorted(ours) == [1, 4, 9, 16, 36, 144]
    assert ours[1] > ours[4] > ours[9] >= ours[16] > ours[144]
    truth = true_picture(scene, 1 / 1024).image
    assert ours[9] == pytest.approx(rmse(render(scene, 9), truth), rel=1e-5)
    certified = {int(row[2]): float(row[3]) for row in rows if row[1].endswith("certified")}
    assert sorted(certified) == [8, 32, 128]
    assert certified[8] > certified[32] > certified[128]
    assert (tmp_path / "speed_accuracy.svg").exists()
