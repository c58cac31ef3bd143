"""The comparison of pictures: its metrics, the formats that it reads, and its command."""

import csv
import errno
import json
import os
import random
import re
import shutil
import signal
import sys
import time
from collections import Counter
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
import tifffile
from PIL import Image
from running import peak_memory, run, start_process, workers_of
from skimage.metrics import structural_similarity

from reference.command import SCENES
from reference.compare import compare_hand_in, main
from reference.figures import get_largest_difference, measure_differences, write_comparison
from reference.handins.diagnosis import Reference
from reference.handins.formula_functions import Array
from reference.handins.renderer import MistakeRenderer
from reference.handins.results import Result, format_csv
from reference.handins.workers import map_in_workers
from reference.pictures import Codes, read_picture
from tracer import load_scene, render, to_codes
from tracer.command.failure import Failure

Compare = Callable[..., tuple[int, list[str], str]]
SCENE = SCENES / "one-sphere.xml"
RIGHT = render(load_scene(SCENE))
CODES = to_codes(RIGHT)


def save(path: Path, image: Codes, **options: object) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(np.ascontiguousarray(image)).save(path, **options)
    return path


@pytest.fixture
def compare(capsys: pytest.CaptureFixture[str]) -> Compare:
    """Run the command in this process; return its exit status, lines of output, and errors."""

    def call(*arguments: str | Path) -> tuple[int, list[str], str]:
        try:
            status = main([*map(str, arguments)])
        except SystemExit as wrong:
            status = int(wrong.code or 0)
        except Failure as failure:
            status = failure.exit_status
            print(failure, file=sys.stderr)
        captured = capsys.readouterr()
        return status, captured.out.splitlines(), captured.err

    return call


def test_metrics_agree_with_other_computations() -> None:
    """Four of 100 pixels differ, by 0.5 in one channel; two of them are excluded."""
    a, b = np.full((10, 10, 3), 0.25), np.full((10, 10, 3), 0.25)
    a[0, :4, 1] += 0.5
    mask = np.zeros((10, 10), dtype=np.bool_)
    mask[0, :2] = True
    result = measure_differences(a, b, mask)
    assert (result.max, result.median, result.differing_count) == (0.5, 0.0, 2)
    assert result.rmse == pytest.approx(0.5 * np.sqrt(2 / 294), rel=1e-12)  # of 98 * 3 values
    assert result.percentile == 0.5
    shown = a ** (1 / 2.2), b ** (1 / 2.2)
    right = structural_similarity(*shown, channel_axis=2, data_range=1.0)
    assert measure_differences(a, b).ssim == pytest.approx(right, abs=1e-6)
    for wrong, words in ((a[1:], "shapes differ"), (np.nan * a, "not finite")):
        with pytest.raises(ValueError, match=words):
            measure_differences(a, wrong)
    with pytest.raises(ValueError, match="every pixel is excluded"):
        measure_differences(a, a, np.ones((10, 10), dtype=np.bool_))


@pytest.mark.parametrize("width", [300, 400])
def test_comparison_shows_sign_and_size(width: int, tmp_path: Path) -> None:
    """The first picture is brighter by 0.04 on the left, and darker by 0.02 on the right.

    A single pixel that differs more does not fade the others.  The pictures are not enlarged.
    """
    a, b = np.full((20, width, 3), 0.5), np.full((20, width, 3), 0.5)
    a[:, :100] += 0.04
    a[:, 200:] -= 0.02
    a[19, 150] += 0.4
    difference, labels = get_largest_difference(a - b), ("A" * 200, "B")
    write_comparison(tmp_path / "out.png", (to_codes(a), to_codes(b)), difference, labels)
    shown = read_picture(tmp_path / "out.png").codes
    # A long name stays in its column.
    assert (shown[:32, width + 8 : width + 16] == 250).all()
    # The largest factor of 1, 2, 5, 10, ... under 1 / 0.04 is 20.
    orange, blue = np.array((1, 0.62, 0)), np.array((0.34, 0.71, 0.91))
    places = (10, 50, 0.8 * orange), (19, 150, orange), (10, 150, 0 * blue), (10, 250, 0.4 * blue)
    for row, column, light in places:
        color = shown[32 + row, 2 * width + 24 + column] / 255
        np.testing.assert_allclose(color, light, atol=1 / 255)


# A PNG of one pixel, with the levels 1, 2 and 3 of 65535.
DEEP_PNG = bytes.fromhex(
    "89504e470d0a1a0a0000000d4948445200000001000000011002000000c0e78f9d000000"
    "0f49444154789c636060646062600600001500073c77f4280000000049454e44ae426082"
)


def test_sixteen_bits_count_as_eight(tmp_path: Path) -> None:
    """The upper 8 of 16 bits are compared: the levels 1, 2 and 3 of 65535 become black."""
    path, contents = tmp_path / "deep", [DEEP_PNG, b"P6 1 1 65535\n123456", b"P3 1 1 999\n1 2 3\n"]
    for order in ("<", ">"):
        tifffile.imwrite(path, np.array([[[1, 2, 3]]], dtype=np.uint16), byteorder=order)
        contents.append(path.read_bytes())
    for content in contents:
        path.write_bytes(content)
        picture = read_picture(path)
        assert picture.codes[0, 0].tolist() in (
            [0, 0, 0],
            [0, 1, 1],
            [ord("1"), ord("3"), ord("5")],
        )
        assert picture.format_noise == 1
        assert "more than 8 bits per channel" in picture.note


def test_formats(tmp_path: Path) -> None:
    for suffix in ("bmp", "png", "ppm", "tga", "tif", "webp"):
        lossless = {"lossless": True} if suffix == "webp" else {}
        picture = read_picture(save(tmp_path / f"a.{suffix}", CODES, **lossless))
        assert (picture.codes == CODES).all()
        assert (picture.format_noise, picture.note) == (0, "")
    for suffix, word in (("webp", "WEBP"), ("jpg", "JPEG"), ("gif", "palette")):
        picture = read_picture(save(tmp_path / f"b.{suffix}", CODES))
        assert picture.format_noise
        assert word in picture.note
    grey = read_picture(save(tmp_path / "g.png", np.array([[0, 257, 65535]], dtype=np.uint16)))
    assert grey.codes[0, :, 1].tolist() == [0, 1, 255]
    clear = read_picture(save(tmp_path / "c.png", np.dstack([CODES, 0 * CODES[:, :, 0]])))
    assert not clear.codes.any()
    assert "transparent" in clear.note


def test_tolerances(tmp_path: Path, compare: Compare) -> None:
    a = save(tmp_path / "a.png", to_codes(1.05 * RIGHT))
    statuses = {"--max 0.2": 0, "--max 1e-4": 1, "--ssim 0.9": 0, "--ssim 0.9 --max 1e-4": 1}
    for tolerances, status in (statuses | {"": 1, "--max -1": 2}).items():
        assert compare(a, SCENE, *tolerances.split())[0] == status, tolerances
    # A difference of exactly the tolerance is permitted.
    right = save(tmp_path / "b.png", CODES)
    assert compare(right, SCENE, "--max", "0", "--ssim", "1")[0] == 0


def test_a_single_comparison_shows_a_progress_bar(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, compare: Compare
) -> None:
    def compare_slowly(*arguments: object) -> object:
        time.sleep(1.6)
        return compare_hand_in(*arguments)

    monkeypatch.setattr("reference.compare.compare_hand_in", compare_slowly)
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    status, _, error = compare(save(tmp_path / "a.png", CODES), SCENE)
    assert (status, "0 of 1 pictures [00:01" in error) == (0, True)


def test_one_picture(tmp_path: Path, compare: Compare) -> None:
    right, dark = save(tmp_path / "b.png", CODES), save(tmp_path / "a.png", to_codes(RIGHT / 2))
    assert compare(right, SCENE)[:2] == (0, compare(right, right)[1])
    assert compare(dark, SCENE)[1][1] == compare(dark, right)[1][1]
    assert compare(dark, right)[1][1] == "Light is half as bright as it should be."
    assert compare(dark, right, "-o", tmp_path / "new" / "c.png")[0] == 1
    assert (tmp_path / "new" / "c.png").exists()


@pytest.mark.slow
def test_a_large_picture_is_compared_in_limited_memory(tmp_path: Path) -> None:
    """A JPEG of the maximum size is compared and shown; its mistake is unknown."""
    scene, size = tmp_path / "large.xml", "<image>3000 3000</image>"
    scene.write_text(SCENE.read_text().replace("<image>300 300</image>", size))
    codes = to_codes(render(load_scene(scene)))
    codes[1100:1400, 1200:1500] //= 2
    picture = save(tmp_path / "a.jpg", codes, quality=90)
    arguments = picture, scene, "-o", tmp_path / "out.png", "--html", tmp_path / "page.html"
    # With this tolerance, the exit status is 0.
    command = sys.executable, "-m", "reference.compare", *map(str, arguments), "--max", "1"
    assert peak_memory(*command) < 600  # MB


def test_a_large_jpeg_is_searched_in_a_sample(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Complete pictures are compressed at most twice, and rendered at most once."""
    max_pixels, complete, evaluate = 4096, Counter[str](), MistakeRenderer.evaluate
    codes = CODES.copy()
    codes[110:140, 120:150] //= 2
    picture = read_picture(save(tmp_path / "a.jpg", codes, quality=90))

    def count_and_reencode(codes: Codes) -> Codes:
        complete["compressed"] += codes[:, :, 0].size > max_pixels
        return picture.reencode(codes)

    def count_and_evaluate(*arguments: Any, **options: Any) -> Array:
        _, formula_sets, pixels, *_ = arguments
        complete["rendered"] += len(formula_sets) * (len(pixels) > max_pixels)
        return evaluate(*arguments, **options)

    monkeypatch.setattr("reference.handins.search.MAX_PIXELS", max_pixels)
    monkeypatch.setattr(MistakeRenderer, "evaluate", count_and_evaluate)
    diagnosis = Reference(load_scene(SCENE)).diagnose(picture._replace(reencode=count_and_reencode))
    assert diagnosis.kind == "unknown"
    assert (complete["compressed"] <= 2, complete["rendered"] <= 1) == (True, True)


@pytest.mark.parametrize(("share", "status"), [(0.008, 0), (0.02, 1)])
def test_few_pixels_may_be_one_level_off(
    tmp_path: Path, compare: Compare, share: float, status: int
) -> None:
    """Rounding explains differences of one level in at most one in a hundred pixels."""
    codes = CODES.copy()
    codes[np.random.default_rng(1).random(codes.shape[:2]) < share] ^= 1
    assert compare(save(tmp_path / "a.png", codes), SCENE)[0] == status


@pytest.fixture
def hand_ins(tmp_path: Path) -> Path:
    """The folder of a class with right, wrong and unreadable pictures, and with missing ones."""
    folder, level = tmp_path / "class", CODES.copy()
    level[140, 140:160] += 1
    save(folder / "ada" / "one-sphere.xml.png", CODES)
    save(folder / "bob" / "deep" / "17_ONE-SPHERE.PNG", level)
    save(folder / "bob" / "one-sphear.png", CODES)
    save(folder / "cy" / "one-sphere.png", CODES[:, ::-1])
    save(folder / "cy" / "one-sphere.compare.png", CODES)
    (folder / "di").mkdir()
    for name in ("__MACOSX/one-sphere.png", ".git/one-sphere.png", "cy/._one-sphere.png"):
        save(folder / name, CODES)
    (folder / "cy" / "two-boxes.png").write_bytes(b"no picture")
    (tmp_path / "right").mkdir()
    for name in ("one-sphere", "two-boxes", "room"):
        shutil.copy(SCENES / f"{name}.xml", tmp_path / "right")
    for name in ("room.xml.png", "room.check.png", "room.mitsuba.xml"):  # computed from the scene
        (tmp_path / "right" / name).touch()
    return folder


def test_a_class(hand_ins: Path, compare: Compare) -> None:
    right = hand_ins.with_name("right")
    before = sorted(hand_ins.rglob("*"))
    status, lines, error = compare(hand_ins, right)
    assert (status, error, sorted(hand_ins.rglob("*"))) == (3, "", before)
    words = [line.split()[0] for line in lines]
    expected = ["agrees", "agrees", "unread", "differs", "unread"]
    assert words == [*expected, *["missing"] * 5, "5"]
    assert lines[2].endswith("has this name; did you mean one-sphere.xml?")
    assert "The picture is mirrored" in lines[3]
    assert lines[5] == "missing  ada/two-boxes: no picture of this scene"
    assert lines[7] == "missing  di/one-sphere: no picture of this scene"
    assert lines[9] == f"missing  {right}/room.xml: nobody has handed in a picture of it"
    assert lines[10] == (
        "5 pictures: 2 agree, 1 differs, 2 cannot be compared; 4 are missing;"
        " scenes that nobody has handed in: 1"
    )


def test_the_page_and_the_tables_of_a_class(hand_ins: Path, compare: Compare) -> None:
    right, out, page = (hand_ins.with_name(name) for name in ("right", "out", "page.html"))
    _, lines, _ = compare(hand_ins, right, "--json", "-o", f"{out}/", "--html", page)
    shown = page.read_text()
    mirrored = "The picture is mirrored: left and right are swapped."
    assert re.findall("[✓✗] ([^<]*)</span></a>", shown) == ["agrees", "agrees", mirrored]
    titles = ["student", "right", "one-sphere", "two-boxes"]
    assert re.findall("<th .*?>([^<]+)", shown) == titles
    assert re.findall("<td>(\\d) of 2", shown) == ["1", "1", "0", "0"]
    assert f"<h2>Mistakes</h2>\n<p>1 student: {mirrored}</p>" in shown
    assert "not matched: one-sphear.png" in shown
    assert "<p>room.xml: nobody has handed in a picture of it</p>" in shown
    assert str(hand_ins.parent) not in shown
    assert shown.count("<details>") == 2  # the pictures that agree
    results = json.loads("".join(lines))
    assert [one["kind"] for one in results[:4]] == ["identical", "rounding", None, "mirrored"]
    assert [one["student"] for one in results[3:6]] == ["cy", "cy", "ada"]
    assert [one["scene"] for one in results[3:6]] == ["one-sphere", "two-boxes", "two-boxes"]
    assert [*out.rglob("*.png")] == [out / "cy" / "one-sphere.png.compare.png"]
    assert results[3]["comparison"] == str(out / "cy" / "one-sphere.png.compare.png")
    x, y = results[3]["worst"]
    size = np.abs(CODES[:, ::-1].astype(int) - CODES).max(axis=2)
    assert (results[3]["differing"], size[y, x]) == ((size > 0).sum(), size.max())
    rows = [*csv.DictReader(compare(hand_ins, right, "--csv")[1])]
    assert rows[3]["worst"] == f"{x},{y}"
    assert [row["kind"] for row in rows] == [one["kind"] or "" for one in results]


def test_harmful_names_and_sizes(tmp_path: Path, compare: Compare) -> None:
    """Names that are not UTF-8, or that a spreadsheet would run; a picture larger than memory."""
    for name in (b"one-sphere-\xff", b"=cmd|one-sphere", b"one-sphere-\x1b[2J"):
        save(tmp_path / "class" / f"{os.fsdecode(name)}.png", CODES)
    Image.new("1", (13000, 13000)).save(tmp_path / "class" / "huge_one-sphere.png")
    page = tmp_path / "page.html"
    status, lines, error = compare(tmp_path / "class", SCENE, "--csv", "--html", page)
    assert (status, error) == (3, "")
    assert "\x1b" not in "".join(lines)
    students = sorted(row["student"] for row in csv.DictReader(lines))
    assert students == ["'=cmd|", "\\udcff", "\\x1b[2j", "huge"]
    assert any("has 13000x13000 pixels; at most 9 million can be compared" in x for x in lines)
    assert "one-sphere-\\udcff.png" in page.read_text()


@pytest.mark.parametrize("first_character", ["=", "+", "-", "@"])
def test_no_cell_of_a_table_is_run_by_a_spreadsheet(first_character: str) -> None:
    student = f"{first_character}SUM(A1)"
    table = format_csv([Result(student=student, scene="", picture=None, right=None)])
    assert [row["student"] for row in csv.DictReader(table.splitlines())] == [f"'{student}"]


@pytest.mark.parametrize(
    ("error", "reason"),
    [
        (MemoryError(), "not enough memory; compare a part"),
        (ZeroDivisionError("1 / 0"), "ZeroDivisionError: 1 / 0; this is a bug, please report it"),
    ],
)
def test_bugs_and_lack_of_memory_have_different_messages(
    error: Exception, reason: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, compare: Compare
) -> None:
    monkeypatch.setattr("reference.compare.compare_codes", Mock(side_effect=error))
    right = save(tmp_path / "a.png", CODES)
    assert compare(right, SCENE) == (3, [], f"{right}: cannot be compared: {reason}\n")


def kill_worker(folder: Path, job: int) -> int:
    """Kill the worker process: always for job 5, and the first time for job 7."""
    is_first_time = not (folder / str(job)).exists()
    (folder / str(job)).touch()
    if job == 5 or (job == 7 and is_first_time):
        os.kill(os.getpid(), signal.SIGKILL)
    return 10 * job


def test_only_a_job_that_ends_two_workers_is_lost(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    results = [-5 if job == 5 else 10 * job for job in range(10)]
    compute = partial(kill_worker, tmp_path)
    assert sorted(map_in_workers(compute, range(10), lambda job: -job)) == sorted(results)

    no_process = Mock(side_effect=OSError(errno.EAGAIN, "no process"))
    monkeypatch.setattr("reference.handins.workers.WorkerPool.submit", no_process)
    assert sorted(map_in_workers(str, range(10), str)) == [*map(str, range(10))]


def test_workers_end_with_a_command_that_is_killed() -> None:
    """Workers end at any moment, although they keep their ends of the command's pipes open."""
    script = "import time; from reference.handins.workers import map_in_workers"
    process = start_process(
        python=("-c", f"{script}; [*map_in_workers(time.sleep, [600] * 8, str)]")
    )
    while len(workers_of(process)) < 3:  # two, and Python's resource tracker
        assert process.poll() is None
    time.sleep(2 * random.random())
    process.kill()
    assert process.communicate(timeout=60) == ("", "")


def test_pipes_are_neither_read_nor_replaced(tmp_path: Path) -> None:
    """The command runs in separate processes: opening a pipe without a writer waits for ever."""
    pipe, right = tmp_path / "pipe", save(tmp_path / "a.png", CODES)
    os.mkfifo(pipe)
    unread = f"{pipe}: cannot be read: not a regular file\n"
    unwritten = f"{pipe}: cannot be written: not a regular file; choose another with -o\n"
    for arguments, error in (((right, pipe), unread), ((right, right, "-o", pipe), unwritten)):
        assert run(*arguments, python=("-m", "reference.compare")) == (3, "", error)
    assert pipe.is_fifo()
