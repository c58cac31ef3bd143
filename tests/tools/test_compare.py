"""The picture comparison: its figures, its picture and its command."""

from __future__ import annotations

import csv
import io
import json
import os
import shutil
import struct
import subprocess
import sys
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Literal

import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray
from PIL import Image
from skimage.metrics import structural_similarity

from reference.command import SCENES
from reference.compare import figures, main, read_picture, write_comparison
from tracer import load_scene, render, to_codes

ROOT = Path(__file__).resolve().parents[2]
Floats = NDArray[np.float64]
PNG = b"\x89PNG\r\n\x1a\n"
Image8 = NDArray[np.uint8]
Compare = Callable[..., tuple[int, list[str], str]]


RIGHT = render(load_scene(SCENES / "four-spheres.xml"))
CODES = to_codes(RIGHT)


def save(path: Path, image: Image8) -> Path:
    Image.fromarray(np.ascontiguousarray(image)).save(path)
    return path


@pytest.fixture
def black(tmp_path: Path) -> Path:
    """A small picture that is saved."""
    return save(tmp_path / "a.png", np.zeros((4, 4, 3), dtype=np.uint8))


@pytest.fixture
def right(tmp_path: Path) -> Path:
    return save(tmp_path / "b.png", CODES)


@pytest.fixture
def compare(capsys: pytest.CaptureFixture[str]) -> Compare:
    """The command in this process: its status, the lines of its output, its errors."""

    def call(*arguments: str | Path) -> tuple[int, list[str], str]:
        try:
            status = main([*map(str, arguments)])
        except SystemExit as wrong:
            status = int(wrong.code or 0)
        told = capsys.readouterr()
        return status, told.out.splitlines(), told.err

    return call


def run(
    *arguments: str | Path, module: str = "reference.compare", **environment: str
) -> tuple[int, str, str]:
    """A command as a process of its own: its status, output and errors."""
    done = subprocess.run(
        [sys.executable, "-m", module, *arguments],
        capture_output=True,
        text=True,
        cwd=ROOT,
        env=os.environ | environment,
        timeout=60,
    )
    return done.returncode, done.stdout, done.stderr


def test_figures_by_hand() -> None:
    """Four of 100 pixels differ, by 0.5 in one channel; two of them are masked."""
    a, b = np.full((10, 10, 3), 0.25), np.full((10, 10, 3), 0.25)
    a[0, :4, 1] += 0.5
    mask = np.zeros((10, 10), dtype=np.bool_)
    mask[0, :2] = True
    result = figures(a, b, mask)
    assert (result.max, result.median, result.over, result.masked) == (0.5, 0.0, 2, 2)
    # 2 of 98 * 3 values are 0.5.
    assert result.rmse == pytest.approx(0.5 * np.sqrt(2 / 294), rel=1e-12)
    assert result.p999 == 0.5
    shown = a ** (1 / 2.2), b ** (1 / 2.2)
    right = structural_similarity(*shown, channel_axis=2, data_range=1.0)
    assert figures(a, b).ssim == pytest.approx(right, abs=1e-6)
    # A thousandth of the pixels may differ more.
    for pixels, p999 in ((1, 0.0), (4, 0.5)):
        a, b = np.full((40, 50, 3), 0.25), np.full((40, 50, 3), 0.25)
        a[0, :pixels] += 0.5
        assert figures(a, b).p999 == p999


def test_figures_refuse() -> None:
    a = np.zeros((8, 8, 3))
    with pytest.raises(ValueError, match="shapes differ"):
        figures(a, np.zeros((8, 9, 3)))
    with pytest.raises(ValueError, match="not finite"):
        figures(a, np.full((8, 8, 3), np.nan))
    with pytest.raises(ValueError, match="every pixel is masked"):
        figures(a, a, np.ones((8, 8), dtype=np.bool_))


def test_comparison_shows_sign_and_size(tmp_path: Path) -> None:
    """300 pixels wide, so not enlarged: A brighter by 0.04 at left, darker by 0.02 at right.

    One pixel that differs more does not fade the others.
    """
    a, b = np.full((20, 300, 3), 0.5), np.full((20, 300, 3), 0.5)
    a[:, :100] += 0.04
    a[:, 200:] -= 0.02
    a[19, 150] += 0.4
    path = tmp_path / "out.png"
    write_comparison(path, a, b, ("A", "B"))
    difference = read_picture(path).codes[32:52, 624:924] / 255
    # The largest factor of 1, 2, 5, 10, ... under 1 / 0.04 is 20.
    for row, column, level in (
        (10, 50, (0.8, 0.8 * 0.62, 0)),
        (19, 150, (1, 0.62, 0)),
        (10, 150, (0, 0, 0)),
        (10, 250, (0.4 * 0.34, 0.4 * 0.71, 0.4 * 0.91)),
    ):
        np.testing.assert_allclose(difference[row, column], level, atol=1 / 255)


@pytest.mark.parametrize(("width", "height", "zoom"), [(1, 2000, 1), (100, 150, 2), (8, 6, 38)])
def test_comparisons_are_enlarged_by_their_longer_side(
    tmp_path: Path, width: int, height: int, zoom: int
) -> None:
    a = np.linspace(0, 1, width * height * 3).reshape(height, width, 3)
    write_comparison(tmp_path / "out.png", a, a[::-1, ::-1], ("A", "B"))
    shown = read_picture(tmp_path / "out.png").codes
    column = max(300, zoom * width)  # the labels fit
    assert shown.shape == (zoom * height + 2 * 8 + 2 * 24, 3 * column + 4 * 8, 3)
    panel = shown[8 + 24 : 8 + 24 + zoom * height, 8 : 8 + zoom * width]
    np.testing.assert_array_equal(panel[::zoom, ::zoom], to_codes(a))


def test_exit_status(tmp_path: Path, right: Path, compare: Compare) -> None:
    a = save(tmp_path / "a.png", to_codes(1.05 * RIGHT))
    for tolerances, status in {
        "": 1,
        "--max 0.2": 0,
        "--max 1e-4": 1,
        "--ssim 0.9": 0,
        "--ssim 0.9 --max 1e-4": 1,
        "--ssim 1": 1,
        "--max -1": 2,
    }.items():
        assert compare(a, right, *tolerances.split())[0] == status, tolerances
    assert compare("only-one.png")[0] == 2
    assert compare(tmp_path, right, "-o", f"{tmp_path}/no-folder.png")[0] == 2


def test_command(tmp_path: Path, right: Path) -> None:
    status, told, error = run(save(tmp_path / "a.png", CODES[:, ::-1]), right)
    assert (status, error) == (1, "")
    figures_line, words, path = told.splitlines()
    assert figures_line.startswith("SSIM 0.")
    assert words == "A is mirrored: left and right are swapped."
    assert Path(path) == tmp_path / "a.compare.png"
    with Image.open(path) as comparison:
        assert comparison.size[0] == 3 * 300 + 4 * 8


def test_a_missing_package_does_not_pass_for_a_difference(tmp_path: Path, black: Path) -> None:
    (tmp_path / "PIL.py").write_text("raise ModuleNotFoundError('No module named PIL')")
    told = "No module named PIL; install it with pip install -e '.[reference]'\n"
    assert run(black, black, PYTHONPATH=str(tmp_path)) == (2, "", told)


@pytest.mark.parametrize(
    ("name", "note"),
    [
        ("a.jpg", ["A is a JPEG, which changes levels: save it as PNG."]),
        ("a.gif", ["A has a palette, of 256 colours at most: save it as RGB."]),
        ("a.png", []),
    ],
)
def test_a_format_is_noted_and_hides_nothing(
    tmp_path: Path, right: Path, compare: Compare, name: str, note: list[str]
) -> None:
    status, told, _ = compare(save(tmp_path / name, CODES[::-1]), right, "-o", tmp_path)
    words = "A is upside down: row 0 should be the top."
    assert (status, told[1:]) == (1, [*note, words, str(tmp_path / "a.compare.png")])


def test_transparency_that_was_not_meant(tmp_path: Path, right: Path, compare: Compare) -> None:
    clear = save(tmp_path / "a.png", np.dstack([CODES, 0 * CODES[:, :, 0]]))
    assert not read_picture(clear).codes.any()
    note = "A is transparent in places, which counts as black: save it as RGB."
    assert compare(clear, right)[1][1:-1] == [note, "A is black, and B is not."]


def test_long_names_stay_in_their_column(tmp_path: Path) -> None:
    black = np.zeros((40, 40, 3))
    write_comparison(tmp_path / "c.png", black, black + 0.5, ("x" * 200, "right"))
    gap = read_picture(tmp_path / "c.png").codes[:32, 328:336]  # panels 8 times as large
    assert (gap == 250).all()


def test_sizes_exit_1(tmp_path: Path, right: Path, compare: Compare) -> None:
    status, told, _ = compare(save(tmp_path / "a.png", CODES[:10]), right, "--max", "2")
    assert status == 1
    assert told[0].startswith("Different sizes")


@pytest.mark.parametrize("what", ["missing", "empty", "cut", "wrong length of a chunk"])
def test_unreadable(tmp_path: Path, right: Path, compare: Compare, what: str) -> None:
    whole, bad = right.read_bytes(), tmp_path / "a.png"
    before, after = whole.split(b"IDAT", 1)
    wrong = before[:-4] + b"\0\0\0\5IDAT" + after
    contents = {"empty": b"", "cut": whole[: len(whole) // 2], "wrong length of a chunk": wrong}
    if what in contents:
        bad.write_bytes(contents[what])
    status, told, error = compare(bad, right)
    assert (status, told, error.count("\n")) == (3, [], 1)
    assert error.startswith(f"{bad}: cannot be read: ")


def test_pipes_are_neither_read_nor_replaced(tmp_path: Path, black: Path) -> None:
    """In processes of their own: opening a pipe that none writes to waits without end."""
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    assert run(black, pipe) == (3, "", f"{pipe}: cannot be read: not a regular file\n")
    told = f"{pipe}: cannot be written: not a regular file\n"
    assert run(black, black, "-o", pipe) == (3, "", told)
    assert pipe.is_fifo()


def test_too_little_memory_is_told(
    black: Path, monkeypatch: pytest.MonkeyPatch, compare: Compare
) -> None:
    def fail(*_arguments: object) -> None:
        raise MemoryError

    monkeypatch.setattr("reference.compare.figures", fail)
    told = f"{black}: cannot be compared: not enough memory; compare a part\n"
    assert compare(black, black) == (3, [], told)


def test_grey_of_sixteen_bits_is_read(tmp_path: Path) -> None:
    path = save(tmp_path / "deep.png", np.array([[0, 257, 65535, 30000]], dtype=np.uint16))
    assert read_picture(path).codes[0].tolist() == [[k] * 3 for k in (0, 1, 255, 117)]


def deep_png() -> bytes:
    """A pixel of 16 bits in each of red, green and blue."""
    chunks = (
        (b"IHDR", struct.pack(">IIBBBBB", 1, 1, 16, 2, 0, 0, 0)),
        (b"IDAT", zlib.compress(b"\0" + 3 * b"\x12\x34")),
        (b"IEND", b""),
    )
    return PNG + b"".join(
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        for kind, data in chunks
    )


def deep_tiff(order: Literal["<", ">"]) -> bytes:
    """A pixel of 16 bits a channel, in either byte order."""
    data = io.BytesIO()
    tifffile.imwrite(data, np.array([[[1, 2, 3]]], dtype=np.uint16), byteorder=order)
    return data.getvalue()


DEEP = (deep_png(), deep_tiff("<"), deep_tiff(">"), b"P6 1 1 65535\n123456", b"P3 1 1 999\n1 2 3\n")


@pytest.mark.parametrize("content", DEEP, ids=("PNG", "TIFF", "big TIFF", "PPM", "plain PPM"))
def test_colours_of_sixteen_bits_are_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "deep"
    path.write_bytes(content)
    with Image.open(path) as image:
        image.load()  # Pillow reads it
    with pytest.raises(ValueError, match="more than 8 bits a channel; 8-bit RGB is needed"):
        read_picture(path)


@pytest.mark.parametrize("suffix", ["bmp", "gif", "png", "ppm", "tga", "tif"])
def test_eight_bits_are_read(tmp_path: Path, suffix: str) -> None:
    picture = np.array([[(1, 2, 3), (200, 100, 50)]], dtype=np.uint8)
    assert (read_picture(save(tmp_path / f"a.{suffix}", picture)).codes == picture).all()


def test_a_new_folder_is_made(tmp_path: Path, black: Path, compare: Compare) -> None:
    assert compare(black, black, "-o", f"{tmp_path}/new/folder/")[0] == 0
    assert (tmp_path / "new" / "folder" / "a.compare.png").exists()


@pytest.fixture
def hand_ins(tmp_path: Path) -> Path:
    """Hand-ins of three, in folders of their own, and beside them the right pictures."""
    others = tmp_path / "class"
    for folder in ("ada", "bob", "cy", "../right"):
        (others / folder).mkdir(parents=True)
    save(others / "ada" / "four-spheres.png", CODES)
    save(others / "bob" / "four-spheres.xml.png", CODES[::-1])
    save(others / "bob" / "four-spheres.jpg", CODES[:, ::-1])
    (others / "cy" / "four-spheres.png").write_bytes(b"no picture")
    save(others / "cy" / "other.png", CODES)
    save(tmp_path / "right" / "four-spheres.png", CODES)
    return others


@pytest.mark.parametrize("scene", [False, True])
def test_a_class(hand_ins: Path, compare: Compare, *, scene: bool) -> None:
    rights = hand_ins.with_name("right")
    if scene:
        (rights / "four-spheres.png").unlink()
        shutil.copy(SCENES / "four-spheres.xml", rights)
    status, lines, _ = compare(hand_ins, rights)
    assert status == 3
    words = [line.split()[0] for line in lines[:-1]]
    assert words == ["agrees", "differs", "differs", "unread", "unread"]
    assert "A is mirrored" in lines[1]
    assert "A is upside down" in lines[2]
    assert "has no picture of this name" in lines[4]
    assert lines[5] == "5 pictures: 1 agree, 2 differ, 2 cannot be compared"
    written = sorted(str(path.relative_to(hand_ins)) for path in hand_ins.rglob("*.compare.png"))
    assert written == ["bob/four-spheres.compare.png", "bob/four-spheres.xml.compare.png"]
    assert compare(hand_ins, rights) == (3, lines, "")  # comparisons are no hand-ins


def test_results_for_scripts(hand_ins: Path, compare: Compare, tmp_path: Path) -> None:
    others, scene = hand_ins / "bob", SCENES / "four-spheres.xml"
    save(others / "four-spheres.gif", CODES[::-1])
    status, told, _ = compare(others, scene, "--json", "-o", f"{tmp_path}/new/")
    found = json.loads("".join(told))
    names = ["picture", "right", "agrees", "ssim", "max", "diagnosis", "error"]
    assert (status, [list(one) for one in found]) == (1, 3 * [names])
    assert found[2]["diagnosis"] == "A is upside down: row 0 should be the top."
    assert (found[2]["agrees"], found[2]["right"], found[2]["error"]) == (False, str(scene), None)
    assert 0 < found[2]["ssim"] < 1
    assert 0 < found[2]["max"] <= 1
    assert sorted(path.name for path in (tmp_path / "new").iterdir()) == [
        "four-spheres.gif.compare.png",
        "four-spheres.jpg.compare.png",
        "four-spheres.xml.compare.png",
    ]
    status, told, _ = compare(others, scene, "--csv")
    rows = list(csv.DictReader(told))
    assert (status, [row["picture"] for row in rows]) == (1, [one["picture"] for one in found])


def test_many_are_shared_by_processes(tmp_path: Path, black: Path, compare: Compare) -> None:
    """In order, and those that cannot be read are told as ever."""
    folder = tmp_path / "many"
    folder.mkdir()
    for k in range(12):
        shutil.copy(black, folder / f"{k:02}.png")
    (folder / "05.png").write_bytes(b"no picture")
    status, lines, _ = compare(folder, black)
    assert status == 3
    for k, line in enumerate(lines[:12]):
        assert line.startswith("unread" if k == 5 else "agrees")
        assert f"{folder}/{k:02}.png: " in line


def test_a_scene_with_a_fault_is_told(tmp_path: Path, black: Path, compare: Compare) -> None:
    (tmp_path / "bad.xml").write_text("<scene/>")
    status, _, error = compare(black, tmp_path / "bad.xml")
    assert status == 3
    assert f"{tmp_path}/bad.xml:1" in error


@pytest.mark.parametrize(
    ("b", "output"),
    [("a.compare.png", []), ("b.png", ["a.png"]), ("b.png", ["link.png"]), ("b.png", ["./b.png"])],
)
def test_inputs_are_not_replaced(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, compare: Compare, b: str, output: list[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "link.png").symlink_to("b.png")
    for name, level in (("a.png", 0), (b, 200)):
        save(tmp_path / name, np.full((4, 4, 3), level, dtype=np.uint8))
    before = {path: path.read_bytes() for path in tmp_path.iterdir() if path.name != "link.png"}
    status, _, error = compare("a.png", b, *(["-o", *output] if output else []))
    assert status == 2
    assert "this would replace an input; choose another with -o" in error
    assert {path: path.read_bytes() for path in before} == before


def test_a_working_folder_that_is_gone(no_working_folder: str, compare: Compare) -> None:
    assert compare("a.png", "b.png") == (2, [], no_working_folder)
