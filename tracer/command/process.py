"""Start, interrupt and end the process of a command, and print its lines.

Every command of this project calls `run` first, before its other imports.  Importing NumPy and the
rest takes longer than rendering a small picture, and may fail.  During this time, `run` must
already handle Ctrl-C, limit the threads that NumPy starts, and report a missing package in one
line.

A module that is executed as a command has the name ``__main__``.  It passes its own name,
``__spec__.name``, to `run`, which imports it again under this name, so that its classes can be
pickled.
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

# Exit status when nobody reads a result on standard output.  A shell reports the same status for a
# program that SIGPIPE ends.
_UNREAD = 141

# The name under which to install a package whose modules have another name.
_INSTALLED_NAMES = {"PIL": "pillow", "skimage": "scikit-image"}


def run(module_name: str) -> NoReturn:
    """Run a command: import its module, call its function `main`, and end this process.

    The exit status is the one that `main` returns or passes to `sys.exit`, except in these cases:

    - the status of the Failure, if `main` raises one;
    - 1 if there is not enough memory, or standard output cannot be written;
    - 2 if a package is missing;
    - 130 if a signal ends the command;
    - 141 if nobody reads a result that the command writes to standard output.

    A Failure, a missing package or a lack of memory is reported in one line, without a traceback.
    Any other exception is raised, and the process does not end here.
    """
    end_on_signals()
    # Starting the threads of OpenBLAS would take as long as rendering a small picture.  NumPy reads
    # the variable when it is imported.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    # Collect garbage rarely: importing creates tens of thousands of objects, but no garbage.
    gc.set_threshold(100_000)
    exit_status = _flush_streams(_import_and_call_main(module_name))
    # An orderly exit would destroy NumPy's modules one by one, which takes a tenth as long as
    # rendering a small picture.
    os._exit(exit_status)


def _import_and_call_main(module_name: str) -> int:
    """Import a module, call its function `main`, and return the exit status of the command."""
    try:
        # First, because deep inside other imports it may take 6 ms longer: Python 3.11 requests
        # memory for its stack anew in each call at certain depths.
        with suppress(ImportError):  # reported below, or by the command
            import_module("numpy")
        result = attempt(import_module(module_name).main)
        return result.exit_status if isinstance(result, Failure) else result or 0
    except ModuleNotFoundError as error:
        package = (error.name or "numpy").partition(".")[0]
        package = _INSTALLED_NAMES.get(package, package)
        print_line(sys.stderr, f"{error}; install it with python -m pip install {package}")
        return MISUSED  # in some commands, status 1 means that pictures differ
    except BrokenPipeError:
        return _UNREAD
    except (ImportError, MemoryError, SystemError) as error:
        # NumPy's own message is a page of advice, but the first cause names the library at fault.
        first_cause: BaseException = error
        while cause := first_cause.__cause__ or first_cause.__context__:
            first_cause = cause
        reason = str(first_cause).strip() or "not enough memory"
        remedy = "give it more memory, or install it again"
        print_line(sys.stderr, make_printable(f"the command cannot start: {reason}; {remedy}"))
        return FAILED
    except SystemExit as error:
        return error.code if isinstance(error.code, int) else FAILED


def _flush_streams(exit_status: int) -> int:
    """Write what standard output and standard error still hold, because `os._exit` does not.

    Return the given exit status or, if it is 0 and writing fails, the status of that error.
    """
    for stream in (sys.stdout, sys.stderr):
        try:
            if stream is not None and not stream.closed:
                stream.flush()
        except OSError as error:
            exit_status = exit_status or (_UNREAD if isinstance(error, BrokenPipeError) else FAILED)
    return exit_status


def attempt(function: Callable[..., _Result], *arguments: object) -> _Result | Failure:
    """Call a function and return its result, or print the Failure that it raises and return that.

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

    Use this for notices, because a command must not fail if a notice cannot be printed.
    """
    with suppress(OSError):
        print_or_raise(stream, text)


def print_or_raise(stream: TextIO | None, text: str) -> None:
    """Print a line immediately, above the progress bar if one is shown.

    Characters that the stream cannot encode are escaped.  If the line cannot be printed, for
    example because the disk is full, close the stream and raise OSError.  Raise OSError, too, if
    the stream is closed, or is None because Python started without it.
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

    When a signal arrives, this process tells its child processes to end, deletes the unfinished
    files that it has been writing, and ends with exit status 130.  A signal that is already
    ignored, for example under nohup, stays ignored.
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
