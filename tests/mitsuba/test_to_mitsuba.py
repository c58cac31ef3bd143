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

from converters.mitsuba_xml import WRITTEN
from converters.to_mitsuba import main
from converters.variant import SCALAR, mi, use
from reference.command import HERE, own_scenes
from tracer.picture.png import PNG

EXR = b"\x76\x2f\x31\x01"


def command(*arguments: str) -> list[str]:
    return [sys.executable, "-m", "converters.to_mitsuba", *arguments]


def run(*arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """The converter as a process of its own."""
    return subprocess.run(
        command(*arguments),
        cwd=HERE.parent,
        env=os.environ | environment,
        capture_output=True,
        text=True,
        timeout=120,
    )


@pytest.fixture
def small(tmp_path: Path) -> Path:
    """A scene that is soon rendered."""
    return small_one(tmp_path, "40 30")


@pytest.mark.parametrize(
    ("flavour", "names"),
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
    small: Path, capsys: pytest.CaptureFixture[str], flavour: list[str], names: set[str]
) -> None:
    for _ in range(2):
        scenes = [str(path) for path in sorted(small.parent.glob("*.xml"))]
        assert main([*flavour, *scenes]) == 0
        assert {path.name for path in small.parent.iterdir()} == names | {"small.xml"}
    written = small.with_name(max(names))
    assert ET.parse(written).getroot().tag == "scene"
    assert f"{written}: left out, for it is a converted scene\n" in capsys.readouterr().out


def test_writes_several_to_a_folder_that_is_made(tmp_path: Path) -> None:
    two = own_scenes()[:2]
    assert main([*map(str, two), "-o", f"{tmp_path}/made/"]) == 0
    names = {path.name for path in (tmp_path / "made").iterdir()}
    assert names == {f"{path.stem}.mitsuba.xml" for path in two}


def test_a_bad_scene_is_told_and_spares_the_others(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bad = tmp_path / "bad.xml"
    bad.write_text("<scene><camera/><image>8 8</image><light/></scene>")
    assert main([str(bad), str(ONE_SPHERE), "-o", f"{tmp_path}/"]) == 1
    error = capsys.readouterr().err
    assert error.startswith(f"{bad}:1: light: ")
    assert (tmp_path / "one-sphere.mitsuba.xml").exists()
    assert not (tmp_path / "bad.mitsuba.xml").exists()


@pytest.mark.parametrize("name", [".", "/", "loop"])
def test_a_path_that_is_no_file_spares_the_others(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    name = str(tmp_path / name) if name == "loop" else name
    assert main([name, str(ONE_SPHERE), "-o", f"{tmp_path}/"]) == 1
    error = capsys.readouterr().err
    assert error.startswith(f"{name}: ")
    assert error.count("\n") == 1
    assert (tmp_path / "one-sphere.mitsuba.xml").exists()


@pytest.mark.parametrize(
    ("what", "line"),
    [([], ".mitsuba.xml: stock flavour"), (["--check", "--variant", SCALAR], ": agrees")],
)
def test_names_that_are_not_text_are_escaped(small: Path, what: list[str], line: str) -> None:
    odd = small.rename(os.fsdecode(os.fsencode(small.parent) + b"/\xff\n.xml"))
    done = run(*what, str(odd), PYTHONIOENCODING="utf-8")
    # Dr.Jit says there if it has found no libLLVM.
    assert done.returncode == 0, done.stderr
    assert f"\\udcff\\n{line}\n" in done.stdout


def test_names_that_the_terminal_cannot_show(small: Path) -> None:
    target = small.with_name("\u00e4.xml")
    done = run(str(small), "-o", str(target), PYTHONIOENCODING="ascii")
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout == f"{small.parent}/\\xe4.xml: stock flavour\n"
    assert target.exists()


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
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("what", [[], ["--check", "--variant", SCALAR]])
def test_no_one_reads_the_output(small: Path, unread: int, what: list[str]) -> None:
    target = small.with_name("written")
    done = subprocess.run(
        command(*what, str(small), "-o", str(target)),
        cwd=HERE.parent,
        stdout=unread,
        stderr=subprocess.PIPE,
        text=True,
        timeout=120,
    )
    # Dr.Jit says there if it has found no libLLVM.
    assert done.returncode == 0, done.stderr
    assert "Traceback" not in done.stderr
    assert "cannot be written" not in done.stderr
    assert target.exists()


def test_no_room_for_the_output(small: Path) -> None:
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(
            command(str(small)), cwd=HERE.parent, stdout=full, stderr=subprocess.PIPE, timeout=120
        )
    assert (done.returncode, done.stderr) == (0, b"")
    assert small.with_name("small.mitsuba.xml").exists()


def children(process: subprocess.Popen[str]) -> str:
    """The processes that it has started."""
    return Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text()


@pytest.mark.usefixtures("signals_heeded")
@pytest.mark.parametrize("kind", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT])
@pytest.mark.parametrize("when", ["numpy is imported", "the variant is probed"])
def test_an_interrupt(small: Path, kind: signal.Signals, when: str) -> None:
    process = subprocess.Popen(
        command("--check", str(small)),
        cwd=HERE.parent,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    loaded = Path(f"/proc/{process.pid}/maps")
    while not (
        "_multiarray_umath" in loaded.read_text()
        if when == "numpy is imported"
        else children(process)
    ):
        assert process.poll() is None
    process.send_signal(kind)
    out, err = process.communicate(timeout=30)
    assert (process.returncode, out) == (130, "")
    assert told(err) == ""
    assert list(small.parent.iterdir()) == [small]


@pytest.mark.parametrize("what", [[], ["--render"], ["--check"]])
def test_what_is_no_regular_file_stays(
    small: Path, capsys: pytest.CaptureFixture[str], what: list[str]
) -> None:
    pipe = small.with_name("pipe")
    os.mkfifo(pipe)
    assert main([*what, str(small), "-o", str(pipe)]) == 1
    assert capsys.readouterr().err == f"{pipe}: cannot be written: not a regular file\n"
    assert pipe.is_fifo()
    assert sorted(small.parent.iterdir()) == [pipe, small]


@pytest.mark.parametrize("what", [[], ["--render"], ["--check"]])
def test_what_is_of_another_kind_stays(
    small: Path, capsys: pytest.CaptureFixture[str], what: list[str]
) -> None:
    other = small.with_name("other.xml")
    other.write_text("<scene>")
    assert main([*what, str(small), "-o", str(other)]) == 1
    assert (
        capsys.readouterr().err == f"{other}: cannot be written: a file of another kind is there\n"
    )
    assert other.read_text() == "<scene>"
    assert sorted(small.parent.iterdir()) == [other, small]


@pytest.mark.parametrize(("named", "bad"), [("x.png", "x.exr"), ("x.exr", "x.png")])
def test_the_file_that_cannot_be_written_is_the_one_told(
    small: Path, capsys: pytest.CaptureFixture[str], named: str, bad: str
) -> None:
    folder = small.with_name(bad)
    folder.mkdir()
    assert main(["--render", str(small), "-o", str(small.with_name(named))]) == 1
    assert capsys.readouterr().err == f"{folder}: cannot be written: not a regular file\n"


@pytest.mark.parametrize(
    ("what", "written", "magic"),
    [
        ([], "x.xml", WRITTEN.encode()),
        (["--render"], "x.png", PNG),
        (["--render"], "x.exr", EXR),
        (["--check"], "x.png", PNG),
    ],
)
def test_links_are_followed(small: Path, what: list[str], written: str, magic: bytes) -> None:
    (small.parent / "real").write_bytes(magic + b"old")
    (small.parent / written).symlink_to("real")
    target = small.with_name("x.png" if what else "x.xml")
    variant = ["--variant", SCALAR] if what else []
    assert main([*what, *variant, str(small), "-o", str(target)]) == 0
    assert (small.parent / written).is_symlink()
    assert (small.parent / "real").read_bytes().startswith(magic)
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


def test_converting_needs_no_mitsuba(tmp_path: Path) -> None:
    (tmp_path / "mitsuba.py").write_text("raise ImportError('not installed')")
    done = run(str(ONE_SPHERE), "-o", f"{tmp_path}/", PYTHONPATH=str(tmp_path))
    assert (done.returncode, done.stderr) == (0, "")
    done = run("--render", str(ONE_SPHERE), "-o", f"{tmp_path}/", PYTHONPATH=str(tmp_path))
    assert (done.returncode, done.stderr) == (1, "Mitsuba cannot run: not installed\n")


@pytest.mark.parametrize("option", ["exact", "--check"])
def test_without_numpy(tmp_path: Path, option: str) -> None:
    (tmp_path / "numpy.py").write_text("raise ModuleNotFoundError('No module named numpy')")
    done = run(option, str(ONE_SPHERE), "-o", f"{tmp_path}/", PYTHONPATH=str(tmp_path))
    assert done.returncode == 1
    assert re.fullmatch("(.*: )?No module named numpy; install it with .*\n", done.stderr)


@pytest.mark.parametrize(
    ("module", "stub", "reason"),
    [
        (
            "mitsuba",
            "raise ModuleNotFoundError('No module named mitsuba')",
            "No module named mitsuba; install it with pip install -e '.[reference]'",
        ),
        (
            "skimage",
            "raise ModuleNotFoundError('No module named skimage')",
            "No module named skimage; install it with pip install -e '.[reference]'",
        ),
        # As drjit ends where a library of the system is missing.
        (
            "mitsuba",
            "try:\n    raise ImportError('libatomic.so.1: cannot open shared object file')\n"
            "except ImportError:\n    extension",
            "libatomic.so.1: cannot open shared object file",
        ),
    ],
)
def test_what_mitsuba_lacks_is_told(module: str, stub: str, reason: str, tmp_path: Path) -> None:
    (tmp_path / f"{module}.py").write_text(stub)
    done = run("--check", str(ONE_SPHERE), "-o", f"{tmp_path}/", PYTHONPATH=str(tmp_path))
    assert (done.returncode, told(done.stderr)) == (1, f"Mitsuba cannot run: {reason}\n")


def test_render_writes_a_png_and_an_exr(small: Path, tmp_path: Path) -> None:
    assert main(["--render", "--samples", "4", "--variant", SCALAR, str(small)]) == 0
    exr = np.array(mi.Bitmap(str(tmp_path / "small.mitsuba.exr")))
    shown = np.asarray(Image.open(tmp_path / "small.mitsuba.png"))
    assert exr.shape == shown.shape == (30, 40, 3)
    np.testing.assert_array_equal(shown, codes(exr))
    use()


@pytest.mark.parametrize("name", ["x.png", "x.exr"])
def test_either_file_of_a_rendering_may_be_named(small: Path, name: str) -> None:
    assert (
        main(["--render", "--variant", SCALAR, str(small), "-o", str(small.with_name(name))]) == 0
    )
    assert {path.name for path in small.parent.iterdir()} == {"small.xml", "x.png", "x.exr"}
    assert small.with_name("x.png").read_bytes().startswith(PNG)
    assert small.with_name("x.exr").read_bytes().startswith(EXR)
    use()


def test_names_with_dots_have_an_exr_each(small: Path) -> None:
    for name in ("room.v1", "room.v2", "A.EXR"):
        done = ["--render", "--variant", SCALAR, str(small), "-o", str(small.with_name(name))]
        assert main(done) == 0
    names = {path.name for path in small.parent.iterdir()} - {"small.xml"}
    assert names == {"room.v1", "room.v1.exr", "room.v2", "room.v2.exr", "A.png", "A.EXR"}
    assert small.with_name("A.EXR").read_bytes().startswith(EXR)
    use()


def test_check_reports_and_writes_the_comparison(tmp_path: Path) -> None:
    done = run("--check", str(ONE_SPHERE), "-o", f"{tmp_path}/", DRJIT_LIBLLVM_PATH="/nonexistent")
    assert done.returncode == 0, done.stderr
    assert f"Mitsuba variant {SCALAR}: no usable libLLVM" in done.stdout
    assert "one-sphere: agrees" in done.stdout
    with Image.open(tmp_path / "one-sphere.check.png") as picture:
        assert picture.width > 3 * 300


def test_check_ends_with_status_1_where_a_tolerance_is_broken(
    small: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("reference.check.MIN_SSIM", 2)
    assert main(["--check", str(small)]) == 1
    told = capsys.readouterr().out
    assert "small: DIFFERS" in told
    assert "SSIM 1.00000 is below 2" in told
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
    shown = variant or "''"
    assert error.startswith(f"Mitsuba cannot run: {shown} is no RGB variant; choose one of ")
    assert SCALAR in error
    assert "spectral" not in error.partition("choose")[2]


@pytest.mark.parametrize("flavour", ["stock", "exact"])
@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("<position>3 5 4", "<position>1e70 5 4"),
        ("<viewPoint>5 4 3", "<viewPoint>5e69 4e69 1e70"),
        (".25 .5 .85", "1e308 .5 .85"),
        ("<center>0 0 0", "<center>-1e70 1e70 1e70"),
    ],
)
def test_huge_numbers_are_told(
    small: Path, capsys: pytest.CaptureFixture[str], flavour: str, old: str, new: str
) -> None:
    text = small.read_text(encoding="utf-8")
    assert old in text
    small.write_text(text.replace(old, new), encoding="utf-8")
    assert main(["--flavour", flavour, str(small)]) == 1
    assert re.fullmatch(
        rf"{small}: cannot be converted: \w+ would be (inf|[\d.]+e\+\d+), and Mitsuba's numbers"
        r" end at 3\.4e\+38; keep the numbers of the scene closer to 1\n",
        capsys.readouterr().err,
    )
    assert list(small.parent.iterdir()) == [small]


@pytest.mark.parametrize("width", ["1e-70", "1e-20"])
def test_a_picture_of_too_many_square_pixels_is_told(
    small: Path, capsys: pytest.CaptureFixture[str], width: str
) -> None:
    text = small.read_text(encoding="utf-8")
    small.write_text(text.replace("<viewWidth>2.5", f"<viewWidth>{width}"), encoding="utf-8")
    assert main([str(small)]) == 1
    error = capsys.readouterr().err
    assert error.startswith(f"{small}: cannot be converted: Mitsuba's pixels are square, and ")
    assert error.endswith(" too many; make viewWidth larger or viewHeight smaller\n")
    assert list(small.parent.iterdir()) == [small]
