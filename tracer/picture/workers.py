"""Work shared among processes.

NumPy in threads gains little: between two array operations a thread waits for
the interpreter's lock.  Another process has its own.  `forked` ones have all
that was prepared, start within milliseconds and end with the picture; `helpers`
stay for the next one.

The parts of a job are numbered, and whichever process is idle takes the next number.
"""

from __future__ import annotations

import ctypes
import itertools
import os
import pickle
import select
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from struct import Struct
from typing import Any, NamedTuple, NoReturn, TypeAlias, TypeVar

__all__ = [
    "AHEAD",
    "POSSIBLE",
    "Channel",
    "Numbers",
    "Team",
    "Work",
    "Worker",
    "channel",
    "forked",
    "processors",
    "serve",
    "take_part",
]

T = TypeVar("T")

Work: TypeAlias = Callable[[int], T]
"""Does the part with a number."""

AHEAD = 4
"""How many results a process may have ready that have not been used yet."""

POSSIBLE = hasattr(os, "memfd_create")
"""Whether other processes can take part: only Linux has `memfd_create`, for shared memory."""

# Before each message: its length in bytes.  And what is in the file of `Numbers`.
_LENGTH, _STATE = Struct("=Q"), Struct("=3q")


class Numbers:
    """Numbers 0, 1, ... of the parts of a job, each handed out to one of several processes.

    The same numbers serve for one job after the other: each is a round of its own.

    Parameters
    ----------
    file : int, optional
        Descriptor of the file, in memory, that the processes share; made if absent.

    Attributes
    ----------
    file : int
    round : int
        The round that this process takes part in.
    """

    __slots__ = ("file", "round")

    def __init__(self, file: int | None = None) -> None:
        self.file = os.memfd_create("tracer") if file is None else file
        self.round = 0

    def begin(self, count: int) -> None:
        """Begin another round, of this many numbers."""
        self.round += 1
        with self._locked():
            self._write(self.round, count, 0)

    def left(self) -> bool:
        """Whether this process's round is still on, and has numbers left."""
        now, count, number = self._read()
        return now == self.round and number < count

    def take(self) -> int | None:
        """The next number, or None if none is left."""
        with self._locked():
            if not self.left():
                return None
            now, count, number = self._read()
            self._write(now, count, number + 1)
            return number

    def _read(self) -> tuple[int, int, int]:
        """The current round, how many numbers it has, and the next of them to be taken."""
        now, count, number = _STATE.unpack(os.pread(self.file, _STATE.size, 0))
        return now, count, number

    def _write(self, *state: int) -> None:
        os.pwrite(self.file, _STATE.pack(*state), 0)

    @contextmanager
    def _locked(self) -> Iterator[None]:
        from fcntl import LOCK_EX, LOCK_UN, lockf  # not on all systems

        lockf(self.file, LOCK_EX)
        try:
            yield
        finally:
            lockf(self.file, LOCK_UN)


class Channel:
    """One end of two pipes between this process and another.

    Parameters
    ----------
    reads, writes : int
        Descriptors of the pipes from the other process, and to it.
    """

    __slots__ = ("reads", "writes")

    def __init__(self, reads: int, writes: int) -> None:
        self.reads, self.writes = reads, writes

    def send(self, message: object) -> None:
        """Send a message, which is pickled."""
        data = pickle.dumps(message)
        data = _LENGTH.pack(len(data)) + data
        with suppress(BrokenPipeError):  # the other process has ended: `receive` will tell
            while data:
                data = data[os.write(self.writes, data) :]

    def receive(self) -> Any:
        """The next message; waits for it.  Raises EOFError if the other process has ended."""
        return pickle.loads(self._read(_LENGTH.unpack(self._read(_LENGTH.size))[0]))

    def close(self) -> None:
        """Close the pipes: the other process finds out."""
        os.close(self.reads)
        os.close(self.writes)

    def _read(self, size: int) -> bytes:
        data = bytearray()
        while len(data) < size:
            more = os.read(self.reads, size - len(data))
            if not more:
                raise EOFError
            data += more
        return bytes(data)


@contextmanager
def channel() -> Iterator[tuple[Channel, Channel]]:
    """Both ends of a new channel: this process's, and a worker's.

    On leaving, the worker's end is closed here; after an exception, the other as well.
    """
    with ExitStack() as theirs, ExitStack() as ours:
        calls_in, calls_out = os.pipe()
        theirs.callback(os.close, calls_in)
        ours.callback(os.close, calls_out)
        results_in, results_out = os.pipe()
        theirs.callback(os.close, results_out)
        ours.callback(os.close, results_in)
        yield Channel(results_in, calls_out), Channel(calls_in, results_out)
        ours.pop_all()


class Worker(Channel):
    """Another process that takes part, as this one sees it.

    Parameters
    ----------
    end : Channel
        This process's.
    process : int
        Its number.
    """

    __slots__ = ("_process",)

    def __init__(self, end: Channel, process: int) -> None:
        super().__init__(end.reads, end.writes)
        self._process = process

    def result(self) -> tuple[int, Any]:
        """The next number it has worked on, and the result; raises what ended its work, if so."""
        answer = self.receive()
        if isinstance(answer, BaseException):
            raise answer
        number, result = answer
        return number, result

    def keep_apart(self) -> None:
        """Keep it off the processor that this process runs on, if there are others.

        Linux may wake it there and let it wait for milliseconds: half the time of a small picture.
        """
        with suppress(AttributeError, OSError):
            others = os.sched_getaffinity(0) - {ctypes.CDLL(None).sched_getcpu()}
            if others:
                os.sched_setaffinity(self._process, others)

    def stop(self) -> None:
        """End it, whatever it does."""
        with suppress(OSError):  # somebody else has waited for it
            os.kill(self._process, signal.SIGKILL)
            os.waitpid(self._process, 0)
        self.close()


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
        for number in range(self.total):
            while number not in done:
                own: int | None = number
                if self.workers:
                    # Results of others come first: these go on only when theirs have been used.
                    busy = len(done) >= AHEAD or self._answered(0)
                    own = None if busy else self.take()
                if own is not None:
                    done[own] = work(own), None
                    continue
                for worker in self._answered(None):
                    try:
                        place, result = worker.result()
                    except EOFError:
                        # Which number it had taken is unknown: all that is not done is done here.
                        self.workers.clear()
                        break
                    done[place] = result, worker
            result, used = done.pop(number)
            yield result
            if used is not None:
                used.send(None)

    def _answered(self, timeout: int | None) -> list[Worker]:
        """Workers with an answer to read, or that have ended; waits for one, `timeout` ms."""
        poll, by_pipe = select.poll(), {worker.reads: worker for worker in self.workers}
        for pipe in by_pipe:
            poll.register(pipe, select.POLLIN)
        return [by_pipe[pipe] for pipe, _ in poll.poll(timeout)]


def processors() -> int:
    """How many processors this process may use."""
    # Only some systems tell, Linux among them; others have no workers anyway.
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else 1


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
                    worker = _fork(work, numbers)
                    stack.callback(worker.stop)
                    team.workers.append(worker)
        yield team


def _fork(work: Work[Any], numbers: Numbers) -> Worker:
    """A copy of this process that takes part."""
    with channel() as (ours, theirs):
        process = os.fork()
        if not process:
            try:
                # Only then does the channel end with the caller.  Copies made earlier have theirs
                # held open by this one, and end after it.
                ours.close()
                serve(theirs, lambda: take_part(theirs, work, numbers))
            finally:  # whatever happens, it must not go on as if it were this process
                os._exit(1)
    worker = Worker(ours, process)
    worker.keep_apart()
    return worker


def take_part(caller: Channel, work: Work[Any], numbers: Numbers) -> None:
    """In a worker: work on numbers until none is left."""
    for done in itertools.count():
        if done >= AHEAD:
            caller.receive()  # a result has been used
        number = numbers.take()
        if number is None:
            return
        caller.send((number, work(number)))


def serve(caller: Channel, work: Callable[[], None]) -> NoReturn:
    """Be a worker: `work`, and stay until the caller ends."""
    try:
        # Ctrl-C reaches all processes of a terminal: the one that calls decides what it means.
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        work()
        while True:
            caller.receive()
    except BaseException as error:
        caller.send(error)
    finally:
        os._exit(0)
