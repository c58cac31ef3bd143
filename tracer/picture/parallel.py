"""Start and end workers, which are processes or threads; `Distribution` gives them work.

Workers are usually processes.  Threads would often wait for each other, because only one at a time
may run Python code between two operations on arrays: the one that holds Python's global interpreter
lock.  Where Python has no such lock (*free-threaded* Python), workers are threads of this process.
"""

from __future__ import annotations

import operator
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Any, NamedTuple, SupportsIndex

from tracer.children import end_children
from tracer.files import remove_part_files
from tracer.picture.memory import limit_thread_memory

# Importing these takes longer than rendering a small picture, and only a pool needs them.
if TYPE_CHECKING:
    from concurrent.futures import Future, ProcessPoolExecutor, ThreadPoolExecutor

# Maximum number of times that a pool starts workers: it starts new ones if a worker has died.
_MAX_STARTS = 4

# Maximum time, in seconds, to wait for the end of a pool's workers, and then for the end of the
# threads that manage the pool.  Usually both end within milliseconds.  But a worker may be busy
# with a large array, and if a worker has died while it sent a result, a thread waits for the rest.
_MAX_END_SECONDS = 0.5


def count_processors() -> int:
    """Return the number of processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def has_gil() -> bool:
    """Test whether only one thread at a time can run Python code (global interpreter lock)."""
    return bool(getattr(sys, "_is_gil_enabled", lambda: True)())


def choose_thread_count(max_threads: SupportsIndex | None) -> int:
    """Choose how many threads work on a task of the calling thread, itself included.

    Without `max_threads`, all processors are used, but only for the main thread of a program that
    `multiprocessing` has not started.  Other threads presumably share the processors already.  If
    each thread of a pool started one thread for each processor, they would be in each other's way.

    Raise TypeError if `max_threads` is not an integer, and ValueError if it is less than 1.
    """
    max_count = None if max_threads is None else operator.index(max_threads)
    if max_count is not None and max_count < 1:
        raise ValueError(f"threads must be at least 1, not {max_count}")
    if has_gil():
        return 1
    if max_count is not None:
        return max_count
    process_module = sys.modules.get("multiprocessing.process")
    is_child = process_module is not None and process_module.parent_process() is not None
    is_main = threading.current_thread() is threading.main_thread()
    return count_processors() if is_main and not is_child else 1


class Sharing(NamedTuple):
    """The least work that is worth sharing with workers of one kind, in estimated seconds."""

    min_seconds: float  # for a picture, or for all pictures of a command
    min_tile_seconds: float  # for a tile: in smaller ones, the overhead is significant


class Threads:
    """Workers that are threads of this process.

    They are started when work is submitted.  No thread is left after `close`, so none can hold a
    lock while the process is forked.
    """

    sharing = Sharing(min_seconds=0.02, min_tile_seconds=0.01)

    def __init__(self, worker_count: int) -> None:
        self.worker_count = worker_count
        self._executor: ThreadPoolExecutor | None = None

    def submit(self, function: Callable[..., Any], /, *args: Any) -> Future[Any]:
        """Schedule the call ``function(*args)`` in a thread, and return its future."""
        if self._executor is None:
            from concurrent.futures import ThreadPoolExecutor

            self._executor = ThreadPoolExecutor(self.worker_count)
        return self._executor.submit(function, *args)

    def close(self) -> None:
        """Cancel the work that no thread has begun, and wait until all threads have ended."""
        if self._executor is not None:
            self._executor.shutdown(cancel_futures=True)
            self._executor = None


class WorkerPool:
    """Workers that are child processes of a command.

    They are started when work is submitted, and end when the command ends.  Use a pool only in a
    command, because `close` ends all child processes that `multiprocessing` has started.

    When the user presses Ctrl-C, the terminal sends SIGINT to the command and to all workers.
    Workers ignore it, because the command ends them.

    Parameters
    ----------
    initializer
        Called without arguments in each worker, before any work.
    """

    # The minima exceed those of `Threads`: a process takes time to start and to prepare the scene.
    sharing = Sharing(min_seconds=0.1, min_tile_seconds=0.02)

    def __init__(self, worker_count: int, initializer: Callable[[], None] | None = None) -> None:
        self.worker_count = worker_count
        self._initializer = initializer
        self._executor: ProcessPoolExecutor | None = None
        self._start_count = 0

    def submit(self, function: Callable[..., Any], /, *args: Any) -> Future[Any]:
        """Schedule the call ``function(*args)`` in a worker, and return the future of its result.

        The function, its arguments and its result must be picklable.  If there are no workers, or
        one has died, new workers are started.

        Raises
        ------
        OSError, ImportError
            If the system has no semaphores, or too many files are open.
        RuntimeError
            If workers have been started `_MAX_STARTS` times, and have died or could not be started.
        """
        while True:
            if self._executor is None:
                if self._start_count == _MAX_STARTS:
                    raise RuntimeError("workers cannot be started, or have died several times")
                self._start_count += 1
                self._executor = self._create_executor()
            # Workers inherit the blocked SIGINT.  If Ctrl-C interrupted a worker before it ignores
            # SIGINT, the worker would print a traceback.
            with suppress(Exception), _block_interrupts():
                return self._executor.submit(function, *args)
            self.close()  # a worker has died, or could not be started

    def _create_executor(self) -> ProcessPoolExecutor:
        """Create an executor that forks its workers if that is safe, and spawns them otherwise.

        A forked worker starts with the modules and the data of this process.  A spawned one is a
        new Python process that imports the modules again.
        """
        import multiprocessing
        from concurrent.futures import ProcessPoolExecutor

        _silence_pools()
        limit_thread_memory()
        # Forking is not safe while other threads run, because they may hold locks.
        method = "fork" if sys.platform == "linux" and threading.active_count() == 1 else "spawn"
        return ProcessPoolExecutor(
            self.worker_count,
            mp_context=multiprocessing.get_context(method),
            initializer=_init_worker,
            initargs=(self._initializer,),
        )

    def close(self) -> None:
        """End the workers, and shut down their executor; do nothing if there are no workers.

        A worker that does not end in `_MAX_END_SECONDS` is killed.  Unfinished work is lost.  Work
        that is submitted later starts new workers.
        """
        if self._executor is None:
            return
        end_children(_MAX_END_SECONDS)
        shutdown_thread = threading.Thread(target=self._executor.shutdown, daemon=True)
        self._executor = None
        with suppress(RuntimeError):  # the system cannot start another thread
            shutdown_thread.start()
            shutdown_thread.join(_MAX_END_SECONDS)


@contextmanager
def _block_interrupts() -> Iterator[None]:
    """Delay SIGINT until the end of a block of code; on Windows, do nothing."""
    if sys.platform == "win32":
        yield
        return
    old_mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, old_mask)


def _silence_pools() -> None:
    """Suppress messages that Python prints when a pool fails, until this process ends."""
    # If a signal ends the command, Python's resource tracker removes the semaphores of spawned
    # workers, and would print a warning.
    sys.warnoptions.append("ignore::UserWarning:multiprocessing.resource_tracker")
    # If the system cannot start another thread, a thread of the pool dies.  Its traceback would
    # only confuse, because the work is done without the pool.
    threading.excepthook = lambda _: None


def _init_worker(initializer: Callable[[], None] | None) -> None:
    """Let a new worker process ignore SIGINT, and end when its parent process ends.

    A thread of the worker waits for the end of the parent.  If the thread cannot be started, the
    worker ends immediately with exit status 1.  Then call `initializer`, unless it is None.
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
