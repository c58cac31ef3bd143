"""Wrong usage of commands, and results that cannot be written.

Each command has its rows in both tables.
"""

import os
from pathlib import Path

import numpy as np
import pytest
from running import SCENE

from converters import to_mitsuba
from reference import certify, check, compare, report
from tracer import write_png
from tracer.command import cli
from tracer.command.failure import Failure

MAIN = {
    "tracer": cli.main,
    "to_mitsuba": to_mitsuba.main,
    "check": check.main,
    "certify": certify.main,
    "compare": compare.main,
    "report": report.main,
}

COUNT = "argument --samples: must be a whole number from 1 to 999999999, is"
SIZE = "argument --size: must be width and height in pixels, as 640x360 or 640, is"
PIXEL = "argument --pixel: must be column and row, as 160,90, is"
ERROR = "argument --error: must be a number or fraction above 0, is"
ONE = "expected one argument; a value that begins with - is joined to its option by ="
NEEDED = "the following arguments are required:"
INPUT = "-: a picture of standard input needs a name, with -o, and no --watch"
ONE_SCENE = "-o -: standard output takes the picture of one scene, and no --watch"
FOLDER = "several scenes need a folder; to have it made, end it in /"
BOTH = "would both be written there; do them one by one"
A_SCENE = "this would replace a scene; choose another with -o"
AN_INPUT = "this would replace an input; choose another with -o"
NOT_A_FILE = "not a regular file; for standard output, use -o -"

USAGE = [
    ("tracer", f"{NEEDED} SCENE.xml"),
    ("tracer -dashed.xml",
     f"{NEEDED} SCENE.xml; for the file named -dashed.xml, write ./-dashed.xml"),
    ("tracer ball.xml --samples 0", f"{COUNT} '0'"),
    ("tracer ball.xml --samples 1_0", f"{COUNT} '1_0'"),
    ("tracer ball.xml --samples \u0663", f"{COUNT} '\u0663'"),  # an Arabic 3
    ("tracer ball.xml --samples 9999999999", f"{COUNT} '9999999999'"),
    ("tracer ball.xml -o=", "argument -o/--output: the name is empty; name a file"),
    ("tracer ball.xml -o -b.png", f"argument -o/--output: {ONE}"),
    ("tracer ball.xml out.png", "out.png: a picture is no scene; to write it, use -o out.png"),
    ("tracer ball -o ball", f"ball: {A_SCENE}"),
    ("tracer ball.xml -o ball.v2.jpg",
     "-o ball.v2.jpg: pictures end in .png, .npy, .exr; name it ball.v2.png"),
    ("tracer ball.xml -o a.exr --format npy", "-o a.exr: pictures end in .npy; name it a.npy"),
    ("tracer ball.xml --format exr -o -", "-o -: an EXR file cannot go to standard output"),
    ("tracer ball.xml -o /dev/null", f"-o /dev/null: {NOT_A_FILE}"),
    ("tracer ball.xml -o pipe", f"-o pipe: {NOT_A_FILE}"),
    ("tracer ball.xml --size 0x10", f"{SIZE} '0x10'"),
    ("tracer ball.xml --size 1x2x3", f"{SIZE} '1x2x3'"),
    ("tracer -", INPUT),
    ("tracer - -o ball.png --watch", INPUT),
    ("tracer ball.xml other.xml -o -", ONE_SCENE),
    ("tracer ball.xml -o - --watch", ONE_SCENE),
    ("tracer ball.xml other.xml -o here.png", f"-o here.png: {FOLDER}"),
    ("tracer ball.xml ball.xml", f"ball.xml.png: ball.xml and ball.xml {BOTH}"),
    ("tracer ball.xml sub/ball.xml -o .", f"./ball.xml.png: ball.xml and sub/ball.xml {BOTH}"),
    ("tracer ball.xml --pixel=4,x", f"{PIXEL} '4,x'"),
    ("tracer ball.xml --pixel=-1,0", f"{PIXEL} '-1,0'"),
    ("tracer ball.xml --pixel -1,0", f"argument --pixel: {ONE}"),
    ("tracer ball.xml --pixel=4,4 -o x.png",
     "--pixel cannot be combined with -o, --format, --samples or --watch"),
    ("tracer ball.xml --pixel=4,4 --samples 4",
     "--pixel cannot be combined with -o, --format, --samples or --watch"),
    ("to_mitsuba", f"{NEEDED} SCENE.xml"),
    ("to_mitsuba --render a.exr -o a.png", f"a.exr: {A_SCENE}"),
    ("to_mitsuba ball.xml other.xml -o b.xml", f"-o b.xml: {FOLDER}"),
    ("to_mitsuba a.xml --samples 0", f"{COUNT} '0'"),
    ("to_mitsuba a.xml --variant nope",
     "--variant is for --render; converting needs no Mitsuba"),
    ("check", f"{NEEDED} SCENE.xml"),
    ("check ball.xml -o ball.xml", f"ball.xml: {A_SCENE}"),
    ("certify", f"{NEEDED} SCENE.xml"),
    ("certify ball.xml --error 0", f"{ERROR} '0'"),
    ("certify ball.xml --error 1/0", f"{ERROR} '1/0'"),
    ("certify ball.xml -o ball.xml", f"ball.xml: {AN_INPUT}"),
    ("compare a.png", f"{NEEDED} RIGHT"),
    ("compare a.png a.png --max -1", "argument --max: must be 0 or more, is -1"),
    ("compare a.png a.png -o a.png", f"a.png: {AN_INPUT}"),
    ("compare a.png ball.xml --html ball.xml", f"ball.xml: {AN_INPUT}"),
    ("compare sub ball.xml", "sub: a hand-in is a picture; give it first, then the scene"),
    ("compare empty ball.xml", "empty: contains no pictures"),
    ("report ball.xml -o link.xml", f"link.xml: {AN_INPUT}"),
]  # fmt: skip


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Change to a folder that contains what the commands of both tables read."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "sub").mkdir()
    (tmp_path / "empty").mkdir()
    for name in ("ball.xml", "other.xml", "sub/ball.xml", "ball", "-dashed.xml"):
        Path(name).write_text(SCENE.format(8, 6))
    write_png("a.png", np.zeros((6, 8, 3)))
    Path("text.png").write_text("<scene/>")
    Path("nothing").symlink_to("missing")
    Path("link.xml").symlink_to("ball.xml")
    os.mkfifo("pipe")
    return tmp_path


def contents(folder: Path) -> dict[str, bytes]:
    """Return the contents of all files in a folder, by name."""
    return {str(path): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.mark.parametrize(("command", "message"), USAGE, ids=[command for command, _ in USAGE])
def test_wrong_usage(folder, capsys, monkeypatch, command, message):
    before, (name, *arguments) = contents(folder), command.split()
    monkeypatch.setattr("sys.argv", command.split())
    with pytest.raises(SystemExit, match="2"):
        MAIN[name](arguments)
    out, err = capsys.readouterr()
    assert (out, err.splitlines()[-1].partition(": error: ")[2]) == ("", message)
    assert contents(folder) == before


LONG = "x" * 300
MISSING, NO_FOLDER = "No such file or directory", "Not a directory"
EXISTING = "a file of another kind is there"

UNWRITTEN = [
    ("tracer ball.xml -o missing/a.png", 1, "missing/a.png", MISSING),
    ("tracer ball.xml -o ball.xml/a.png", 1, "ball.xml/a.png", NO_FOLDER),
    ("tracer ball.xml -o ball.xml/", 1, "ball.xml/", "File exists"),
    ("tracer ball.xml -o ball.xml/deep/", 1, "ball.xml/deep/", NO_FOLDER),
    ("tracer ball.xml -o nothing/", 1, "nothing/", "File exists"),
    (f"tracer ball.xml -o {LONG}.png", 1, f"{LONG}.png", "File name too long"),
    ("tracer ball.xml -o text.png", 1, "text.png", EXISTING),
    ("tracer ball.xml -o missing/a.npy", 1, "missing/a.npy", MISSING),
    ("tracer ball.xml -o missing/a.exr", 1, "missing/a.exr", MISSING),
    ("to_mitsuba ball.xml -o text.png", 1, "text.png", EXISTING),
    ("to_mitsuba --render ball.xml -o text.png", 1, "text.png", EXISTING),
    ("to_mitsuba ball.xml -o ball.xml/", 1, "ball.xml/", "File exists"),
    ("check ball.xml -o ball.xml/a.png", 1, "ball.xml/a.png", NO_FOLDER),
    ("certify ball.xml -o missing/a.png", 3, "missing/a.png", MISSING),
    ("compare a.png ball.xml -o text.png", 3, "text.png", EXISTING),
    ("compare a.png a.png --html text.png", 3, "text.png", EXISTING),
    ("report ball.xml -o pipe", 1, "pipe", "not a regular file"),
]


@pytest.mark.parametrize(
    ("command", "status", "name", "reason"), UNWRITTEN, ids=[row[0][:60] for row in UNWRITTEN]
)
def test_results_that_cannot_be_written(folder, capsys, command, status, name, reason):
    before, (main, *arguments) = contents(folder), command.split()
    try:
        result = MAIN[main](arguments), capsys.readouterr().err
    except Failure as failure:
        result = failure.status, f"{failure}\n"
    option = "--html" if "--html" in command else "-o"
    message = f"{name}: cannot be written: {reason}; choose another with {option}\n"
    assert result == (status, message)
    assert contents(folder) == before
