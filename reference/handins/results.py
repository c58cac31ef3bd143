"""What a comparison finds, as text, JSON and CSV."""

from __future__ import annotations

import csv
import io
import json
from collections import Counter
from collections.abc import Sequence
from typing import NamedTuple

from tracer.messages import printable

MISSING = "missing"


class Result(NamedTuple):
    """What `--json` and `--csv` say of a picture, or of a scene or folder without one."""

    picture: str | None
    right: str | None
    agrees: bool = False
    kind: str | None = None
    diagnosis: str | None = None
    ssim: float | None = None
    rmse: float | None = None
    max: float | None = None
    differing: int | None = None
    worst: tuple[int, int] | None = None
    comparison: str | None = None
    error: str | None = None

    @property
    def word(self) -> str:
        """The verdict in a word."""
        if self.error:
            return MISSING if self.kind == MISSING else "unread"
        return "agrees" if self.agrees else "differs"

    def figures(self) -> str:
        """SSIM, RMSE and the largest difference; nothing of pictures of different sizes."""
        if self.ssim is None:
            return ""
        return f"SSIM {self.ssim:.4f}  RMSE {self.rmse:.2e}  max {self.max:.2e}"

    def line(self) -> str:
        """A line for a list of many."""
        found = f"{self.figures()}  {printable(str(self.picture))}: {self.diagnosis}".lstrip()
        return f"{self.word:8} {self.error or found}"


def count_of(results: Sequence[Result]) -> str:
    """How many there are, agree, differ, are missing and cannot be compared."""
    counts = Counter(result.word for result in results)
    words = {"agrees": "agree", "differs": "differ", MISSING: "are missing"}
    words["unread"] = "cannot be compared"
    told = [f"{counts[word]} {plural}" for word, plural in words.items() if counts[word]]
    return f"{len(results) - counts[MISSING]} pictures: {', '.join(told)}"


def text_of(results: Sequence[Result], *, many: bool) -> str:
    """A line for each of many, and their number; or all of one."""
    if not many:
        one = results[0]
        comparison = printable(one.comparison or "")
        return one.error or "\n".join(filter(None, (one.figures(), one.diagnosis, comparison)))
    return "\n".join([*(result.line() for result in results), count_of(results)])


def json_of(results: Sequence[Result]) -> str:
    """A list with an object for each."""
    return json.dumps([result._asdict() for result in results], indent=1)


def csv_of(results: Sequence[Result]) -> str:
    """A table with a row for each, the worst pixel as `tracer --pixel` takes it."""
    table = io.StringIO()
    writer = csv.writer(table, lineterminator="\n")
    writer.writerow(Result._fields)
    for result in results:
        worst = ",".join(map(str, result.worst)) if result.worst else None
        writer.writerow({**result._asdict(), "worst": worst}.values())
    return table.getvalue().removesuffix("\n")
