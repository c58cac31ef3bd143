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

import tracer.rendering
from tracer import PointLight, Scene, Sphere, Surfaces
from tracer.memory import resident, shared
from tracer.scene import Floats
from tracer.workers import forked

COUNT = 11
LIGHTS = [PointLight(position=(1, 2, 3)), PointLight(position=(3, 2, 1))]


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


@pytest.mark.parametrize("workers", [1, 2, 3, 20])
@pytest.mark.parametrize("ahead", [1, 2, COUNT])
def test_results_in_order(workers: int, ahead: int) -> None:
    def work(number: int) -> Floats:
        return np.full((1 + patiently(number) % 4, 3), float(number))

    slots = shared((workers - 1, ahead, 4, 3))
    count = 0
    for number, result in enumerate(forked(work, COUNT, workers, slots)):
        # Not yet overwritten by one that comes later.
        assert np.array_equal(result, work(number))
        count += 1
    assert count == COUNT


def test_results_larger_than_a_pipe_holds() -> None:
    def work(number: int) -> bytes:
        return bytes([number]) * 300_000

    assert list(forked(work, COUNT, 3)) == [work(number) for number in range(COUNT)]


@pytest.mark.parametrize("failing", [4, 5])
def test_an_error_is_raised_here(failing: int) -> None:
    def fails(number: int) -> int:
        if number == failing:
            raise MemoryError("too little")
        return patiently(number)

    with pytest.raises(MemoryError, match="too little"):
        list(forked(fails, COUNT, 2))
    assert children() == 0


def test_a_killed_worker_is_reported() -> None:
    def dies(number: int) -> int:
        if number == 3:
            os.kill(os.getpid(), signal.SIGKILL)
        return patiently(number)

    with pytest.raises(ChildProcessError, match="a worker was killed"):
        list(forked(dies, COUNT, 2))
    assert children() == 0


def test_nothing_is_left_when_no_more_is_asked_for() -> None:
    numbers = forked(patiently, COUNT, 3)
    assert list(islice(numbers, 2)) == [0, 1]
    assert children() == 2
    numbers.close()
    assert children() == 0


@pytest.mark.parametrize(("memory", "workers"), [(0, 2), (1 << 30, 2), (1 << 40, 1)])
def test_memory_in_use_speaks_against_forking(
    memory: int, workers: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = Scene(width=4000, height=2000, surfaces=Surfaces.of([Sphere()]), lights=LIGHTS)
    monkeypatch.setattr(tracer.rendering, "can_fork", lambda: True)
    monkeypatch.setattr(tracer.rendering, "resident", lambda: memory)
    bands = tracer.rendering._Bands.of(scene, 1, None, (0.0, 0.0), 1 << 16)
    assert bands.workers == workers


def test_memory_in_use() -> None:
    before = resident()
    more = np.ones(1 << 24)
    assert resident() - before > 0.9 * more.nbytes
