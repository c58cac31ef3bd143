"""The page of pairs of pictures in a real browser, the system's Chromium."""

import io
import time
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from conftest import need
from numpy.typing import NDArray
from PIL import Image
from playwright.sync_api import Browser, Page, sync_playwright
from test_report import CHART, HEIGHT, MITSUBA, TRACER, WIDTH, result

from reference.compare import main
from reference.report import page as report_page

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with sync_playwright() as playwright:
        options = {"executable_path": need("chromium"), "args": ["--no-sandbox"]}
        with playwright.chromium.launch(**options) as launched:
            yield launched


@pytest.fixture
def page(browser: Browser, tmp_path: Path) -> Iterator[Page]:
    """A page of one pair and a chart; it asks for nothing but its file, and reports no error."""
    path = tmp_path / "report.html"
    path.write_text(report_page([result()], {"pair": ""}, [("Chart", CHART)]), encoding="utf-8")
    with browser.new_page(viewport={"width": 1280, "height": 1000}) as opened:
        asked, told = [], []
        opened.on("request", lambda request: asked.append(request.url.partition(":")[0]))
        opened.on("console", lambda message: told.append(message.text))
        opened.on("pageerror", lambda error: told.append(str(error)))
        opened.goto(path.as_uri())
        yield opened
        assert {*asked} <= {"file", "data"}
        assert told == []


def shot(page: Page, index: int = 0) -> NDArray[np.uint8]:
    """Colours (HEIGHT, WIDTH, 3) in the middles of a panel's pixels, as they are unzoomed."""
    with Image.open(io.BytesIO(page.locator(".panel").nth(index).screenshot())) as image:
        shown = np.asarray(image.convert("RGB"))
    rows = ((np.arange(HEIGHT) + 0.5) / HEIGHT * shown.shape[0]).astype(int)
    return shown[rows][:, ((np.arange(WIDTH) + 0.5) / WIDTH * shown.shape[1]).astype(int)]


def drag(page: Page, *parts: float) -> None:
    """Over parts of the panel's width, a little above its middle."""
    box = page.locator(".panel").first.bounding_box()
    for k, part in enumerate(parts):
        page.mouse.move(box["x"] + part * box["width"], box["y"] + 0.4 * box["height"])
        if not k:
            page.mouse.down()
    page.mouse.up()


def test_slider_and_seam(page):
    """In the middle half of each; at the slider's ends all of one; the seam can be dragged."""
    assert page.evaluate("[...document.images].map(i => i.naturalWidth)") == [8, 8, 8, 20]
    slider = page.locator("input")
    middle = shot(page)
    np.testing.assert_array_equal(middle[:, :4], TRACER[:, :4])
    np.testing.assert_array_equal(middle[:, 4:], MITSUBA[:, 4:])
    slider.press("End")
    np.testing.assert_array_equal(shot(page), TRACER)
    slider.press("Home")
    np.testing.assert_array_equal(shot(page), MITSUBA)
    slider.fill("50")
    drag(page, 0.505, 0.4, 0.25)
    np.testing.assert_array_equal(shot(page)[:, :2], TRACER[:, :2])
    np.testing.assert_array_equal(shot(page)[:, 2:], MITSUBA[:, 2:])
    assert (slider.input_value(), page.locator(".scale").text_content()) == ("25", "1×")


def blues(page: Page, seconds: float) -> list[int]:
    """The blue of the whole panel, over some time: each picture has one of its own."""
    seen, end = [], time.monotonic() + seconds
    while time.monotonic() < end:
        (blue,) = {*shot(page)[:, :, 2].ravel().tolist()}
        seen.append(blue)
    return seen


def test_flicker(page):
    """Each picture whole, in turn; slower than three flashes a second; it stops when told.

    Who wants no motion sees the other picture at each press, and nothing moves by itself.
    """
    button = page.locator(".flicker")
    button.click()
    assert button.get_attribute("aria-pressed") == "true"
    seen = blues(page, 2.0)
    assert {*seen} == {40, 200}
    assert sum(a != b for a, b in pairwise(seen)) <= 4
    page.locator(".panel").first.press("f")
    assert button.get_attribute("aria-pressed") == "false"
    page.emulate_media(reduced_motion="reduce")
    turns = []
    for _ in range(3):
        button.click()
        turns.append({*blues(page, 0.8)})
    assert sorted(map(tuple, turns[:2])) == [(40,), (200,)]
    assert turns[2] == turns[0]


def test_click_zooms_to_the_pixel(page):
    """Each click doubles, about the place clicked: (5.5, 2.5) pixels stays where it is."""
    page.locator("input").press("End")
    panel = page.locator(".panel").first
    box = panel.bounding_box()
    at = {"x": 5.5 / WIDTH * box["width"], "y": 2.5 / HEIGHT * box["height"]}
    for times in (2, 4, 8, 16):
        panel.click(position=at)
        assert page.locator(".scale").text_content() == f"{times}×"
    # At 16 times the panel shows half a pixel in width: one colour, that of column 5, row 2.
    for index, colours in ((0, {tuple(TRACER[2, 5].tolist())}), (1, None)):
        shown = {*map(tuple, shot(page, index).reshape(-1, 3).tolist())}
        assert shown == colours or (colours is None and len(shown) == 1)
    told = "column 5, row 2: tracer 160 90 40, Mitsuba 160 90 200, off by 160"
    assert page.locator(".readout").text_content() == told


@pytest.mark.parametrize("drags", [False, True])
def test_zoom_and_move(page, *, drags):
    """Twice as large about the centre, then to the picture's border: columns 4 ... 7; and back."""
    page.locator("input").press("End")
    panel = page.locator(".panel").first
    page.locator(".in").click() if drags else panel.press("+")
    np.testing.assert_array_equal(shot(page)[0, :, 0], TRACER[0, [2, 2, 3, 3, 4, 4, 5, 5], 0])
    if drags:  # half a panel to the left is a quarter of the picture
        drag(page, 0.6, 0.35, 0.1)
    else:
        for _ in range(12):
            panel.press("ArrowRight")
    np.testing.assert_array_equal(shot(page)[0, :, 0], TRACER[0, [4, 4, 5, 5, 6, 6, 7, 7], 0])
    page.locator(".all").click() if drags else panel.press("-")
    np.testing.assert_array_equal(shot(page), TRACER)


def test_all_is_reached_by_tab(page):
    reached = []
    for _ in range(9):
        page.keyboard.press("Tab")
        active = "(e => e.ariaLabel || e.textContent.trim())(document.activeElement)"
        reached.append(page.evaluate(active))
    panels = ["pair: tracer and Mitsuba", "pair: difference × 1", "pair: how much is of the left"]
    buttons = ["Flicker", "Zoom out", "Zoom in", "All"]
    assert reached == ["All scenes", "pair", *panels, *buttons]


WIDER = "[...document.querySelectorAll('body, main, .scroll, table, .scene, p, h1, h2')]"
WIDER += ".filter(e => e.getBoundingClientRect().right > innerWidth + 1).map(e => e.className)"


def test_on_a_phone_and_printed(page):
    """On a phone the table scrolls in its own box, and fingers meet the controls.

    On paper there are no controls, nothing sticks out, and no picture is cut in two.
    """
    page.set_viewport_size({"width": 375, "height": 700})
    assert page.evaluate("document.documentElement.scrollWidth") == 375
    assert page.evaluate("(e => e.scrollWidth > e.clientWidth)(document.querySelector('.scroll'))")
    sizes = page.evaluate(
        "[...document.querySelectorAll('button, input, .seam')]"
        ".map(e => e.getBoundingClientRect()).map(r => Math.min(r.width, r.height))"
    )
    assert (len(sizes), min(sizes) >= 44) == (6, True)
    page.set_viewport_size({"width": 680, "height": 960})  # A4
    page.emulate_media(media="print")
    assert page.evaluate(WIDER) == []
    assert not any(one.is_visible() for one in page.locator("button, input, .seam, kbd").all())
    uncut = "[...document.querySelectorAll('figure, .chart, tr')]"
    assert {*page.evaluate(f"{uncut}.map(e => getComputedStyle(e).breakInside)")} == {"avoid"}


def test_a_class(browser, tmp_path):
    """Names are text; thumbnails lead to pairs; the worst pixel has a ring, zoomed as well."""
    scene = tmp_path / "<b>.xml"
    scene.write_text(
        "<scene><image>8 6</image><camera/><light><position>1 2 3</position></light></scene>"
    )
    wrong = np.zeros((HEIGHT, WIDTH, 3), dtype=np.uint8)
    wrong[2, 5] = (255, 0, 0)
    for name, codes in (("<i>ada</i>/<b>.png", wrong), ("bob/<b>.png", 0 * wrong)):
        (tmp_path / "class" / name).parent.mkdir(parents=True)
        Image.fromarray(codes).save(tmp_path / "class" / name)
    assert main([str(tmp_path / "class"), str(scene), "--html", str(tmp_path / "class.html")]) == 1
    with browser.new_page() as page:
        page.goto((tmp_path / "class.html").as_uri())
        assert page.locator("td:first-child").all_text_contents() == ["<i>ada</i>", "bob"]
        assert page.locator("h2").all_text_contents() == ["<i>ada</i>/<b>.png", "bob/<b>.png"]
        widths = page.evaluate("[...document.images].map(i => i.naturalWidth)")
        assert widths == [8] * len(widths)
        links = page.locator("td a")
        assert links.all_text_contents() == ["✗ differs", "✓ agrees"]
        links.first.click()
        assert page.url.endswith("#pair-0")
        for _ in range(2):
            panel, ring = (page.locator(name).first.bounding_box() for name in (".panel", ".worst"))
            zoom = 1 if page.locator(".scale").first.text_content() == "1×" else 2
            for axis, side, at in (("x", "width", 5.5 / 8), ("y", "height", 2.5 / 6)):
                middle = (ring[axis] + ring[side] / 2 - panel[axis]) / panel[side]
                assert middle == pytest.approx(zoom * (at - (zoom - 1) / 4), abs=0.01)
            page.locator(".in").first.click()
        assert page.locator(".worst").count() == 3  # in each picture of what differs alone
