"""What the charts share: the look of their curves, and how they are measured, stored and drawn."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any

import matplotlib as mpl

mpl.use("Agg")

import matplotlib.pyplot as plt

from reference.command import need_scenes, need_table, parser, result
from reference.measured.measurements import measured_on, read_csv, write_csv

__all__ = ["LOOKS", "headline", "make_chart", "plt"]

plt.rcParams.update(
    {
        "font.size": 10,
        "axes.spines.top": False,
        "axes.spines.right": False,
        "axes.edgecolor": "#888888",
        "axes.labelcolor": "#333333",
        "axes.titlelocation": "left",
        "axes.titlepad": 9,
        "axes.titlesize": 11.5,
        "axes.titleweight": "bold",
        "axes.grid": True,
        "grid.color": "#e8e8e8",
        "grid.linewidth": 0.7,
        "legend.frameon": False,
        "legend.handlelength": 3.2,
        "xtick.color": "#555555",
        "ytick.color": "#555555",
        "svg.fonttype": "none",  # texts as texts: as outlines they would be most of the file
        "svg.hashsalt": "pencil-tracer",
    }
)


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


def headline(figure: Any, title: str, note: str) -> None:
    """Write the title of a whole figure, and a note below it."""
    height = figure.get_figheight()
    figure.text(
        0.03,
        1 - 0.2 / height,
        title,
        va="top",
        fontsize=min(18, 2.6 * figure.get_figwidth()),
        weight="bold",
    )
    figure.text(
        0.03,
        1 - 0.62 / height,
        note,
        va="top",
        fontsize=min(11, 1.6 * figure.get_figwidth()),
        color="#444444",
    )


def make_chart(
    name: str,
    doc: str | None,
    quick: str,
    columns: Sequence[str],
    measure: Callable[[bool], Iterable[Sequence[object]]],
    draw: Callable[[Sequence[Sequence[str]], bool], Any],
) -> None:
    """Run `python -m reference.NAME`: measure the rows of a table, store it, and draw it as SVG.

    `quick` says what `--quick` does, which `measure` and `draw` are told; `draw` makes the figure
    of the rows as the CSV has them, rounded, so that the chart drawn again is the same.
    """
    used = parser(f"reference.{name}", doc, quick, redraw=True)
    options = used.parse_args()
    need_scenes(used)
    table = result(f"{name}.csv", quick=options.quick)
    if options.redraw:
        need_table(used, table)
    else:
        # All of it before the stored table is replaced.
        where, measured = measured_on(), [*measure(options.quick)]
        write_csv(table, where, columns, measured)
    where, rows = read_csv(table)
    figure = draw(rows, options.quick)
    figure.text(0.03, 0.008, f"Measured on {where}.", color="#666666", fontsize=9)
    figure.savefig(table.with_suffix(".svg"), metadata={"Date": None})
    plt.close(figure)
