"""Process many jobs in two worker processes: a job that ends its worker costs no other job.

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
# Number of workers that a job may end before it is given up.
_MAX_DEATHS = 2


def map_in_workers(
    work: Callable[[Job], Result], jobs: Sequence[Job], result_if_lost: Callable[[Job], Result]
) -> Iterator[Result]:
    """Compute the results of jobs in two worker processes.

    One worker begins with the first jobs, the other with the last, because neighbouring jobs may
    use the same cached data.  If a worker dies, its job is begun once more; if that worker dies,
    too, the job is given up.  The calling process computes the results itself if there are few
    jobs, or if no process can be started.  When the results are complete, the calling process
    kills all its children that `multiprocessing` has started.

    Parameters
    ----------
    work : callable
        Computes the result of a job.  It must be picklable, as jobs and results must be.
    jobs : sequence
        The arguments of `work`.
    result_if_lost : callable
        Returns the result of a job that is given up.

    Yields
    ------
    object
        The result of each job, in the order in which they are computed.
    """
    # Each job with the number of workers that it has ended.
    pending = deque((job, 0) for job in jobs)
    # The future of each running job: the job, that number, its worker, and whence it takes jobs.
    running: dict[Future[Result], tuple[Job, int, WorkerPool, Callable[[], Any]]] = {}

    def begin_next_job(worker: WorkerPool, take: Callable[[], tuple[Job, int]]) -> None:
        """Let a worker begin the next job, if there is one and if the worker can be started."""
        if pending:
            job, death_count = take()
            try:
                running[worker.submit(work, job)] = job, death_count, worker, take
            except Exception:  # no process can be started
                pending.appendleft((job, death_count))

    try:
        for take in (pending.popleft, pending.pop) if len(jobs) >= _MIN_JOBS else ():
            begin_next_job(WorkerPool(1), take)
        while running:
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                job, death_count, worker, take = running.pop(future)
                if future.exception():
                    worker, death_count = WorkerPool(1), death_count + 1
                    if death_count < _MAX_DEATHS:
                        pending.append((job, death_count))
                    else:
                        yield result_if_lost(job)
                else:
                    yield future.result()
                begin_next_job(worker, take)
    finally:
        for process in active_children():
            process.kill()
    for job, _ in pending:
        yield work(job)
