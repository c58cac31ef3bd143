"""The exception for a task that fails for a reason outside the program.

Examples are a missing file, a full disk, and a scene that is too large.  The user needs one line
about such a reason, and no traceback.  `errors_as_failure` converts an exception to a `Failure`
where it arises, because only that place knows which file was in use, and for what.
`tracer.command.process` prints every failure, and ends the command with its exit status.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager

from tracer.messages import make_printable

_NO_MEMORY = "not enough memory"


class Failure(Exception):  # noqa: N818
    """The failure of a task.  Its `str` is the line for the user: ``SUBJECT: PROBLEM; REMEDY``."""

    subject: str  # name of the file, folder or stream concerned; may be empty
    problem: str  # what went wrong, such as "cannot be written: No space left on device"
    remedy: str  # what the user can do; may be empty
    exit_status: int  # exit status of the command if this is its only failure

    def __init__(self, subject: str, problem: str, remedy: str = "", exit_status: int = 1) -> None:
        super().__init__(subject, problem, remedy, exit_status)  # so that it can be pickled
        self.subject = subject
        self.problem = problem
        self.remedy = remedy
        self.exit_status = exit_status

    def __str__(self) -> str:
        text = f"{make_printable(self.subject)}: {self.problem}" if self.subject else self.problem
        return f"{text}; {self.remedy}" if self.remedy else text


@contextmanager
def errors_as_failure(
    subject: str | os.PathLike[str],
    participle: str,
    remedy: str = "",
    *,
    memory_remedy: str = "make the image smaller",
    exit_status: int = 1,
    error_types: tuple[type[BaseException], ...] = (),
) -> Iterator[None]:
    """Convert errors in a with block to a Failure if their cause is outside the program.

    The text of the failure is ``SUBJECT: cannot be PARTICIPLE: reason; REMEDY``.  The text of a
    SceneFileError is kept, because it contains a complete line for each error in the scene.  A
    BrokenPipeError is not converted, because a command must end silently when nobody reads its
    output.

    Parameters
    ----------
    subject
        Name of the file, folder or stream that the block uses.
    participle
        What the block does to the subject: for example "written".
    remedy
        What the user can do.
    memory_remedy
        What the user can do if there is not enough memory; replaces `remedy`.
    exit_status
        Exit status of the command if this is its only failure.
    error_types
        Classes of errors to convert, in addition to OSError, MemoryError and SceneFileError.
    """
    try:
        yield
    except Exception as error:
        # Not imported at the top, because a command must begin before NumPy is imported.
        from tracer.scene.reader import SceneFileError

        if isinstance(error, SceneFileError):
            raise Failure("", str(error), exit_status=exit_status) from error
        is_exempt = isinstance(error, (Failure, BrokenPipeError))
        if is_exempt or not isinstance(error, (OSError, MemoryError, *error_types)):
            raise
        reason = describe_cause(error)
        remedy = memory_remedy if reason == _NO_MEMORY else remedy
        problem = f"cannot be {participle}: {reason}"
        raise Failure(os.fspath(subject), problem, remedy, exit_status) from error


def describe_cause(error: BaseException) -> str:
    """Describe the cause of an error in one line, for example "No such file or directory".

    For a MemoryError or ChildProcessError, the line is "not enough memory".  For any other OSError,
    it is the system's message, if there is one.  Otherwise, it is the text of the error, or the
    name of its class if there is no text.  Unprintable characters are escaped.
    """
    # Dr.Jit raises chains of RuntimeErrors: only the first error in a chain states the cause.
    while isinstance(error, RuntimeError) and error.__cause__ is not None:
        error = error.__cause__
    # The system ends child processes that take too much memory.
    if isinstance(error, (MemoryError, ChildProcessError)):
        return _NO_MEMORY
    text = (isinstance(error, OSError) and error.strerror) or " ".join(str(error).split())
    return make_printable(text or type(error).__name__)
