"""Process many jobs in two isolated workers: if one crashes, one job is lost.

A pool of processes would not do: if one of its processes dies, all unfinished jobs fail.
"""

from __future__ import annotations

import os
import signal
import threading
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from multiprocessing import connection, get_context, resource_tracker
from typing import Any, TypeVar

from tracer.picture.parallel import end_with_parent

Job = TypeVar("Job")
Result = TypeVar("Result")

# Minimum number of jobs for which starting processes is worth it.
_MIN_JOBS = 8


def _serve(work: Callable[[Any], Any], link: connection.Connection) -> None:
    """Process each job that arrives, until the other end is closed."""
    threading.Thread(target=end_with_parent, daemon=True).start()
    with suppress(EOFError):
        while True:
            link.send(work(link.recv()))


def _start(work: Callable[[Any], Any]) -> connection.Connection:
    """Start a process for jobs; it ignores Ctrl-C, and ends with the calling process."""
    context = get_context("spawn")
    own_end, other_end = context.Pipe()
    mask = None
    if os.name != "nt":
        # If it started later, it would let signals through again (CPython's resource_tracker.py).
        resource_tracker.ensure_running()
        mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        context.Process(target=_serve, args=(work, other_end), daemon=True).start()
    finally:
        if mask is not None:
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        other_end.close()
    return own_end


def start_workers(
    work: Callable[[Job], Result], jobs: Sequence[Job], lost: Callable[[Job], Result]
) -> Iterator[Result]:
    """Yield the result of each job, in any order.

    One worker begins with the first jobs, the other with the last: neighbouring jobs may use the
    same cached data.  If no process can be started, the calling process does all jobs.

    Parameters
    ----------
    work : callable
        Computes the result of a job, in a worker.
    jobs : sequence
    lost : callable
        Returns the result of a job whose worker died.
    """
    todo = deque(jobs)
    running: dict[Any, tuple[Job, Callable[[], Job]]] = {}
    link: Any

    def give(take: Callable[[], Job], link: connection.Connection | None = None) -> None:
        with suppress(OSError):
            link = link or _start(work)
            if todo:
                running[link] = take(), take
                link.send(running[link][0])

    for take in (todo.popleft, todo.pop) if len(jobs) >= _MIN_JOBS else ():
        give(take)
    while running:
        for link in connection.wait([*running]):
            job, take = running.pop(link)
            try:
                result = link.recv()
            except (EOFError, OSError):  # this job ended the worker, which had no other job
                result, link = lost(job), None
            yield result
            give(take, link)
    for job in todo:
        yield work(job)
