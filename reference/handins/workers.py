"""Process many jobs in two worker processes; a job that kills its worker harms no other job.

A single pool of processes would not do: if one of its processes dies, all unfinished jobs fail.
Each worker is therefore a pool of one process.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from multiprocessing import active_children
from typing import Any, NamedTuple, TypeVar

from tracer.picture.parallel import WorkerPool

Job = TypeVar("Job")
Result = TypeVar("Result")

# Minimum number of jobs for which starting processes is worth it.
_MIN_JOBS = 8
# Number of workers that a job may kill before it is lost.
_MAX_KILLS = 2


class _Attempt(NamedTuple):
    """A job that a worker computes."""

    job: Any
    kill_count: int  # number of workers that the job has killed before
    worker: WorkerPool
    # Takes the worker's next job, and its kill count, from one end of the pending jobs.
    take_job: Callable[[], tuple[Any, int]]


def map_in_workers(
    compute: Callable[[Job], Result], jobs: Sequence[Job], make_lost_result: Callable[[Job], Result]
) -> Iterator[Result]:
    """Compute the results of jobs in two worker processes, and yield them as they are completed.

    If a worker dies, its job is started once more; after a second death, the job is lost, and its
    result is made by `make_lost_result`.  If there are few jobs, or if no process can be started,
    the calling process computes the results.  At the end, all child processes that
    `multiprocessing` has started are killed.

    `compute`, the jobs and the results must be picklable.
    """
    # Pairs of a job and its kill count.
    pending_jobs = deque((job, 0) for job in jobs)
    attempts: dict[Future[Result], _Attempt] = {}

    def start_next_job(worker: WorkerPool, take_job: Callable[[], tuple[Job, int]]) -> None:
        """Start a pending job, chosen by `take_job`, on a worker; put it back if this fails."""
        if pending_jobs:
            job, kill_count = take_job()
            attempt = _Attempt(job=job, kill_count=kill_count, worker=worker, take_job=take_job)
            try:
                attempts[worker.submit(compute, job)] = attempt
            except Exception:  # no process can be started
                pending_jobs.appendleft((job, kill_count))

    try:
        # Neighbouring jobs may use the same cached data, so the workers start from opposite ends.
        if len(jobs) >= _MIN_JOBS:
            start_next_job(WorkerPool(1), pending_jobs.popleft)
            start_next_job(WorkerPool(1), pending_jobs.pop)
        while attempts:
            for future in wait(attempts, return_when=FIRST_COMPLETED).done:
                job, kill_count, worker, take_job = attempts.pop(future)
                if future.exception():
                    worker = WorkerPool(1)
                    kill_count += 1
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
