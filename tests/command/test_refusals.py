"""Wrong usage of commands, and results that cannot be written: `refusals.txt` lists both."""

import os
import re
from pathlib import Path

import numpy as np
import pytest
from running import SCENE, write_ball

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

TABLE = Path(__file__).with_name("refusals.txt").read_text(encoding="utf-8")
CASES = re.findall(r"^\$ (.*)\n=> (\d) (.*)$", TABLE, re.MULTILINE)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Fill an empty folder with all files that `refusals.txt` lists, and make it current."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "sub").mkdir()
    (tmp_path / "empty").mkdir()
    for name in ("ball.xml", "other.xml", "sub/ball.xml", "ball", "-dashed.xml"):
        write_ball(Path(name), 8, 6)
    Path("eye-on-ball.xml").write_text(SCENE.format(8, 6).replace("0 0 5", "0 0 1"))
    write_png("a.png", np.zeros((6, 8, 3)))
    write_png("small.png", np.zeros((3, 4, 3)))
    Path("ball.zip").write_bytes(b"PK")
    for name in ("text.png", "no-camera.xml"):
        Path(name).write_text("<scene><image>8 6</image></scene>")
    Path("cut.png").write_bytes(b"\x89PNG\r\n\x1a\ncut")
    Path("empty.png").touch()
    Path("nothing").symlink_to("missing")
    Path("loop").symlink_to("loop")
    Path("link.xml").symlink_to("ball.xml")
    os.mkfifo("pipe")
    return tmp_path


def read_files(folder: Path) -> dict[str, bytes]:
    """Return the contents of all files below a folder, by path."""
    return {str(path): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_the_table_is_complete():
    assert len(CASES) == TABLE.count("\n$ ") == TABLE.count("\n=> ") > 60


@pytest.mark.parametrize(
    ("command", "status", "message"), CASES, ids=[command[:60] for command, *_ in CASES]
)
def test_a_command_is_refused(folder, capsys, monkeypatch, command, status, message):
    """The command prints one message, exits with a status, and changes no file."""
    before, (name, *arguments) = read_files(folder), command.split()
    monkeypatch.setattr("sys.argv", command.split())
    try:
        actual_status, printed = MAIN[name](arguments), capsys.readouterr().err
    except Failure as failure:
        actual_status, printed = failure.exit_status, f"{failure}\n"
    except SystemExit as usage_error:
        output, usage = capsys.readouterr()
        # The line with the message follows a summary of the usage.
        actual_status, printed = usage_error.code, f"{usage.rpartition(': error: ')[2]}{output}"
    assert (actual_status, printed) == (int(status), f"{message}\n")
    assert read_files(folder) == before
