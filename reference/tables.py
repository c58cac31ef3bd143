"""Tables of measurements: for GitHub, for a CSV, and quoted in a page."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from reference.charts import write_csv
from reference.timing import Timing

__all__ = ["Ratio", "Table", "quote", "write_records"]


@dataclass(frozen=True, slots=True)
class Table:
    """One table of a report; cells that are timings or ratios go to the CSV in full."""

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


class Ratio(float):
    """Shown with two digits at least: 0.50×, 3.0×, 42×."""

    def __str__(self) -> str:
        places = 2 if self < 0.995 else 1 if self < 9.95 else 0
        return f"{self:.{places}f}×"


def quote(page: Path, mark: str, made: str, found: Sequence[Table]) -> None:
    """Put tables, after a line on how they were `made`, between a page's marks of that name."""
    begin, end = f"<!-- {mark}:begin -->\n", f"<!-- {mark}:end -->"
    before, rest = page.read_text(encoding="utf-8").split(begin)
    # One heading level deeper than in a report.
    quoted = "\n".join("#" + table.markdown() for table in found)
    after = rest.split(end)[1]
    page.write_text(f"{before}{begin}{made}\n\n{quoted}\n{end}{after}", encoding="utf-8")


def write_records(path: Path, where: str, found: Sequence[Table]) -> None:
    """Write all cells as CSV, with the machine in the first line."""
    records = (record for table in found for record in table.records())
    write_csv(path, where, ("table", "row", "column", "value", "low", "high"), records)
