"""Times of tasks that run in turns, and tables of them as CSV, with their origin."""

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
"""Work to be timed; the seconds that it took if it returns a float."""

_Name = TypeVar("_Name", bound=Hashable)

# Seconds between tasks: threads of the one before, Mitsuba's above all, spin for some 10 ms.
_PAUSE = 0.02

# Short times vary most: a task goes on for so many seconds, and times as many rounds, at most.
_ENOUGH, _MORE = 0.5, 5


class Timing(NamedTuple):
    """Seconds over some rounds."""

    median: float
    low: float
    high: float

    def __str__(self) -> str:
        shown, low, high = (f"{1e3 * t:,.0f}" if t >= 0.1 else f"{1e3 * t:.1f}" for t in self)
        return shown if self.low == self.high else f"{shown} ({low}–{high})"


def interleaved(
    tasks: Mapping[_Name, Task], rounds: int, *, enough: float = _ENOUGH
) -> dict[_Name, Timing]:
    """Time tasks in turns, each after a run to warm up: a round runs each once, after a pause.

    A machine that is busy for a while then slows down all alike.
    """
    for task in tasks.values():
        task()
    taken: dict[_Name, list[float]] = {name: [] for name in tasks}
    for number in range(_MORE * rounds):
        for name, task in tasks.items():
            if number < rounds or sum(taken[name]) < enough:
                sleep(_PAUSE)
                start = perf_counter()
                seconds = task()
                spent = perf_counter() - start
                taken[name].append(seconds if isinstance(seconds, float) else spent)
    return {name: Timing(median(s), min(s), max(s)) for name, s in taken.items()}


def process(command: Sequence[str]) -> Task:
    """Run a process in silence; raises if it fails.

    Python may keep what it compiles: the first run compiles the modules, and no other has to.
    """
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}
    return lambda: subprocess.run(command, check=True, capture_output=True, env=environment)


def write_csv(
    path: Path, where: str, header: Sequence[str], rows: Iterable[Sequence[object]]
) -> None:
    """Write numbers, under a comment that says where they were measured."""
    with path.open("w", newline="", encoding="utf-8") as file:
        file.write(f"# {where}\n")
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(header)
        writer.writerows([f"{v:.6g}" if isinstance(v, float) else v for v in row] for row in rows)


def read_csv(path: Path) -> tuple[str, list[list[str]]]:
    """Where a table was measured, and its rows without the header."""
    with path.open(newline="", encoding="utf-8") as file:
        where = file.readline().removeprefix("# ").rstrip("\n")
        return where, list(csv.reader(file))[1:]


def measured_on() -> str:
    """One line: date, commit, processor, system, versions."""
    povray = re.search(r"POV-Ray \d+(\.\d+)*", subprocess.getoutput("povray --version"))
    versions = [f"{package} {metadata.version(package)}" for package in ("numpy", "mitsuba")]
    system = [platform.system(), f"Python {platform.python_version()}", *versions]
    machine = f"{_processor()} ({processors()} cores)"
    today = datetime.now(timezone.utc).strftime("%Y-%m-%d")
    return ", ".join([today, _commit(), machine, *system, povray[0] if povray else "no POV-Ray"])


def _commit() -> str:
    """The commit that is checked out, with + if a module has been changed since."""
    git = f"git -C {shlex.quote(str(HERE))}"
    failed, commit = subprocess.getstatusoutput(f"{git} rev-parse --short=7 HEAD")
    changed = subprocess.getoutput(f"{git} status --porcelain -- ':/*.py'")
    return "no commit" if failed else f"commit {commit}{'+' * bool(changed)}"


def _processor() -> str:
    """The processor's name, where Linux tells it."""
    info = Path("/proc/cpuinfo")
    named = re.search(r"^model name\s*: (.*)", info.read_text() if info.exists() else "", re.M)
    return named[1] if named else platform.processor() or platform.machine()
