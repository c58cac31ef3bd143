"""The style of the charts: fonts, colours, labels beside their curves; written as SVG."""

from __future__ import annotations

import io
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, TypeAlias

import matplotlib as mpl

mpl.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.colors import to_rgb
from matplotlib.patheffects import withStroke
from matplotlib.text import Text

__all__ = [
    "HALO",
    "LOOKS",
    "End",
    "headline",
    "label_ends",
    "label_losses",
    "plt",
    "save",
]

HALO = [withStroke(linewidth=3, foreground="white")]
"""Keeps text legible across lines."""

# Of an SVG: the same halos; and for those who lack the font of the charts, one that is as wide.
_STYLE = """
[id^=halo] text {stroke: white; stroke-width: 3; stroke-linejoin: round; paint-order: stroke}
text, tspan {font-family: "DejaVu Sans", Verdana, sans-serif !important}
</style>"""

# Font size of labels, in points.
_SIZE = 9

# Of text: contrast to white is 1.05 over luminance + 0.05, and should be 4.5.
_MOST_LUMINANCE = 1.05 / 4.5 - 0.05

plt.rcParams.update(
    {
        "font.family": "DejaVu Sans",
        "font.size": 10,
        "axes.spines.top": False,
        "axes.spines.right": False,
        "axes.edgecolor": "#888888",
        "axes.labelcolor": "#333333",
        "axes.titlelocation": "left",
        "axes.titlesize": 11.5,
        "axes.titleweight": "bold",
        "axes.grid": True,
        "grid.color": "#e8e8e8",
        "grid.linewidth": 0.7,
        "xtick.color": "#555555",
        "ytick.color": "#555555",
        "xtick.minor.visible": False,
        "ytick.minor.visible": False,
        "svg.fonttype": "none",  # texts as texts: as outlines they would be most of the file
        "svg.hashsalt": "pencil-tracer",
    }
)


def _look(color: str, dashes: Any, marker: str, size: float = 5.0, width: float = 1.6) -> Any:
    return {
        "color": color,
        "ls": dashes,
        "lw": width,
        "marker": marker,
        "ms": size,
        "mec": "white",
        "mew": 0.5,
    }


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
    "h": _look("#777777", (0, (4, 1, 1, 1)), ">"),
}

End: TypeAlias = tuple[float, float, str, str]
"""Where a curve ends (x, y), its name and its colour."""


def _spread(wanted: Sequence[float], spacing: float) -> list[float]:
    """Move sorted places as little as it takes to keep them `spacing` apart."""
    # Places too near merge into blocks, each centred where its members want to be.
    blocks: list[tuple[float, int]] = []
    for place in wanted:
        blocks.append((place, 1))
        while len(blocks) > 1:
            (y0, n0), (y1, n1) = blocks[-2:]
            if y1 - y0 >= spacing * (n0 + n1) / 2:
                break
            blocks[-2:] = [((n0 * y0 + n1 * y1) / (n0 + n1), n0 + n1)]
    return [y + (i - (n - 1) / 2) * spacing for y, n in blocks for i in range(n)]


def label_ends(axes: Any, ends: Iterable[End]) -> None:
    """Name curves at the right of the axes, which must have their final limits."""
    _label(axes, sorted(ends, key=lambda end: (end[1], end[2])), 1)


def label_losses(axes: Any, ends: Iterable[End]) -> None:
    """Cross curves out where they leave through the top of the axes, and name them there."""
    ends = sorted(ends)
    for x, y, _, color in ends:
        axes.plot(x, y, "x", color=color, ms=11, mew=3, clip_on=False, zorder=6)
    _label(axes, ends, 0)


def _ink(color: str) -> Any:
    """A colour, darkened until text in it has a contrast of 4.5 to white (WCAG 2.1, 1.4.3)."""
    rgb = np.array(to_rgb(color))
    # A luminance, nearly: codes to the power 2.2.
    luminance = float(rgb**2.2 @ (0.2126, 0.7152, 0.0722))
    return rgb * (_MOST_LUMINANCE / max(luminance, _MOST_LUMINANCE)) ** (1 / 2.2)


def _label(axes: Any, ends: Sequence[End], along: int) -> None:
    points = 72 / axes.figure.dpi
    corner = axes.get_window_extent().max * points
    at = [axes.transData.transform(end[:2]) * points for end in ends]
    places = _spread([float(xy[along]) for xy in at], (1.3 if along else 2.6) * _SIZE)
    for (x, y, text, color), xy, place in zip(ends, at, places, strict=True):
        away = (corner[0] + 14 - xy[0], place - xy[1])
        if not along:
            away = (place - xy[0] + 3, corner[1] + 9 - xy[1])
        axes.annotate(
            text,
            xy=(x, y),
            xytext=away,
            textcoords="offset points",
            color=_ink(color),
            fontsize=_SIZE,
            fontweight="bold" if "tracer" in text else "normal",
            va="center" if along else "bottom",
            rotation=0 if along else 28,
            rotation_mode="anchor",
            annotation_clip=False,
            path_effects=HALO,
            zorder=7,
            arrowprops={
                "arrowstyle": "-",
                "color": color,
                "lw": 0.6,
                "alpha": 0.6,
                "shrinkA": 0,
                "shrinkB": 4,
                "relpos": (0, 0.5 if along else 0),
            },
        )


def headline(figure: Any, title: str, note: str) -> None:
    """Write the title of a whole figure, and a note below it."""
    height = figure.get_figheight()
    for words, below, look in (
        (title, 0.2, {"fontsize": 18, "weight": "bold"}),
        (note, 0.62, {"fontsize": 11, "color": "#444444", "linespacing": 1.4}),
    ):
        figure.text(0.03, 1 - below / height, words, va="top", **look)


def save(figure: Any, path: Path) -> None:
    """Write a figure as SVG."""
    # As path effects, halos would be written as the outlines of all their glyphs.
    for k, text in enumerate(figure.findobj(Text)):
        if text.get_path_effects():
            text.set(gid=f"halo{k}", path_effects=[])
    figure.savefig(written := io.StringIO(), format="svg", metadata={"Date": None})
    svg = written.getvalue().replace("</style>", _STYLE, 1)
    path.write_text(svg, encoding="utf-8")
    plt.close(figure)
