"""Write files so that an incomplete file never has the name of the result.

A new file gets its name only when it is complete.  Until then it has no name at all, so that it
vanishes when its process ends for any reason.  On systems without nameless files, it has a
temporary name until then: it is a *part file*, which is removed if the process ends early.
"""

from __future__ import annotations

import errno
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import IO

_part_files: set[str] = set()
"""Paths that the part files of this process have, or will have."""


@contextmanager
def open_atomically(path: str | os.PathLike[str], magic: bytes) -> Iterator[IO[bytes]]:
    """Open a new file for a with block, and put it in place if the block raises no error.

    At the end of the block, the new file replaces the file at `path`, and takes over the
    permissions of the old file.  After an error in the block, the new file is deleted, and the file
    at `path` is unchanged.  If `path` is a symbolic link, the target of the link is replaced.

    Parameters
    ----------
    path : str or path-like
        Path of the file.  If a file already exists there, it must be writable, and it must be empty
        or begin with `magic`.
    magic : bytes
        The first bytes of every file of this kind.  If empty, a file of any kind is replaced.

    Yields
    ------
    file : binary file
        The new file, which is empty and open for writing.  The attribute `name` is the temporary
        path of the file or, on Linux, a file descriptor.

    Raises
    ------
    OSError
        If the file cannot be written, or `path` exists but is not a regular file.
    FileExistsError
        If a file of another kind exists at `path`.  This is a subclass of OSError.
    """
    target_path, old_mode = os.path.realpath(path), None
    with suppress(FileNotFoundError):
        old_mode = os.stat(target_path).st_mode
        if not stat.S_ISREG(old_mode):
            raise OSError(errno.EINVAL, "not a regular file", target_path)
        # Open it for writing, because a file without write permission must not be replaced.
        with open(target_path, "r+b") as old_file:
            if old_file.read(len(magic)) not in (magic, b""):
                raise FileExistsError(errno.EEXIST, "a file of another kind is there", target_path)
    folder = os.path.dirname(target_path)
    # The name is random, because a name derived from that of the file could be too long.
    part_path = os.path.join(folder, f".{os.urandom(8).hex()}.part")
    _part_files.add(part_path)
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
        with suppress(OSError):
            os.unlink(part_path)
        raise
    finally:
        _part_files.discard(part_path)


def _create_temporary_file(folder: str, fallback_path: str) -> IO[bytes]:
    """Create a temporary file, which has no name if the system supports unnamed files.

    Parameters
    ----------
    folder : str
        Folder that will contain the file when it is complete.
    fallback_path : str
        Path of the file if it must have a name.

    Returns
    -------
    file : binary file
        The new file, open for writing.

    Raises
    ------
    OSError
        If the file cannot be created.
    """
    if hasattr(os, "O_TMPFILE") and os.path.isdir("/proc/self/fd"):
        with suppress(OSError):  # some file systems do not support unnamed files
            return open(os.open(folder, os.O_TMPFILE | os.O_WRONLY, 0o666), "wb")
    return open(fallback_path, "xb")


def remove_part_files() -> None:
    """Delete the part files (incomplete files with temporary names) of this process.

    Call this only when the process is about to end.  A file that cannot be deleted is skipped.
    """
    for path in [*_part_files]:  # a copy, because another thread may change the set
        with suppress(OSError):
            os.unlink(path)
