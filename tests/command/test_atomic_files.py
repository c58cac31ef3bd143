"""Files appear under their name only when they are complete, whatever goes wrong."""

import errno
import os
import resource
import signal
import stat
from pathlib import Path
from typing import IO, Any

import pytest
from running import start_process

from tracer.files import open_atomically

MAGIC = b"magic"
PRECIOUS = MAGIC + b": precious"


@pytest.fixture(params=["nameless", "named"])
def target(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest) -> Path:
    """Create a file to replace; new files are nameless, or have temporary names, until then."""
    if request.param == "named":
        monkeypatch.delattr(os, "O_TMPFILE", raising=False)
    path = tmp_path / "target"
    path.write_bytes(PRECIOUS)
    return path


def write(path: Path, data: bytes = MAGIC) -> None:
    """Write a complete file."""
    with open_atomically(path, MAGIC) as file:
        file.write(data)


def read_files(folder: Path) -> list[bytes]:
    """Return the contents of all files in a folder."""
    return [path.read_bytes() for path in folder.iterdir()]


@pytest.mark.parametrize("error", [KeyboardInterrupt, MemoryError, OSError])
def test_a_failure_halfway(target, error):
    with pytest.raises(error), open_atomically(target, MAGIC) as file:  # noqa: PT012
        file.write(MAGIC)
        file.flush()
        raise error
    assert read_files(target.parent) == [PRECIOUS]


@pytest.mark.parametrize("size", [20, 100_000], ids=["smaller than the buffer", "larger"])
def test_a_full_disk(target, size):
    """A limit of the process on the size of files stands for a full disk."""
    old_limit = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (10, old_limit[1]))
    try:
        with pytest.raises(OSError, match="File too large"):
            write(target, bytes(size))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, old_limit)
        signal.signal(signal.SIGXFSZ, handler)
    assert read_files(target.parent) == [PRECIOUS]


def test_a_file_that_may_not_be_written(target, monkeypatch):
    """`open` refuses to write, as for a user without privileges: root may write everything."""

    def refuse(path: str | int, mode: str) -> IO[Any]:
        if path == str(target) and mode != "rb":
            raise PermissionError(errno.EACCES, "Permission denied", path)
        return open(path, mode)  # noqa: PTH123

    monkeypatch.setattr("tracer.files.open", refuse, raising=False)
    with pytest.raises(PermissionError):
        write(target)
    assert read_files(target.parent) == [PRECIOUS]


@pytest.mark.parametrize("text", [b"<scene>", MAGIC[:-1], b"\n"])
def test_a_file_of_another_kind_stays(target, text):
    target.write_bytes(text)
    with pytest.raises(FileExistsError, match="a file of another kind is there"):
        write(target)
    assert read_files(target.parent) == [text]
    target.write_bytes(b"")  # an empty file contains nobody's work
    write(target)
    assert read_files(target.parent) == [MAGIC]


def test_permissions_are_kept_and_a_link_stays_one(target):
    target.chmod(0o640)
    link, new, other = (target.with_name(name) for name in ("link", "new", "other"))
    link.symlink_to(target.name)
    write(link)
    assert link.is_symlink()
    assert target.read_bytes() == MAGIC
    assert stat.S_IMODE(target.stat().st_mode) == 0o640
    write(new)
    other.touch()
    assert new.stat().st_mode == other.stat().st_mode


def test_a_folder_is_not_replaced(target):
    """`tests/command/refusals.txt` has other paths that cannot be written."""
    (target.parent / "folder").mkdir()
    with pytest.raises(OSError, match="not a regular file") as caught:
        write(target.parent / "folder")
    assert caught.value.filename == str(target.parent / "folder")
    assert (target.parent / "folder").is_dir()


WRITER = """if True:
    import sys, time
    from tracer.files import open_atomically
    with open_atomically(sys.argv[1], b"") as file:
        file.write(b"half")
        file.flush()
        print("begun", flush=True)
        time.sleep(60)
"""


def test_a_killed_writer_leaves_nothing_behind(tmp_path):
    with start_process(tmp_path / "target", python=("-c", WRITER)) as process:
        assert process.stdout.readline() == "begun\n"
        process.kill()
    assert read_files(tmp_path) == []


def test_two_writers_leave_one_complete_file(target):
    with open_atomically(target, MAGIC) as first, open_atomically(target, MAGIC) as second:
        first.write(MAGIC + b"1")
        second.write(MAGIC + b"2")
    assert read_files(target.parent) == [MAGIC + b"1"]
