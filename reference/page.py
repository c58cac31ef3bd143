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
"""Two pictures and their difference, for the template: see `prepare_pair`."""


class Cell(NamedTuple):
    """A piece of text, or a thumbnail, in a cell of the page's overview table.

    Attributes
    ----------
    text : str
        The text.
    link : int, optional
        Index of the pair of pictures on the page to which the text links.
    good : bool, optional
        True if the text reports a success, False if it reports a failure.
    thumbnail : bytes, optional
        A small picture as a PNG.
    """

    text: str
    link: int | None = None
    good: bool | None = None
    thumbnail: bytes | None = None


def prepare_pair(a: Codes, b: Codes, difference: Floats, gain: float, **content: Any) -> Pair:
    """Prepare two pictures and their difference for the template of the page.

    Parameters
    ----------
    a, b : (height, width, 3) uint8 arrays
        8-bit codes of the left and the right picture.
    difference : (height, width, 3) float array
        A picture of the difference, from 0 to 1, as `reference.figures.amplify_difference` computes
        it.
    gain : float
        Factor by which the difference is amplified; 0 if the pictures are equal.
    **content
        Values for the template.

        Required are `name` and `word` (str: the heading and the verdict), `good` (bool), `left` and
        `right` (str: names of the pictures), and `figures` (a sequence of pairs of a name and a
        value).

        Optional are `comment` (str), `faults` and `notes` (sequences of paragraphs), `worst`
        (column and row of a pixel to mark by a ring), and `thumbnail` (bytes).

    Returns
    -------
    pair : Pair
        All values for the template, including the pictures as PNG files.
    """
    height, width, _ = a.shape
    optional = {"comment": "", "faults": (), "notes": (), "worst": None, "thumbnail": None}
    pictures = {
        "left_png": encode_png(a),
        "right_png": encode_png(b),
        "difference": encode_png(np.round(255 * difference).astype(np.uint8)),
        "shown": f"difference × {gain:,.10g}" if gain else "no difference",
    }
    return optional | pictures | {"width": width, "height": height} | content


def render_page(**content: Any) -> str:
    """Render an HTML page that shows pairs of pictures, and contains everything that it shows.

    Parameters
    ----------
    **content
        Values for the template.

        Required are `title`, `lead` and `verdict` (str: the heading, and the first paragraph with
        the verdict at its end), `good` (bool), `overview` (str: name of the table), `head` (a
        sequence of column titles), `rows` (for each row a sequence of cells, each a sequence of
        Cell), `pairs` (a sequence of Pair), and `legend` (str).

        Optional are `source` (str: how the pictures were made), `faults` (a sequence of paragraphs
        about what could not be compared), `charts` (pairs of a title and an SVG as bytes), `below`
        (a sequence of paragraphs below the table) and `is_folded` (bool: whether good pairs are
        folded).

    Returns
    -------
    html : str
        The page.  A picture that occurs more than once is stored once.

    Raises
    ------
    UndefinedError
        If a required value is missing.
    """
    image_id: dict[bytes, str] = {}

    def image_attributes(data: bytes) -> Markup:
        """Return the attributes of an image element: the picture, or the id of an equal element."""
        if data in image_id:
            return Markup('data-same="{}"').format(image_id[data])
        image_id[data] = f"picture-{len(image_id)}"
        return Markup('id="{}" src="{}"').format(image_id[data], _data_url(data))

    environment = Environment(autoescape=True, trim_blocks=True, undefined=StrictUndefined)
    environment.filters |= {"source": image_attributes, "png": _data_url}
    environment.filters["svg"] = lambda svg: _data_url(svg, "svg+xml")
    template = environment.from_string(TEMPLATE.read_text(encoding="utf-8"))
    return template.render(_OPTIONAL | content)


def encode_png(codes: Codes, *, thumbnail: bool = False) -> bytes:
    """Encode a picture as a PNG.

    Parameters
    ----------
    codes : (height, width, 3) uint8 array
        8-bit codes of the picture.
    thumbnail : bool
        Whether to reduce the size to at most 96 x 96 pixels.

    Returns
    -------
    png : bytes
        The PNG file.
    """
    buffer, image = io.BytesIO(), Image.fromarray(np.ascontiguousarray(codes))
    if thumbnail:
        image.thumbnail((_MAX_THUMBNAIL, _MAX_THUMBNAIL))
    image.save(buffer, format="PNG")
    return buffer.getvalue()


def _data_url(content: bytes, subtype: str = "png") -> str:
    """Return a URL that contains a picture with the MIME type image/subtype, such as image/png."""
    return f"data:image/{subtype};base64,{base64.b64encode(content).decode()}"
