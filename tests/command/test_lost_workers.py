"""Workers that are killed or stopped: the picture is complete, and nothing of them stays.

What a forked worker inherits belongs to the main process: its part files, its signal handlers and
its other workers.  So each test also runs without nameless files, as on NFS or FAT.
"""

import os
import signal
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from running import file_names, start_process, wait_until, workers_of, write_ball

import tracer

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="other systems have no /proc")

# How the command runs: with four processes, however many processors there are.
COMMAND = """
import multiprocessing, os, signal, sys, types
os.sched_getaffinity = lambda _: set(range(4))
if {named}:
    del os.O_TMPFILE
if {spawned}:
    from tracer.picture import parallel
    parallel.sys = types.SimpleNamespace(platform="darwin", warnoptions=sys.warnoptions)
replace = os.replace

def replace_or_die(part_path, path):
    if multiprocessing.parent_process() is not None:
        if {dying}:
            os.kill(os.getpid(), signal.SIGKILL)
        if {orphaned}:
            os.symlink(part_path, "part")
            os.kill(os.getppid(), signal.SIGKILL)
            signal.pause()
    replace(part_path, path)

os.replace = replace_or_die
if __name__ == "__main__":
    from tracer.__main__ import main
    main()
"""


@pytest.fixture(params=[False, True], ids=["nameless", "named"])
def is_named(request: pytest.FixtureRequest) -> bool:
    """Whether incomplete files have names."""
    return bool(request.param)


def write_command(
    folder: Path,
    *,
    named: bool,
    spawned: bool = False,
    dying: bool = False,
    orphaned: bool = False,
) -> str:
    """Write the module of a command in which a worker may do something before it renames a file.

    If `dying`, it kills itself; if `orphaned`, it kills the command's main process, and waits.
    """
    text = COMMAND.format(named=named, spawned=spawned, dying=dying, orphaned=orphaned)
    (folder / "command.py").write_text(text)
    return "command"


def read_state(process_id: int) -> str:
    """Return the state of a process, such as "T" for stopped; "" if there is no such process."""
    try:
        return Path(f"/proc/{process_id}/stat").read_text().rpartition(") ")[2][:1]
    except OSError:
        return ""


def is_running(process_id: int) -> bool:
    """Test whether a process exists, and is no zombie."""
    return read_state(process_id) not in ("", "Z")


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM])
def test_a_killed_worker_costs_no_picture(is_named, number, tmp_path):
    """When one worker dies, Python's pool sends SIGTERM to the others."""
    scene = write_ball(tmp_path / "large.xml", 3000, 2000)
    module = write_command(tmp_path, named=is_named)
    with start_process("large.xml", "--quiet", python=("-m", module), cwd=tmp_path) as process:
        wait_until(lambda: len(workers_of(process)) == 3)
        os.kill(workers_of(process)[0], number)
        assert (process.communicate(timeout=120), process.returncode) == (("", ""), 0)
    assert file_names(tmp_path) == ["command.py", "large.xml", "large.xml.png"]
    with Image.open(tmp_path / "large.xml.png") as picture:
        expected = tracer.to_codes(tracer.render(tracer.load_scene(scene)))
        assert np.array_equal(np.asarray(picture), expected)


@pytest.mark.parametrize("spawned", [False, True], ids=["forked", "spawned"])
def test_part_files_of_killed_workers_are_removed(is_named, spawned, tmp_path):
    scenes = [write_ball(tmp_path / f"{k}.xml", 400, 300).name for k in range(40)]
    module = write_command(tmp_path, named=is_named, spawned=spawned, dying=True)
    (tmp_path / "new").mkdir()
    (tmp_path / "new" / ".0123456789abcdef-other.part").touch()  # of another command
    with start_process(
        *scenes, "-o", "new/", "--quiet", python=("-m", module), cwd=tmp_path
    ) as process:
        killed = set[int]()
        while process.poll() is None:
            killed |= {*workers_of(process)}
        assert (process.communicate(timeout=120), process.returncode) == (("", ""), 0)
    assert len(killed) >= 3
    wait_until(lambda: not any(map(is_running, killed)))  # the resource tracker ends last
    pictures = [f"{name}.png" for name in scenes]
    assert file_names(tmp_path / "new") == sorted([".0123456789abcdef-other.part", *pictures])


def test_a_worker_removes_its_part_file_when_the_command_is_killed(is_named, tmp_path):
    scenes = [write_ball(tmp_path / f"{k}.xml", 400, 300).name for k in range(40)]
    module = write_command(tmp_path, named=is_named, orphaned=True)
    with start_process(*scenes, "--quiet", python=("-m", module), cwd=tmp_path) as process:
        assert process.wait(120) == -signal.SIGKILL
    part_file = tmp_path / "part"  # a link to the file, which does not exist once it is removed
    assert part_file.is_symlink()
    wait_until(lambda: not part_file.exists())


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_stopped_worker_ends_with_the_command(is_named, number, tmp_path):
    write_ball(tmp_path / "large.xml", 6000, 5000)
    module = write_command(tmp_path, named=is_named)
    with start_process("large.xml", python=("-m", module), cwd=tmp_path) as process:
        wait_until(lambda: len(workers_of(process)) == 3)
        workers = workers_of(process)
        os.kill(workers[0], signal.SIGSTOP)
        wait_until(lambda: read_state(workers[0]) == "T")
        process.send_signal(number)
        assert (process.communicate(timeout=20), process.returncode) == (("", ""), 130)
    wait_until(lambda: not any(map(is_running, workers)))
    assert file_names(tmp_path) == ["command.py", "large.xml"]
