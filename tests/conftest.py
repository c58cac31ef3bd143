"""Options, limits and fixtures of all tests."""

import math
import os
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest
import shapes
from hypothesis import settings

# Before the first import of these packages.
shapes.install("tracer", "converters", "reference")

# Commands leave no compiled modules in the folders whose files tests list.
os.environ["PYTHONDONTWRITEBYTECODE"] = "1"

# Numbers of examples of each Hypothesis test; a test may try a multiple of them.  The quick profile
# tries the same examples in every run.  The thorough profile tries more, which depend on the seed
# that `.ci/run` passes.
settings.register_profile("quick", max_examples=30, deadline=None, derandomize=True)
settings.register_profile("thorough", max_examples=300, deadline=None, print_blob=True)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "quick"))


def pytest_configure(config: pytest.Config) -> None:
    """Ignore warnings about scenes.

    In pyproject.toml, this filter would import the tracer before its shapes can be checked.
    """
    config.addinivalue_line("filterwarnings", "ignore::tracer.SceneWarning")


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the option `--expect-skips` to the command line of pytest."""
    help_text = (
        "fail if a test is skipped, unless for lack of one of these programs: NAME[,NAME...]"
    )
    parser.addoption("--expect-skips", metavar="PROGRAMS", help=help_text)


def find_program(program: str) -> str:
    """Return the path of an installed program; if it is not installed, skip the current test."""
    path = shutil.which(program)
    if path is None:
        pytest.skip(f"{program} is not installed")
    return path


@pytest.hookimpl(trylast=True)
def pytest_sessionfinish(session: pytest.Session) -> None:
    """Make the test run fail if a test was skipped for an unexpected reason: it may hide a failure.

    The option `--expect-skips` lists the programs that may be missing; without it, any reason will
    do.  Each unexpected reason is printed, and the exit status becomes that of failed tests.
    """
    missing_programs = session.config.getoption("--expect-skips")
    reporter = session.config.pluginmanager.get_plugin("terminalreporter")
    if missing_programs is None or reporter is None:
        return
    # Two facts about the machine, which no installation changes, are also expected.
    expected = {"Skipped: there is one processor", "Skipped: other C libraries do as they do"}
    expected |= {f"Skipped: {name} is not installed" for name in missing_programs.split(",")}
    reasons = {report.longrepr[2] for report in reporter.stats.get("skipped", [])}
    for reason in sorted(reasons - expected):
        reporter.write_line(f"not expected: {reason}", red=True)
        session.exitstatus = pytest.ExitCode.TESTS_FAILED


@pytest.fixture
def pixels_are_split(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make antialiasing divide pixels at edges, even in pictures full of small objects.

    Without this fixture, antialiasing samples all pixels of such pictures uniformly.
    """
    monkeypatch.setattr("tracer.antialias.refine._MAX_PAIRS_PER_SAMPLE", math.inf)


@pytest.fixture
def small_tiles(monkeypatch: pytest.MonkeyPatch) -> None:
    """Divide pictures into many tiles, and share even the smallest pictures with an executor."""
    from tracer.picture import parallel

    for workers in (parallel.Threads, parallel.WorkerPool):
        monkeypatch.setattr(workers, "sharing", workers.sharing._replace(min_seconds=0))
    monkeypatch.setattr("tracer.picture.tiles._MAX_TILE_SAMPLES", 1000)
    monkeypatch.setattr("tracer.picture.tiles._ADAPTIVE_FACTOR", 1)


@pytest.fixture
def small_file(tmp_path: Path) -> Path:
    """Write the scene file `small.xml` into an empty folder, and return the path of the file.

    The scene is that of `scenes/one-sphere.xml`, with a picture of 40 x 30 pixels.
    """
    text = (Path(__file__).parents[1] / "scenes/one-sphere.xml").read_text(encoding="utf-8")
    path = tmp_path / "small.xml"
    path.write_text(text.replace("300 300", "40 30"), encoding="utf-8")
    return path


@pytest.fixture
def odd_file(small_file: Path) -> Path:
    """Rename the file of the fixture `small_file`, and return its new path.

    The new name is not valid UTF-8, and contains a line break.
    """
    return small_file.rename(small_file.with_name(os.fsdecode(b"\xff\n.xml")))


@pytest.fixture
def pipe_without_reader() -> Iterator[int]:
    """Yield a file descriptor for writing to a pipe whose reading end is closed."""
    read_end, write_end = os.pipe()
    os.close(read_end)
    yield write_end
    os.close(write_end)
