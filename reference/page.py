"""One HTML page that shows pairs of pictures and holds all that it shows."""

from __future__ import annotations

import base64
import io
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from jinja2 import Environment
from markupsafe import Markup
from PIL import Image

from reference.command import HERE
from reference.figures import Floats
from reference.pictures import Codes

TEMPLATE = HERE / "page.html"
# Longer side of a thumbnail in pixels.
_THUMBNAIL = 96


class Cell(NamedTuple):
    """A cell of the overview; `link` is the index of a pair, `thumbnail` a PNG."""

    text: str
    link: int | None = None
    good: bool | None = None
    thumbnail: bytes | None = None


@dataclass(frozen=True, kw_only=True)
class Pair:
    """Two pictures and their difference, all PNGs of one size; `shown` is the caption of that.

    `left` and `right` say what the pictures are; `worst` is a pixel that gets a ring.
    """

    name: str
    good: bool
    word: str
    left: str
    right: str
    width: int
    height: int
    left_png: bytes
    right_png: bytes
    difference: bytes
    shown: str
    figures: Sequence[tuple[str, object]]
    comment: str = ""
    faults: Sequence[str] = ()
    notes: Sequence[str] = ()
    worst: tuple[int, int] | None = None
    thumbnail: bytes | None = None

    @classmethod
    def of(cls, a: Codes, b: Codes, difference: Floats, gain: float, **told: Any) -> Pair:
        """Codes (h, w, 3), and their difference in 0 ... 1 with its gain, as `amplified` has it."""
        return cls(
            width=a.shape[1],
            height=a.shape[0],
            left_png=png(a),
            right_png=png(b),
            difference=png(np.round(255 * difference).astype(np.uint8)),
            shown=f"difference × {gain:,.10g}" if gain else "no difference",
            **told,
        )


def page(
    *,
    title: str,
    lead: str,
    verdict: str,
    good: bool,
    overview: str,
    head: Sequence[str],
    rows: Sequence[Sequence[Sequence[Cell]]],
    pairs: Sequence[Pair],
    legend: str,
    source: str = "",
    faults: Sequence[str] = (),
    charts: Iterable[tuple[str, bytes]] = (),
) -> str:
    """The page as HTML.

    A place in a row holds some cells.  `charts` are titles and SVGs; `faults` says what could not
    be compared, `source` how the rest was.
    """
    held: dict[bytes, str] = {}

    def picture(data: bytes) -> Markup:
        """The attributes of a picture: its content, or where that is held already."""
        if data in held:
            return Markup('data-same="{}"').format(held[data])
        held[data] = f"picture-{len(held)}"
        return Markup('id="{}" src="{}"').format(held[data], _data(data))

    environment = Environment(autoescape=True, trim_blocks=True)
    environment.filters |= {"source": picture, "png": _data}
    environment.filters["svg"] = lambda svg: _data(svg, "svg+xml")
    template = environment.from_string(TEMPLATE.read_text(encoding="utf-8"))
    return template.render(
        title=title, lead=lead, verdict=verdict, good=good, overview=overview, head=head, rows=rows,
        pairs=pairs, legend=legend, source=source, faults=faults, charts=charts,
    )  # fmt: skip


def png(codes: Codes, *, thumbnail: bool = False) -> bytes:
    """Codes (h, w, 3) as a PNG, or as a small one."""
    data, image = io.BytesIO(), Image.fromarray(np.ascontiguousarray(codes))
    if thumbnail:
        image.thumbnail((_THUMBNAIL, _THUMBNAIL))
    image.save(data, format="PNG")
    return data.getvalue()


def _data(content: bytes, kind: str = "png") -> str:
    """A picture as an address that holds it."""
    return f"data:image/{kind};base64,{base64.b64encode(content).decode()}"
