"""Work shared among processes.

NumPy in threads gains little: between two array operations a thread waits for
the interpreter's lock.  Another process has its own.  `forked` ones have all
that was prepared, start within milliseconds and end with the picture; `helpers`
stay for the next one.

The parts of a job are numbered, and whichever process is idle takes the next number.
"""

from __future__ import annotations

import ctypes
import os
import pickle
import select
import signal
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from mmap import PAGESIZE, mmap
from struct import Struct
from typing import IO, Any, NamedTuple, NoReturn, TypeAlias, TypeVar

import numpy as np

from tracer.memory import renew_heap

__all__ = [
    "AHEAD",
    "POSSIBLE",
    "Caller",
    "Numbers",
    "Team",
    "Work",
    "Worker",
    "forked",
    "keep_apart",
    "pipes",
    "processors",
    "readable",
    "serve",
    "shared",
]

T = TypeVar("T")

Work: TypeAlias = Callable[[int], T]
"""Does the part with a number."""

AHEAD = 4
"""How many results a process may have ready that have not been used yet."""

POSSIBLE = hasattr(os, "memfd_create")
"""Whether other processes can take part: only Linux has `memfd_create`, for shared memory."""

# Before each message: its length in bytes.
_LENGTH = Struct("=Q")


class Numbers:
    """Numbers 0, 1, ... of the parts of a job, each handed out to one of several processes.

    The same numbers serve for one job after the other: each is a round of its own.

    Parameters
    ----------
    file : int, optional
        Descriptor of the memory that the processes share; made if absent.

    Attributes
    ----------
    file : int
    round : int
        The round that this process takes part in.
    """

    __slots__ = ("_state", "file", "round")

    def __init__(self, file: int | None = None) -> None:
        if file is None:
            self.file, memory = shared(PAGESIZE)
        else:
            self.file, memory = file, mmap(file, PAGESIZE)
        self.round = 0
        # The current round, how many numbers it has, and the next of them to be taken.
        self._state = np.frombuffer(memory, np.int64, 3)

    def begin(self, count: int) -> None:
        """Begin another round, of this many numbers."""
        self.round += 1
        with self._locked():
            self._state[:] = self.round, count, 0

    def left(self) -> bool:
        """Whether this process's round is still on, and has numbers left."""
        now, count, number = self._state.tolist()
        return bool(now == self.round and number < count)

    def take(self) -> int | None:
        """The next number, or None if none is left."""
        with self._locked():
            if not self.left():
                return None
            self._state[2] += 1
            return int(self._state[2]) - 1

    @contextmanager
    def _locked(self) -> Iterator[None]:
        from fcntl import LOCK_EX, LOCK_UN, lockf  # not on all systems

        lockf(self.file, LOCK_EX)
        try:
            yield
        finally:
            lockf(self.file, LOCK_UN)


class Worker:
    """Another process that takes part, as this one sees it.

    Attributes
    ----------
    calls, results : int
        Pipes to it, and from it.
    """

    __slots__ = ("calls", "results")

    def __init__(self, calls: int, results: int) -> None:
        self.calls, self.results = calls, results

    def joins(self) -> bool:
        """Whether it is ready to take part."""
        return True

    def send(self, message: bytes = b"") -> None:
        """Send it a message; an empty one says that one of its results has been used."""
        # All messages are far shorter than PIPE_BUF: a pipe takes them whole.
        with suppress(BrokenPipeError):  # it was killed: `receive` will tell
            os.write(self.calls, _LENGTH.pack(len(message)) + message)

    def receive(self) -> Any:
        """Its next answer; raises the exception that ended its work, if that is the answer."""
        well, answer = pickle.loads(self._read(_LENGTH.unpack(self._read(_LENGTH.size))[0]))
        if not well:
            raise answer
        return answer

    def close(self) -> None:
        """Close the pipes: it ends when it finds out."""
        os.close(self.calls)
        os.close(self.results)

    def _read(self, size: int) -> bytes:
        data = bytearray()
        while len(data) < size:
            more = os.read(self.results, size - len(data))
            if not more:
                raise ChildProcessError("a worker was killed")
            data += more
        return bytes(data)


class Team(NamedTuple):
    """This process and its workers.

    Attributes
    ----------
    total : int
        How many parts the job has: numbers 0 to `total` - 1.
    take : callable
        Hands out the next number to this process, or None if none is left; not asked if there are
        no workers.
    workers : list of Worker
        Emptied as soon as one of them turns out to have been killed.
    """

    total: int
    take: Callable[[], int | None]
    workers: list[Worker]

    @classmethod
    def alone(cls, count: int) -> Team:
        """Only this process."""
        return cls(count, lambda: None, [])

    def results(self, work: Work[T]) -> Iterator[T]:
        """Results for all numbers, in order; `work` is what this process does.

        Yields
        ------
        result
            If it lies in memory shared with a worker, it is valid until the next is asked for.

        Raises
        ------
        BaseException
            Whatever `work` raises.
        """
        done: dict[int, tuple[T, Worker | None]] = {}
        left = True
        for number in range(self.total):
            while number not in done:
                own = None
                if not self.workers:
                    own = number
                elif left and len(done) < AHEAD and not self._answered(0):
                    own = self.take()
                    left = own is not None
                if own is not None:
                    done[own] = work(own), None
                    continue
                for worker in self._answered(None):
                    try:
                        place, result = worker.receive()
                    except ChildProcessError:
                        # Which number it had taken is unknown: all that is not done is done here.
                        self.workers.clear()
                        break
                    done[place] = result, worker
            result, used = done.pop(number)
            yield result
            if used is not None:
                used.send()

    def _answered(self, timeout: int | None) -> list[Worker]:
        """Workers with an answer to read, or with none any more as they have ended."""
        by_pipe = {worker.results: worker for worker in self.workers if worker.joins()}
        if not by_pipe:
            return []
        return [by_pipe[pipe] for pipe in readable(by_pipe, timeout)]


def shared(size: int) -> tuple[int, mmap]:
    """Memory of a size in bytes for several processes: its file, and the map of it in this one."""
    file = os.memfd_create("tracer")
    try:
        os.ftruncate(file, size)
        return file, mmap(file, size)
    except BaseException:
        os.close(file)
        raise


@contextmanager
def pipes() -> Iterator[tuple[int, int, int, int]]:
    """Pipes to a worker and from it: first the worker's two ends, then those of this process.

    On leaving, the worker's ends are closed here; after an exception, the others as well.
    """
    with ExitStack() as theirs, ExitStack() as ours:
        calls_in, calls_out = os.pipe()
        theirs.callback(os.close, calls_in)
        ours.callback(os.close, calls_out)
        results_in, results_out = os.pipe()
        theirs.callback(os.close, results_out)
        ours.callback(os.close, results_in)
        yield calls_in, results_out, calls_out, results_in
        ours.pop_all()


def readable(pipes: Iterable[int], timeout: int | None) -> list[int]:
    """Pipes with something to read, or at their end; waits for one, at most `timeout` ms."""
    poll = select.poll()
    for pipe in pipes:
        poll.register(pipe, select.POLLIN)
    return [pipe for pipe, _ in poll.poll(timeout)]


def processors() -> int:
    """How many processors this process may use."""
    # Only some systems tell, Linux among them; others have no workers anyway.
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else 1


def keep_apart(process: int) -> None:
    """Keep a process off the processor that this one runs on, if there are others.

    Linux may wake it there and let it wait for milliseconds: half the time of a small picture.
    """
    with suppress(AttributeError, OSError):
        others = os.sched_getaffinity(0) - {ctypes.CDLL(None).sched_getcpu()}
        if others:
            os.sched_setaffinity(process, others)


class _Fork(Worker):
    """A copy of this process."""

    __slots__ = ("_process",)

    def __init__(self, work: Work[Any], numbers: Numbers, others: list[Worker]) -> None:
        """Fork; the copy closes this process's pipes to `others`, made before, and to itself."""
        with pipes() as (calls_in, results_out, calls_out, results_in):
            super().__init__(calls_out, results_in)
            self._process = os.fork()
            if not self._process:
                try:
                    for worker in (*others, self):
                        worker.close()
                    renew_heap()
                    serve(calls_in, results_out, lambda caller: caller.take_part(work, numbers))
                finally:  # whatever happens, it must not go on as if it were this process
                    os._exit(1)
        keep_apart(self._process)

    def stop(self) -> None:
        """End it, whatever it does."""
        os.kill(self._process, signal.SIGKILL)
        with suppress(ChildProcessError):  # nobody waits for it where SIGCHLD is ignored
            os.waitpid(self._process, 0)
        self.close()


@contextmanager
def forked(work: Work[Any], count: int, others: int) -> Iterator[Team]:
    """A team of this process and `others` copies of it, or fewer, for `count` numbers.

    It has no copies if this process has other threads: a lock that one of them holds would never
    be released in a copy.
    """
    others = min(others, count - 1)
    team = Team.alone(count)
    with ExitStack() as stack:
        if others > 0 and POSSIBLE and threading.active_count() == 1:
            with suppress(OSError):  # out of processes or files
                numbers = Numbers()
                stack.callback(os.close, numbers.file)
                numbers.begin(count)
                team = Team(count, numbers.take, [])
                for _ in range(others):
                    worker = _Fork(work, numbers, team.workers)
                    stack.callback(worker.stop)
                    team.workers.append(worker)
        yield team


class Caller(NamedTuple):
    """The process that a worker works for, as the worker sees it.

    Attributes
    ----------
    calls, results : binary files
        Pipes from it, and to it.
    """

    calls: IO[bytes]
    results: IO[bytes]

    def listen(self) -> bytes | None:
        """Its next message; None once it has ended."""
        length = self.calls.read(_LENGTH.size)
        return self.calls.read(*_LENGTH.unpack(length)) if length else None

    def tell(self, well: bool, answer: object) -> None:
        """Answer; not `well` with the exception that ends this worker."""
        message = pickle.dumps((well, answer))
        self.results.write(_LENGTH.pack(len(message)) + message)
        self.results.flush()

    def take_part(self, work: Work[Any], numbers: Numbers) -> None:
        """Work on numbers until none is left."""
        done = 0
        while done < AHEAD or self.listen() is not None:
            number = numbers.take()
            if number is None:
                break
            self.tell(True, (number, work(number)))
            done += 1


def serve(calls: int, results: int, work: Callable[[Caller], None]) -> NoReturn:
    """Be a worker: `work`, and stay until the pipe `calls` ends."""
    try:
        # Ctrl-C reaches all processes of a terminal: the one that calls decides what it means.
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        with os.fdopen(calls, "rb") as heard, os.fdopen(results, "wb") as told:
            caller = Caller(heard, told)
            try:
                work(caller)
                while caller.listen() is not None:
                    pass
            except BaseException as error:
                caller.tell(False, error)
    finally:
        os._exit(0)
