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


def _serve_jobs(work: Callable[[Any], Any], pipe: connection.Connection) -> None:
    """Process jobs in a worker until the calling process closes its end of the pipe.

    The worker ends at once if the calling process dies.

    Parameters
    ----------
    work : callable
        Computes the result of a job.
    pipe : Connection
        The worker's end of the pipe on which jobs arrive and results are sent.
    """
    threading.Thread(target=end_with_parent, daemon=True).start()
    with suppress(EOFError):
        while True:
            pipe.send(work(pipe.recv()))


def _start_worker(work: Callable[[Any], Any]) -> connection.Connection:
    """Start a process that computes results of jobs.

    The process ignores Ctrl-C, and ends with the calling process.

    Parameters
    ----------
    work : callable
        Computes the result of a job.

    Returns
    -------
    Connection
        The calling process's end of a pipe, on which jobs are sent and results arrive.

    Raises
    ------
    OSError
        If no process can be started.
    """
    context = get_context("spawn")
    own_end, worker_end = context.Pipe()
    previous_mask = None
    if os.name != "nt":
        # If it started later, it would let signals through again (CPython's resource_tracker.py).
        resource_tracker.ensure_running()
        previous_mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        context.Process(target=_serve_jobs, args=(work, worker_end), daemon=True).start()
    finally:
        if previous_mask is not None:
            signal.pthread_sigmask(signal.SIG_SETMASK, previous_mask)
        worker_end.close()
    return own_end


def map_in_workers(
    work: Callable[[Job], Result], jobs: Sequence[Job], result_if_lost: Callable[[Job], Result]
) -> Iterator[Result]:
    """Compute the results of jobs in two processes, of which a crash loses only one job.

    One process begins with the first jobs, the other with the last, because neighbouring jobs may
    use the same cached data.  The calling process computes the results itself if there are few
    jobs, or if no process can be started.

    Parameters
    ----------
    work : callable
        Computes the result of a job.  It must be picklable, as jobs and results must be.
    jobs : sequence
        The arguments of `work`.
    result_if_lost : callable
        Returns the result of a job whose process died.

    Yields
    ------
    object
        The result of each job, in the order in which they are computed.
    """
    pending = deque(jobs)
    # For each worker's pipe, its current job, and the function that takes its next one.
    running: dict[Any, tuple[Job, Callable[[], Job]]] = {}
    pipe: Any

    def send_job(take: Callable[[], Job], pipe: connection.Connection | None = None) -> None:
        """Send the next job to a worker; without a pipe, to a new worker."""
        with suppress(OSError):
            pipe = pipe or _start_worker(work)
            if pending:
                running[pipe] = take(), take
                pipe.send(running[pipe][0])

    for take in (pending.popleft, pending.pop) if len(jobs) >= _MIN_JOBS else ():
        send_job(take)
    while running:
        for pipe in connection.wait([*running]):
            job, take = running.pop(pipe)
            try:
                result = pipe.recv()
            except (EOFError, OSError):  # this job ended the worker, which had no other job
                result, pipe = result_if_lost(job), None
            yield result
            send_job(take, pipe)
    for job in pending:
        yield work(job)
