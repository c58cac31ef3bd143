"""The converter's command line: what it writes, what it says, and what it leaves as it was."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest
from messages import told
from PIL import Image
from scene_files import ONE_SPHERE, codes, overflowing, small_one

from converters.to_mitsuba import main
from converters.variant import SCALAR, mi, use
from reference.command import HERE, own_scenes

PNG, EXR = b"\x89PNG", b"\x76\x2f\x31\x01"
CHECK = ["--check", "--variant", SCALAR]
RENDER = ["--render", "--variant", SCALAR]


def command(*arguments: str) -> list[str]:
    return [sys.executable, "-m", "converters.to_mitsuba", *arguments]


def run(
    *arguments: str, stdout: int = subprocess.PIPE, **environment: str
) -> subprocess.CompletedProcess[str]:
    """The converter as a process of its own."""
    return subprocess.run(
        command(*arguments),
        cwd=HERE.parent,
        env=os.environ | environment,
        stdout=stdout,
        stderr=subprocess.PIPE,
        text=True,
        timeout=120,
    )


@pytest.fixture
def small(tmp_path: Path) -> Path:
    """A scene that is soon rendered."""
    return small_one(tmp_path, "40 30")


def names(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


@pytest.mark.parametrize(
    ("flavour", "written"),
    [
        ([], {"small.mitsuba.xml"}),
        (["--flavour", "exact"], {"small.exact.mitsuba.xml"}),
        (
            ["--flavour", "stock-lights"],
            {"small.stock-lights.mitsuba.xml", "small.stock-lights.mitsuba.pfm"},
        ),
    ],
)
def test_writes_beside_the_scene_and_leaves_that_out_of_the_next(
    small: Path, capsys: pytest.CaptureFixture[str], flavour: list[str], written: set[str]
) -> None:
    for _ in range(2):
        assert main([*flavour, *map(str, sorted(small.parent.glob("*.xml")))]) == 0
        assert names(small.parent) == written | {"small.xml"}
    scene = small.with_name(max(written))
    assert ET.parse(scene).getroot().tag == "scene"
    assert f"{scene}: left out, for it is a converted scene\n" in capsys.readouterr().out


def test_writes_several_to_a_folder_that_is_made(tmp_path: Path) -> None:
    two = own_scenes()[:2]
    assert main([*map(str, two), "-o", f"{tmp_path}/made/"]) == 0
    assert names(tmp_path / "made") == {f"{path.stem}.mitsuba.xml" for path in two}


@pytest.mark.parametrize(
    ("name", "message"),
    [("bad.xml", ":1: light: "), (".", ": "), ("/", ": "), ("loop", ": "), ("none.xml", ": ")],
)
def test_what_cannot_be_read_is_told_and_spares_the_others(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str, message: str
) -> None:
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    (tmp_path / "bad.xml").write_text("<scene><camera/><image>8 8</image><light/></scene>")
    name = name if name in "./" else str(tmp_path / name)
    assert main([name, str(ONE_SPHERE), "-o", f"{tmp_path}/"]) == 1
    error = capsys.readouterr().err
    assert error.startswith(f"{name}{message}")
    assert error.count("\n") == 1
    assert names(tmp_path) == {"loop", "bad.xml", "one-sphere.mitsuba.xml"}


@pytest.mark.parametrize(
    ("what", "line"), [([], ".mitsuba.xml: stock flavour"), (CHECK, ": agrees")]
)
def test_names_that_are_not_text_are_escaped(small: Path, what: list[str], line: str) -> None:
    odd = small.rename(os.fsdecode(os.fsencode(small.parent) + b"/\xff\n.xml"))
    done = run(*what, str(odd), PYTHONIOENCODING="utf-8")
    # Dr.Jit says there if it has found no libLLVM.
    assert done.returncode == 0, done.stderr
    assert f"\\udcff\\n{line}\n" in done.stdout


@pytest.mark.parametrize(
    ("name", "reason"),
    [("missing/x.xml", "No such file or directory"), ("x" * 300, "File name too long")],
)
def test_what_cannot_be_written_is_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str, reason: str
) -> None:
    target = tmp_path / name
    assert main([str(ONE_SPHERE), "-o", str(target)]) == 1
    assert capsys.readouterr().err == f"{target}: cannot be written: {reason}\n"
    assert names(tmp_path) == set()


@pytest.mark.parametrize("what", [[], CHECK])
def test_no_one_reads_the_output(small: Path, unread: int, what: list[str]) -> None:
    target = small.with_name("written")
    done = run(*what, str(small), "-o", str(target), stdout=unread)
    # Dr.Jit says there if it has found no libLLVM.
    assert done.returncode == 0, done.stderr
    assert not re.search("Traceback|cannot be written", done.stderr)
    assert target.exists()


@pytest.mark.usefixtures("signals_heeded")
@pytest.mark.parametrize(
    "kind",
    [
        signal.SIGINT,
        pytest.param(signal.SIGTERM, marks=pytest.mark.slow),
        pytest.param(signal.SIGHUP, marks=pytest.mark.slow),
        pytest.param(signal.SIGQUIT, marks=pytest.mark.slow),
    ],
)
@pytest.mark.parametrize("when", ["numpy is imported", "the variant is probed"])
def test_an_interrupt(small: Path, kind: signal.Signals, when: str) -> None:
    process = subprocess.Popen(
        command("--check", str(small)),
        cwd=HERE.parent,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    about = Path(f"/proc/{process.pid}")
    while not (
        "_multiarray_umath" in (about / "maps").read_text()
        if when == "numpy is imported"
        else (about / f"task/{process.pid}/children").read_text()
    ):
        assert process.poll() is None
    process.send_signal(kind)
    out, err = process.communicate(timeout=30)
    assert (process.returncode, out, told(err)) == (130, "", "")
    assert list(small.parent.iterdir()) == [small]


@pytest.mark.parametrize("what", [[], RENDER, CHECK])
@pytest.mark.parametrize("kind", ["a pipe", "another format"])
def test_what_is_of_another_kind_stays(
    small: Path, capsys: pytest.CaptureFixture[str], what: list[str], kind: str
) -> None:
    other = small.with_name("other")
    if kind == "a pipe":
        os.mkfifo(other)
    else:
        other.write_text("<scene>")
    assert main([*what, str(small), "-o", str(other)]) == 1
    reason = "not a regular file" if kind == "a pipe" else "a file of another kind is there"
    assert capsys.readouterr().err == f"{other}: cannot be written: {reason}\n"
    assert other.is_fifo() or other.read_text() == "<scene>"
    assert names(small.parent) == {"other", "small.xml"}
    use()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["a.xml", "b.xml", "-o", "c.xml"], "several scenes need a folder"),
        (
            ["a/x.xml", "b/x.xml", "-o", "/tmp"],
            "/tmp/x.mitsuba.xml: a/x.xml and b/x.xml would both be written there",
        ),
        (["a.xml", "-o", "a.xml"], "would replace a scene"),
        (["--render", "a.exr", "-o", "a.png"], "would replace a scene"),
        (["a.xml", "--samples", "0"], "must be a whole number from 1 to 999999999, is '0'"),
        (["a.xml", "--check", "--samples", "4"], "it takes no --samples"),
        (["a.xml", "--check", "--render"], "not allowed with"),
        (["a.xml", "--flavour", "best"], "invalid choice: 'best'"),
        (["a.xml", "--variant", "nope"], "--variant is for --render and --check"),
        (["a.xml", "-o", ""], "argument -o/--output: the name is empty; name a file"),
        (["a.xml", ""], "argument SCENE.xml: the name is empty; name a file"),
        ([], "the following arguments are required: SCENE.xml"),
    ],
)
def test_wrong_usage_ends_with_status_2(
    arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit, match="2"):
        main(arguments)
    assert message in capsys.readouterr().err


@pytest.mark.parametrize("flavour", ["stock", "stock-lights", "exact"])
def test_converting_needs_no_mitsuba(tmp_path: Path, flavour: str) -> None:
    (tmp_path / "mitsuba.py").write_text("raise ImportError('not installed')")
    to = f"{tmp_path}/"
    done = run("--flavour", flavour, str(ONE_SPHERE), "-o", to, PYTHONPATH=str(tmp_path))
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.parametrize(
    ("option", "module", "stub", "message"),
    [
        ("--samples=4", "numpy", "", "No module named numpy; install it with pip install -e ."),
        ("--check", "numpy", "", "Mitsuba cannot run: No module named numpy; install it with"),
        ("--render", "mitsuba", "", "Mitsuba cannot run: No module named mitsuba; install it with"),
        ("--check", "skimage", "", "Mitsuba cannot run: No module named skimage; install it with"),
        # As drjit ends where a library of the system is missing.
        (
            "--check",
            "mitsuba",
            "try:\n    raise ImportError('libatomic.so.1: cannot open shared object file')\n"
            "except ImportError:\n    extension",
            "Mitsuba cannot run: libatomic.so.1: cannot open shared object file",
        ),
    ],
)
def test_what_is_not_installed_is_told(
    tmp_path: Path, option: str, module: str, stub: str, message: str
) -> None:
    missing = f"raise ModuleNotFoundError('No module named {module}')"
    (tmp_path / f"{module}.py").write_text(stub or missing)
    done = run(option, str(ONE_SPHERE), "-o", f"{tmp_path}/", PYTHONPATH=str(tmp_path))
    assert done.returncode == 1
    assert told(done.stderr).startswith(message)
    assert told(done.stderr).count("\n") == 1


@pytest.mark.parametrize("flavour", ["stock", "stock-lights", "exact"])
def test_render_writes_a_png_and_an_exr(small: Path, flavour: str) -> None:
    assert main([*RENDER, "--flavour", flavour, "--samples", "4", str(small)]) == 0
    stem = "small.mitsuba" if flavour == "exact" else f"small.{flavour}.mitsuba"
    assert names(small.parent) == {"small.xml", f"{stem}.png", f"{stem}.exr"}
    exr = np.array(mi.Bitmap(str(small.with_name(f"{stem}.exr"))))
    shown = np.asarray(Image.open(small.with_name(f"{stem}.png")))
    # Stock flavours are in square pixels.
    assert exr.shape == shown.shape == (30 if flavour == "exact" else 40, 40, 3)
    np.testing.assert_array_equal(shown, codes(exr))
    use()


@pytest.mark.parametrize(
    ("named", "written"),
    [
        ("x.png", {"x.png", "x.exr"}),
        ("x.exr", {"x.png", "x.exr"}),
        ("A.EXR", {"A.png", "A.EXR"}),
        ("room.v1", {"room.v1", "room.v1.exr"}),
    ],
)
def test_either_file_of_a_rendering_may_be_named(
    small: Path, named: str, written: set[str]
) -> None:
    assert main([*RENDER, str(small), "-o", str(small.with_name(named))]) == 0
    assert names(small.parent) == written | {"small.xml"}
    formats = sorted(small.with_name(name).read_bytes()[:4] for name in written)
    assert formats == [EXR, PNG]
    use()


@pytest.mark.parametrize(
    ("flavour", "line"),
    [
        ("exact", "one-sphere: agrees"),
        pytest.param(
            "stock", "one-sphere, diffuse light by stock plugins: agrees", marks=pytest.mark.slow
        ),
        pytest.param(
            "stock-lights",
            "one-sphere, stock-lights flavour: is similar\n  SSIM 0.99",
            marks=pytest.mark.slow,
        ),
    ],
)
def test_check_reports_and_writes_the_comparison(tmp_path: Path, flavour: str, line: str) -> None:
    done = run(
        "--check", "--flavour", flavour, str(small_one(tmp_path, "40 30")), "-o", f"{tmp_path}/",
        DRJIT_LIBLLVM_PATH="/nonexistent",
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert f"Mitsuba variant {SCALAR}: no usable libLLVM" in done.stdout
    assert line.replace("one-sphere", "small") in done.stdout
    middle = "" if flavour == "exact" else f".{flavour}"
    with Image.open(tmp_path / f"small{middle}.check.png") as picture:
        assert picture.width > 3 * 40


def test_check_ends_with_status_1_where_a_tolerance_is_broken(
    small: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("reference.check.MIN_SSIM", 2)
    assert main(["--check", str(small)]) == 1
    assert re.search("small: DIFFERS\n(.*\n)*.*SSIM 1.00000 is below 2", capsys.readouterr().out)
    assert small.with_name("small.check.png").exists()


def test_a_radiance_that_overflows_is_told_and_spares_the_others(
    small: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bright = overflowing(small)
    assert main(["--check", str(bright), str(small)]) == 1
    captured = capsys.readouterr()
    assert captured.err == (
        f"{bright}: Mitsuba's radiance is not finite;"
        " keep the colours and lights of the scene closer to 1\n"
    )
    assert "small: agrees" in captured.out


@pytest.mark.parametrize(
    ("error", "line"),
    [
        (RuntimeError("Mitsuba\n  is lost"), "Mitsuba is lost"),
        (RuntimeError(), "RuntimeError"),
        (MemoryError(), "not enough memory; make the image smaller"),
        (ChildProcessError(9), "not enough memory; make the image smaller"),
    ],
)
def test_what_mitsuba_stumbles_over_is_told_in_a_line(
    small: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    error: Exception,
    line: str,
) -> None:
    def fail(*_arguments: object) -> None:
        raise error

    monkeypatch.setattr("reference.check.check", fail)
    assert main(["--check", str(small)]) == 1
    assert capsys.readouterr().err == f"{small}: {line}\n"


@pytest.mark.parametrize("variant", ["nope", "scalar_spectral", "llvm_ad_mono", ""])
@pytest.mark.parametrize("what", ["--check", "--render"])
def test_variants_without_rgb_are_refused(
    small: Path, capsys: pytest.CaptureFixture[str], what: str, variant: str
) -> None:
    assert main([what, "--variant", variant, str(small)]) == 1
    error = capsys.readouterr().err
    wrong = f"Mitsuba cannot run: {variant or repr(variant)} is no RGB variant; choose one of "
    assert error.startswith(wrong)
    assert SCALAR in error
    assert "spectral" not in error.removeprefix(wrong)


NUMBERS = (
    r"\w+ would be (inf|[\d.]+e\+\d+), and Mitsuba's numbers end at 3\.4e\+38;"
    r" keep the numbers of the scene closer to 1"
)
ROWS = r"Mitsuba's pixels are square, and .* too many; make viewWidth larger or viewHeight smaller"


@pytest.mark.parametrize(
    ("flavour", "old", "new", "wrong"),
    [
        *(
            (flavour, old, new, NUMBERS)
            for flavour in ("stock", "exact")
            for old, new in (
                ("<position>3 5 4", "<position>1e70 5 4"),
                ("<viewPoint>5 4 3", "<viewPoint>5e69 4e69 1e70"),
                (".25 .5 .85", "1e308 .5 .85"),
                ("<center>0 0 0", "<center>-1e70 1e70 1e70"),
            )
        ),
        ("stock", "<viewWidth>2.5", "<viewWidth>1e-70", ROWS),
        ("stock-lights", "<viewWidth>2.5", "<viewWidth>1e-20", ROWS),
    ],
)
def test_what_mitsuba_could_not_hold_is_told(
    small: Path,
    capsys: pytest.CaptureFixture[str],
    flavour: str,
    old: str,
    new: str,
    wrong: str,
) -> None:
    text = small.read_text(encoding="utf-8")
    assert old in text
    small.write_text(text.replace(old, new), encoding="utf-8")
    assert main(["--flavour", flavour, str(small)]) == 1
    assert re.fullmatch(f"{small}: cannot be converted: {wrong}\n", capsys.readouterr().err)
    assert list(small.parent.iterdir()) == [small]
