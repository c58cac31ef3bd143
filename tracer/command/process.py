"""A command as a process: how it starts, prints, is interrupted and ends.

Every command of this project starts by `run`, before anything that takes long is imported.
"""

from __future__ import annotations

import gc
import os
import signal
import sys
from collections.abc import Callable
from contextlib import nullcontext, suppress
from importlib import import_module
from typing import NoReturn, TextIO, TypeVar

from tracer.command.failure import Failure
from tracer.files import remove_part_files
from tracer.messages import printable

_Result = TypeVar("_Result")

FAILED, MISUSED, INTERRUPTED = 1, 2, 130
"""Exit statuses: something could not be done, wrong usage, ended by a signal."""

# Exit status when the reader of standard output has gone away: that of a program that SIGPIPE ends.
_UNREAD = 141


def run(module: str) -> NoReturn:
    """Run a command: import its module, call `main`, and exit with the status that it returns.

    A Failure, a missing package and a lack of memory are printed as one line instead of a
    traceback.  A signal that ends the command makes the exit status 130.  If the reader of standard
    output goes away, the command ends silently with status 141.

    Parameters
    ----------
    module : str
        Name of the module.  Its function `main` takes no arguments, and returns an exit status or
        None, which counts as 0.
    """
    end_on_signals()
    # No product of matrices here is worth OpenBLAS's threads; starting them would take as long as
    # rendering a small picture.  The variable is read when NumPy is imported.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    # Importing creates tens of thousands of objects, and none is garbage: collect it rarely.
    gc.set_threshold(50_000)
    status = FAILED
    try:
        result = attempt(import_module(module).main)
        status = result.status if isinstance(result, Failure) else result or 0
    except ModuleNotFoundError as error:
        package = (error.name or "numpy").partition(".")[0]
        package = {"PIL": "pillow", "skimage": "scikit-image"}.get(package, package)
        print_line(sys.stderr, f"{error}; install it with python -m pip install {package}")
        status = MISUSED  # in some commands 1 says that pictures differ
    except BrokenPipeError:
        status = _UNREAD
    except (ImportError, MemoryError, SystemError) as error:
        # NumPy's own message is a page of advice; the first cause names the library at fault.
        first_cause: BaseException = error
        while cause := first_cause.__cause__ or first_cause.__context__:
            first_cause = cause
        reason = str(first_cause).strip() or "not enough memory"
        remedy = "give it more memory, or install it again"
        print_line(sys.stderr, printable(f"the command cannot start: {reason}; {remedy}"))
    except SystemExit as error:
        status = error.code if isinstance(error.code, int) else FAILED
    # os._exit flushes nothing, and the status must show that a result could not be printed.
    for stream in (sys.stdout, sys.stderr):
        try:
            if stream is not None and not stream.closed:
                stream.flush()
        except OSError as error:
            status = status or (_UNREAD if isinstance(error, BrokenPipeError) else FAILED)
    # An orderly exit would destroy NumPy's modules one by one, and add a tenth to the time of a
    # small picture.
    os._exit(status)


def attempt(function: Callable[..., _Result], *arguments: object) -> _Result | Failure:
    """Call a function; if it raises a Failure, print it to standard error and return it.

    This is how a command processes many files: a failure of one does not keep the others from
    being processed.

    Parameters
    ----------
    function : callable
        Called with `arguments`.

    Returns
    -------
    result : object or Failure
        What the function returns, or the failure that it raised.
    """
    try:
        return function(*arguments)
    except Failure as failure:
        print_line(sys.stderr, str(failure))
        return failure


def print_line(stream: TextIO | None, text: str) -> None:
    """Print a notice as `print_result` does, but do nothing if it cannot be printed.

    A notice is less important than the result of the command, which must not fail for it.
    """
    with suppress(OSError):
        print_result(stream, text)


def print_result(stream: TextIO | None, text: str) -> None:
    """Print a line immediately, above a progress bar if one is shown.

    Parameters
    ----------
    stream : text file or None
        Standard output or standard error; None if it is closed.
    text : str
        The line.  Characters that the stream cannot encode are escaped.

    Raises
    ------
    OSError
        If the line cannot be printed: the stream is closed, or its disk is full.
    """
    if stream is None or stream.closed:
        raise OSError("it is closed")
    encoding, tqdm = stream.encoding or "utf-8", sys.modules.get("tqdm")
    try:
        with tqdm.tqdm.external_write_mode(stream) if tqdm else nullcontext():
            line = text.encode(encoding, "backslashreplace").decode(encoding)
            print(line, file=stream, flush=True)
    except OSError:
        # The text that remains in the stream's buffer would fail again at the end.
        with suppress(OSError):
            stream.close()
        raise


def end_on_signals() -> None:
    """Let signals end this process immediately, without part files, and without a message.

    Signals that are ignored stay ignored: in the background of a script, or under nohup.
    """
    for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT", "SIGXCPU"):
        number = getattr(signal, name, None)  # not all systems have the last three
        if number is not None and signal.getsignal(number) != signal.SIG_IGN:
            signal.signal(number, _end_now)


def _end_now(_number: int, _frame: object) -> NoReturn:
    """Handle a signal: remove part files, and end this process.

    A KeyboardInterrupt would be lost if it were raised in a finalizer or after a fork; raised in
    NumPy or in a plugin, it would be reported as an error of theirs.
    """
    remove_part_files()
    os._exit(INTERRUPTED)
