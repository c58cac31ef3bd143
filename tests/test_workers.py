"""Processes that take part: order, errors, and what is left of them."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from contextlib import AbstractContextManager, suppress
from itertools import islice
from pathlib import Path

import numpy as np
import pytest

import tracer.picture.helpers
from tracer.picture.workers import Channel, Numbers, Worker, forked

COUNT = 11


@pytest.fixture(autouse=True)
def no_helpers() -> None:
    """Whoever helped in other tests is no longer there."""
    tracer.picture.helpers._crew.stop()


def patiently(number: int) -> int:
    """Take longer for some, so that workers get out of step."""
    time.sleep(0.01 * (number % 3))
    return number


def children() -> int:
    """How many child processes this one has, finished ones included."""
    count = 0
    for stat in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError):
            count += int(stat.read_text().rpartition(")")[2].split()[1]) == os.getpid()
    return count


@pytest.mark.parametrize("others", [0, 1, 2, 20])
def test_results_in_order(others: int) -> None:
    with forked(patiently, COUNT, others) as team:
        assert list(team.results(patiently)) == list(range(COUNT))


def test_no_copies_beside_another_thread() -> None:
    """It may hold a lock, which nobody would release in a copy."""
    ends = threading.Event()
    thread = threading.Thread(target=ends.wait)
    thread.start()
    try:
        with forked(patiently, COUNT, 2) as team:
            assert not team.workers
            assert list(team.results(patiently)) == list(range(COUNT))
    finally:
        ends.set()
        thread.join()


@pytest.mark.parametrize("count", range(17))
def test_workers_for_whom_there_are_files(
    count: int, files_left: Callable[[int], AbstractContextManager[None]]
) -> None:
    with files_left(count), forked(patiently, COUNT, 3) as team:
        # That of the numbers, both of theirs, and four while they are made.
        assert len(team.workers) == min(3, max(0, count - 3) // 2)
        assert list(team.results(patiently)) == list(range(COUNT))
        del team


def test_workers_for_whom_there_are_processes(monkeypatch: pytest.MonkeyPatch) -> None:
    fork = os.fork

    def once() -> int:
        monkeypatch.setattr(os, "fork", never)
        return fork()

    def never() -> int:
        raise BlockingIOError("no more processes")

    monkeypatch.setattr(os, "fork", once)
    with forked(patiently, COUNT, 3) as team:
        assert len(team.workers) == children() == 1
        assert list(team.results(patiently)) == list(range(COUNT))
    assert children() == 0


def test_workers_keep_off_this_processor() -> None:
    with subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE) as process:
        Worker(Channel(-1, -1), process.pid).keep_apart()
        mine, its = os.sched_getaffinity(0), os.sched_getaffinity(process.pid)
        process.communicate(b"\n")
    assert its <= mine
    assert len(its) == max(1, len(mine) - 1)


def test_each_number_is_worked_on_once(tmp_path: Path) -> None:
    def work(number: int) -> int:
        (tmp_path / f"{number} {os.getpid()}").touch()
        return patiently(number)

    with forked(work, 30, 2) as team:
        assert sum(team.results(work)) == sum(range(30))
    done = [path.name.split() for path in tmp_path.iterdir()]
    assert sorted(int(number) for number, _ in done) == list(range(30))
    assert len({pid for _, pid in done}) == 3


def test_numbers_of_a_round_that_is_over() -> None:
    ours = Numbers()
    theirs = Numbers(ours.file)
    ours.begin(3)
    assert theirs.take() is None
    theirs.round = ours.round
    assert [ours.take(), theirs.take(), ours.take(), theirs.take()] == [0, 1, 2, None]
    ours.begin(1)
    assert [theirs.take(), ours.take(), ours.take()] == [None, 0, None]
    os.close(ours.file)


def test_results_larger_than_a_pipe_holds() -> None:
    def work(number: int) -> bytes:
        return bytes([number]) * 300_000

    with forked(work, COUNT, 2) as team:
        assert list(team.results(work)) == [work(number) for number in range(COUNT)]


@pytest.mark.parametrize("here", [True, False])
def test_an_error_is_raised_here(here: bool) -> None:
    process = os.getpid()

    def fails(number: int) -> int:
        if number > 3 and here == (os.getpid() == process):
            raise MemoryError("too little")
        return patiently(number)

    with pytest.raises(MemoryError, match="too little"), forked(fails, COUNT, 1) as team:
        list(team.results(fails))
    assert children() == 0


@pytest.mark.parametrize("others", [1, 3])
@pytest.mark.parametrize("first", [0, 4])
def test_what_a_killed_worker_had_taken_is_done_here(others: int, first: int) -> None:
    process = os.getpid()

    def dies(number: int) -> int:
        if number >= first and os.getpid() != process:
            os.kill(os.getpid(), signal.SIGKILL)
        return patiently(number)

    with forked(dies, COUNT, others) as team:
        assert list(team.results(dies)) == list(range(COUNT))
    assert children() == 0


def test_nothing_is_left_when_no_more_is_asked_for() -> None:
    with forked(patiently, COUNT, 2) as team:
        assert list(islice(team.results(patiently), 2)) == [0, 1]
        assert children() == 2
    assert children() == 0
    assert not np.any([Path(f"/proc/self/fd/{w.reads}").exists() for w in team.workers])
