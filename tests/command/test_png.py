"""8-bit codes against exact arithmetic, and PNG files against Pillow."""

import io
import struct
import zlib
from fractions import Fraction

import numpy as np
import pytest
from PIL import Image

from tracer import to_codes, write_png
from tracer.picture.png import compressed, write_tiles


def codes_of(values) -> np.ndarray:
    """The codes of any number of values."""
    padded = np.resize(np.asarray(values, dtype=float), (1, -(-len(values) // 3), 3))
    return to_codes(padded).ravel()[: len(values)]


def power(values: np.ndarray) -> np.ndarray:
    return np.rint(255 * np.clip(values, 0, 1) ** (1 / 2.2)).astype(int)


def exact_code(x: float) -> int:
    """round(255 x^(5/11)) in rationals: how many of the 255 thresholds x has reached."""
    fifth = Fraction(x) ** 5
    return sum(fifth >= Fraction(2 * code - 1, 510) ** 11 for code in range(1, 256))


# Where the power function changes its mind, to the float64 or nearly so.
THRESHOLDS = ((np.arange(1, 256) - 0.5) / 255) ** 2.2


@pytest.mark.parametrize(
    "x", [np.linspace(-0.1, 1.1, 600_000), 10.0 ** np.linspace(-320, 0, 30_000)]
)
def test_the_codes_round_the_power_function(x):
    assert (codes_of(x) == power(x)).all()
    assert {0, 255} < set(codes_of(x))


def test_the_codes_change_exactly_at_every_threshold():
    """By the power function where it can be trusted: not within 8 ulp of the thresholds."""
    ulp = np.spacing(THRESHOLDS)
    for ulps, codes in ((-8, range(255)), (8, range(1, 256))):
        x = THRESHOLDS + ulps * ulp
        assert codes_of(x).tolist() == power(x).tolist() == list(codes)
    for code in (1, 2, 3, 17, 100, 186, 254, 255):
        x = THRESHOLDS[code - 1] + ulp[code - 1] * np.arange(-8, 9)
        assert codes_of(x).tolist() == [exact_code(value) for value in x]


def test_codes_of_what_is_no_colour():
    dark, bright = (0.0, -0.0, 5e-324, -1.0, -np.inf), (1.0, np.nextafter(1, 2), 1e308, np.inf)
    assert codes_of(dark + bright).tolist() == [0] * 5 + [255] * 4


def test_the_codes_do_not_depend_on_the_layout_of_the_array():
    image = np.random.default_rng(1).uniform(size=(7, 9, 3))
    expected = to_codes(image)
    assert (to_codes(np.asfortranarray(image)) == expected).all()
    assert (to_codes(image[::-1, ::-1])[::-1, ::-1] == expected).all()
    assert (to_codes(image.tolist()) == expected).all()


@pytest.mark.parametrize(
    ("image", "message"),
    [
        (np.zeros((4, 3)), r"an image has shape \(height, width, 3\), not \(4, 3\)"),
        (np.zeros((4, 3, 4)), r"an image has shape \(height, width, 3\), not \(4, 3, 4\)"),
        (np.full((1, 1, 3), np.nan), "an image must not hold NaN"),
        (np.zeros((0, 4, 3)), "a picture has at least one pixel, not 4 x 0"),
        (np.zeros((4, 0, 3)), "a picture has at least one pixel, not 0 x 4"),
        (np.zeros((4, 3, 3), dtype=np.uint8), "not codes of type uint8"),
    ],
)
def test_what_is_no_image(tmp_path, image, message):
    error = TypeError if image.dtype == np.uint8 else ValueError
    with pytest.raises(error, match=message):
        write_png(tmp_path / "picture.png", image)
    with pytest.raises(ValueError, match=r"a.jpg: pictures are PNG files; name it .*a.png"):
        write_png(tmp_path / "a.jpg", np.zeros((1, 1, 3)))
    assert list(tmp_path.iterdir()) == []


def checked(file) -> np.ndarray:
    """The codes in a PNG file, with all its checksums."""
    data = file.getvalue()
    Image.open(file).verify()
    # Pillow does not look at the last check; zlib does.
    left, stream = data[8:], b""
    while left:
        size, kind = struct.unpack(">I4s", left[:8])
        stream += left[8 : 8 + size] if kind == b"IDAT" else b""
        left = left[12 + size :]
    zlib.decompress(stream)
    with Image.open(file) as picture:
        assert (picture.format, picture.mode) == ("PNG", "RGB")
        return np.asarray(picture)


@pytest.mark.parametrize("size", [(1, 1), (1, 500), (500, 1), (3, 2), (180, 320), (3, 40_000)])
def test_pillow_reads_what_was_written(tmp_path, size):
    image = np.random.default_rng(size).uniform(-0.2, 1.2, (*size, 3))
    image[: size[0] // 2] = 0.25  # and something to compress
    write_png(file := io.BytesIO(), image)
    assert (checked(file) == to_codes(image)).all()
    write_png(path := tmp_path / "picture.png", image)
    assert path.read_bytes() == file.getvalue()
    write_png(str(path), np.zeros((1000, 1000, 3)))
    assert path.stat().st_size < 20_000


@pytest.mark.parametrize(("rows", "columns"), [(1, 50), (7, 50), (300, 50), (1, 17), (1, 1)])
def test_tiles_make_the_picture(rows, columns):
    """Whole rows; or parts of one, if they are less than the picture is wide."""
    image = np.random.default_rng(rows).uniform(size=(300, 50, 3))
    tiles = (
        compressed(image[top : top + rows, left : left + columns], from_left=left == 0)
        for top in range(0, 300, rows)
        for left in range(0, 50, columns)
    )
    write_tiles(file := io.BytesIO(), 50, 300, tiles)
    assert (checked(file) == to_codes(image)).all()


@pytest.mark.parametrize("size", [(2, 4), (4, 4), (3, 5)])
def test_tiles_that_do_not_make_the_picture(size):
    with pytest.raises(ValueError, match="tiles do not make up a picture of 4 x 3 pixels"):
        write_tiles(io.BytesIO(), 4, 3, [compressed(np.zeros((*size, 3)))])
