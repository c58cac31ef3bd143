"""The benchmark: its scenes and rivals, and tables that are complete.

No time is asserted.
"""

from __future__ import annotations

import sys
from pathlib import Path
from time import sleep

import numpy as np
import pytest
from scene_files import small

from reference import benchmark, minimal, rivals
from reference.benchmark import growth_exponent
from reference.povray import to_pov
from reference.rivals import povray_trace
from reference.tables import Ratio, Table, quote
from reference.timing import Task, Timing, interleaved, on_copies
from reference.workloads import CROWDS, Crowd, afresh, crowd, lit_by, to_xml
from tracer import Scene, load_scene, render


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
    scene = small("four-spheres")
    copy = afresh(scene, 1)
    assert not np.shares_memory(copy.surfaces.center, scene.surfaces.center)
    assert np.array_equal(render(afresh(scene, 0)), render(scene))
    assert 0 < np.abs(render(copy) - render(scene)).mean() < 1e-3


def test_lights_are_as_many_as_asked_for_and_as_bright_together() -> None:
    one, many = (lit_by(small("four-spheres"), count) for count in (1, 7))
    assert len(many.lights) == 7
    total = np.sum([light.intensity for light in many.lights], axis=0)
    np.testing.assert_allclose(total, one.lights[0].intensity)


def test_growth_exponent_of_a_power_law() -> None:
    sizes = [10, 100, 1000]
    timings = [Timing.of([n**0.4]) for n in sizes]
    assert growth_exponent(sizes, timings) == pytest.approx(0.4)


def test_a_speedup_is_the_time_of_the_other_over_that_of_the_tracer() -> None:
    assert benchmark._speedup(Timing.of([1.0]), Timing.of([3.0])) == 3


@pytest.mark.parametrize(("ratio", "shown"), [(0.5, "0.50×"), (0.998, "1.0×"), (42.4, "42×")])
def test_ratios_have_two_digits(ratio: float, shown: str) -> None:
    assert str(Ratio(ratio)) == shown


def test_interleaved_runs_in_turns() -> None:
    order: list[str] = []

    def task(name: str) -> Task:
        return lambda k: order.append(f"{name}{k}")

    tasks = {name: task(name) for name in "ab"}
    timings = interleaved(tasks, 2)
    assert order == ["a0", "b0", "a1", "b1"]
    assert all(0 <= t.low <= t.median <= t.high for t in timings.values())


def test_each_round_has_a_scene_of_its_own() -> None:
    scene = small("one-sphere", 4, 4)
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
    scene = small(name)
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
        benchmark.smooth,
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


@pytest.mark.parametrize(("said", "seconds"), [("0.000", 0.0005), ("1.250", 1.25)])
def test_time_of_povray(said: str, seconds: float) -> None:
    # No time at all has no place on a logarithmic axis.
    script = f"import sys; sys.stderr.write('Trace Time: 0 hours 0 minutes ({said} seconds)')"
    assert povray_trace([sys.executable, "-c", script]) == seconds


@pytest.mark.skipif(not rivals.povray_installed(), reason="there is no POV-Ray here")
@pytest.mark.parametrize("name", ["sticks-shifted", "non-square-pixels", "sunflower"])
def test_povray_draws_the_same_picture(name: str, tmp_path: Path) -> None:
    scene, png = small(name), tmp_path / "picture.png"
    povray_trace(rivals.povray_linear(scene, png))
    # Its numbers end at 4, in steps of 16 bits; at this size no edge runs through a pixel's centre.
    np.testing.assert_allclose(rivals.povray_picture(png), render(scene), rtol=0, atol=3 / 65535)


def test_pov_scene_names_every_object_and_light() -> None:
    scene = small("sticks-perspective")
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
