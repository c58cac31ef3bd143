"""Jobs for worker processes, which must find and import them."""

from __future__ import annotations

import os
import time
from mmap import mmap
from pathlib import Path

import numpy as np

from tracer.picture.parallel import Work

PARTS = 1000
"""The most parts that a job here has."""

SIZE = 8 * PARTS
"""Bytes of shared memory that it needs."""


def signing(memory: mmap) -> Work:
    """Take a while for each part, and write down which process does it."""

    def work(number: int) -> None:
        time.sleep(0.004 + 0.002 * (number % 3))  # workers get out of step
        np.frombuffer(memory, np.int64, PARTS)[number] = os.getpid()

    return work


def failing(memory: mmap) -> Work:
    """Do no part, but wait a moment for the others to begin."""
    del memory

    def work(_number: int) -> None:
        time.sleep(0.01)
        raise MemoryError("too little")

    return work


def refusing(memory: mmap) -> Work:
    """Not even begin."""
    raise MemoryError("too little")


def dying(first: int, path: Path, memory: mmap) -> Work:
    """Sign, but end the process of one part, the first that is `first` or later."""
    sign = signing(memory)

    def work(number: int) -> None:
        if number >= first and not path.exists():
            path.touch()
            os._exit(1)
        sign(number)

    return work
