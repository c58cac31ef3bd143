"""The stability chart: usual methods err as theory says, and the tracer does not."""

import sys
from dataclasses import replace

import numpy as np
import pytest

from reference import command, stability
from reference.judges import plain
from tracer import render


@pytest.mark.parametrize(
    ("spheres", "arithmetic", "distances", "power"),
    [
        ("textbook", "float64", 10.0 ** np.arange(2, 6.6, 0.5), 2),
        ("closest", "float64", 10.0 ** np.arange(2, 6.6, 0.5), 1),
        ("textbook", "float32", 10.0 ** np.arange(1, 3.1, 0.25), 2),
        ("closest", "float32", 10.0 ** np.arange(1, 5.1, 0.5), 1),
    ],
)
def test_error_grows_with_distance_as_eps_times_its_power(spheres, arithmetic, distances, power):
    errors = []
    for distance in distances.tolist():
        scene = stability.distant(distance)
        image = plain.render(scene, arithmetic=arithmetic, spheres=spheres)
        errors.append(stability.largest_error(image, plain.render(scene, arithmetic="decimal")))
    slope = np.polyfit(np.log(distances), np.log(errors), 1)[0]
    # Rounding errors are as good as random: a fit over a few decades comes within a third.
    assert abs(slope - power) < 1 / 3
    # The constant in front is a small number.
    eps = np.finfo(arithmetic).eps
    assert 0.1 < np.median(errors / (eps * distances**power)) < 30


@pytest.mark.parametrize(
    ("scene", "method"),
    [
        *(picture[1:] for picture in stability.EXAMPLES),
        (stability.ball_on_ground(scale=2.0**30), "t > 1e-6"),  # rounding is larger
        (stability.ball_on_ground(scale=2.0**-30), "normal offset 1e-4"),
        # Close to a plane of coordinates an ulp is nothing.
        (stability.ball_on_ground(scale=2.0**20), "offset of 256 ulp"),
    ],
)
def test_usual_methods_fail_where_the_chart_says(scene, method):
    exact = plain.render(scene, arithmetic="decimal")
    assert stability.wrong_share(stability.METHODS[method](scene), exact) > 1
    assert stability.wrong_share(render(scene), exact) == 0


@pytest.mark.parametrize("panel", stability.PANELS, ids=lambda panel: panel.title)
def test_the_tracer_holds_at_the_hard_end_of_every_axis(panel):
    found = stability.measure(panel, "this tracer", panel.positions[-1:])
    # Shares are exact decisions; radiance keeps seven digits at 1e8, and six at 1e9.
    assert found <= (2e-7 if panel.error is stability.largest_error else 0.0)


def test_what_the_chart_shows_by_hand(monkeypatch):
    exact = np.array([[[0.5] * 3, [0.0] * 3], [[0.25] * 3, [1.0] * 3]])
    off = exact + np.array([[[0.0], [0.125]], [[-0.25], [0.0]]])
    lost = exact.copy()
    lost[0, 0, 1] = np.nan
    for image, most, share in ((off, 0.25, 50), (lost, 1, 25)):
        assert stability.largest_error(image, exact) == most
        assert stability.wrong_share(image, exact) == share
    # Of the scenes near a point the worst counts.
    panel = replace(stability.PANELS[0], nearby=(1.0, 3.0, 2.0))
    monkeypatch.setitem(
        stability.METHODS, "dark", lambda s: render(s) * (s.camera.proj_distance < 25)
    )
    assert stability.measure(panel, "dark", [10.0]) > 0.5


@pytest.mark.slow
def test_chart_of_a_few_points(monkeypatch, tmp_path):
    monkeypatch.setattr(command, "BUILD", tmp_path)
    monkeypatch.setattr(sys, "argv", ["stability", "--quick"])
    few = [0, 1, 2, -1]
    panels = [replace(panel, positions=panel.positions[few]) for panel in stability.PANELS]
    monkeypatch.setattr(stability, "PANELS", panels)
    stability.main()
    assert {path.suffix for path in tmp_path.iterdir()} == {".svg", ".csv"}
    table = (tmp_path / "stability.csv").read_text()
    assert table.count(",this tracer,") == 2 * len(panels)
    chart = tmp_path / "stability.svg"
    drawn = chart.read_text()
    assert table.partition(",")[2].partition(",")[0] in drawn  # the commit
    # Names are texts: written as outlines, they would be most of a file of a megabyte.
    assert drawn.count(">this tracer</text>") == 2  # once in each legend
    # Drawn again from the table it is the same, and nothing is measured.
    monkeypatch.setattr(sys, "argv", ["stability", "--quick", "--redraw"])
    monkeypatch.delattr(stability, "measure")
    chart.unlink()
    stability.main()
    assert chart.read_text() == drawn
