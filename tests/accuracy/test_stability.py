"""The stability chart: usual methods have the errors that theory predicts; the tracer does not."""

import sys
from dataclasses import replace

import numpy as np
import pytest

from reference import command, stability
from reference.judges import plain
from tracer import render


@pytest.mark.parametrize(
    ("sphere_method", "arithmetic", "distances", "power"),
    [
        ("textbook", "float64", 10.0 ** np.arange(2, 6.6, 0.5), 2),
        ("closest", "float64", 10.0 ** np.arange(2, 6.6, 0.5), 1),
        ("textbook", "float32", 10.0 ** np.arange(1, 3.1, 0.25), 2),
        ("closest", "float32", 10.0 ** np.arange(1, 5.1, 0.5), 1),
    ],
)
def test_error_grows_with_distance_as_eps_times_its_power(
    sphere_method, arithmetic, distances, power
):
    errors = []
    for distance in distances.tolist():
        scene = stability.build_distant_sphere_scene(distance)
        image = plain.render(scene, arithmetic=arithmetic, sphere_method=sphere_method)
        exact = plain.render(scene, arithmetic="decimal")
        errors.append(stability.measure_largest_error(image, exact))
    slope = np.polyfit(np.log(distances), np.log(errors), 1)[0]
    # Rounding errors are almost random, so a fit over a few decades is accurate to one third.
    assert abs(slope - power) < 1 / 3
    # The constant factor is a small number.
    eps = np.finfo(arithmetic).eps
    assert 0.1 < np.median(errors / (eps * distances**power)) < 30


@pytest.mark.parametrize(
    ("scene", "method"),
    [
        *(picture[1:] for picture in stability.EXAMPLES),
        (stability.build_ball_scene(scale=2.0**30), "t > 1e-6"),  # rounding errors are larger
        (stability.build_ball_scene(scale=2.0**-30), "normal offset 1e-4"),
        # Near a coordinate plane, 256 ulp are less than the rounding errors of hits.
        (stability.build_ball_scene(scale=2.0**20), "offset of 256 ulp"),
    ],
)
def test_usual_methods_fail_where_the_chart_shows_it(scene, method):
    exact = plain.render(scene, arithmetic="decimal")
    assert stability.measure_wrong_pixels(stability.METHODS[method](scene), exact) > 1
    assert stability.measure_wrong_pixels(render(scene), exact) == 0


@pytest.mark.parametrize("panel", stability.PANELS, ids=lambda panel: panel.title)
def test_the_tracer_is_accurate_at_the_end_of_every_axis(panel):
    error = stability.measure_errors(panel, "this tracer", panel.positions[-1:])
    # No decision is wrong.  Radiance has seven correct digits at 1e8, and six at 1e9.
    assert error <= (2e-7 if panel.measures_radiance else 0.0)


def test_errors_of_small_pictures(monkeypatch):
    exact = np.array([[[0.5] * 3, [0.0] * 3], [[0.25] * 3, [1.0] * 3]])
    changed = exact + np.array([[[0.0], [0.125]], [[-0.25], [0.0]]])
    unknown = exact.copy()
    unknown[0, 0, 1] = np.nan
    for image, largest, percentage in ((changed, 0.25, 50), (unknown, 1, 25)):
        assert stability.measure_largest_error(image, exact) == largest
        assert stability.measure_wrong_pixels(image, exact) == percentage
    # A point of the chart shows the largest error of several scenes at nearby positions.
    panel = replace(stability.PANELS[0], position_factors=(1.0, 3.0, 2.0))
    monkeypatch.setitem(
        stability.METHODS, "dark", lambda s: render(s) * (s.camera.proj_distance < 25)
    )
    assert stability.measure_errors(panel, "dark", [10.0]) > 0.5


@pytest.mark.slow
def test_chart_of_a_few_points(monkeypatch, tmp_path):
    monkeypatch.setattr(command, "BUILD", tmp_path)
    monkeypatch.setattr(sys, "argv", ["stability", "--quick"])
    panels = [
        replace(panel, positions=panel.positions[[0, 1, 2, -1]]) for panel in stability.PANELS
    ]
    monkeypatch.setattr(stability, "PANELS", panels)
    stability.main()
    assert {path.suffix for path in tmp_path.iterdir()} == {".svg", ".csv"}
    table = (tmp_path / "stability.csv").read_text()
    assert table.count(",this tracer,") == 2 * len(panels)
    chart = tmp_path / "stability.svg"
    drawn = chart.read_text()
    assert table.partition(",")[2].partition(",")[0] in drawn  # the commit
    # Names are stored as text; as outlines they would make the file ten times as large.
    assert drawn.count(">this tracer</text>") == 2  # once in each legend
    # With --redraw, the chart is drawn from the table without measuring anything.
    monkeypatch.setattr(sys, "argv", ["stability", "--quick", "--redraw"])
    monkeypatch.delattr(stability, "measure_errors")
    chart.unlink()
    stability.main()
    assert chart.read_text() == drawn
