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
# Number of workers that a job may kill before it is lost.
_MAX_KILLS = 2


def map_in_workers(
    compute: Callable[[Job], Result], jobs: Sequence[Job], make_lost_result: Callable[[Job], Result]
) -> Iterator[Result]:
    """Compute the results of jobs in two worker processes.

    If a worker dies, its job is started once more; after a second death, the job is lost.
    If there are few jobs, or if no process can be started, the calling process computes the
    results.  At the end, all child processes that `multiprocessing` has started are killed.

    Parameters
    ----------
    compute : callable
        Computes the result of a job.  The function, the jobs and the results must be picklable.
    jobs : sequence
        The arguments of `compute`.
    make_lost_result : callable
        Makes the result of a lost job.

    Yields
    ------
    object
        The result of each job, in order of completion.
    """
    # Pairs of a job and its kill count: the number of workers that it has killed.
    pending_jobs = deque((job, 0) for job in jobs)
    # By future: the job, its kill count, the worker, and the function that takes the next job.
    running_jobs: dict[Future[Result], tuple[Job, int, WorkerPool, Callable[[], Any]]] = {}

    def start_next_job(worker: WorkerPool, take_job: Callable[[], tuple[Job, int]]) -> None:
        """Start a pending job, chosen by `take_job`, on a worker; put it back if this fails."""
        if pending_jobs:
            job, kill_count = take_job()
            try:
                running_jobs[worker.submit(compute, job)] = job, kill_count, worker, take_job
            except Exception:  # no process can be started
                pending_jobs.appendleft((job, kill_count))

    try:
        # Neighbouring jobs may use the same cached data, so the workers start from opposite ends.
        for take_job in (pending_jobs.popleft, pending_jobs.pop) if len(jobs) >= _MIN_JOBS else ():
            start_next_job(WorkerPool(1), take_job)
        while running_jobs:
            for future in wait(running_jobs, return_when=FIRST_COMPLETED).done:
                job, kill_count, worker, take_job = running_jobs.pop(future)
                if future.exception():
                    worker, kill_count = WorkerPool(1), kill_count + 1
                    if kill_count < _MAX_KILLS:
                        pending_jobs.append((job, kill_count))
                    else:
                        yield make_lost_result(job)
                else:
                    yield future.result()
                start_next_job(worker, take_job)
    finally:
        for process in active_children():
            process.kill()
    for job, _ in pending_jobs:
        yield compute(job)
