"""What commands share: names in their arguments, what they print, and how they are interrupted.

Nothing here takes long to import: a command is to heed signals before NumPy is imported.
"""

from __future__ import annotations

import argparse
import os
import signal
import sys
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from time import monotonic
from typing import NoReturn, TextIO

from tracer.messages import printable

__all__ = [
    "at_least",
    "begin",
    "end",
    "heed_signals",
    "is_folder",
    "named",
    "no_folder",
    "say",
    "targets",
]


def named(text: str) -> str:
    """The type of an argument that names a file or a folder."""
    if not text:
        raise argparse.ArgumentTypeError("the name is empty; name a file")
    return text


def at_least(least: int) -> Callable[[str], int]:
    """The type of an argument that is a whole number, `least` or more."""

    def whole_number(text: str) -> int:
        if not (text.isascii() and text.isdigit() and len(text) < 10 and int(text) >= least):
            wanted = f"must be a whole number from {least} to 999999999"
            raise argparse.ArgumentTypeError(f"{wanted}, is {text!r}")
        return int(text)

    return whole_number


def is_folder(path: str) -> bool:
    """Whether results are to be written to a folder of this name, there or not."""
    return path.endswith(("/", os.sep)) or os.path.isdir(path)


def no_folder(error: OSError) -> str:
    """What is wrong if a path has no place: only the folder that it starts from can be missing."""
    return f"the working folder cannot be found: {error.strerror or error}; change to another"


def targets(
    parser: argparse.ArgumentParser,
    scenes: Sequence[str],
    output: str | None,
    beside: Sequence[str],
    files: Callable[[str], Iterable[str | os.PathLike[str]]] = lambda target: (target,),
) -> list[str]:
    """Where each scene's result goes: to `output` if that is given, or else `beside` the scene.

    `files`: all that is written for a target.  Ends with wrong usage, and status 2, where one of
    these would replace a scene, or two of them each other; with status 1 in a folder that is gone.
    """
    if output is None:
        found = list(beside)
    elif is_folder(output):
        found = [os.path.join(output, os.path.basename(path)) for path in beside]
    elif len(scenes) == 1:
        found = [output]
    else:
        wrong = "several scenes need a folder; to have it made, end it in"
        _misused(parser, f"-o {output}: {wrong} {os.sep}")
    try:
        inputs = {os.path.realpath(scene) for scene in scenes}
        taken: dict[str, str] = {}
        for scene, target in zip(scenes, found, strict=True):
            for path in files(target):
                place = os.path.realpath(path)
                if place in inputs:
                    _misused(parser, f"{path}: this would replace a scene; choose another with -o")
                if place in taken:
                    both = f"{taken[place]} and {scene} would both be written there"
                    _misused(parser, f"{path}: {both}; do them one by one")
                taken[place] = scene
    except OSError as error:
        parser.exit(1, no_folder(error) + "\n")
    except ValueError as error:  # a NUL
        _misused(parser, f"no such name: {error}")
    return found


def _misused(parser: argparse.ArgumentParser, wrong: str) -> NoReturn:
    parser.error(printable(wrong))


def say(stream: TextIO | None, text: str) -> None:
    """Print a line at once, or not at all if that fails: the files that are written matter more."""
    if stream is None:
        return
    encoding = stream.encoding or "utf-8"
    with suppress(OSError):
        print(text.encode(encoding, "backslashreplace").decode(encoding), file=stream, flush=True)


_begun = False

# For so long after a signal, in seconds, no other is heeded: what it has left half-written goes.
_DEAF = 0.5
_deaf_until = 0.0


def heed_signals() -> None:
    """Let signals that end a process do so with status 130; see `begin`."""
    for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT", "SIGXCPU"):
        number = getattr(signal, name, None)  # not all systems have the last three
        # One that is ignored stays so: in the background of a script, or under nohup.
        if number is not None and signal.getsignal(number) != signal.SIG_IGN:
            signal.signal(number, _interrupted)


def begin() -> None:
    """From here on signals raise KeyboardInterrupt: files may be half-written, all is imported."""
    global _begun
    _begun = True


def end(status: int) -> NoReturn:
    """End the process, and with it what it has started."""
    global _begun
    _begun = False
    # Otherwise Python, as it exits, would try again to print what could not be.
    for stream in (sys.stdout, sys.stderr):
        if stream is not None:
            with suppress(OSError):
                stream.close()
    sys.exit(status)


def _interrupted(_number: int, _frame: object) -> None:
    """Leave, with nothing half-written."""
    # An exception while NumPy is imported would pass for a fault of NumPy's.
    if not _begun:
        os._exit(130)
    global _deaf_until
    now = monotonic()
    if now >= _deaf_until:
        _deaf_until = now + _DEAF
        raise KeyboardInterrupt
