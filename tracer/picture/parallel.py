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
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
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

# Maximum number of starts of a pool: it is started again if a worker has died.
_MAX_STARTS = 4

# Maximum time, in seconds, to wait for the end of a pool's threads.  Usually they end within
# milliseconds, but if a worker has died while it sent a result, a thread waits for the rest.
_MAX_END_SECONDS = 0.5


def count_processors() -> int:
    """Return the number of processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class Executor(Protocol):
    """The part of a `concurrent.futures.Executor` that is used here."""

    def submit(self, function: Callable[..., Any], /, *args: Any) -> Future[Any]:
        """Schedule the call ``function(*args)`` in a worker.

        Parameters
        ----------
        function : callable
            The function to call.
        *args : object
            The arguments.

        Returns
        -------
        future : Future
            The future, which receives the result of the call or the exception that it raises.
        """


@dataclass(eq=False)
class Distribution(Generic[_Item, _Result]):
    """A list of items that this process and an executor process together.

    Iterate over the instance once: this processes all items, and yields their results in order.

    This process and the executor both take items from the front of the list.  When no item is left
    to take, this process repeats the items that the executor has not finished, first those that no
    worker has begun.  Before it repeats an item that a worker has begun, it waits for as long as
    its own slowest item took.  If the executor fails to process an item, this process repeats it.

    Parameters
    ----------
    function : callable
        Processes an item in this process: called with the item, it returns the result.  Its
        exceptions end the iteration.
    remote_function : callable
        Processes an item in the executor: called with the item, it returns the result.  If the
        executor uses other processes, the function, the items and the results must be picklable.
    items : sequence
        The items to process.
    worker_count : int
        Number of workers of the executor, which determines how many items are submitted to it.
    executor : Executor, optional
        Processes some of the items.  By default, this process does all the work.
    is_valid : callable
        Tests a result of the executor: called with the item and the result, it returns a bool.  An
        item with an invalid result is processed again in this process.  By default, all results are
        valid.

    Notes
    -----
    `executor` can be set at any time, to share the remaining items.
    """

    function: Callable[[_Item], _Result]
    remote_function: Callable[[_Item], _Result]
    items: Sequence[_Item]
    worker_count: int
    executor: Executor | None = None
    is_valid: Callable[[_Item, Any], bool] = lambda _item, _result: True

    # Index of the first item that nobody has taken.
    _next_index: int = field(default=0, init=False)
    # Futures of items whose results have not been collected, in order of submission, and results
    # that have not been yielded.  The keys are the indices of the items.
    _futures: dict[int, Future[_Result]] = field(default_factory=dict, init=False)
    _results: dict[int, _Result] = field(default_factory=dict, init=False)
    # The longest time, in seconds, that an item has taken in this process.
    _max_item_seconds: float = field(default=0.0, init=False)

    def __iter__(self) -> Iterator[_Result]:
        """Process all items, and yield their results in the order of the items.

        If the caller stops early, submitted items that no worker has begun are cancelled.

        Yields
        ------
        result : object
            The result of `function` or `remote_function` for the next item.
        """
        try:
            for index in range(len(self.items)):
                while index not in self._results:
                    self.submit_items()
                    self._process_next_item()
                    self._collect_results()
                yield self._results.pop(index)
        finally:
            for future in self._futures.values():
                future.cancel()

    def submit_items(self) -> None:
        """Submit enough items to the executor to keep all its workers busy.

        Iteration calls this method before each item that this process takes.  A slow `function`
        should also call this method from time to time.

        If the executor fails, `executor` is set to None, and this process does the remaining work.
        """
        if self.executor is None:
            return
        unfinished_count = sum(not future.done() for future in self._futures.values())
        # The workers get only their share of the remaining items: this process needs work, too.
        remaining_count = len(self.items) - self._next_index
        worker_share = remaining_count * self.worker_count // (self.worker_count + 1)
        needed_count = _ITEMS_PER_WORKER * self.worker_count - unfinished_count
        try:
            for _ in range(min(needed_count, worker_share)):
                item = self.items[self._next_index]
                future = self.executor.submit(self.remote_function, item)
                self._futures[self._next_index] = future
                self._next_index += 1
        except Exception:  # for example, a worker has died, or none can be started
            self.executor = None

    def _process_next_item(self) -> None:
        """Process the next item or, if none is left, an item that the executor has not finished.

        Before repeating an item that a worker may have begun, wait for the executor.  If the
        executor finishes any item in time (see `_wait_for_executor`), repeat nothing.
        """
        if self._next_index < len(self.items):
            self._next_index += 1
            self._process_item(self._next_index - 1)
        elif self._futures:
            # Workers have probably not begun the item that was submitted last.
            index, future = next(reversed(self._futures.items()))
            if future.cancel() or not self._wait_for_executor():
                del self._futures[index]
                self._process_item(index)

    def _process_item(self, index: int) -> None:
        """Process the item with the given index in this process, and measure how long it takes."""
        start_time = perf_counter()
        self._results[index] = self.function(self.items[index])
        self._max_item_seconds = max(self._max_item_seconds, perf_counter() - start_time)

    def _collect_results(self) -> None:
        """Store the results of all items that the executor has finished.

        Items that failed, or whose results are invalid, are processed again in this process.
        """
        finished_indices = [index for index, future in self._futures.items() if future.done()]
        for index in finished_indices:
            future = self._futures.pop(index)
            # future.result() would raise a worker's exception, even a KeyboardInterrupt.
            has_result = not future.cancelled() and future.exception() is None
            if has_result and self.is_valid(self.items[index], future.result()):
                self._results[index] = future.result()
            else:
                self._process_item(index)

    def _wait_for_executor(self) -> bool:
        """Wait until the executor finishes a submitted item, or until the time limit passes.

        The time limit is the longest time that an item has taken in this process.

        Returns
        -------
        has_finished : bool
            Whether the executor has finished at least one submitted item.
        """
        from concurrent.futures import FIRST_COMPLETED, wait

        futures = self._futures.values()
        return bool(wait(futures, self._max_item_seconds, return_when=FIRST_COMPLETED).done)


class WorkerPool:
    """The worker processes of a command, which are started when the first work is submitted.

    Use this only from the command line.  On Linux, a calling process with a single thread is
    forked, so workers start with all its modules and data.  Closing the pool kills all processes
    that `multiprocessing` has started.

    Workers end when the calling process ends.  They ignore SIGINT, which the terminal sends to all
    processes when the user presses Ctrl-C: then the calling process ends the workers.

    Parameters
    ----------
    worker_count : int
        Number of worker processes.
    initializer : callable, optional
        Called without arguments in each worker before any work.
    """

    def __init__(self, worker_count: int, initializer: Callable[[], None] | None = None) -> None:
        self.worker_count, self._initializer = worker_count, initializer
        self._executor: ProcessPoolExecutor | None = None
        self._start_count = 0

    def submit(self, function: Callable[..., Any], /, *args: Any) -> Future[Any]:
        """Schedule the call ``function(*args)`` in a worker.

        Workers are started if there are none, or if one of them has died.

        Parameters
        ----------
        function : callable
            The function to call.  The function, its arguments and its result must be picklable.
        *args : object
            The arguments.

        Returns
        -------
        future : Future
            The future, which receives the result of the call or the exception that it raises.

        Raises
        ------
        OSError, ImportError
            If the system has no semaphores, or too many files are open.
        RuntimeError
            If no worker can be started, or workers have already been started `_MAX_STARTS` times.
        """
        if self._executor is None:
            if self._start_count == _MAX_STARTS:
                raise RuntimeError("workers cannot be started, or have died several times")
            self._start_count += 1
            self._executor = self._create_executor()
        # Block SIGINT, so that workers start with it blocked.  Otherwise, a worker that Ctrl-C
        # interrupts before it ignores SIGINT would print a traceback.
        if sys.platform != "win32":
            signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            return self._executor.submit(function, *args)
        except Exception:  # a worker has died, or none can be started
            self.close()
            return self.submit(function, *args)
        finally:
            if sys.platform != "win32":
                signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})

    def _create_executor(self) -> ProcessPoolExecutor:
        """Create an executor that forks its processes if that is safe, and spawns them otherwise.

        Also suppress, in this process, the warnings of Python's resource tracker and the tracebacks
        of exceptions that end a thread.

        Returns
        -------
        executor : ProcessPoolExecutor
            The executor, which starts its processes when work is first submitted.
        """
        import multiprocessing
        from concurrent.futures import ProcessPoolExecutor

        # Forking is not safe while other threads run, because they may hold locks.
        method = "fork" if sys.platform == "linux" and threading.active_count() == 1 else "spawn"
        context = multiprocessing.get_context(method)
        # If a signal ends the command, Python's resource tracker removes the semaphores of spawned
        # workers.  It must not print a warning about this.
        sys.warnoptions.append("ignore::UserWarning:multiprocessing.resource_tracker")
        # If the system cannot start another thread, one of the pool's threads dies.  No message is
        # needed, because this process then does all the work.
        threading.excepthook = lambda _: None
        return ProcessPoolExecutor(self.worker_count, context, _init_worker, (self._initializer,))

    def close(self) -> None:
        """Kill the workers, and wait up to `_MAX_END_SECONDS` for their executor to shut down.

        Unfinished work is lost.  If there are no workers, nothing is done.  Work that is submitted
        later starts new workers.
        """
        if self._executor is None:
            return
        import multiprocessing

        for process in multiprocessing.active_children():
            process.kill()
        shutdown_thread = threading.Thread(target=self._executor.shutdown, daemon=True)
        self._executor = None
        with suppress(RuntimeError):  # the system cannot start another thread
            shutdown_thread.start()
            shutdown_thread.join(_MAX_END_SECONDS)


def _init_worker(initializer: Callable[[], None] | None) -> None:
    """Prepare a new worker process: it ignores SIGINT, and ends when its parent process ends.

    A thread waits for the end of the parent.  If the thread cannot be started, the worker ends
    immediately with exit status 1.

    Parameters
    ----------
    initializer : callable or None
        Called without arguments when the worker is prepared.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        threading.Thread(target=end_with_parent, daemon=True).start()
    except RuntimeError:  # the system cannot start another thread
        os._exit(1)
    if initializer:
        initializer()


def end_with_parent() -> None:
    """Wait until the parent process has ended, then end this process with exit status 1.

    Part files (incomplete output files) of this process are removed first.  If this process was not
    started by `multiprocessing`, return immediately.
    """
    import multiprocessing

    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        remove_part_files()
        os._exit(1)
