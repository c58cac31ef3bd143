"""8-bit codes against exact arithmetic, PNG files against Pillow, and what a failure leaves."""

from __future__ import annotations

import errno
import os
import stat
import struct
import zlib
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tracer import write_png
from tracer.picture.png import PNG, _shifts, packed, to_codes, write_bands


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


def test_the_codes_round_the_power_function():
    x = np.linspace(-0.1, 1.1, 600_000)
    assert (codes_of(x) == power(x)).all()
    assert set(codes_of(x)) == set(range(256))


def test_the_codes_where_numpys_integers_have_32_bits(monkeypatch: pytest.MonkeyPatch) -> None:
    def narrow(function):
        def narrowed(*arguments, **options):
            result = function(*arguments, **options)
            return result if "dtype" in options else result.astype(np.int32)

        return narrowed

    for name in ("arange", "searchsorted"):
        monkeypatch.setattr(np, name, narrow(getattr(np, name)))
    table = _shifts.__wrapped__()
    monkeypatch.undo()
    np.testing.assert_array_equal(table, _shifts())


def test_small_radiances_round_the_power_function():
    x = 10.0 ** np.linspace(-320, 0, 30_000)
    assert (codes_of(x) == power(x)).all()


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


def test_errors_name_the_picture(tmp_path):
    picture = tmp_path / "missing" / "picture.png"
    with pytest.raises(FileNotFoundError) as caught:
        write_png(picture, np.zeros((1, 1, 3)))
    assert caught.value.filename == str(picture)


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


@pytest.mark.parametrize("rows", [1, 2, 5, 7])
def test_bands_make_the_picture(tmp_path, rows):
    image = np.random.default_rng(rows).uniform(size=(7, 5, 3))
    bands = (packed(image[row : row + rows]) for row in range(0, 7, rows))
    write_bands(tmp_path / "picture.png", 5, 7, bands)
    with Image.open(tmp_path / "picture.png") as picture:
        assert (np.asarray(picture) == to_codes(image)).all()


@pytest.mark.parametrize("rows", [1, 7, 300])
def test_the_check_of_a_picture_in_parts(tmp_path, rows):
    """Pillow does not look at it; zlib does."""
    image = np.random.default_rng(rows).uniform(size=(300, 50, 3))
    bands = (packed(image[row : row + rows]) for row in range(0, 300, rows))
    write_bands(tmp_path / "picture.png", 50, 300, bands)
    left, stream = (tmp_path / "picture.png").read_bytes()[8:], b""
    while left:
        size, kind = struct.unpack(">I4s", left[:8])
        stream += left[8 : 8 + size] if kind == b"IDAT" else b""
        left = left[12 + size :]
    assert len(zlib.decompress(stream)) == 300 * (1 + 3 * 50)


def test_a_row_too_few(tmp_path):
    with pytest.raises(ValueError, match="the bands have 2 rows, not 3"):
        write_bands(tmp_path / "picture.png", 4, 3, [packed(np.zeros((2, 4, 3)))])
    assert list(tmp_path.iterdir()) == []


PRECIOUS = PNG + b"precious"


class TestWhatIsThereAlready:
    """It is replaced by a whole picture, or not touched."""

    @pytest.fixture
    def picture(self, tmp_path) -> Path:
        path = tmp_path / "picture.png"
        path.write_bytes(PRECIOUS)
        return path

    @pytest.mark.parametrize(
        ("bands", "error"),
        [
            ([np.zeros((1, 4, 3))], ValueError),  # too few rows
            ([np.zeros((4, 4, 3))], ValueError),  # too many
            ([np.zeros((3, 5, 3))], ValueError),  # too wide
            ([np.full((3, 4, 3), np.nan)], ValueError),
        ],
        ids=["few", "many", "wide", "nan"],
    )
    def test_wrong_bands(self, picture, bands, error):
        with pytest.raises(error):
            write_bands(picture, 4, 3, map(packed, bands))
        assert [path.read_bytes() for path in picture.parent.iterdir()] == [PRECIOUS]

    @pytest.mark.parametrize("error", [KeyboardInterrupt, MemoryError, OSError])
    def test_a_failure_halfway(self, picture, error):
        def bands():
            yield packed(np.zeros((1, 4, 3)))
            assert len(list(picture.parent.iterdir())) == 2  # the new one, beside it
            raise error

        with pytest.raises(error):
            write_bands(picture, 4, 3, bands())
        assert [path.read_bytes() for path in picture.parent.iterdir()] == [PRECIOUS]

    def test_a_full_disk(self, picture):
        """The system refuses to let a file grow beyond the limit of a process."""
        import resource
        import signal

        old = resource.getrlimit(resource.RLIMIT_FSIZE)
        handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (1000, old[1]))
        try:
            with pytest.raises(OSError, match="File too large"):
                write_png(picture, np.random.default_rng(1).uniform(size=(100, 100, 3)))
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, old)
            signal.signal(signal.SIGXFSZ, handler)
        assert [path.read_bytes() for path in picture.parent.iterdir()] == [PRECIOUS]

    @pytest.mark.parametrize("why", [errno.EACCES, errno.EROFS])
    def test_it_may_not_be_written(self, picture, monkeypatch, why):
        """As by a user without privileges, for root may write everything, or on a fixed disk."""

        def refuses(path: str, _mode: str) -> None:
            raise OSError(why, os.strerror(why), path)

        monkeypatch.setattr(os, "access", lambda *_: False)
        monkeypatch.setattr("tracer.commands.open", refuses, raising=False)
        with pytest.raises(OSError, match=os.strerror(why)):
            write_png(picture, np.zeros((1, 1, 3)))
        assert [path.read_bytes() for path in picture.parent.iterdir()] == [PRECIOUS]

    @pytest.mark.parametrize("text", [b"<scene>", PNG[:-1], b"\n"])
    def test_it_is_no_picture(self, picture, text):
        picture.write_bytes(text)
        with pytest.raises(FileExistsError, match="a file of another kind is there"):
            write_png(picture, np.zeros((1, 1, 3)))
        assert [path.read_bytes() for path in picture.parent.iterdir()] == [text]

    def test_it_is_empty(self, picture):
        picture.write_bytes(b"")
        write_png(picture, np.zeros((1, 1, 3)))
        assert picture.read_bytes().startswith(PNG)

    def test_its_permissions_are_kept(self, picture):
        picture.chmod(0o640)
        write_png(picture, np.zeros((1, 1, 3)))
        assert stat.S_IMODE(picture.stat().st_mode) == 0o640
        assert picture.read_bytes().startswith(b"\x89PNG")

    def test_a_link_stays_a_link(self, picture):
        link = picture.with_name("link.png")
        link.symlink_to(picture.name)
        write_png(link, np.zeros((1, 1, 3)))
        assert link.is_symlink()
        assert picture.read_bytes().startswith(b"\x89PNG")


def test_a_new_picture_has_the_permissions_of_any_new_file(tmp_path):
    write_png(tmp_path / "picture.png", np.zeros((1, 1, 3)))
    (tmp_path / "other").touch()
    assert (tmp_path / "picture.png").stat().st_mode == (tmp_path / "other").stat().st_mode


@pytest.mark.parametrize(
    ("target", "reason"),
    [
        ("folder", "not a regular file"),
        ("pipe", "not a regular file"),
        ("missing/picture.png", "No such file"),
        ("loop", "Too many levels of symbolic links"),
        ("there", "Too many levels of symbolic links"),
    ],
)
def test_what_cannot_be_written(tmp_path, target, reason):
    (tmp_path / "folder").mkdir()
    os.mkfifo(tmp_path / "pipe")
    for link, to in (("loop", "loop"), ("there", "back"), ("back", "there")):
        (tmp_path / link).symlink_to(to)
    before = sorted(tmp_path.rglob("*"))
    with pytest.raises(OSError, match=reason):
        write_png(tmp_path / target, np.zeros((1, 1, 3)))
    assert sorted(tmp_path.rglob("*")) == before
    assert (tmp_path / "loop").is_symlink()
