"""The tracer measured, and held against others; a module with a `main` is a command."""

from __future__ import annotations

import sys
from types import TracebackType

__all__: list[str] = []


def _told(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
    """Show an uncaught exception: in a line, if a package is not installed."""
    if issubclass(kind, ModuleNotFoundError):
        print(f"{error}; install it with pip install -e '.[reference]'", file=sys.stderr)
    else:
        sys.__excepthook__(kind, error, trace)


# As a command: python -m has not yet found which module to run.  Who imports this package as a
# library keeps their own hook.
if sys.argv[:1] == ["-m"]:
    sys.excepthook = _told
