"""Encode linear radiance as 8-bit codes, and write them to a PNG file (ISO/IEC 15948).

A picture is written tile by tile, in the order of its pixels, so only one tile needs to be in
memory.  Each tile is compressed separately, in any process; the file's checksum is computed from
those of the tiles.

Codes are those of exact arithmetic.  The power function in float64 has an error of some ulps, so
it may give a wrong code near a threshold between two codes; tables of exact thresholds do not, and
take half the time.
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

from tracer.arrays import CACHE_SIZE, Floats
from tracer.files import atomic_file

PNG = b"\x89PNG\r\n\x1a\n"
"""The first bytes of a PNG file (5.2)."""

# The code of radiance x is round(_MAX_CODE x^(1 / gamma)).  Gamma is 11 / 5 = 2.2: two integers,
# because thresholds are computed exactly.
_MAX_CODE = 255
_GAMMA = 11, 5

# Number of values that are encoded or compressed together: they stay in the CPU cache.
_VALUES_PER_BATCH = CACHE_SIZE

# The largest prime below 2^16 (RFC 1950).
_ADLER = 65521


def write_png(file: str | bytes | os.PathLike[str] | IO[bytes], image: ArrayLike) -> None:
    """Write a picture as an 8-bit RGB PNG file; its codes are those of `to_codes`.

    Parameters
    ----------
    file : str, bytes, path-like or binary file
        Name of the file, or an open file.  A PNG file of this name is replaced when the new one is
        complete.
    image : (height, width, 3) array_like
        Linear RGB radiance, as `render` returns it.

    Raises
    ------
    TypeError
        If the image has type uint8, is complex, or is a masked array.
    ValueError
        If the image has another shape, has no pixels, or contains a NaN; or if the name has a
        suffix other than ".png".
    OSError
        If the file cannot be written, or a file that is not a PNG has this name.
    """
    radiance = _validated_radiance(image)
    height, width, _ = radiance.shape
    rows_per_tile = max(1, _VALUES_PER_BATCH // (3 * max(1, width)))
    row_starts = range(0, height, rows_per_tile)
    tiles = (compressed(radiance[start : start + rows_per_tile]) for start in row_starts)
    if not isinstance(file, (str, bytes, os.PathLike)):
        write_tiles(file, width, height, tiles)
        return
    path = os.fsdecode(file)
    stem, suffix = os.path.splitext(path)
    if suffix.lower() not in ("", ".png"):
        raise ValueError(f"{path}: pictures are PNG files; name it {stem}.png")
    with atomic_file(path, PNG) as stream:
        write_tiles(stream, width, height, tiles)


class Compressed(NamedTuple):
    """A tile of a picture (a rectangle of pixels), compressed for a PNG file.

    Attributes
    ----------
    data : bytes
        Deflate blocks (RFC 1951).  The last block ends at the end of a byte, and is not marked as
        the last of the stream.
    size : int
        Number of bytes before compression.
    checksum : int
        Adler-32 of the bytes before compression (RFC 1950).
    """

    data: bytes
    size: int
    checksum: int


def compressed(radiance: Floats, *, from_left: bool = True) -> Compressed:
    """Encode the radiance of a tile as 8-bit codes, and compress these.

    Parameters
    ----------
    radiance : (rows, columns, 3) float array
        Linear RGB radiance of whole rows of the picture, or of a part of one row.
    from_left : bool
        Whether the tile begins at the left side of the picture.  In the file, each row begins there
        with the number of its filter.  It is always 0, no filter: rendered pictures are full of
        exact repeats, which filters would disturb.

    Returns
    -------
    tile : Compressed
        The data for `write_tiles`.
    """
    codes = to_codes(radiance)
    lines = codes.reshape(len(codes), -1)
    if from_left:
        lines = np.pad(lines, ((0, 0), (1, 0)))
    # Level 3 takes no longer than level 1.
    stream = zlib.compressobj(3, wbits=-zlib.MAX_WBITS)
    data = stream.compress(lines.data) + stream.flush(zlib.Z_FULL_FLUSH)
    return Compressed(data, lines.size, zlib.adler32(lines.data))


def write_tiles(file: IO[bytes], width: int, height: int, tiles: Iterable[Compressed]) -> None:
    """Write a PNG file from the compressed tiles of a picture.

    Parameters
    ----------
    file : binary file
        The file to write to.
    width, height : int
        Size of the picture, in pixels.
    tiles : iterable of Compressed
        All pixels of the picture, in order: from top to bottom and from left to right.

    Raises
    ------
    ValueError
        If the picture has no pixels, or the tiles contain more or fewer pixels than it has.
    """
    if width < 1 or height < 1:
        raise ValueError(f"a picture has at least one pixel, not {width} x {height}")

    def write_chunk(kind: bytes, data: bytes) -> None:  # (5.3)
        file.write(struct.pack(">I", len(data)) + kind)
        file.write(data)
        file.write(struct.pack(">I", zlib.crc32(data, zlib.crc32(kind))))

    file.write(PNG)
    # 8 bits per channel, RGB, the only compression and filter methods that exist, not interlaced.
    write_chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0))
    # A zlib stream (RFC 1950): its header (window of 32 KB, fast compression), the blocks of the
    # tiles, an empty last block, and the checksum.
    header, checksum, remaining = b"\x78\x5e", 1, height * (1 + 3 * width)
    for tile in tiles:
        write_chunk(b"IDAT", header + tile.data)
        header, checksum = b"", _joined_adler(checksum, tile.checksum, tile.size)
        remaining -= tile.size
    if remaining:
        raise ValueError(f"tiles do not make up a picture of {width} x {height} pixels")
    write_chunk(b"IDAT", b"\x03\x00" + struct.pack(">I", checksum))
    write_chunk(b"IEND", b"")


def _joined_adler(first: int, second: int, second_size: int) -> int:
    """Compute the Adler-32 checksum of two joined pieces of data from the checksums of both.

    Parameters
    ----------
    first, second : int
        Checksum of the first piece, and of the second piece.
    second_size : int
        Number of bytes of the second piece.

    Returns
    -------
    checksum : int
        The checksum of the first piece followed by the second.
    """
    a, b = first & 0xFFFF, first >> 16
    total = (a + (second & 0xFFFF) - 1) % _ADLER
    return ((b + (second >> 16) + second_size * (a - 1)) % _ADLER) << 16 | total


def to_codes(image: ArrayLike) -> NDArray[np.uint8]:
    """Encode linear RGB radiance in 8 bits: round(255 clip(x, 0, 1)^(1/2.2)).

    Parameters
    ----------
    image : (height, width, 3) array_like
        Linear RGB radiance, as `render` returns it.

    Returns
    -------
    codes : (height, width, 3) uint8 array
        The codes that exact arithmetic would give.

    Raises
    ------
    TypeError
        If the image has type uint8 (codes already), is complex, or is a masked array.
    ValueError
        If the image has another shape, or contains a NaN.
    """
    radiance = _validated_radiance(image)
    codes = np.empty(radiance.shape, dtype=np.uint8)
    flat, flat_codes = radiance.reshape(-1), codes.reshape(-1)
    min_value, first_cell, cell_code, next_threshold = _code_tables()
    for start in range(0, flat.size, _VALUES_PER_BATCH):
        batch = slice(start, start + _VALUES_PER_BATCH)
        x = np.clip(flat[batch], min_value, 1.0)
        code = cell_code.take((x.view(np.int64) >> _CELL_BITS) - first_cell)
        np.add(code, x >= next_threshold.take(code), out=flat_codes[batch])
    return codes


def _validated_radiance(image: ArrayLike) -> Floats:
    """Validate an image, and convert it to a contiguous float64 array.

    Parameters
    ----------
    image : (height, width, 3) array_like
        Linear RGB radiance.

    Returns
    -------
    radiance : (height, width, 3) float64 array
        The same values, in C order.

    Raises
    ------
    TypeError, ValueError
        As `to_codes` does.
    """
    array = np.asarray(image)
    if array.dtype == np.uint8:
        raise TypeError("an image is linear radiance, from 0 to 1, not codes of type uint8")
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


# Values are looked up by their leading bits, because a binary search among the thresholds would
# take three times as long.  A cell is a range of float64 values that have these bits in common.
# With 7 bits after those of the exponent, a cell contains at most one threshold.
_CELL_BITS = 52 - 7


@cache
def _code_tables() -> tuple[float, int, NDArray[np.uint8], Floats]:
    """Compute tables that give the code of any value from `min_value` to 1.

    Returns
    -------
    min_value : float
        A power of two below the first threshold: it has code 0, as all smaller values have.
    first_cell : int
        The leading bits of `min_value`.
    cell_code : (cells,) uint8 array
        The code of the smallest float64 in each cell.
    next_threshold : (_MAX_CODE + 1,) float array
        For each code, the smallest float64 that has a larger code.
    """
    codes = range(1, _MAX_CODE + 1)
    next_threshold = np.array([_threshold(code) for code in codes] + [np.inf])
    min_value = 2.0 ** _min_exponent()
    first_cell, last_cell = (np.array([min_value, 1.0]).view(np.int64) >> _CELL_BITS).tolist()
    smallest: Floats = (np.arange(first_cell, last_cell + 1) << _CELL_BITS).view(np.float64)
    cell_code = next_threshold.searchsorted(smallest, side="right").astype(np.uint8)
    return min_value, first_cell, cell_code, next_threshold


def _min_exponent() -> int:
    """Return the exponent of the largest power of two below the first threshold."""
    p, q = _GAMMA
    return math.frexp((0.5 / _MAX_CODE) ** (p / q))[1] - 1


def _threshold(code: int) -> float:
    """Compute the smallest float64 whose code is at least `code`.

    The condition is 255 x^(q/p) >= code - 1/2, where p / q is gamma.  Raised to the power p it has
    only integers, for a float64 that is at least 2^e is a multiple of 2^(e - 52).
    """
    p, q = _GAMMA
    root = (code - 0.5) / _MAX_CODE
    # Closer than root**(p / q): the remainder is small, and so is the error of its rounding.
    near: float = root ** (p // q) * root ** (p % q / q)
    bits = 52 - _min_exponent()
    limit = (2 * code - 1) ** p << q * bits
    candidates = (near + ulps * math.ulp(near) for ulps in range(-4, 5))
    return next(x for x in candidates if int(x * 2.0**bits) ** q * (2 * _MAX_CODE) ** p >= limit)
