"""A command as a process: how it starts, prints, is interrupted and ends.

Every command of this project starts by `run`, before anything that takes long is imported.
"""

from __future__ import annotations

import gc
import os
import signal
import sys
from collections.abc import Callable
from contextlib import suppress
from importlib import import_module
from typing import NoReturn, TextIO, TypeVar

from tracer.command.failure import Failure
from tracer.files import unfinished
from tracer.messages import printable

_Result = TypeVar("_Result")

FAILED, MISUSED, INTERRUPTED = 1, 2, 130
"""Exit statuses: something could not be done, wrong usage, ended by a signal."""


def run(module: str) -> NoReturn:
    """Run a command: import its module, call `main`, and exit with the status that it returns.

    A Failure, a missing package and a lack of memory are printed as one line instead of a
    traceback.  A signal that ends the command makes the exit status 130.

    Parameters
    ----------
    module : str
        Name of the module.  Its function `main` takes no arguments, and returns an exit status or
        None, which counts as 0.
    """
    for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT", "SIGXCPU"):
        number = getattr(signal, name, None)  # not all systems have the last three
        # One that is ignored stays so: in the background of a script, or under nohup.
        if number is not None and signal.getsignal(number) != signal.SIG_IGN:
            signal.signal(number, _interrupted)
    # No product of matrices here is worth OpenBLAS's threads; starting them would take as long as
    # rendering a small picture.  The variable is read when NumPy is imported.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    # Importing makes tens of thousands of objects, and none is garbage: seldom look for any.
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
    except (ImportError, MemoryError, SystemError) as error:
        # NumPy's own message is a page of advice; what caused it names a library.
        first: BaseException = error
        while cause := first.__cause__ or first.__context__:
            first = cause
        reason = str(first).strip() or "not enough memory"
        remedy = "give it more memory, or install it again"
        print_line(sys.stderr, printable(f"the command cannot start: {reason}; {remedy}"))
    except SystemExit as error:
        status = error.code if isinstance(error.code, int) else FAILED
    # Otherwise what could not be printed would be lost without a word.
    for stream in (sys.stdout, sys.stderr):
        try:
            if stream is not None and not stream.closed:
                stream.flush()
        except OSError:
            status = status or FAILED
    # An orderly exit would take NumPy's modules down one by one, and add a tenth to the time of a
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
    """Print a notice at once, or not at all if that fails: results matter more."""
    with suppress(OSError):
        print_result(stream, text)


def print_result(stream: TextIO | None, text: str) -> None:
    """Print a line at once.

    Raises
    ------
    OSError
        If it cannot be printed: the stream is closed, or its disk full.
    """
    if stream is None or stream.closed:
        raise OSError("it is closed")
    encoding = stream.encoding or "utf-8"
    try:
        print(text.encode(encoding, "backslashreplace").decode(encoding), file=stream, flush=True)
    except OSError:
        # What is left in its buffer would fail again at the end.
        with suppress(OSError):
            stream.close()
        raise


def _interrupted(_number: int, _frame: object) -> NoReturn:
    """Leave at once, with nothing half-written and nothing printed.

    A KeyboardInterrupt would be lost where it is raised in a finalizer or after a fork, and would
    pass for a fault of NumPy's or of a plugin's where it is raised in one of these.
    """
    for path in unfinished:
        with suppress(OSError):
            os.unlink(path)
    os._exit(INTERRUPTED)
