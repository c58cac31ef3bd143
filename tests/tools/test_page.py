"""The page of pairs of pictures in a real browser, the system's Chromium."""

import io
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from conftest import find_program
from numpy.typing import NDArray
from PIL import Image
from playwright.sync_api import Browser, Page, sync_playwright
from test_report import CHART, HEIGHT, MITSUBA, TRACER, WIDTH, make_result

from reference.compare import main
from reference.report import ComparedScene, render_report

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    """Start the browser, once for all tests of this module."""
    with sync_playwright() as playwright:
        options = {"executable_path": find_program("chromium"), "args": ["--no-sandbox"]}
        with playwright.chromium.launch(**options) as launched:
            yield launched


@pytest.fixture
def page(browser: Browser, tmp_path: Path) -> Iterator[Page]:
    """Open a page with one pair and a chart; check that it requests nothing else, without errors.

    Animations are off, as readers can request: pictures change only when a button is pressed.
    """
    path = tmp_path / "report.html"
    scenes = [ComparedScene(make_result(), comment="")]
    path.write_text(render_report(scenes, [("Chart", CHART)]), encoding="utf-8")
    size = {"width": 1280, "height": 1000}
    with browser.new_page(viewport=size, reduced_motion="reduce") as page:
        schemes, messages = [], []
        page.on("request", lambda request: schemes.append(request.url.partition(":")[0]))
        page.on("console", lambda message: messages.append(message.text))
        page.on("pageerror", lambda error: messages.append(str(error)))
        page.goto(path.as_uri())
        yield page
        assert {*schemes} <= {"file", "data"}
        assert messages == []


def capture(page: Page, index: int = 0) -> NDArray[np.uint8]:
    """Return the colours (HEIGHT, WIDTH, 3) that a panel shows at the unzoomed pixels' centres."""
    with Image.open(io.BytesIO(page.locator(".panel").nth(index).screenshot())) as image:
        shown = np.asarray(image.convert("RGB"))
    rows = ((np.arange(HEIGHT) + 0.5) / HEIGHT * shown.shape[0]).astype(int)
    return shown[rows][:, ((np.arange(WIDTH) + 0.5) / WIDTH * shown.shape[1]).astype(int)]


def drag(page: Page, *positions: float) -> None:
    """Drag the mouse over positions in the first panel, in fractions of its width."""
    box = page.locator(".panel").first.bounding_box()
    for k, position in enumerate(positions):
        page.mouse.move(box["x"] + position * box["width"], box["y"] + 0.4 * box["height"])
        if not k:
            page.mouse.down()
    page.mouse.up()


def test_slider_and_seam(page):
    """The slider and the seam decide how much of each picture is visible."""
    assert page.evaluate("[...document.images].map(i => i.naturalWidth)") == [8, 8, 8, 20]
    slider = page.locator("input")
    halves = capture(page)
    np.testing.assert_array_equal(halves[:, :4], TRACER[:, :4])
    np.testing.assert_array_equal(halves[:, 4:], MITSUBA[:, 4:])
    slider.press("End")
    np.testing.assert_array_equal(capture(page), TRACER)
    slider.press("Home")
    np.testing.assert_array_equal(capture(page), MITSUBA)
    slider.fill("50")
    drag(page, 0.505, 0.4, 0.25)
    np.testing.assert_array_equal(capture(page)[:, :2], TRACER[:, :2])
    np.testing.assert_array_equal(capture(page)[:, 2:], MITSUBA[:, 2:])
    assert (slider.input_value(), page.locator(".scale").text_content()) == ("25", "1×")


def test_flicker_shows_the_pictures_alternately(page):
    button, shown = page.locator(".flicker"), []
    for _ in range(3):
        button.click()
        shown.append({*capture(page)[:, :, 2].ravel().tolist()})
    assert shown[0] != shown[1]
    assert all(blues in ({40}, {200, 255}) for blues in shown)
    assert shown[2] == shown[0]
    assert button.get_attribute("aria-pressed") == "true"
    page.locator("input").fill("50")
    assert button.get_attribute("aria-pressed") == "false"


def test_clicks_zoom_to_a_pixel(page):
    """Each click doubles the scale about the clicked point, here (5.5, 2.5) pixels."""
    page.locator("input").press("End")
    panel = page.locator(".panel").first
    box = panel.bounding_box()
    point = {"x": 5.5 / WIDTH * box["width"], "y": 2.5 / HEIGHT * box["height"]}
    for scale in (2, 4, 8, 16):
        panel.click(position=point)
        assert page.locator(".scale").text_content() == f"{scale}×"
    # At 16 times, the panel shows only half a pixel: column 5, row 2.
    for index, colours in ((0, {tuple(TRACER[2, 5].tolist())}), (1, None)):
        shown = {*map(tuple, capture(page, index).reshape(-1, 3).tolist())}
        assert shown == colours or (colours is None and len(shown) == 1)
    readout = "column 5, row 2: tracer 160 90 40, Mitsuba 160 90 200, difference 160"
    assert page.locator(".readout").text_content() == readout


@pytest.mark.parametrize("drags", [False, True])
def test_zoom_and_move(page, *, drags):
    """Zoom in by 2 about the centre, move to columns 4 to 7 at the border, and zoom out."""
    page.locator("input").press("End")
    panel = page.locator(".panel").first
    page.locator(".in").click() if drags else panel.press("+")
    np.testing.assert_array_equal(capture(page)[0, :, 0], TRACER[0, [2, 2, 3, 3, 4, 4, 5, 5], 0])
    if drags:  # to the left by half a panel, which is a quarter of the picture
        drag(page, 0.6, 0.35, 0.1)
    else:
        for _ in range(12):
            panel.press("ArrowRight")
    np.testing.assert_array_equal(capture(page)[0, :, 0], TRACER[0, [4, 4, 5, 5, 6, 6, 7, 7], 0])
    page.locator(".all").click() if drags else panel.press("-")
    np.testing.assert_array_equal(capture(page), TRACER)


def test_a_page_about_hand_ins(browser, tmp_path):
    """Names are shown as text, thumbnails lead to pairs, and a ring marks the worst pixel."""
    scene = tmp_path / "<b>.xml"
    scene.write_text(
        "<scene><image>8 6</image><camera/><light><position>1 2 3</position></light></scene>"
    )
    wrong = np.zeros((HEIGHT, WIDTH, 3), dtype=np.uint8)
    wrong[2, 5] = (255, 0, 0)
    for name, codes in (("<i>ada/<b>.png", wrong), ("bob/<b>.png", 0 * wrong)):
        (tmp_path / "class" / name).parent.mkdir(parents=True)
        Image.fromarray(codes).save(tmp_path / "class" / name)
    assert main([str(tmp_path / "class"), str(scene), "--html", str(tmp_path / "class.html")]) == 1
    with browser.new_page() as page:
        page.goto((tmp_path / "class.html").as_uri())
        assert page.locator("td:first-child").all_text_contents() == ["<i>ada", "bob"]
        assert page.locator("h2").all_text_contents() == ["<i>ada/<b>.png", "bob/<b>.png"]
        widths = page.evaluate("[...document.images].map(i => i.naturalWidth)")
        assert widths == [8] * len(widths)
        links = page.locator("td a")
        verdicts = links.all_text_contents()
        assert verdicts[0] == "✗ One pixel differs, most on the background (brighter)."
        assert verdicts[1:] == ["✓ agrees"]
        links.first.click()
        assert page.url.endswith("#pair-0")
        for _ in range(2):
            panel, ring = (page.locator(name).first.bounding_box() for name in (".panel", ".worst"))
            zoom = 1 if page.locator(".scale").first.text_content() == "1×" else 2
            for axis, side, pixel in (("x", "width", 5.5 / 8), ("y", "height", 2.5 / 6)):
                center = (ring[axis] + ring[side] / 2 - panel[axis]) / panel[side]
                assert center == pytest.approx(zoom * (pixel - (zoom - 1) / 4), abs=0.01)
            page.locator(".in").first.click()
        assert page.locator(".worst").count() == 3  # in each picture of the pair that differs
