"""Render a self-contained HTML page that shows pairs of pictures."""

from __future__ import annotations

import base64
import io
from pathlib import Path
from typing import Annotated as Shaped
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from jinja2 import Environment, StrictUndefined
from markupsafe import Markup
from PIL import Image

from reference.command import REFERENCE_FOLDER
from reference.pictures import Codes
from tracer.command.arguments import OUTPUT_REMEDY
from tracer.command.failure import errors_as_failure
from tracer.files import open_atomically

TEMPLATE = REFERENCE_FOLDER / "page.html"

# Maximum side of a thumbnail in pixels.
_MAX_THUMBNAIL_SIDE = 96

# Default values of the optional template variables.
_DEFAULT_CONTENT = {"source": "", "faults": (), "charts": (), "sections": (), "is_class": False}

Pair: TypeAlias = dict[str, Any]
"""Template values for a pair of pictures and their difference, from `prepare_pair`."""


class Cell(NamedTuple):
    """A piece of text in a page's overview table, with an optional thumbnail."""

    text: str
    link: int | None = None  # index of the pair of pictures to which the text links
    is_good: bool | None = None  # marks the text as a success or a failure; None for neither
    thumbnail: bytes | None = None  # a small picture as a PNG


def prepare_pair(
    left_codes: Shaped[Codes, "h w 3"],
    right_codes: Shaped[Codes, "h w 3"],
    difference_codes: Shaped[Codes, "h w 3"],
    gain: float,
    **content: Any,
) -> Pair:
    """Collect the values that the HTML template needs to show a pair of pictures.

    Parameters
    ----------
    left_codes, right_codes, difference_codes
        The two pictures, and a picture of their difference.
    gain
        Factor by which the difference is amplified; 0 if the pictures are equal.
    **content
        Further template values by name:

        - `name`, `verdict` : str, shown in the heading
        - `is_good` : bool, whether the verdict is a success
        - `left_name`, `right_name` : str, the names of the pictures
        - `figures` : sequence of (name, value) tuples
        - `comment` : str, optional
        - `faults`, `notes` : sequences of paragraphs, optional
        - `worst_pixel` : column and row of a pixel to mark with a ring, optional
        - `thumbnail` : bytes of a PNG file, optional
    """
    height, width, _ = left_codes.shape
    defaults = {"comment": "", "faults": (), "notes": (), "worst_pixel": None, "thumbnail": None}
    picture_content = {
        "left_png": encode_png(left_codes),
        "right_png": encode_png(right_codes),
        "difference_png": encode_png(difference_codes),
        "difference_caption": f"difference × {gain:,.10g}" if gain else "no difference",
    }
    return defaults | picture_content | {"width": width, "height": height} | content


def render_page(**content: Any) -> str:
    """Render a self-contained HTML page that shows pairs of pictures, each stored once.

    Parameters
    ----------
    **content
        Values for the page template by name:

        - `title`, `table_name` : str, the headings of the page and of its table
        - `introduction`, `verdict` : str, the beginning and the end of the first paragraph
        - `is_good` : bool, whether the verdict is a success
        - `column_titles` : sequence of str
        - `rows` : sequence of rows, with a sequence of `Cell` objects for each column
        - `pairs` : sequence of results of `prepare_pair`
        - `legend` : str
        - `source` : str, the origin of the pictures, optional
        - `faults` : sequence of paragraphs on failed comparisons, optional
        - `charts` : sequence of (title, SVG bytes) tuples, optional
        - `sections` : sequence of (heading, paragraphs) tuples, shown below the table, optional
        - `is_class` : bool, optional: cells of the table wrap, and pairs with a good verdict are
          hidden at first

    Raises
    ------
    UndefinedError
        If a required value is missing.
    """
    id_by_png: dict[bytes, str] = {}

    def format_image_attributes(png: bytes) -> Markup:
        """Format the id and data of an image or, if it was used before, a reference to its id."""
        if png in id_by_png:
            return Markup('data-same="{}"').format(id_by_png[png])
        id_by_png[png] = f"picture-{len(id_by_png)}"
        return Markup('id="{}" src="{}"').format(id_by_png[png], _to_data_url(png))

    environment = Environment(autoescape=True, trim_blocks=True, undefined=StrictUndefined)
    environment.filters |= {"source": format_image_attributes, "png": _to_data_url}
    environment.filters["svg"] = lambda svg: _to_data_url(svg, "svg+xml")
    template = environment.from_string(TEMPLATE.read_text(encoding="utf-8"))
    return template.render(_DEFAULT_CONTENT | content)


def write_page(path: Path, html: str, remedy: str = OUTPUT_REMEDY, exit_status: int = 1) -> None:
    """Write an HTML page to a file, creating the file's folder if necessary.

    An existing file is replaced only if it is HTML.  Characters that UTF-8 cannot encode, such as
    those in some file names, are escaped.

    Parameters
    ----------
    html
        The page, which begins with ``<!doctype html>``.
    remedy
        Advice to the user, for the failure message.
    exit_status
        The command's exit status if the file cannot be written.

    Raises
    ------
    Failure
        If the file cannot be written.
    """
    with errors_as_failure(path, "written", remedy, exit_status=exit_status):
        path.parent.mkdir(parents=True, exist_ok=True)
        with open_atomically(path, b"<!doctype html>") as file:
            file.write(html.encode(errors="backslashreplace"))


def encode_png(codes: Shaped[Codes, "h w 3"], *, as_thumbnail: bool = False) -> bytes:
    """Encode a picture, or a thumbnail of it, as the content of a PNG file."""
    buffer = io.BytesIO()
    image = Image.fromarray(np.ascontiguousarray(codes))
    if as_thumbnail:
        image.thumbnail((_MAX_THUMBNAIL_SIDE, _MAX_THUMBNAIL_SIDE))
    image.save(buffer, format="PNG")
    return buffer.getvalue()


def _to_data_url(content: bytes, subtype: str = "png") -> str:
    """Encode the content of a picture file of MIME type image/SUBTYPE as a data URL."""
    return f"data:image/{subtype};base64,{base64.b64encode(content).decode()}"
