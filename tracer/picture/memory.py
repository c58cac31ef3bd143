"""Make the C library keep freed memory for later arrays.

Otherwise many pictures would spend half of their time on requesting fresh memory from the system.
"""

from __future__ import annotations

import ctypes
from contextlib import suppress
from functools import cache

import numpy as np

# Parameters of mallopt(3), from glibc's malloc.h.
_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3

# Maximum size of an array that is allocated on the heap, in bytes: glibc allows no more.
_MAX_HEAP_BLOCK_BYTES = 1 << 25

# Number of bytes of the heap for which large pages are requested.  Twice as many bytes of freed
# memory are kept.  The arrays of a picture take about 30 MB, or 130 MB if pixels are divided.
_LARGE_PAGE_BYTES = 1 << 27


@cache
def keep_freed_memory() -> None:
    """Make glibc, the C library of Linux, keep freed memory for later arrays.

    By default, glibc returns freed memory to the system.  Requesting memory again often takes
    longer than the arithmetic on the new arrays.

    The setting applies to this process and to processes forked from it, and further calls do
    nothing.  With another C library, nothing is changed, and no error is raised.
    """
    with suppress(OSError, TypeError, AttributeError):
        mallopt = ctypes.CDLL(None).mallopt
        mallopt(_M_MMAP_THRESHOLD, _MAX_HEAP_BLOCK_BYTES)
        mallopt(_M_TRIM_THRESHOLD, 2 * _LARGE_PAGE_BYTES)
        # Get large pages for the heap: NumPy requests them with madvise(2) for arrays of this size.
        # The arrays are deleted immediately and use no memory because nothing is written to them.
        with suppress(MemoryError):
            _ = [
                np.empty(_MAX_HEAP_BLOCK_BYTES - 4096, np.uint8)
                for _ in range(_LARGE_PAGE_BYTES // _MAX_HEAP_BLOCK_BYTES)
            ]
