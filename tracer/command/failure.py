"""The exception for a task that fails for a reason outside the program.

Examples are a missing file, a full disk, and a scene that is too large.  The user needs one line
about such a reason.  `errors_as_failure` turns an exception into a `Failure` where it arises,
because only that place knows which file was in use, and for what.  `tracer.command.process` prints
every failure, and ends the command with the failure's exit status.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager

from tracer.messages import make_printable

_NO_MEMORY = "not enough memory"


class Failure(Exception):  # noqa: N818
    """The failure of a task.  ``str(failure)`` is the line for the user: ``where: what; remedy``.

    Parameters
    ----------
    where : str
        The file or stream concerned.  If empty, the line is ``what; remedy``.
    what : str
        What failed and why, for example "cannot be written: No space left on device".
    remedy : str
        What the user can do about the failure.  If empty, the line is ``where: what``.
    exit_status : int
        Exit status of a command that fails only for this reason.
    """

    def __init__(self, where: str, what: str, remedy: str = "", exit_status: int = 1) -> None:
        super().__init__(where, what, remedy, exit_status)  # so that it can be pickled
        self.where, self.what, self.remedy, self.exit_status = where, what, remedy, exit_status

    def __str__(self) -> str:
        text = f"{make_printable(self.where)}: {self.what}" if self.where else self.what
        return f"{text}; {self.remedy}" if self.remedy else text


@contextmanager
def errors_as_failure(
    where: str | os.PathLike[str],
    participle: str,
    remedy: str = "",
    *,
    memory_remedy: str = "make the image smaller",
    exit_status: int = 1,
    error_types: tuple[type[BaseException], ...] = (),
) -> Iterator[None]:
    """Convert errors in a with block to a Failure if their cause is outside the program.

    The text of the failure is ``WHERE: cannot be PARTICIPLE: reason; REMEDY``.  The text of a
    SceneFileError is kept, because it contains a complete line for each error in the scene.

    Parameters
    ----------
    where : str or path-like
        The file or stream that the block uses.
    participle : str
        What the block does with the file, for example "read", "written" or "compared".
    remedy : str
        What the user can do about the failure, for example "choose another with -o".
    memory_remedy : str
        Replaces `remedy` if the error is a lack of memory.
    exit_status : int
        Exit status of a command that fails only for this reason.
    error_types : tuple of exception classes
        Classes of errors to convert in addition to OSError, MemoryError and SceneFileError.

    Raises
    ------
    Failure
        If the block raises an error of these classes, or a Failure, which is passed on unchanged.
    BrokenPipeError
        If the block raises it.  It is not converted, because a command must end silently when the
        reader of its output has gone away.
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
        what = f"cannot be {participle}: {reason}"
        raise Failure(os.fspath(where), what, remedy, exit_status) from error


def describe_cause(error: BaseException) -> str:
    """Describe the cause of an error in one line, for example "No such file or directory".

    For a RuntimeError that was raised from another error, that error is described.  For a
    MemoryError, or a ChildProcessError (because the system ends processes that take too much
    memory), the line is "not enough memory".  For any other OSError, it is the system's message.
    Otherwise, it is the text of the error, or the name of its class if the text is empty.
    Unprintable characters are escaped.
    """
    # Dr.Jit raises chains of RuntimeErrors.
    while isinstance(error, RuntimeError) and error.__cause__ is not None:
        error = error.__cause__
    if isinstance(error, (MemoryError, ChildProcessError)):
        return _NO_MEMORY
    text = (isinstance(error, OSError) and error.strerror) or " ".join(str(error).split())
    return make_printable(text or type(error).__name__)
