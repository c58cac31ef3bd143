"""What the charts share: the look of their curves, and how they are measured, stored and drawn."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any

import matplotlib as mpl

mpl.use("Agg")

import matplotlib.pyplot as plt

from reference.command import HERE, built, parser
from reference.measured.measurements import measured_on, read_csv, write_csv

__all__ = ["LOOKS", "WIDTH", "make_chart", "plt"]

WIDTH = 5.6
"""Inches that a phone shows in full."""

plt.rcParams.update({"axes.spines.top": False, "axes.spines.right": False, "axes.grid": True})
plt.rcParams.update({"axes.titlelocation": "left", "axes.titleweight": "bold"})
plt.rcParams.update({"axes.edgecolor": "#888888", "grid.color": "#e8e8e8", "legend.frameon": False})
# Texts stay texts, which as outlines would be most of the file; and files stay the same.
plt.rcParams.update({"svg.fonttype": "none", "svg.hashsalt": "pencil-tracer"})


def _look(color: str, dashes: Any, marker: str, size: float = 5.0, width: float = 1.6) -> Any:
    line = {"color": color, "ls": dashes, "lw": width}
    return line | {"marker": marker, "ms": size, "mec": "white", "mew": 0.5}


# Okabe and Ito's colours; every look also has its own dashes and marker, for print in grey.
LOOKS: dict[str, dict[str, Any]] = {
    "tracer": _look("#000000", "-", "o", 5.5, 3.0) | {"zorder": 5},
    "a": _look("#d55e00", "-", "s", 4.5),
    "b": _look("#cc79a7", "--", "D", 4.0),
    "c": _look("#b8860b", "-.", "v"),
    "d": _look("#009e73", (0, (5, 1.5, 1, 1.5, 1, 1.5)), "P", 6.0),
    "e": _look("#56b4e9", (0, (1.2, 1.2)), "X"),
    "f": _look("#0072b2", (0, (7, 2)), "^"),
    "g": _look("#7b5fc4", (0, (3, 1, 1, 1)), "<"),
}


def make_chart(
    name: str,
    doc: str | None,
    columns: Sequence[str],
    measure: Callable[[bool], Iterable[Sequence[object]]],
    draw: Callable[[Sequence[Sequence[str]], bool], Any],
    texts: tuple[str, str],
) -> None:
    """Run `python -m reference.NAME`: measure the rows of a table, store it, and draw it as SVG.

    `measure` and `draw` are told whether to be quick; `draw` makes the figure of the rows as the
    CSV has them, rounded, so that the chart drawn again is the same.  `texts` are its title and a
    note below that.
    """
    used = parser(f"reference.{name}", doc, "fewer points")
    used.add_argument("--redraw", action="store_true", help="measure nothing: draw the CSV")
    options = used.parse_args()
    table = built(f"{name}.csv") if options.quick else HERE / f"{name}.csv"
    if not options.redraw:
        # All of it before the stored table is replaced.
        where, measured = measured_on(), [*measure(options.quick)]
        write_csv(table, where, columns, measured)
    where, rows = read_csv(table)
    figure = draw(rows, options.quick)
    title, note = texts
    height = figure.get_figheight()
    figure.text(0.03, 1 - 0.2 / height, title, va="top", fontsize=14, weight="bold")
    figure.text(0.03, 1 - 0.58 / height, note, va="top", fontsize=9, color="#444444")
    origin = f"Measured on {where}."
    figure.text(0.03, 0.1 / height, origin, fontsize=7, color="#666666", wrap=True)
    figure.savefig(table.with_suffix(".svg"), metadata={"Date": None})
    plt.close(figure)
