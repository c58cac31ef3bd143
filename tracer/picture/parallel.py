"""Work shared among processes.

NumPy in threads gains little: between two array operations a thread waits for the interpreter's
lock.  Another process has its own.

The parts of a job are numbered.  One pipe, the queue, holds all numbers, and then one `_END` for
each process; whichever process is idle reads the next.  Results go to their place in shared memory.
Each worker process reports what it has finished on a pipe of its own.  Whatever no one has reported
in the end is done by the process that asked, which so meets the errors of the others as well.

Workers are either forks, for one job, of a process that does little else; or new interpreters that
stay for the next job, since a program may have threads, open files and much memory, none of which a
fork should inherit.
"""

from __future__ import annotations

import atexit
import os
import pickle
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from functools import cache
from mmap import PAGESIZE, mmap
from struct import Struct
from typing import NamedTuple, NoReturn, TypeAlias

__all__ = ["Job", "Team", "Work", "forked", "helped", "processors", "run_helper"]

Work: TypeAlias = Callable[[int], object]
"""Does the part with a number."""

Job: TypeAlias = Callable[[mmap], Work]
"""Returns the work of a worker, whose results go into shared memory."""

# Only Linux has both.  A process's number may be given to another one: its descriptor may not.
_POSSIBLE = hasattr(os, "memfd_create") and hasattr(os, "pidfd_open")

_NUMBER, _END = Struct("=i"), -1

# A message to a worker that stays: the number of bytes for results, and of the job after them.
_MESSAGE = Struct("=2q")

# The folder that holds the package.
_FOLDER = os.path.dirname(os.path.dirname(os.path.dirname(os.path.abspath(__file__))))

# A new interpreter imports this very package, even if the path has changed, or has '' in it and the
# working folder has changed; all other modules it finds by this process's path.
_CODE = """
import sys
sys.path[:] = {path!r}
import tracer.picture.bands
del sys.path[0]
from tracer.picture.parallel import run_helper
run_helper{files!r}
"""

# A new interpreter takes as long to start as some pictures take, and slows this process meanwhile.
# It starts at a job of the first load, or once all jobs together have the second.
_LONG, _MANY = 1 << 23, 1 << 26


def processors() -> int:
    """How many processors this process may use."""
    # Only some systems tell, Linux among them; others have no workers anyway.
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else 1


def _pipe(reader: ExitStack, writer: ExitStack) -> tuple[int, int]:
    """Both ends of a new pipe; each is closed by one of the stacks."""
    reads, writes = os.pipe()
    reader.callback(os.close, reads)
    writer.callback(os.close, writes)
    return reads, writes


def _put(pipe: int, *numbers: int) -> None:
    data = b"".join(map(_NUMBER.pack, numbers))
    if os.write(pipe, data) < len(data):
        raise OSError("the pipe is too small")


def _taken(queue: int) -> Iterator[int]:
    """Take numbers from the queue, up to an end."""
    # A read of a pipe is atomic.
    while (number := _NUMBER.unpack(os.read(queue, _NUMBER.size))[0]) != _END:
        yield number


class _Worker:
    """Another process that takes part, as this one sees it.

    It reports the numbers of the parts it has done, and the end of each job, on the pipe `reports`;
    if it stays, it waits for jobs on `calls`.  It may have a job (`busy`), have done a part of it
    (`begun`), or have died (`lost`).
    """

    def __init__(self, process: int, files: ExitStack, reports: int, calls: int = -1) -> None:
        self.busy, self.begun, self.lost = calls < 0, False, False
        self.reports, self.calls = reports, calls
        try:
            self._process = os.pidfd_open(process)
        except OSError:  # out of files; so new a child surely has its number
            os.kill(process, signal.SIGKILL)
            os.waitpid(process, 0)
            raise
        files.callback(os.close, self._process)

    def reported(self) -> list[int]:
        """Numbers that it has reported since it was asked; waits for one, or its death."""
        numbers = [number for (number,) in _NUMBER.iter_unpack(os.read(self.reports, 1 << 12))]
        self.begun, self.lost = True, not numbers
        self.busy = self.busy and numbers[-1:] not in ([], [_END])
        return [number for number in numbers if number != _END]

    def kill(self) -> None:
        """End it, whatever it does."""
        with suppress(OSError):  # it has ended, and somebody else has waited for it
            signal.pidfd_send_signal(self._process, signal.SIGKILL)
            os.waitid(os.P_PIDFD, self._process, os.WEXITED)


def _reports(workers: Sequence[_Worker], timeout: int | None) -> Iterator[int]:
    """Numbers that workers report; waits for them, `timeout` ms."""
    import select

    poll, by_pipe = select.poll(), {w.reports: w for w in workers if not w.lost}
    for pipe in by_pipe:
        poll.register(pipe, select.POLLIN)
    for pipe, _ in poll.poll(timeout):
        yield from by_pipe[pipe].reported()


class Team(NamedTuple):
    """This process and its workers, for a job of so many parts, numbered from 0.

    `queue` is the pipe of their numbers, and `memory` what workers write results into.
    """

    parts: int
    workers: Sequence[_Worker] = ()
    queue: int = -1
    memory: mmap | None = None

    def finished(self, work: Work) -> Iterator[tuple[int, bool]]:
        """Do all parts, of which this process does its own by `work`.

        Yields
        ------
        number : int
            A part that is done, in any order.
        here : bool
            Whether this process did it; otherwise its result is in shared memory.

        Raises
        ------
        Exception
            Whatever `work` raises.
        """
        left, workers = dict.fromkeys(range(self.parts)), self.workers
        for number in _taken(self.queue) if workers else ():
            work(number)
            del left[number]
            yield number, True
            for other in _reports(workers, 0):
                del left[other]
                yield other, False
        # If none is left, those who have begun come to their end at once.
        while any(worker.busy and (left or worker.begun) for worker in workers):
            for other in _reports(workers, None):
                del left[other]
                yield other, False
        for number in left:
            work(number)
            yield number, True

    def give_back(self, start: int, stop: int) -> None:
        """Free the pages of shared memory that lie between two bytes."""
        first, last = -(-start // PAGESIZE) * PAGESIZE, stop // PAGESIZE * PAGESIZE
        if self.memory is not None and first < last:
            from mmap import MADV_REMOVE  # not on all systems

            self.memory.madvise(MADV_REMOVE, first, last - first)


def _serve(queue: int, reports: int, work: Work) -> None:
    """Do what a worker does: take numbers, do their parts and report them."""
    for number in _taken(queue):
        try:
            work(number)
        except Exception:  # the process that asked meets the same error, or does better
            work = _skip
        else:
            _put(reports, number)
    _put(reports, _END)


def _skip(_number: int) -> NoReturn:
    """Leave a part to the process that asked."""
    raise RuntimeError


@contextmanager
def forked(parts: int, others: int, size: int, job: Job) -> Iterator[Team]:
    """A team of this process and, at most, `others` copies of it, with `size` bytes to share.

    It has no copies if this process has other threads: a lock that one of them holds would never
    be released in a copy.
    """
    team, others = Team(parts), min(others, parts - 1)
    with ExitStack() as files:
        if others > 0 and _POSSIBLE and threading.active_count() == 1:
            try:
                memory, (reads, writes) = mmap(-1, size), _pipe(files, files)
                os.set_blocking(writes, False)
                _put(writes, *range(parts), *[_END] * (others + 1))
                workers = [_fork(files, reads, job(memory)) for _ in range(others)]
                team = Team(parts, workers, reads, memory)
            except OSError:  # out of processes, files or memory
                files.close()
        yield team


def _fork(files: ExitStack, queue: int, work: Work) -> _Worker:
    """A copy of this process that does one job; closing its files ends it."""
    with ExitStack() as theirs:
        reads, writes = _pipe(files, theirs)
        process = os.fork()
        if not process:
            try:
                # Ctrl-C reaches all processes of a terminal: the first decides what it means.
                signal.signal(signal.SIGINT, signal.SIG_IGN)
                os.close(reads)
                _serve(queue, writes, work)
            finally:  # whatever happens, it must not go on as if it were the first
                os._exit(0)
        worker = _Worker(process, files, reads)
        files.callback(worker.kill)
        return worker


def _start(files: ExitStack, queue: int, memory: int) -> _Worker:
    """A new interpreter that waits for jobs; `memory` is the file that it shares."""
    import subprocess  # takes longer to import than a small picture to render

    with ExitStack() as theirs:
        calls_in, calls_out = _pipe(theirs, files)
        reports_in, reports_out = _pipe(files, theirs)
        path, inherited = [_FOLDER, *map(str, sys.path)], (calls_in, queue, reports_out, memory)
        process = subprocess.Popen(
            # Isolated, as this process may be: the path says all about where modules are.
            [sys.executable, "-I", "-c", _CODE.format(path=path, files=inherited)],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            pass_fds=inherited,
            env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
        )
        process.returncode = 0  # not for `Popen` to wait for, but for `kill`
        return _Worker(process.pid, files, reports_in, calls_out)


class _Helpers:
    """The workers of this process that stay for the next job; `in_use` while one has them."""

    def __init__(self) -> None:
        self.in_use = threading.Lock()
        self._files = ExitStack()
        self._reset()

    def _reset(self) -> None:
        self._files.close()
        self._workers: list[_Worker] = []
        self._memory, self._load = mmap(-1, 1), 0.0

    def team(self, parts: int, others: int, size: int, job: Job, load: float) -> Team:
        """See `helped`."""
        self._load += load
        if not self._workers and load < _LONG and self._load < _MANY:
            return Team(parts)
        packed = pickle.dumps(job)
        for _ in _reports(self._workers, 0):
            pass
        if any(worker.lost for worker in self._workers):
            self.stop()
        # Who still has an earlier job would take numbers of this one for it.
        if any(worker.busy for worker in self._workers):
            return Team(parts)
        try:
            self._prepare(others, size + len(packed))
            self._memory[size : size + len(packed)] = packed
            workers = self._workers[:others]
            _put(self._queue[1], *range(parts), *[_END] * (len(workers) + 1))
            for worker in workers:
                os.write(worker.calls, _MESSAGE.pack(size, len(packed)))
                worker.busy, worker.begun = True, False
        except BaseException:
            self.stop()
            raise
        return Team(parts, workers, self._queue[0], self._memory)

    def _prepare(self, others: int, size: int) -> None:
        """See that there are so many helpers, and so much memory."""
        if not self._workers:
            _end_with_this_process()
            self._queue = _pipe(self._files, self._files)
            os.set_blocking(self._queue[1], False)
            self._file = os.memfd_create("tracer")
            self._files.callback(os.close, self._file)
        if len(self._memory) < size:
            os.ftruncate(self._file, size)
            self._memory = mmap(self._file, size)
        while len(self._workers) < others:
            self._workers.append(_start(self._files, self._queue[0], self._file))

    def stop(self) -> None:
        """End them all; it must pay again to start others, which may be no better."""
        for worker in self._workers:
            worker.kill()
        self._reset()

    def forget(self) -> None:
        """In a fork of the process that started them: leave them to that one."""
        self._reset()
        self.in_use = threading.Lock()


_helpers = _Helpers()


@cache
def _end_with_this_process() -> None:
    atexit.register(_helpers.stop)
    os.register_at_fork(after_in_child=_helpers.forget)


@contextmanager
def helped(parts: int, others: int, size: int, job: Job, load: float) -> Iterator[Team]:
    """A team of this process and, at most, `others` helpers, with `size` bytes to share.

    It has no helpers while another job uses them, nor before it pays to start them; `load` is how
    much there is to do, in units of some 10 ns.  The job is pickled.
    """
    team, others, in_use = Team(parts), min(others, parts - 1), _helpers.in_use
    # In a program that embeds Python the executable is that program, not an interpreter.
    python = os.path.basename(sys.executable or "").startswith("python")
    if not (others > 0 and _POSSIBLE and python and in_use.acquire(blocking=False)):
        yield team
        return
    done = False
    try:
        # Out of processes, files or memory; or a job cannot be pickled.
        with suppress(Exception):
            team = _helpers.team(parts, others, size, job, load)
        yield team
        done = not any(worker.lost for worker in team.workers)
    finally:
        # Helpers may be at work on results that no one will read, or the queue hold numbers.
        if not done:
            _helpers.stop()
        in_use.release()


def run_helper(calls: int, queue: int, reports: int, memory: int) -> NoReturn:
    """Serve the process that started this one, until that ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        while message := os.read(calls, _MESSAGE.size):
            start, size = _MESSAGE.unpack(message)
            shared = mmap(memory, start + size)
            try:
                job: Job = pickle.loads(shared[start : start + size])
                work = job(shared)
            except Exception:  # this process lacks something
                work = _skip
            _serve(queue, reports, work)
    finally:
        os._exit(0)
