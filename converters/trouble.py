"""Errors that keep one scene from being converted or rendered, reported while others go on."""

from __future__ import annotations

import os

from tracer import SceneFileError
from tracer.commands import printable

__all__ = ["TROUBLE", "told"]

TROUBLE = (ChildProcessError, ImportError, MemoryError, RuntimeError, ValueError)
"""What the reader, the tracer, the converter and Mitsuba raise over a scene."""


def told(path: str | os.PathLike[str], error: BaseException) -> str:
    """What is wrong with the scene file at `path`: a line, or one for each fault in it."""
    if isinstance(error, SceneFileError):
        return str(error)
    # Of what fails while it renders, drjit says only that it does.
    while isinstance(error, RuntimeError) and error.__cause__ is not None:
        error = error.__cause__
    if isinstance(error, (ChildProcessError, MemoryError)):  # the system kills who takes too much
        reason = "not enough memory; make the image smaller"
    else:
        reason = " ".join(str(error).split()) or type(error).__name__
    return printable(f"{os.fspath(path)}: {reason}")
