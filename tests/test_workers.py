"""Forked workers: order, errors, and what is left when the reader stops early."""

from __future__ import annotations

import os
import signal
import time
from contextlib import suppress
from itertools import islice
from pathlib import Path

import pytest

from tracer.workers import forked, shared

COUNT = 11


def patiently(number: int) -> None:
    """Take longer for some, so that workers get out of step."""
    time.sleep(0.01 * (number % 3))


def children() -> int:
    """How many child processes this one has, finished ones included."""
    count = 0
    for stat in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError):
            count += int(stat.read_text().rpartition(")")[2].split()[1]) == os.getpid()
    return count


@pytest.mark.parametrize("workers", [1, 2, 3, 20])
@pytest.mark.parametrize("ahead", [1, 2, COUNT])
def test_results_in_order(workers: int, ahead: int) -> None:
    slots = shared((workers * ahead, 3))

    def work(number: int) -> None:
        patiently(number)
        slots[number % len(slots)] = number

    numbers = []
    for number in forked(work, COUNT, workers, ahead):
        numbers.append(number)
        # Not yet overwritten by one that comes later.
        assert (slots[number % len(slots)] == number).all()
    assert numbers == list(range(COUNT))


def test_an_error_is_raised_here() -> None:
    def fails(number: int) -> None:
        if number == 4:
            raise MemoryError("too little")
        patiently(number)

    with pytest.raises(MemoryError, match="too little"):
        list(forked(fails, COUNT, 2, 2))
    assert children() == 0


def test_a_killed_worker_is_reported() -> None:
    def dies(number: int) -> None:
        if number == 3:
            os.kill(os.getpid(), signal.SIGKILL)
        patiently(number)

    with pytest.raises(ChildProcessError, match="a worker was killed"):
        list(forked(dies, COUNT, 2, 2))
    assert children() == 0


def test_nothing_is_left_when_no_more_is_asked_for() -> None:
    numbers = forked(patiently, COUNT, 3, 2)
    assert list(islice(numbers, 2)) == [0, 1]
    assert children() == 3
    numbers.close()
    assert children() == 0
