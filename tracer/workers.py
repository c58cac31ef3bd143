"""Work shared among processes, its results in order.

NumPy in threads gains little: between two array operations a thread waits for
the interpreter's lock.  A forked process has its own, starts within
milliseconds and has all that was prepared; results come back in shared memory.
"""

from __future__ import annotations

import os
import pickle
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from mmap import mmap

import numpy as np

from tracer.scene import Floats

__all__ = ["can_fork", "forked"]

# Results that a worker may be ahead.
_SLOTS = 2

# Not how a pickle begins.
_DONE = b"."


def can_fork() -> bool:
    """Whether forking is safe here: where it is well tried, and without other threads."""
    return sys.platform == "linux" and threading.active_count() == 1


def forked(
    work: Callable[[int], Floats],
    shapes: Sequence[tuple[int, ...]],
    workers: int,
) -> Iterator[Floats]:
    """The results of work(0), work(1), ... one after the other, made in forked processes.

    Parameters
    ----------
    work : callable
        Returns float64 of the shape of that number.
    shapes : sequence of tuple
    workers : int

    Yields
    ------
    result : float64

    Raises
    ------
    BaseException
        Whatever `work` raises.
    ChildProcessError
        If a worker was killed.
    """
    room = max(8 * int(np.prod(shape)) for shape in shapes)
    shared = mmap(-1, workers * _SLOTS * room)

    def slot(number: int) -> Floats:
        turn, worker = divmod(number, workers)
        place = (worker * _SLOTS + turn % _SLOTS) * room
        count = int(np.prod(shapes[number]))
        return np.frombuffer(shared, np.float64, count, place).reshape(shapes[number])

    pids: list[int] = []
    done: list[int] = []
    free: list[int] = []
    try:
        for worker in range(workers):
            done_in, done_out = os.pipe()
            free_in, free_out = os.pipe()
            pid = os.fork()
            if not pid:
                try:
                    # The parent decides what an interrupt means.
                    signal.signal(signal.SIGINT, signal.SIG_IGN)
                    for end in (done_in, free_out, *done, *free):
                        os.close(end)
                    for number in range(worker, len(shapes), workers):
                        if number // workers >= _SLOTS and not os.read(free_in, 1):
                            break
                        slot(number)[:] = work(number)
                        os.write(done_out, _DONE)
                except BaseException as error:
                    os.write(done_out, pickle.dumps(error))
                finally:
                    os._exit(0)
            pids.append(pid)
            done.append(done_in)
            free.append(free_out)
            os.close(done_out)
            os.close(free_in)
        for number in range(len(shapes)):
            worker = number % workers
            message = os.read(done[worker], 1)
            if not message:
                raise ChildProcessError("a worker was killed")
            if message != _DONE:
                with open(done[worker], "rb", closefd=False) as rest:
                    raise pickle.loads(message + rest.read())
            result = slot(number).copy()
            if number + _SLOTS * workers < len(shapes):
                with suppress(BrokenPipeError):  # killed: found out when it is asked again
                    os.write(free[worker], _DONE)
            yield result
    finally:
        for end in (*done, *free):
            os.close(end)
        for pid in pids:
            os.kill(pid, signal.SIGKILL)
            os.waitpid(pid, 0)
