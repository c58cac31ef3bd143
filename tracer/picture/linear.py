"""Write linear radiance to a file: as float64 in NumPy's format, or as float32 in OpenEXR.

As in `tracer.picture.png`, a picture is written tile by tile, in the order of its pixels.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import IO

import numpy as np

from tracer.arrays import Floats

NPY_MAGIC, EXR_MAGIC = b"\x93NUMPY", b"\x76\x2f\x31\x01"
"""The first bytes of files of these formats."""


def encode_raw(radiance: Floats, *, is_leftmost: bool = True) -> bytes:
    """Convert the radiance of a tile (a rectangle of pixels) to raw float64 bytes.

    Parameters
    ----------
    radiance : (rows, columns, 3) float array
        Linear RGB radiance of the pixels.
    is_leftmost : bool
        Whether the tile is at the left edge of the picture; ignored in this format.

    Returns
    -------
    data : bytes
        The values in order: row by row, and for each pixel red, green and blue.
    """
    return radiance.tobytes()


def write_npy(file: IO[bytes], width: int, height: int, tiles: Iterable[bytes]) -> None:
    """Write the linear radiance of a picture to a .npy file.

    `numpy.load` returns the radiance as a float64 array of shape (height, width, 3).

    Parameters
    ----------
    file : binary file
        A file open for writing.
    width, height : int
        Size of the picture, in pixels.
    tiles : iterable of bytes
        The pixels of the picture from top to bottom and from left to right, as `encode_raw` returns
        them.  The number of pixels is not checked.

    Raises
    ------
    OSError
        If the file cannot be written.
    """
    header = {"descr": "=f8", "fortran_order": False, "shape": (height, width, 3)}
    np.lib.format.write_array_header_1_0(file, header)
    file.writelines(tiles)


def write_exr(file: IO[bytes], width: int, height: int, tiles: Iterable[bytes]) -> None:
    """Write the linear radiance of a picture to an OpenEXR file with the channels R, G and B.

    Values are rounded to float32; values that are too large for float32 become infinite.

    Parameters
    ----------
    file : binary file
        A file open for writing.  Its attribute `name` must be its path or file descriptor.
    width, height : int
        Size of the picture, in pixels.
    tiles : iterable of bytes
        The pixels of the picture from top to bottom and from left to right, as `encode_raw` returns
        them.

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

    image = np.frombuffer(b"".join(tiles)).reshape(height, width, 3)
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    with np.errstate(over="ignore"):
        channels = {"RGB": image.astype(np.float32)}
    # OpenEXR opens the file again.  On Linux, a file without a path is opened by its descriptor.
    path = file.name if isinstance(file.name, str) else f"/proc/self/fd/{file.name}"
    try:
        OpenEXR.File(header, channels).write(path)
    except RuntimeError as error:
        reason = str(error).rpartition(f'"{path}". ')[2].rstrip(".")
        raise OSError(reason) from error
