"""Processes that help to render, from one picture to the next.

They start in the background, as new interpreters: a program that renders may
have threads, open files and much memory, none of which a fork should inherit.
Until they are ready, and where they cannot run, pictures are made without them.
"""

from __future__ import annotations

import atexit
import os
import pickle
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import cycle
from math import prod
from mmap import mmap
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from tracer.arrays import Floats
from tracer.memory import keep_heap
from tracer.workers import (
    POSSIBLE,
    Caller,
    Numbers,
    Team,
    Work,
    Worker,
    keep_apart,
    pipes,
    readable,
    serve,
    shared,
)

__all__ = ["Fill", "Job", "helped", "run_helper"]

# What a helper runs.  It imports this very package, even if the path has changed, or has '' in it
# and the current folder has changed; all other modules it finds by this process's path.
_CODE = """
import sys
sys.path[:] = {path!r}
import tracer
del sys.path[0]
import tracer.rendering
from tracer.helpers import run_helper
run_helper{ends!r}
"""

# The folder that holds the package.
_FOLDER = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))

# Bytes of memory that each helper shares with this process; pages that are not used cost nothing.
_SHARED = 1 << 27

# The load, of all pictures so far together, from which it pays to start helpers.
_START = 1 << 23


Fill: TypeAlias = Callable[[int, Floats], int]
"""Writes the result for a number into the memory given, and returns how many rows it has."""


class Job(NamedTuple):
    """What a process that has nothing of this one's memory is to do.

    Attributes
    ----------
    make, arguments
        make(*arguments) returns the `Fill`; `make` is a function of a module, and the arguments
        can be pickled.
    shape : (AHEAD, ...)
        Of the memory for its results.
    """

    make: Callable[..., Fill]
    arguments: tuple[Any, ...]
    shape: tuple[int, ...]

    def slots(self, memory: mmap) -> Floats:
        """The part of shared memory that its results go into."""
        return np.frombuffer(memory, count=prod(self.shape)).reshape(self.shape)

    def packed(self, round: int, memory: mmap) -> bytes:
        """The message that asks for this job in a round.

        The job itself goes into the shared memory, after the results: for many objects a pipe would
        take ten times as long.
        """
        start = self.slots(memory).nbytes
        memory.seek(start)
        pickle.dump(self, memory, protocol=5)
        return pickle.dumps((round, start, memory.tell()))

    @staticmethod
    def unpacked(message: bytes, memory: mmap, numbers: Numbers) -> Job | None:
        """The job that a message asks for; None if nothing of it is left to do."""
        numbers.round, start, end = pickle.loads(message)
        job = memory[start:end]
        # Asked only now that the job is copied: when a round is over, the next one's may be written
        # over it.
        unpacked: Job | None = pickle.loads(job) if numbers.left() else None
        return unpacked

    def work(self, memory: mmap) -> Work[tuple[int, int]]:
        """What a helper does: results go into one slot after the other; which, and their rows."""
        fill, slots = self.make(*self.arguments), cycle(enumerate(self.slots(memory)))

        def work(number: int) -> tuple[int, int]:
            place, slot = next(slots)
            return place, fill(number, slot)

        return work


class _Helper(Worker):
    """A worker that is a new interpreter, and stays for the next picture."""

    __slots__ = ("_here", "_memory", "_message", "_process", "_slots")

    def __init__(self, numbers: int) -> None:
        """Start it; `numbers` is the file of the `Numbers` that it takes from."""
        import subprocess  # takes longer to import than a small picture to render

        with pipes() as (calls_in, results_out, calls_out, results_in):
            super().__init__(calls_out, results_in)
            file, self._memory = shared(_SHARED)
            path = [_FOLDER, *map(str, sys.path)]
            ends = calls_in, results_out, numbers, file
            try:
                self._process = subprocess.Popen(
                    [sys.executable, "-c", _CODE.format(path=path, ends=ends)],
                    stdin=subprocess.DEVNULL,
                    stdout=subprocess.DEVNULL,
                    stderr=subprocess.DEVNULL,
                    pass_fds=ends,
                    env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
                )
            finally:
                os.close(file)
        # Whether it has started.  None if it could not: it stays, for another could not either.
        self._here: bool | None = False
        self._message = b""

    def begin(self, job: Job, round: int) -> None:
        """Prepare a job, which is sent as soon as the helper `joins`."""
        self._message = job.packed(round, self._memory)
        self._slots = job.slots(self._memory)

    def joins(self) -> bool:
        """Whether it has started; if so, the job has been sent."""
        if self._here is False and readable([self.results], 0):
            try:
                super().receive()
                self._here = True
            except ChildProcessError:
                self._here = None
                self._process.kill()
                self._process.wait()
        if self._here and self._message:
            keep_apart(self._process.pid)
            self.send(self._message)
            self._message = b""
        return bool(self._here)

    def receive(self) -> tuple[int, Floats]:
        """Its next result, valid until it is told that this has been used; see `Worker`."""
        number, (slot, rows) = super().receive()
        return number, self._slots[slot, :rows]

    def died(self) -> bool:
        """Whether it has ended after it had started."""
        return bool(self._here) and self._process.poll() is not None

    def stop(self) -> None:
        """End it, whatever it does."""
        self._process.kill()
        self._process.wait()
        self.close()

    def forget(self) -> None:
        """In a fork of the process that started it: leave it to that one."""
        self._process.returncode = 0
        self.close()


class _Crew:
    """All helpers of this process.

    Attributes
    ----------
    busy : Lock
        Held while a picture has their help.
    """

    def __init__(self) -> None:
        self.busy = threading.Lock()
        self._helpers: list[_Helper] = []
        self._numbers: Numbers | None = None
        self._load = 0.0

    def team(self, count: int, others: int, job: Job, load: float) -> Team:
        """See `helped`."""
        self._load += load
        if not self._helpers and self._load < _START:
            return Team.alone(count)
        numbers = self._numbers = self._numbers or Numbers()
        numbers.begin(count)
        for helper in [helper for helper in self._helpers if helper.died()]:
            self._helpers.remove(helper)
            helper.stop()
        while len(self._helpers) < others:
            self._helpers.append(_Helper(numbers.file))
        helpers = self._helpers[:others]
        for helper in helpers:
            helper.begin(job, numbers.round)
        # Sent only when every message is made: if pickling fails, no helper has taken a number.
        for helper in helpers:
            helper.joins()
        return Team(count, numbers.take, [*helpers])

    def stop(self) -> None:
        """End them all."""
        while self._helpers:
            self._helpers.pop().stop()

    def forget(self) -> None:
        """In a fork of the process that started them: have none."""
        while self._helpers:
            self._helpers.pop().forget()
        if self._numbers is not None:
            os.close(self._numbers.file)
        self._numbers = None
        self.busy = threading.Lock()


_crew = _Crew()
atexit.register(_crew.stop)
if POSSIBLE:
    os.register_at_fork(after_in_child=_crew.forget)


@contextmanager
def helped(count: int, others: int, job: Job, load: float) -> Iterator[Team]:
    """A team of this process and, at most, `others` helpers, for `count` numbers.

    It has no helpers while another picture uses them, nor before it pays to start them.

    Parameters
    ----------
    count, others : int
    job : Job
        What helpers do.
    load : float
        How much there is to do, in units of 10 ns or so.
    """
    others, busy = min(others, count - 1), _crew.busy
    # In a program that embeds Python the executable is that program, not an interpreter.
    python = os.path.basename(sys.executable or "").startswith("python")
    possible = POSSIBLE and python and 8 * prod(job.shape) <= _SHARED
    if not (others > 0 and possible and busy.acquire(blocking=False)):
        yield Team.alone(count)
        return
    try:
        try:
            team = _crew.team(count, others, job, load)
        except Exception:
            # Out of processes, files or memory, or a job cannot be pickled.
            team = Team.alone(count)
        helpers = len(team.workers)
        yield team
        if len(team.workers) < helpers:  # one was killed, and what the others did was not read
            _crew.stop()
    except BaseException:
        # Helpers are at work on results that will not be read: the next picture needs new ones.
        _crew.stop()
        raise
    finally:
        busy.release()


def run_helper(calls: int, results: int, numbers: int, memory: int) -> None:
    """Serve the process that started this one, until that ends; never returns."""
    keep_heap()
    taken, shared = Numbers(numbers), mmap(memory, 0)

    def do_jobs(caller: Caller) -> None:
        caller.tell(True, None)
        while (message := caller.listen()) is not None:
            if not message:  # a result of a round that is over has been used
                continue
            try:
                job = Job.unpacked(message, shared, taken)
                work = job and job.work(shared)
            except Exception:  # this process lacks something: the one that calls does all
                continue
            if work is not None:
                caller.take_part(work, taken)

    serve(calls, results, do_jobs)
