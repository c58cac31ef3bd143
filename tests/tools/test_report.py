"""The report page: its content, and the command that writes it."""

import base64
import io
import re
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image
from skimage.metrics import structural_similarity

from converters.rendering import Rendering
from reference import figures
from reference.check import CheckResult
from reference.figures import (
    amplify_difference,
    compare_codes,
    decode_to_linear,
    get_largest_difference,
    measure_differences,
)
from reference.report import ComparedScene, main, render_report

WIDTH, HEIGHT = 8, 6


def make_codes(blue: int) -> NDArray[np.uint8]:
    """Return codes that differ in all pixels: red 10 + 30 column, green 10 + 40 row, and `blue`."""
    row, column = np.mgrid[:HEIGHT, :WIDTH]
    return np.dstack([10 + 30 * column, 10 + 40 * row, np.full_like(row, blue)]).astype(np.uint8)


TRACER, MITSUBA = make_codes(blue=40), make_codes(blue=200)
MITSUBA[5, 7] = 255  # the pixel that is excluded


def make_result(name: str = "pair") -> CheckResult:
    """Return the comparison of two pictures that differ in blue, with one excluded pixel."""
    tracer, mitsuba = decode_to_linear(TRACER), decode_to_linear(MITSUBA)
    edges = np.zeros((HEIGHT, WIDTH), dtype=np.bool_)
    edges[5, 7] = True
    mitsuba[5, 7] = 9  # so large a difference that it would change the amplification
    return CheckResult(
        name=name,
        tracer_image=tracer,
        tracer_seconds=0.0123,
        mitsuba=Rendering(mitsuba, "scalar_rgb", 4.5),
        differs_at_edge=edges,
        is_tie=np.zeros_like(edges),
        is_disputed=~edges,
        is_examined=~edges,
        is_wrong=~edges,
        metrics=measure_differences(tracer, mitsuba, edges),
    )


CHART = b'<svg xmlns="http://www.w3.org/2000/svg" width="20" height="10"><circle r="4"/></svg>'


def test_the_page_contains_everything_that_it_shows():
    same = replace(make_result("two"), is_wrong=np.zeros((HEIGHT, WIDTH), dtype=np.bool_))
    scenes = [
        ComparedScene(make_result("<b>&"), comment="Shows <one> & more."),
        ComparedScene(same, comment=""),
    ]
    text = render_report(scenes, [("Chart", CHART)])
    for expected in (
        "12.3 ms",
        "4.50 s",
        "Shows &lt;one&gt; &amp; more.",
        'alt="&lt;b&gt;&amp;: tracer"',
        "✗ DIFFERS",
        "✗ undecided",
        "The pictures differ in 47 pixels, for example at column 0, row 0.",
        "<dt>edge pixels excluded</dt><dd>1</dd>",
        base64.b64encode(CHART).decode(),
        "0 agree.",
    ):
        assert expected in text
    assert "<!--" not in text
    assert "&amp;lt;" not in text, "a name is escaped twice"
    ids = re.findall(r' id="([^"]*)"', text)
    assert len(ids) == len(set(ids))
    assert text.count('<section class="scene"') == 2
    sources = re.findall(r'(?:src|href)="([^"]*)"', text)
    assert len(sources) == 3 + 2 + 1  # the pictures of the second pair equal those of the first
    assert text.count(" data-same=") == 3
    assert all(source.startswith(("data:image/", "#")) for source in sources)
    pictures = [
        np.asarray(Image.open(io.BytesIO(base64.b64decode(data))))
        for data in re.findall(r'src="data:image/png;base64,([^"]+)"', text)
    ]
    np.testing.assert_array_equal(pictures[0], TRACER)
    np.testing.assert_array_equal(pictures[1], MITSUBA)
    # decode_to_linear(40) - decode_to_linear(200) = -0.57, amplified once, in the blue of "darker".
    blue = np.round(255 * 0.5695 * np.array([0.34, 0.71, 0.91]))
    np.testing.assert_array_equal(pictures[2][0, 0], blue)
    assert pictures[2][5, 7].tolist() == [76, 76, 76], "an excluded pixel is grey"


@pytest.mark.parametrize("rows_per_band", [1, 5, 6, 7, 8, 23, 31, 32, 40])
@pytest.mark.parametrize("size", [(32, 24), (32, 5), (6, 40), (7, 7)], ids=str)
def test_a_comparison_in_bands_is_that_of_the_whole_pictures(size, rows_per_band, monkeypatch):
    rng, (height, width) = np.random.default_rng(1), size
    left = rng.integers(0, 256, (height, width, 3)).astype(np.uint8)
    right = np.clip(left + rng.normal(0, 25, left.shape), 0, 255).astype(np.uint8)
    monkeypatch.setattr(figures, "_PIXELS_PER_BAND", rows_per_band * width)
    ssim, rmse, largest, difference = compare_codes(left, right)
    # A picture that is smaller than a window is continued by its edge.
    padding = [(0, max(7 - height, 0)), (0, max(7 - width, 0)), (0, 0)]
    padded = [np.pad(codes / 255, padding, mode="edge") for codes in (left, right)]
    expected = structural_similarity(*padded, win_size=7, channel_axis=2, data_range=1.0)
    # The windows are computed in float32.
    assert ssim == pytest.approx(expected, abs=1e-5)
    assert 0.8 < ssim < 0.999
    exact = (left / 255) ** 2.2 - (right / 255) ** 2.2
    assert rmse == pytest.approx(np.sqrt((exact**2).mean()))
    assert largest == pytest.approx(np.abs(exact).max())
    np.testing.assert_allclose(difference, get_largest_difference(exact), atol=1e-7)


def test_pixels_that_differ_by_more_than_a_thousandth_are_counted():
    images = np.zeros((2, 4, 4, 3))
    images[1, 0, :3, 1] = 0.99e-3, 1.01e-3, -0.5
    images[1, 1, 0] = 2e-3  # one pixel, not three channels
    metrics = measure_differences(*images)
    assert metrics.differing_count == 3
    assert str(metrics).endswith(" pixels over 1e-3: 3")


@pytest.mark.parametrize(("largest", "gain"), [(0.9, 1), (0.34, 2), (0.15, 5), (0.0011, 500)])
def test_differences_are_amplified_to_fit_except_for_the_largest(largest, gain):
    a = np.zeros((50, 50, 3))
    a[0, :3, 1] = (1.5, -1.5, largest)  # a thousandth of the pixels may exceed the range
    a[1, :3, 2] = -largest
    picture, actual_gain = amplify_difference(get_largest_difference(a))
    assert actual_gain == pytest.approx(gain)
    for row, color in ((0, (1, 0.62, 0)), (1, (0.34, 0.71, 0.91))):
        codes = 255 * gain * largest * np.array(color)
        np.testing.assert_allclose(picture[row, 2], codes, atol=0.5 + 1e-9)
    assert not picture[2:].any()


@pytest.fixture
def report(capsys: pytest.CaptureFixture[str]) -> Callable[..., tuple[int, str, str]]:
    """Return a function that runs the command in Mitsuba's scalar variant.

    It returns the exit status, the text on standard error, and the page.
    """

    def run_report(output: Path | str, *arguments: Path | str) -> tuple[int, str, str]:
        status = main(["--variant", "scalar_rgb", *map(str, arguments), "-o", str(output)])
        page = Path(output)
        text = page.read_text(encoding="utf-8") if page.is_file() else ""
        return status, capsys.readouterr().err, text

    return run_report


@pytest.mark.parametrize(
    ("encoding", "before", "within", "shown"),
    [
        ("latin-1", "<!-- Kugel für Übung -->", "<!-- later -->", "Kugel für Übung"),
        ("utf-16", "<!-- Kugel für Übung -->", "", "Kugel für Übung"),
        ("utf-8", "", "<!-- ask somebody -->", ""),
    ],
)
def test_a_scene_is_described_by_its_first_comment(
    tmp_path, report, encoding, before, within, shown
):
    scene = f"<image>9 9</image><camera/>{within}<surface type='Sphere'/>"
    text = f"<?xml version='1.0' encoding='{encoding}'?>{before}<scene>{scene}</scene>"
    (tmp_path / "a.xml").write_text(text, encoding=encoding)
    folder = tmp_path / "new"
    assert report(f"{folder}/", tmp_path / "a.xml")[:2] == (0, "")
    html = (folder / "report.html").read_text(encoding="utf-8")
    assert shown in html
    assert "ask somebody" not in html


def test_without_standard_error_the_page_is_written(small_file, report, monkeypatch):
    monkeypatch.setattr(sys, "stderr", None)
    status, _, text = report(small_file.with_name("report.html"), small_file)
    assert (status, '<strong class="good">All agree.<' in text) == (0, True)


def test_scenes_with_the_same_name_are_named_by_their_paths(small_file, report):
    other = small_file.parent / "other" / small_file.name
    other.parent.mkdir()
    text = small_file.read_text(encoding="utf-8")
    other.write_text(text.replace("The unit sphere", "The same again"), encoding="utf-8")
    status, _, text = report(small_file.with_name("report.html"), small_file, other, small_file)
    ids = re.findall(r' id="(pair-[^"]*)"', text)
    assert (status, len(ids), len(set(ids))) == (0, 2, 2)
    assert re.findall(r' href="#([^"]*)"', text) == ids
    assert re.findall("<h2>(.*?)</h2>", text)[:2] == sorted(map(str, (small_file, other)))
    assert text.count("The unit sphere") == text.count("The same again") == 1
