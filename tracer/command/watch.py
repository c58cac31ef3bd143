"""Find out when a file has been saved, for the option --watch.

An editor may write a file in pieces.  So a version of a file counts as complete when two successive
checks have found it.
"""

from __future__ import annotations

import os
import stat
import zlib
from contextlib import suppress
from dataclasses import dataclass, field, replace
from time import monotonic

from tracer.scene.elements import MAX_BYTES

# Seconds after a save in which another save may leave the same time in the file, so that only its
# content shows it.  The coarsest times are those of FAT, 2 seconds; the rest is a margin.
_TIME_RESOLUTION_SECONDS = 3.0


class WatchedFile:
    """A scene file that is checked again and again, and need not exist."""

    def __init__(self, path: str) -> None:
        self._path = path
        self._version = _read_version(path, None)  # as of the last check
        self._reported_version: _FileVersion | None = None

    def has_new_version(self) -> bool:
        """Check the file; return True if its version is complete and has not been reported yet.

        Each version is reported only once, by the first call that returns True for it.
        """
        previous_version = self._version
        self._version = _read_version(self._path, previous_version)
        is_complete = self._version == previous_version
        is_new = is_complete and self._version != self._reported_version
        if is_new:
            self._reported_version = self._version
        return is_new


@dataclass(frozen=True)
class _FileVersion:
    """A version of a scene file.  Versions are equal if the file was not saved between them."""

    # Modification time, size and inode number; None if the file cannot be accessed.
    status: tuple[int, int, int] | None
    checksum: int  # checksum of the content
    first_seen: float = field(compare=False)  # when the status was first seen, by `monotonic`
    # Whether the status is so old that every later save will change it.
    is_settled: bool = field(compare=False)


def _read_version(path: str, previous: _FileVersion | None) -> _FileVersion:
    """Read the version of a file.

    `previous` is the version that was read before, or None.  It is returned, without reading the
    file again, if it is settled and the status of the file is still the same.
    """
    now = monotonic()
    status = None
    is_readable = False
    with suppress(OSError):
        result = os.stat(path)
        status = result.st_mtime_ns, result.st_size, result.st_ino
        is_readable = stat.S_ISREG(result.st_mode) and result.st_size <= MAX_BYTES
    if previous is None or previous.status != status:
        previous = _FileVersion(status=status, checksum=0, first_seen=now, is_settled=False)
    elif previous.is_settled:
        return previous
    checksum = 0
    if is_readable:
        with suppress(OSError), open(path, "rb") as file:
            checksum = zlib.crc32(file.read())
    is_settled = now - previous.first_seen > _TIME_RESOLUTION_SECONDS
    return replace(previous, checksum=checksum, is_settled=is_settled)
