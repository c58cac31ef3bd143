"""Times of tasks that run in turns: a machine that is busy for a while slows down all alike."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass
from statistics import median
from time import perf_counter, sleep
from typing import TypeAlias, TypeVar

__all__ = ["Task", "Timing", "interleaved", "process"]

Task: TypeAlias = Callable[[], object]
"""Work to be timed."""

_Name = TypeVar("_Name", bound=Hashable)

# Seconds between tasks: threads of the one before, Mitsuba's above all, spin for some 10 ms.
_PAUSE = 0.02

# Short times vary most: a task goes on until its times add up to the first, in seconds, for at most
# the second times the rounds asked for.
_ENOUGH, _MORE = 0.5, 5


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
    tasks: dict[_Name, Task], rounds: int, *, enough: float = _ENOUGH
) -> dict[_Name, Timing]:
    """Time tasks in turns, each after a run to warm up: a round runs each once, after a pause."""
    for task in tasks.values():
        task()
    taken: dict[_Name, list[float]] = {name: [] for name in tasks}
    for number in range(_MORE * rounds):
        for name, task in tasks.items():
            if number < rounds or sum(taken[name]) < enough:
                sleep(_PAUSE)
                start = perf_counter()
                task()
                taken[name].append(perf_counter() - start)
    return {name: Timing.of(spent) for name, spent in taken.items()}


def process(command: Sequence[str]) -> Task:
    """Run a process in silence; raises if it fails.

    Python may keep what it compiles: the first run compiles the modules, and no other has to.
    """
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}
    return lambda: subprocess.run(command, check=True, capture_output=True, env=environment)
