"""Show a progress bar for any command whose work takes longer than a second.

While a bar is shown, `tracer.command.process` prints lines above it.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterable, Iterator
from contextlib import suppress
from time import perf_counter
from typing import Any, TypeVar

_Item = TypeVar("_Item")

# Seconds of work before a progress bar is shown.
_SECONDS_BEFORE_BAR = 1.0

# Width of the bar, in characters, on a terminal that does not know its own: a serial line, or the
# terminal of some containers and editors, which report a width of 0.
_DEFAULT_WIDTH = 80

_BAR_FORMAT = (
    "{percentage:3.0f}%|{bar}| {n:g} of {total} {unit} [{elapsed}, {remaining} left{postfix}]"
)


class Progress:
    """The progress of a command, shown as a bar on standard error if that is a terminal.

    The bar appears at the first update after a second of work.  Use the instance as a context
    manager, which removes the bar at the end.

    Parameters
    ----------
    total
        Amount of work.
    unit
        What is counted, as a noun in the plural: for example "pictures".
    show
        False if no bar is wanted.
    """

    _bar: Any  # a bar of tqdm; None if none has been created
    _may_create_bar: bool

    def __init__(self, total: int, unit: str, *, show: bool = True) -> None:
        self._total = total
        self._unit = unit
        self._start_time = perf_counter()
        is_closed = sys.stderr is None or sys.stderr.closed
        self._bar = None
        self._may_create_bar = show and not is_closed and sys.stderr.isatty()

    def __enter__(self) -> Progress:
        return self

    def __exit__(self, *_: object) -> None:
        if self._bar is not None:
            self._bar.close()

    def update(self, finished_work: float, note: str = "") -> None:
        """Show how much of `total` has been done so far, and a note beside the bar."""
        seconds = perf_counter() - self._start_time
        if self._may_create_bar and seconds >= _SECONDS_BEFORE_BAR:
            self._may_create_bar = False
            self._bar = self._create_bar(seconds)
        if self._bar is not None:
            self._bar.set_postfix_str(note, refresh=False)
            self._bar.update(round(finished_work, 2) - self._bar.n)

    def _create_bar(self, seconds: float) -> Any:
        """Create a tqdm progress bar for work that began some seconds ago.

        Return None if tqdm is not installed, or its environment variables are invalid.
        """
        with suppress(ImportError, ValueError):
            from tqdm import tqdm  # importing it takes longer than rendering a small picture

            tqdm.monitor_interval = 0  # otherwise tqdm starts a thread
            options = {"bar_format": _BAR_FORMAT, "leave": False, "smoothing": 0, "miniters": 0}
            # If the terminal states its width, tqdm finds the width itself.
            width = None if _get_terminal_width() else _DEFAULT_WIDTH
            bar = tqdm(total=self._total, unit=self._unit, ncols=width, **options)
            # Count the elapsed time from the start of the work, and show the next update at once.
            bar.start_t = bar.last_print_t = bar.start_t - seconds
            return bar
        return None


def _get_terminal_width() -> int:
    """Return the number of columns of the terminal on standard error, or 0 if it is unknown."""
    with suppress(OSError, ValueError):  # not a terminal, or it has no file descriptor
        return os.get_terminal_size(sys.stderr.fileno()).columns
    return 0


def format_pixel_count(count: int) -> str:
    """Format a number of pixels as text such as "11,520 pixels" or "1.2 million pixels"."""
    return f"{count / 1e6:,.1f} million pixels" if count >= 1_000_000 else f"{count:,} pixels"


def track(items: Iterable[_Item], total: int, unit: str) -> Iterator[_Item]:
    """Yield items, and show a progress bar if processing them takes longer than a second.

    An item counts as finished when the next one is requested.  `total` is the number of items, and
    `unit` is the noun for them in the plural.
    """
    with Progress(total, unit) as progress:
        for finished_count, item in enumerate(items, 1):
            yield item
            progress.update(finished_count)
