"""Distribute work to other processes: those of any executor, or of a pool for the command line.

Processes are used rather than threads.  Between two operations on arrays, a thread needs the lock
of the Python interpreter, so threads would often wait for each other.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, Any, TypeVar

# Importing these takes longer than rendering a small picture, and only a pool needs them.
if TYPE_CHECKING:
    from concurrent.futures import Executor, Future

_Item = TypeVar("_Item")
_Result = TypeVar("_Result")

# Maximum number of items, for each processor, that are submitted to an executor and not yet
# collected: enough to keep all processors busy.
_QUEUED_PER_PROCESSOR = 2


def processors() -> int:
    """Return the number of processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def map_unordered(
    function: Callable[[_Item], _Result],
    items: Sequence[_Item],
    executor: Executor | None,
    remote_function: Callable[[_Item], _Result],
) -> Iterator[tuple[int, _Result]]:
    """Apply a function to all items, partly in other processes, and yield the results in any order.

    This process takes items from the front of the sequence, and the executor from the back, until
    they meet.  If the executor fails to process an item, for whatever reason, this process applies
    `function` to the item.

    Parameters
    ----------
    function : callable
        Called in this process; its exceptions are passed on.
    items : sequence
        The arguments of the calls.
    executor : concurrent.futures.Executor or None
        If None, this process does all the work.
    remote_function : callable
        Called instead of `function` by the executor; must be picklable if `items` are sent to other
        processes.

    Yields
    ------
    index : int
        Index of an item.
    result : object
        The result of `function` or `remote_function` for this item.
    """
    front, back, max_queued = 0, len(items), _QUEUED_PER_PROCESSOR * processors()
    queue = deque[tuple[int, "Future[_Result]"]]()
    while front < back or queue:
        while executor is not None and front < back and len(queue) < max_queued:
            try:
                queue.append((back - 1, executor.submit(remote_function, items[back - 1])))
                back -= 1
            except (RuntimeError, OSError):  # a worker has died, or none can be started
                executor = None
        if front < back:
            yield front, function(items[front])
            front += 1
        while queue and (front >= back or queue[0][1].done()):
            index, future = queue.popleft()
            try:
                result = future.result()
            except Exception:
                result = function(items[index])
            yield index, result


def worker_pool(count: int, initializer: Callable[..., None], *arguments: Any) -> Executor | None:
    """Start a pool of worker processes.

    For the command line only, because this function forks the process where this is safe.  Workers
    ignore SIGINT: when the user presses Ctrl-C, the terminal sends it to all processes, and this
    process ends the workers.  Workers end by themselves if this process has ended.

    Parameters
    ----------
    count : int
        Number of worker processes.
    initializer : callable
        Called once in each worker, with `arguments`, before any work.
    *arguments
        Arguments of `initializer`.

    Returns
    -------
    pool : Executor or None
        None if `count` is less than 1, or if the system cannot start a pool.
    """
    if count < 1:
        return None
    import multiprocessing
    from concurrent.futures import ProcessPoolExecutor

    # A forked worker already has all modules and the prepared scene.  It is not safe to fork while
    # other threads run.
    method = "fork" if sys.platform == "linux" and threading.active_count() == 1 else "spawn"
    context = multiprocessing.get_context(method)
    try:
        return ProcessPoolExecutor(count, context, _begin_worker, (initializer, arguments))
    except (OSError, ImportError):  # no semaphores, or too many open files
        return None


def _begin_worker(initializer: Callable[..., None], arguments: tuple[Any, ...]) -> None:
    """Prepare a worker process, and call `initializer` with `arguments`.

    The worker ignores SIGINT, other signals end it immediately, and a thread ends it when the
    parent process has ended.
    """
    for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT"):
        if number := getattr(signal, name, None):
            signal.signal(number, signal.SIG_IGN if name == "SIGINT" else signal.SIG_DFL)
    threading.Thread(target=end_with_parent, daemon=True).start()
    initializer(*arguments)


def end_with_parent() -> None:
    """Wait until the parent process has ended, then end this process with exit status 1.

    Return immediately if this process has no parent in `multiprocessing`.
    """
    import multiprocessing

    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
