"""Work shared by two processes, neither of which can take the other's results with it."""

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

# Fewer jobs take less time than it takes to start processes.
_MANY = 8


def _serve(work: Callable[[Any], Any], link: connection.Connection) -> None:
    """Do each job that is sent, until the other end is closed."""
    threading.Thread(target=end_with_parent, daemon=True).start()
    with suppress(EOFError):
        while True:
            link.send(work(link.recv()))


def _start(work: Callable[[Any], Any]) -> connection.Connection:
    """Start a process for jobs, which Ctrl-C does not reach: it ends with this one."""
    context = get_context("spawn")
    here, there = context.Pipe()
    mask = None
    if os.name != "nt":
        # Started later, it would let signals through again (CPython's resource_tracker.py).
        resource_tracker.ensure_running()
        mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        context.Process(target=_serve, args=(work, there), daemon=True).start()
    finally:
        if mask is not None:
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        there.close()
    return here


def shared(
    work: Callable[[Job], Result], jobs: Sequence[Job], lost: Callable[[Job], Result]
) -> Iterator[Result]:
    """Yield the result of each job, in any order; `lost` of one whose process died.

    One process begins with the first jobs, another with the last: what a process keeps for the
    next job serves those beside it.  Where none can be started, all is done in this process.
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

    for take in (todo.popleft, todo.pop) if len(jobs) >= _MANY else ():
        give(take)
    while running:
        for link in connection.wait([*running]):
            job, take = running.pop(link)
            try:
                result = link.recv()
            except (EOFError, OSError):  # it died of this job, for it had no other
                result, link = lost(job), None
            yield result
            give(take, link)
    for job in todo:
        yield work(job)
