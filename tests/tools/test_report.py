"""The report page: what it holds, and how it works in a real browser."""

from __future__ import annotations

import base64
import io
import itertools
import json
import os
import re
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import need
from numpy.typing import NDArray
from PIL import Image
from scene_files import overflowing, small_one

from reference.check import CheckResult
from reference.figures import figures, linear
from reference.report import main, page

ROOT = Path(__file__).resolve().parents[2]
WIDTH, HEIGHT = 8, 6


def colours(blue: int) -> NDArray[np.uint8]:
    """Every pixel in a colour of its own: 10 + 30 column, 10 + 40 row, `blue`."""
    row, column = np.mgrid[:HEIGHT, :WIDTH]
    return np.dstack([10 + 30 * column, 10 + 40 * row, np.full_like(row, blue)]).astype(np.uint8)


Report = Callable[..., tuple[int, str, str]]
TRACER, MITSUBA = colours(blue=40), colours(blue=200)


def result(name: str = "pair") -> CheckResult:
    """A made-up comparison of two pictures that differ in blue, one pixel of it masked."""
    a, b = linear(TRACER), linear(MITSUBA)
    mask = np.zeros((HEIGHT, WIDTH), dtype=np.bool_)
    mask[5, 7] = True
    pictures = {"tracer": a, "mitsuba": b, "reference": b, "mask": mask}
    times = {"tracer_seconds": 0.0123, "mitsuba_seconds": 4.5}
    found = figures(a, b, mask)
    return CheckResult(name=name, figures=found, variant="scalar_rgb", **pictures, **times)


CHART = b'<svg xmlns="http://www.w3.org/2000/svg" width="20" height="10"><circle r="4"/></svg>'


def test_page_holds_everything() -> None:
    """Whatever it refers to is in it; names and comments are escaped once, and ids unique."""
    results = [result("<b>&"), replace(result("two"), differing=30, asked=30, agreed=30)]
    text = page(results, {"<b>&": "Shows <one> & more."}, [("Chart", CHART)])
    for told in (
        "12.3 ms",
        "4.50 s",
        "Shows &lt;one&gt; &amp; more.",
        'alt="&lt;b&gt;&amp; by the tracer"',
        "Mitsuba errs on 30 pixels, says exact arithmetic",
        "<dt>masked pixels</dt><dd>1</dd>",
        base64.b64encode(CHART).decode(),
        "0 agree.",
    ):
        assert told in text
    assert "<!--" not in text
    assert "&amp;lt;" not in text
    ids = re.findall(r' id="([^"]*)"', text)
    assert len(ids) == len(set(ids)) == text.count('<section class="scene"') == 2
    sources = re.findall(r'(?:src|href)="([^"]*)"', text)
    assert len(sources) == 2 * 4 + 1
    assert all(source.startswith(("data:image/", "#")) for source in sources)
    pictures = [
        np.asarray(Image.open(io.BytesIO(base64.b64decode(data))))
        for data in re.findall(r'src="data:image/png;base64,([^"]+)"', text)
    ]
    np.testing.assert_array_equal(pictures[0], TRACER)
    np.testing.assert_array_equal(pictures[1], MITSUBA)
    # linear(40) - linear(200) = -0.57 times 1, in the blue of "darker"; grey where masked.
    blue = np.round(255 * 0.5695 * np.array([0.34, 0.71, 0.91]))
    np.testing.assert_array_equal(pictures[2][0, 0], blue)
    assert pictures[2][5, 7].tolist() == [76, 76, 76]


@pytest.fixture
def report(capsys: pytest.CaptureFixture[str]) -> Report:
    """The command, in Mitsuba's plainest variant: its status, its errors, and the page."""

    def call(output: Path | str, *arguments: Path | str) -> tuple[int, str, str]:
        status = main(["--variant", "scalar_rgb", *map(str, arguments), "-o", str(output)])
        made = Path(output)
        text = made.read_text(encoding="utf-8") if made.is_file() else ""
        return status, capsys.readouterr().err, text

    return call


@pytest.fixture
def small(tmp_path: Path) -> Path:
    """A scene that is soon rendered."""
    return small_one(tmp_path, "16 12")


@pytest.mark.parametrize(
    ("encoding", "before", "within", "shown"),
    [
        ("latin-1", "<!-- Kugel für Übung -->", "<!-- later -->", "Kugel für Übung"),
        ("utf-16", "<!-- Kugel für Übung -->", "", "Kugel für Übung"),
        ("utf-8", "", "<!-- ask somebody -->", ""),
    ],
)
def test_what_a_scene_shows_is_its_first_comment(
    tmp_path: Path, report: Report, encoding: str, before: str, within: str, shown: str
) -> None:
    scene = f"<image>9 9</image><camera/>{within}<surface type='Sphere'/>"
    text = f"<?xml version='1.0' encoding='{encoding}'?>{before}<scene>{scene}</scene>"
    (tmp_path / "a.xml").write_text(text, encoding=encoding)
    folder = tmp_path / "new"
    assert report(f"{folder}/", tmp_path / "a.xml")[:2] == (0, "")
    html = (folder / "report.html").read_text(encoding="utf-8")
    assert shown in html
    assert "ask somebody" not in html


@pytest.mark.parametrize("output", ["small.xml", "link.xml"])
def test_scenes_are_not_replaced(
    small: Path, report: Report, capsys: pytest.CaptureFixture[str], output: str
) -> None:
    small.with_name("link.xml").symlink_to(small.name)
    before = small.read_bytes()
    with pytest.raises(SystemExit, match="2"):
        report(small.with_name(output), small)
    assert "this would replace an input; choose another with -o" in capsys.readouterr().err
    assert small.read_bytes() == before


def test_bad_scenes_are_told_and_spare_the_others(small: Path, report: Report) -> None:
    folder, pipe, missing, bad = map(small.with_name, ("folder", "pipe", "missing.xml", "no.xml"))
    folder.mkdir()
    os.mkfifo(pipe)
    bad.write_text("<scene/>")
    bright = overflowing(small)
    scenes = (bright, folder, missing, bad, pipe, small)
    status, error, text = report(small.with_name("report.html"), *scenes)
    assert status == 1
    for words in (
        f"{bright}: Mitsuba's radiance is not finite; keep the colours and lights of the scene",
        f"{folder}: is a folder; name a scene file in it",
        f"{missing}: cannot be read: No such file or directory; check the path and its permissions",
        f"{bad}:1: scene: has no image",
        f"{pipe}: is not a regular file; save the scene to one",
    ):
        assert error.count(words) == 1
    assert len(error.splitlines()) == 6  # <scene/> has two faults
    assert text.count('<section class="scene"') == 1
    assert "The unit sphere, lit from the upper left" in text
    assert "All agree." not in text
    assert "<p>1 scene, " in text
    assert f"Not compared: {folder}: is a folder; name a scene file in it<" in text
    assert text.count("Not compared: ") == 5


def test_what_is_in_the_way(small: Path, report: Report, monkeypatch: pytest.MonkeyPatch) -> None:
    """A pipe is not replaced; where a shell has closed the errors (`2>&-`), the page is made."""
    pipe = small.with_name("pipe")
    os.mkfifo(pipe)
    assert report(pipe, small) == (1, f"{pipe}: cannot be written: not a regular file\n", "")
    assert pipe.is_fifo()
    monkeypatch.setattr(sys, "stderr", None)
    status, _, text = report(small.with_name("report.html"), small)
    assert (status, "All agree." in text) == (0, True)


def test_scenes_of_one_name_are_told_apart(small: Path, report: Report) -> None:
    other = small.parent / "other" / small.name
    other.parent.mkdir()
    text = small.read_text(encoding="utf-8")
    other.write_text(text.replace("The unit sphere", "The same again"), encoding="utf-8")
    status, _, text = report(small.with_name("report.html"), small, other, small)
    ids = re.findall(r' id="([^"]*)"', text)
    assert (status, len(ids), len(set(ids))) == (0, 2, 2)
    assert re.findall(r' href="#([^"]*)"', text) == ids
    assert re.findall("<h2>(.*?)</h2>", text)[:2] == sorted(map(str, (small, other)))
    assert text.count("The unit sphere") == text.count("The same again") == 1


def test_a_variant_that_cannot_run_is_told_once(small: Path, report: Report) -> None:
    output = small.with_name("report.html")
    status, error, text = report(output, small, "--variant", "scalar_spectral")
    assert error.startswith("Mitsuba cannot run: scalar_spectral is no RGB variant; choose one of ")
    assert (status, error.count("\n"), text) == (1, 1, "")


class Browser:
    """Chromium on the DevTools protocol, by a pair of pipes."""

    def __init__(self, program: str, profile: Path) -> None:
        read_theirs, self._write = os.pipe()
        self._read, write_theirs = os.pipe()
        flags = "--headless --no-sandbox --disable-gpu --disable-background-networking"
        flags += " --disable-sync --no-first-run --hide-scrollbars --window-size=1280,1000"
        command = [program, *flags.split(), "--remote-debugging-pipe"]
        # The protocol is read from descriptor 3 and written to 4.
        move = f'exec 8<&{read_theirs} 9>&{write_theirs}; exec 3<&8 4>&9; exec "$@"'
        self.process = subprocess.Popen(
            ["bash", "-c", move, "bash", *command, f"--user-data-dir={profile}", "about:blank"],
            pass_fds=(read_theirs, write_theirs),
            stderr=subprocess.DEVNULL,
        )
        os.close(read_theirs)
        os.close(write_theirs)
        self._buffer = b""
        self._numbers = itertools.count(1)
        self._session: str | None = None
        self.events: list[dict[str, Any]] = []
        targets = self.call("Target.getTargets")["targetInfos"]
        target = next(t["targetId"] for t in targets if t["type"] == "page")
        self._session = self.call("Target.attachToTarget", targetId=target, flatten=True)[
            "sessionId"
        ]
        for domain in ("Page", "Runtime", "Network", "Log"):
            self.call(f"{domain}.enable")

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        number = next(self._numbers)
        message: dict[str, Any] = {"id": number, "method": method, "params": parameters}
        if self._session:
            message["sessionId"] = self._session
        os.write(self._write, json.dumps(message).encode() + b"\0")
        while True:
            answer = self._receive()
            if answer.get("id") == number:
                assert "error" not in answer, answer
                return dict(answer["result"])
            self.events.append(answer)

    def _receive(self) -> dict[str, Any]:
        while b"\0" not in self._buffer:
            data = os.read(self._read, 1 << 20)
            assert data, "the browser has gone"
            self._buffer += data
        message, _, self._buffer = self._buffer.partition(b"\0")
        return dict(json.loads(message))

    def open(self, path: Path) -> None:
        self.events.clear()
        self.call("Page.navigate", url=path.as_uri())
        while not any(event.get("method") == "Page.loadEventFired" for event in self.events):
            self.events.append(self._receive())

    def evaluate(self, expression: str) -> Any:
        answer = self.call("Runtime.evaluate", expression=expression, returnByValue=True)
        assert "exceptionDetails" not in answer, answer
        return answer["result"].get("value")

    def box(self, selector: str, index: int = 0) -> tuple[float, float, float, float]:
        """Left, top, width and height of an element, scrolled into view."""
        left, top, width, height = self.evaluate(
            f"(() => {{ const e = document.querySelectorAll({json.dumps(selector)})[{index}];"
            "e.scrollIntoView({block: 'center'}); const r = e.getBoundingClientRect();"
            "return [r.left, r.top, r.width, r.height]; })()"
        )
        return left, top, width, height

    def shot(self, index: int = 0) -> NDArray[np.uint8]:
        """Colours (HEIGHT, WIDTH, 3) in the middles of a panel's pixels, as they are unzoomed."""
        left, top, width, height = self.box(".panel", index)
        top += self.evaluate("window.scrollY")
        clip = {"x": left, "y": top, "width": width, "height": height, "scale": 1}
        data = self.call("Page.captureScreenshot", format="png", clip=clip)["data"]
        with Image.open(io.BytesIO(base64.b64decode(data))) as image:
            shown = np.asarray(image.convert("RGB"))
        rows = ((np.arange(HEIGHT) + 0.5) / HEIGHT * shown.shape[0]).astype(int)
        columns = ((np.arange(WIDTH) + 0.5) / WIDTH * shown.shape[1]).astype(int)
        return np.asarray(shown[rows][:, columns])

    def mouse(self, kind: str, x: float, y: float, **more: Any) -> None:
        self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, **more)

    def drag(self, *path: tuple[float, float]) -> None:
        """From the first of these points to the last."""
        self.mouse("mousePressed", *path[0], button="left", buttons=1, clickCount=1)
        for x, y in path[1:]:
            self.mouse("mouseMoved", x, y, button="left", buttons=1)
        self.mouse("mouseReleased", *path[-1], button="left", clickCount=1)

    def click(self, selector: str, at: tuple[float, float] = (0.5, 0.5)) -> bool:
        left, top, width, height = self.box(selector)
        self.drag((left + at[0] * width, top + at[1] * height))
        return True

    def press(self, selector: str, key: str, code: int = 0) -> None:
        """A key, where the focus is set first."""
        self.evaluate(f"document.querySelector({json.dumps(selector)}).focus()")
        more: dict[str, Any] = {"key": key, "code": key, "windowsVirtualKeyCode": code}
        text = {"text": key} if len(key) == 1 else {}
        self.call("Input.dispatchKeyEvent", type="keyDown", **more, **text)
        self.call("Input.dispatchKeyEvent", type="keyUp", **more)

    def text(self, selector: str) -> str:
        return str(self.evaluate(f"document.querySelector({json.dumps(selector)}).textContent"))

    def close(self) -> None:
        os.close(self._write)
        os.close(self._read)
        self.process.kill()
        self.process.wait()


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    chromium = Browser(need("chromium"), tmp_path_factory.mktemp("profile"))
    yield chromium
    chromium.close()


@pytest.fixture
def opened(browser: Browser, tmp_path: Path) -> Browser:
    path = tmp_path / "report.html"
    path.write_text(page([result()], {}, [("Chart", CHART)]), encoding="utf-8")
    browser.open(path)
    return browser


HOME, END, RIGHT, TAB = 36, 35, 39, 9


@pytest.mark.slow
def test_opens_alone(opened: Browser) -> None:
    """No request but for the file itself, no message on the console, every picture there."""
    opened.evaluate("1")
    requests = [
        event["params"]["request"]["url"]
        for event in opened.events
        if event.get("method") == "Network.requestWillBeSent"
    ]
    assert {url.partition(":")[0] for url in requests} <= {"file", "data"}
    told = ("Runtime.consoleAPICalled", "Runtime.exceptionThrown", "Log.entryAdded")
    assert [event for event in opened.events if event.get("method") in told] == []
    assert opened.evaluate("[...document.images].map(i => i.naturalWidth)") == [8, 8, 8, 20]


@pytest.mark.slow
def test_slider(opened: Browser) -> None:
    """In the middle half of each; at its ends all of one; by the keyboard, or the mouse."""
    middle = opened.shot()
    np.testing.assert_array_equal(middle[:, :4], TRACER[:, :4])
    np.testing.assert_array_equal(middle[:, 4:], MITSUBA[:, 4:])
    opened.press("input", "End", END)
    np.testing.assert_array_equal(opened.shot(), TRACER)
    opened.press("input", "Home", HOME)
    np.testing.assert_array_equal(opened.shot(), MITSUBA)
    opened.click("input", (0.75, 0.5))
    shown = opened.shot()
    np.testing.assert_array_equal(shown[:, :5], TRACER[:, :5])
    np.testing.assert_array_equal(shown[:, 7:], MITSUBA[:, 7:])


def seen_for(browser: Browser, seconds: float) -> list[int]:
    """Blues of the first and last column, over some time: each picture has one of its own."""
    seen = []
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        shown = browser.shot()
        assert len({*shown[:, :, 2].ravel().tolist()}) == 1
        seen.append(int(shown[0, 0, 2]))
        time.sleep(0.05)
    return seen


@pytest.mark.slow
def test_flicker(opened: Browser) -> None:
    """Each picture whole, in turn; slower than three flashes a second; it stops when told.

    Who wants no motion sees the other picture at each press, and nothing moves by itself.
    """
    opened.click(".flicker")
    assert opened.evaluate("document.querySelector('.flicker').ariaPressed") == "true"
    seen = seen_for(opened, 2.0)
    assert set(seen) == {40, 200}
    assert 2 <= sum(a != b for a, b in itertools.pairwise(seen)) <= 4
    opened.press(".panel", "f")
    assert opened.evaluate("document.querySelector('.flicker').ariaPressed") == "false"
    np.testing.assert_array_equal(opened.shot()[:, :4], TRACER[:, :4])
    still = [{"name": "prefers-reduced-motion", "value": "reduce"}]
    opened.call("Emulation.setEmulatedMedia", features=still)
    first, second, third = ({*seen_for(opened, 0.8)} for _ in range(3) if opened.click(".flicker"))
    assert (first, second) in (({40}, {200}), ({200}, {40}))
    assert third == first
    opened.call("Emulation.setEmulatedMedia", features=[])


@pytest.mark.slow
def test_click_zooms_to_the_pixel(opened: Browser) -> None:
    """Each click doubles, about the place clicked: (5.5, 2.5) pixels stays where it is."""
    opened.press("input", "End", END)
    for times in (2, 4, 8, 16):
        opened.click(".panel", (5.5 / WIDTH, 2.5 / HEIGHT))
        assert opened.text(".scale") == f"{times}×"
    # At 16 times the panel shows half a pixel in width: one colour, that of column 5, row 2.
    shown = opened.shot()
    assert {*map(tuple, shown.reshape(-1, 3).tolist())} == {tuple(TRACER[2, 5].tolist())}
    told = "column 5, row 2: tracer 160 90 40, Mitsuba 160 90 200, off by 160"
    assert opened.text(".readout") == told
    # The difference has moved along with it.
    assert len({*map(tuple, opened.shot(1).reshape(-1, 3).tolist())}) == 1


@pytest.mark.slow
@pytest.mark.parametrize("drags", [False, True])
def test_zoom_and_move(opened: Browser, *, drags: bool) -> None:
    """Twice as large about the centre, then to the picture's border: columns 4 ... 7; and back."""
    opened.press("input", "End", END)
    if drags:
        opened.click(".in")
    else:
        opened.press(".panel", "+")
    assert opened.text(".scale") == "2×"
    np.testing.assert_array_equal(opened.shot()[0, :, 0], TRACER[0, [2, 2, 3, 3, 4, 4, 5, 5], 0])
    if drags:  # half a panel to the left is a quarter of the picture
        left, top, width, height = opened.box(".panel")
        opened.drag(*((left + width * x, top + height / 2) for x in (0.5, 0.25, 0)))
    else:
        for _ in range(12):
            opened.press(".panel", "ArrowRight", RIGHT)
    np.testing.assert_array_equal(opened.shot()[0, :, 0], TRACER[0, [4, 4, 5, 5, 6, 6, 7, 7], 0])
    if drags:
        opened.click(".all")
    else:
        opened.press(".panel", "-")
    np.testing.assert_array_equal(opened.shot(), TRACER)


@pytest.mark.slow
def test_all_is_reached_by_tab(opened: Browser) -> None:
    reached = []
    active = "(e => e.ariaLabel || e.textContent.trim())(document.activeElement)"
    for _ in range(9):
        opened.press(":focus, body", "Tab", TAB)
        reached.append(opened.evaluate(active))
    panels = ["pair: tracer and Mitsuba", "pair: difference × 1", "pair: how much is the tracer's"]
    buttons = ["Flicker", "Zoom out", "Zoom in", "All"]
    assert reached == ["All scenes", "pair", *panels, *buttons]


@pytest.mark.slow
def test_the_seam_can_be_dragged(opened: Browser) -> None:
    """From the middle to a quarter, and the slider with it; the picture stays where it is."""
    left, top, width, height = opened.box(".panel")
    y = top + height / 4
    opened.drag((left + width / 2 + 9, y), *((left + part * width, y) for part in (0.4, 0.25)))
    shown = opened.shot()
    np.testing.assert_array_equal(shown[:, :2], TRACER[:, :2])
    np.testing.assert_array_equal(shown[:, 2:], MITSUBA[:, 2:])
    assert opened.evaluate("document.querySelector('input').value") == "25"
    assert opened.text(".scale") == "1×"


@pytest.mark.slow
def test_on_a_phone(opened: Browser) -> None:
    """The table scrolls in its own box, the page does not, and fingers meet the controls."""
    phone = {"width": 375, "height": 700, "deviceScaleFactor": 2, "mobile": True}
    opened.call("Emulation.setDeviceMetricsOverride", **phone)
    page_width, table_scrolls, sizes = opened.evaluate(
        "[document.documentElement.scrollWidth,"
        " (e => e.scrollWidth > e.clientWidth)(document.querySelector('.scroll')),"
        " [...document.querySelectorAll('button, input, .seam')]"
        ".map(e => e.getBoundingClientRect()).map(r => Math.min(r.width, r.height))]"
    )
    opened.call("Emulation.clearDeviceMetricsOverride")
    assert (page_width, table_scrolls, len(sizes)) == (375, True, 6)
    assert min(sizes) >= 44
