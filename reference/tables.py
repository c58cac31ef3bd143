"""Tables of measurements, for GitHub and as CSV, and where they were measured."""

from __future__ import annotations

import csv
import os
import platform
import re
import subprocess
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime, timezone
from importlib import metadata
from pathlib import Path

from reference.timing import Timing

__all__ = ["Ratio", "Table", "measured_on", "read_csv", "write_csv", "write_tables"]


class Ratio(float):
    """Shown with two digits at least: 0.50×, 3.0×, 42×."""

    def __str__(self) -> str:
        places = 2 if self < 0.995 else 1 if self < 9.95 else 0
        return f"{self:.{places}f}×"


@dataclass(frozen=True, slots=True)
class Table:
    """One table of a page; cells that are timings or ratios go to the CSV in full."""

    title: str
    note: str
    header: tuple[str, ...]
    rows: list[tuple[object, ...]]

    def markdown(self) -> str:
        """As GitHub shows it."""
        lines = [f"## {self.title}", "", self.note, "", "| " + " | ".join(self.header) + " |"]
        lines.append("|---" * len(self.header) + "|")
        lines += ["| " + " | ".join(map(str, row)) + " |" for row in self.rows]
        return "\n".join(lines) + "\n"

    def records(self) -> Iterator[tuple[object, ...]]:
        """A line for each cell: table, row, column, value (median), low, high."""
        for row in self.rows:
            for name, cell in zip(self.header[1:], row[1:], strict=True):
                if isinstance(cell, Timing):
                    yield self.title, row[0], name, cell.median, cell.low, cell.high
                else:
                    yield self.title, row[0], name, cell, "", ""


def write_tables(page: Path, head: str, where: str, tables: Sequence[Table]) -> None:
    """Write a page of tables below its head, and the same numbers as CSV beside it."""
    text = "\n".join([f"{head} Measured on {where}.\n", *(table.markdown() for table in tables)])
    page.write_text(text, encoding="utf-8")
    records = (record for table in tables for record in table.records())
    header = ("table", "row", "column", "value", "low", "high")
    write_csv(page.with_suffix(".csv"), where, header, records)


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
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return ", ".join(
        [
            datetime.now(timezone.utc).strftime("%Y-%m-%d"),
            _commit(),
            f"{_processor()} ({cores} cores)",
            platform.system(),
            f"Python {platform.python_version()}",
            *map(_version, ("numpy", "mitsuba", "drjit")),
            _povray(),
        ]
    )


def _output(*command: str) -> str:
    """What a command prints; nothing if there is none."""
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=False)
    except FileNotFoundError:
        return ""
    return done.stdout + done.stderr if done.returncode == 0 else ""


def _commit() -> str:
    """The commit that is checked out, with + if a module has been changed since."""
    git = ("git", "-C", str(Path(__file__).parent))
    commit = _output(*git, "rev-parse", "--short=7", "HEAD").strip()
    changed = _output(*git, "status", "--porcelain", "--", ":/*.py")
    return f"commit {commit}{'+' if changed else ''}" if commit else "no commit"


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    names = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(names, platform.machine())


def _version(package: str) -> str:
    try:
        return f"{package} {metadata.version(package)}"
    except metadata.PackageNotFoundError:
        return f"no {package}"


def _povray() -> str:
    found = re.search(r"POV-Ray \d+(\.\d+)*", _output("povray", "--version"))
    return found[0] if found else "no POV-Ray"
