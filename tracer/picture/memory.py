"""Make the C library keep freed memory for later arrays, and give threads little memory.

Without the first, many pictures would spend half of their time on requesting fresh memory from the
system.  Without the second, a command that starts workers would fail where address space is limited
(``ulimit -v``), although a single process has enough.
"""

from __future__ import annotations

import ctypes
import threading
from collections.abc import Callable
from contextlib import suppress
from functools import cache

import numpy as np

# Parameters of mallopt(3), from glibc's malloc.h.
_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD, _M_ARENA_MAX = -1, -3, -8

# Maximum size of an array that is allocated on the heap, in bytes: glibc allows no more.
_MAX_HEAP_BLOCK_BYTES = 1 << 25

# Number of bytes of the heap for which large pages are requested.  Twice as many bytes of freed
# memory are kept.  The arrays of a picture take about 30 MB, or 130 MB if pixels are divided.
_LARGE_PAGE_BYTES = 1 << 27

# Size of the stack of a thread, in bytes: what macOS gives a thread.
_STACK_BYTES = 1 << 19


@cache
def keep_freed_memory() -> None:
    """Make glibc, the C library of Linux, keep freed memory for later arrays.

    By default, glibc returns freed memory to the system.  Requesting memory again often takes
    longer than the arithmetic on the new arrays.

    The setting applies to this process and to processes forked from it, and further calls do
    nothing.  With another C library, nothing is changed, and no error is raised.
    """
    mallopt = _load_mallopt()
    if mallopt is None:
        return
    mallopt(_M_MMAP_THRESHOLD, _MAX_HEAP_BLOCK_BYTES)
    mallopt(_M_TRIM_THRESHOLD, 2 * _LARGE_PAGE_BYTES)
    # Get large pages for the heap: NumPy requests them with madvise(2) for arrays of this size.
    # The arrays are deleted immediately and use no memory because nothing is written to them.
    with suppress(MemoryError):
        _ = [
            np.empty(_MAX_HEAP_BLOCK_BYTES - 4096, np.uint8)
            for _ in range(_LARGE_PAGE_BYTES // _MAX_HEAP_BLOCK_BYTES)
        ]


def limit_thread_memory() -> None:
    """Limit the address space that each later thread of this process takes.

    By default, a thread takes 8 MB for its stack on Linux and, if it can, 64 MB for a heap of its
    own.  Both count towards the limit that ``ulimit -v`` sets.
    """
    threading.stack_size(_STACK_BYTES)
    mallopt = _load_mallopt()
    if mallopt is not None:
        mallopt(_M_ARENA_MAX, 1)


def _load_mallopt() -> Callable[[int, int], int] | None:
    """Load the function mallopt(3); return None if the C library does not have it."""
    with suppress(OSError, TypeError, AttributeError):
        mallopt: Callable[[int, int], int] = ctypes.CDLL(None).mallopt
        return mallopt
    return None
