"""Read pictures of any format, as codes."""

from __future__ import annotations

import io
import re
import stat
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray
from PIL import Image, JpegImagePlugin, UnidentifiedImageError

Codes: TypeAlias = NDArray[np.uint8]

# Formats whose bits a channel are known before they are decoded.
_FORMATS = ("BMP", "GIF", "JPEG", "PNG", "PPM", "TGA", "TIFF", "WEBP")
UNREADABLE = (MemoryError, OSError, SyntaxError, ValueError, Image.DecompressionBombError)
"""What reading may raise; Pillow's errors in a PNG are SyntaxErrors."""


def reason(fault: BaseException, remedy: str) -> str:
    """Why something is unreadable; `remedy` is what to do where memory is short."""
    if isinstance(fault, MemoryError):
        return f"not enough memory; {remedy}"
    if isinstance(fault, UnidentifiedImageError):
        return "not a picture in a format that is known"
    return getattr(fault, "strerror", None) or str(fault)


class Picture(NamedTuple):
    """A picture's codes (h, w, 3), a note on what its format did to them, and what it does.

    `lossy`: codes that are saved in this format differ from themselves by so many levels, or, where
    `saved` does to others what it did to these, from those.
    """

    codes: Codes
    note: str = ""
    lossy: int = 0
    saved: Callable[[Codes], Codes] | None = None


def read_picture(path: Path) -> Picture:
    """Read a picture; what is transparent is black.

    Raises one of `UNREADABLE` if it cannot be read, or has more than 8 bits a channel.
    """
    if not stat.S_ISREG(path.stat().st_mode):  # a pipe or a device may block
        raise ValueError("not a regular file")
    with Image.open(path, formats=_FORMATS) as image:
        if image.mode.startswith("I"):  # grey of 16 bits
            grey = np.round(np.clip(np.asarray(image), 0, 65535) / 257).astype(np.uint8)
            return Picture(np.repeat(grey[:, :, None], 3, axis=2))
        if image.mode not in ("1", "L", "LA", "P", "PA", "RGB", "RGBA"):
            raise ValueError(f"has pixels of mode {image.mode}; 8-bit RGB is needed")
        # Pillow would drop low bits without a word: how it decodes shows it.
        for codec, _, _, coding in image.tile:
            largest = coding[1] if codec.startswith("ppm") and isinstance(coding, tuple) else 0
            if largest > 255 or re.search(r";16[BLN]", str(coding)):
                raise ValueError("has more than 8 bits a channel; 8-bit RGB is needed")
        rgba = image.convert("RGBA")
        note, lossy, saved = "", 0, None
        # A WEBP holds a chunk VP8L if it is lossless.
        if image.format == "WEBP" and b"VP8L" not in path.read_bytes()[:64]:
            note, lossy = "is a WEBP, which changes levels: save it as PNG.", 12
        elif image.format == "JPEG":
            note, lossy, saved = "is a JPEG, which changes levels: save it as PNG.", 3, _jpeg(image)
        elif image.mode in ("P", "PA"):
            note, lossy = "has a palette, of 256 colours at most: save it as RGB.", 12
        elif rgba.getchannel("A").getextrema() != (255, 255):
            note = "is transparent in places, which counts as black: save it as RGB."
    black = Image.new("RGBA", rgba.size, (0, 0, 0, 255))
    return Picture(
        np.asarray(Image.alpha_composite(black, rgba).convert("RGB")), note, lossy, saved
    )


def _jpeg(image: Image.Image) -> Callable[[Codes], Codes]:
    """Return what saves codes with the same tables as a JPEG, and reads them."""
    options = {
        "qtables": image.quantization,  # type: ignore[attr-defined]
        "subsampling": JpegImagePlugin.get_sampling(image),
    }

    def saved(codes: Codes) -> Codes:
        data = io.BytesIO()
        Image.fromarray(codes).save(data, "JPEG", **options)
        return np.asarray(Image.open(data))

    return saved
