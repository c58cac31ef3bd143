"""The command line, as the process that a user starts."""

from __future__ import annotations

import fcntl
import os
import pty
import re
import resource
import signal
import struct
import subprocess
import sys
import termios
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import tracer
from converters import to_mitsuba
from tracer import __main__ as command_line
from tracer import to_codes
from tracer.commands import _interrupted
from tracer.picture import bands
from tracer.picture.png import PNG, compressed

SCENE = """<scene><camera><viewPoint>0 0 5</viewPoint></camera><image>{} {}</image>
<light><position>3 4 5</position></light><surface type="Sphere"/></scene>"""
# A picture that takes long enough to do something meanwhile.
SLOW = SCENE.format(16384, 16384)


# The tracer under test, whatever folder the process starts in.
ENVIRONMENT = {**os.environ, "PYTHONPATH": str(Path(tracer.__file__).parents[1])}


def command(*arguments: object) -> list[str]:
    return [sys.executable, "-m", "tracer", *map(str, arguments)]


def run(
    *arguments: object, cwd: Path | None = None, **environment: str
) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        command(*arguments),
        capture_output=True,
        text=True,
        cwd=cwd,
        env={**ENVIRONMENT, **environment},
    )


@pytest.fixture
def scene(tmp_path) -> Path:
    path = tmp_path / "ball.xml"
    path.write_text(SCENE.format(40, 30))
    return path


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_a_picture_is_written_beside_its_scene(scene):
    done = run(scene)
    assert re.fullmatch(
        re.escape(f"{scene}.png") + r": 40 x 30 pixels in \d+\.\d{3} s\n", done.stdout
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert names(scene.parent) == ["ball.xml", "ball.xml.png"]
    with Image.open(f"{scene}.png") as picture:
        expected = to_codes(tracer.render(tracer.load_scene(scene)))
        assert (np.asarray(picture) == expected).all()
        assert expected.max() > 0


def test_quiet(scene):
    done = run(scene, "--quiet")
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    assert names(scene.parent) == ["ball.xml", "ball.xml.png"]


def test_relative_paths(scene):
    done = run("ball.xml", cwd=scene.parent)
    assert done.stdout.startswith("ball.xml.png: 40 x 30 pixels")
    assert names(scene.parent) == ["ball.xml", "ball.xml.png"]


def test_output_file(scene):
    assert run(scene, "-o", scene.parent / "here.png").returncode == 0
    assert names(scene.parent) == ["ball.xml", "here.png"]


@pytest.mark.parametrize("made", [True, False])
def test_output_folder(scene, made):
    other = scene.with_name("other.xml")
    other.write_text(SCENE.format(3, 3))
    folder = scene.parent / "deep" / "pictures"
    if made:
        folder.mkdir(parents=True)
    done = run(scene, other, f"--output={folder}{'' if made else '/'}")
    assert done.returncode == 0
    assert len(done.stdout.splitlines()) == 2
    assert names(folder) == ["ball.xml.png", "other.xml.png"]


def test_samples_and_threads(scene):
    assert run(scene, "--samples", 4, "--processes", 2).returncode == 0
    with Image.open(f"{scene}.png") as picture:
        expected = to_codes(tracer.render(tracer.load_scene(scene), samples=4))
        assert (np.asarray(picture) == expected).all()


def test_no_files_for_workers(scene):
    done = subprocess.run(
        command(scene, "--quiet", "--processes", 2),
        capture_output=True,
        env=ENVIRONMENT,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_NOFILE, (9, 9)),
    )
    assert (done.returncode, done.stderr) == (0, b"")
    assert names(scene.parent) == ["ball.xml", "ball.xml.png"]


def test_without_numpy(scene):
    stub = "raise ModuleNotFoundError(\"No module named 'numpy'\", name='numpy')"
    (scene.parent / "numpy.py").write_text(stub)
    done = run("ball.xml", cwd=scene.parent)
    assert done.returncode == 1
    assert done.stderr == "No module named 'numpy'; install it with python -m pip install numpy\n"


def test_wrong_usage_without_numpy(scene):
    (scene.parent / "numpy.py").write_text("raise ModuleNotFoundError")
    done = run("ball.xml", "-o", "ball.jpg", cwd=scene.parent)
    assert done.returncode == 2
    assert done.stderr.endswith("pictures are PNG files; name it ball.png\n")


def test_half_of_numpy(scene):
    missing = "numpy._core.gone"
    stub = f"raise ModuleNotFoundError('No module named {missing}', name='{missing}')"
    (scene.parent / "numpy.py").write_text(stub)
    done = run("ball.xml", cwd=scene.parent)
    told = f"No module named {missing}; install it with python -m pip install numpy\n"
    assert (done.returncode, done.stderr) == (1, told)


def test_version():
    done = run("--version")
    assert (done.returncode, done.stdout) == (0, f"tracer {tracer.__version__}\n")


def test_help():
    done = run("--help")
    assert done.returncode == 0
    assert "tracer scenes/one-sphere.xml" in done.stdout
    assert max(map(len, done.stdout.splitlines())) <= 88


@pytest.mark.parametrize(
    ("arguments", "error"),
    [
        ([], "the following arguments are required: SCENE.xml"),
        (["--frobnicate", "ball.xml"], "unrecognized arguments: --frobnicate"),
        (
            ["ball.xml", "--samples", "0"],
            "argument --samples: must be a whole number from 1 to 999999999, is '0'",
        ),
        (
            ["ball.xml", "--samples", "1_0"],
            "argument --samples: must be a whole number from 1 to 999999999, is '1_0'",
        ),
        (
            ["ball.xml", "--processes", "-1"],
            "argument --processes: must be a whole number from 1 to 999999999, is '-1'",
        ),
        (["ball.xml", "-o"], "argument -o/--output: expected one argument"),
        (["ball.xml", "-o", ""], "argument -o/--output: the name is empty; name a file"),
        (["ball.xml", ""], "argument SCENE.xml: the name is empty; name a file"),
        (
            ["ball.png", "-o", "ball.png"],
            "ball.png: this would replace a scene; choose another with -o",
        ),
        (
            ["ball.xml", "-o", "ball.v2.jpg"],
            "-o ball.v2.jpg: pictures are PNG files; name it ball.v2.png",
        ),
        (
            ["ball.xml", "--size", "640"],
            "argument --size: must be width and height in pixels, as 640x360, is '640'",
        ),
        (
            ["ball.xml", "--size", "0x10"],
            "argument --size: must be width and height in pixels, as 640x360, is '0x10'",
        ),
        (["-"], "-: a picture of standard input needs a name, with -o, and no --watch"),
        (
            ["-", "-o", "ball.png", "--watch"],
            "-: a picture of standard input needs a name, with -o, and no --watch",
        ),
        (
            ["ball.xml", "other.xml", "-o", "-"],
            "-o -: standard output takes the picture of one scene, and no --watch",
        ),
        (
            ["ball.xml", "other.xml", "-o", "here.png"],
            "-o here.png: several scenes need a folder; to have it made, end it in /",
        ),
        (
            ["ball.xml", "ball.xml"],
            "ball.xml.png: ball.xml and ball.xml would both be written there; do them one by one",
        ),
        (
            ["ball.xml", "sub/ball.xml", "-o", "."],
            "./ball.xml.png: ball.xml and sub/ball.xml would both be written there;"
            " do them one by one",
        ),
    ],
)
def test_wrong_usage(scene, arguments, error):
    done = run(*arguments, cwd=scene.parent)
    assert done.returncode == 2
    assert done.stderr.splitlines()[-1] == f"tracer: error: {error}"
    assert done.stdout == ""
    assert names(scene.parent) == ["ball.xml"]


def test_what_is_faulty_does_not_keep_the_others_from_being_rendered(scene):
    faulty = scene.with_name("faulty.xml")
    faulty.write_text("<scene>\n<camra/>\n</scene>")
    done = run(faulty, "missing.xml", scene, cwd=scene.parent)
    assert done.returncode == 1
    assert done.stderr.splitlines() == [
        f"{faulty}:1: scene: has no camera; add <camera> ... </camera>",
        f"{faulty}:1: scene: has no image; add <image> ... </image>",
        f"{faulty}:2: camra: unknown in scene; did you mean 'camera'?",
        "missing.xml: cannot be read: No such file or directory;"
        " check the path and its permissions",
    ]
    assert done.stdout.startswith(f"{scene}.png: ")
    assert names(scene.parent) == ["ball.xml", "ball.xml.png", "faulty.xml"]


@pytest.mark.parametrize(
    ("output", "reason"),
    [
        ("missing/ball.png", "No such file or directory"),
        ("/dev/null", "not a regular file"),
        ("ball.xml/ball.png", "Not a directory"),
        (f"{'x' * 300}.png", "File name too long"),
    ],
)
def test_what_cannot_be_written(scene, output, reason):
    done = run("ball.xml", "-o", output, cwd=scene.parent)
    assert done.returncode == 1
    assert done.stderr == f"{output}: cannot be written: {reason}; choose another with -o\n"
    assert names(scene.parent) == ["ball.xml"]
    assert Path("/dev/null").is_char_device()


def limited(scene: Path, megabytes: int) -> subprocess.CompletedProcess[str]:
    """Render with so much more memory than there is in use once all modules are loaded."""
    script = (
        "import resource, sys, tracer.picture.bands, tracer.scene.reader\n"
        "from tracer.__main__ import main\n"
        "used = int(open('/proc/self/statm').read().split()[0]) * resource.getpagesize()\n"
        f"resource.setrlimit(resource.RLIMIT_AS, (used + ({megabytes} << 20),) * 2)\n"
        f"sys.exit(main([{str(scene)!r}, '--processes', '1']))\n"
    )
    return subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, env=ENVIRONMENT
    )


def test_too_little_memory(scene, tmp_path):
    scene.write_text(SCENE.format(3000, 2000))
    done = limited(scene, 4)
    assert done.stderr == (
        f"{scene}: not enough memory for 3000 x 2000 pixels; make the image smaller\n"
    )
    assert done.returncode == 1
    assert names(tmp_path) == ["ball.xml"]


@pytest.mark.parametrize("megabytes", [20, 40, 60, 97, 100])
def test_too_little_memory_to_start(scene, megabytes):
    """It may also be enough: libraries differ."""
    limit = megabytes << 20
    done = subprocess.run(
        command(scene, "--quiet"),
        capture_output=True,
        text=True,
        env=ENVIRONMENT,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, (limit, limit)),
    )
    assert len(done.stderr.splitlines()) == done.returncode
    assert names(scene.parent)[1:] == ([] if done.returncode else ["ball.xml.png"])


@pytest.mark.slow
@pytest.mark.parametrize("size", [(1 << 28, 1), (1, 1 << 28)])
def test_a_picture_as_wide_or_as_high_as_can_be_needs_little_memory(scene, size):
    scene.write_text(SCENE.format(*size))
    script = (
        "import resource, subprocess, sys; subprocess.run(sys.argv[1:], check=True)\n"
        "print(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss)"
    )
    run = [sys.executable, "-c", script, *command(scene, "--quiet")]
    done = subprocess.run(run, capture_output=True, text=True, env=ENVIRONMENT, check=True)
    assert int(done.stdout) < 150_000
    assert Path(f"{scene}.png").stat().st_size > 100_000


def test_memory_that_is_enough_for_a_small_picture(scene, tmp_path):
    done = limited(scene, 16)
    assert (done.returncode, done.stderr) == (0, "")
    assert names(tmp_path) == ["ball.xml", "ball.xml.png"]


def test_too_little_memory_for_the_samples(scene, monkeypatch, capsys):
    def fail(*_: object, **__: object) -> None:
        raise MemoryError

    monkeypatch.setattr("tracer.picture.bands.render_compressed", fail)
    assert command_line.main([str(scene), "--samples", "999999999"]) == 1
    assert capsys.readouterr().err == (
        f"{scene}: not enough memory for 40 x 30 pixels of 999999999 samples;"
        " make the image smaller or take fewer samples\n"
    )


def test_a_picture_that_holds_no_numbers(scene, monkeypatch, capsys):
    """However it came about: a line, and not a traceback."""
    monkeypatch.setattr(
        "tracer.picture.bands.render_compressed",
        lambda *_, **__: iter([compressed(np.full((30, 40, 3), np.nan))]),
    )
    assert command_line.main([str(scene)]) == 1
    assert capsys.readouterr().err.startswith(f"{scene}.png: cannot be written: an image must not")
    assert names(scene.parent) == ["ball.xml"]


def test_what_is_no_picture_is_not_replaced(scene, capsys):
    other = scene.with_name("other.png")
    other.write_text("<scene/>")
    assert command_line.main([str(scene), "-o", str(other)]) == 1
    assert capsys.readouterr().err == (
        f"{other}: cannot be written: a file of another kind is there; choose another with -o\n"
    )
    assert other.read_text() == "<scene/>"
    assert names(scene.parent) == ["ball.xml", "other.png"]


def started(scene: Path) -> subprocess.Popen[str]:
    """A process that is rendering: its picture has been begun."""
    process = subprocess.Popen(
        command(scene), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=ENVIRONMENT
    )
    deadline = time.monotonic() + 30
    while not any(name.endswith(".part") for name in names(scene.parent)):
        assert process.poll() is None
        assert time.monotonic() < deadline
        time.sleep(0.02)
    return process


@pytest.mark.usefixtures("signals_heeded")
@pytest.mark.parametrize(
    "kind", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT, signal.SIGXCPU]
)
def test_an_interrupt_leaves_nothing_half_written(scene, kind):
    scene.write_text(SLOW)
    picture = scene.with_name("ball.xml.png")
    picture.write_bytes(PNG + b"precious")
    process = started(scene)
    process.send_signal(kind)
    out, err = process.communicate(timeout=30)
    assert (process.returncode, out, err) == (130, "", "")
    assert names(scene.parent) == ["ball.xml", "ball.xml.png"]
    assert picture.read_bytes() == PNG + b"precious"


def test_no_interrupt_interrupts_what_another_has_begun(monkeypatch):
    """As when a user is impatient, or each process of a pipe is sent one."""
    seconds = iter([10.0, 10.1, 10.4, 10.6])
    monkeypatch.setattr("tracer.commands._interruptible", True)
    monkeypatch.setattr("tracer.commands._ignored_until", 0.0)
    monkeypatch.setattr("tracer.commands.monotonic", seconds.__next__)
    heeded = []
    for _ in range(4):
        try:
            _interrupted(signal.SIGINT, None)
            heeded.append(False)
        except KeyboardInterrupt:
            heeded.append(True)
    assert heeded == [True, False, False, True]


@pytest.mark.usefixtures("signals_heeded")
@pytest.mark.parametrize("kind", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupt_while_numpy_is_imported(scene, kind):
    process = subprocess.Popen(
        command(scene), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=ENVIRONMENT
    )
    loaded = Path(f"/proc/{process.pid}/maps")
    while "_multiarray_umath" not in loaded.read_text():
        assert process.poll() is None
    process.send_signal(kind)
    out, err = process.communicate(timeout=30)
    assert (process.returncode, out, err) == (130, "", "")
    assert names(scene.parent) == ["ball.xml"]


def test_an_interrupt_that_the_shell_ignores(scene):
    """As of a command in the background of a script."""
    process = subprocess.Popen(
        command(scene, "--quiet"),
        env=ENVIRONMENT,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_IGN),
    )
    deadline = time.monotonic() + 30
    while process.poll() is None:
        process.send_signal(signal.SIGINT)
        assert time.monotonic() < deadline
        time.sleep(0.01)
    assert process.returncode == 0
    assert names(scene.parent) == ["ball.xml", "ball.xml.png"]


def test_ends_of_children_that_the_caller_ignores(scene):
    """As some servers do, whose commands inherit it: no process can wait for its children."""
    done = subprocess.run(
        command(scene, "--quiet", "--processes", 2),
        capture_output=True,
        env=ENVIRONMENT,
        preexec_fn=lambda: signal.signal(signal.SIGCHLD, signal.SIG_IGN),
    )
    assert (done.returncode, done.stderr) == (0, b"")
    assert names(scene.parent) == ["ball.xml", "ball.xml.png"]


def test_no_one_reads_the_output(scene, unread):
    other = scene.with_name("other.xml")
    other.write_text(SCENE.format(3, 3))
    done = subprocess.run(
        command(scene, other), stdout=unread, stderr=subprocess.PIPE, env=ENVIRONMENT
    )
    assert (done.returncode, done.stderr) == (0, b"")
    assert names(scene.parent) == ["ball.xml", "ball.xml.png", "other.xml", "other.xml.png"]


def test_no_one_reads_the_errors(scene, unread):
    done = subprocess.run(
        command("none.xml", scene), stdout=subprocess.PIPE, stderr=unread, env=ENVIRONMENT
    )
    assert done.returncode == 1
    assert names(scene.parent) == ["ball.xml", "ball.xml.png"]


def test_no_room_for_the_output(scene):
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(
            command(scene), stdout=full, stderr=subprocess.PIPE, env=ENVIRONMENT, text=True
        )
    assert (done.returncode, done.stderr) == (0, "")
    assert names(scene.parent) == ["ball.xml", "ball.xml.png"]


def test_names_that_the_terminal_cannot_show(scene):
    odd = scene.with_name("b\u00e4ll\n.xml")
    scene.rename(odd)
    done = run(odd, PYTHONIOENCODING="ascii")
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.startswith(f"{odd.parent}/b\\xe4ll\\n.xml.png: 40 x 30 pixels in ")
    assert done.stdout.count("\n") == 1


def on_a_terminal(scene: Path, wait_for: str | None = None) -> str:
    """What a terminal shows on stderr; stops the process once `wait_for` is shown."""
    terminal, end = pty.openpty()
    fcntl.ioctl(end, termios.TIOCSWINSZ, struct.pack("HHHH", 25, 80, 0, 0))
    process = subprocess.Popen(command(scene), stdout=subprocess.PIPE, stderr=end, env=ENVIRONMENT)
    os.close(end)
    shown = ""
    try:
        while text := os.read(terminal, 4096).decode():
            shown += text
            if wait_for is not None and wait_for in shown:
                process.send_signal(signal.SIGINT)
                wait_for = None
    except OSError:  # how Linux says that the other end is closed
        pass
    finally:
        process.communicate(timeout=30)
        os.close(terminal)
    return shown


@pytest.mark.usefixtures("signals_heeded")
def test_a_slow_picture_shows_its_progress(scene):
    scene.write_text(SLOW)
    shown = on_a_terminal(scene, wait_for="row/s")
    assert "ball.xml.png" in shown
    assert "/16384" in shown
    assert "Traceback" not in shown


@pytest.mark.parametrize(("missing", "setting"), [(True, "1"), (False, "often")])
def test_a_slow_picture_does_without_a_bar_that_cannot_be_shown(
    missing, setting, scene, monkeypatch, capsys
):
    """Slow as the clock has it; tqdm reads its settings when it is imported."""
    for module in [name for name in sys.modules if name.partition(".")[0] == "tqdm"]:
        monkeypatch.delitem(sys.modules, module)
    if missing:
        monkeypatch.setitem(sys.modules, "tqdm", None)
    monkeypatch.setenv("TQDM_MININTERVAL", setting)
    monkeypatch.setattr(command_line, "perf_counter", iter(range(100)).__next__)
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    monkeypatch.setattr(bands, "_TILE_SAMPLES", 400)
    assert command_line.main([str(scene)]) == 0
    assert capsys.readouterr().err == ""
    with Image.open(f"{scene}.png") as image:
        assert image.size == (40, 30)


def test_a_quick_picture_shows_none(scene):
    assert on_a_terminal(scene) == ""


def test_a_slow_picture_shows_none_where_there_is_no_terminal(scene, monkeypatch, capsys):
    """Slow as the clock has it."""
    monkeypatch.setattr(command_line, "perf_counter", iter(range(100)).__next__)
    assert command_line.main([str(scene)]) == 0
    assert capsys.readouterr().err == ""


def test_another_size(scene):
    done = run(scene, "--size", "80x60")
    assert (done.returncode, done.stderr) == (0, "")
    assert ": 80 x 60 pixels in " in done.stdout
    with Image.open(f"{scene}.png") as picture:
        expected = to_codes(tracer.render(replace(tracer.load_scene(scene), width=80, height=60)))
        assert (np.asarray(picture) == expected).all()


@pytest.mark.parametrize(
    ("file", "window", "size", "told"),
    [
        ((30, 30), "", "20x10", "--size 20x20 keeps them so"),
        ((32, 18), "<viewWidth>1.6</viewWidth><viewHeight>.9</viewHeight>", "321x181", ""),
        ((32, 18), "<viewWidth>1.6</viewWidth><viewHeight>.9</viewHeight>", "32x32",
         "--size 32x18 keeps them so"),
        ((40, 30), "", "20x10", ""),  # they are not square in the file
    ],
)  # fmt: skip
def test_a_size_that_makes_pixels_oblong(scene, file, window, size, told):
    scene.write_text(SCENE.format(*file).replace("</camera>", f"{window}</camera>"))
    done = run(scene, "--size", size)
    told = told and f"{scene}: pixels are no longer square; {told}\n"
    assert (done.returncode, done.stderr) == (0, told)
    assert run(scene, "--size", size, "--quiet").stderr == ""


def test_a_size_that_is_too_large(scene):
    done = run(scene, "--size", "99999x99999")
    assert done.returncode == 1
    assert done.stderr.startswith("--size: width, height: 99999 x 99999 pixels are too many")
    assert names(scene.parent) == ["ball.xml"]


def test_standard_input_and_output(scene):
    done = subprocess.run(
        command("-", "-o", "-"), input=scene.read_bytes(), capture_output=True, env=ENVIRONMENT
    )
    assert done.returncode == 0
    assert re.fullmatch(rb"-: 40 x 30 pixels in \d+\.\d{3} s\n", done.stderr)
    assert run(scene).returncode == 0
    assert done.stdout == Path(f"{scene}.png").read_bytes()


def test_faulty_standard_input(tmp_path):
    done = subprocess.run(
        command("-", "-o", "x.png"), input=b"<scene>", capture_output=True, cwd=tmp_path,
        env=ENVIRONMENT,
    )  # fmt: skip
    assert done.returncode == 1
    assert b":1: " in done.stderr
    assert names(tmp_path) == []


def test_standard_output_that_no_one_reads(scene, unread):
    done = subprocess.run(
        command(scene, "-o", "-"), stdout=unread, stderr=subprocess.PIPE, env=ENVIRONMENT
    )
    assert done.returncode == 1
    assert done.stderr == b"-: cannot be written: Broken pipe; choose another with -o\n"


@pytest.mark.usefixtures("signals_heeded")
def test_watch(scene):
    """A file that is saved, is faulty, is mended, is replaced, is removed."""
    other = scene.with_name("other.xml")
    other.write_text(SCENE.format(3, 3))
    with subprocess.Popen(
        command(scene, other, "--watch"), stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        text=True, env=ENVIRONMENT,
    ) as process:  # fmt: skip
        assert process.stdout is not None
        assert process.stderr is not None
        assert "ball.xml.png: 40 x 30" in process.stdout.readline()
        assert "other.xml.png: 3 x 3" in process.stdout.readline()
        other.write_text(SCENE.format(5, 5))
        assert "other.xml.png: 5 x 5" in process.stdout.readline()
        scene.write_text("<scene>")
        assert "ball.xml:1: " in process.stderr.readline()
        new = scene.with_name("new")
        new.write_text(SCENE.format(8, 6))
        new.replace(scene)
        assert "ball.xml.png: 8 x 6" in process.stdout.readline()
        other.unlink()
        shown = process.stderr.readline()
        while "other.xml: cannot be read" not in shown:
            assert "ball.xml:" in shown  # more faults of the one before
            shown = process.stderr.readline()
        process.send_signal(signal.SIGINT)
        assert (process.wait(), process.stdout.read(), process.stderr.read()) == (130, "", "")


@pytest.mark.parametrize(("given", "threads"), [({}, "1"), ({"OPENBLAS_NUM_THREADS": "2"}, "2")])
def test_no_threads_are_started_that_no_one_asked_for(given, threads):
    script = (
        "import os\nfrom tracer import __main__ as command_line\n"
        "def main():\n    print(os.environ['OPENBLAS_NUM_THREADS'], flush=True)\n    return 0\n"
        "command_line.main = main\ncommand_line.run()"
    )
    environment = {k: v for k, v in ENVIRONMENT.items() if k != "OPENBLAS_NUM_THREADS"}
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, env=environment | given
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, f"{threads}\n", "")


@pytest.mark.parametrize(
    "arguments", [["--help"], ["--version"], [], ["ball.xml", "--samples", "0"]]
)
def test_what_draws_nothing_does_not_wait_for_numpy(arguments):
    done = subprocess.run(
        [sys.executable, "-X", "importtime", *command(*arguments)[1:]],
        capture_output=True,
        text=True,
        env=ENVIRONMENT,
    )
    assert "argparse" in done.stderr
    assert "numpy" not in done.stderr


@pytest.mark.parametrize(
    "module",
    [
        *("tqdm", "PIL", "difflib", "pathlib", "shutil", "tempfile"),
        *("tracer.antialias.refine", "tracer.scene.malformed"),
    ],
)
def test_a_small_picture_does_not_wait_for_modules_it_does_not_need(scene, module):
    script = (
        "import sys, numpy\nbefore = set(sys.modules)\n"
        "from tracer.__main__ import main\n"
        f"main([{str(scene)!r}])\nprint(*set(sys.modules) - before)"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, env=ENVIRONMENT
    )
    loaded = done.stdout.split()
    assert "tracer.picture.bands" in loaded
    assert module not in loaded


def test_a_working_folder_that_is_gone(
    no_working_folder: str, capsys: pytest.CaptureFixture[str]
) -> None:
    for main in (command_line.main, to_mitsuba.main):
        with pytest.raises(SystemExit, match="1"):
            main(["x.xml"])
        assert capsys.readouterr().err == no_working_folder
