"""Work shared among processes.

NumPy in threads gains little: between two array operations a thread waits for
the interpreter's lock.  A forked process has its own, starts within
milliseconds and has all that was prepared; results come back in shared memory.
"""

from __future__ import annotations

import ctypes
import os
import pickle
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import suppress
from mmap import mmap

import numpy as np

from tracer.scene import Floats

__all__ = ["can_fork", "forked", "shared"]

# Not how a pickle begins.
_DONE = b"."


def can_fork() -> bool:
    """Whether forking is safe here: where it is well tried, and without other threads."""
    return sys.platform == "linux" and threading.active_count() == 1


def shared(shape: tuple[int, ...]) -> Floats:
    """An array of zeros that workers forked later share with this process."""
    count = int(np.prod(shape))
    return np.frombuffer(mmap(-1, max(8 * count, 1)), np.float64, count).reshape(shape)


def _forget() -> None:
    """Give back memory that the parent had used and freed.

    Pages of its own are made faster than copies of the parent's.
    """
    with suppress(AttributeError, OSError):  # glibc only
        ctypes.CDLL(None).malloc_trim(0)


def forked(work: Callable[[int], None], count: int, workers: int, ahead: int) -> Iterator[int]:
    """Do work(0), work(1), ... in forked processes.

    Parameters
    ----------
    work : callable
        Leaves what it makes in `shared` arrays.
    count : int
        How often it is called.
    workers : int
    ahead : int
        Calls that may be done or under way, for each worker, after the last that was yielded.

    Yields
    ------
    number : int
        Of the call that is done: 0, 1, ...

    Raises
    ------
    BaseException
        Whatever `work` raises.
    ChildProcessError
        If a worker was killed.
    """
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
                    _forget()
                    for number in range(worker, count, workers):
                        if number // workers >= ahead and not os.read(free_in, 1):
                            break
                        work(number)
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
        for number in range(count):
            worker = number % workers
            message = os.read(done[worker], 1)
            if not message:
                raise ChildProcessError("a worker was killed")
            if message != _DONE:
                with open(done[worker], "rb", closefd=False) as rest:
                    raise pickle.loads(message + rest.read())
            yield number
            with suppress(BrokenPipeError):  # killed: found out when it is asked again
                os.write(free[worker], _DONE)
    finally:
        for end in (*done, *free):
            os.close(end)
        for pid in pids:
            os.kill(pid, signal.SIGKILL)
            os.waitpid(pid, 0)
