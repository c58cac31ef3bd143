"""Forked workers: order, errors, and what is left when the reader stops early."""

from __future__ import annotations

import os
import signal
import time
from contextlib import suppress
from itertools import islice
from pathlib import Path

import numpy as np
import pytest

from tracer.workers import forked

SHAPES = [(3 + i % 2, 5) for i in range(11)]


def numbered(number: int) -> np.ndarray:
    """Slower for some, so that workers get out of step."""
    time.sleep(0.01 * (number % 3))
    return np.full(SHAPES[number], float(number))


def children() -> int:
    """How many child processes this one has, finished ones included."""
    count = 0
    for stat in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError):
            count += int(stat.read_text().rpartition(")")[2].split()[1]) == os.getpid()
    return count


@pytest.mark.parametrize("workers", [1, 2, 3, 20])
def test_results_in_order(workers: int) -> None:
    results = list(forked(numbered, SHAPES, workers))
    assert [r.shape for r in results] == SHAPES
    for number, result in enumerate(results):
        assert (result == number).all()


def test_an_error_is_raised_here() -> None:
    def fails(number: int) -> np.ndarray:
        if number == 4:
            raise MemoryError("too little")
        return numbered(number)

    with pytest.raises(MemoryError, match="too little"):
        list(forked(fails, SHAPES, 2))
    assert children() == 0


def test_a_killed_worker_is_reported() -> None:
    def dies(number: int) -> np.ndarray:
        if number == 3:
            os.kill(os.getpid(), signal.SIGKILL)
        return numbered(number)

    with pytest.raises(ChildProcessError, match="a worker was killed"):
        list(forked(dies, SHAPES, 2))
    assert children() == 0


def test_nothing_is_left_when_no_more_is_asked_for() -> None:
    results = forked(numbered, SHAPES, 3)
    assert len(list(islice(results, 2))) == 2
    assert children() == 3
    results.close()
    assert children() == 0
