"""Conversion of scenes to Mitsuba 3, and comparison of the tracer with it."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

__all__ = ["need_command"]


def need_command() -> None:
    """End with status 2 where `python -m` is asked for a module that is no command.

    To be called by a package that is imported on the way: Python would run the module in silence.
    """
    if sys.argv[:1] != ["-m"]:  # which it is until the module is found
        return
    name = sys.orig_argv[-len(sys.argv)].removeprefix("-m")
    spec = importlib.util.find_spec(name)
    if spec is None or not spec.origin or spec.submodule_search_locations:
        return
    if '__name__ == "__main__"' not in Path(spec.origin).read_text(encoding="utf-8"):
        print(f"{name} is no command; it is only imported by others", file=sys.stderr)
        raise SystemExit(2)


need_command()
