"""Work shared among processes: NumPy's threads wait too much for the interpreter's lock.

The parts of a job are numbered.  All processes share an open file, whose memory holds the results
and whose offset is the number of the next part: whichever process is idle takes that.  A worker
reports what it has finished on a pipe.  Whatever no one has reported in the end is done by the
process that asked, which so meets the errors of the others as well.

Workers are either forks, for one job, of a process that does little else; or *helpers*, new
interpreters that stay for the next job, since a program may have threads, open files and much
memory, none of which a fork should inherit.
"""

from __future__ import annotations

import os
import pickle
import select
import signal
import sys
import threading
from collections.abc import Callable, Generator, Iterator
from contextlib import ExitStack, suppress
from mmap import mmap
from struct import Struct
from typing import NoReturn, TypeAlias

__all__ = ["Job", "Work", "forked", "helped", "processors", "run_helper"]

Work: TypeAlias = Callable[[int], object]
"""Does the part with a number."""

Job: TypeAlias = Callable[[mmap], Work]
"""Returns the work of a worker, whose results go into shared memory."""

Done: TypeAlias = Generator[tuple[int, mmap | None], None, None]
"""Parts that are done, in any order; and of those that a worker did, the memory with the result."""

# Only Linux has both.  A process's number may be given to another one: its descriptor may not.
_POSSIBLE = hasattr(os, "memfd_create") and hasattr(os, "pidfd_open")

# What a worker reports: the number of a part; and a helper, that it is idle again.
_REPORT, _IDLE = Struct("=q"), -1

# What a helper is sent: how many parts there are, and where in the shared memory the job lies.
_CALL = Struct("=3q")

# Shared memory beyond this many bytes is given back after each job.
_KEPT = 1 << 27

# A helper imports this very package, even if the path has changed, or has '' in it and the working
# folder has changed; all other modules it finds by this process's path.
_FOLDER = os.path.dirname(os.path.dirname(os.path.dirname(os.path.abspath(__file__))))
_CODE = (
    "import sys; sys.path[:] = {path!r}; from tracer.picture.parallel import run_helper;"
    " del sys.path[0]; run_helper{files!r}"
)

# A new interpreter takes as long to start as some pictures take, and slows this process meanwhile.
# It starts at a job of the first load, or once all jobs together have the second.
_LONG, _MANY = 1 << 23, 1 << 26


def processors() -> int:
    """How many processors this process may use."""
    # Only some systems tell, Linux among them; others have no workers anyway.
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else 1


class _Team:
    """Workers, and the file that they share.

    Of each worker, by the pipe on which it reports: its descriptor, a pipe to call it, what closes
    all three.
    """

    def __init__(self) -> None:
        self.workers: dict[int, tuple[int, int, ExitStack]] = {}
        self.busy: set[int] = set()
        self.file, self.memory = -1, mmap(-1, 1)

    def share(self, size: int) -> None:
        """Have so many bytes of memory, and a counter of parts at 0."""
        if self.file < 0:
            memory = os.memfd_create("tracer")
            try:  # opened by a name: only then do seeks of two processes wait for each other
                self.file = os.open(f"/proc/self/fd/{memory}", os.O_RDWR)
            finally:
                os.close(memory)
        os.ftruncate(self.file, max(size, _KEPT))
        os.lseek(self.file, 0, os.SEEK_SET)
        self.memory = mmap(self.file, size)

    def add(self, start: Callable[[int, int, ExitStack], int]) -> None:
        """Add a worker: `start`, given its pipes and our ends of them, returns its number."""
        with ExitStack() as ours, ExitStack() as theirs:
            calls, call = _pipe(theirs, ours)
            report, reports = _pipe(ours, theirs)
            number = start(calls, reports, ours)
            theirs.close()  # so that there are files left for one more
            process = os.pidfd_open(number)
            ours.callback(os.close, process)
            self.workers[report] = process, call, ours.pop_all()

    def done(self, parts: int, work: Work) -> Done:
        """Do a job together with those who are busy with it."""
        left = set(range(parts))
        numbers = _taken(self.file, parts) if self.busy else iter(range(parts))
        while left:
            number = next(numbers, None)
            if number is None and not self.busy:
                number = min(left)
            if number is not None:
                work(number)
                left.remove(number)
                yield number, None
            for other in self.reported(wait=number is None) if self.busy else ():
                left.remove(other)
                yield other, self.memory

    def reported(self, *, wait: bool = False) -> Iterator[int]:
        """Parts that workers report; `wait` for a report or a death."""
        poll = select.poll()
        for report in self.workers:
            poll.register(report, select.POLLIN)
        for report, _ in poll.poll(None if wait else 0):
            data = os.read(report, 1 << 12)
            if not data:
                self.end(report)
            for (number,) in _REPORT.iter_unpack(data):
                if number == _IDLE:
                    self.busy.remove(report)
                else:
                    yield number

    def end(self, report: int) -> None:
        """End a worker, whatever it does."""
        process, _, files = self.workers.pop(report)
        self.busy.discard(report)
        with suppress(OSError):  # it has ended, and somebody else has waited for it
            signal.pidfd_send_signal(process, signal.SIGKILL)
            os.waitid(os.P_PIDFD, process, os.WEXITED)
        files.close()

    def stop(self) -> None:
        """End all workers, and share nothing."""
        for report in list(self.workers):
            self.end(report)
        if self.file >= 0:
            os.close(self.file)
        self.file = -1


def _pipe(reader: ExitStack, writer: ExitStack) -> tuple[int, int]:
    """Both ends of a new pipe; each is closed by one of the stacks."""
    reads, writes = os.pipe()
    reader.callback(os.close, reads)
    writer.callback(os.close, writes)
    return reads, writes


def _taken(file: int, parts: int) -> Iterator[int]:
    """Take numbers of parts, each of which only one process gets."""
    # A seek moves the offset and returns it in one step.
    while (number := os.lseek(file, 1, os.SEEK_CUR) - 1) < parts:
        yield number


def _serve(file: int, parts: int, reports: int, work: Work) -> None:
    """Take part in a job as a worker."""
    for number in _taken(file, parts):
        work(number)
        os.write(reports, _REPORT.pack(number))


def forked(parts: int, others: int, size: int, job: Job, work: Work) -> Done:
    """Do a job, this process by `work` and at most `others` forks by `job` with `size` bytes.

    There are none if this process has other threads: a lock that one of them holds would never be
    released in a copy.
    """
    team, others = _Team(), min(others, parts - 1)

    def fork(_calls: int, reports: int, ours: ExitStack) -> int:
        if number := os.fork():
            return number
        try:
            ours.close()
            # Ctrl-C reaches all processes of a terminal: the first decides what it means.
            signal.signal(signal.SIGINT, signal.SIG_IGN)
            _serve(team.file, parts, reports, its_work)
        finally:  # whatever happens, it must not go on as if it were the first
            os._exit(0)

    try:
        if others > 0 and _POSSIBLE and threading.active_count() == 1:
            with suppress(OSError):  # out of processes, files or memory
                team.share(size)
                its_work = job(team.memory)
                for _ in range(others):
                    team.add(fork)
                    team.busy.update(team.workers)
        yield from team.done(parts, work)
    finally:
        team.stop()


class _Helpers(_Team):
    """The helpers of a process; `in_use` while a job has them."""

    def __init__(self) -> None:
        super().__init__()
        self.owner, self.in_use, self.load = os.getpid(), threading.Lock(), 0.0

    def call(self, parts: int, others: int, size: int, job: Job, load: float) -> bool:
        """Give them a job, if that pays and they are idle."""
        self.load += load
        for _ in self.reported():
            pass
        pays = load >= _LONG or self.load >= _MANY
        # Who still has an earlier job would read this one's memory for that.
        if self.busy or not (self.workers or pays):
            return False
        packed = pickle.dumps(job)
        end = size + len(packed)
        self.share(end)
        self.memory[size:] = packed
        while pays and len(self.workers) < others:
            self.load = 0.0
            self.add(self._started)
        for report in list(self.workers)[:others]:
            os.write(self.workers[report][1], _CALL.pack(parts, size, end))
            self.busy.add(report)
        return True

    def _started(self, calls: int, reports: int, _ours: ExitStack) -> int:
        import subprocess  # takes longer to import than a small picture to render

        files, path = (self.file, calls, reports), [_FOLDER, *map(str, sys.path)]
        process = subprocess.Popen(
            # Isolated, as this process may be: the path says all about where modules are.
            [sys.executable, "-I", "-c", _CODE.format(path=path, files=files)],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            pass_fds=files,
            env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
        )
        process.returncode = 0  # not for `Popen` to wait for
        return process.pid


_helpers = _Helpers()


def helped(parts: int, others: int, size: int, job: Job, work: Work, load: float) -> Done:
    """Do a job, this process by `work` and at most `others` helpers by `job` with `size` bytes.

    There are none while another job uses them, nor before it pays to start them; `load` is how much
    there is to do, in units of some 10 ns.  The job is pickled.
    """
    global _helpers
    if _helpers.owner != os.getpid():  # a fork leaves them to the process that started them
        _helpers = _Helpers()
    team, helpers, others = _Team(), _helpers, min(others, parts - 1)
    # In a program that embeds Python the executable is that program, not an interpreter.
    python = os.path.basename(sys.executable or "").startswith("python")
    if not (others > 0 and _POSSIBLE and python and helpers.in_use.acquire(blocking=False)):
        yield from team.done(parts, work)
        return
    try:
        with suppress(Exception):  # out of processes, files or memory; no job that can be pickled
            if helpers.call(parts, others, size, job, load):
                team = helpers
        yield from team.done(parts, work)
        if team is helpers:
            os.ftruncate(helpers.file, _KEPT)
    except BaseException:  # they may be at work on results that no one will read
        helpers.stop()
        raise
    finally:
        helpers.in_use.release()


def run_helper(file: int, calls: int, reports: int) -> NoReturn:
    """Serve the process that started this one, until that ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        while call := os.read(calls, _CALL.size):
            parts, start, end = _CALL.unpack(call)
            with suppress(Exception):  # who asked meets the same error, or has what is lacking here
                shared = mmap(file, end)
                job: Job = pickle.loads(shared[start:])
                _serve(file, parts, reports, job(shared))
            os.write(reports, _REPORT.pack(_IDLE))
    finally:
        os._exit(0)
