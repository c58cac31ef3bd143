"""The result of a comparison, as text, JSON and CSV."""

from __future__ import annotations

import csv
import io
import json
from collections import Counter, defaultdict
from collections.abc import Sequence
from typing import Any, NamedTuple

from reference.handins.diagnosis import UNKNOWN, Diagnosis
from tracer.messages import printable


class Result(NamedTuple):
    """The result for a hand-in, or for one that is missing.

    Attributes
    ----------
    student, scene : str
        Who handed it in, and the name of the scene.
    picture, right : str or None
        The picture and the right one; no picture if it is missing.
    agrees : bool
        Whether the picture is right, or within the tolerances.
    diagnosis : Diagnosis or None
        None if the pictures could not be compared.
    ssim, rmse, max : float or None
        Figures of the difference in linear light; None if the sizes differ.
    differing : int or None
        Number of pixels that differ.
    worst : tuple of 2 ints or None
        Column and row of the pixel that differs most.
    comparison : str or None
        The file that shows both pictures.
    error : str or None
        Why the picture could not be compared, as a line.
    """

    student: str
    scene: str
    picture: str | None
    right: str | None
    agrees: bool = False
    diagnosis: Diagnosis | None = None
    ssim: float | None = None
    rmse: float | None = None
    max: float | None = None
    differing: int | None = None
    worst: tuple[int, int] | None = None
    comparison: str | None = None
    error: str | None = None

    @property
    def word(self) -> str:
        """The verdict: missing, unread, agrees or differs."""
        if self.error:
            return "unread" if self.picture else "missing"
        return "agrees" if self.agrees else "differs"

    def fields(self) -> dict[str, Any]:
        """Return the columns of the table, and their values."""
        one = self.diagnosis
        texts = {"kind": one and one.kind, "hint": one and one.hint, "diagnosis": one and str(one)}
        values = [*self._asdict().items()]
        return dict(values[:5]) | texts | dict(values[6:])

    def figures(self) -> str:
        """Return SSIM, RMSE and the largest difference; nothing if the sizes differ."""
        if self.ssim is None:
            return ""
        return f"SSIM {self.ssim:.4f}  RMSE {self.rmse:.2e}  max {self.max:.2e}"

    def line(self) -> str:
        """Return a line for a list of many results."""
        text = f"{self.figures()}  {printable(str(self.picture))}: {self.diagnosis}".lstrip()
        return f"{self.word:8} {self.error or text}"


def with_common_causes_first(results: Sequence[Result]) -> list[Result]:
    """Order the causes of each picture: first those that explain most pictures of the student.

    The scenes of one student are rendered by one program, so that its mistake shows in all of them.
    """
    counts: dict[str, Counter[str]] = defaultdict(Counter)
    for result in results:
        if result.diagnosis and not result.agrees:
            counts[result.student].update(result.diagnosis.kind.split("|"))
    order = {
        student: [kind for kind, _ in count.most_common()] for student, count in counts.items()
    }
    return [
        one._replace(
            diagnosis=one.diagnosis and one.diagnosis.preferring(order.get(one.student, ()))
        )
        for one in results
    ]


def mistake_counts(results: Sequence[Result]) -> list[str]:
    """Return a line for each mistake of the class, with its number of pictures."""
    causes = (
        result.diagnosis.causes[0] for result in results if result.diagnosis and not result.agrees
    )
    counts = Counter(text for cause in causes for kind, text in cause.items() if kind != UNKNOWN)
    return [f"{count} × {text}" for text, count in counts.most_common()]


def count_of(results: Sequence[Result]) -> str:
    """Return how many pictures there are, agree, differ, are missing and cannot be compared."""
    counts = Counter("nobody" if not r.picture and not r.student else r.word for r in results)
    words = {"agrees": "agree", "differs": "differ", "unread": "cannot be compared"}
    parts = ", ".join(f"{counts[word]} {plural}" for word, plural in words.items() if counts[word])
    text = f"{sum(counts[word] for word in words)} pictures: {parts}"
    text += f"; {counts['missing']} are missing" if counts["missing"] else ""
    nobodys = f"; scenes that nobody has handed in: {counts['nobody']}"
    return text + (nobodys if counts["nobody"] else "")


def text_of(results: Sequence[Result], *, many: bool) -> str:
    """Return a line for each of many results and a count, or all about a single one."""
    if not many:
        one = results[0]
        comparison = printable(one.comparison or "")
        return one.error or "\n".join(filter(None, (one.figures(), str(one.diagnosis), comparison)))
    return "\n".join([*(result.line() for result in results), count_of(results)])


def json_of(results: Sequence[Result]) -> str:
    """Return a list with an object for each result."""
    return json.dumps([result.fields() for result in results], indent=1)


def csv_of(results: Sequence[Result]) -> str:
    """Return a table with a row for each result; `worst` as `tracer --pixel` takes it.

    Names come from those who hand in, so control characters are escaped, and a cell that a
    spreadsheet would run as a formula begins with an apostrophe.
    """
    table = io.StringIO()
    writer = csv.writer(table, lineterminator="\n")
    writer.writerow(results[0].fields())
    for result in results:
        worst = ",".join(map(str, result.worst)) if result.worst else None
        row = (result.fields() | {"worst": worst}).values()
        writer.writerow([_cell(value) if isinstance(value, str) else value for value in row])
    return table.getvalue().removesuffix("\n")


def _cell(text: str) -> str:
    text = printable(text)
    return f"'{text}" if text.startswith(("=", "+", "-", "@")) else text
