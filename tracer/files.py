"""Write files so that an incomplete file never has the name of the result.

A new file gets its name only when it is complete.  Until then it has no name at all, so that it
vanishes when its process ends for any reason.  Some systems and file systems have no nameless files
(NFS, FAT and FUSE, for example).  There, and for a moment before a file replaces another, it is a
*part file*: a file with a temporary name.

`remove_part_files` deletes part files if a process ends early.  A process that is killed cannot
call it.  If this process was a worker, the main process of the command deletes its part files.  It
recognises them by a prefix that the part files of all its processes have.
"""

from __future__ import annotations

import errno
import os
import stat
from collections import defaultdict
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from typing import IO

# Paths that part files have, or may get, and folders in which workers write results.  Both are
# stored by the id of the process that uses them, because a forked worker inherits those of its
# parent, and must not delete the parent's part files.
_part_files = defaultdict[int, set[str]](set)
_result_folders = defaultdict[int, set[str]](set)

# Each command chooses its own prefix, so that it leaves the part files of other commands alone.
_part_prefix = f".{os.urandom(8).hex()}-"


def get_part_prefix() -> str:
    """Return the prefix of the names of all part files that this command writes."""
    return _part_prefix


def set_part_prefix(prefix: str) -> None:
    """Set the prefix of the names of part files to that of the main process.

    Every worker must call this: one that was spawned imports this module again, and so has chosen
    another prefix.
    """
    global _part_prefix
    _part_prefix = prefix


@contextmanager
def open_atomically(path: str | os.PathLike[str], magic: bytes) -> Iterator[IO[bytes]]:
    """Open a new file for a with block, and put it in place if the block raises no error.

    At the end of the block, the new file replaces the file at `path`, and takes over the
    permissions of the old file.  After an error in the block, the new file is deleted, and the file
    at `path` is unchanged.  If `path` is a symbolic link, the target of the link is replaced.

    The attribute `name` of the file is its temporary path, or its descriptor if the file has no
    name yet.

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
            _name_file(file, part_path)
        if old_mode is not None:
            os.chmod(part_path, stat.S_IMODE(old_mode))
        os.replace(part_path, target_path)
    except BaseException as error:
        if isinstance(error, OSError) and error.filename == part_path:
            _name_target(error, path, target_path)
        with suppress(OSError):
            os.unlink(part_path)
        raise
    finally:
        part_files.discard(part_path)


def _name_target(error: OSError, path: str | os.PathLike[str], target_path: str) -> None:
    """Change an error about a part file so that it is about the target, or its missing folder.

    `path` is the target as the caller named it, and `target_path` has no symbolic links.
    """
    error.filename = target_path
    folder = os.path.dirname(target_path)
    if isinstance(error, FileNotFoundError) and not os.path.lexists(folder):
        # Name the folder as the caller does, unless `path` is a link to another folder.
        given_folder = "" if os.path.islink(path) else os.path.dirname(path)
        error.strerror = f"the folder {given_folder or folder} does not exist"


def _check_old_file(path: str, magic: bytes) -> int | None:
    """Check that the file at a path may be replaced; return its mode, or None if there is no file.

    Raise OSError if it is not a regular file, or not writable.  Raise FileExistsError if it is not
    empty, and does not begin with `magic`.
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
    """Open a new file for writing that has no name or, if this is impossible, the fallback path."""
    if hasattr(os, "O_TMPFILE") and os.path.isdir("/proc/self/fd"):
        with suppress(OSError):  # some file systems do not support unnamed files
            return open(os.open(folder, os.O_TMPFILE | os.O_WRONLY, 0o666), "wb")
    return open(fallback_path, "xb")


def _name_file(file: IO[bytes], path: str) -> None:
    """Give a file this path if it has no name."""
    if not os.fstat(file.fileno()).st_nlink:
        # Only linkat(2) can follow the link to a file without a name, and Python calls it only if
        # `src_dir_fd` is given.  Its value does not matter, because the path is absolute.
        descriptor_path = f"/proc/self/fd/{file.fileno()}"
        os.link(descriptor_path, path, src_dir_fd=0, follow_symlinks=True)


def register_result_folders(result_paths: Iterable[str]) -> None:
    """Tell `remove_part_files` in which folders workers of this process write results.

    `result_paths` are the paths of these results.  Call this before the workers begin to write.
    """
    folders = {os.path.dirname(os.path.realpath(path)) for path in result_paths}
    _result_folders[os.getpid()] |= folders


def remove_part_files() -> None:
    """Delete the part files of this process, and those that its workers have left behind.

    Part files of workers are searched for in the folders that `register_result_folders` was given.
    Call this only when no result is being written: when this process is about to end, or after its
    workers have ended.  A file that cannot be deleted is skipped.
    """
    process_id = os.getpid()
    paths = [*_part_files[process_id]]  # a copy, because another thread may change the set
    for folder in _result_folders[process_id]:
        with suppress(OSError), os.scandir(folder) as entries:
            paths += [entry.path for entry in entries if entry.name.startswith(_part_prefix)]
    for path in paths:
        with suppress(OSError):
            os.unlink(path)
