"""Render an HTML page that shows pairs of pictures, and needs no other file."""

from __future__ import annotations

import base64
import io
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from jinja2 import Environment, StrictUndefined
from markupsafe import Markup
from PIL import Image

from reference.command import HERE
from reference.pictures import Codes
from tracer.command.arguments import OTHER_NAME
from tracer.command.failure import errors_as_failure
from tracer.files import atomic_file

TEMPLATE = HERE / "page.html"

# Maximum side of a thumbnail in pixels.
_MAX_THUMBNAIL = 96

# Default values for the template.
_OPTIONAL = {"source": "", "faults": (), "charts": (), "below": (), "is_folded": False}

Pair: TypeAlias = dict[str, Any]
"""Values for the template about two pictures and their difference, from `prepare_pair`."""


class Cell(NamedTuple):
    """A piece of text in the overview table of a page, perhaps with a thumbnail.

    Attributes
    ----------
    text : str
        The text.
    link : int, optional
        Index of the pair of pictures, further down the page, to which the text links.
    good : bool, optional
        True to mark the text as a success, False as a failure; None for neither.
    thumbnail : bytes, optional
        A small picture as a PNG.
    """

    text: str
    link: int | None = None
    good: bool | None = None
    thumbnail: bytes | None = None


def prepare_pair(
    left_codes: Codes, right_codes: Codes, difference_codes: Codes, gain: float, **content: Any
) -> Pair:
    """Collect what an HTML page shows of two pictures: both, their difference, and text.

    Parameters
    ----------
    left_codes, right_codes : (height, width, 3) uint8 arrays
        8-bit codes of the left and the right picture.
    difference_codes : (height, width, 3) uint8 array
        8-bit codes of a picture of the difference.
    gain : float
        Factor by which the difference is amplified; 0 if the pictures are equal.
    **content
        Further values for the template of the page.

        Required are `name` and `word` (str: the heading and the verdict), `good` (bool), `left` and
        `right` (str: names of the pictures), and `figures` (a sequence of pairs of a name and a
        value).

        Optional are `comment` (str), `faults` and `notes` (sequences of paragraphs), `worst`
        (column and row of a pixel to mark by a ring), and `thumbnail` (bytes).

    Returns
    -------
    pair : dict
        All values for the template by name, with the three pictures as the bytes of PNG files.
    """
    height, width, _ = left_codes.shape
    optional = {"comment": "", "faults": (), "notes": (), "worst": None, "thumbnail": None}
    pictures = {
        "left_png": encode_png(left_codes),
        "right_png": encode_png(right_codes),
        "difference": encode_png(difference_codes),
        "shown": f"difference × {gain:,.10g}" if gain else "no difference",
    }
    return optional | pictures | {"width": width, "height": height} | content


def render_page(**content: Any) -> str:
    """Render an HTML page that shows pairs of pictures, and needs no other file.

    Parameters
    ----------
    **content
        Values for the template.

        Required are `title` (str, the heading), `lead` and `verdict` (str, the beginning and the
        end of the first paragraph), `good` (bool, whether the verdict is a success), `overview`
        (str, the name of the overview table), `head` (a sequence of column titles), `rows` (for
        each row of the table a sequence of its cells, each of which is a sequence of `Cell`),
        `pairs` (a sequence of results of `prepare_pair`), and `legend` (str).

        Optional are `source` (str, the origin of the pictures), `faults` (a sequence of paragraphs
        on failed comparisons), `charts` (a sequence of pairs of a title and an SVG as bytes),
        `below` (a sequence of paragraphs below the table), and `is_folded` (bool, whether pairs
        with a good verdict are folded).

    Returns
    -------
    html : str
        The page.  Equal pictures are stored once.

    Raises
    ------
    UndefinedError
        If a required value is missing.
    """
    image_id: dict[bytes, str] = {}

    def image_attributes(png: bytes) -> Markup:
        """Return HTML attributes with a PNG, or with the id of an element that has an equal PNG."""
        if png in image_id:
            return Markup('data-same="{}"').format(image_id[png])
        image_id[png] = f"picture-{len(image_id)}"
        return Markup('id="{}" src="{}"').format(image_id[png], _data_url(png))

    environment = Environment(autoescape=True, trim_blocks=True, undefined=StrictUndefined)
    environment.filters |= {"source": image_attributes, "png": _data_url}
    environment.filters["svg"] = lambda svg: _data_url(svg, "svg+xml")
    template = environment.from_string(TEMPLATE.read_text(encoding="utf-8"))
    return template.render(_OPTIONAL | content)


def write_page(path: Path, html: str, remedy: str = OTHER_NAME, status: int = 1) -> None:
    """Write an HTML page to a file, and create the folder of the file if it does not exist.

    Parameters
    ----------
    path : Path
        The file to write.  Only an existing HTML file is replaced.
    html : str
        The page, which begins with ``<!doctype html>``.  Characters that UTF-8 cannot encode, as in
        some file names, are escaped.
    remedy : str
        What the user can do if the file cannot be written, for the message of the failure.
    status : int
        Exit status of the command if the file cannot be written.

    Raises
    ------
    Failure
        If the file cannot be written.
    """
    with errors_as_failure(path, "written", remedy, status=status):
        path.parent.mkdir(parents=True, exist_ok=True)
        with atomic_file(path, b"<!doctype html>") as file:
            file.write(html.encode(errors="backslashreplace"))


def encode_png(codes: Codes, *, thumbnail: bool = False) -> bytes:
    """Encode a picture as a PNG file in memory.

    Parameters
    ----------
    codes : (height, width, 3) uint8 array
        8-bit codes of the picture.
    thumbnail : bool
        Whether to shrink the picture to at most 96 x 96 pixels.

    Returns
    -------
    png : bytes
        The content of the file.
    """
    buffer, image = io.BytesIO(), Image.fromarray(np.ascontiguousarray(codes))
    if thumbnail:
        image.thumbnail((_MAX_THUMBNAIL, _MAX_THUMBNAIL))
    image.save(buffer, format="PNG")
    return buffer.getvalue()


def _data_url(content: bytes, subtype: str = "png") -> str:
    """Encode a picture file of the MIME type image/SUBTYPE as a data URL, which contains it."""
    return f"data:image/{subtype};base64,{base64.b64encode(content).decode()}"
