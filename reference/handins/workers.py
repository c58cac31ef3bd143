"""Work shared by two processes, neither of which can take the other's results with it."""

from __future__ import annotations

import os
import signal
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing import connection, get_context, parent_process, resource_tracker
from typing import TypeVar

Job = TypeVar("Job")
Result = TypeVar("Result")

# Fewer jobs take less time than it takes to start processes.
_MANY = 8
# What is raised where processes, threads or semaphores cannot be had; a timeout, in seconds.
_NO_POOL = (
    BrokenProcessPool,
    ImportError,
    NotImplementedError,
    OSError,
    RuntimeError,
    TimeoutError,
)
_START = 60


@contextmanager
def _undisturbed() -> Iterator[None]:
    """Start processes that Ctrl-C does not reach: it is for this one, with which they end.

    Nor do they warn: of semaphores, which a process of their own removes if this one cannot.
    """
    before = os.environ.get("PYTHONWARNINGS")
    os.environ["PYTHONWARNINGS"] = "ignore"
    mask = None
    if os.name != "nt":
        # Started later, it would let signals through again (CPython's resource_tracker.py).
        resource_tracker.ensure_running()
        mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        if mask is not None:
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        del os.environ["PYTHONWARNINGS"]
        if before is not None:
            os.environ["PYTHONWARNINGS"] = before


def _end_with_parent() -> None:
    parent = parent_process()

    def watch() -> None:
        if parent is not None:
            connection.wait([parent.sentinel])
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def _pool(count: int) -> list[Executor]:
    """So many processes, each with an executor of its own; none if they cannot be had."""
    executors: list[Executor] = []
    try:
        with _undisturbed():
            ready = []
            for _ in range(count):
                executors += [ProcessPoolExecutor(1, get_context("spawn"), _end_with_parent)]
                ready += [executors[-1].submit(int)]
        for future in ready:
            future.result(_START)
    except _NO_POOL:
        _shut_down(executors)
        return []
    return executors


def _shut_down(executors: Iterable[Executor]) -> None:
    for executor in executors:
        executor.shutdown(wait=False, cancel_futures=True)


def shared(
    work: Callable[[Job], Result], jobs: Sequence[Job], lost: Callable[[Job], Result]
) -> Iterator[Result]:
    """Yield the result of each job, in any order; `lost` of one whose process died.

    One process begins with the first jobs, another with the last: what a process keeps for the
    next job serves those beside it.  Where none can be started, all is done in this process.
    """
    todo = deque(jobs)
    executors = _pool(2) if len(jobs) >= _MANY else []
    running: dict[Future[Result], tuple[Job, Executor, Callable[[], Job]]] = {}

    def start(executor: Executor, take: Callable[[], Job]) -> None:
        if todo:
            job = take()
            running[executor.submit(work, job)] = job, executor, take

    try:
        for executor, take in zip(executors, (todo.popleft, todo.pop), strict=False):
            start(executor, take)
        while running:
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                job, executor, take = running.pop(future)
                try:
                    result, more = future.result(), [executor]
                except BrokenProcessPool:  # it died of this job, for it had no other
                    result, more = lost(job), _pool(1)
                    executors += more
                yield result
                for executor in more:
                    start(executor, take)
    finally:
        _shut_down(executors)
    for job in todo:
        yield work(job)
