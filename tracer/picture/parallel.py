"""Work shared with other processes: those of any executor, or a pool of this program's own.

NumPy's threads wait too much for the interpreter's lock, so processes share a picture's tiles.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, Any, TypeVar

# These take longer to import than a small picture to draw, and only a pool needs them.
if TYPE_CHECKING:
    from concurrent.futures import Executor, Future

_Item = TypeVar("_Item")
_Result = TypeVar("_Result")

# For each processor so many items wait in the executor's queue or are done there.
_QUEUED = 2


def processors() -> int:
    """How many processors this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def share(
    process: Callable[[_Item], _Result],
    items: Sequence[_Item],
    executor: Executor | None,
    remote: Callable[[_Item], _Result],
) -> Iterator[tuple[int, _Result]]:
    """Process items; yield their indices and results, in any order.

    An executor gets the last items, for `remote`, while this process takes the first that nobody
    has.  What fails there, for whatever reason, is done here, and raises its error here.
    """
    first, last, most = 0, len(items), _QUEUED * processors()
    queued = deque[tuple[int, "Future[_Result]"]]()
    while first < last or queued:
        while executor is not None and first < last and len(queued) < most:
            try:
                queued.append((last - 1, executor.submit(remote, items[last - 1])))
                last -= 1
            except (RuntimeError, OSError):  # a process has died, or none can be started
                executor = None
        if first < last:
            yield first, process(items[first])
            first += 1
        while queued and (first >= last or queued[0][1].done()):
            index, future = queued.popleft()
            try:
                result = future.result()
            except Exception:
                result = process(items[index])
            yield index, result


def worker_pool(count: int, initializer: Callable[..., None], *arguments: Any) -> Executor | None:
    """Processes for a program that does nothing else; None where there can be none.

    `initializer` prepares each of them.  They ignore Ctrl-C, which reaches all processes of a
    terminal, as this process decides what it means; and they end when this process has ended.
    """
    if count < 1:
        return None
    import multiprocessing
    from concurrent.futures import ProcessPoolExecutor

    # Forks have what is imported and prepared already.
    method = "fork" if sys.platform == "linux" and threading.active_count() == 1 else "spawn"
    context = multiprocessing.get_context(method)
    try:
        return ProcessPoolExecutor(count, context, _begin_worker, (initializer, arguments))
    except (OSError, ImportError):  # no semaphores, or no more files
        return None


def _begin_worker(initializer: Callable[..., None], arguments: tuple[Any, ...]) -> None:
    for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT"):
        if number := getattr(signal, name, None):
            signal.signal(number, signal.SIG_IGN if name == "SIGINT" else signal.SIG_DFL)
    threading.Thread(target=end_with_parent, daemon=True).start()
    initializer(*arguments)


def end_with_parent() -> None:
    import multiprocessing

    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
