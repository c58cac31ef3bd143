"""Format the results of comparing hand-ins as text, JSON and CSV.

A *hand-in* is a picture that a student handed in; the *reference picture* is what it should be.
"""

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
    """The result for one picture that a student handed in, or that is missing.

    Attributes
    ----------
    student, scene : str
        The names of the student and of the scene.  The student is empty for a scene of which nobody
        has handed in a picture.
    picture, right : str or None
        File of the picture, and of the reference picture or scene; None if it is missing.
    agrees : bool
        True if the picture is right, or within the tolerances that the user has set.
    diagnosis : Diagnosis or None
        The mistakes in the picture; None if it could not be compared.
    ssim, rmse, max : float or None
        Structural similarity (1 for equal pictures), and root mean square and maximum of the
        difference in linear light; None if the sizes differ.
    differing : int or None
        Number of pixels whose codes differ.
    worst : tuple of 2 ints or None
        Column and row of the pixel that differs most.
    comparison : str or None
        File that shows both pictures side by side, if it was written.
    error : str or None
        A line that states why the picture could not be compared.
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
        """Return the result as a row of the JSON and CSV output.

        Returns
        -------
        dict of str to object
            The values by column.  The diagnosis has three columns: "kind" (keywords of the
            mistakes), "hint" (keywords of the most similar known picture) and "diagnosis"
            (sentences).  Without a diagnosis, they are None.
        """
        diagnosis = self.diagnosis
        columns = {"kind": diagnosis and diagnosis.kind, "hint": diagnosis and diagnosis.hint,
                   "diagnosis": diagnosis and str(diagnosis)}  # fmt: skip
        values = [*self._asdict().items()]
        return dict(values[:5]) | columns | dict(values[6:])

    def format_figures(self) -> str:
        """Format the figures of the comparison as text.

        Returns
        -------
        str
            Structural similarity, and root mean square and maximum of the difference.  Empty if the
            sizes of the pictures differ.
        """
        if self.ssim is None:
            return ""
        return f"SSIM {self.ssim:.4f}  RMSE {self.rmse:.2e}  max {self.max:.2e}"

    def format_line(self) -> str:
        """Format the result as one line: verdict, figures, file and diagnosis; or the error."""
        text = f"{self.format_figures()}  {printable(str(self.picture))}: {self.diagnosis}".lstrip()
        return f"{self.verdict:8} {self.error or text}"


def with_common_causes_first(results: Sequence[Result]) -> list[Result]:
    """Order the alternative causes of each picture by their frequency among the student's pictures.

    A cause is a set of mistakes that are made together.  One program renders all pictures of a
    student, so a cause that explains several of them is more likely than one that explains only
    one.

    Returns
    -------
    list of Result
        Copies of the results, in the same order, each with the most frequent cause first.
    """
    counts: dict[str, Counter[str]] = defaultdict(Counter)
    for result in results:
        if result.diagnosis and not result.agrees:
            counts[result.student].update(result.diagnosis.kind.split("|"))
    diagnoses = (result.diagnosis and result.diagnosis.most_frequent_first(counts[result.student])
                 for result in results)  # fmt: skip
    return [result._replace(diagnosis=d) for result, d in zip(results, diagnoses, strict=True)]


def list_mistake_counts(results: Sequence[Result]) -> list[str]:
    """List the mistakes of a class with their numbers of pictures, the most frequent mistake first.

    If a picture has alternative causes, only the first is counted.

    Returns
    -------
    list of str
        Lines such as "3 × Gamma is missing."
    """
    causes = (
        result.diagnosis.causes[0] for result in results if result.diagnosis and not result.agrees
    )
    counts = Counter(text for cause in causes for kind, text in cause.items() if kind != UNKNOWN)
    return [f"{count} × {text}" for text, count in counts.most_common()]


def summarize_counts(results: Sequence[Result]) -> str:
    """Summarise the results of a class in numbers of pictures.

    Returns
    -------
    str
        How many pictures agree, differ, cannot be compared and are missing, and of how many scenes
        nobody has handed in a picture: "3 pictures: 2 agree, 1 differ; 1 are missing".
    """
    counts = Counter("nobody" if not result.picture and not result.student else result.verdict
                     for result in results)  # fmt: skip
    verbs = {"agrees": "agree", "differs": "differ", "unread": "cannot be compared"}
    numbers = ", ".join(f"{counts[word]} {verb}" for word, verb in verbs.items() if counts[word])
    summary = f"{sum(counts[word] for word in verbs)} pictures: {numbers}"
    summary += f"; {counts['missing']} are missing" if counts["missing"] else ""
    nobody_note = f"; scenes that nobody has handed in: {counts['nobody']}"
    return summary + (nobody_note if counts["nobody"] else "")


def format_text(results: Sequence[Result], *, as_list: bool) -> str:
    """Format results as text for a terminal.

    Parameters
    ----------
    results : sequence of Result
        At least one.
    as_list : bool
        If True, return a line for each result, and a line with counts.  If False, return the
        figures, the diagnosis and the comparison picture's file of the first result, each on a
        line; or its error.
    """
    if as_list:
        return "\n".join([*(result.format_line() for result in results), summarize_counts(results)])
    result = results[0]
    lines = result.format_figures(), str(result.diagnosis), printable(result.comparison or "")
    return result.error or "\n".join(filter(None, lines))


def format_json(results: Sequence[Result]) -> str:
    """Format results as a JSON list with one object for each result."""
    return json.dumps([result.to_row() for result in results], indent=1)


def format_csv(results: Sequence[Result]) -> str:
    """Format results as CSV: a header, and a row for each result.

    The column "worst" contains the worst pixel as ``column,row``, the form of the argument of
    `tracer --pixel`.  File names come from students, so cells are made safe: control characters are
    escaped, and a cell that a spreadsheet would run as a formula begins with an apostrophe.

    Parameters
    ----------
    results : sequence of Result
        At least one result, whose columns become the header.

    Returns
    -------
    str
        The lines of the table, without a newline at the end.
    """
    table = io.StringIO()
    writer = csv.writer(table, lineterminator="\n")
    writer.writerow(results[0].to_row())
    for result in results:
        worst = ",".join(map(str, result.worst)) if result.worst else None
        values = (result.to_row() | {"worst": worst}).values()
        writer.writerow([_make_cell_safe(v) if isinstance(v, str) else v for v in values])
    return table.getvalue().removesuffix("\n")


def _make_cell_safe(text: str) -> str:
    """Change the text of a CSV cell so that neither a terminal nor a spreadsheet executes it.

    Control characters are escaped.  An apostrophe precedes a first character with which a
    spreadsheet formula begins, such as "=".
    """
    text = printable(text)
    return f"'{text}" if text.startswith(("=", "+", "-", "@")) else text
