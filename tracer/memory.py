"""Memory for arrays: where it comes from is half of the time of a small picture."""

from __future__ import annotations

from contextlib import suppress

import numpy as np

__all__ = ["keep_heap"]

# The largest block that glibc ever takes from the heap is 32 MB.
_MOST = (1 << 25) - (1 << 16)


def keep_heap() -> None:
    """Let the C library keep freed memory for the next array, in large pages.

    Fresh pages cost more than the arithmetic on them.  Freeing one block of
    nearly 32 MB raises glibc's thresholds (M_MMAP_THRESHOLD in mallopt(3)), so
    that smaller blocks are kept and reused from then on.  The second block comes
    from the heap, where NumPy thus asks for large pages (madvise(2)).  Neither
    block is ever touched.
    """
    with suppress(MemoryError):  # the picture may need far less
        for size in (_MOST, _MOST - (1 << 16)):
            np.empty(size, dtype=np.uint8)
