"""What the charts share: how their curves look, and how they are measured, stored and drawn."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any

import matplotlib as mpl

mpl.use("Agg")

import matplotlib.pyplot as plt
from cycler import cycler

from reference.command import HERE, built, parser
from reference.measured.measurements import measured_on, read_csv, write_csv

__all__ = ["WIDTH", "make_chart", "plt"]

WIDTH = 5.6
"""Inches that a phone shows in full."""

plt.rcParams.update({"axes.spines.top": False, "axes.spines.right": False, "axes.grid": True})
plt.rcParams.update({"axes.titlelocation": "left", "axes.titleweight": "bold"})
plt.rcParams.update({"axes.edgecolor": "#888888", "grid.color": "#e8e8e8", "legend.frameon": False})
plt.rcParams.update({"lines.markeredgecolor": "white", "lines.markeredgewidth": 0.5})
# Texts stay texts, which as outlines would be most of the file; and files stay the same.
plt.rcParams.update({"svg.fonttype": "none", "svg.hashsalt": "pencil-tracer"})
# This tracer is black; the others have Okabe and Ito's colours, and for print in grey each its own
# dashes and marker.
plt.rcParams["axes.prop_cycle"] = (
    cycler(color=["#000000", "#d55e00", "#cc79a7", "#b8860b", "#009e73", "#56b4e9", "#0072b2"])
    + cycler(ls=["-", "-", "--", "-.", (0, (5, 1, 1, 1, 1, 1)), ":", (0, (7, 2))])
    + cycler(marker="osDvPX^")
    + cycler(lw=[3.0, *[1.6] * 6])
)


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
