"""From radiance to the codes of an 8-bit picture, and to a PNG file.

The picture is written band by band, in the order it is rendered, so that no
more of it than a band need ever be in memory.  It appears under its name only
when it is whole: whatever goes wrong before leaves what was there untouched.
"""

from __future__ import annotations

import math
import os
import struct
import zlib
from collections.abc import Iterable
from functools import cache
from typing import IO, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tracer.arrays import Floats
from tracer.commands import atomic_file

__all__ = ["PNG", "Packed", "packed", "to_codes", "write_bands", "write_png"]

PNG = b"\x89PNG\r\n\x1a\n"
"""How a PNG file begins (ISO/IEC 15948, 5.2)."""

# Values worked on at a time: what stays in a core's cache.
_BLOCK = 1 << 15

# The largest prime below 2^16.
_ADLER = 65521


def write_png(path: str | os.PathLike[str], image: ArrayLike) -> None:
    """Write a picture as an 8-bit RGB PNG file.

    Parameters
    ----------
    path : str or path-like
        A PNG file that is there already is replaced, once the new one is whole.
    image : (height, width, 3) array_like
        Linear RGB, as `render` returns it; the codes are round(255 clip(x, 0, 1)^(1/2.2)).

    Raises
    ------
    TypeError
        For an image of type uint8, which holds codes, not radiance.
    ValueError
        For another shape, a picture of no pixels, or a NaN.
    OSError
        If the file cannot be written, or a file that is there is not a PNG.
    """
    radiance = _checked(image)
    height, width, _ = radiance.shape
    rows = max(1, _BLOCK // (3 * max(1, width)))
    bands = (packed(radiance[row : row + rows]) for row in range(0, height, rows))
    write_bands(path, width, height, bands)


class Packed(NamedTuple):
    """Some rows of a picture, compressed: a part of a PNG file's pixels.

    Attributes
    ----------
    rows, width : int
    data : bytes
        Deflate blocks (RFC 1951) that end on a byte, none of them the last.
    check : int
        Adler-32 (RFC 1950) of the data before compression.
    """

    rows: int
    width: int
    data: bytes
    check: int


def packed(band: Floats) -> Packed:
    """Quantise and compress some rows (rows, width, 3), linear RGB.

    Raises
    ------
    TypeError, ValueError
        See `to_codes`.
    """
    codes = to_codes(band)
    rows, width, _ = codes.shape
    # Every row starts with the number of its filter, 0 for none: rendered pictures are full of
    # exact repeats, which filters disturb.
    lines = np.zeros((rows, 1 + 3 * width), dtype=np.uint8)
    lines[:, 1:] = codes.reshape(rows, 3 * width)
    # Level 3 takes no longer than 1.
    stream = zlib.compressobj(3, wbits=-zlib.MAX_WBITS)
    data = stream.compress(lines.data) + stream.flush(zlib.Z_FULL_FLUSH)
    return Packed(rows, width, data, zlib.adler32(lines.data))


def write_bands(
    path: str | os.PathLike[str], width: int, height: int, bands: Iterable[Packed]
) -> None:
    """Write a picture that comes in bands of rows, from the top, as `write_png` does.

    Parameters
    ----------
    path : str or path-like
    width, height : int
        Size of the picture in pixels.
    bands : iterable of Packed

    Raises
    ------
    ValueError
        For a picture of no pixels, or bands that do not make it up.
    OSError
        If the file cannot be written, or what is there is no PNG file.
    """
    if width < 1 or height < 1:
        raise ValueError(f"a picture has at least one pixel, not {width} x {height}")
    with atomic_file(path, PNG) as file:
        file.write(PNG)
        # 8 bits a channel, RGB, the only compression and filter methods there are, not interlaced.
        _write_chunk(file, b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0))
        # A zlib stream (RFC 1950): window of 32 KB, fast; its blocks; an empty last one; a check.
        start, check, written = b"\x78\x5e", 1, 0
        for band in bands:
            written += band.rows
            if band.width != width or written > height:
                size = f"{band.rows} rows of {band.width} pixels"
                raise ValueError(f"a band of {size} does not fit {width} x {height}")
            _write_chunk(file, b"IDAT", start + band.data)
            start, check = b"", _adler_of_both(check, band.check, band.rows * (1 + 3 * width))
        if written < height:
            raise ValueError(f"the bands have {written} rows, not {height}")
        _write_chunk(file, b"IDAT", b"\x03\x00" + struct.pack(">I", check))
        _write_chunk(file, b"IEND", b"")


def _adler_of_both(first: int, second: int, size: int) -> int:
    """Adler-32 of two pieces of data end to end, from that of each; `size`: of the second."""
    a, b = first & 0xFFFF, first >> 16
    total = (a + (second & 0xFFFF) - 1) % _ADLER
    return ((b + (second >> 16) + size * (a - 1)) % _ADLER) << 16 | total


def _write_chunk(file: IO[bytes], kind: bytes, data: bytes) -> None:
    """Write a chunk of a PNG file (ISO/IEC 15948, 5.3)."""
    file.write(struct.pack(">I", len(data)))
    file.write(kind)
    file.write(data)
    file.write(struct.pack(">I", zlib.crc32(data, zlib.crc32(kind))))


def to_codes(image: ArrayLike) -> NDArray[np.uint8]:
    """The 8-bit codes of radiances: round(255 clip(x, 0, 1)^(1/2.2)).

    The codes are those of exact arithmetic.  The power function in float64 is
    some ulps off, and on most machines slower than the table used here.

    Parameters
    ----------
    image : (height, width, 3) array_like
        Linear RGB.

    Returns
    -------
    (height, width, 3) uint8

    Raises
    ------
    TypeError
        For an image of type uint8, which holds codes, not radiance.
    ValueError
        For another shape, or a NaN.
    """
    radiance = _checked(image)
    codes = np.empty(radiance.shape, dtype=np.uint8)
    flat, flat_codes = radiance.reshape(-1), codes.reshape(-1)
    for start in range(0, flat.size, _BLOCK):
        block = slice(start, start + _BLOCK)
        bits = _bits(np.clip(flat[block], _LEAST, 1.0))
        bits += _shifts().take(bits >> _CELL_BITS)
        flat_codes[block] = bits >> _CELL_BITS
    return codes


def _checked(image: ArrayLike) -> Floats:
    given = np.asarray(image)
    if given.dtype == np.uint8:
        raise TypeError("an image is linear radiance, from 0 to 1, not codes of type uint8")
    radiance = np.ascontiguousarray(given, dtype=np.float64)
    if radiance.ndim != 3 or radiance.shape[2] != 3:
        raise ValueError(f"an image has shape (height, width, 3), not {radiance.shape}")
    if np.isnan(radiance).any():
        raise ValueError("an image must not hold NaN")
    return radiance


# The cells of a table over [_LEAST, 1]: 2^7 between any two powers of two, and so at most
# one threshold in each.  The cell of a float64 is its leading bits, taken as an integer.
_LEAST = 2.0**-20
_LEAST_BITS = int(np.float64(_LEAST).view(np.int64))
_CELL_BITS = 52 - 7


@cache
def _shifts() -> NDArray[np.int64]:
    """For each cell, what to add to the bits of x so that the leading bits are its code."""
    thresholds = _bits(np.array([_threshold(code) for code in range(1, 256)]))
    # NumPy's own integers have 32 bits on some systems.
    cells = int(_bits(np.ones(1))[0] >> _CELL_BITS) + 1
    start = np.arange(cells, dtype=np.int64) << _CELL_BITS
    code = np.searchsorted(thresholds, start, side="right").astype(np.int64)
    shifts = (code << _CELL_BITS) - start
    inside = thresholds >> _CELL_BITS
    shifts[inside] = (np.arange(1, 256, dtype=np.int64) << _CELL_BITS) - thresholds
    return shifts


def _bits(x: Floats) -> NDArray[np.int64]:
    """The bits of each x as an integer, less those of `_LEAST`: increasing with x."""
    return x.view(np.int64) - _LEAST_BITS


def _threshold(code: int) -> float:
    """The least float64 whose code is `code` or more."""
    root = (code - 0.5) / 255
    x: float = root**2 * root**0.2  # closer than root**2.2: 0.2 has the smaller rounding error
    while not _reaches(x, code):
        x = math.nextafter(x, 1)
    while _reaches(below := math.nextafter(x, 0), code):
        x = below
    return x


def _reaches(x: float, code: int) -> bool:
    """Whether 255 x^(1/2.2) >= code - 1/2, decided in whole numbers.

    1/2.2 is 5/11, so both sides may be raised to the 11th power; from 2^-20
    on, every float64 is a multiple of 2^-72.
    """
    return int(x * 2.0**72) ** 5 * 510**11 >= (2 * code - 1) ** 11 << 5 * 72
