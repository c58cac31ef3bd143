"""Jobs for helpers, which must find and import them quickly."""

from __future__ import annotations

import os
import time
from contextlib import suppress
from pathlib import Path

import numpy as np

from tracer.arrays import Floats
from tracer.picture.helpers import Fill
from tracer.picture.workers import AHEAD, Work

SHAPE = (AHEAD, 2, 3)


def add(amount: float) -> Fill:
    """A job: arrays that say which number they are of, and which process made them."""

    def fill(number: int, slot: Floats) -> None:
        time.sleep(0.005)
        slot[:] = number + amount, os.getpid(), 0

    return fill


def here(fill: Fill) -> Work[Floats]:
    """The same, into new memory."""

    def work(number: int) -> Floats:
        slot = np.empty(SHAPE[1:])
        fill(number, slot)
        return slot

    return work


def fail() -> Fill:
    """A job that cannot be done."""

    def fill(_number: int, _slot: Floats) -> None:
        raise MemoryError("too little")

    return fill


def refuse() -> Fill:
    """A job that cannot be begun."""
    raise MemoryError("too little")


def die(first: int, path: Path) -> Fill:
    """A job, as `add(0)`, that ends one helper: whose is a number from the first on."""
    fill = add(0)

    def dies(number: int, slot: Floats) -> None:
        with suppress(FileExistsError):
            if number >= first:
                path.touch(exist_ok=False)
                os._exit(1)
        fill(number, slot)

    return dies
