"""8-bit codes against exact arithmetic, and PNG files against Pillow."""

from __future__ import annotations

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


def test_the_codes_at_the_neighbours_of_every_threshold():
    """Exact, where the power function may err: within 8 ulp of the thresholds."""
    for code in (1, 2, 3, 17, 100, 186, 254, 255):
        x = THRESHOLDS[code - 1] + np.spacing(THRESHOLDS[code - 1]) * np.arange(-8, 9)
        expected = [exact_code(value) for value in x]
        assert expected[0] == code - 1
        assert expected[-1] == code
        assert codes_of(x).tolist() == expected


def test_the_codes_change_at_every_threshold():
    """And agree with the power function as soon as it can be trusted."""
    ulp = np.spacing(THRESHOLDS)
    assert codes_of(THRESHOLDS - 8 * ulp).tolist() == list(range(255))
    assert codes_of(THRESHOLDS + 8 * ulp).tolist() == list(range(1, 256))
    assert (codes_of(THRESHOLDS - 8 * ulp) == power(THRESHOLDS - 8 * ulp)).all()
    assert (codes_of(THRESHOLDS + 8 * ulp) == power(THRESHOLDS + 8 * ulp)).all()


@pytest.mark.parametrize(
    ("x", "code"),
    [
        (0.0, 0),
        (-0.0, 0),
        (5e-324, 0),
        (-1.0, 0),
        (-np.inf, 0),
        (1.0, 255),
        (np.nextafter(1, 2), 255),
        (1e308, 255),
        (np.inf, 255),
        (0.5, 186),  # 255 x .5^(5/11) = 186.08
        (0.18, 117),  # 255 x .18^(5/11) = 116.96
    ],
)
def test_codes(x, code):
    assert to_codes(np.full((2, 3, 3), x)).tolist() == [[[code] * 3] * 3] * 2


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
    ],
)
def test_what_is_no_image(tmp_path, image, message):
    with pytest.raises(ValueError, match=message):
        write_png(tmp_path / "picture.png", image)
    assert list(tmp_path.iterdir()) == []


def test_codes_are_no_radiance(tmp_path):
    with pytest.raises(TypeError, match="not codes of type uint8"):
        write_png(tmp_path / "picture.png", np.zeros((4, 3, 3), dtype=np.uint8))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("size", [(1, 1), (1, 500), (500, 1), (3, 2), (180, 320), (3, 40_000)])
def test_pillow_reads_what_was_written(tmp_path, size):
    image = np.random.default_rng(size).uniform(-0.2, 1.2, (*size, 3))
    image[: size[0] // 2] = 0.25  # and something to compress
    write_png(tmp_path / "picture.png", image)
    with Image.open(tmp_path / "picture.png") as picture:
        assert picture.format == "PNG"
        assert picture.mode == "RGB"
        assert (np.asarray(picture) == to_codes(image)).all()
    with Image.open(tmp_path / "picture.png") as picture:
        picture.verify()  # the checksums


def test_a_flat_picture_is_small(tmp_path):
    write_png(str(tmp_path / "picture.png"), np.zeros((1000, 1000, 3)))
    assert (tmp_path / "picture.png").stat().st_size < 20_000


def test_a_binary_file(tmp_path):
    image = np.random.default_rng(1).uniform(size=(7, 5, 3))
    write_png(tmp_path / "picture.png", image)
    file = io.BytesIO()
    write_png(file, image)
    assert file.getvalue() == (tmp_path / "picture.png").read_bytes()


def in_tiles(image, rows, columns):
    """Whole rows; or parts of one, if they are less than the picture is wide."""
    for top in range(0, image.shape[0], rows):
        for left in range(0, image.shape[1], columns):
            tile = image[top : top + rows, left : left + columns]
            yield compressed(tile, from_left=left == 0)


@pytest.mark.parametrize(("rows", "columns"), [(1, 50), (7, 50), (300, 50), (1, 17), (1, 1)])
def test_tiles_make_the_picture(rows, columns):
    image = np.random.default_rng(rows).uniform(size=(300, 50, 3))
    file = io.BytesIO()
    write_tiles(file, 50, 300, in_tiles(image, rows, columns))
    with Image.open(file) as picture:
        assert (np.asarray(picture) == to_codes(image)).all()
    # Pillow does not look at the last check; zlib does.
    left, stream = file.getvalue()[8:], b""
    while left:
        size, kind = struct.unpack(">I4s", left[:8])
        stream += left[8 : 8 + size] if kind == b"IDAT" else b""
        left = left[12 + size :]
    assert len(zlib.decompress(stream)) == 300 * (1 + 3 * 50)


@pytest.mark.parametrize("size", [(2, 4), (4, 4), (3, 5)])
def test_tiles_that_do_not_make_the_picture(size):
    with pytest.raises(ValueError, match="tiles do not make up a picture of 4 x 3 pixels"):
        write_tiles(io.BytesIO(), 4, 3, [compressed(np.zeros((*size, 3)))])
