"""A progress bar for any command, shown once the command's work has taken a second.

While a bar is shown, `tracer.command.process` prints lines above it.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator
from contextlib import suppress
from time import perf_counter
from typing import Any, TypeVar

_Item = TypeVar("_Item")

# Seconds of work after which a progress bar is shown.
_BAR_SECONDS = 1.0

_BAR_FORMAT = (
    "{percentage:3.0f}%|{bar}| {n:g} of {total} {unit} [{elapsed}, {remaining} left{postfix}]"
)


class Progress:
    """The progress of a command's work, with a bar on standard error if that is a terminal.

    Use it as a context manager, which removes the bar at the end.

    Parameters
    ----------
    total : int
        Amount of work, for example the number of pictures.
    unit : str
        What is counted, in the plural: "pictures".
    show : bool
        If False, no bar is ever shown.
    """

    def __init__(self, total: int, unit: str, *, show: bool = True) -> None:
        self._total, self._unit, self._start = total, unit, perf_counter()
        is_lost = sys.stderr is None or sys.stderr.closed
        # None: may be shown later; False: there can be no bar.
        self._bar: Any = None if show and not is_lost and sys.stderr.isatty() else False

    def __enter__(self) -> Progress:
        return self

    def __exit__(self, *_: object) -> None:
        if self._bar:
            self._bar.close()

    def update(self, done: float, note: str = "") -> None:
        """Update the progress, and show the bar if the work has taken a second.

        Parameters
        ----------
        done : float
            Amount of work that is done, in the unit of `total`.
        note : str
            Text beside the bar.
        """
        seconds = perf_counter() - self._start
        if self._bar is None and seconds >= _BAR_SECONDS:
            self._bar = self._new_bar(seconds)
        if self._bar:
            self._bar.set_postfix_str(note, refresh=False)
            self._bar.update(round(done, 2) - self._bar.n)

    def _new_bar(self, seconds: float) -> Any:
        """Create a progress bar.

        The work must not fail because tqdm is not installed, or because the environment has
        settings for tqdm that it cannot read.

        Parameters
        ----------
        seconds : float
            Time that the work has taken so far.

        Returns
        -------
        bar : tqdm.tqdm or False
            False if tqdm cannot be used.
        """
        with suppress(ImportError, ValueError):
            from tqdm import tqdm  # importing it takes longer than rendering a small picture

            tqdm.monitor_interval = 0  # otherwise tqdm starts a thread
            options = {"bar_format": _BAR_FORMAT, "leave": False, "smoothing": 0, "miniters": 0}
            bar = tqdm(total=self._total, unit=self._unit, **options)
            # The time left follows from all the time so far, and the first update is shown.
            bar.start_t = bar.last_print_t = bar.start_t - seconds
            return bar
        return False


def track(items: Iterable[_Item], total: int, unit: str) -> Iterator[_Item]:
    """Yield items unchanged, with a progress bar that counts them.

    Parameters
    ----------
    items : iterable
        The work; an item counts as done when the next one is requested.
    total : int
        Number of items.
    unit : str
        What the items are, in the plural: "scenes".
    """
    with Progress(total, unit) as progress:
        for count, item in enumerate(items, 1):
            yield item
            progress.update(count)
