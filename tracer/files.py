"""Write whole files, or none."""

from __future__ import annotations

import errno
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import IO

unfinished: set[str] = set()
"""Part files, which a process that ends early must remove."""


@contextmanager
def atomic_file(path: str | os.PathLike[str], magic: bytes) -> Iterator[IO[bytes]]:
    """Open a new binary file that replaces `path` once it is whole, and vanishes after an error.

    A link stays a link: the file that it points to is replaced.  Refuses to replace a non-empty
    file that does not start with `magic`.

    Raises
    ------
    OSError
        If it cannot be written, or what is there is not a regular file, or of another kind.
    """
    target, mode = os.path.realpath(path), None
    with suppress(FileNotFoundError):
        mode = os.stat(target).st_mode
        if not stat.S_ISREG(mode):
            raise OSError(errno.EINVAL, "not a regular file", target)
        with open(target, "r+b") as there:  # only those who may write it may replace it
            if there.read(len(magic)) not in (magic, b""):
                raise FileExistsError(errno.EEXIST, "a file of another kind is there", target)
    folder = os.path.dirname(target)
    # Not the name itself: that may be as long as a name can be.
    part = os.path.join(folder, f".{os.urandom(8).hex()}.part")
    unfinished.add(part)
    try:
        with _nameless(folder, part) as file:
            yield file
            if not os.fstat(file.fileno()).st_nlink:
                os.link(f"/proc/self/fd/{file.fileno()}", part, src_dir_fd=0, follow_symlinks=True)
        if mode is not None:
            os.chmod(part, stat.S_IMODE(mode))
        os.replace(part, target)
    except BaseException as error:
        if isinstance(error, OSError) and error.filename in (folder, part):
            error.filename = target
        with suppress(OSError):
            os.unlink(part)
        raise
    finally:
        unfinished.discard(part)


def _nameless(folder: str, part: str) -> IO[bytes]:
    """Open a file without a name, which vanishes with its process; or one named `part`."""
    if hasattr(os, "O_TMPFILE") and os.path.isdir("/proc/self/fd"):
        with suppress(OSError):  # not on all file systems
            return open(os.open(folder, os.O_TMPFILE | os.O_WRONLY, 0o666), "wb")
    return open(part, "xb")
