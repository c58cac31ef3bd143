"""The results of comparisons, as text, JSON and CSV."""

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
    """The result of comparing a picture that was handed in, or of finding that one is missing.

    Attributes
    ----------
    student, scene : str
        The student who handed the picture in, and the name of the scene.  The student is empty for
        a scene of which nobody has handed in a picture.
    picture, right : str or None
        File of the picture, and of the right picture or scene.  `picture` is None if it is missing.
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
        """Return the values of the result by the names of their columns in the JSON and CSV output.

        The diagnosis becomes three columns: "kind" (keywords of its mistakes), "hint" (keywords of
        the most similar known picture) and "diagnosis" (sentences).
        """
        diagnosis = self.diagnosis
        columns = {"kind": diagnosis and diagnosis.kind, "hint": diagnosis and diagnosis.hint,
                   "diagnosis": diagnosis and str(diagnosis)}  # fmt: skip
        values = [*self._asdict().items()]
        return dict(values[:5]) | columns | dict(values[6:])

    def figures(self) -> str:
        """Format SSIM, RMSE and the largest difference for a line of text.

        Returns
        -------
        str
            Empty if the sizes of the pictures differ.
        """
        if self.ssim is None:
            return ""
        return f"SSIM {self.ssim:.4f}  RMSE {self.rmse:.2e}  max {self.max:.2e}"

    def line(self) -> str:
        """Return the result as one line: verdict, figures, picture and diagnosis, or the error."""
        text = f"{self.figures()}  {printable(str(self.picture))}: {self.diagnosis}".lstrip()
        return f"{self.verdict:8} {self.error or text}"


def with_common_causes_first(results: Sequence[Result]) -> list[Result]:
    """Order the alternative causes of each picture by their frequency among the student's pictures.

    All pictures of one student are rendered by one program, so its mistakes show in all of them.  A
    cause (a set of mistakes that are made together) that explains several pictures is therefore
    more likely than one that explains a single picture.

    Returns
    -------
    list of Result
        Copies of the results, in the same order, with the most frequent causes first.
    """
    counts: dict[str, Counter[str]] = defaultdict(Counter)
    for result in results:
        if result.diagnosis and not result.agrees:
            counts[result.student].update(result.diagnosis.kind.split("|"))
    ordered = []
    for result in results:
        common = [cause for cause, _ in counts[result.student].most_common()]
        diagnosis = result.diagnosis and result.diagnosis.preferring(common)
        ordered.append(result._replace(diagnosis=diagnosis))
    return ordered


def mistake_lines(results: Sequence[Result]) -> list[str]:
    """Return a line of text for each mistake of a class, the most frequent mistake first.

    Each line has the number of pictures with the mistake, and the sentence that describes it.  If
    a picture has alternative causes, only the first is counted.
    """
    causes = (
        result.diagnosis.causes[0] for result in results if result.diagnosis and not result.agrees
    )
    counts = Counter(text for cause in causes for kind, text in cause.items() if kind != UNKNOWN)
    return [f"{count} × {text}" for text, count in counts.most_common()]


def summarize_counts(results: Sequence[Result]) -> str:
    """Return a sentence with the numbers of pictures that agree, differ, and so on.

    It also states how many pictures are missing, and of how many scenes nobody has handed in a
    picture.
    """
    counts = Counter("nobody" if not result.picture and not result.student else result.verdict
                     for result in results)  # fmt: skip
    verbs = {"agrees": "agree", "differs": "differ", "unread": "cannot be compared"}
    parts = ", ".join(f"{counts[word]} {verb}" for word, verb in verbs.items() if counts[word])
    text = f"{sum(counts[word] for word in verbs)} pictures: {parts}"
    text += f"; {counts['missing']} are missing" if counts["missing"] else ""
    nobody_note = f"; scenes that nobody has handed in: {counts['nobody']}"
    return text + (nobody_note if counts["nobody"] else "")


def format_text(results: Sequence[Result], *, as_list: bool) -> str:
    """Format results as text for a terminal.

    Parameters
    ----------
    results : sequence of Result
        At least one.
    as_list : bool
        If true, return one line for each result, and a line with counts.  If false, return figures,
        diagnosis and file of the first result, or its error, each on a line.
    """
    if as_list:
        return "\n".join([*(result.line() for result in results), summarize_counts(results)])
    result = results[0]
    lines = result.figures(), str(result.diagnosis), printable(result.comparison or "")
    return result.error or "\n".join(filter(None, lines))


def format_json(results: Sequence[Result]) -> str:
    """Format results as JSON: a list with one object for each result."""
    return json.dumps([result.to_row() for result in results], indent=1)


def format_csv(results: Sequence[Result]) -> str:
    """Format results as CSV: a header, and a row for each result.

    The column "worst" contains the worst pixel as ``column,row``, as the option --pixel of `tracer`
    takes it.  Names come from students, so control characters are escaped, and a cell that a
    spreadsheet would run as a formula begins with an apostrophe.

    Parameters
    ----------
    results : sequence of Result
        At least one.
    """
    table = io.StringIO()
    writer = csv.writer(table, lineterminator="\n")
    writer.writerow(results[0].to_row())
    for result in results:
        worst = ",".join(map(str, result.worst)) if result.worst else None
        values = (result.to_row() | {"worst": worst}).values()
        writer.writerow([_safe_cell(v) if isinstance(v, str) else v for v in values])
    return table.getvalue().removesuffix("\n")


def _safe_cell(text: str) -> str:
    """Return the text of a CSV cell that neither a terminal nor a spreadsheet will execute.

    Control characters are escaped, and an apostrophe is put before a first character with which a
    spreadsheet formula begins.
    """
    text = printable(text)
    return f"'{text}" if text.startswith(("=", "+", "-", "@")) else text
