"""From radiance to 8-bit codes, and to a PNG file (ISO/IEC 15948).

A picture is written tile by tile, in the order of its pixels: only a tile need be in memory.
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
from tracer.files import atomic_file

PNG = b"\x89PNG\r\n\x1a\n"
"""The first bytes of a PNG file (5.2)."""

# Values worked on at a time: they stay in a core's cache.
_VALUES_AT_ONCE = 1 << 15

# The largest prime below 2^16.
_ADLER = 65521


def write_png(file: str | os.PathLike[str] | IO[bytes], image: ArrayLike) -> None:
    """Write a picture as an 8-bit RGB PNG file; its codes are those of `to_codes`.

    Parameters
    ----------
    file : str, path-like or binary file
        A PNG file of this name is replaced, once the new one is whole.
    image : (height, width, 3) array_like
        Linear RGB, as `render` returns it.

    Raises
    ------
    TypeError, ValueError
        See `to_codes`; also for a picture of no pixels, and a name that ends as other files do.
    OSError
        If the file cannot be written, or a file that is there is not a PNG.
    """
    radiance = _checked(image)
    height, width, _ = radiance.shape
    rows = max(1, _VALUES_AT_ONCE // (3 * max(1, width)))
    tiles = (compressed(radiance[row : row + rows]) for row in range(0, height, rows))
    if isinstance(file, (str, os.PathLike)):
        stem, suffix = os.path.splitext(os.fspath(file))
        if suffix.lower() not in ("", ".png"):
            raise ValueError(f"{os.fspath(file)}: pictures are PNG files; name it {stem}.png")
        with atomic_file(file, PNG) as stream:
            write_tiles(stream, width, height, tiles)
    else:
        write_tiles(file, width, height, tiles)


class Compressed(NamedTuple):
    """Some of a picture's pixels, compressed.

    Attributes
    ----------
    data : bytes
        Deflate blocks (RFC 1951) that end on a byte, none of them the last.
    size, check : int
        Number of bytes before compression, and their Adler-32 (RFC 1950).
    """

    data: bytes
    size: int
    check: int


def compressed(radiance: Floats, *, from_left: bool = True) -> Compressed:
    """Encode and compress whole rows (rows, width, 3), or a part of one.

    `from_left` is whether it begins at the picture's left side: there a row has the number of its
    filter, 0 for none.  Rendered pictures are full of exact repeats, which filters disturb.
    """
    codes = to_codes(radiance)
    lines = codes.reshape(len(codes), -1)
    if from_left:
        lines = np.pad(lines, ((0, 0), (1, 0)))
    # Level 3 takes no longer than 1.
    stream = zlib.compressobj(3, wbits=-zlib.MAX_WBITS)
    data = stream.compress(lines.data) + stream.flush(zlib.Z_FULL_FLUSH)
    return Compressed(data, lines.size, zlib.adler32(lines.data))


def write_tiles(file: IO[bytes], width: int, height: int, tiles: Iterable[Compressed]) -> None:
    """Write a PNG file of all its pixels, compressed, in order.

    Raises
    ------
    ValueError
        For a picture of no pixels, or tiles of more or fewer.
    """
    if width < 1 or height < 1:
        raise ValueError(f"a picture has at least one pixel, not {width} x {height}")

    def write_chunk(kind: bytes, data: bytes) -> None:  # (5.3)
        file.write(struct.pack(">I", len(data)) + kind)
        file.write(data)
        file.write(struct.pack(">I", zlib.crc32(data, zlib.crc32(kind))))

    file.write(PNG)
    # 8 bits a channel, RGB, the only compression and filter methods there are, not interlaced.
    write_chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0))
    # A zlib stream (RFC 1950): window of 32 KB, fast; its blocks; an empty last one; a check.
    start, check, left = b"\x78\x5e", 1, height * (1 + 3 * width)
    for tile in tiles:
        write_chunk(b"IDAT", start + tile.data)
        start, check = b"", _adler_of_both(check, tile.check, tile.size)
        left -= tile.size
    if left:
        raise ValueError(f"tiles do not make up a picture of {width} x {height} pixels")
    write_chunk(b"IDAT", b"\x03\x00" + struct.pack(">I", check))
    write_chunk(b"IEND", b"")


def _adler_of_both(first: int, second: int, size: int) -> int:
    """Adler-32 of two pieces of data end to end, from that of each; `size`: of the second."""
    a, b = first & 0xFFFF, first >> 16
    total = (a + (second & 0xFFFF) - 1) % _ADLER
    return ((b + (second >> 16) + size * (a - 1)) % _ADLER) << 16 | total


def to_codes(image: ArrayLike) -> NDArray[np.uint8]:
    """Encode linear RGB (height, width, 3) in 8 bits: round(255 clip(x, 0, 1)^(1/2.2)).

    The codes are those of exact arithmetic.  The power function in float64 is some ulps off, and
    takes twice as long as the tables used here.

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
    least_code, thresholds = _tables()
    for start in range(0, flat.size, _VALUES_AT_ONCE):
        block = slice(start, start + _VALUES_AT_ONCE)
        x = np.clip(flat[block], _LEAST, 1.0)
        code = least_code.take((x.view(np.int64) >> _CELL_BITS) - _FIRST_CELL)
        np.add(code, x >= thresholds.take(code), out=flat_codes[block])
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


# A search among thresholds would take three times as long.  Instead [_LEAST, 1] is cut into cells,
# 2^7 between any two powers of two, with at most one threshold in each: a cell is the leading bits
# of its float64s.
_LEAST, _CELL_BITS = 2.0**-20, 52 - 7
_FIRST_CELL, _LAST_CELL = (np.array([_LEAST, 1.0]).view(np.int64) >> _CELL_BITS).tolist()


@cache
def _tables() -> tuple[NDArray[np.uint8], Floats]:
    """The code of each cell's least float64, and the least float64 of each code but 0."""
    thresholds = np.array([_threshold(code) for code in range(1, 256)] + [np.inf])
    cells = np.arange(_FIRST_CELL, _LAST_CELL + 1, dtype=np.int64)
    least: Floats = (cells << _CELL_BITS).view(np.float64)
    return thresholds.searchsorted(least, side="right").astype(np.uint8), thresholds


def _threshold(code: int) -> float:
    """The least float64 whose code is `code` or more: 255 x^(1/2.2) >= code - 1/2.

    1/2.2 is 5/11, so both sides may be raised to the 11th power; from 2^-20 on, every float64 is a
    multiple of 2^-72.  So whole numbers decide.
    """
    root = (code - 0.5) / 255
    near: float = root**2 * root**0.2  # closer than root**2.2: 0.2 has the smaller rounding error
    reached = (2 * code - 1) ** 11 << 5 * 72
    candidates = (near + ulps * math.ulp(near) for ulps in range(-4, 5))
    return next(x for x in candidates if int(x * 2.0**72) ** 5 * 510**11 >= reached)
