"""The benchmark and the charts: complete, and with the right ratios.  No time is tested."""

import re
import sys
from collections.abc import Callable, Mapping
from time import sleep

import pytest
from scene_files import small_scene

from converters.variant import LLVM, use_variant
from reference import benchmark, command, speed_accuracy
from reference.judges.certificate import certify
from reference.judges.sampling import compute_rms_error
from reference.measured import measurements
from reference.measured.charts import plt
from reference.measured.measurements import Task, Timing
from tracer import render


def test_tasks_alternate_and_only_short_ones_get_more_rounds_and_warm_up():
    order: list[str] = []

    def make_task(name: str, seconds: float) -> Callable[[], None]:
        return lambda: (order.append(name), sleep(seconds))[1]

    tasks = {"a": make_task("a", 0.2), "b": make_task("b", 0)}
    timings = measurements.time_alternately(tasks, 2, min_seconds=0.3)
    assert order[:8] == ["a", "b", *["a", "b", "b"] * 2]  # the first two runs are not timed
    assert set(order[8:]) == {"b"}
    assert all(0 < t.low <= t.median <= t.high for t in timings.values())


def test_tables_show_times_and_ratios_and_keep_their_origin(tmp_path):
    time = Timing(0.05, 0.04, 0.09)
    rows = [("room", time, 0.25), ("far", time.divided_by(5), 42.4)]
    assert benchmark.format_section("Title", "A note.", ("scene", "time", "ratio"), rows) == (
        "## Title\n\nA note.\n\n| scene | time | ratio |\n| --- | --- | --- |\n"
        "| room | 50.0 (40.0–90.0) | 0.25× |\n| far | 10.0 (8.0–18.0) | 42× |"
    )
    ratios = [benchmark.format_ratio(value) for value in (0.994, 0.996, 9.94, 9.96)]
    assert ratios == ["0.99×", "1.0×", "9.9×", "10×"]
    origin = measurements.describe_origin()
    assert re.search(r"commit [0-9a-f]{7}\b|no commit", origin)
    measurements.write_csv(tmp_path / "a.csv", origin, ("name", "error"), [("room", 1 / 3)])
    assert measurements.read_csv(tmp_path / "a.csv") == (origin, [["room", "0.333333"]])


# Seconds of each task, as if they had been measured.
SECONDS = {"tracer": 0.1, "tracer, 1 process": 0.4, "tracer, 2 processes": 0.2}
SECONDS |= {"Mitsuba": 0.3, "Mitsuba exact": 0.3, "Mitsuba stock": 0.2, "the same, scalar": 0.25}


@pytest.mark.parametrize(
    ("section", "ratios"),
    [
        (
            benchmark.benchmark_whole_process,
            {name: ["3.0×", "2.0×"] for name in ("geometric mean 320×180", "one-sphere 320×180")},
        ),
        (benchmark.benchmark_rendering, {"geometric mean 320×180": ["3.0×", "3.0×"]}),
        (benchmark.benchmark_frames, {"tracer, 2 processes": ["2.0×"], "Mitsuba exact": ["1.3×"]}),
    ],
)
def test_speedups_are_above_1_where_the_tracer_is_faster(section, ratios, monkeypatch, tmp_path):
    def prescribe_times(tasks: Mapping[str, Task], *_: object, **__: object) -> dict[str, Timing]:
        return {name: Timing(*[SECONDS.get(name, 1.0)] * 3) for name in tasks}

    monkeypatch.setattr(command, "BUILD", tmp_path)
    monkeypatch.setattr(benchmark, "time_alternately", prescribe_times)
    rows = [line[2:-2].split(" | ") for line in section(True).splitlines() if line[:2] == "| "]
    shown = {row[0]: [cell for cell in row[1:] if "×" in cell] for row in rows}
    assert {name: shown[name] for name in ratios} == ratios


@pytest.mark.slow
@pytest.mark.parametrize("section", benchmark.BENCHMARKS, ids=lambda section: section.__name__)
def test_benchmark_tables_are_complete(section, monkeypatch):
    monkeypatch.setattr(benchmark, "MIN_ROUNDS", 1)
    monkeypatch.setattr(measurements, "_MAX_ROUNDS_FACTOR", 1)
    lines = [line for line in section(True).splitlines() if line.startswith("|")]
    assert len(lines) > 2
    assert len({line.count("|") for line in lines}) == 1


@pytest.mark.slow
def test_costs_of_a_million_frames(monkeypatch, tmp_path, capsys):
    pytest.importorskip("distributed", reason="distributed is not installed")
    from reference import cluster

    monkeypatch.setattr(command, "BUILD", tmp_path)
    monkeypatch.setattr(sys, "argv", ["cluster", "--quick"])
    cluster.main()
    page = (tmp_path / "cluster.md").read_text(encoding="utf-8")
    assert page == capsys.readouterr().out
    name, milliseconds, hours, dollars = re.search(r"\| (tracer.*) \|\n", page)[1].split(" | ")
    assert name == "tracer, 1 process"
    assert float(hours) == pytest.approx(float(milliseconds) / 3.6, abs=0.7)
    assert float(dollars.removeprefix("$")) == pytest.approx(float(hours) * 0.05, abs=0.03)


def make_row(scene: str, method: str, samples: str, error: float, seconds: float) -> list[str]:
    return [scene, method, samples, *map(str, (error, seconds, seconds, seconds))]


@pytest.mark.parametrize("scene_count", [1, 2, 5])
def test_the_chart_has_a_panel_for_each_scene_and_a_legend(scene_count):
    rows = [make_row(f"scene {k}", "this tracer", "1", 1e-2, 1e-2) for k in range(scene_count)]
    figure = speed_accuracy._draw_chart(rows)
    plt.close(figure)
    visible = [axes for axes in figure.axes if axes.axison]
    assert [axes.get_title("left") for axes in visible] == [
        f"scene {k}" for k in range(scene_count)
    ]
    assert all(len(line.get_xdata()) == 1 for line in (axes.lines[0] for axes in visible))
    assert figure.axes[-1].get_legend()
    assert not figure.axes[-1].axison


def test_curves_are_sorted_and_show_the_best_settings_of_povray():
    errors = {"16": 1e-3, "4": 1e-3, "1": 1e-1}
    cells = [make_row("room", "this tracer", n, error, 1.0) for n, error in errors.items()]
    rows = [*map(speed_accuracy._parse_row, cells)]
    curve = speed_accuracy._find_curve(rows, "this tracer")
    assert [point.samples for point in curve] == ["1", "16"]
    # "b" is slower than "a" and has a larger error.
    settings = {"d": (1e-4, 9.0), "b": (3e-3, 2.0), "a": (2e-3, 1.0), "c": (1e-3, 3.0)}
    cells = [make_row("room", "POV-Ray adaptive", s, *point) for s, point in settings.items()]
    rows += map(speed_accuracy._parse_row, cells)
    curve = speed_accuracy._find_curve(rows, "POV-Ray adaptive")
    assert [point.samples for point in curve] == ["a", "c", "d"]


@pytest.mark.slow
def test_speed_accuracy_of_a_small_picture(monkeypatch, tmp_path):
    monkeypatch.setattr(command, "BUILD", tmp_path)
    monkeypatch.setattr(measurements, "_MAX_ROUNDS_FACTOR", 1)
    monkeypatch.setattr(speed_accuracy, "_MAX_SECONDS", float("inf"))  # on a loaded machine, too
    scene = small_scene("four-spheres", 32, 18)
    monkeypatch.setattr(speed_accuracy, "_load_scenes", lambda quick: {"small": scene})
    monkeypatch.setattr(sys, "argv", ["speed_accuracy", "--quick"])
    if use_variant().variant != LLVM:
        with pytest.raises(ImportError, match=LLVM):
            speed_accuracy.main()
        return
    speed_accuracy.main()
    _, rows = measurements.read_csv(tmp_path / "speed_accuracy.csv")
    ours = {int(row[2]): float(row[3]) for row in rows if row[1] == "this tracer"}
    # With 144 samples, the error may be smaller than that of the reference picture.
    assert sorted(ours)[:5] == [1, 4, 9, 16, 36]
    assert ours[1] > ours[4] > ours[9] >= ours[16] >= ours[36]
    reference_image = certify(scene, 1 / 1024).image
    error = compute_rms_error(render(scene, 9), reference_image)
    assert ours[9] == pytest.approx(error, rel=1e-5)
    certified = {int(row[2]): float(row[3]) for row in rows if row[1].endswith("certified")}
    assert sorted(certified) == [8, 32, 128]
    assert certified[8] > certified[32] > certified[128]
    assert (tmp_path / "speed_accuracy.svg").exists()
