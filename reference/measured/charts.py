"""Set the style of all charts, and run the commands that measure a table and draw its chart.

Importing this module sets the style.  Modules that draw import `plt`, Matplotlib's pyplot, from
here, so that they cannot forget the style.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any

import matplotlib as mpl

mpl.use("Agg")

import matplotlib.pyplot as plt
from cycler import cycler

from reference.command import REFERENCE_FOLDER, build_path, make_parser
from reference.measured.measurements import describe_origin, read_csv, write_csv

__all__ = ["CHART_WIDTH", "plt", "run_chart_command"]

CHART_WIDTH = 9.0
"""Width of a chart in inches: two panels side by side."""

# Distances of texts from the edges of the chart, in inches.
_TEXT_TO_LEFT_EDGE = 0.2
_TITLE_TO_TOP = 0.15
_NOTE_TO_TOP = 0.45
_ORIGIN_TO_BOTTOM = 0.08

plt.rcParams.update({"axes.spines.top": False, "axes.spines.right": False, "axes.grid": True})
plt.rcParams.update({"axes.titlelocation": "left", "axes.titleweight": "bold"})
plt.rcParams.update({"axes.titlesize": 10, "axes.labelsize": 9, "font.size": 9})
plt.rcParams.update({"axes.edgecolor": "#888888", "grid.color": "#e8e8e8", "legend.frameon": False})
plt.rcParams.update({"lines.markeredgecolor": "white", "lines.markeredgewidth": 0.5})
# Text remains text, because outlines would be most of the file.  The salt makes equal charts equal
# files.
plt.rcParams.update({"svg.fonttype": "none", "svg.hashsalt": "pencil-tracer"})
# This tracer is black.  Other curves have the colours of Okabe and Ito for colour-blind readers,
# and each has its own dashes and marker for print in grey.
plt.rcParams["axes.prop_cycle"] = (
    cycler(color=["#000000", "#d55e00", "#cc79a7", "#b8860b", "#009e73", "#56b4e9", "#0072b2"])
    + cycler(ls=["-", "-", "--", "-.", (0, (5, 1, 1, 1, 1, 1)), ":", (0, (7, 2))])
    + cycler(marker="osDvPX^")
    + cycler(lw=[3.0, *[1.6] * 6])
)


def run_chart_command(
    name: str,
    columns: Sequence[str],
    measure: Callable[[bool], Iterable[Sequence[object]]],
    draw: Callable[[Sequence[Sequence[str]]], Any],
    title: str,
    note: str,
) -> None:
    """Run `python -m reference.NAME`: measure a table, store it as NAME.csv, draw it as NAME.svg.

    The files are in the folder `reference`.  With the option `--quick`, the command measures fewer
    points and writes to the build folder.  With `--redraw`, it draws the stored table without
    measuring.

    Parameters
    ----------
    name
        Name of the module, NAME above.
    columns
        Titles of the columns of the table.
    measure
        Yields the rows of the table.  Its argument is True to measure fewer points.
    draw
        Draws the chart from the rows of the CSV file, and returns it as a Matplotlib figure.
    title, note
        Text above the chart: one line, and smaller lines below it.
    """
    command_parser = make_parser(f"reference.{name}", quick_help="fewer points")
    redraw_help = "draw the stored table again, without measuring"
    command_parser.add_argument("--redraw", action="store_true", help=redraw_help)
    arguments = command_parser.parse_args()
    table_path = build_path(f"{name}.csv") if arguments.quick else REFERENCE_FOLDER / f"{name}.csv"
    if not arguments.redraw:
        # Everything is measured before the stored table is replaced.
        origin, rows = describe_origin(), [*measure(arguments.quick)]
        write_csv(table_path, origin, columns, rows)
    origin, stored_rows = read_csv(table_path)
    figure = draw(stored_rows)
    _write_texts(figure, title, note, f"Measured on {origin}.")
    figure.savefig(table_path.with_suffix(".svg"), metadata={"Date": None})
    plt.close(figure)


def _write_texts(figure: Any, title: str, note: str, footer: str) -> None:
    """Write a title and a note at the top of a Matplotlib figure, and a footer at the bottom."""
    # Positions are fractions of the size of the figure, from its lower left corner.
    width, height = figure.get_size_inches()
    x = _TEXT_TO_LEFT_EDGE / width
    title_top = 1 - _TITLE_TO_TOP / height
    note_top = 1 - _NOTE_TO_TOP / height
    footer_bottom = _ORIGIN_TO_BOTTOM / height
    figure.text(x, title_top, title, va="top", fontsize=14, weight="bold")
    figure.text(x, note_top, note, va="top", fontsize=9, color="#444444")
    figure.text(x, footer_bottom, footer, fontsize=7, color="#666666", wrap=True)
