"""Format the results of comparing submitted pictures with their reference pictures.

A *submitted picture* is one that a student handed in; the *reference picture* is what it should be.
"""

from __future__ import annotations

import csv
import io
import json
from collections import Counter, defaultdict
from collections.abc import Sequence
from typing import Any, NamedTuple

from reference.handins.diagnosis import UNKNOWN, Diagnosis
from tracer.messages import make_printable

AGREES = "agrees"
"""Verdict on a picture that is right, or within the tolerances of the user."""
DIFFERS = "differs"
"""Verdict on a picture that is wrong."""
UNREAD = "unread"
"""Verdict on a picture that could not be compared."""
MISSING = "missing"
"""Verdict on a picture that nobody has handed in."""


class Result(NamedTuple):
    """The result for one submitted or missing picture."""

    student: str  # empty if nobody has submitted a picture of the scene
    scene: str  # empty if it is unknown
    picture: str | None  # file that was submitted; None if it is missing
    right: str | None  # file of the reference picture or scene; None if it is unknown
    agrees: bool = False  # also true within tolerances set by the user
    diagnosis: Diagnosis | None = None  # None if the picture could not be compared
    # The metrics are None if the sizes differ.
    ssim: float | None = None  # structural similarity: 1 for equal pictures
    rmse: float | None = None  # root mean square of the difference in linear light
    max: float | None = None  # maximum of the difference in linear light
    differing: int | None = None  # number of pixels whose codes differ
    worst: tuple[int, int] | None = None  # column and row of the pixel that differs most
    comparison: str | None = None  # file that shows both pictures, if one was written
    error: str | None = None  # one line: why the picture could not be compared

    @property
    def verdict(self) -> str:
        """One word: `AGREES`, `DIFFERS`, `UNREAD` or `MISSING`."""
        if self.error:
            return UNREAD if self.picture else MISSING
        return AGREES if self.agrees else DIFFERS

    def to_row(self) -> dict[str, Any]:
        """Convert the result to a row of the JSON and CSV output: values by column name.

        The diagnosis takes three columns: "kind" (keywords of the mistakes), "hint" (if no cause is
        known, keywords of the mistakes that come closest) and "diagnosis" (sentences).  They are
        None if there is no diagnosis.
        """
        diagnosis = self.diagnosis
        return {
            "student": self.student, "scene": self.scene,
            "picture": self.picture, "right": self.right, "agrees": self.agrees,
            "kind": diagnosis.kind if diagnosis else None,
            "hint": diagnosis.hint if diagnosis else None,
            "diagnosis": str(diagnosis) if diagnosis else None,
            "ssim": self.ssim, "rmse": self.rmse, "max": self.max, "differing": self.differing,
            "worst": self.worst, "comparison": self.comparison, "error": self.error,
        }  # fmt: skip

    def format_metrics(self) -> str:
        """Format the metrics of the comparison; empty if the sizes of the pictures differ."""
        if self.ssim is None:
            return ""
        return f"SSIM {self.ssim:.4f}  RMSE {self.rmse:.2e}  max {self.max:.2e}"

    def format_line(self) -> str:
        """Format the result as one line: verdict, metrics, file and diagnosis; or the error."""
        report = f"{self.format_metrics()}  {make_printable(str(self.picture))}: {self.diagnosis}"
        return f"{self.verdict:8} {self.error or report.lstrip()}"


def sort_causes(results: Sequence[Result]) -> list[Result]:
    """Sort the possible causes of each picture by their frequency in the student's wrong pictures.

    All pictures of a student come from one program, so the cause that explains most of them is the
    most likely.
    """
    cause_counts: dict[str, Counter[str]] = defaultdict(Counter)
    for result in results:
        if result.diagnosis and not result.agrees:
            # `kind` contains the keywords of all possible causes, separated by "|".
            cause_counts[result.student].update(result.diagnosis.kind.split("|"))
    return [
        result._replace(diagnosis=result.diagnosis.sort_by_frequency(cause_counts[result.student]))
        if result.diagnosis else result for result in results
    ]  # fmt: skip


def list_mistake_counts(results: Sequence[Result]) -> list[str]:
    """List how many students make each mistake, as in "3 students: Gamma is missing."

    The most frequent mistake comes first.  Of alternative causes, only the first is counted.
    """
    students_by_sentence: dict[str, set[str]] = defaultdict(set)
    for result in results:
        if result.diagnosis and not result.agrees:
            for keyword, sentence in result.diagnosis.causes[0].items():
                if keyword != UNKNOWN:
                    students_by_sentence[sentence].add(result.student)
    counts = Counter({sentence: len(names) for sentence, names in students_by_sentence.items()})
    return [
        f"{count} {'student' if count == 1 else 'students'}: {sentence}"
        for sentence, count in counts.most_common()
    ]


def summarize_counts(results: Sequence[Result]) -> str:
    """Summarise a class, as in "3 pictures: 2 agree, 1 differs; 1 is missing".

    Pictures that cannot be compared and scenes that nobody has handed in are also counted.
    """
    used_results = [result for result in results if result.picture or result.student]
    unused_count = len(results) - len(used_results)
    counts = Counter(result.verdict for result in used_results)
    # For each verdict, the verb for one picture and for several.
    verbs = {
        AGREES: ("agrees", "agree"),
        DIFFERS: ("differs", "differ"),
        UNREAD: ("cannot be compared", "cannot be compared"),
        MISSING: ("is missing", "are missing"),
    }
    clauses = {
        verdict: f"{count} {verbs[verdict][count > 1]}"
        for verdict in verbs
        if (count := counts[verdict])
    }
    missing_clause = clauses.pop(MISSING, "")
    picture_count = sum(counts[verdict] for verdict in clauses)
    summary = f"{picture_count} {'picture' if picture_count == 1 else 'pictures'}"
    summary += f": {', '.join(clauses.values())}" if clauses else ""
    summary += f"; {missing_clause}" if missing_clause else ""
    unused_note = f"; scenes that nobody has handed in: {unused_count}"
    return summary + (unused_note if unused_count else "")


def format_class_text(results: Sequence[Result]) -> str:
    """Format the results of a class for a terminal: one line per result, and a summary."""
    return "\n".join([*(result.format_line() for result in results), summarize_counts(results)])


def format_single_text(results: Sequence[Result]) -> str:
    """Format the only result for a terminal: the error, or one to three lines.

    These are the metrics, the diagnosis and the file of the comparison picture.
    """
    result = results[0]
    lines = result.format_metrics(), str(result.diagnosis), make_printable(result.comparison or "")
    return result.error or "\n".join(filter(None, lines))


def format_json(results: Sequence[Result]) -> str:
    """Format results as a JSON list with one object per result."""
    return json.dumps([result.to_row() for result in results], indent=1)


def format_csv(results: Sequence[Result]) -> str:
    """Format at least one result as CSV, with a header and without a newline at the end.

    The column "worst" contains the worst pixel as ``column,row``, as `tracer --pixel` expects it.
    """
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(results[0].to_row())
    for result in results:
        # Text is escaped, because students choose the names of files.
        worst_pixel = ",".join(map(str, result.worst)) if result.worst else None
        cells = (result.to_row() | {"worst": worst_pixel}).values()
        writer.writerow([_escape_cell(cell) if isinstance(cell, str) else cell for cell in cells])
    return buffer.getvalue().removesuffix("\n")


def _escape_cell(text: str) -> str:
    """Make the text of a CSV cell safe to show in a terminal or a spreadsheet.

    Control characters are escaped.  Text that begins like a spreadsheet formula, with a character
    such as "=", is prefixed with an apostrophe.
    """
    text = make_printable(text)
    return f"'{text}" if text.startswith(("=", "+", "-", "@")) else text
