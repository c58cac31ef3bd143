"""Distribute work between this process and others: those of any executor, or a command's own pool.

The problem is that workers fail: they are killed, stop, run out of memory, or never answer.  The
solution has two parts.  (1) Any process can process any item, with the same result.  (2) This
process depends on no other one: when all items are taken, it repeats those that are not finished.
So a worker that fails costs time, but no result.

Processes are used rather than threads.  Between two operations on arrays, a thread needs the lock
of the Python interpreter, so threads would often wait for each other.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from time import perf_counter
from typing import TYPE_CHECKING, Any, Generic, Protocol, TypeVar

from tracer.files import remove_part_files

# Importing these takes longer than rendering a small picture, and only a pool needs them.
if TYPE_CHECKING:
    from concurrent.futures import Future, ProcessPoolExecutor

_Item = TypeVar("_Item")
_Result = TypeVar("_Result")

# Maximum number of items for each worker that are submitted and not yet finished: enough to keep
# the worker busy.
_ITEMS_PER_WORKER = 2

# Maximum number of times that a pool is started.  It is started again if a worker has died.
_MAX_STARTS = 4

# Maximum time, in seconds, for which the end of a pool is waited for.  Usually it takes
# milliseconds, but a worker that dies while it sends a result leaves half of a message, and then a
# thread of the pool waits for the rest.
_MAX_END_SECONDS = 0.5


def processors() -> int:
    """Return the number of processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class Executor(Protocol):
    """The part of a `concurrent.futures.Executor` that is used here."""

    def submit(self, fn: Callable[..., Any], /, *args: Any) -> Future[Any]:
        """Schedule the call ``fn(*args)``, and return the future of its result."""


class Distribution(Generic[_Item, _Result]):
    """Work that this process shares with an executor; iterate over it for the results.

    This process and the executor both take the next item from the front.  When all items are taken,
    this process repeats the items that the executor has not finished.  It begins with those that no
    worker has begun.  It repeats another one only after waiting for it as long as the longest item
    has taken in this process.  If the executor fails to process an item, for whatever reason, this
    process does it.

    Each step of the iteration yields the index of an item and its result.  The order is nearly that
    of the items; `in_order` restores the order.

    Parameters
    ----------
    function : callable
        Called with an item, in this process.  Its exceptions are passed on.
    items : sequence
        The arguments of the calls.
    executor : Executor or None
        If None, this process does all the work.
    remote_function : callable
        Called with an item by the executor.  If the executor has processes, the function, the items
        and the results must be picklable.
    accepts : callable
        Called with an item and what the executor returned for it.  If it returns False, the
        executor counts as having failed.
    workers : int
        Number of workers that the executor is supposed to have.

    Attributes
    ----------
    executor : Executor or None
        May be set, at any time, to share the remaining items.
    """

    def __init__(
        self,
        function: Callable[[_Item], _Result],
        items: Sequence[_Item],
        executor: Executor | None,
        remote_function: Callable[[_Item], _Result],
        accepts: Callable[[_Item, Any], bool],
        *,
        workers: int,
    ) -> None:
        self._function, self._remote_function = function, remote_function
        self._items, self._accepts = items, accepts
        self.executor, self._workers = executor, workers
        self._next_index = 0
        # Futures that are not yet collected, by the index of their item, in order of submission.
        self._futures = dict[int, "Future[_Result]"]()
        # The item that this process is repeating, and its future.
        self._repeated: tuple[int, Future[_Result]] | None = None
        self._longest_seconds = 0.0

    def __iter__(self) -> Iterator[tuple[int, _Result]]:
        """Process all items; yield the index of each and its result."""
        try:
            while self._next_index < len(self._items) or self._futures:
                self.submit()
                if self._next_index < len(self._items):
                    self._next_index += 1
                    yield self._process(self._next_index - 1)
                elif self._futures:
                    # The item submitted last is the least likely to be begun.
                    index, future = next(reversed(self._futures.items()))
                    if future.cancel() or not self._wait():
                        self._repeated = index, self._futures.pop(index)
                        yield self._process(index)
                        self._repeated = None
                for index in [index for index, f in self._futures.items() if f.done()]:
                    future = self._futures.pop(index)
                    is_accepted = self._is_accepted(index, future)
                    yield (index, future.result()) if is_accepted else self._process(index)
        finally:
            for future in self._futures.values():
                future.cancel()

    def submit(self) -> None:
        """Submit items to the executor until all its workers are busy.

        If the executor raises an error, no more items are submitted, and this process does all the
        remaining work.  A `function` that takes long should call this method from time to time.
        """
        pending = sum(not future.done() for future in self._futures.values())
        # This process keeps its own share of the remaining items.
        share = (len(self._items) - self._next_index) * self._workers // (self._workers + 1)
        for _ in range(min(_ITEMS_PER_WORKER * self._workers - pending, share)):
            if self.executor is None:
                return
            index = self._next_index
            try:
                future = self.executor.submit(self._remote_function, self._items[index])
            except Exception:  # a worker has died, none can be started, or anything else
                self.executor = None
                return
            self._futures[index] = future
            self._next_index += 1

    @property
    def is_obsolete(self) -> bool:
        """True if a worker has finished the item that this process is repeating.

        If so, `function` may return immediately: the worker's result is taken instead of its own.
        """
        return self._repeated is not None and self._is_accepted(*self._repeated)

    def _process(self, index: int) -> tuple[int, _Result]:
        """Process an item in this process.

        Parameters
        ----------
        index : int
            Index of the item.

        Returns
        -------
        index : int
            The same index.
        result : object
            The result of `function`; or that of a worker, if the item is repeated and a worker has
            finished the item in the meantime.
        """
        start = perf_counter()
        result = self._function(self._items[index])
        self._longest_seconds = max(self._longest_seconds, perf_counter() - start)
        if self._repeated is not None and self.is_obsolete:
            result = self._repeated[1].result()
        return index, result

    def _is_accepted(self, index: int, future: Future[_Result]) -> bool:
        """Test whether a worker has finished an item, and its result is acceptable.

        Parameters
        ----------
        index : int
            Index of the item.
        future : Future
            The future that the executor returned for the item.

        Returns
        -------
        is_accepted : bool
            True if the future has a result, and `accepts` does not refuse the result.  False if the
            future is not done, is cancelled, or has an exception.
        """
        # An exception may be a worker's KeyboardInterrupt: it must not be raised here.
        if not future.done() or future.cancelled() or future.exception() is not None:
            return False
        return self._accepts(self._items[index], future.result())

    def _wait(self) -> bool:
        """Wait until a future is done, but no longer than the longest item has taken so far.

        Returns
        -------
        is_done : bool
            Whether a future is done.
        """
        from concurrent.futures import FIRST_COMPLETED, wait

        futures = self._futures.values()
        return bool(wait(futures, self._longest_seconds, return_when=FIRST_COMPLETED).done)


def in_order(results: Iterable[tuple[int, _Result]]) -> Iterator[_Result]:
    """Restore the order of results that come in any order.

    Parameters
    ----------
    results : iterable of (int, object)
        Pairs of an index and a result, in any order; the indices are 0, 1, 2, ...

    Yields
    ------
    result : object
        The results, in the order of their indices.
    """
    finished, next_index = dict[int, _Result](), 0
    for index, result in results:
        finished[index] = result
        while next_index in finished:
            yield finished.pop(next_index)
            next_index += 1


class WorkerPool:
    """Worker processes of a command, started when the first work is submitted.

    Use this only from the command line: on Linux the pool may fork the calling process, and when it
    ends, it kills all children of the calling process that `multiprocessing` has started.  A forked
    worker already has all modules, and whatever the calling process has prepared.  Workers ignore
    SIGINT, because when the user presses Ctrl-C, the terminal sends it to all processes, and the
    calling process ends the workers.  Workers end by themselves if the calling process has ended.

    Parameters
    ----------
    workers : int
        Number of worker processes.
    initializer : callable, optional
        Called once in each worker before any work.

    Attributes
    ----------
    workers : int
        Number of worker processes.
    """

    def __init__(self, workers: int, initializer: Callable[[], None] | None = None) -> None:
        self.workers, self._initializer = workers, initializer
        self._executor: ProcessPoolExecutor | None = None
        self._starts = 0

    def submit(self, fn: Callable[..., Any], /, *args: Any) -> Future[Any]:
        """Schedule the call ``fn(*args)`` in a worker, and return the future of its result.

        Raises
        ------
        OSError, ImportError
            If the system has no semaphores, or too few files can be open.
        RuntimeError
            If no worker can be started, or workers have died several times.
        """
        if self._executor is None:
            if self._starts == _MAX_STARTS:
                raise RuntimeError("workers cannot be started, or have died several times")
            self._starts += 1
            self._executor = self._new_executor()
        try:
            return self._executor.submit(fn, *args)
        except Exception:  # a worker has died, or none can be started
            self.close()
            return self.submit(fn, *args)

    def _new_executor(self) -> ProcessPoolExecutor:
        """Create an executor that starts its processes when the first work is submitted."""
        import multiprocessing
        from concurrent.futures import ProcessPoolExecutor

        # It is not safe to fork while other threads run: they may hold locks.
        method = "fork" if sys.platform == "linux" and threading.active_count() == 1 else "spawn"
        context = multiprocessing.get_context(method)
        # A command that a signal ends leaves semaphores of spawned workers to Python's resource
        # tracker, which removes them; it must not warn of them.
        sys.warnoptions.append("ignore::UserWarning:multiprocessing.resource_tracker")
        # If the system has no thread left, a thread of the pool fails.  This process then does all
        # the work, so nobody needs to know.
        threading.excepthook = lambda _: None
        return ProcessPoolExecutor(self.workers, context, _begin_worker, (self._initializer,))

    def close(self) -> None:
        """Kill the workers, whatever they do, and shut down the executor, if there is one."""
        if self._executor is None:
            return
        import multiprocessing

        for process in multiprocessing.active_children():
            process.kill()
        shut_down = threading.Thread(target=self._executor.shutdown, daemon=True)
        self._executor = None
        try:
            shut_down.start()
            shut_down.join(_MAX_END_SECONDS)
        except RuntimeError:  # the system has no thread left
            self._starts = _MAX_STARTS
        if shut_down.is_alive():  # no process can be forked while the pool's own thread runs
            self._starts = _MAX_STARTS


def _begin_worker(initializer: Callable[[], None] | None) -> None:
    """Prepare a worker process, in which this function is called first.

    The worker ignores SIGINT, and a thread ends the worker when the parent process has ended.  If
    that thread cannot be started, the worker ends immediately.

    Parameters
    ----------
    initializer : callable or None
        Called last, without arguments.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        threading.Thread(target=end_with_parent, daemon=True).start()
    except RuntimeError:  # the system has no thread left
        os._exit(1)
    if initializer:
        initializer()


def end_with_parent() -> None:
    """Wait until the parent process has ended, then end this process with exit status 1.

    Return immediately if this process has no parent in `multiprocessing`.
    """
    import multiprocessing

    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        remove_part_files()
        os._exit(1)
