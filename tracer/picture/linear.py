"""Write linear radiance to a file: exactly to .npy, or as float32 to OpenEXR.

As in `tracer.picture.png`, a picture is written tile by tile, in the order of its pixels.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import IO

import numpy as np

from tracer.arrays import Floats

NPY, EXR = b"\x93NUMPY", b"\x76\x2f\x31\x01"
"""The first bytes of files of these formats."""


def raw(radiance: Floats, *, from_left: bool = True) -> bytes:
    """Return the radiance of a tile as bytes.

    Parameters
    ----------
    radiance : (rows, columns, 3) float array
        Linear RGB radiance of the pixels.
    from_left : bool
        Ignored; present because every function that encodes tiles has this argument.

    Returns
    -------
    data : bytes
        The float64 values, in the order of the pixels.
    """
    return radiance.tobytes()


def write_npy(file: IO[bytes], width: int, height: int, tiles: Iterable[bytes]) -> None:
    """Write a picture as a float64 array (height, width, 3) that `numpy.load` reads.

    The values are exactly those of `render`.

    Parameters
    ----------
    file : binary file
        The file to write to.
    width, height : int
        Size of the picture, in pixels.
    tiles : iterable of bytes
        All pixels of the picture, encoded by `raw`, from top to bottom and from left to right.
    """
    header = {"descr": "=f8", "fortran_order": False, "shape": (height, width, 3)}
    np.lib.format.write_array_header_1_0(file, header)
    for tile in tiles:
        file.write(tile)


def write_exr(file: IO[bytes], width: int, height: int, tiles: Iterable[bytes]) -> None:
    """Write a picture as an OpenEXR file with channels R, G and B.

    Values are rounded to float32; those beyond its range become infinite.

    Parameters
    ----------
    file : binary file
        An empty file that has a name, by which the package OpenEXR opens it.
    width, height : int
        Size of the picture, in pixels.
    tiles : iterable of bytes
        All pixels of the picture, encoded by `raw`, from top to bottom and from left to right.

    Raises
    ------
    ModuleNotFoundError
        If the package OpenEXR is not installed.
    OSError
        If the file cannot be written.
    """
    import OpenEXR  # optional, and slow to import

    image = np.frombuffer(b"".join(tiles)).reshape(height, width, 3)
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    with np.errstate(over="ignore"):
        channels = {"RGB": image.astype(np.float32)}
    try:
        OpenEXR.File(header, channels).write(file.name)
    except RuntimeError as error:
        reason = str(error).rpartition(f'"{file.name}". ')[2].rstrip(".")
        raise OSError(reason) from error
