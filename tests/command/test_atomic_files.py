"""Files appear under their name only when they are whole, whatever goes wrong."""

import errno
import os
import resource
import signal
import stat
from pathlib import Path
from typing import IO, Any

import pytest
from running import start_process

from tracer.files import atomic_file

MAGIC = b"magic"
PRECIOUS = MAGIC + b": precious"


@pytest.fixture(params=["without a name", "beside it"])
def there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest) -> Path:
    """A file that is to be replaced; the new one has no name, or one of its own, until then."""
    if request.param == "beside it":
        monkeypatch.delattr(os, "O_TMPFILE", raising=False)
    path = tmp_path / "there"
    path.write_bytes(PRECIOUS)
    return path


def write(path: Path, data: bytes = MAGIC) -> None:
    with atomic_file(path, MAGIC) as file:
        file.write(data)


def contents(folder: Path) -> list[bytes]:
    return [path.read_bytes() for path in folder.iterdir()]


@pytest.mark.parametrize("error", [KeyboardInterrupt, MemoryError, OSError])
def test_a_failure_halfway(there, error):
    with pytest.raises(error), atomic_file(there, MAGIC) as file:  # noqa: PT012
        file.write(MAGIC)
        file.flush()
        raise error
    assert contents(there.parent) == [PRECIOUS]


@pytest.mark.parametrize("size", [20, 100_000], ids=["less than a buffer", "more"])
def test_a_full_disk(there, size):
    """The system refuses to let a file grow beyond the limit of a process."""
    old = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (10, old[1]))
    try:
        with pytest.raises(OSError, match="File too large"):
            write(there, bytes(size))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, old)
        signal.signal(signal.SIGXFSZ, handler)
    assert contents(there.parent) == [PRECIOUS]


def test_a_file_that_may_not_be_written(there, monkeypatch):
    """As by a user without privileges, for root may write everything."""

    def refuses(path: str | int, mode: str) -> IO[Any]:
        if path == str(there) and mode != "rb":
            raise PermissionError(errno.EACCES, "Permission denied", path)
        return open(path, mode)  # noqa: PTH123

    monkeypatch.setattr("tracer.files.open", refuses, raising=False)
    with pytest.raises(PermissionError):
        write(there)
    assert contents(there.parent) == [PRECIOUS]


@pytest.mark.parametrize("text", [b"<scene>", MAGIC[:-1], b"\n"])
def test_a_file_of_another_kind_stays(there, text):
    there.write_bytes(text)
    with pytest.raises(FileExistsError, match="a file of another kind is there"):
        write(there)
    assert contents(there.parent) == [text]
    there.write_bytes(b"")  # holds nobody's work
    write(there)
    assert contents(there.parent) == [MAGIC]


def test_permissions_are_kept_and_a_link_stays_one(there):
    there.chmod(0o640)
    link, new, other = (there.with_name(name) for name in ("link", "new", "other"))
    link.symlink_to(there.name)
    write(link)
    assert link.is_symlink()
    assert there.read_bytes() == MAGIC
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
    ],
)
def test_targets_that_cannot_be_written(there, target, reason):
    folder = there.parent
    (folder / "folder").mkdir()
    os.mkfifo(folder / "pipe")
    (folder / "loop").symlink_to("loop")
    before = sorted(folder.rglob("*"))
    with pytest.raises(OSError, match=reason) as caught:
        write(folder / target)
    assert caught.value.filename == str(folder / target)
    assert sorted(folder.rglob("*")) == before
    assert (folder / "loop").is_symlink()


WRITER = """if True:
    import sys, time
    from tracer.files import atomic_file
    with atomic_file(sys.argv[1], b"") as file:
        file.write(b"half")
        file.flush()
        print("begun", flush=True)
        time.sleep(60)
"""


def test_a_killed_writer_leaves_nothing_behind(tmp_path):
    with start_process(tmp_path / "there", python=("-c", WRITER)) as process:
        assert process.stdout.readline() == "begun\n"
        process.kill()
    assert contents(tmp_path) == []


def test_two_writers_at_once_leave_one_whole_file(there):
    with atomic_file(there, MAGIC) as first, atomic_file(there, MAGIC) as second:
        first.write(MAGIC + b"1")
        second.write(MAGIC + b"2")
    assert contents(there.parent) == [MAGIC + b"1"]
