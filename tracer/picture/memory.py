"""Memory for arrays: where it comes from is half of the time of many pictures."""

from __future__ import annotations

import ctypes
from contextlib import suppress
from functools import cache

import numpy as np

# In glibc's malloc.h: parameters of mallopt(3).
_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3

# Blocks of up to this many bytes come from the heap; glibc allows no more.  So much of that lies in
# large pages, and twice as much is kept: arrays take some 30 MB, or 130 where pixels are split.
_BLOCK_BYTES, _HEAP_BYTES = 1 << 25, 1 << 27


@cache
def keep_heap() -> None:
    """Let the C library keep freed memory for the next array, in large pages.

    Fresh pages cost more than the arithmetic on them, and by default glibc gives back whatever is
    free at the heap's end.  With another C library nothing happens, nor when called again.
    """
    with suppress(OSError, TypeError, AttributeError):
        mallopt = ctypes.CDLL(None).mallopt
        mallopt(_M_MMAP_THRESHOLD, _BLOCK_BYTES)
        mallopt(_M_TRIM_THRESHOLD, 2 * _HEAP_BYTES)
        # For blocks this large NumPy asks for large pages (madvise(2)).  They are never touched;
        # if there is not as much memory, the picture may need far less.
        with suppress(MemoryError):
            _ = [
                np.empty(_BLOCK_BYTES - 4096, np.uint8) for _ in range(_HEAP_BYTES // _BLOCK_BYTES)
            ]
