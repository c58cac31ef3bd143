"""What several test files share."""

import math
import os
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import settings

from tracer.antialias import refine as antialias

# Quick tests try the same examples each time; thorough ones try others, by the seed that `.ci/run`
# gives, and ten times as many where a test does not say how many.
settings.register_profile("quick", max_examples=30, deadline=None, derandomize=True)
settings.register_profile("thorough", max_examples=300, deadline=None, print_blob=True)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "quick"))


def pytest_addoption(parser: pytest.Parser) -> None:
    text = "fail if a test is skipped for lack of anything but these, separated by commas"
    parser.addoption("--expect-skips", metavar="NAMES", help=text)


def need(program: str) -> str:
    """The path of a program; without it the test is skipped, which CI has to expect."""
    path = shutil.which(program)
    if path is None:
        pytest.skip(f"{program} is not installed")
    return path


@pytest.hookimpl(trylast=True)
def pytest_sessionfinish(session: pytest.Session) -> None:
    """Fail on skips that nobody expects: they may hide what no longer works."""
    expected = session.config.getoption("--expect-skips")
    reporter = session.config.pluginmanager.get_plugin("terminalreporter")
    if expected is None or reporter is None:
        return
    # Facts about the machine, which nothing that is installed changes.
    known = {"Skipped: there is one processor", "Skipped: other C libraries do as they do"}
    known |= {f"Skipped: {name} is not installed" for name in expected.split(",")}
    reasons = {report.longrepr[2] for report in reporter.stats.get("skipped", [])}
    for reason in sorted(reasons - known):
        reporter.write_line(f"not expected: {reason}", red=True)
        session.exitstatus = pytest.ExitCode.TESTS_FAILED


@pytest.fixture
def pixels_are_split(monkeypatch: pytest.MonkeyPatch) -> None:
    """No picture is so full of outlines that it is made of lattices."""
    monkeypatch.setattr(antialias, "_MAX_SILHOUETTE_PAIRS", math.inf)


@pytest.fixture
def small(tmp_path: Path) -> Path:
    """A scene that is soon rendered, in a folder of its own."""
    text = (Path(__file__).parents[1] / "scenes/one-sphere.xml").read_text(encoding="utf-8")
    path = tmp_path / "small.xml"
    path.write_text(text.replace("300 300", "40 30"), encoding="utf-8")
    return path


@pytest.fixture
def odd(small: Path) -> Path:
    """The same, by a name that is no text, and more than a line."""
    return small.rename(small.with_name(os.fsdecode(b"\xff\n.xml")))


@pytest.fixture
def unread() -> Iterator[int]:
    """A pipe to write to, which no one reads."""
    read, write = os.pipe()
    os.close(read)
    yield write
    os.close(write)
