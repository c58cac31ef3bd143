"""Measure times of tasks alternately, and store tables as CSV files with their origin."""

from __future__ import annotations

import csv
import os
import platform
import re
import shlex
import subprocess
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from datetime import datetime, timezone
from importlib import metadata
from pathlib import Path
from statistics import median
from time import perf_counter, sleep
from typing import NamedTuple, TypeAlias, TypeVar

from reference.command import HERE
from tracer.picture.parallel import processors

Task: TypeAlias = Callable[[], object]
"""Work to be timed.  If it returns a float, this is the time that it took, in seconds."""

_Name = TypeVar("_Name", bound=Hashable)

# Pause between tasks in seconds: threads of the task before, especially Mitsuba's, spin for about
# 10 ms.
_PAUSE_SECONDS = 0.02

# Short times vary most, so short tasks get more rounds: until they have taken this many seconds
# together, but at most this many times the requested number of rounds.
_MIN_TOTAL_SECONDS, _MAX_ROUNDS_FACTOR = 0.5, 5


class Timing(NamedTuple):
    """Seconds that a task took: the median, the minimum and the maximum over some rounds."""

    median: float
    low: float
    high: float

    def __str__(self) -> str:
        """Format the times in milliseconds."""
        shown, low, high = (f"{1e3 * t:,.0f}" if t >= 0.1 else f"{1e3 * t:.1f}" for t in self)
        return shown if self.low == self.high else f"{shown} ({low}–{high})"

    def per(self, count: int) -> Timing:
        """Divide the times by the number of items that the task processed."""
        return Timing(*(seconds / count for seconds in self))


def interleaved(
    tasks: Mapping[_Name, Task], rounds: int, *, min_seconds: float = _MIN_TOTAL_SECONDS
) -> dict[_Name, Timing]:
    """Time tasks alternately: a round runs each task once.

    If the machine is slower for a while, it is slower for all tasks alike.

    Parameters
    ----------
    tasks : mapping of names to Task
        Each task runs once before it is timed.
    rounds : int
        Number of rounds.
    min_seconds : float
        Tasks that have taken less than this together run in more rounds.

    Returns
    -------
    timings : dict of names to Timing
        The times of each task.
    """
    for task in tasks.values():
        task()
    times: dict[_Name, list[float]] = {name: [] for name in tasks}
    for number in range(_MAX_ROUNDS_FACTOR * rounds):
        for name, task in tasks.items():
            if number < rounds or sum(times[name]) < min_seconds:
                sleep(_PAUSE_SECONDS)
                start = perf_counter()
                seconds = task()
                elapsed = perf_counter() - start
                times[name].append(seconds if isinstance(seconds, float) else elapsed)
    return {name: Timing(median(s), min(s), max(s)) for name, s in times.items()}


def process(command: Sequence[str]) -> Task:
    """Make a task that runs a command silently, and raises CalledProcessError if it fails.

    Python may store compiled modules even if PYTHONDONTWRITEBYTECODE is set: the first run compiles
    the modules, and no other has to.
    """
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}
    return lambda: subprocess.run(command, check=True, capture_output=True, env=environment)


def write_csv(
    path: Path, origin: str, columns: Sequence[str], rows: Iterable[Sequence[object]]
) -> None:
    """Write a table as a CSV file.

    Parameters
    ----------
    path : Path
        The file.
    origin : str
        Where and when the table was measured: the first line, a comment.
    columns : sequence of str
        Titles of the columns.
    rows : iterable of sequences
        The rows; floats are rounded to six digits.
    """
    with path.open("w", newline="", encoding="utf-8") as file:
        file.write(f"# {origin}\n")
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(columns)
        writer.writerows([f"{v:.6g}" if isinstance(v, float) else v for v in row] for row in rows)


def read_csv(path: Path) -> tuple[str, list[list[str]]]:
    """Read a table that `write_csv` has written: return its origin, and rows without the titles."""
    with path.open(newline="", encoding="utf-8") as file:
        origin = file.readline().removeprefix("# ").rstrip("\n")
        return origin, list(csv.reader(file))[1:]


def measured_on() -> str:
    """Describe a measurement on one line: date, commit, processor, system and versions."""
    povray = re.search(r"POV-Ray \d+(\.\d+)*", subprocess.getoutput("povray --version"))
    versions = [f"{package} {metadata.version(package)}" for package in ("numpy", "mitsuba")]
    system = [platform.system(), f"Python {platform.python_version()}", *versions]
    machine = f"{_processor()} ({processors()} cores)"
    today = datetime.now(timezone.utc).strftime("%Y-%m-%d")
    return ", ".join([today, _commit(), machine, *system, povray[0] if povray else "no POV-Ray"])


def _commit() -> str:
    """Name the current commit, with a + if a module has been changed since."""
    git = f"git -C {shlex.quote(str(HERE))}"
    failed, commit = subprocess.getstatusoutput(f"{git} rev-parse --short=7 HEAD")
    changed = subprocess.getoutput(f"{git} status --porcelain -- ':/*.py'")
    return "no commit" if failed else f"commit {commit}{'+' * bool(changed)}"


def _processor() -> str:
    """Name the processor: its model if the system is Linux, otherwise its architecture."""
    info = Path("/proc/cpuinfo")
    model = re.search(r"^model name\s*: (.*)", info.read_text() if info.exists() else "", re.M)
    return model[1] if model else platform.processor() or platform.machine()
