"""Files appear under their name only when they are whole, whatever goes wrong."""

from __future__ import annotations

import errno
import os
import signal
import stat
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import tracer.commands

from tracer import write_png
from tracer.files import atomic_file

BEGINS = b"begins"
PRECIOUS = BEGINS + b": precious"


@pytest.fixture
def there(tmp_path: Path) -> Path:
    path = tmp_path / "there"
    path.write_bytes(PRECIOUS)
    return path


def write(path: Path, data: bytes = BEGINS) -> None:
    with atomic_file(path, BEGINS) as file:
        file.write(data)


def contents(folder: Path) -> list[bytes]:
    return [path.read_bytes() for path in folder.iterdir()]


def test_a_picture_replaces_another_only_if_it_is_whole(tmp_path):
    write_png(path := tmp_path / "picture.png", np.zeros((1, 1, 3)))
    (before,) = contents(tmp_path)
    with pytest.raises(ValueError, match="NaN"):
        write_png(path, np.full((1, 1, 3), np.nan))
    assert contents(tmp_path) == [before]
    write_png(path, np.ones((1, 1, 3)))
    assert len(contents(tmp_path)) == 1
    assert path.read_bytes() != before


@pytest.mark.parametrize("error", [KeyboardInterrupt, MemoryError, OSError])
def test_a_failure_halfway(there, error):
    with pytest.raises(error), atomic_file(there, BEGINS) as file:  # noqa: PT012
        file.write(BEGINS)
        assert len(contents(there.parent)) == 2  # the new one, beside it
        raise error
    assert contents(there.parent) == [PRECIOUS]


def test_a_full_disk(there):
    """The system refuses to let a file grow beyond the limit of a process."""
    import resource

    old = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, old[1]))
    try:
        with pytest.raises(OSError, match="File too large"):
            write(there, bytes(100_000))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, old)
        signal.signal(signal.SIGXFSZ, handler)
    assert contents(there.parent) == [PRECIOUS]


def test_it_may_not_be_written(there, monkeypatch):
    """As by a user without privileges, for root may write everything."""

    def refuses(path: str, _mode: str) -> None:
        raise PermissionError(errno.EACCES, "Permission denied", path)

    monkeypatch.setattr("tracer.commands.open", refuses, raising=False)
    with pytest.raises(PermissionError):
        write(there)
    assert contents(there.parent) == [PRECIOUS]


@pytest.mark.parametrize("text", [b"<scene>", BEGINS[:-1], b"\n"])
def test_a_file_of_another_kind_stays(there, text):
    there.write_bytes(text)
    with pytest.raises(FileExistsError, match="a file of another kind is there"):
        write(there)
    assert contents(there.parent) == [text]
    there.write_bytes(b"")  # holds nobody's work
    write(there)
    assert contents(there.parent) == [BEGINS]


def test_permissions_are_kept_and_a_link_stays_one(there):
    there.chmod(0o640)
    link, new, other = (there.with_name(name) for name in ("link", "new", "other"))
    link.symlink_to(there.name)
    write(link)
    assert link.is_symlink()
    assert there.read_bytes() == BEGINS
    assert stat.S_IMODE(there.stat().st_mode) == 0o640
    write(new)
    other.touch()
    assert new.stat().st_mode == other.stat().st_mode


@pytest.mark.parametrize(
    ("target", "reason"),
    [
        ("folder", "not a regular file"),
        ("pipe", "not a regular file"),
        ("missing/picture.png", "No such file"),
        ("loop", "Too many levels of symbolic links"),
        ("turn", "Too many levels of symbolic links"),
    ],
)
def test_what_cannot_be_written(tmp_path, target, reason):
    (tmp_path / "folder").mkdir()
    os.mkfifo(tmp_path / "pipe")
    for link, to in (("loop", "loop"), ("turn", "back"), ("back", "turn")):
        (tmp_path / link).symlink_to(to)
    before = sorted(tmp_path.rglob("*"))
    with pytest.raises(OSError, match=reason) as caught:
        write(tmp_path / target)
    assert caught.value.filename == str(tmp_path / target)
    assert sorted(tmp_path.rglob("*")) == before
    assert (tmp_path / "loop").is_symlink()


WRITER = """if True:
    import sys, time
    from tracer.files import atomic_file
    with atomic_file(sys.argv[1], b"") as file:
        file.write(b"half")
        file.flush()
        print("begun", flush=True)
        time.sleep(60)
"""


def writer(path: Path) -> subprocess.Popen[bytes]:
    """Another process that has begun to write a file."""
    process = subprocess.Popen([sys.executable, "-c", WRITER, path], stdout=subprocess.PIPE)
    assert process.stdout is not None
    assert process.stdout.readline() == b"begun\n"
    process.stdout.close()
    return process


def test_what_a_killed_writer_leaves_is_removed_by_the_next(there):
    other = there.with_name("other")
    with writer(there) as lives:
        for path in (there, other):
            with writer(path) as process:
                process.kill()
        write(there)
        # What is left: of another file, and of a process that lives.
        assert sorted(contents(there.parent)) == [BEGINS, b"half", b"half"]
        lives.kill()
    write(there)
    write(other)
    assert contents(there.parent) == [BEGINS, BEGINS]


def test_two_writers_at_once_leave_one_whole_file(there):
    with atomic_file(there, BEGINS) as first, atomic_file(there, BEGINS) as second:
        first.write(BEGINS + b"1")
        second.write(BEGINS + b"2")
    assert contents(there.parent) == [BEGINS + b"1"]


def test_a_part_that_is_removed_before_it_is_locked(there, monkeypatch):
    """By another process, which takes it for what a killed one has left."""
    locked, removed = tracer.commands._locked, []

    def late(file, *, wait):  # type: ignore[no-untyped-def]
        if wait and not removed:
            removed.append(file.name)
            Path(file.name).unlink()
        return locked(file, wait=wait)

    monkeypatch.setattr(tracer.commands, "_locked", late)
    write(there)
    assert removed
    assert contents(there.parent) == [BEGINS]


def test_where_files_cannot_be_locked(there, monkeypatch):
    monkeypatch.setitem(sys.modules, "fcntl", None)
    write(there)
    assert contents(there.parent) == [BEGINS]
