"""End the child processes that `multiprocessing` has started, even if they are stopped."""

from __future__ import annotations

import os
import signal
import sys
from contextlib import suppress
from time import monotonic


def terminate_children() -> None:
    """Send SIGTERM to all child processes, and SIGCONT, so that stopped ones receive it.

    This does not wait for their end.  A worker of a command first finishes its current operation on
    arrays, and deletes its temporary files.
    """
    # The module is not imported here, which would take milliseconds.  Without it, there are no
    # children.
    multiprocessing = sys.modules.get("multiprocessing")
    for child in multiprocessing.active_children() if multiprocessing else ():
        with suppress(OSError):  # it has ended meanwhile
            child.terminate()
            if sys.platform != "win32":
                os.kill(child.pid, signal.SIGCONT)


def end_children(max_seconds: float) -> None:
    """Terminate all child processes, and kill those that then do not end in time.

    Wait at most `max_seconds` until all have ended by themselves, and then at most as long for each
    child that is killed.
    """
    import multiprocessing

    terminate_children()
    deadline = monotonic() + max_seconds
    for child in multiprocessing.active_children():
        child.join(max(0.0, deadline - monotonic()))
        child.kill()  # does nothing if the child has ended
        child.join(max_seconds)
