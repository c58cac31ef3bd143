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
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from functools import cache
from mmap import PAGESIZE, mmap
from struct import Struct
from typing import NoReturn, TypeAlias

__all__ = ["Job", "Team", "Work", "forked", "helped", "processors", "run_helper", "stop_helpers"]

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


class Team:
    """This process and its workers, if it has any, for a job of so many parts, numbered from 0.

    Attributes
    ----------
    memory : mmap
        What workers write results into.
    lost : bool
        Whether one has died: the queue may hold numbers that were meant for it.
    """

    def __init__(self, parts: int = 0) -> None:
        self._parts, self._files = parts, ExitStack()
        self.forget()

    def forget(self) -> None:
        """Have no workers any more, but let them live: a fork does not own those from before."""
        self._files.close()
        self.memory, self.lost = mmap(-1, 1), False
        self._queue: tuple[int, ...] = ()
        self._processes: list[int] = []
        # The pipes on which workers report, with those on which they are called if they stay; and
        # of those that have not yet reported the end of their job.
        self._workers: dict[int, int] = {}
        self._busy: set[int] = set()

    def stop(self) -> None:
        """End all workers, whatever they do."""
        for process in self._processes:
            with suppress(OSError):  # it has ended, and somebody else has waited for it
                signal.pidfd_send_signal(process, signal.SIGKILL)
                os.waitid(os.P_PIDFD, process, os.WEXITED)
        self.forget()

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
        left = dict.fromkeys(range(self._parts))
        for number in _taken(self._queue[0]) if self._queue else ():
            work(number)
            del left[number]
            yield number, True
            for other in self._reported(0):
                del left[other]
                yield other, False
        while left and self._busy:
            for other in self._reported(None):
                del left[other]
                yield other, False
        for number in left:
            work(number)
            yield number, True

    def give_back(self, start: int, stop: int) -> None:
        """Free the pages of shared memory that lie between two bytes."""
        first, last = -(-start // PAGESIZE) * PAGESIZE, stop // PAGESIZE * PAGESIZE
        if first < last:
            from mmap import MADV_REMOVE  # not on all systems

            self.memory.madvise(MADV_REMOVE, first, last - first)

    def _reported(self, timeout: int | None) -> Iterator[int]:
        """Parts that workers report; waits for one, or a death, `timeout` ms."""
        import select

        poll = select.poll()
        for pipe in self._workers:
            poll.register(pipe, select.POLLIN)
        for pipe, _ in poll.poll(timeout):
            numbers = [number for (number,) in _NUMBER.iter_unpack(os.read(pipe, 1 << 12))]
            if not numbers:
                self.lost = True
                del self._workers[pipe]
            if numbers[-1:] in ([], [_END]):
                self._busy.discard(pipe)
            yield from (number for number in numbers if number != _END)

    def share(self, size: int) -> None:
        """See that there are a queue and so many bytes of memory."""
        if not self._queue:
            self._queue = _pipe(self._files, self._files)
            os.set_blocking(self._queue[1], False)
            self._file = os.memfd_create("tracer")
            self._files.callback(os.close, self._file)
        if len(self.memory) < size:
            os.ftruncate(self._file, size)
            self.memory = mmap(self._file, size)

    def put(self, parts: int, others: int) -> None:
        """Fill the queue for a job of this process and so many workers."""
        self._parts = parts
        _put(self._queue[1], *range(parts), *[_END] * (others + 1))

    def fork(self, work: Work) -> None:
        """Add a copy of this process that does the job in the queue."""
        with ExitStack() as theirs:
            reads, writes = _pipe(self._files, theirs)
            process = os.fork()
            if not process:
                try:
                    # Ctrl-C reaches all processes of a terminal: the first decides what it means.
                    signal.signal(signal.SIGINT, signal.SIG_IGN)
                    os.close(reads)
                    _serve(self._queue[0], writes, work)
                finally:  # whatever happens, it must not go on as if it were the first
                    os._exit(0)
            self._add(process, reads)
            self._busy.add(reads)

    def start(self) -> None:
        """Add a new interpreter that waits for jobs."""
        import subprocess  # takes longer to import than a small picture to render

        with ExitStack() as theirs:
            calls_in, calls_out = _pipe(theirs, self._files)
            reports_in, reports_out = _pipe(self._files, theirs)
            inherited = calls_in, self._queue[0], reports_out, self._file
            code = _CODE.format(path=[_FOLDER, *map(str, sys.path)], files=inherited)
            process = subprocess.Popen(
                # Isolated, as this process may be: the path says all about where modules are.
                [sys.executable, "-I", "-c", code],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                pass_fds=inherited,
                env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
            )
            process.returncode = 0  # not for `Popen` to wait for, but for `stop`
            self._add(process.pid, reports_in, calls_out)

    def _add(self, process: int, reports: int, calls: int = -1) -> None:
        """Count a new child process among the workers."""
        try:
            descriptor = os.pidfd_open(process)
        except OSError:  # out of files; so new a child surely has its number
            os.kill(process, signal.SIGKILL)
            os.waitpid(process, 0)
            raise
        self._files.callback(os.close, descriptor)
        self._processes.append(descriptor)
        self._workers[reports] = calls


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
    try:
        if others > 0 and _POSSIBLE and threading.active_count() == 1:
            try:
                team.share(size)
                work = job(team.memory)
                team.put(parts, others)  # first: a copy that is not known yet has to come to an end
                for _ in range(others):
                    team.fork(work)
            except OSError:  # out of processes, files or memory
                team.stop()
        yield team
    finally:
        team.stop()


class _Helpers(Team):
    """The workers of this process that stay for the next job; `in_use` while one has them."""

    in_use, load = threading.Lock(), 0.0

    def stop(self) -> None:
        """End all; it must pay again to start others, which may be no better."""
        super().stop()
        self.load = 0.0

    def called(self, parts: int, others: int, size: int, job: Job, load: float) -> bool:
        """Give them a job, if that pays; see `helped`."""
        self.load += load
        if not self._workers and load < _LONG and self.load < _MANY:
            return False
        try:
            packed = pickle.dumps(job)
        except Exception:  # it holds what cannot be pickled
            return False
        for _ in self._reported(0):
            pass
        if self.lost:
            self.stop()
        # Who still has an earlier job would take numbers of this one for it.
        if self._busy:
            return False
        if not self._workers:
            _end_with_this_process()
        self.share(size + len(packed))
        self.memory[size : size + len(packed)] = packed
        while len(self._workers) < others:
            self.start()
        self.put(parts, others)
        for reports, calls in list(self._workers.items())[:others]:
            os.write(calls, _MESSAGE.pack(size, len(packed)))
            self._busy.add(reports)
        return True


_helpers = _Helpers()
stop_helpers = _helpers.stop


@cache
def _end_with_this_process() -> None:
    def forget() -> None:
        """In a fork, leave them to the process that started them."""
        _helpers.forget()
        _helpers.in_use = threading.Lock()

    atexit.register(stop_helpers)
    os.register_at_fork(after_in_child=forget)


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
    whole = False
    try:
        try:
            if _helpers.called(parts, others, size, job, load):
                team = _helpers
        except Exception:  # out of processes, files or memory
            _helpers.stop()
        yield team
        whole = not _helpers.lost
    finally:
        # Helpers may be at work on results that no one will read, or the queue hold numbers.
        if not whole:
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
