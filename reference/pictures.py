"""Read pictures of any format, as codes."""

from __future__ import annotations

import io
import re
import stat
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageFile, JpegImagePlugin, UnidentifiedImageError

Codes: TypeAlias = NDArray[np.uint8]

# Formats whose numbers of bits per channel are known before they are decoded.
_FORMATS = ("BMP", "GIF", "JPEG", "PNG", "PPM", "TGA", "TIFF", "WEBP")
# Maximum number of pixels.  Reading takes about 20 bytes per pixel, comparing about 60.
_MAX_PIXELS = 9_000_000
UNREADABLE = (MemoryError, OSError, SyntaxError, ValueError, Image.DecompressionBombError)
"""Exceptions that reading may raise; Pillow's errors in a PNG are SyntaxErrors."""


class Picture(NamedTuple):
    """A picture that was read.

    Attributes
    ----------
    codes : (h, w, 3) uint8 array
    note : str
        A predicate about the format if it has changed the codes: "is a JPEG, which changes levels".
    lossy : int
        Number of levels by which this format changes codes.
    saved : callable, optional
        Changes codes (h, w, 3) as the format has changed those of this picture.
    """

    codes: Codes
    note: str = ""
    lossy: int = 0
    saved: Callable[[Codes], Codes] | None = None


def read_picture(path: Path) -> Picture:
    """Read a picture; transparent pixels become black.

    Raises
    ------
    one of `UNREADABLE`
        If the picture cannot be read, or has more than 9 million pixels.
    """
    if not stat.S_ISREG(path.stat().st_mode):  # a pipe or a device may block
        raise ValueError("not a regular file")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", Image.DecompressionBombWarning)
            image = Image.open(path, formats=_FORMATS)
    except UnidentifiedImageError:
        raise ValueError("not a picture in a format that is known") from None
    with image:
        width, height = image.size  # known before the picture is decoded
        if width * height > _MAX_PIXELS:
            limit = f"{_MAX_PIXELS // 1_000_000} million"
            raise ValueError(f"has {width}x{height} pixels; at most {limit} can be compared")
        return _decode(image, path)


def _decode(image: ImageFile.ImageFile, path: Path) -> Picture:
    """Decode an image that was opened from `path`."""
    if image.mode.startswith("I"):  # grey of 16 bits
        grey = np.round(np.clip(np.asarray(image), 0, 65535) / 257).astype(np.uint8)
        return Picture(np.repeat(grey[:, :, None], 3, axis=2))
    if image.mode not in ("1", "L", "LA", "P", "PA", "RGB", "RGBA"):
        raise ValueError(f"has pixels of mode {image.mode}; 8-bit RGB is needed")
    # Pillow drops the low bits without a warning; how it decodes shows this.
    is_deep = False
    for codec, _, _, coding in image.tile:
        largest = coding[1] if codec.startswith("ppm") and isinstance(coding, tuple) else 0
        is_deep |= largest > 255 or bool(re.search(r";16[BLN]", str(coding)))
    rgba = image.convert("RGBA")
    note, lossy, saved = "", 0, None
    # A WEBP contains a chunk VP8L if it is lossless.
    if image.format == "WEBP" and b"VP8L" not in path.read_bytes()[:64]:
        note, lossy = "is a WEBP, which changes levels: save it as PNG.", 12
    elif image.format == "JPEG":
        note, lossy, saved = "is a JPEG, which changes levels: save it as PNG.", 3, _jpeg(image)
    elif image.mode in ("P", "PA"):
        note, lossy = "has a palette, of 256 colours at most: save it as RGB.", 12
    elif is_deep:
        note, lossy = "has more than 8 bits per channel, of which 8 count: save it as 8-bit RGB.", 1
    elif rgba.getchannel("A").getextrema() != (255, 255):
        note = "is transparent in places, which counts as black: save it as RGB."
    black = Image.new("RGBA", rgba.size, (0, 0, 0, 255))
    codes = np.asarray(Image.alpha_composite(black, rgba).convert("RGB"))
    return Picture(codes, note, lossy, saved)


def _jpeg(image: Image.Image) -> Callable[[Codes], Codes]:
    """Return a function that saves codes with the tables of a JPEG, and reads them again."""
    options = {
        "qtables": image.quantization,  # type: ignore[attr-defined]
        "subsampling": JpegImagePlugin.get_sampling(image),
    }

    def saved(codes: Codes) -> Codes:
        data = io.BytesIO()
        Image.fromarray(codes).save(data, "JPEG", **options)
        return np.asarray(Image.open(data))

    return saved
