"""Options, limits and fixtures of all tests."""

import math
import os
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import settings

from tracer.antialias import refine as antialias

# Numbers of examples of each Hypothesis test; a test may try a multiple of them.  The quick profile
# tries the same examples in every run.  The thorough profile tries others, which the seed from
# `.ci/run` determines.
settings.register_profile("quick", max_examples=30, deadline=None, derandomize=True)
settings.register_profile("thorough", max_examples=300, deadline=None, print_blob=True)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "quick"))


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the option `--expect-skips`."""
    text = (
        "fail if a test is skipped, unless for lack of one of these programs, separated by commas"
    )
    parser.addoption("--expect-skips", metavar="PROGRAMS", help=text)


def find_program(program: str) -> str:
    """Return the path of an installed program, or skip the test if the program is not installed.

    The option `--expect-skips` lists the programs that may be missing.
    """
    path = shutil.which(program)
    if path is None:
        pytest.skip(f"{program} is not installed")
    return path


@pytest.hookimpl(trylast=True)
def pytest_sessionfinish(session: pytest.Session) -> None:
    """Make the test run fail if a test was skipped for an unexpected reason.

    A skipped test may hide a failure.  Nothing is checked without the option `--expect-skips`,
    which lists the programs that may be missing.  Each unexpected reason is printed, and the exit
    status of the test run is then that of failed tests.
    """
    expected = session.config.getoption("--expect-skips")
    reporter = session.config.pluginmanager.get_plugin("terminalreporter")
    if expected is None or reporter is None:
        return
    # These are facts about the machine, which no installation changes.
    known = {"Skipped: there is one processor", "Skipped: other C libraries do as they do"}
    known |= {f"Skipped: {name} is not installed" for name in expected.split(",")}
    reasons = {report.longrepr[2] for report in reporter.stats.get("skipped", [])}
    for reason in sorted(reasons - known):
        reporter.write_line(f"not expected: {reason}", red=True)
        session.exitstatus = pytest.ExitCode.TESTS_FAILED


@pytest.fixture
def pixels_are_split(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make antialiasing divide pixels that edges cross, however many objects the picture shows.

    Otherwise, if a picture is full of small objects, antialiasing samples all pixels uniformly.
    """
    monkeypatch.setattr(antialias, "_MAX_SILHOUETTE_PAIRS", math.inf)


@pytest.fixture
def small(tmp_path: Path) -> Path:
    """Write the file of a scene with 40 x 30 pixels into an empty folder, and return its path.

    The file is a copy of `scenes/one-sphere.xml`, with the name `small.xml`.
    """
    text = (Path(__file__).parents[1] / "scenes/one-sphere.xml").read_text(encoding="utf-8")
    path = tmp_path / "small.xml"
    path.write_text(text.replace("300 300", "40 30"), encoding="utf-8")
    return path


@pytest.fixture
def odd_file(small: Path) -> Path:
    """Return the path of a scene file whose name is not valid UTF-8, and contains a line break.

    The file is that of the fixture `small`, which is renamed.
    """
    return small.rename(small.with_name(os.fsdecode(b"\xff\n.xml")))


@pytest.fixture
def pipe_without_reader() -> Iterator[int]:
    """Yield the file descriptor of a pipe's writing end, whose reading end is closed."""
    read_end, write_end = os.pipe()
    os.close(read_end)
    yield write_end
    os.close(write_end)
