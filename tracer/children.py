"""End the child processes that `multiprocessing` has started, stopped ones, too."""

from __future__ import annotations

import os
import signal
import sys
from contextlib import suppress
from time import monotonic


def terminate_children() -> None:
    """Send SIGTERM to all child processes, and let stopped ones go on, so that they receive it.

    A worker then removes its part files (see `tracer.files`), as soon as its current operation on
    arrays is finished, and ends.
    """
    # Not imported: without the module there are no children, and importing it takes milliseconds.
    multiprocessing = sys.modules.get("multiprocessing")
    for child in multiprocessing.active_children() if multiprocessing else ():
        with suppress(OSError):  # it has ended meanwhile
            child.terminate()
            if sys.platform != "win32":
                os.kill(child.pid, signal.SIGCONT)


def end_children(max_seconds: float) -> None:
    """Terminate all child processes, and kill those that still run after the given time."""
    import multiprocessing

    terminate_children()
    deadline = monotonic() + max_seconds
    for child in multiprocessing.active_children():
        child.join(max(0.0, deadline - monotonic()))
        child.kill()  # nothing happens if it has ended
        child.join(max_seconds)
