"""Write linear radiance to a file: as float64 in NumPy's format, or as float32 in OpenEXR.

A picture is encoded and written tile by tile.  A tile is several whole rows of pixels, or a part of
one row.  It becomes bytes row by row, and for each pixel in the order red, green, blue.  The tiles
of a picture are written from top to bottom and from left to right.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import IO
from typing import Annotated as Shaped

import numpy as np

from tracer.arrays import Floats

NPY_MAGIC, EXR_MAGIC = b"\x93NUMPY", b"\x76\x2f\x31\x01"
"""The first bytes of files of these formats."""


def encode_float64(
    radiance: Shaped[Floats, "rows columns 3"], *, is_leftmost: bool = True
) -> bytes:
    """Convert the radiance of a tile to float64 bytes, in the byte order of this machine.

    `is_leftmost` has no effect.  The encoder of PNG files has this parameter, because rows in these
    files begin with an additional byte, and all encoders are called with the same arguments.
    """
    return radiance.tobytes()


def encode_float32(
    radiance: Shaped[Floats, "rows columns 3"], *, is_leftmost: bool = True
) -> bytes:
    """Convert the radiance of a tile to float32 bytes, in the byte order of this machine.

    Values that are too large for float32 become infinite.  `is_leftmost` has no effect, as in
    `encode_float64`.
    """
    with np.errstate(over="ignore"):
        return radiance.astype(np.float32).tobytes()


def write_npy(file: IO[bytes], width: int, height: int, tiles: Iterable[bytes]) -> None:
    """Write a .npy file from the tiles of a picture, which `encode_float64` has encoded.

    `numpy.load` returns the radiance as a float64 array of shape (height, width, 3).

    Raise ValueError if the tiles contain more or fewer pixels than the picture has, and OSError if
    the file cannot be written.
    """
    header = {"descr": "=f8", "fortran_order": False, "shape": (height, width, 3)}
    np.lib.format.write_array_header_1_0(file, header)
    file.writelines(_check_tiles(tiles, width, height, bytes_per_value=8))


def write_exr(file: IO[bytes], width: int, height: int, tiles: Iterable[bytes]) -> None:
    """Write an OpenEXR file from the tiles of a picture, which `encode_float32` has encoded.

    The channels are R, G and B.  The whole picture is held in memory: 12 bytes for each pixel.

    Parameters
    ----------
    file
        An open file.  Its attribute `name` must be its path or, on Linux, its descriptor, because
        the package OpenEXR opens the file once more.

    Raises
    ------
    ModuleNotFoundError
        If the package OpenEXR is not installed.
    ValueError
        If the tiles contain more or fewer pixels than the picture has.
    OSError
        If the file cannot be written.
    """
    import OpenEXR  # optional, and slow to import

    image = np.empty((height, width, 3), np.float32)
    image_bytes = image.reshape(-1).view(np.uint8)
    start = 0
    for tile in _check_tiles(tiles, width, height, bytes_per_value=4):
        stop = start + len(tile)
        image_bytes[start:stop] = np.frombuffer(tile, np.uint8)
        start = stop
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    # On Linux, a file without a name has this path.
    path = file.name if isinstance(file.name, str) else f"/proc/self/fd/{file.name}"
    try:
        OpenEXR.File(header, {"RGB": image}).write(path)
    except RuntimeError as error:
        reason = str(error).rpartition(f'"{path}". ')[2].rstrip(".")
        raise OSError(reason) from error


def _check_tiles(
    tiles: Iterable[bytes], width: int, height: int, *, bytes_per_value: int
) -> Iterator[bytes]:
    """Yield the tiles of a picture that has three values in each pixel.

    Raise ValueError before the first tile with which there are too many bytes, or at the end if
    there are too few.
    """
    remaining_bytes = 3 * width * height * bytes_per_value
    for tile in tiles:
        remaining_bytes -= len(tile)
        if remaining_bytes < 0:
            break
        yield tile
    if remaining_bytes:
        raise ValueError(f"tiles do not make up a picture of {width} x {height} pixels")
