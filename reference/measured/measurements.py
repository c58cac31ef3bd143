"""Time tasks alternately, and store tables of results as CSV files.

The *origin* of a table says in one line when, where and with which software it was measured.
"""

from __future__ import annotations

import csv
import os
import platform
import re
import shlex
import subprocess
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from contextlib import suppress
from datetime import datetime, timezone
from importlib import metadata
from pathlib import Path
from statistics import median
from time import perf_counter, sleep
from typing import NamedTuple, TypeAlias, TypeVar

from reference.command import REFERENCE_FOLDER
from tracer.picture.parallel import count_processors

Task: TypeAlias = Callable[[], object]
"""Work to be timed.  If it returns a float, this is the time that it took, in seconds."""

_Name = TypeVar("_Name", bound=Hashable)

# Pause before each task in seconds: threads of the previous task, especially Mitsuba's, keep
# spinning for about 10 ms.
_PAUSE_SECONDS = 0.02

# Minimum time of all runs of a task together in seconds.  Short times vary most, so short tasks run
# more often.
_MIN_TOTAL_SECONDS = 0.5

# Maximum number of rounds, as a multiple of the requested number.
_MAX_ROUNDS_FACTOR = 5

# A task that takes less than this many seconds also runs untimed before each timed run, because the
# previous task has filled the caches.  After POV-Ray, a picture of 5 ms took 8 to 18 ms.
_MAX_WARM_UP_SECONDS = 0.1


class Timing(NamedTuple):
    """The time that a task took, in seconds, measured in several rounds."""

    median: float
    low: float  # the minimum
    high: float  # the maximum

    def __str__(self) -> str:
        """Format the times in milliseconds: "median (low–high)", or one number if all are equal."""
        median_ms, low_ms, high_ms = map(_format_milliseconds, self)
        return median_ms if self.low == self.high else f"{median_ms} ({low_ms}–{high_ms})"

    def divided_by(self, item_count: int) -> Timing:
        """Divide all three times by the number of items that the task processed."""
        return Timing(*(seconds / item_count for seconds in self))


def _format_milliseconds(seconds: float) -> str:
    """Format a time in milliseconds, with one decimal place if it is less than 100 ms."""
    return f"{1e3 * seconds:,.0f}" if seconds >= 0.1 else f"{1e3 * seconds:.1f}"


def time_alternately(
    tasks: Mapping[_Name, Task], min_rounds: int, *, min_seconds: float = _MIN_TOTAL_SECONDS
) -> dict[_Name, Timing]:
    """Time tasks alternately, so that a slow period of the machine affects all tasks alike.

    At first, every task runs once untimed.  Each of the next `min_rounds` rounds runs every task
    once.  Further rounds run only tasks whose times add up to less than `min_seconds`.  In total,
    there are at most `_MAX_ROUNDS_FACTOR` * `min_rounds` rounds.  The result has the keys of
    `tasks`.
    """
    short_tasks = set()
    for name, task in tasks.items():
        start_time = perf_counter()
        task()
        if perf_counter() - start_time < _MAX_WARM_UP_SECONDS:
            short_tasks.add(name)
    seconds: dict[_Name, list[float]] = {name: [] for name in tasks}
    for round_index in range(_MAX_ROUNDS_FACTOR * min_rounds):
        for name, task in tasks.items():
            if round_index < min_rounds or sum(seconds[name]) < min_seconds:
                sleep(_PAUSE_SECONDS)
                if name in short_tasks:
                    task()
                seconds[name].append(_time_task(task))
    return {name: Timing(median(times), min(times), max(times)) for name, times in seconds.items()}


def _time_task(task: Task) -> float:
    """Run a task, and return the time in seconds that it took.

    If the task returns a float, this is the time.
    """
    start_time = perf_counter()
    result = task()
    elapsed_seconds = perf_counter() - start_time
    return result if isinstance(result, float) else elapsed_seconds


def make_command_task(command: Sequence[str]) -> Task:
    """Make a function that runs a command in a new process and discards its output.

    The function waits for the command, and raises CalledProcessError if the command fails.
    """
    # Without this variable, Python stores compiled modules, so that only the first run compiles
    # them.
    environment = {**os.environ}
    environment.pop("PYTHONDONTWRITEBYTECODE", None)
    return lambda: subprocess.run(command, check=True, capture_output=True, env=environment)


def write_csv(
    path: Path, origin: str, column_titles: Sequence[str], rows: Iterable[Sequence[object]]
) -> None:
    """Write a table to a CSV file: a comment line with its origin, the column titles, and the rows.

    Floats are rounded to six digits.
    """
    with path.open("w", newline="", encoding="utf-8") as file:
        file.write(f"# {origin}\n")
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(column_titles)
        for row in rows:
            writer.writerow([f"{cell:.6g}" if isinstance(cell, float) else cell for cell in row])


def read_csv(path: Path) -> tuple[str, list[list[str]]]:
    """Read a file that `write_csv` wrote; return its origin, and its rows without the titles."""
    with path.open(newline="", encoding="utf-8") as file:
        origin = file.readline().removeprefix("# ").rstrip("\n")
        return origin, list(csv.reader(file))[1:]


def describe_origin() -> str:
    """Describe the origin of measurements that are made now.

    The line gives the date, the commit, the processor, the system, and the versions of programs.
    """
    povray_match = re.search(r"POV-Ray \d+(\.\d+)*", subprocess.getoutput("povray --version"))
    versions = []
    for package in ("numpy", "mitsuba"):
        with suppress(metadata.PackageNotFoundError):  # Mitsuba has no wheel for some Pythons
            versions.append(f"{package} {metadata.version(package)}")
    software = [platform.system(), f"Python {platform.python_version()}", *versions]
    processor = f"{_describe_processor()} ({count_processors()} cores)"
    today = datetime.now(timezone.utc).strftime("%Y-%m-%d")
    povray_version = povray_match[0] if povray_match else "no POV-Ray"
    return ", ".join([today, _describe_commit(), processor, *software, povray_version])


def _describe_commit() -> str:
    """Describe the current Git commit, as "commit 1a2b3c4", or as "no commit" if there is none.

    A "+" after the hash means that Python files have changed since the commit.
    """
    git_command = f"git -C {shlex.quote(str(REFERENCE_FOLDER))}"
    exit_status, short_hash = subprocess.getstatusoutput(f"{git_command} rev-parse --short=7 HEAD")
    changed_files = subprocess.getoutput(f"{git_command} status --porcelain -- ':/*.py'")
    if exit_status:
        return "no commit"
    return f"commit {short_hash}+" if changed_files else f"commit {short_hash}"


def _describe_processor() -> str:
    """Return the model of the processor on Linux, and its name or architecture elsewhere."""
    cpu_file = Path("/proc/cpuinfo")
    cpu_text = cpu_file.read_text() if cpu_file.exists() else ""
    model_match = re.search(r"^model name\s*: (.*)", cpu_text, re.M)
    return model_match[1] if model_match else platform.processor() or platform.machine()
