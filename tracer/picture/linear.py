"""Write linear radiance to a file: as float64 in NumPy's format, or as float32 in OpenEXR.

A picture is encoded and written tile by tile.  A tile is several whole rows of pixels, or a part of
one row.  It becomes bytes row by row, and for each pixel in the order red, green, blue.  The tiles
of a picture are written from top to bottom and from left to right.
"""

from __future__ import annotations

from collections.abc import Iterable
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

    `numpy.load` returns the radiance as a float64 array of shape (height, width, 3).  It is not
    checked whether the tiles contain that many numbers.  Raise OSError if the file cannot be
    written.
    """
    header = {"descr": "=f8", "fortran_order": False, "shape": (height, width, 3)}
    np.lib.format.write_array_header_1_0(file, header)
    file.writelines(tiles)


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
    values = image.reshape(-1)
    value_count = 0
    for tile in tiles:
        tile_values = np.frombuffer(tile, np.float32)
        values[value_count : value_count + tile_values.size] = tile_values
        value_count += tile_values.size
    if value_count != values.size:
        raise ValueError(f"tiles do not make up a picture of {width} x {height} pixels")
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    # On Linux, a file without a name has this path.
    path = file.name if isinstance(file.name, str) else f"/proc/self/fd/{file.name}"
    try:
        OpenEXR.File(header, {"RGB": image}).write(path)
    except RuntimeError as error:
        reason = str(error).rpartition(f'"{path}". ')[2].rstrip(".")
        raise OSError(reason) from error
