"""The command that certifies: what it prints, writes and refuses."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scene_files import small

from reference.certify import judgement, main
from reference.judges.certificate import certify
from tracer import Camera, render, save_scene, to_codes, write_png


@pytest.fixture
def room(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    save_scene(small("room", 32, 18), path := tmp_path / "room.xml")
    return path


def run(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, list[str], str]:
    status = main(arguments)
    printed = capsys.readouterr()
    return status, printed.out.splitlines(), printed.err


@pytest.mark.usefixtures("room")
def test_a_picture_is_written_with_its_bounds(capsys: pytest.CaptureFixture[str]) -> None:
    status, lines, _ = run(capsys, "room.xml", "--error", "1/64", "--bounds", "bounds.png")
    made = certify(small("room", 32, 18), 1 / 64)
    assert status == 0
    within, certain, last = lines
    assert within.startswith("576 of 576 pixels are within 1/64; all within 0.01")
    assert certain.startswith(f"{made.is_certain.sum()} of 576 pixels have certain codes, ")
    assert last.startswith(f"room.xml.certified.png: {made.cells} cells in ")
    with Image.open("room.xml.certified.png") as picture:
        np.testing.assert_array_equal(np.asarray(picture), made.codes)
    with Image.open("bounds.png") as bounds:
        assert bounds.width > 500


@pytest.mark.usefixtures("room")
def test_a_picture_is_judged(capsys: pytest.CaptureFixture[str]) -> None:
    arguments = "room.xml", "-o", "out.png", "--codes", "--judge"
    assert run(capsys, *arguments, "room.png")[0] == 3
    run(capsys, "room.xml", "-o", "room.png", "--codes")
    assert run(capsys, *arguments, "room.png")[1][2] == "room.png: no code is certainly wrong"
    codes = np.array(Image.open("room.png"))
    codes[7, 5, 1] -= 60
    Image.fromarray(codes).save("room.png")
    status, lines, _ = run(capsys, *arguments, "room.png")
    assert status == 1
    told = "room.png: 1 of 1728 codes are certainly wrong, by up to 60, at 5,7, where G is "
    assert lines[2] == f"{told}{codes[7, 5, 1]} and must be {codes[7, 5, 1] + 60}"


def test_one_sample_a_pixel_is_wrong_at_edges() -> None:
    scene = small("room", 32, 18)
    made = certify(scene, 1 / 1024)
    few, many = (judgement(made, to_codes(render(scene, n)))[0] for n in (1, 1024))
    assert many < few / 20


@pytest.mark.parametrize(
    ("arguments", "status", "told"),
    [
        ("none.xml", 3, "none.xml: cannot be read: No such file or directory"),
        ("on.xml", 3, "on.xml: cannot be certified: the eye is on a surface; move it off"),
        ("room.xml --judge small.png", 3, "its size is 4 x 3, the scene's 32 x 18"),
        ("room.xml --error 0", 2, "--error: must be a number or fraction above 0, is '0'"),
        ("room.xml --error 1/0", 2, "must be a number or fraction above 0, is '1/0'"),
        ("room.xml -o room.xml", 2, "this would replace an input; choose another with -o"),
        ("room.xml -o a.png --bounds a.png", 2, "one file cannot be both"),
        ("room.xml -o none/a.png", 3, "none/a.png: cannot be written: No such file or directory"),
        ("room.xml --bounds room.xml/b", 3, "room.xml/b: cannot be written: Not a directory"),
    ],
)
def test_what_is_refused(
    arguments: str, status: int, told: str, room: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_png("small.png", np.zeros((3, 4, 3)))
    save_scene(replace(small("one-sphere"), camera=Camera(view_point=(0, 0, 1))), Path("on.xml"))
    try:
        ended = main(arguments.split())
    except SystemExit as usage:
        ended = usage.code
    error = capsys.readouterr().err
    assert ended == status
    assert told in error
    assert status == 2 or error.count("\n") == 1
    assert not list(room.parent.glob(".*"))
