"""Write linear radiance to a file: as float64 in NumPy's format, or as float32 in OpenEXR.

As in `tracer.picture.png`, a picture is made of tiles, in the order of its pixels.  The bytes of a
tile are its values in order: row by row, and for each pixel red, green and blue.
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
    radiance: Shaped[Floats, "rows columns 3"],
    *,
    is_leftmost: bool = True,  # ignored: only PNG marks the beginnings of rows
) -> bytes:
    """Convert the radiance of a tile to float64 bytes."""
    return radiance.tobytes()


def encode_float32(
    radiance: Shaped[Floats, "rows columns 3"], *, is_leftmost: bool = True
) -> bytes:
    """Convert the radiance of a tile to float32 bytes; values that are too large become infinite.

    See `encode_float64`.
    """
    with np.errstate(over="ignore"):
        return radiance.astype(np.float32).tobytes()


def write_npy(file: IO[bytes], width: int, height: int, tiles: Iterable[bytes]) -> None:
    """Write the linear radiance of a picture, from tiles of float64 bytes, to a .npy file.

    `numpy.load` returns the radiance as a float64 array of shape (height, width, 3).  The number of
    pixels is not checked.
    """
    header = {"descr": "=f8", "fortran_order": False, "shape": (height, width, 3)}
    np.lib.format.write_array_header_1_0(file, header)
    file.writelines(tiles)


def write_exr(file: IO[bytes], width: int, height: int, tiles: Iterable[bytes]) -> None:
    """Write the radiance of a picture, from tiles of float32 bytes, to an OpenEXR file.

    The channels are R, G and B.  The whole picture is in memory: 12 bytes a pixel.

    Parameters
    ----------
    file
        Its attribute `name` must be its path or file descriptor.

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
    values, value_count = image.reshape(-1), 0
    for tile in tiles:
        tile_values = np.frombuffer(tile, np.float32)
        values[value_count : value_count + tile_values.size] = tile_values
        value_count += tile_values.size
    if value_count != values.size:
        raise ValueError(f"tiles do not make up a picture of {width} x {height} pixels")
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    # OpenEXR opens the file again.  On Linux, a file without a path is opened by its descriptor.
    path = file.name if isinstance(file.name, str) else f"/proc/self/fd/{file.name}"
    try:
        OpenEXR.File(header, {"RGB": image}).write(path)
    except RuntimeError as error:
        reason = str(error).rpartition(f'"{path}". ')[2].rstrip(".")
        raise OSError(reason) from error
