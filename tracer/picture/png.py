"""Encode linear radiance as 8-bit codes, and write them to a PNG file (ISO/IEC 15948).

A picture is written tile by tile, in the order of its pixels, so only one tile needs to be in
memory.  Each tile can be compressed separately, in any process.  The checksum of all pixels is
computed from the checksums of the tiles.

Codes are rounded exactly.  The power function in float64 has an error of a few units in the
last place, so it may give a wrong code near a threshold between two codes.  A table of exact
thresholds corrects the code.
"""

from __future__ import annotations

import math
import os
import struct
import zlib
from collections.abc import Iterable
from functools import cache
from typing import IO, NamedTuple
from typing import Annotated as Shaped

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tracer.arrays import CACHE_SIZE, Floats
from tracer.files import open_atomically

PNG_MAGIC = b"\x89PNG\r\n\x1a\n"
"""The first bytes of a PNG file (5.2)."""

# The code of radiance x is round(_MAX_CODE x^(1 / gamma)).
_MAX_CODE = 255

# Numerator and denominator of gamma, 11 / 5 = 2.2: thresholds are computed exactly, with integers.
_GAMMA = 11, 5

# Smaller radiance is replaced by this value, whose code is 0, because powers of 0 take longer.
_MIN_RADIANCE = 1e-9

# Maximum error of the estimate of a threshold in units in the last place (ulps), with a margin.
_MAX_ESTIMATE_ULPS = 4

# Maximum number of values that are encoded or compressed together, so that they stay in the CPU
# cache.
_VALUES_PER_BATCH = CACHE_SIZE

# Level of compression of zlib.  Level 3 takes no longer than level 1.
_COMPRESSION_LEVEL = 3

# Header of a zlib stream with a window of 32 KB, and fast compression (RFC 1950).
_ZLIB_HEADER = b"\x78\x5e"

# An empty block that is marked as the last one of a stream (RFC 1951).
_LAST_BLOCK = b"\x03\x00"

# Adler-32 checksum of no bytes.
_EMPTY_CHECKSUM = 1

# Modulus of Adler-32 checksums: the largest prime below 2^16 (RFC 1950).
_ADLER_MODULUS = 65521


def write_png(file: str | bytes | os.PathLike[str] | IO[bytes], image: ArrayLike) -> None:
    """Write a picture as an 8-bit RGB PNG file.

    The radiance is encoded by `to_codes`: clipped to the range from 0 to 1, and gamma-corrected.

    Parameters
    ----------
    file : str, bytes, path-like or binary file
        Path of the file, or a file open for writing.  A PNG file that exists at the path is
        replaced once the new one is complete.
    image : (height, width, 3) array_like
        Linear RGB radiance, as `render` returns it.

    Raises
    ------
    TypeError
        If the image has type uint8, is complex, or is a masked array.
    ValueError
        If the image has another shape, has no pixels, or contains a NaN; or if the path has a
        suffix other than ".png".
    OSError
        If the file cannot be written, or a file that is not a PNG exists at the path.
    """
    radiance = _validate_radiance(image)
    height, width, _channels = radiance.shape
    rows_per_tile = max(1, _VALUES_PER_BATCH // (3 * max(1, width)))
    row_starts = range(0, height, rows_per_tile)
    tiles = (compress_tile(radiance[start : start + rows_per_tile]) for start in row_starts)
    if not isinstance(file, (str, bytes, os.PathLike)):
        write_tiles(file, width, height, tiles)
        return
    path = os.fsdecode(file)
    stem, suffix = os.path.splitext(path)
    if suffix.lower() not in ("", ".png"):
        raise ValueError(f"{path}: pictures are PNG files; name it {stem}.png")
    with open_atomically(path, PNG_MAGIC) as stream:
        write_tiles(stream, width, height, tiles)


class CompressedTile(NamedTuple):
    """A tile of a picture (a rectangle of pixels), compressed for a PNG file."""

    # Deflate blocks (RFC 1951).  They end at the end of a byte, and none is marked as the last
    # block of a stream, so the blocks of several tiles can be joined.
    data: bytes
    size: int  # number of bytes before compression
    checksum: int  # Adler-32 (RFC 1950) of the bytes before compression


def compress_tile(
    radiance: Shaped[Floats, "rows columns 3"], *, is_leftmost: bool = True
) -> CompressedTile:
    """Encode a tile as 8-bit codes, and compress it for `write_tiles`.

    A tile consists of whole rows of the picture in the file, or of a part of one row.  Raise
    ValueError if it contains a NaN.

    Parameters
    ----------
    is_leftmost
        Whether the tile is at the left edge of that picture.  If so, each of its rows begins with
        a zero byte, which means that the row is not filtered (PNG, 9.2).
    """
    codes = to_codes(radiance)
    rows = codes.reshape(len(codes), -1)
    if is_leftmost:
        # Filters would hide exact repetitions, which are common in pictures.
        rows = np.pad(rows, ((0, 0), (1, 0)))
    # A negative window size requests blocks without the header and the checksum of a stream.
    compressor = zlib.compressobj(_COMPRESSION_LEVEL, wbits=-zlib.MAX_WBITS)
    data = compressor.compress(rows.data) + compressor.flush(zlib.Z_FULL_FLUSH)
    return CompressedTile(data=data, size=rows.size, checksum=zlib.adler32(rows.data))


def write_tiles(file: IO[bytes], width: int, height: int, tiles: Iterable[CompressedTile]) -> None:
    """Write a PNG file, at the current position of `file`, from the tiles of a picture.

    The tiles must be ordered from top to bottom and from left to right.  Each is written before the
    next one is requested.  Raise ValueError if they contain more or fewer pixels than a picture of
    this size, or if `width` or `height` is less than 1.  Raise OSError if the file cannot be
    written.
    """
    if width < 1 or height < 1:
        raise ValueError(f"a picture has at least one pixel, not {width} x {height}")

    def write_chunk(chunk_type: bytes, data: bytes) -> None:
        """Write the length, the type, the data and the checksum of a chunk (PNG, 5.3)."""
        file.write(struct.pack(">I", len(data)) + chunk_type)
        file.write(data)
        file.write(struct.pack(">I", zlib.crc32(data, zlib.crc32(chunk_type))))

    file.write(PNG_MAGIC)
    # 8 bits per channel, RGB, the standard compression and filter methods, not interlaced.
    write_chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0))
    # The pixels are one zlib stream: its header, the blocks of the tiles, and its end.
    stream_header = _ZLIB_HEADER
    checksum = _EMPTY_CHECKSUM
    remaining_bytes = height * (1 + 3 * width)
    for tile in tiles:
        write_chunk(b"IDAT", stream_header + tile.data)
        stream_header = b""  # only the first chunk contains it
        checksum = _combine_checksums(checksum, tile.checksum, tile.size)
        remaining_bytes -= tile.size
    if remaining_bytes:
        raise ValueError(f"tiles do not make up a picture of {width} x {height} pixels")
    write_chunk(b"IDAT", _LAST_BLOCK + struct.pack(">I", checksum))
    write_chunk(b"IEND", b"")


def _combine_checksums(first_checksum: int, second_checksum: int, second_size: int) -> int:
    """Compute the Adler-32 checksum of two joined byte strings from the checksum of each.

    `second_size` is the length of the second string.

    An Adler-32 checksum has two halves of 16 bits, modulo `_ADLER_MODULUS`.  The lower half is 1
    plus the sum of the bytes.  The upper half is the sum of the lower halves after each byte.
    """
    first_upper, first_lower = divmod(first_checksum, 1 << 16)
    second_upper, second_lower = divmod(second_checksum, 1 << 16)
    lower = (first_lower + second_lower - 1) % _ADLER_MODULUS
    upper = (first_upper + second_upper + second_size * (first_lower - 1)) % _ADLER_MODULUS
    return upper << 16 | lower


def to_codes(image: ArrayLike) -> NDArray[np.uint8]:
    """Encode linear RGB radiance as 8-bit codes.

    Radiance is clipped to the range from 0 to 1.  The code of radiance x is 255 x^(1 / 2.2),
    rounded to the nearest integer.

    Parameters
    ----------
    image : (height, width, 3) array_like
        Linear RGB radiance, as `render` returns it.

    Returns
    -------
    codes : (height, width, 3) uint8 array
        The 8-bit codes, rounded exactly.

    Raises
    ------
    TypeError
        If the image has type uint8 (codes already), is complex, or is a masked array.
    ValueError
        If the image has another shape, or contains a NaN.
    """
    radiance = _validate_radiance(image)
    codes = np.empty(radiance.shape, dtype=np.uint8)
    flat_radiance = radiance.reshape(-1)
    flat_codes = codes.reshape(-1)
    next_thresholds = _compute_next_thresholds()
    gamma_numerator, gamma_denominator = _GAMMA
    exponent = gamma_denominator / gamma_numerator
    for start in range(0, flat_radiance.size, _VALUES_PER_BATCH):
        batch = slice(start, start + _VALUES_PER_BATCH)
        values = np.clip(flat_radiance[batch], _MIN_RADIANCE, 1.0)
        # Rounded down, the code is right or one too small, whatever the error of the power.
        lower_codes = (_MAX_CODE * values**exponent).astype(np.uint8)
        np.add(lower_codes, values >= next_thresholds.take(lower_codes), out=flat_codes[batch])
    return codes


def _validate_radiance(image: ArrayLike) -> Shaped[Floats, "height width 3"]:
    """Convert an image to a contiguous float64 array, which may be `image` itself.

    Raise TypeError or ValueError if it is not linear radiance, as `to_codes` says.
    """
    array = np.asarray(image)
    if array.dtype == np.uint8:
        raise TypeError("an image is linear radiance, from 0 to 1, not 8-bit codes (uint8)")
    if np.iscomplexobj(array):
        raise TypeError("an image must be real, not complex")
    if hasattr(image, "filled"):  # np.asarray ignores the mask
        raise TypeError("an image must not be a masked array; fill it: image.filled(0)")
    radiance = np.ascontiguousarray(array, dtype=np.float64)
    if radiance.ndim != 3 or radiance.shape[2] != 3:
        raise ValueError(f"an image has shape (height, width, 3), not {radiance.shape}")
    if np.isnan(radiance).any():
        raise ValueError("an image must not contain NaN")
    return radiance


@cache
def _compute_next_thresholds() -> Shaped[Floats, "256"]:
    """Compute, for each 8-bit code, the smallest float64 radiance that has a larger code.

    It is infinite for the last code.
    """
    return np.array([*map(_compute_threshold, range(1, _MAX_CODE + 1)), np.inf])


def _compute_threshold(code: int) -> float:
    """Compute the smallest float64 radiance whose 8-bit code is at least `code` (1 to 255)."""
    gamma_numerator, gamma_denominator = _GAMMA
    whole_power, remainder = divmod(gamma_numerator, gamma_denominator)
    relative_code = (code - 0.5) / _MAX_CODE
    # Splitting the exponent keeps the error small.
    root: float = relative_code ** (remainder / gamma_denominator)
    estimate = relative_code**whole_power * root

    def reaches_threshold(radiance: float) -> bool:
        """Test exactly whether the 8-bit code of a radiance is `code` or more."""
        # This is 255 radiance^(1 / gamma) >= code - 1/2, multiplied by 2, and raised to the power
        # gamma_numerator.
        numerator, denominator = radiance.as_integer_ratio()
        radiance_side = (2 * _MAX_CODE) ** gamma_numerator * numerator**gamma_denominator
        code_side = (2 * code - 1) ** gamma_numerator * denominator**gamma_denominator
        return bool(radiance_side >= code_side)

    ulp_range = range(-_MAX_ESTIMATE_ULPS, _MAX_ESTIMATE_ULPS + 1)
    candidates = (estimate + ulps * math.ulp(estimate) for ulps in ulp_range)
    return next(filter(reaches_threshold, candidates))
