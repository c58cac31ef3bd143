"""Timing in turns: a machine that is busy for a while slows down all alike."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass
from statistics import median
from time import perf_counter, sleep
from typing import TypeAlias, TypeVar

from reference.workloads import afresh
from tracer import Scene

__all__ = ["Task", "Timing", "interleaved", "on_copies", "process"]

Task: TypeAlias = Callable[[int], object]
"""Work to be timed, told which round it is."""

_Name = TypeVar("_Name", bound=Hashable)

# Seconds between tasks: threads of the one before, Mitsuba's above all, spin for some 10 ms.
_PAUSE = 0.02


@dataclass(frozen=True, slots=True)
class Timing:
    """Seconds over some rounds."""

    median: float
    low: float
    high: float

    @classmethod
    def of(cls, seconds: Sequence[float]) -> Timing:
        """Sum up what was measured."""
        return cls(median(seconds), min(seconds), max(seconds))

    def __str__(self) -> str:
        if self.low == self.high:
            return _ms(self.median)
        return f"{_ms(self.median)} ({_ms(self.low)}–{_ms(self.high)})"


def _ms(seconds: float) -> str:
    ms = 1e3 * seconds
    return f"{ms:,.0f}" if ms >= 100 else f"{ms:.1f}"


def interleaved(
    tasks: dict[_Name, Task], rounds: int, *, most: int = 0, seconds: float = 0.0
) -> dict[_Name, Timing]:
    """Time tasks in turns: a round runs each once, after a pause.

    Tasks that took less than `seconds` in these rounds go on until they have, for `most` rounds
    in all.
    """
    taken: dict[_Name, list[float]] = {name: [] for name in tasks}
    for k in range(max(rounds, most)):
        for name, task in tasks.items():
            if k < rounds or sum(taken[name]) < seconds:
                sleep(_PAUSE)
                start = perf_counter()
                task(k)
                taken[name].append(perf_counter() - start)
    return {name: Timing.of(spent) for name, spent in taken.items()}


def on_copies(picture: Callable[[Scene], object], scene: Scene, rounds: int) -> Task:
    """Render a fresh copy of a scene in each round: nothing can be left from the one before.

    The copy for round 0 looks the same as the scene; round -1, to warm up, has one of its own.
    """
    copies = [afresh(scene, k) for k in range(rounds + 1)]
    return lambda k: picture(copies[k])


def process(command: Sequence[str]) -> Task:
    """Run a process in silence, whatever the round; raises if it fails.

    Python may keep what it compiles, as it does unless told otherwise: the first run compiles the
    modules, and no other has to.
    """
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}
    return lambda _: subprocess.run(command, check=True, capture_output=True, env=environment)
