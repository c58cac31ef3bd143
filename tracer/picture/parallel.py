"""Distribute work between this process and the workers of an executor.

The problem is that workers fail: they are killed, stop, run out of memory, or never answer.  The
solution has two parts.  (1) Any process can process any item, with the same result.  (2) This
process depends on no other one: when no item is left to take, it repeats those that the workers
have not finished.  So a worker that fails costs time, but no result.

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

# Maximum number of submitted but unfinished items for each worker: enough to keep the worker busy.
_ITEMS_PER_WORKER = 2

# Maximum number of starts of a pool.  It is started again if a worker has died.
_MAX_STARTS = 4

# Maximum time, in seconds, to wait for the end of a pool.  Usually the end takes milliseconds, but
# a worker that dies while it sends a result leaves half of a message, and then a thread of the pool
# waits for the rest.
_MAX_END_SECONDS = 0.5


def count_processors() -> int:
    """Return the number of processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class Executor(Protocol):
    """The part of a `concurrent.futures.Executor` that is used here."""

    def submit(self, fn: Callable[..., Any], /, *args: Any) -> Future[Any]:
        """Schedule the call ``fn(*args)`` in a worker.

        Parameters
        ----------
        fn : callable
            The function to call.
        *args : object
            Its arguments.

        Returns
        -------
        future : Future
            The future of what the function returns.
        """


class Distribution(Generic[_Item, _Result]):
    """A list of items that this process and an executor process together.

    To do the work, iterate over the instance once.  Each step yields the index of an item and the
    result for the item, in nearly the order of the items; `restore_order` restores the order.

    This process and the executor both take items from the front of the list.  When no item is left
    to take, this process repeats the items that the executor has not finished, first those that no
    worker has begun.  Before it repeats an item that a worker has begun, it waits for the worker
    for as long as its own slowest item took.  If the executor fails to process an item for any
    reason, this process processes it.

    Parameters
    ----------
    function : callable
        Processes an item in this process: called with the item, it returns the result.  Its
        exceptions end the iteration.
    items : sequence
        The items to process.
    executor : Executor or None
        Processes a part of the items.  If None, this process does all the work.
    remote_function : callable
        Processes an item in the executor: called with the item, it returns the result.  If the
        executor uses other processes, the function, the items and the results must be picklable.
    accepts : callable
        Validates a result of the executor: called with the item and the result.  If it returns
        False, this process processes the item instead.
    workers : int
        Number of workers of the executor, which determines how many items are submitted to it.

    Attributes
    ----------
    executor : Executor or None
        As above.  It can be set at any time, to share the remaining items.
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
        # Futures whose results have not been yielded, in order of submission.  The key is the index
        # of the item.
        self._futures = dict[int, "Future[_Result]"]()
        # The index of the item that this process is repeating, and the future of the same item.
        self._repeated: tuple[int, Future[_Result]] | None = None
        # The longest time that an item has taken in this process.
        self._max_seconds = 0.0

    def __iter__(self) -> Iterator[tuple[int, _Result]]:
        """Process all items, and yield each result when it is available.

        If the caller stops early, submitted items that no worker has begun are cancelled.

        Yields
        ------
        index : int
            Index of the item.
        result : object
            What `function` or `remote_function` returned for the item.
        """
        try:
            while self._next_index < len(self._items) or self._futures:
                self.submit()
                if self._next_index < len(self._items):
                    self._next_index += 1
                    yield self._process(self._next_index - 1)
                elif self._futures:
                    # The item submitted last is the least likely to have been begun.
                    index, future = next(reversed(self._futures.items()))
                    if future.cancel() or not self._wait_for_any():
                        self._repeated = index, self._futures.pop(index)
                        yield self._process(index)
                        self._repeated = None
                for index in [key for key, value in self._futures.items() if value.done()]:
                    future = self._futures.pop(index)
                    is_accepted = self._is_accepted(index, future)
                    yield (index, future.result()) if is_accepted else self._process(index)
        finally:
            for future in self._futures.values():
                future.cancel()

    def submit(self) -> None:
        """Submit items to the executor until there are enough to keep all its workers busy.

        The iteration calls this after each item.  If one item takes long in this process, its
        `function` should call this method from time to time.

        If the executor raises an error, this method ends silently and sets `executor` to None, so
        that this process does all the remaining work.
        """
        unfinished_count = sum(not future.done() for future in self._futures.values())
        # Not more than the workers' share of the remaining items: this process needs work, too.
        share = (len(self._items) - self._next_index) * self._workers // (self._workers + 1)
        for _ in range(min(_ITEMS_PER_WORKER * self._workers - unfinished_count, share)):
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
        """True if this process repeats an item that a worker has meanwhile finished.

        If so, `function` can return immediately, with any result: the worker's result is used.
        """
        return self._repeated is not None and self._is_accepted(*self._repeated)

    def _process(self, index: int) -> tuple[int, _Result]:
        """Process one item in this process, and measure the time that it takes.

        Parameters
        ----------
        index : int
            Index of the item.

        Returns
        -------
        index : int
            The same index.
        result : object
            What `function` returned for the item.  If a worker has finished the same item in the
            meantime, this is the worker's result instead.
        """
        start = perf_counter()
        result = self._function(self._items[index])
        self._max_seconds = max(self._max_seconds, perf_counter() - start)
        if self._repeated is not None and self.is_obsolete:
            _, future = self._repeated
            result = future.result()
        return index, result

    def _is_accepted(self, index: int, future: Future[_Result]) -> bool:
        """Test whether a worker has processed an item with an acceptable result.

        Parameters
        ----------
        index : int
            Index of the item.
        future : Future
            The future that the executor returned for the item.

        Returns
        -------
        is_accepted : bool
            False if the future is unfinished, is cancelled or has an exception; otherwise what
            `accepts` returns for the item and its result.
        """
        # An exception may be a worker's KeyboardInterrupt: it must not be raised here.
        if not future.done() or future.cancelled() or future.exception() is not None:
            return False
        return self._accepts(self._items[index], future.result())

    def _wait_for_any(self) -> bool:
        """Wait until the executor finishes any item that is submitted.

        The maximum wait is the longest time that an item has taken in this process.

        Returns
        -------
        is_any_done : bool
            True if at least one submitted item is finished; False if the time is up.
        """
        from concurrent.futures import FIRST_COMPLETED, wait

        futures = self._futures.values()
        return bool(wait(futures, self._max_seconds, return_when=FIRST_COMPLETED).done)


def restore_order(results: Iterable[tuple[int, _Result]]) -> Iterator[_Result]:
    """Put results that arrive in any order into the order of their indices.

    Parameters
    ----------
    results : iterable of (int, object)
        Pairs of an index and a result, in any order.  The indices are 0, 1, 2, ... without gaps.

    Yields
    ------
    result : object
        The results in the order of their indices, each as soon as all results before it have
        arrived.
    """
    finished, next_index = dict[int, _Result](), 0
    for index, result in results:
        finished[index] = result
        while next_index in finished:
            yield finished.pop(next_index)
            next_index += 1


class WorkerPool:
    """The worker processes of a command, which are started when the first work is submitted.

    Use this only from the command line.  On Linux, the pool forks the calling process if that has a
    single thread; a forked worker already has all modules, and whatever the calling process has
    prepared.  When the pool is closed, it kills all children of the calling process that
    `multiprocessing` has started.

    Workers end by themselves if the calling process has ended.  They ignore SIGINT: when the user
    presses Ctrl-C, the terminal sends SIGINT to all processes, and the calling process ends the
    workers.

    Parameters
    ----------
    workers : int
        Number of worker processes.
    initializer : callable, optional
        Called without arguments in each worker before any work.

    Attributes
    ----------
    workers : int
        Number of worker processes.
    """

    def __init__(self, workers: int, initializer: Callable[[], None] | None = None) -> None:
        self.workers, self._initializer = workers, initializer
        self._executor: ProcessPoolExecutor | None = None
        self._start_count = 0

    def submit(self, fn: Callable[..., Any], /, *args: Any) -> Future[Any]:
        """Schedule the call ``fn(*args)`` in a worker.

        The workers are started if there are none, or if one of them has died.

        Parameters
        ----------
        fn : callable
            The function to call.  It, its arguments and its result must be picklable.
        *args : object
            Its arguments.

        Returns
        -------
        future : Future
            The future of what the function returns.

        Raises
        ------
        OSError, ImportError
            If the system has no semaphores, or too few files can be open.
        RuntimeError
            If no worker can be started, or workers have died `_MAX_STARTS` times.
        """
        if self._executor is None:
            if self._start_count == _MAX_STARTS:
                raise RuntimeError("workers cannot be started, or have died several times")
            self._start_count += 1
            self._executor = self._new_executor()
        try:
            return self._executor.submit(fn, *args)
        except Exception:  # a worker has died, or none can be started
            self.close()
            return self.submit(fn, *args)

    def _new_executor(self) -> ProcessPoolExecutor:
        """Create an executor whose processes are forked if this is safe, and spawned otherwise.

        This method also changes global settings: Python's resource tracker no longer prints
        warnings, and exceptions in threads are no longer printed.

        Returns
        -------
        executor : ProcessPoolExecutor
            It starts its processes when the first work is submitted.
        """
        import multiprocessing
        from concurrent.futures import ProcessPoolExecutor

        # It is not safe to fork while other threads run: they may hold locks.
        method = "fork" if sys.platform == "linux" and threading.active_count() == 1 else "spawn"
        context = multiprocessing.get_context(method)
        # If a signal ends the command, Python's resource tracker removes the semaphores of spawned
        # workers.  It must not print a warning of that.
        sys.warnoptions.append("ignore::UserWarning:multiprocessing.resource_tracker")
        # If the system has no thread left, a thread of the pool fails.  This process then does all
        # the work, so nobody needs to know.
        threading.excepthook = lambda _: None
        return ProcessPoolExecutor(self.workers, context, _begin_worker, (self._initializer,))

    def close(self) -> None:
        """Kill the workers, and wait at most `_MAX_END_SECONDS` until their executor has ended.

        Unfinished work is lost.  Without workers, this method does nothing.  Later work starts new
        workers, unless the executor has not ended.
        """
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
            self._start_count = _MAX_STARTS
        if shut_down.is_alive():  # no process can be forked while the pool's own thread runs
            self._start_count = _MAX_STARTS


def _begin_worker(initializer: Callable[[], None] | None) -> None:
    """Make this process a worker: ignore SIGINT, and start a thread that ends it with its parent.

    This is the first call in each worker process.  If the thread cannot be started, the process
    ends immediately with status 1.

    Parameters
    ----------
    initializer : callable or None
        Called without arguments after that.
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

    This process's part files (incomplete output files) are removed before it ends.  If
    `multiprocessing` has not started this process, return immediately.
    """
    import multiprocessing

    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        remove_part_files()
        os._exit(1)
