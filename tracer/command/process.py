"""Start, interrupt and end the process of a command, and print its lines.

Every command of this project calls `run` first, before its other imports.  Importing NumPy and the
rest takes longer than rendering a small picture, and may fail: `run` must already handle Ctrl-C,
limit the threads that NumPy starts, and report a missing package in one line.  A module that is
executed as a command has the name ``__main__``, so it passes ``__spec__.name``: `run` imports it
again under its own name, and its classes can be pickled.
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

from tracer.children import terminate_children
from tracer.command.failure import Failure
from tracer.files import remove_part_files
from tracer.messages import make_printable

_Result = TypeVar("_Result")

FAILED, MISUSED, INTERRUPTED = 1, 2, 130
"""Exit statuses: a task failed, the usage was wrong, or a signal ended the command."""

# Exit status when nobody reads a result on standard output: that of a program that SIGPIPE ends.
_UNREAD = 141


def run(module_name: str) -> NoReturn:
    """Run a command: import its module, call its function `main`, and end this process.

    The exit status is the one that `main` returns or passes to `sys.exit`, except in these cases:

    - the status of the Failure, if `main` raises one;
    - 1 if there is not enough memory, or standard output cannot be written;
    - 2 if a package is missing;
    - 130 if a signal ends the command;
    - 141 if nobody reads a result that it writes to standard output (a notice may be lost).

    A Failure, a missing package or a lack of memory is reported in one line, without a traceback.
    """
    end_on_signals()
    # Starting the threads of OpenBLAS would take as long as rendering a small picture.  NumPy reads
    # the variable when it is imported.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    # Collect garbage rarely: importing creates tens of thousands of objects, but no garbage.
    gc.set_threshold(50_000)
    exit_status = FAILED
    try:
        result = attempt(import_module(module_name).main)
        exit_status = result.exit_status if isinstance(result, Failure) else result or 0
    except ModuleNotFoundError as error:
        package = (error.name or "numpy").partition(".")[0]
        package = {"PIL": "pillow", "skimage": "scikit-image"}.get(package, package)
        print_line(sys.stderr, f"{error}; install it with python -m pip install {package}")
        exit_status = MISUSED  # in some commands, status 1 means that pictures differ
    except BrokenPipeError:
        exit_status = _UNREAD
    except (ImportError, MemoryError, SystemError) as error:
        # NumPy's own message is a page of advice, but the first cause names the library at fault.
        first_cause: BaseException = error
        while cause := first_cause.__cause__ or first_cause.__context__:
            first_cause = cause
        reason = str(first_cause).strip() or "not enough memory"
        remedy = "give it more memory, or install it again"
        print_line(sys.stderr, make_printable(f"the command cannot start: {reason}; {remedy}"))
    except SystemExit as error:
        exit_status = error.code if isinstance(error.code, int) else FAILED
    # Flush the streams here, because os._exit does not, and an error must change the exit status.
    for stream in (sys.stdout, sys.stderr):
        try:
            if stream is not None and not stream.closed:
                stream.flush()
        except OSError as error:
            exit_status = exit_status or (_UNREAD if isinstance(error, BrokenPipeError) else FAILED)
    # An orderly exit would destroy NumPy's modules one by one, which takes a tenth as long as
    # rendering a small picture.
    os._exit(exit_status)


def attempt(function: Callable[..., _Result], *arguments: object) -> _Result | Failure:
    """Call a function; if it raises a Failure, print the failure to standard error and return it.

    A command that processes many files calls this for each file, so that it continues after a
    failure.
    """
    try:
        return function(*arguments)
    except Failure as failure:
        print_line(sys.stderr, str(failure))
        return failure


def print_line(stream: TextIO | None, text: str) -> None:
    """Print a line immediately, above the progress bar if one is shown, and ignore errors.

    Use this for notices: a command must not fail because a notice cannot be printed.
    """
    with suppress(OSError):
        print_or_raise(stream, text)


def print_or_raise(stream: TextIO | None, text: str) -> None:
    """Print a line immediately, above the progress bar if one is shown.

    Characters that the stream cannot encode are escaped.  If the line cannot be printed, for
    example because the disk is full, the stream is closed and OSError is raised.

    The stream is None if Python started without it.
    """
    if stream is None or stream.closed:
        raise OSError("it is closed")
    encoding = stream.encoding or "utf-8"
    tqdm = sys.modules.get("tqdm")  # without it, no bar is shown
    try:
        with tqdm.tqdm.external_write_mode(stream) if tqdm else nullcontext():
            printable_line = text.encode(encoding, "backslashreplace").decode(encoding)
            print(printable_line, file=stream, flush=True)
    except OSError:
        # Discard the buffer of the stream: printing it at the end would raise the error again.
        with suppress(OSError):
            stream.close()
        raise


def end_on_signals() -> None:
    """Install signal handlers that end this process immediately, without a message.

    When a signal arrives, this process ends its workers, removes its part files (see
    `tracer.files`), and ends with exit status 130.  A signal that is already ignored, for example
    under nohup, stays ignored.
    """
    for signal_name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT", "SIGXCPU"):
        signal_number = getattr(signal, signal_name, None)  # not all systems have the last three
        if signal_number is not None and signal.getsignal(signal_number) != signal.SIG_IGN:
            signal.signal(signal_number, _handle_signal)


def _handle_signal(_signal_number: int, _frame: object) -> NoReturn:
    # Do not raise KeyboardInterrupt: it would be lost in a finalizer or after a fork, and NumPy or
    # a plugin might turn it into a different error.
    terminate_children()
    remove_part_files()
    os._exit(INTERRUPTED)
