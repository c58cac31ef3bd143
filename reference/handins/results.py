"""Format the results of comparing submitted with reference pictures, as text, JSON and CSV.

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


class Result(NamedTuple):
    """The result for one submitted or missing picture.

    Attributes
    ----------
    student, scene : str
        Names of the student and of the scene.  The student is empty if nobody has submitted a
        picture of the scene.
    picture, right : str or None
        Files of the submitted picture, and of the reference picture or scene; None if missing.
    agrees : bool
        True if the picture is right, or within the tolerances set by the user.
    diagnosis : Diagnosis or None
        The mistakes in the picture; None if it could not be compared.
    ssim, rmse, max : float or None
        Structural similarity (1 for equal pictures), and the root mean square and the maximum of
        the difference in linear light; None if the sizes differ.
    differing : int or None
        Number of pixels whose codes differ.
    worst : tuple of 2 ints or None
        Column and row of the pixel that differs most.
    comparison : str or None
        File that shows both pictures side by side, if one was written.
    error : str or None
        One line that states why the picture could not be compared.
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
    def verdict(self) -> str:
        """One word: "missing", "unread" (could not be compared), "agrees" or "differs"."""
        if self.error:
            return "unread" if self.picture else "missing"
        return "agrees" if self.agrees else "differs"

    def to_row(self) -> dict[str, Any]:
        """Convert the result to a row of the JSON and CSV output.

        Returns
        -------
        dict of str to object
            The values by column name.  The diagnosis takes three columns: "kind" (keywords of the
            mistakes), "hint" (if no cause is known, keywords of the mistakes that come closest to
            explaining the picture) and "diagnosis" (sentences).  All are None without a diagnosis.
        """
        diagnosis, row = self.diagnosis, dict[str, Any]()
        new_columns = {"kind": diagnosis and diagnosis.kind, "hint": diagnosis and diagnosis.hint,
                       "diagnosis": diagnosis and str(diagnosis)}  # fmt: skip
        for name, value in self._asdict().items():
            row |= new_columns if name == "diagnosis" else {name: value}
        return row

    def format_metrics(self) -> str:
        """Format the metrics of the comparison as text.

        Returns
        -------
        str
            Structural similarity, root mean square error and maximum difference.  Empty if the
            sizes of the pictures differ.
        """
        if self.ssim is None:
            return ""
        return f"SSIM {self.ssim:.4f}  RMSE {self.rmse:.2e}  max {self.max:.2e}"

    def format_line(self) -> str:
        """Format the result as one line: verdict, metrics, file and diagnosis; or the error."""
        report = f"{self.format_metrics()}  {make_printable(str(self.picture))}: {self.diagnosis}"
        return f"{self.verdict:8} {self.error or report.lstrip()}"


def sort_causes(results: Sequence[Result]) -> list[Result]:
    """Sort the possible causes of each picture by their frequency in the student's wrong pictures.

    A cause is a set of mistakes that are made together.  All pictures of a student come from one
    program, so the cause that explains most of them is the most likely.

    Parameters
    ----------
    results : sequence of Result
        The results of all students.

    Returns
    -------
    list of Result
        Copies of the results, in the same order, each with the most frequent cause first.
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
    """List how many pictures contain each mistake, the most frequent mistake first.

    If a picture has alternative causes, only the first is counted.

    Parameters
    ----------
    results : sequence of Result
        The results of a class.

    Returns
    -------
    list of str
        Lines such as "3 × Gamma is missing."
    """
    causes = (
        result.diagnosis.causes[0] for result in results if result.diagnosis and not result.agrees
    )
    counts = Counter(cause[keyword] for cause in causes for keyword in cause if keyword != UNKNOWN)
    return [f"{count} × {sentence}" for sentence, count in counts.most_common()]


def summarize_counts(results: Sequence[Result]) -> str:
    """Summarise how many pictures of a class are right, wrong or missing.

    Returns
    -------
    str
        A summary such as "3 pictures: 2 agree, 1 differ; 1 are missing".  Pictures that cannot be
        compared and scenes that nobody has handed in are also counted.
    """
    counts = Counter("unused" if not result.picture and not result.student else result.verdict
                     for result in results)  # fmt: skip
    verbs = {"agrees": "agree", "differs": "differ", "unread": "cannot be compared"}
    clauses = [f"{counts[verdict]} {verb}" for verdict, verb in verbs.items() if counts[verdict]]
    summary = f"{sum(counts[verdict] for verdict in verbs)} pictures: {', '.join(clauses)}"
    summary += f"; {counts['missing']} are missing" if counts["missing"] else ""
    unused_note = f"; scenes that nobody has handed in: {counts['unused']}"
    return summary + (unused_note if counts["unused"] else "")


def format_text(results: Sequence[Result], *, is_class: bool) -> str:
    """Format the results of a class, or of a single comparison, as text for a terminal.

    Parameters
    ----------
    results : sequence of Result
        The results of the class, or a single result.
    is_class : bool
        True for the results of a class, false for a single result.

    Returns
    -------
    str
        For a class, one line per result and a summary.  For a single comparison, the error; or up
        to three lines: metrics, diagnosis and the file of the comparison picture.
    """
    if is_class:
        return "\n".join([*(result.format_line() for result in results), summarize_counts(results)])
    result = results[0]
    lines = result.format_metrics(), str(result.diagnosis), make_printable(result.comparison or "")
    return result.error or "\n".join(filter(None, lines))


def format_json(results: Sequence[Result]) -> str:
    """Format results as a JSON list with one object per result."""
    return json.dumps([result.to_row() for result in results], indent=1)


def format_csv(results: Sequence[Result]) -> str:
    """Format results as CSV, with a header and one row per result.

    The column "worst" contains the worst pixel as ``column,row``, as `tracer --pixel` expects it.

    Parameters
    ----------
    results : sequence of Result
        At least one result.

    Returns
    -------
    str
        The table, without a newline at the end.
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
