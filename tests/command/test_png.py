"""8-bit codes compared with exact arithmetic, and PNG files read by Pillow."""

import io
import os
import struct
import zlib
from fractions import Fraction

import numpy as np
import pytest
from PIL import Image

from tracer import to_codes, write_png
from tracer.picture import png
from tracer.picture.formats import FORMATS
from tracer.picture.png import compress_tile, write_tiles


def encode_values(values) -> np.ndarray:
    """Encode any number of values as 8-bit codes."""
    padded = np.resize(np.asarray(values, dtype=float), (1, -(-len(values) // 3), 3))
    return to_codes(padded).ravel()[: len(values)]


def compute_exact_code(x: float, gamma: tuple[int, int] = (11, 5)) -> int:
    """Compute the 8-bit code of x, round(255 clip(x, 0, 1)^(q / p)), in exact arithmetic.

    The pair `gamma` = (p, q) stands for the gamma value p / q.
    """
    p, q = gamma
    power = Fraction(min(max(x, 0.0), 1.0)) ** q
    return sum(power >= Fraction(2 * code - 1, 510) ** p for code in range(1, 256))


@pytest.mark.parametrize("gamma", [(11, 5), (12, 5), (9, 5)])
def test_codes_are_exact_at_every_threshold_and_between(gamma, monkeypatch):
    """The code changes at exactly the right float64, for any value of the constant `_GAMMA`."""
    monkeypatch.setattr(png, "_GAMMA", gamma)
    png._compute_next_thresholds.cache_clear()
    try:
        thresholds = ((np.arange(1, 256) - 0.5) / 255) ** (gamma[0] / gamma[1])
        x = np.concatenate(
            [
                (thresholds[:, None] + np.spacing(thresholds)[:, None] * [-8, -1, 0, 1, 8]).ravel(),
                np.linspace(-0.1, 1.1, 300),
                10.0 ** np.linspace(-320, 0, 300),
            ]
        )
        assert encode_values(x).tolist() == [compute_exact_code(value, gamma) for value in x]
    finally:
        png._compute_next_thresholds.cache_clear()


def test_the_power_function_agrees_away_from_the_thresholds():
    x = np.linspace(-0.1, 1.1, 600_000)
    assert (encode_values(x) == np.rint(255 * np.clip(x, 0, 1) ** (1 / 2.2))).all()


def test_codes_of_values_outside_the_range():
    dark, bright = (0.0, -0.0, 5e-324, -1.0, -np.inf), (1.0, np.nextafter(1, 2), 1e308, np.inf)
    assert encode_values(dark + bright).tolist() == [0] * 5 + [255] * 4


@pytest.mark.parametrize("nan_count", [1, 3])
def test_a_single_nan_is_refused(nan_count):
    with pytest.raises(ValueError, match="must not contain NaN"):
        encode_values((0.5,) * (3 - nan_count) + (np.nan,) * nan_count)


def test_codes_do_not_depend_on_the_layout_of_the_array():
    image = np.random.default_rng(1).uniform(size=(7, 9, 3))
    expected = to_codes(image)
    assert (to_codes(np.asfortranarray(image)) == expected).all()
    assert (to_codes(image[::-1, ::-1])[::-1, ::-1] == expected).all()
    assert (to_codes(image.tolist()) == expected).all()


def test_names_of_pictures(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    image = np.zeros((1, 1, 3))
    names = ["A.PNG", "b.png", "c"]
    for name in names:
        write_png(os.fsencode(name) if name == "c" else name, image)
    for name in ("a.jpg", b"a.jpg"):
        with pytest.raises(ValueError, match=r"^a\.jpg: pictures are PNG files; name it a\.png$"):
            write_png(name, image)
    assert sorted(path.name for path in tmp_path.iterdir()) == names


def read_verified_codes(file) -> np.ndarray:
    """Verify all checksums of a PNG file in memory, and return its 8-bit codes."""
    data = file.getvalue()
    Image.open(file).verify()
    # Pillow ignores the checksum of the compressed stream; zlib does not.
    remaining, stream = data[8:], b""
    while remaining:
        size, chunk_type = struct.unpack(">I4s", remaining[:8])
        stream += remaining[8 : 8 + size] if chunk_type == b"IDAT" else b""
        remaining = remaining[12 + size :]
    zlib.decompress(stream)
    with Image.open(file) as picture:
        assert (picture.format, picture.mode) == ("PNG", "RGB")
        return np.asarray(picture)


@pytest.mark.parametrize("size", [(1, 1), (1, 500), (500, 1), (3, 2), (180, 320), (3, 40_000)])
def test_pillow_reads_what_was_written(tmp_path, size):
    image = np.random.default_rng(size).uniform(-0.2, 1.2, (*size, 3))
    image[: size[0] // 2] = 0.25  # can be compressed well
    write_png(file := io.BytesIO(), image)
    assert (read_verified_codes(file) == to_codes(image)).all()
    write_png(path := tmp_path / "picture.png", image)
    assert path.read_bytes() == file.getvalue()
    write_png(str(path), np.zeros((1000, 1000, 3)))
    assert path.stat().st_size < 20_000


@pytest.mark.parametrize(("rows", "columns"), [(1, 50), (7, 50), (300, 50), (1, 17), (1, 1)])
def test_tiles_make_the_picture(rows, columns):
    """Tiles are whole rows, or parts of one row if they are narrower than the picture."""
    image = np.random.default_rng(rows).uniform(size=(300, 50, 3))
    tiles = (
        compress_tile(image[row : row + rows, column : column + columns], is_leftmost=column == 0)
        for row in range(0, 300, rows)
        for column in range(0, 50, columns)
    )
    write_tiles(file := io.BytesIO(), 50, 300, tiles)
    assert (read_verified_codes(file) == to_codes(image)).all()


@pytest.mark.parametrize("sizes", [[], [(2, 4)], [(4, 4)], [(3, 5)], [(3, 4), (1, 1)]])
@pytest.mark.parametrize("suffix", FORMATS)
def test_tiles_that_do_not_make_the_picture(suffix, sizes):
    """All formats refuse too few and too many pixels with the same message."""
    file_format = FORMATS[suffix]
    tiles = [file_format.encode(np.zeros((*size, 3))) for size in sizes]
    with pytest.raises(ValueError, match=r"^tiles do not make up a picture of 4 x 3 pixels$"):
        file_format.write(io.BytesIO(), 4, 3, tiles)
