"""Write files so that an incomplete file never has the name of the result.

A new file gets its name only when it is complete.  Until then it has no name at all, so that it
vanishes when its process ends for any reason.  Some systems and file systems have no nameless files
(NFS, FAT and FUSE, for example).  There, and for a moment before a file replaces another, it has a
temporary name: it is a *part file*, which is removed if the process ends early.

A process that is killed cannot remove its part files.  If it is a worker, the command's main
process does: see `share_folders`.
"""

from __future__ import annotations

import errno
import os
import stat
from collections import defaultdict
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from typing import IO

# Both by the id of the process to which they belong: a forked worker inherits those of its parent,
# and must not remove them.
_part_files = defaultdict[int, set[str]](set)  # paths that part files have, or will have
_shared_folders = defaultdict[int, set[str]](set)

_part_prefix = f".{os.urandom(8).hex()}-"


def get_part_prefix() -> str:
    """Return the beginning of the names of part files: other commands have other ones."""
    return _part_prefix


def set_part_prefix(prefix: str) -> None:
    """Begin the names of part files as the main process does, in a worker that is no fork of it."""
    global _part_prefix
    _part_prefix = prefix


@contextmanager
def open_atomically(path: str | os.PathLike[str], magic: bytes) -> Iterator[IO[bytes]]:
    """Open a new file for a with block, and put it in place if the block raises no error.

    At the end of the block, the new file replaces the file at `path`, and takes over the
    permissions of the old file.  After an error in the block, the new file is deleted, and the file
    at `path` is unchanged.  If `path` is a symbolic link, the target of the link is replaced.

    The attribute `name` of the file is its temporary path or, on Linux, a file descriptor.

    Parameters
    ----------
    path
        If a file already exists there, it must be writable, and it must be empty or begin with
        `magic`.
    magic
        The first bytes of every file of this kind.  If empty, a file of any kind is replaced.

    Raises
    ------
    OSError
        If the file cannot be written, or `path` exists but is not a regular file.
    FileExistsError
        If a file of another kind exists at `path`.  This is a subclass of OSError.
    """
    target_path = os.path.realpath(path)
    old_mode = _check_old_file(target_path, magic)
    folder = os.path.dirname(target_path)
    # The name is random, because a name derived from that of the file could be too long.
    part_path = os.path.join(folder, f"{_part_prefix}{os.urandom(8).hex()}.part")
    part_files = _part_files[os.getpid()]
    part_files.add(part_path)
    try:
        with _create_temporary_file(folder, part_path) as file:
            yield file
            if not os.fstat(file.fileno()).st_nlink:
                descriptor_path = f"/proc/self/fd/{file.fileno()}"
                os.link(descriptor_path, part_path, src_dir_fd=0, follow_symlinks=True)
        if old_mode is not None:
            os.chmod(part_path, stat.S_IMODE(old_mode))
        os.replace(part_path, target_path)
    except BaseException as error:
        if isinstance(error, OSError) and error.filename == part_path:
            error.filename = target_path
            if isinstance(error, FileNotFoundError) and not os.path.lexists(folder):
                given_folder = "" if os.path.islink(path) else os.path.dirname(path)
                error.strerror = f"the folder {given_folder or folder} does not exist"
        with suppress(OSError):
            os.unlink(part_path)
        raise
    finally:
        part_files.discard(part_path)


def _check_old_file(path: str, magic: bytes) -> int | None:
    """Check that the file at a path may be replaced, and return its mode; None if there is none.

    For `magic` and the errors, see `open_atomically`.
    """
    old_mode: int | None = None
    with suppress(FileNotFoundError):
        old_mode = os.stat(path).st_mode
        if not stat.S_ISREG(old_mode):
            raise OSError(errno.EINVAL, "not a regular file", path)
        # Open it for writing, because a file without write permission must not be replaced.
        with open(path, "r+b") as old_file:
            if old_file.read(len(magic)) not in (magic, b""):
                raise FileExistsError(errno.EEXIST, "a file of another kind is there", path)
    return old_mode


def _create_temporary_file(folder: str, fallback_path: str) -> IO[bytes]:
    """Create a file without a name or, if the system has no such files, at the fallback path."""
    if hasattr(os, "O_TMPFILE") and os.path.isdir("/proc/self/fd"):
        with suppress(OSError):  # some file systems do not support unnamed files
            return open(os.open(folder, os.O_TMPFILE | os.O_WRONLY, 0o666), "wb")
    return open(fallback_path, "xb")


def share_folders(paths: Iterable[str]) -> None:
    """Let `remove_part_files` remove the part files of workers, too, from the folders of results.

    The workers are processes that this process starts, and that write the results at these paths.
    """
    _shared_folders[os.getpid()] |= {os.path.dirname(os.path.realpath(path)) for path in paths}


def remove_part_files() -> None:
    """Delete the part files of this process, and those of its workers (see `share_folders`).

    Call this only when nothing is being written: before this process ends, or after its workers
    have.  A file that cannot be deleted is skipped.
    """
    process_id = os.getpid()
    paths = [*_part_files[process_id]]  # a copy, because another thread may change the set
    for folder in _shared_folders[process_id]:
        with suppress(OSError), os.scandir(folder) as entries:
            paths += [entry.path for entry in entries if entry.name.startswith(_part_prefix)]
    for path in paths:
        with suppress(OSError):
            os.unlink(path)
