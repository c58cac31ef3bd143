"""Commands that are interrupted at any moment end immediately, and leave nothing behind."""

import os
import random
import re
import signal
import subprocess
import time
from contextlib import suppress
from importlib import metadata
from pathlib import Path

import numpy as np
import pytest
from running import (
    INTERRUPTS,
    drop_jit,
    needs_two,
    run,
    start_process,
    wait_until,
    workers_of,
    write_ball,
)

from tracer import write_png

# Runs the tracer as on systems whose new files have a name from the beginning.
NAMED_FILES = "import os; del os.O_TMPFILE; from tracer.__main__ import main; main()"
# Runs the tracer as free-threaded Python does: its workers are threads.
THREADS = """
import os
del os.O_TMPFILE
from tracer.picture import parallel
parallel.has_gil = lambda: False
from tracer.__main__ import main
main()
"""
# Renders a scene in threads, and presses Ctrl-C when the tenth tile begins.  It prints how many
# tiles begin after that, and how many threads are left in the end.
INTERRUPTED_RENDER = """
import os, signal, sys, threading
import tracer
from tracer.picture import parallel
from tracer.picture.render_job import RenderJob

parallel.has_gil = lambda: False
scene = tracer.load_scene(sys.argv[1])
lock, tiles, render_tile = threading.Lock(), [], RenderJob.render_tile

def press_or_render(*arguments, **options):
    with lock:
        tiles.append(arguments)
        is_tenth = len(tiles) == 10
    if is_tenth:
        os.kill(os.getpid(), signal.SIGINT)
    return render_tile(*arguments, **options)

RenderJob.render_tile = press_or_render
try:
    tracer.render(scene, threads=int(sys.argv[2]))
except KeyboardInterrupt:
    print(len(tiles) - 10, threading.active_count())
"""
# Runs the tracer as on systems whose workers are spawned.
SPAWNED = """
import sys, types
from tracer.picture import parallel
parallel.sys = types.SimpleNamespace(platform="darwin", warnoptions=sys.warnoptions)
if __name__ == "__main__":
    from tracer.__main__ import main
    main()
"""

# Tests a libLLVM that hangs, and whose child process does not end after a KeyboardInterrupt.
HANGING_LLVM = """
from tracer.command.process import end_on_signals
end_on_signals()
from converters.variant import find_fastest_variant
find_fastest_variant('''
import time
while True:
    try:
        time.sleep(60)
    except KeyboardInterrupt:
        pass
''', timeout=2)
"""

MANY = [f"{k}.xml" for k in range(20)]

# Commands, and the files that they write.
COMMANDS = {
    "tracer large.xml --processes 2": ["large.xml.png"],
    f"named_files large.xml {' '.join(MANY)} --processes 2": [
        f"{name}.png" for name in ("large.xml", *MANY)
    ],
    f"threads large.xml {' '.join(MANY)} --processes 2": [
        f"{name}.png" for name in ("large.xml", *MANY)
    ],
    "converters.to_mitsuba ball.xml": ["ball.mitsuba.xml"],
    "reference.check ball.xml -o out.png": ["out.png"],
    "reference.certify ball.xml -o certified.png": ["certified.png"],
    "reference.compare hand-ins right.png --json": [],
    "reference.report ball.xml -o page.html": ["page.html"],
}

# Packages that commands need, and that have no wheel for every Python.
PACKAGES = {
    "reference.check": ["mitsuba"],
    "reference.compare": ["jinja2"],
    "reference.report": ["jinja2"],
    "hanging_llvm": ["mitsuba"],
}


def skip_without_package(command: str) -> None:
    """Skip the current test if a package is missing that a command needs."""
    for package in PACKAGES.get(command.split()[0], ()):
        try:
            metadata.version(package)  # a folder of tests has the name of a package
        except metadata.PackageNotFoundError:
            pytest.skip(f"{package} is not installed")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Create a folder with all files that `COMMANDS` read."""
    (tmp_path / "named_files.py").write_text(NAMED_FILES)
    (tmp_path / "spawned.py").write_text(SPAWNED)
    (tmp_path / "threads.py").write_text(THREADS)
    for name in MANY:
        write_ball(tmp_path / name, 400, 400)
    write_ball(tmp_path / "ball.xml", 60, 40)
    write_ball(tmp_path / "large.xml", 4000, 3000)
    image = np.random.default_rng(0).uniform(size=(60, 90, 3))
    write_png(tmp_path / "right.png", image)
    (tmp_path / "hand-ins").mkdir()
    for k in range(4):
        write_png(tmp_path / "hand-ins" / f"{k}.png", image * (0.9 + 0.01 * k))
    (tmp_path / "tmp").mkdir()
    return tmp_path


def list_processes() -> set[str]:
    """Return the ids of all running processes that commands of these tests have started."""
    ids, mark = set(), f"INTERRUPTED_BY={os.getpid()}".encode()
    for path in Path("/proc").glob("[0-9]*/environ"):
        with suppress(OSError):
            if mark in path.read_bytes():
                ids.add(path.parent.name)
    return ids


def start(command: str, folder: Path) -> subprocess.Popen[str]:
    """Start a command in a folder, and wait until it has installed its signal handlers."""
    environment = {"TMPDIR": str(folder / "tmp"), "INTERRUPTED_BY": str(os.getpid())}
    python = ["-m", *command.split()]
    process = start_process(python=python, cwd=folder, env=environment, start_new_session=True)
    status = Path(f"/proc/{process.pid}/status")
    while process.poll() is None:
        caught = re.search(r"SigCgt:\s*(\w+)", status.read_text())
        if caught and int(caught[1], 16) >> (signal.SIGTERM - 1) & 1:
            break
        time.sleep(0.001)
    return process


def interrupt(command: str, moment: float, number: int, folder: Path) -> int:
    """Interrupt a command, check that it leaves nothing behind, and return its exit status.

    Parameters
    ----------
    command
        A key of `COMMANDS`.
    moment
        Seconds after which the command is interrupted.
    number
        Determines the signal, how often it is sent, and whether all processes of the command
        receive it.
    """
    before = set(folder.rglob("*"))
    process = start(command, folder)
    time.sleep(moment)
    # In a terminal, Ctrl-C reaches all processes of the group, and users may press it twice.
    send = os.killpg if number % 2 else os.kill
    for _ in range(1 + (number // 2) % 2):
        with suppress(ProcessLookupError):
            send(process.pid, INTERRUPTS[number % 5])
    out, err = process.communicate(timeout=60)
    assert drop_jit(err) == "", moment
    wait_until(lambda: not list_processes())
    if process.returncode != 130:  # the command had ended: its results are complete
        assert process.returncode in (0, 1, 3)
        assert out
        assert all((folder / name).exists() for name in COMMANDS[command])
    for name in COMMANDS[command]:
        (folder / name).unlink(missing_ok=True)
    assert set(folder.rglob("*")) == before
    return process.returncode


@pytest.mark.parametrize(
    "moments", [3, pytest.param(35, marks=pytest.mark.slow)], ids=["some", "many"]
)
@pytest.mark.parametrize("command", COMMANDS, ids=lambda command: command.split()[0])
def test_at_any_moment(command, moments, folder):
    skip_without_package(command)
    begin = time.monotonic()
    start(command, folder).communicate(timeout=60)
    duration = time.monotonic() - begin
    for name in COMMANDS[command]:
        (folder / name).unlink()
    seed = int(os.environ.get("INTERRUPTS_SEED", moments))
    print(f"INTERRUPTS_SEED={seed}")
    rng = random.Random(seed)
    statuses = []
    for k in range(moments):
        moment = (k + rng.random()) / moments * duration
        statuses.append(interrupt(command, moment, k, folder))
        if statuses[-1] != 130:  # the first run had to load files from the disk: it took longer
            duration = moment
    assert 130 in statuses


@pytest.mark.parametrize("ignored", [signal.SIGINT, signal.SIGCHLD])
def test_signals_that_the_caller_ignores(folder, ignored):
    """Scripts ignore SIGINT for commands in the background, and some servers SIGCHLD."""
    ignore = lambda: signal.signal(ignored, signal.SIG_IGN)  # noqa: E731
    process = start_process("ball.xml", *MANY, "--quiet", preexec_fn=ignore, cwd=folder)
    while process.poll() is None:
        process.send_signal(ignored)
        time.sleep(0.01)
    assert (*process.communicate(), process.returncode) == ("", "", 0)
    assert all((folder / f"{name}.png").exists() for name in ("ball.xml", *MANY))


@pytest.mark.parametrize("threads", [1, 3])
def test_ctrl_c_ends_a_render_within_the_time_of_a_tile(threads, folder):
    """The two workers finish at most the two tiles each that they have been given."""
    script = ("-c", INTERRUPTED_RENDER)
    status, out, err = run(folder / "large.xml", threads, python=script)
    assert (status, err) == (0, "")
    later_tile_count, thread_count = map(int, out.split())
    assert later_tile_count <= (0 if threads == 1 else 5)
    assert thread_count == 1


def test_spawned_workers_end_without_a_warning(folder):
    """Python's resource tracker removes their semaphores, and must not warn of them."""
    with start(f"spawned large.xml {' '.join(MANY)} --processes 2", folder) as process:
        assert process.stdout.readline().startswith("large.xml.png: ")
        process.send_signal(signal.SIGTERM)
        assert (process.wait(20), process.stderr.read()) == (130, "")
    wait_until(lambda: not list_processes())


@pytest.mark.parametrize(
    ("send", "signal_number"), [(os.killpg, signal.SIGINT), (os.kill, signal.SIGKILL)]
)
def test_the_child_that_tests_libllvm_ends_with_its_parent(send, signal_number, folder):
    skip_without_package("hanging_llvm")
    (folder / "hanging_llvm.py").write_text(HANGING_LLVM)
    environment = {"INTERRUPTED_BY": str(os.getpid())}
    with start_process(
        python=["-m", "hanging_llvm"], cwd=folder, env=environment, start_new_session=True
    ) as process:
        wait_until(lambda: len(list_processes()) == 2)
        time.sleep(0.2)  # the child handles signals only after its start
        send(process.pid, signal_number)
    wait_until(lambda: not list_processes())


@needs_two
@pytest.mark.parametrize("delay", [0.02, 0.04, 0.08, 0.12])
def test_ctrl_c_while_spawned_workers_start(delay, folder):
    """The signal reaches all processes, and Python prints a traceback if it is not yet handled."""
    with start("spawned large.xml --processes 2", folder) as process:
        wait_until(lambda: len(workers_of(process)) == 2)  # a worker, and Python's resource tracker
        time.sleep(delay)
        os.killpg(process.pid, signal.SIGINT)
        assert (process.wait(20), process.stderr.read()) == (130, "")
    wait_until(lambda: not list_processes())


def test_watching_many_scenes_ends_with_its_workers(folder):
    with start(f"tracer {' '.join(MANY)} --watch --processes 2", folder) as process:
        for _ in range(2):
            names = [process.stdout.readline().partition(".png: ")[0] for _ in MANY]
            assert names == MANY
            for name in MANY:
                write_ball(folder / name, 300, 400)
        process.send_signal(signal.SIGTERM)
        assert process.wait(20) == 130
    wait_until(lambda: not list_processes())
    assert not [*folder.glob(".*")]


def test_watching_ends_when_nobody_reads(folder):
    with start("tracer ball.xml --watch", folder) as process:
        assert "ball.xml.png" in process.stdout.readline()
        process.stdout.close()
        write_ball(folder / "ball.xml", 61, 40)
        assert process.wait(20) == 0


@pytest.mark.parametrize(
    ("command", "status"),
    [
        ("tracer --pixel 3,3 ball.xml", 1),
        ("reference.compare hand-ins right.png --json", 3),
        ("reference.compare hand-ins right.png --csv", 3),
    ],
)
@pytest.mark.parametrize(
    "prepare",
    [lambda: os.close(1), lambda: os.dup2(os.open("/dev/full", os.O_WRONLY), 1)],
    ids=["a closed stream", "/dev/full"],
)
def test_results_that_cannot_be_printed(command, status, prepare, folder):
    skip_without_package(command)
    ended, _, err = run(python=["-m", *command.split()], cwd=folder, preexec_fn=prepare)
    assert (ended, err.count("\n")) == (status, 1)
    assert err.startswith("standard output: cannot be written: ")
