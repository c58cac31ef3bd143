"""Processes that help to render, from one picture to the next.

They start in the background and from nothing: a program that renders may have
threads, open files and much memory, none of which a fork should meet.  Until
they are there, and wherever they cannot be, pictures are made without them.
"""

from __future__ import annotations

import atexit
import os
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from math import prod
from mmap import mmap

import numpy as np

from tracer.memory import keep_heap
from tracer.workers import (
    POSSIBLE,
    Job,
    Numbers,
    Team,
    Worker,
    keep_apart,
    pipes,
    readable,
    serve,
    shared,
)

__all__ = ["helped", "run_helper"]

# What they run.  Their tracer is this one, even if the path has changed or says '' for a folder
# that was left; all else is found as it is here.
_CODE = """
import sys
sys.path[:] = {path!r}
import tracer
del sys.path[0]
import tracer.rendering
from tracer.helpers import run_helper
run_helper{ends!r}
"""

# Where the package is.
_FOLDER = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))

# Bytes of memory that each shares with this process: what no picture needs is never touched.
_SHARED = 1 << 25

# The load from which on, pictures before it counted in, it pays to start one.
_START = 1 << 23


class _Helper(Worker):
    """A process with an interpreter of its own."""

    __slots__ = ("_here", "_memory", "_message", "_process")

    def __init__(self, numbers: int) -> None:
        """Start it; it takes `Numbers` from that file."""
        import subprocess  # takes longer to import than a small picture to render

        with pipes() as (calls_in, results_out, calls_out, results_in):
            super().__init__(calls_out, results_in)
            file, memory = shared(_SHARED)
            self._memory = np.frombuffer(memory)
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
        # None if it could not start: nor would another.
        self._here: bool | None = False
        self._message = b""

    def begin(self, job: Job, round: int) -> None:
        """Give it something to do, once it joins."""
        self._message = job.packed(round, self._memory)
        self.slots = job.slots(self._memory)

    def joins(self) -> bool:
        """Whether it is there; then it knows what to do."""
        if self._here is False and readable([self.results], 0):
            try:
                self.receive()
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

    def died(self) -> bool:
        """Whether it was there, and is no more."""
        return bool(self._here) and self._process.poll() is not None

    def stop(self) -> None:
        """End it, whatever it does."""
        self._process.kill()
        self._process.wait()
        self.close()

    def forget(self) -> None:
        """Leave it to the process that this one is a fork of."""
        self._process.returncode = 0
        self.close()


class _Crew:
    """All helpers of this process.

    Attributes
    ----------
    busy : Lock
        Held while they do something.
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
        # No one is told before all can be: if the job cannot be pickled, none takes any number.
        for helper in helpers:
            helper.joins()
        return Team(count, numbers.take, [*helpers])

    def stop(self) -> None:
        """End them all."""
        while self._helpers:
            self._helpers.pop().stop()

    def forget(self) -> None:
        """In a fork of this process: they are not this one's."""
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
    """A team of this process and so many helpers, for so many numbers.

    There are none while something else uses them, nor before it pays to start them.

    Parameters
    ----------
    count, others : int
    job : Job
        What helpers do.
    load : float
        How much there is to do, in units of 10 ns or so.
    """
    others, busy = min(others, count - 1), _crew.busy
    # A program that Python is only a part of would start itself, and not know what to do.
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
        if len(team.workers) < helpers:  # one was killed: nobody asks the others any more
            _crew.stop()
    except BaseException:
        # Nobody will take what they are working on.
        _crew.stop()
        raise
    finally:
        busy.release()


def run_helper(calls: int, results: int, numbers: int, memory: int) -> None:
    """Serve the process that started this one, until that ends; never returns."""
    keep_heap()
    serve(calls, results, Numbers(numbers), memory=np.frombuffer(mmap(memory, 0)))
