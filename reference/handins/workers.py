"""Process many jobs in two worker processes; a job that kills its worker harms no other job.

A single pool of processes would not do: if one of its processes dies, all unfinished jobs fail.
Each worker is therefore a pool of one process.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from multiprocessing import active_children
from typing import Any, TypeVar

from tracer.picture.parallel import WorkerPool

Job = TypeVar("Job")
Result = TypeVar("Result")

# Minimum number of jobs for which starting processes is worth it.
_MIN_JOBS = 8
# Number of workers that a job may kill before it is abandoned.
_MAX_DEATHS = 2


def map_in_workers(
    work: Callable[[Job], Result], jobs: Sequence[Job], result_if_lost: Callable[[Job], Result]
) -> Iterator[Result]:
    """Compute the results of jobs in two worker processes.

    One worker starts from the first job, the other from the last, because neighbouring jobs may use
    the same cached data.  If a worker dies, its job is started once more; if that worker dies, too,
    the job is abandoned.  The calling process does the work itself if there are few jobs, or if no
    process can be started.  At the end, the calling process kills all its child processes that
    `multiprocessing` has started.

    Parameters
    ----------
    work : callable
        Computes the result of a job.  The function, the jobs and the results must be picklable.
    jobs : sequence
        The arguments of `work`.
    result_if_lost : callable
        Returns the result for an abandoned job.

    Yields
    ------
    object
        The result of each job, in order of completion.
    """
    # Each job with the number of workers that it has killed.
    pending = deque((job, 0) for job in jobs)
    # For each future: the job, that number, the worker, and the function that takes the next job.
    running: dict[Future[Result], tuple[Job, int, WorkerPool, Callable[[], Any]]] = {}

    def start_next_job(worker: WorkerPool, take_job: Callable[[], tuple[Job, int]]) -> None:
        """Start the next job on a worker, if there is a job and the worker can be started."""
        if pending:
            job, death_count = take_job()
            try:
                running[worker.submit(work, job)] = job, death_count, worker, take_job
            except Exception:  # no process can be started
                pending.appendleft((job, death_count))

    try:
        for take_job in (pending.popleft, pending.pop) if len(jobs) >= _MIN_JOBS else ():
            start_next_job(WorkerPool(1), take_job)
        while running:
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                job, death_count, worker, take_job = running.pop(future)
                if future.exception():
                    worker, death_count = WorkerPool(1), death_count + 1
                    if death_count < _MAX_DEATHS:
                        pending.append((job, death_count))
                    else:
                        yield result_if_lost(job)
                else:
                    yield future.result()
                start_next_job(worker, take_job)
    finally:
        for process in active_children():
            process.kill()
    for job, _ in pending:
        yield work(job)
