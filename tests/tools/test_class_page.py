"""Pages that a teacher hands out, and the class list."""

import json
import shutil
from pathlib import Path

import pytest
from test_compare import CODES, SCENE, SCENES, save

from reference.compare import main


def test_a_page_for_each_student(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The pages name no other student; wrong sizes are shown; a class list names the missing."""
    for student, codes in (("03_chen", CODES[1::2, 1::2]), ("diaz", 255 - CODES)):
        save(tmp_path / "class" / student / "out" / "one-sphere.png", codes)
    (tmp_path / "class" / "03_chen" / "two-boxes.png").touch()
    names = tmp_path / "names.txt"
    names.write_text("Chen\n\nEvans\n")
    options = ["--students", str(names), "--html", f"{tmp_path / 'pages'}/", "--json"]
    assert main([str(tmp_path / "class"), str(SCENES), *options]) == 3
    students = {result["student"] for result in json.loads(capsys.readouterr().out)}
    assert students == {"", "Chen", "diaz", "Evans"}
    pages = {path.stem: path.read_text() for path in (tmp_path / "pages").rglob("*.html")}
    assert {*pages} == {"index", "Chen", "diaz", "Evans"}
    for name, page in pages.items():
        assert ("3 students" in page) == (name == "index")
        others = {"chen", "diaz", "evans"} - {name.lower()}
        assert name == "index" or not any(other in page.lower() for other in others)
    height, width, _ = CODES.shape
    size = f"The picture has {width // 2}x{height // 2} pixels in place of {width}x{height}."
    assert size in pages["Chen"]
    assert f"the right picture, {width} × {height}, stretched" in pages["Chen"]
    assert "cannot be read: the file is empty" in pages["Chen"]
    assert "2 are missing" in pages["Evans"]


def test_an_impossible_ssim_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    picture = save(tmp_path / "a.png", CODES)
    with pytest.raises(SystemExit):
        main([str(picture), str(SCENE), "--ssim", "2"])
    assert "argument --ssim: must be from 0 to 1, not 2" in capsys.readouterr().err


def test_the_picture_of_another_scene_is_recognised(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("one-sphere", "two-boxes"):
        shutil.copy(SCENES / f"{name}.xml", tmp_path)
    save(tmp_path / "class" / "ada" / "two-boxes.png", CODES)
    assert main([str(tmp_path / "class"), str(tmp_path)]) == 1
    assert "It is the picture of one-sphere.xml." in capsys.readouterr().out
