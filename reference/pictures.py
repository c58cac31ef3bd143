"""Read picture files of common formats as arrays of 8-bit codes."""

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

# Formats of which Pillow states the number of bits per channel before it decodes a picture.
_FORMATS = ("BMP", "GIF", "JPEG", "PNG", "PPM", "TGA", "TIFF", "WEBP")
# Maximum number of pixels.  Reading takes about 20 bytes per pixel, comparing about 60.
_MAX_PIXELS = 9_000_000
UNREADABLE = (MemoryError, OSError, SyntaxError, ValueError, Image.DecompressionBombError)
"""Exceptions of `read_picture`; Pillow raises a SyntaxError for a damaged PNG."""


class Picture(NamedTuple):
    """The contents of a picture file.

    Attributes
    ----------
    codes : (h, w, 3) uint8 array
        Red, green and blue of each pixel, as encoded with gamma.
    note : str
        What the file format has changed, as a predicate: "is a JPEG, which changes levels: …".
        Empty if it has changed nothing.
    lossy_levels : int
        Number of levels by which the file format may have changed codes.
    save : callable, optional
        Returns the codes (h, w, 3) that other codes would have after they are saved in this file's
        format and read again.
    """

    codes: Codes
    note: str = ""
    lossy_levels: int = 0
    save: Callable[[Codes], Codes] | None = None


def read_picture(path: Path) -> Picture:
    """Read a picture file, with transparent pixels over black.

    Raises
    ------
    MemoryError, OSError, SyntaxError, ValueError, Image.DecompressionBombError
        If the file is not a regular file (a pipe may block for ever), is not a picture in a known
        format, or is damaged; or if the picture has more than 9 million pixels, or pixels other
        than RGB, palette or grey.  `UNREADABLE` contains these exceptions.
    """
    if not stat.S_ISREG(path.stat().st_mode):
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
    """Decode an opened picture file, and determine what its format has changed.

    Parameters
    ----------
    image : ImageFile
        The picture, opened but not yet decoded.
    path : Path
        Its file.

    Raises
    ------
    OSError, SyntaxError, ValueError
        If the file is damaged, or if the pixels are not RGB, palette or grey.
    """
    if image.mode.startswith("I"):  # grey of 16 bits
        grey = np.round(np.clip(np.asarray(image), 0, 65535) / 257).astype(np.uint8)
        return Picture(np.repeat(grey[:, :, None], 3, axis=2))
    if image.mode not in ("1", "L", "LA", "P", "PA", "RGB", "RGBA"):
        raise ValueError(f"has pixels of mode {image.mode}; 8-bit RGB is needed")
    is_deep = _has_more_than_8_bits(image)  # decoding removes what this test needs
    rgba = image.convert("RGBA")
    note, lossy_levels, save = "", 0, None
    # A WEBP contains a chunk VP8L if it is lossless.
    if image.format == "WEBP" and b"VP8L" not in path.read_bytes()[:64]:
        note, lossy_levels = "is a WEBP, which changes levels: save it as PNG.", 12
    elif image.format == "JPEG":
        note, lossy_levels = "is a JPEG, which changes levels: save it as PNG.", 3
        save = _jpeg_round_trip(image)
    elif image.mode in ("P", "PA"):
        note, lossy_levels = "has a palette, of 256 colours at most: save it as RGB.", 12
    elif is_deep:
        note = "has more than 8 bits per channel, of which 8 count: save it as 8-bit RGB."
        lossy_levels = 1
    elif rgba.getchannel("A").getextrema() != (255, 255):
        note = "is transparent in places, which counts as black: save it as RGB."
    black = Image.new("RGBA", rgba.size, (0, 0, 0, 255))
    codes = np.asarray(Image.alpha_composite(black, rgba).convert("RGB"))
    return Picture(codes, note, lossy_levels, save)


def _has_more_than_8_bits(image: ImageFile.ImageFile) -> bool:
    """Test whether an opened, not yet decoded picture has more than 8 bits per channel.

    Pillow drops the lower bits without a warning, but names the encoding of the pixels in the
    arguments of the decoder: a mode such as "RGB;16B", or the largest level of a PPM file.
    """
    for codec, _, _, arguments in image.tile:
        is_ppm = codec.startswith("ppm")
        largest_level = arguments[1] if is_ppm and isinstance(arguments, tuple) else 0
        if largest_level > 255 or re.search(r";16[BLN]", str(arguments)):
            return True
    return False


def _jpeg_round_trip(image: Image.Image) -> Callable[[Codes], Codes]:
    """Return a function that saves codes as a given JPEG was saved, and reads them again.

    Parameters
    ----------
    image : Image
        An opened JPEG, whose quantisation tables and chroma subsampling are used.

    Returns
    -------
    round_trip : callable
        Takes and returns codes (h, w, 3).
    """
    options = {
        "qtables": image.quantization,  # type: ignore[attr-defined]
        "subsampling": JpegImagePlugin.get_sampling(image),
    }

    def round_trip(codes: Codes) -> Codes:
        data = io.BytesIO()
        Image.fromarray(codes).save(data, "JPEG", **options)
        return np.asarray(Image.open(data))

    return round_trip
