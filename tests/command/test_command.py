"""The command line as a process that a user starts, and how all commands start."""

import fcntl
import os
import pickle
import re
import struct
import termios
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import OpenEXR
import pytest
from PIL import Image
from running import ROOT, SCENE, file_names, run, write_ball

import tracer
from converters import to_mitsuba
from reference import compare
from tracer import SceneFileError
from tracer.command import cli, progress
from tracer.command.batch import read_scene
from tracer.command.failure import Failure, errors_as_failure


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    """Write the file of a scene with 40 x 30 pixels into an empty folder, and return its path."""
    return write_ball(tmp_path / "ball.xml", 40, 30)


@pytest.mark.parametrize(
    ("arguments", "written"),
    [
        ("ball.xml", ["ball.xml.png"]),
        ("ball.xml --processes 2 --samples 4", ["ball.xml.png"]),
        ("ball.xml --size 80x60", ["ball.xml.png"]),
        ("ball.xml --size 80 -o A.PNG", ["A.PNG"]),
        ("ball.xml -o here.png", ["here.png"]),
        ("ball.xml --output=here", ["here"]),
        ("ball.xml -o there", ["there/ball.xml.png"]),
        ("ball.xml there/../there/other.xml -o new/deep/",
         ["new/deep/ball.xml.png", "new/deep/other.xml.png"]),
    ],
)  # fmt: skip
def test_where_pictures_are_written(scene, arguments, written):
    (scene.parent / "there").mkdir()
    write_ball(scene.parent / "there" / "other.xml", 3, 3)
    status, out, err = run(*arguments.split(), cwd=scene.parent)
    assert (status, err) == (0, "")
    lines = [re.escape(name) + r": \d+ x \d+ pixels in \d+\.\d{3} s\n" for name in written]
    assert re.fullmatch("".join(lines), out)
    assert file_names(scene.parent) == sorted([*written, "there/other.xml"])
    size = (80, 60) if "--size" in arguments else (40, 30)
    resized = replace(tracer.load_scene(scene), width=size[0], height=size[1])
    expected = tracer.to_codes(tracer.render(resized, 4 if "--samples" in arguments else 1))
    with Image.open(scene.parent / written[0]) as picture:
        assert (np.asarray(picture) == expected).all()
    assert expected.max() > 0


@pytest.mark.parametrize(
    ("size", "expected"), [((81,), (81, 20)), ((1,), (1, 1)), ((7, 8), (7, 8)), (None, (40, 10))]
)
def test_a_width_alone_keeps_the_proportions(scene, size, expected):
    resized = read_scene(str(write_ball(scene, 40, 10)), size)
    assert (resized.width, resized.height) == expected


def test_version_and_help():
    assert run("--version") == (0, f"tracer {tracer.__version__}\n", "")
    status, out, _ = run("--help")
    assert status == 0
    assert "tracer scenes/one-sphere.xml" in out
    assert max(map(len, out.splitlines())) <= 88


@pytest.mark.parametrize(
    ("main", "arguments", "status"),
    [
        (cli.main, ["x.xml"], 1),
        (to_mitsuba.main, ["x.xml"], 1),
        (compare.main, [__file__, __file__, "-o", "a.png"], 2),
    ],
)
def test_a_working_folder_that_is_gone(main, arguments, status, tmp_path, monkeypatch):
    (gone := tmp_path / "gone").mkdir()
    monkeypatch.chdir(gone)
    gone.rmdir()
    text = "the working folder: cannot be found: No such file or directory; change to another"
    with pytest.raises(Failure) as caught:
        main(arguments)
    assert (str(caught.value), caught.value.exit_status) == (text, status)


def set_cause(error: Exception, cause: Exception) -> Exception:
    """Return an error with its cause, as Dr.Jit raises it."""
    error.__cause__ = cause
    return error


@pytest.mark.parametrize(
    ("error", "text"),
    [
        (OSError(28, "full disk"), "a.png: cannot be read: full disk; R"),
        (MemoryError(), "a.png: cannot be read: not enough memory; M"),
        (ChildProcessError(), "a.png: cannot be read: not enough memory; M"),
        (KeyError(), "a.png: cannot be read: KeyError; R"),
        (set_cause(RuntimeError("loop"), KeyError("two\n words")),
         "a.png: cannot be read: 'two\\n words'; R"),
        (SceneFileError(["a.xml:3: wrong", "a.xml:5: wrong"]), "a.xml:3: wrong\na.xml:5: wrong"),
        (Failure("b", "first", "F", 3), "b: first; F"),
        (ValueError("a bug"), None),
        (BrokenPipeError(), None),
    ],
    ids=lambda value: type(value).__name__ if isinstance(value, Exception) else "",
)  # fmt: skip
def test_errors_become_failures_where_they_arise(error, text):
    settings = {"memory_remedy": "M", "exit_status": 3, "error_types": (KeyError, RuntimeError)}
    with (
        pytest.raises(type(error) if text is None else Failure) as caught,
        errors_as_failure("a.png", "read", "R", **settings),
    ):
        raise error
    if text is not None:
        for failure in (caught.value, pickle.loads(pickle.dumps(caught.value))):
            assert (str(failure), failure.exit_status) == (text, 3)


@pytest.mark.parametrize("samples", [1, 4])
def test_linear_radiance_is_written_exactly_or_as_float32(scene, samples):
    # The second picture has several tiles.
    scenes = [scene, write_ball(scene.with_name("other.xml"), 300, 200)]
    for arguments in (["--format", "npy"], ["--format", "exr", "-o", "new/"]):
        options = [*arguments, "--quiet", "--samples", samples, "--processes", 2]
        assert run(*scenes, *options, cwd=scene.parent) == (0, "", "")
    for path in scenes:
        image = tracer.render(tracer.load_scene(path), samples)
        assert (np.load(f"{path}.npy") == image).all()
        with OpenEXR.File(str(scene.parent / "new" / f"{path.name}.exr")) as file:
            assert (file.channels()["RGB"].pixels == image.astype(np.float32)).all()
    status, out, _ = run(scene, "-o", "-", "--format", "npy", "--samples", samples, text=False)
    assert (status, out) == (0, Path(f"{scene}.npy").read_bytes())


def test_without_openexr_a_line_says_how_to_install_it(scene):
    stub = scene.with_name("OpenEXR.py")
    error = "No module named 'OpenEXR'"
    stub.write_text(f"raise ModuleNotFoundError({error!r}, name='OpenEXR')")
    path = {"PYTHONPATH": f"{scene.parent}:{ROOT}"}
    status, out, err = run(scene, "-o", "a.exr", env=path, cwd=scene.parent)
    assert (status, out) == (2, "")
    assert err == f"{error}; install it with python -m pip install OpenEXR\n"
    assert file_names(scene.parent) == ["OpenEXR.py"]


def test_a_faulty_scene_does_not_keep_the_others_from_being_rendered(scene):
    faulty = scene.with_name("faulty.xml")
    faulty.write_text("<scene>\n<camra/>\n</scene>")
    status, out, err = run(faulty, "missing.xml", scene, cwd=scene.parent)
    assert status == 1
    assert err.splitlines() == [
        f"{faulty}:1: scene: has no image; add <image> ... </image>",
        f"{faulty}:2: camra: unknown in scene; did you mean 'camera'?",
        "missing.xml: cannot be read: No such file or directory;"
        " check the path and its permissions",
    ]
    assert out.startswith(f"{scene}.png: ")
    assert file_names(scene.parent) == ["ball.xml.png", "faulty.xml"]


def test_a_bug_is_reported_in_a_line(scene, monkeypatch, capsys):
    """The command prints no traceback."""
    render_tile = Mock(return_value=np.full((30, 40, 3), np.nan))
    monkeypatch.setattr("tracer.picture.render_job.RenderJob.render_tile", render_tile)
    assert cli.main([str(scene), "--samples", "4"]) == 1
    reason = "an image must not contain NaN; this is a bug in the tracer"
    error = f"{scene}: cannot be rendered: {reason}; please report it with the scene\n"
    assert capsys.readouterr().err == error
    assert file_names(scene.parent) == []


def test_nobody_reads_the_output_or_the_errors(scene, pipe_without_reader):
    other = write_ball(scene.with_name("other.xml"), 3, 3)
    assert run(scene, other, stdout=pipe_without_reader) == (0, None, "")
    assert file_names(scene.parent) == ["ball.xml.png", "other.xml", "other.xml.png"]
    Path(f"{scene}.png").unlink()
    assert run("none.xml", scene, stderr=pipe_without_reader)[0] == 1
    with Path("/dev/full").open("w") as full:
        assert run(other, stdout=full) == (0, None, "")
        assert run("--version", stdout=full, env={"PYTHONUNBUFFERED": ""})[0] == 1
        error = "-: cannot be written: No space left on device; choose another with -o\n"
        assert run(other, "-o", "-", stdout=full) == (1, None, error)
    assert file_names(scene.parent) == ["ball.xml.png", "other.xml", "other.xml.png"]
    assert run(scene, "-o", "-", stdout=pipe_without_reader) == (141, None, "")
    assert run(scene, "--pixel", "3,3", stdout=pipe_without_reader) == (141, None, "")
    buffered = {"PYTHONUNBUFFERED": ""}
    assert run("--help", stdout=pipe_without_reader, env=buffered) == (141, None, "")


def test_standard_output_that_is_a_terminal(scene):
    controller, terminal = os.openpty()
    status, _, err = run(scene, "-o", "-", stdout=terminal)
    os.close(controller)
    os.close(terminal)
    message = "-o -: standard output is a terminal; write the picture to a file"
    assert (status, err.splitlines()[-1]) == (2, f"tracer: error: {message}")


def test_a_pixel_of_several_scenes_is_explained_by_name(scene, capsys):
    assert cli.main([str(scene), "none.xml", str(scene), "--pixel", "20,15"]) == 1
    out, err = capsys.readouterr()
    assert out.split("\n\n")[0].count(f"{scene}:\npixel     20,15\n") == 2
    assert err.startswith("none.xml: cannot be read: ")
    assert cli.main([str(scene), "--pixel", "20,15"]) == 0
    assert capsys.readouterr().out.startswith("pixel     20,15\n")


def test_names_that_the_terminal_cannot_show(scene):
    odd = scene.with_name("b\u00e4ll\n.xml")
    scene.rename(odd)
    status, out, err = run(odd, env={"PYTHONIOENCODING": "ascii"})
    assert (status, err) == (0, "")
    assert out.startswith(f"{odd.parent}/b\\xe4ll\\n.xml.png: 40 x 30 pixels in ")
    assert out.count("\n") == 1


def test_warnings_and_a_size_that_makes_pixels_oblong(scene, capsys):
    assert cli.main([str(scene), "--size", "20x20"]) == 0
    window = "a window of 40 x 30 is stretched over 20 x 20 pixels"
    warning = f"{window}; viewWidth 30, or 27 columns, would make them square"
    assert capsys.readouterr().err == f"{scene}: warning: {warning}\n"
    scene.write_text(SCENE.format(40, 30).replace("0 0 5", "0 0 -5"))
    assert cli.main([str(scene), "--size", "20x20"]) == 0
    seen = capsys.readouterr().err
    assert seen.startswith(f"{scene}: warning: {warning}\n{scene}: warning: no object is in view")
    assert cli.main([str(scene), "--size", "20x20", "--quiet"]) == 0
    assert capsys.readouterr() == ("", "")


def test_standard_input_and_output(scene):
    status, out, err = run("-", "-o", "-", input=scene.read_bytes(), text=False)
    assert status == 0
    assert re.fullmatch(rb"-: 40 x 30 pixels in \d+\.\d{3} s\n", err)
    assert cli.main([str(scene)]) == 0
    assert out == Path(f"{scene}.png").read_bytes()
    status, _, err = run("-", "-o", "x.png", input="<scene>", cwd=scene.parent)
    assert status == 1
    assert ":1: " in err
    assert file_names(scene.parent) == ["ball.xml.png"]


@pytest.mark.parametrize("columns", [0, 60])
def test_the_bar_fits_terminals_and_those_that_do_not_know_their_width(columns, monkeypatch):
    monkeypatch.setattr(progress, "perf_counter", iter(range(0, 1000, 10)).__next__)
    controller, terminal = os.openpty()
    fcntl.ioctl(terminal, termios.TIOCSWINSZ, struct.pack("HHHH", 24, columns, 0, 0))
    with os.fdopen(terminal, "w") as stream:
        monkeypatch.setattr("sys.stderr", stream)
        with progress.Progress(4, "parts") as bar:
            bar.update(3, "a note")
    shown = ""
    with os.fdopen(controller, "rb", buffering=0) as screen, suppress(OSError):  # at its end
        while data := screen.read(1000):
            shown += data.decode()
    assert "75%|" in shown
    width = columns or 80
    assert width - 1 <= max(map(len, shown.split("\r"))) <= width


@pytest.mark.parametrize(
    ("count", "text"),
    [
        (0, "0 pixels"),
        (11_520, "11,520 pixels"),
        (999_999, "999,999 pixels"),
        (1_000_000, "1.0 million pixels"),
        (2_345_678_901, "2,345.7 million pixels"),
    ],
)
def test_numbers_of_pixels_can_be_read(count, text):
    assert progress.format_pixel_count(count) == text


def test_a_small_picture_imports_no_module_that_it_does_not_need(scene):
    script = (
        "import sys, numpy\nbefore = set(sys.modules)\n"
        "from tracer.command.cli import main\n"
        f"main([{str(scene)!r}])\nprint(*set(sys.modules) - before)"
    )
    loaded = set(run(python=("-c", script))[1].split())
    assert "tracer.picture.render_job" in loaded
    assert not loaded & {"tqdm", "PIL", "difflib", "multiprocessing", "concurrent.futures.process"}
