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
from typing import NamedTuple, TypeAlias

import numpy as np

from tracer.arrays import Floats
from tracer.picture.workers import (
    POSSIBLE,
    Channel,
    Numbers,
    Team,
    Work,
    Worker,
    channel,
    serve,
    take_part,
)

__all__ = ["Fill", "Job", "helped", "run_helper"]

# What a helper runs.  It imports this very package, even if the path has changed, or has '' in it
# and the current folder has changed; all other modules it finds by this process's path.  What only
# some pictures need is imported before it is asked for any.
_CODE = """
import sys
sys.path[:] = {path!r}
import tracer
del sys.path[0]
import tracer.antialias.refine, tracer.light_buffers, tracer.rendering, tracer.shadow_cache
from tracer.picture.helpers import run_helper
run_helper{ends!r}
"""

# The folder that holds the package.
_FOLDER = os.path.dirname(os.path.dirname(os.path.dirname(os.path.abspath(__file__))))

# Bytes of memory that each helper shares with this process; pages that are not used cost nothing.
_SHARED = 1 << 27

# The load, of all pictures so far together, from which it pays to start helpers.
_START = 1 << 23


Fill: TypeAlias = Callable[[int, Floats], None]
"""Writes the result for a number into the memory given."""


class Job(NamedTuple):
    """What a process that has nothing of this one's memory is to do.

    Attributes
    ----------
    make
        Returns the `Fill`; it can be pickled.
    shape : (AHEAD, ...)
        Of the memory for its results.
    """

    make: Callable[[], Fill]
    shape: tuple[int, ...]

    def slots(self, memory: memoryview | mmap) -> Floats:
        """The part of shared memory that its results go into."""
        return np.frombuffer(memory, count=prod(self.shape)).reshape(self.shape)

    def work(self, memory: mmap) -> Work[int]:
        """What a helper does: results go into one slot after the other; returns which."""
        fill, slots = self.make(), cycle(enumerate(self.slots(memory)))

        def work(number: int) -> int:
            place, slot = next(slots)
            fill(number, slot)
            return place

        return work


class _Helper(Worker):
    """A worker that is a new interpreter, and stays for the next picture."""

    __slots__ = ("_memory", "_slots")

    def __init__(self, numbers: int) -> None:
        """Start it; `numbers` is the file of the `Numbers` that it takes from."""
        import subprocess  # takes longer to import than a small picture to render

        with channel() as (ours, theirs):
            file = os.memfd_create("tracer")
            path = [_FOLDER, *map(str, sys.path)]
            ends = theirs.reads, theirs.writes, numbers, file
            try:
                os.ftruncate(file, _SHARED)
                self._memory = mmap(file, _SHARED)
                process = subprocess.Popen(
                    [sys.executable, "-c", _CODE.format(path=path, ends=ends)],
                    stdin=subprocess.DEVNULL,
                    stdout=subprocess.DEVNULL,
                    stderr=subprocess.DEVNULL,
                    pass_fds=ends,
                    env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
                )
            finally:
                os.close(file)
        process.returncode = 0  # not for `Popen` to wait for, but for `stop`
        super().__init__(ours, process.pid)

    def begin(self, job: Job, packed: bytes, round: int) -> None:
        """Ask it to do a job, as soon as it has started; `packed`: the job, pickled.

        That goes into the end of the shared memory: for many objects a pipe would take ten times as
        long.
        """
        self._slots = job.slots(memoryview(self._memory)[: -len(packed)])
        self._memory[-len(packed) :] = packed
        self.keep_apart()
        self.send((round, len(packed)))

    def result(self) -> tuple[int, Floats]:
        """Its next result, valid until it is told that this has been used; see `Worker`."""
        number, slot = super().result()
        return number, self._slots[slot]


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
        packed = pickle.dumps(job)
        numbers = self._numbers = self._numbers or Numbers()
        numbers.begin(count)
        while len(self._helpers) < others:
            self._helpers.append(_Helper(numbers.file))
        helpers = self._helpers[:others]
        for helper in helpers:
            helper.begin(job, packed, numbers.round)
        return Team(count, numbers.take, [*helpers])

    def stop(self) -> None:
        """End them all; it must pay again to start others, which may be no better."""
        self._load = 0.0
        while self._helpers:
            self._helpers.pop().stop()

    def forget(self) -> None:
        """In a fork of the process that started them: leave them to that one."""
        while self._helpers:
            self._helpers.pop().close()
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
    if not (others > 0 and POSSIBLE and python and busy.acquire(blocking=False)):
        yield Team.alone(count)
        return
    read = False
    try:
        try:
            team = _crew.team(count, others, job, load)
        except Exception:
            # Out of processes, files or memory, or a job cannot be pickled, or is too large.
            team = Team.alone(count)
        helpers = len(team.workers)
        yield team
        # If one was killed, what the others did was not read.
        read = len(team.workers) == helpers
    finally:
        # Helpers may be at work on results that will not be read: the next picture needs new ones.
        if not read:
            _crew.stop()
        busy.release()


def run_helper(reads: int, writes: int, numbers: int, memory: int) -> None:
    """Serve the process that started this one, until that ends; never returns."""
    caller, taken, shared = Channel(reads, writes), Numbers(numbers), mmap(memory, 0)

    def do_jobs() -> None:
        while True:
            work = received(caller.receive(), taken, shared)
            if work is not None:
                take_part(caller, work, taken)

    serve(caller, do_jobs)


def received(message: tuple[int, int] | None, numbers: Numbers, memory: mmap) -> Work[int] | None:
    """In a helper: what a message asks for; None if there is nothing to do."""
    if message is None:  # a result of a round that is over has been used
        return None
    numbers.round, size = message
    job = memory[-size:]
    # Asked only now that the job is copied: the next round's may be written over it.
    if not numbers.left():
        return None
    try:
        unpacked: Job = pickle.loads(job)
        return unpacked.work(memory)
    except Exception:  # this process lacks something: the one that calls does all
        return None
