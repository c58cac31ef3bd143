"""The exception for everything that a command cannot do, whatever the cause.

A command fails on a file that is missing, a disk that is full, a scene that is too large: causes
outside the program, of which the user needs one line.  `errors_as_failure` turns an exception into
a `Failure` where it arises, because only that place knows which file was in use, and for what.
`tracer.command.process` prints every failure, and ends the command with its exit status.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager

from tracer.messages import printable


class Failure(Exception):  # noqa: N818
    """A task that failed; its text is the line for the user, ``where: what; remedy``.

    Parameters
    ----------
    where : str
        The file or stream concerned.  May be empty: then the line is ``what; remedy``.
    what : str
        What failed and why, for example "cannot be written: No space left on device".
    remedy : str
        What the user can do about it.  May be empty.
    status : int
        Exit status of a command that fails only because of this.
    """

    def __init__(self, where: str, what: str, remedy: str = "", status: int = 1) -> None:
        super().__init__(where, what, remedy, status)  # so that it can be pickled
        self.where, self.what, self.remedy, self.status = where, what, remedy, status

    def __str__(self) -> str:
        text = f"{printable(self.where)}: {self.what}" if self.where else self.what
        return f"{text}; {self.remedy}" if self.remedy else text


@contextmanager
def errors_as_failure(
    where: str | os.PathLike[str],
    action: str,
    remedy: str = "",
    *,
    memory_remedy: str = "make the image smaller",
    status: int = 1,
    errors: tuple[type[BaseException], ...] = (),
) -> Iterator[None]:
    """Raise a Failure in place of any error that a with block raises for a cause outside of it.

    The failure's text is ``where: cannot be ACTION: reason; remedy``.  For a SceneFileError, which
    has a complete line for each error in the scene, it is the text of the SceneFileError.

    Parameters
    ----------
    where : str or path-like
        The file or stream that the block uses.
    action : str
        The participle of what the block does with it: "read", "written", "compared".
    remedy : str
        What the user can do about it, for example "choose another with -o".
    memory_remedy : str
        Replaces `remedy` if there is not enough memory.
    status : int
        Exit status of a command that fails only because of this.
    errors : tuple of exception classes
        Classes to convert in addition to OSError, MemoryError and SceneFileError.

    Raises
    ------
    Failure
        In place of an error of these classes.  A Failure from inside the block is passed on, and
        so is a BrokenPipeError: the command must end silently when its reader has gone away.
    """
    try:
        yield
    except Exception as error:
        # Not imported at the top: a command must begin before NumPy is imported.
        from tracer.scene.reader import SceneFileError

        if isinstance(error, SceneFileError):
            raise Failure("", str(error), status=status) from error
        is_passed = isinstance(error, (Failure, BrokenPipeError))
        if is_passed or not isinstance(error, (OSError, MemoryError, *errors)):
            raise
        if is_lack_of_memory(error):
            remedy = memory_remedy
        what = f"cannot be {action}: {reason_of(error)}"
        raise Failure(os.fspath(where), what, remedy, status) from error


def is_lack_of_memory(error: BaseException) -> bool:
    """Test whether an error means that there was not enough memory.

    A ChildProcessError counts, because the system ends processes that take too much memory.
    """
    return isinstance(_root_cause(error), (MemoryError, ChildProcessError))


def reason_of(error: BaseException) -> str:
    """Return the reason for an error in a few words, on one line that any terminal can show."""
    if is_lack_of_memory(error):
        return "not enough memory"
    error = _root_cause(error)
    text = (isinstance(error, OSError) and error.strerror) or " ".join(str(error).split())
    return printable(text or type(error).__name__)


def _root_cause(error: BaseException) -> BaseException:
    """Return the error from which a chain of RuntimeErrors was raised, as Dr.Jit does."""
    while isinstance(error, RuntimeError) and error.__cause__ is not None:
        error = error.__cause__
    return error
