"""What charts and tables show: the alternatives err as theory says, and every measurement runs.

No time is asserted.
"""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from time import sleep

import mitsuba as mi
import numpy as np
import pytest
from messages import told

from converters.variant import LLVM, use
from reference import (
    ablation,
    alternatives,
    benchmark,
    charts,
    command,
    minimal,
    rivals,
    speed_accuracy,
    stability,
)
from reference.alternatives import closest_approach, exactly, float32, float64, textbook
from reference.benchmark import growth_exponent
from reference.povray import to_pov
from reference.rivals import povray_trace
from reference.speed_accuracy import Lead, Point, Truth
from reference.tables import Ratio, Table, quote
from reference.timing import Task, Timing, interleaved, on_copies
from reference.workloads import CROWDS, Crowd, afresh, crowd, lit_by, resized, rods, to_xml
from tracer import Scene, load_scene, render
from tracer.arrays import Floats

ROOT = Path(__file__).resolve().parent.parent
SCENES = ROOT / "scenes"


def _small(name: str, width: int = 48, height: int = 27) -> Scene:
    return resized(load_scene(SCENES / f"{name}.xml"), width, height)


# --- The alternatives ------------------------------------------------------------------


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
    roots: alternatives.Roots,
    arithmetic: alternatives.Arithmetic,
    distances: Floats,
    power: int,
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
    scene = _small(name)
    exact = alternatives.render(scene, exactly)
    assert exact.max() > 0.1
    # A few hundred roundings between the scene and the picture.
    np.testing.assert_allclose(render(scene), exact, rtol=0, atol=1e-12)
    np.testing.assert_allclose(alternatives.render(scene), exact, rtol=0, atol=1e-12)


def test_offset_moves_the_samples_of_both_renderers_alike() -> None:
    scene = _small("four-spheres")
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


@pytest.mark.parametrize("panel", stability.PANELS, ids=lambda panel: panel.title)
def test_the_tracer_holds_at_the_hard_end_of_every_axis(panel: stability.Panel) -> None:
    found = stability.measure(panel, {"this tracer": render}, panel.at[-1:])["this tracer"]
    # Shares are exact decisions; radiance keeps seven digits at 1e8, and six at 1e9.
    assert found <= (2e-7 if panel.judge is stability.largest_error else 0.0)


# --- Workloads -------------------------------------------------------------------------


@pytest.mark.parametrize("kind", CROWDS)
@pytest.mark.parametrize("count", [1, 10, 300])
def test_crowds_are_what_they_say(kind: Crowd, count: int) -> None:
    scene = crowd(count, kind)
    surfaces, eye = scene.surfaces, np.array(scene.camera.view_point)
    assert len(surfaces) == count
    assert len(scene.lights) == 2
    assert (np.linalg.norm(surfaces.center - eye, axis=1) > surfaces.radius).all()
    assert not ((surfaces.min_pt <= eye) & (eye <= surfaces.max_pt)).all(axis=1).any()
    light = np.array(scene.lights[0].position)
    if kind == "cone":
        to_object = surfaces.center - light
        cosine = -(to_object @ light) / np.linalg.norm(to_object, axis=1) / np.linalg.norm(light)
        assert (np.degrees(np.arccos(cosine)) < 2).all()
    if kind == "eye amid" and count > 10:
        assert (surfaces.center.min(axis=0) < eye).all()
        assert (surfaces.center.max(axis=0) > eye).all()
    if kind == "light amid" and count > 10:
        assert (surfaces.center.min(axis=0) < light).all()
        assert (surfaces.center.max(axis=0) > light).all()


@pytest.mark.parametrize("kind", CROWDS)
def test_crowds_survive_the_file(kind: Crowd, tmp_path: Path) -> None:
    scene = crowd(50, kind, width=64, height=36)
    path = tmp_path / "crowd.xml"
    path.write_text(to_xml(scene))
    assert np.array_equal(render(load_scene(path)), render(scene))


def test_copies_share_nothing_and_move_by_next_to_nothing() -> None:
    scene = _small("four-spheres")
    copy = afresh(scene, 1)
    assert not np.shares_memory(copy.surfaces.center, scene.surfaces.center)
    assert np.array_equal(render(afresh(scene, 0)), render(scene))
    assert 0 < np.abs(render(copy) - render(scene)).mean() < 1e-3


def test_lights_are_as_many_as_asked_for_and_as_bright_together() -> None:
    one, many = (lit_by(_small("four-spheres"), count) for count in (1, 7))
    assert len(many.lights) == 7
    total = np.sum([light.intensity for light in many.lights], axis=0)
    np.testing.assert_allclose(total, one.lights[0].intensity)


# --- Measurements ----------------------------------------------------------------------


def test_growth_exponent_of_a_power_law() -> None:
    sizes = [10, 100, 1000]
    timings = [Timing.of([n**0.4]) for n in sizes]
    assert growth_exponent(sizes, timings) == pytest.approx(0.4)


def test_interleaved_runs_in_turns() -> None:
    order: list[str] = []

    def task(name: str) -> Task:
        return lambda k: order.append(f"{name}{k}")

    tasks = {name: task(name) for name in "ab"}
    timings = interleaved(tasks, 2)
    assert order == ["a0", "b0", "a1", "b1"]
    assert all(0 <= t.low <= t.median <= t.high for t in timings.values())


def test_each_round_has_a_scene_of_its_own() -> None:
    scene = _small("one-sphere", 4, 4)
    task = on_copies(lambda copy: copy, scene, 3)
    copies = [task(k) for k in (-1, 0, 1, 2)]
    assert copies[1] == scene
    for number, copy in enumerate(copies):
        assert isinstance(copy, Scene)
        assert copy is not scene
        assert copy not in copies[:number]


def test_only_short_tasks_go_on() -> None:
    rounds: list[int] = []
    tasks: dict[str, Task] = {"long": lambda _: sleep(0.02), "short": rounds.append}
    timings = interleaved(tasks, 1, most=4, seconds=0.015)
    assert timings["long"].low == timings["long"].high
    assert rounds == [0, 1, 2, 3]


@pytest.mark.parametrize("name", ["one-sphere", "sticks-perspective"])
def test_the_compiled_loop_draws_the_same_picture(name: str) -> None:
    scene = _small(name)
    if minimal.compiler() is None:
        with pytest.raises(FileNotFoundError, match="no C compiler"):
            minimal.Minimal(scene).find()
        return
    loops = minimal.Minimal(scene)
    loops.find()
    # It computes otherwise, and contracts to fused multiply-adds; no pixel sees another surface.
    np.testing.assert_allclose(loops.shade(), render(scene), rtol=0, atol=1e-9)


@pytest.mark.parametrize(
    "section",
    [
        benchmark.whole_process,
        benchmark.warm,
        benchmark.loading,
        benchmark.memory,
        benchmark.crowded,
    ],
    ids=lambda section: section.__name__,
)
def test_benchmark_tables_are_complete(
    section: benchmark.Section, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(benchmark, "_MORE", 1)
    monkeypatch.setattr(benchmark, "_FEW", ("one-sphere",))
    table = section(1, True)
    assert table.rows
    assert all(len(row) == len(table.header) for row in table.rows)
    assert len(list(table.records())) == len(table.rows) * (len(table.header) - 1)
    lines = table.markdown().splitlines()
    assert {line.count("|") for line in lines if line.startswith("|")} == {len(table.header) + 1}


@pytest.mark.parametrize("part", ablation.ONE_SAMPLE, ids=lambda part: part.name)
def test_no_part_changes_a_picture_of_one_sample(part: ablation.Part) -> None:
    for scene in (_small("highlights", 96, 54), crowd(300, width=96, height=54)):
        picture = render(scene, threads=1)
        with ablation.without(part):
            other = render(scene, threads=1)
        # Highlights from vectors round differently.
        assert np.abs(other - picture).max() <= 1e-12


@pytest.mark.parametrize("part", ablation.ANTIALIASING, ids=lambda part: part.name)
def test_antialiasing_without_a_part_is_another_way_to_the_same(part: ablation.Part) -> None:
    scene = _small("sunflower", 96, 54)
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


def test_a_page_quotes_tables_between_its_marks(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    marks = "<!-- x:begin -->\n", "<!-- x:end -->\n"
    page.write_text("before\n{}old\n{}after\n".format(*marks))
    table = Table("Title", "A note.", ("scene", "time"), [("ball", 0.25)])
    for _ in range(2):
        quote(page, "x", "Made so.", [table])
        assert page.read_text() == (
            f"before\n{marks[0]}Made so.\n\n"
            "### Title\n\nA note.\n\n| scene | time |\n|---|---|\n| ball | 0.25 |\n\n"
            f"{marks[1]}after\n"
        )


def test_the_compact_table_has_every_scene_at_every_size() -> None:
    header = ("scene", "tracer", "speedup over exact", "speedup over stock")
    rows = [
        (f"{name} {size}", Timing.of([ours]), Ratio(exact), Ratio(stock))
        for size, ours, exact, stock in (("3×2", 0.01, 2, 0.48), ("6×4", 0.04, 0.25, 0.5))
        for name in ("a", "b")
    ]
    table = benchmark.compact(Table("Warm", "", header, list(rows)))
    assert table.header == ("scene", "3×2", "speedup", "6×4", "speedup")
    cells = [line.strip("| ").split(" | ") for line in table.markdown().splitlines()[-4:]]
    assert cells[0] == ["a", "10.0", "2.0×", "40.0", "0.25×"]
    assert cells[2] == ["geometric mean", "", "2.0×", "", "0.25×"]
    assert cells[3] == ["the same over stock plugins", "", "0.48×", "", "0.50×"]


def test_memory_is_that_of_the_child() -> None:
    here = benchmark.peak(sys.executable, "-c", "")
    more = benchmark.peak(sys.executable, "-c", "x = bytearray(50_000_000)")
    # A bare interpreter takes about ten, this process with Mitsuba hundreds.
    assert here < 40
    assert more - here == pytest.approx(50, abs=10)
    # And that of all its workers together, while they are there.
    script = "import os, time; os.fork(); x = bytearray(50_000_000); time.sleep(0.5)"
    both = benchmark.peak(sys.executable, "-c", script)
    assert both - here == pytest.approx(100, abs=20)


def test_supersampling_in_parts_is_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = _small("sticks-perspective", 16, 9)
    whole = speed_accuracy.supersampled(scene, 4)
    by_hand = np.mean(
        [render(scene, offset=(x / 4 - 3 / 8, y / 4 - 3 / 8)) for x in range(4) for y in range(4)],
        axis=0,
    )
    monkeypatch.setattr(speed_accuracy, "MAX_PIXELS", 4 * 16 * 9)
    # The same rays, but for the last bit, that decides no pixel here.
    np.testing.assert_allclose(speed_accuracy.supersampled(scene, 4), whole, rtol=0, atol=1e-12)
    np.testing.assert_allclose(by_hand, whole, rtol=0, atol=1e-12)


def test_truth_is_rows_of_the_whole_picture(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    scene = _small("sticks-perspective", 16, 9)
    monkeypatch.setattr(command, "BUILD", tmp_path)
    monkeypatch.setattr(speed_accuracy, "_PIXELS", 16 * 9 // 4)
    truth = Truth.of(scene, 5)
    assert truth.radiance.shape == (2, 16, 3)
    whole = speed_accuracy.supersampled(scene, 5)
    # The same rays, but for the last bit, that decides no pixel here.
    assert truth.error(whole) < 1e-12
    assert truth.error(whole + 0.1) == pytest.approx(0.1)
    stored = Truth.of(scene, 5)
    assert np.array_equal(stored.radiance, truth.radiance)


def _curve(method: str, *errors_and_seconds: tuple[float, float]) -> list[Point]:
    return [
        Point("any", method, 4**k, False, error, Timing.of([seconds]))
        for k, (error, seconds) in enumerate(errors_and_seconds)
    ]


def test_lead_is_over_the_fastest_rival_at_the_same_error() -> None:
    ours = _curve("this tracer", (1e-2, 1.0), (5e-4, 2.0), (1e-4, 4.0))
    slow = _curve("Mitsuba scalar", (1e-2, 9.0), (1e-4, 9.0))
    fast = _curve("Mitsuba stratified", (1e-2, 3.0), (1e-5, 3.0))
    numpy = _curve("uniform grid", (1e-2, 0.1), (1e-5, 0.1))
    lead = Lead.of([*ours, *slow, *fast, *numpy])
    assert lead is not None
    assert (lead.level, lead.ours, lead.theirs) == pytest.approx((1e-3, 2.0, 3.0))
    assert lead.speedup == pytest.approx(1.5)
    # Rivals take any number of samples; this tracer those of its points.
    between = Lead.of([*ours, *_curve("Mitsuba scalar", (1e-2, 1.0), (1e-4, 4.0))])
    assert between is not None
    assert (between.level, between.ours, between.theirs) == pytest.approx((1e-3, 2.0, 2.0))
    # Where a rival does not come so far, it is met where it comes; to be better is as good.
    rough = Lead.of([*ours, *_curve("Mitsuba scalar", (1.0, 1.0), (0.1, 2.0))])
    assert rough is not None
    assert (rough.level, rough.ours, rough.theirs) == pytest.approx((0.1, 1.0, 2.0))
    # One that ends a little above the others is met there, if it is faster; not one that ends far.
    early = _curve("Mitsuba independent", (1e-2, 0.5), (1.2e-3, 1.5))
    near = Lead.of([*ours, *fast, *early])
    assert near is not None
    assert (near.level, near.ours, near.theirs) == pytest.approx((1.2e-3, 2.0, 1.5))
    far = Lead.of([*ours, *fast, *_curve("Mitsuba independent", (1e-2, 0.5), (2e-3, 1.5))])
    assert far is not None
    assert far.theirs == pytest.approx(3.0)
    # The first picture of ours that is as good counts, whatever the noise of later ones.
    noisy = Lead.of([*_curve("this tracer", (5e-4, 2.0), (1e-4, 1.0)), *fast])
    assert noisy is not None
    assert noisy.ours == 2.0
    assert Lead.of([*ours, *numpy]) is None


def test_what_is_expected_to_take_too_long() -> None:
    # Four times the samples take four times as long, but for starting up; POV-Ray has thresholds.
    assert speed_accuracy._next("Mitsuba scalar", []) == 0
    assert speed_accuracy._next("Mitsuba scalar", [1.0]) == 2
    assert speed_accuracy._next("Mitsuba scalar", [1.0, 1.5]) == 3.5
    assert speed_accuracy._next("POV-Ray adaptive", [1.0, 1.5]) == 2
    assert speed_accuracy._next("POV-Ray adaptive", [1.0, 0.5]) == 0.5


@pytest.mark.parametrize(("said", "seconds"), [("0.000", 0.0005), ("1.250", 1.25)])
def test_time_of_povray(said: str, seconds: float) -> None:
    # No time at all has no place on a logarithmic axis.
    script = f"import sys; sys.stderr.write('Trace Time: 0 hours 0 minutes ({said} seconds)')"
    assert povray_trace([sys.executable, "-c", script]) == seconds


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
    scene = _small("four-spheres", 32, 18)
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
    truth = Truth.of(scene, speed_accuracy.truth_side(quick=True))
    assert ours[9] == pytest.approx(truth.error(render(scene, 9)), rel=1e-5)
    chart = tmp_path / "speed_accuracy.svg"
    chart.unlink()
    monkeypatch.setattr(sys, "argv", ["speed_accuracy", "--quick", "--redraw"])
    monkeypatch.delattr(speed_accuracy, "measure")
    speed_accuracy.main()
    assert chart.exists()


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


@pytest.mark.skipif(not rivals.povray_installed(), reason="there is no POV-Ray here")
@pytest.mark.parametrize("name", ["sticks-shifted", "non-square-pixels", "sunflower"])
def test_povray_draws_the_same_picture(name: str, tmp_path: Path) -> None:
    scene, png = _small(name), tmp_path / "picture.png"
    povray_trace(rivals.povray_linear(scene, png))
    # Its numbers end at 4, in steps of 16 bits; at this size no edge runs through a pixel's centre.
    np.testing.assert_allclose(rivals.povray_picture(png), render(scene), rtol=0, atol=3 / 65535)


def test_pov_scene_names_every_object_and_light() -> None:
    scene = _small("sticks-perspective")
    text = to_pov(scene)
    assert text.count("sphere {") == len(scene.surfaces.radius)
    assert text.count("box {") == len(scene.surfaces.min_pt)
    assert text.count("light_source {") == len(scene.lights)


def test_the_merged_mesh_is_closed_around_every_object() -> None:
    surfaces = (scene := crowd(12)).surfaces
    vertices, faces = rivals._triangles(scene)
    edges = np.sort(np.concatenate([faces[:, [k, (k + 1) % 3]] for k in range(3)]), axis=1)
    _, sides = np.unique(edges, axis=0, return_counts=True)
    assert (sides == 2).all()
    balls, boxes = np.split(vertices[faces], [20 * surfaces.sphere_count])
    away = balls.reshape(-1, 60, 3) - surfaces.center[:, None]
    np.testing.assert_allclose(np.linalg.norm(away, axis=2).T, [surfaces.radius] * 60)
    corners = boxes.reshape(-1, 36, 3)
    np.testing.assert_allclose(corners.min(axis=1), surfaces.min_pt)
    np.testing.assert_allclose(corners.max(axis=1), surfaces.max_pt)


def test_mitsuba_stays_usable_after_a_chart_has_switched_variants() -> None:
    stability.mitsuba_render(stability.ball_on_ground(), "scalar_rgb")
    assert use().variant == mi.variant()


@pytest.mark.parametrize(
    "module", ["ablation", "benchmark", "regenerate", "report", "speed_accuracy", "stability"]
)
def test_a_command_without_its_packages_says_what_to_install(tmp_path: Path, module: str) -> None:
    (tmp_path / "mitsuba.py").write_text("raise ModuleNotFoundError('No module named mitsuba')")
    done = subprocess.run(
        [sys.executable, "-m", f"reference.{module}"],
        capture_output=True,
        text=True,
        cwd=ROOT,
        env=os.environ | {"PYTHONPATH": str(tmp_path)},
        check=False,
    )
    missing = "No module named mitsuba; install it with pip install -e '.[reference]'\n"
    assert (done.returncode, done.stdout, told(done.stderr)) == (2, "", missing)
