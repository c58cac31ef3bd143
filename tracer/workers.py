"""Work shared among processes.

NumPy in threads gains little: between two array operations a thread waits for
the interpreter's lock.  A forked process has its own, starts within
milliseconds and has all that was prepared; results come back in shared memory.
"""

from __future__ import annotations

import os
import pickle
import select
import signal
import sys
import threading
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import suppress
from struct import Struct
from typing import Any, NoReturn, TypeVar

from tracer.memory import renew_heap
from tracer.scene import Floats

__all__ = ["AHEAD", "can_fork", "forked"]

T = TypeVar("T")

AHEAD = 4
"""How many calls each process may be beyond the last whose result was yielded."""

# How long a message is, before it.
_SIZE = Struct("=Q")


def can_fork() -> bool:
    """Whether forking is safe here: where it is well tried, and without other threads."""
    return sys.platform == "linux" and threading.active_count() == 1


def _live(
    work: Callable[[int], Any],
    numbers: range,
    ahead: int,
    free: int,
    done: int,
    slots: Floats | None,
) -> NoReturn:
    """What a worker does, from its first breath to its last."""
    with os.fdopen(done, "wb") as results:

        def send(well: bool, result: object) -> None:
            data = pickle.dumps((well, result))
            results.write(_SIZE.pack(len(data)) + data)
            results.flush()

        try:
            # The parent decides what an interrupt means.
            signal.signal(signal.SIGINT, signal.SIG_IGN)
            renew_heap()
            for turn, number in enumerate(numbers):
                if turn >= ahead and not os.read(free, 1):
                    break
                result = work(number)
                if slots is not None:
                    slots[turn % ahead, : len(result)] = result
                    result = len(result)
                send(True, result)
        except BaseException as error:
            send(False, error)
        finally:
            os._exit(0)


def forked(
    work: Callable[[int], T], count: int, workers: int, slots: Floats | None = None
) -> Iterator[T]:
    """Do work(0), work(1), ... in several processes, of which this is the first.

    Parameters
    ----------
    work : callable
    count : int
        How often it is called.
    workers : int
        How many processes.
    slots : (workers - 1, ahead, ...), optional
        `shared` memory for results that are arrays with no more than so many rows; others are
        pickled.

    Yields
    ------
    result
        Of work(0), work(1), ...  In `slots`, they stay until the next is asked for.

    Raises
    ------
    BaseException
        Whatever `work` raises.
    ChildProcessError
        If a worker was killed.
    """
    ahead = AHEAD if slots is None else slots.shape[1]
    pids: list[int] = []
    done: list[int] = []
    free: list[int] = []
    try:
        for worker in range(1, workers):
            done_in, done_out = os.pipe()
            free_in, free_out = os.pipe()
            pid = os.fork()
            if not pid:
                for end in (done_in, free_out, *done, *free):
                    os.close(end)
                turns = range(worker, count, workers)
                part = None if slots is None else slots[worker - 1]
                _live(work, turns, ahead, free_in, done_out, part)
            pids.append(pid)
            done.append(done_in)
            free.append(free_out)
            os.close(done_out)
            os.close(free_in)
        own = map(work, range(0, count, workers))
        early: deque[T] = deque()
        for number in range(count):
            turn, worker = divmod(number, workers)
            if not worker:
                yield early.popleft() if early else next(own)
                continue
            # Rather than wait for others, this one goes on with its own.
            pipe = done[worker - 1]
            while len(early) < ahead and not _ready(pipe):
                try:
                    early.append(next(own))
                except StopIteration:
                    break
            well, result = pickle.loads(_read(pipe, _SIZE.unpack(_read(pipe, _SIZE.size))[0]))
            if not well:
                raise result
            if slots is not None:
                result = slots[worker - 1, turn % ahead, :result]
            yield result
            with suppress(BrokenPipeError):  # killed: found out when it is asked again
                os.write(free[worker - 1], b".")
    finally:
        for pid in pids:
            os.kill(pid, signal.SIGKILL)
            os.waitpid(pid, 0)
        for end in (*done, *free):
            os.close(end)


def _ready(pipe: int) -> bool:
    """Whether there is something to read, be it the end."""
    poll = select.poll()
    poll.register(pipe, select.POLLIN)
    return bool(poll.poll(0))


def _read(pipe: int, size: int) -> bytes:
    """So many bytes."""
    data = bytearray()
    while len(data) < size:
        more = os.read(pipe, size - len(data))
        if not more:
            raise ChildProcessError("a worker was killed")
        data += more
    return bytes(data)
