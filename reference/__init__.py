"""The tracer measured, and held against others; a module with a `main` is a command."""

from __future__ import annotations

import sys
from types import TracebackType

from converters import need_command

__all__: list[str] = []


def _told(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
    """Show an uncaught exception, and end with 1; in a line, with 2, if a package is missing."""
    if not issubclass(kind, ImportError):
        sys.__excepthook__(kind, error, trace)
        return
    missing = issubclass(kind, ModuleNotFoundError)
    remedy = "; install it with pip install -e '.[reference]'" if missing else ""
    print(f"{error}{remedy}", file=sys.stderr)
    raise SystemExit(2)  # not 1, which says that pictures differ


# As a command: python -m has not yet found which module to run.  Who imports this package as a
# library keeps their own hook.
if sys.argv[:1] == ["-m"]:
    sys.excepthook = _told
    need_command()
