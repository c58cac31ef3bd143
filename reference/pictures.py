"""Read picture files of common formats as arrays of 8-bit codes."""

from __future__ import annotations

import io
import re
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Annotated as Shaped
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageFile, JpegImagePlugin, UnidentifiedImageError

from reference.command import FAILED_STATUS
from tracer.command.failure import errors_as_failure

Codes: TypeAlias = NDArray[np.uint8]

# Formats for which Pillow states the bits per channel before it decodes a picture.
_FORMATS = ("BMP", "GIF", "JPEG", "PNG", "PPM", "TGA", "TIFF", "WEBP")
# Maximum number of pixels.  Reading takes about 20 bytes per pixel, comparing about 60.
_MAX_PIXELS = 9_000_000
# Pictures are compressed in bands of rows, of at most about this number of pixels each.
_PIXELS_PER_BAND = 500_000
Image.MAX_IMAGE_PIXELS = None  # Pillow's own limit is higher, and prints a warning

JPEG_BLOCK = 16
"""Maximum side in pixels of a JPEG block, the part of a picture that is compressed separately.

Blocks are counted from the upper left corner of the picture.  With chroma subsampling, the
outermost pixels of a block depend on the neighbouring blocks, too.
"""

_FORMAT_NOTE = "is a {}, which changes levels: save it as PNG."
_PALETTE_NOTE = "has a palette, of 256 colours at most: save it as RGB."
_DEPTH_NOTE = "has more than 8 bits per channel, of which 8 count: save it as 8-bit RGB."
_ALPHA_NOTE = "is transparent in places, which counts as black: save it as RGB."

# Numbers of levels by which formats alter most codes.  Pillow's WEBP of quality 90 and its palettes
# altered the worst 1 % of the pixels of room and four-spheres by more than 13 to 18 levels.
_WEBP_NOISE = 12
_PALETTE_NOISE = 12
_JPEG_NOISE = 3  # where `Picture.reencode` differs; it reproduced Pillow's JPEG exactly
_DEPTH_NOISE = 1  # 16 bits may be rounded or cut off


class Picture(NamedTuple):
    """The contents of a picture file."""

    codes: Shaped[Codes, "h w 3"]  # red, green and blue, as encoded with gamma
    # How the file format altered the picture, such as "is a JPEG, which changes levels: …", without
    # a subject.  The note is empty if the format altered nothing.
    note: str = ""
    format_noise: int = 0  # number of levels by which the file format may have altered the codes
    # Takes the codes of a picture (h, w, 3), and returns those that are read back after it is
    # saved in the format of the file.  None if the format alters nothing, or unpredictably.
    reencode: Callable[[Codes], Codes] | None = None


def read_picture(path: Path) -> Picture:
    """Read a BMP, GIF, JPEG, PNG, PPM, TGA, TIFF or WEBP file; blend transparent pixels with black.

    Raise Failure if the file is missing, empty, damaged, or not a picture in a known format; if the
    picture has more than `_MAX_PIXELS` pixels, or colours that are not RGB, palette or grey; or if
    memory runs out.
    """
    # Pillow raises a SyntaxError for a damaged PNG.
    error_types = SyntaxError, ValueError
    with errors_as_failure(path, "read", exit_status=FAILED_STATUS, error_types=error_types):
        if path.exists() and not path.is_file():  # opening a pipe may block for ever
            raise ValueError("not a regular file")
        if path.exists() and not path.stat().st_size:
            raise ValueError("the file is empty")
        try:
            image = Image.open(path, formats=_FORMATS)
        except UnidentifiedImageError:
            raise ValueError("not a picture in a known format") from None
        with image:
            width, height = image.size  # available before the picture is decoded
            if width * height > _MAX_PIXELS:
                maximum = f"{_MAX_PIXELS // 1_000_000} million"
                raise ValueError(f"has {width}x{height} pixels; at most {maximum} can be compared")
            return _decode_picture(image, path)


def _decode_picture(image: ImageFile.ImageFile, path: Path) -> Picture:
    """Decode an image that was opened from a path, and determine how its format altered it.

    Raise OSError, SyntaxError or ValueError if the file is damaged, and ValueError if the pixels
    are not RGB, palette or grey.
    """
    if image.mode.startswith("I"):  # 16-bit grey
        grey_codes = np.round(np.clip(np.asarray(image), 0, 65535) / 257).astype(np.uint8)
        return Picture(np.repeat(grey_codes[:, :, None], 3, axis=2))
    if image.mode not in ("1", "L", "LA", "P", "PA", "RGB", "RGBA"):
        raise ValueError(f"has pixels of mode {image.mode}; 8-bit RGB is needed")
    has_extra_bits = _has_more_than_8_bits(image)  # must precede decoding, which discards the depth
    rgba_image = image.convert("RGBA")
    black_image = Image.new("RGBA", rgba_image.size, (0, 0, 0, 255))
    codes = np.asarray(Image.alpha_composite(black_image, rgba_image).convert("RGB"))
    if image.format == "JPEG":
        note, reencode = _FORMAT_NOTE.format("JPEG"), _make_jpeg_encoder(image)
        return Picture(codes, note, format_noise=_JPEG_NOISE, reencode=reencode)
    # A lossless WEBP contains a chunk named VP8L.
    if image.format == "WEBP" and b"VP8L" not in path.read_bytes()[:64]:
        return Picture(codes, _FORMAT_NOTE.format("WEBP"), format_noise=_WEBP_NOISE)
    if image.mode in ("P", "PA"):
        return Picture(codes, _PALETTE_NOTE, format_noise=_PALETTE_NOISE)
    if has_extra_bits:
        return Picture(codes, _DEPTH_NOTE, format_noise=_DEPTH_NOISE)
    is_opaque = rgba_image.getchannel("A").getextrema() == (255, 255)
    return Picture(codes, "" if is_opaque else _ALPHA_NOTE)


def _has_more_than_8_bits(image: ImageFile.ImageFile) -> bool:
    """Test whether a picture file has more than the 8 bits per channel that Pillow keeps."""
    # The arguments of Pillow's decoder state a mode such as "RGB;16B", or a PPM's largest level.
    for codec, _, _, arguments in image.tile:
        is_ppm = codec.startswith("ppm")
        largest_level = arguments[1] if is_ppm and isinstance(arguments, tuple) else 0
        if largest_level > 255 or re.search(r";16[BLN]", str(arguments)):
            return True
    return False


def _make_jpeg_encoder(image: Image.Image) -> Callable[[Codes], Codes]:
    """Make a function that returns the codes of a picture after saving it like a given JPEG.

    It uses the quantisation tables and the chroma subsampling of `image`.
    """
    quantization_tables = image.quantization  # type: ignore[attr-defined]
    subsampling = JpegImagePlugin.get_sampling(image)
    return partial(_reencode_as_jpeg, qtables=quantization_tables, subsampling=subsampling)


def _reencode_as_jpeg(codes: Shaped[Codes, "h w 3"], **jpeg_options: Any) -> Shaped[Codes, "h w 3"]:
    """Save a picture as a JPEG file in memory, and return the codes that are read back.

    The picture is saved in bands of rows, with the given options of Pillow.
    """
    reloaded_codes = np.empty_like(codes)
    band_height = JPEG_BLOCK * max(1, _PIXELS_PER_BAND // (JPEG_BLOCK * codes.shape[1]))
    for start in range(0, len(codes), band_height):
        # The neighbouring blocks are compressed, too, because they affect the outermost rows.
        padded_start = max(0, start - JPEG_BLOCK)
        padded_end = start + band_height + JPEG_BLOCK
        jpeg_file = io.BytesIO()
        Image.fromarray(codes[padded_start:padded_end]).save(jpeg_file, "JPEG", **jpeg_options)
        padded_codes = np.asarray(Image.open(jpeg_file))
        rows = slice(start - padded_start, start - padded_start + band_height)
        reloaded_codes[start : start + band_height] = padded_codes[rows]
    return reloaded_codes


def to_columns(codes: Shaped[Codes, "h w 3"]) -> Shaped[Codes, "3 h*w"]:
    """Convert the codes of a picture to an array with one column per pixel, row by row."""
    return np.ascontiguousarray(codes.reshape(-1, 3).T)


def to_rows(columns: Shaped[Codes, "3 n"], width: int) -> Shaped[Codes, "h width 3"]:
    """Convert the result of `to_columns` to the codes of a picture of the given width."""
    return np.ascontiguousarray(columns.T.reshape(-1, width, 3))


def compare_levels(
    first_codes: Shaped[Codes, "..."], second_codes: Shaped[Codes, "..."], axis: int = -2
) -> Shaped[Codes, "..."]:
    """Compute, for each pixel of two pictures, the largest difference of any channel.

    The channels are along `axis`: -2 in arrays (..., 3, n), and 2 in arrays (h, w, 3).
    """
    # The codes are unsigned, so subtracting the larger from the smaller would wrap around.
    low, high = np.minimum(first_codes, second_codes), np.maximum(first_codes, second_codes)
    return np.asarray(np.subtract(high, low, out=high).max(axis))
