"""One HTML page that shows pairs of pictures, and contains everything that it shows."""

from __future__ import annotations

import base64
import io
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from jinja2 import Environment, StrictUndefined
from markupsafe import Markup
from PIL import Image

from reference.command import HERE
from reference.figures import Floats
from reference.pictures import Codes

TEMPLATE = HERE / "page.html"

# Maximum side of a thumbnail in pixels.
_MAX_THUMBNAIL = 96

# Values for the template, unless others are given.
_OPTIONAL = {"source": "", "faults": (), "charts": (), "below": (), "is_folded": False}

Pair: TypeAlias = dict[str, Any]
"""Two pictures and their difference, for the template: see `pair`."""


class Cell(NamedTuple):
    """A part of a cell in the overview table.

    Attributes
    ----------
    text : str
        What it says.
    link : int, optional
        Index of the pair to which it leads.
    good : bool, optional
        Whether it reports a success or a failure, if either.
    thumbnail : bytes, optional
        A small picture as a PNG.
    """

    text: str
    link: int | None = None
    good: bool | None = None
    thumbnail: bytes | None = None


def pair(a: Codes, b: Codes, difference: Floats, gain: float, **content: Any) -> Pair:
    """Prepare two pictures and their difference for the template.

    Parameters
    ----------
    a, b : (height, width, 3) uint8 arrays
        8-bit codes of the left and the right picture.
    difference : (height, width, 3) float array
        A picture of the difference, from 0 to 1, as `reference.figures.amplify_difference`
        computes it.
    gain : float
        Factor by which the difference is amplified; 0 if there is none.
    **content
        Values for the template.  Required are `name` and `word` (str: the heading and the
        verdict), `good` (bool), `left` and `right` (str: names of the pictures), and `figures` (a
        sequence of pairs of a name and a value).  Optional are `comment` (str), `faults` and
        `notes` (sequences of paragraphs), `worst` (column and row of a pixel to mark by a ring),
        and `thumbnail` (bytes).
    """
    height, width, _ = a.shape
    optional = {"comment": "", "faults": (), "notes": (), "worst": None, "thumbnail": None}
    pictures = {
        "left_png": png(a),
        "right_png": png(b),
        "difference": png(np.round(255 * difference).astype(np.uint8)),
        "shown": f"difference × {gain:,.10g}" if gain else "no difference",
    }
    return optional | pictures | {"width": width, "height": height} | content


def page(**content: Any) -> str:
    """Render the page.

    Parameters
    ----------
    **content
        Values for the template: `title`, `lead` and `verdict` (str: the heading, and the first
        paragraph with the verdict at its end), `good` (bool), `overview` (str: name of the
        table), `head` (a sequence of column titles), `rows` (for each row a sequence of cells, each
        a sequence of Cell), `pairs` (a sequence of Pair), and `legend` (str).  Optional are
        `source` (str: how the pictures were made), `faults` (a sequence of paragraphs about what
        could not be compared), `charts` (pairs of a title and an SVG as bytes), `below` (a sequence
        of paragraphs below the table) and `is_folded` (bool: whether good pairs are folded).

    Returns
    -------
    html : str
        The page.  A picture that is shown more than once is stored once.
    """
    stored: dict[bytes, str] = {}

    def picture(data: bytes) -> Markup:
        """Return the attributes of an image: its data, or the id of an equal image."""
        if data in stored:
            return Markup('data-same="{}"').format(stored[data])
        stored[data] = f"picture-{len(stored)}"
        return Markup('id="{}" src="{}"').format(stored[data], _data_url(data))

    environment = Environment(autoescape=True, trim_blocks=True, undefined=StrictUndefined)
    environment.filters |= {"source": picture, "png": _data_url}
    environment.filters["svg"] = lambda svg: _data_url(svg, "svg+xml")
    template = environment.from_string(TEMPLATE.read_text(encoding="utf-8"))
    return template.render(_OPTIONAL | content)


def png(codes: Codes, *, thumbnail: bool = False) -> bytes:
    """Encode 8-bit codes (height, width, 3) as a PNG, reduced in size if it is a thumbnail."""
    file, image = io.BytesIO(), Image.fromarray(np.ascontiguousarray(codes))
    if thumbnail:
        image.thumbnail((_MAX_THUMBNAIL, _MAX_THUMBNAIL))
    image.save(file, format="PNG")
    return file.getvalue()


def _data_url(content: bytes, kind: str = "png") -> str:
    """Return a URL that contains a picture; `kind` is "png" or "svg+xml"."""
    return f"data:image/{kind};base64,{base64.b64encode(content).decode()}"
