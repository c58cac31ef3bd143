"""Write complete files, or none.

A new file gets its name only when it is complete.  Until then it has no name at all, so that it
vanishes with its process, whatever ends that; on systems without nameless files it has the name of
a part file, which is removed if the process ends early.
"""

from __future__ import annotations

import errno
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import IO

_part_files: set[str] = set()
"""Names of the part files that this process is writing."""


@contextmanager
def atomic_file(
    path: str | os.PathLike[str], magic: bytes, *, is_named: bool = False
) -> Iterator[IO[bytes]]:
    """Open a new binary file that replaces `path` when it is complete, and vanishes after an error.

    A link stays a link: the file that it refers to is replaced.

    Parameters
    ----------
    path : str or path-like
        Name of the file.  If it is there already, it must be empty or begin with `magic`.
    magic : bytes
        The first bytes of files of this kind.
    is_named : bool
        Whether the new file needs a name from the beginning, its attribute `name`, because another
        library will open it.

    Raises
    ------
    OSError
        If the file cannot be written; or what has this name is not a regular file, or is a file of
        another kind.
    """
    target, mode = os.path.realpath(path), None
    with suppress(FileNotFoundError):
        mode = os.stat(target).st_mode
        if not stat.S_ISREG(mode):
            raise OSError(errno.EINVAL, "not a regular file", target)
        with open(target, "r+b") as existing:  # only those who may write it may replace it
            if existing.read(len(magic)) not in (magic, b""):
                raise FileExistsError(errno.EEXIST, "a file of another kind is there", target)
    folder = os.path.dirname(target)
    # Not derived from the name of the file, which may be as long as a name can be.
    part_path = os.path.join(folder, f".{os.urandom(8).hex()}.part")
    _part_files.add(part_path)
    try:
        with open(part_path, "xb") if is_named else _open_nameless(folder, part_path) as file:
            yield file
            if not os.fstat(file.fileno()).st_nlink:
                nameless = f"/proc/self/fd/{file.fileno()}"
                os.link(nameless, part_path, src_dir_fd=0, follow_symlinks=True)
        if mode is not None:
            os.chmod(part_path, stat.S_IMODE(mode))
        os.replace(part_path, target)
    except BaseException as error:
        if isinstance(error, OSError) and error.filename == part_path:
            error.filename = target
        with suppress(OSError):
            os.unlink(part_path)
        raise
    finally:
        _part_files.discard(part_path)


def _open_nameless(folder: str, part_path: str) -> IO[bytes]:
    """Open a new file without a name in a folder; if this is impossible, one named `part_path`."""
    if hasattr(os, "O_TMPFILE") and os.path.isdir("/proc/self/fd"):
        with suppress(OSError):  # not on all file systems
            return open(os.open(folder, os.O_TMPFILE | os.O_WRONLY, 0o666), "wb")
    return open(part_path, "xb")


def remove_part_files() -> None:
    """Remove the part files of this process, which is about to end early.

    A part file is a new file that has a name of its own because it is not complete yet.
    """
    for path in [*_part_files]:  # another thread may change the set
        with suppress(OSError):
            os.unlink(path)
