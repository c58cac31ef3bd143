"""Formats of picture files, which are written tile by tile.

Each tile is encoded on its own.  So a picture takes little more memory than a few tiles, and
workers share the encoding, too.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import IO, Any, NamedTuple, Protocol
from typing import Annotated as Shaped

from tracer.arrays import Floats
from tracer.picture.linear import (
    EXR_MAGIC,
    NPY_MAGIC,
    encode_float32,
    encode_float64,
    write_exr,
    write_npy,
)
from tracer.picture.lint import Exposure
from tracer.picture.png import PNG_MAGIC, compress_tile, write_tiles


class TileEncoder(Protocol):
    """A function that converts the radiance of a tile to data for a file, as `compress_tile` does.

    A tile is several whole rows of the picture, or a piece of one row.
    """

    def __call__(
        self, radiance: Shaped[Floats, "rows columns 3"], /, *, is_leftmost: bool = True
    ) -> Any:
        """Encode a tile; `is_leftmost` tells whether it is at the left edge of the picture."""


class EncodedTile(NamedTuple):
    """A rendered tile, in a form for a file."""

    data: Any  # what a `TileEncoder` returned
    exposure: Exposure


class Format(NamedTuple):
    """A picture format."""

    magic: bytes  # the first bytes of a file
    encode: TileEncoder
    # Writes a file from its width, its height and the results of `encode` for all tiles.  Raises
    # ValueError if they do not make up the picture, and OSError if the file cannot be written.
    write: Callable[[IO[bytes], int, int, Iterable[Any]], None]

    def write_picture(
        self, file: IO[bytes], width: int, height: int, tiles: Iterable[EncodedTile]
    ) -> Exposure:
        """Write a picture, and return its exposure; raise what `write` raises.

        The tiles are ordered from top to bottom and from left to right.  They are requested one by
        one, so the iterator may render them meanwhile.
        """
        exposure = Exposure()

        def list_data() -> Iterator[Any]:
            nonlocal exposure
            for tile in tiles:
                exposure = exposure.add(tile.exposure)
                yield tile.data

        self.write(file, width, height, list_data())
        return exposure


FORMATS: dict[str, Format] = {
    "png": Format(magic=PNG_MAGIC, encode=compress_tile, write=write_tiles),
    "npy": Format(magic=NPY_MAGIC, encode=encode_float64, write=write_npy),
    "exr": Format(magic=EXR_MAGIC, encode=encode_float32, write=write_exr),
}
"""Picture formats, by the suffix of the file name."""
