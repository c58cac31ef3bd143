"""Shared by all commands: arguments, lines that are printed, whole files, signals, exit statuses.

Nothing here takes long to import: a command handles signals before NumPy is imported.
"""

from __future__ import annotations

import argparse
import errno
import os
import signal
import stat
import sys
import zlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from time import monotonic
from typing import IO, NoReturn, TextIO

from tracer.messages import printable

__all__ = [
    "FAILED",
    "INTERRUPTED",
    "MISUSED",
    "allow_interrupts",
    "atomic_file",
    "exit_process",
    "file_name",
    "install_signal_handlers",
    "is_folder",
    "no_working_folder",
    "output_paths",
    "print_line",
    "printable",
    "whole_number",
]

FAILED, MISUSED, INTERRUPTED = 1, 2, 130
"""Exit statuses: something could not be done, wrong usage, ended by a signal."""

# Seconds after a signal in which no other counts, so that half-written files can be removed.
_GRACE = 0.5


def file_name(text: str) -> str:
    """Type of an argument that names a file or a folder."""
    if not text:
        raise argparse.ArgumentTypeError("the name is empty; name a file")
    return text


def whole_number(least: int) -> Callable[[str], int]:
    """Type of an argument that is a whole number, `least` or more."""

    def number(text: str) -> int:
        if not (text.isascii() and text.isdigit() and len(text) < 10 and int(text) >= least):
            wanted = f"must be a whole number from {least} to 999999999"
            raise argparse.ArgumentTypeError(f"{wanted}, is {text!r}")
        return int(text)

    return number


def is_folder(path: str) -> bool:
    """Whether results are to be written to a folder of this name, which need not exist yet."""
    return path.endswith(("/", os.sep)) or os.path.isdir(path)


def no_working_folder(error: OSError) -> str:
    """Message for a path that cannot be resolved: the folder that it starts from is gone."""
    return f"the working folder cannot be found: {error.strerror or error}; change to another"


def output_paths(
    parser: argparse.ArgumentParser,
    scenes: Sequence[str],
    output: str | None,
    beside: Sequence[str],
    files: Callable[[str], Iterable[str | os.PathLike[str]]] = lambda target: (target,),
) -> list[str]:
    """Choose where each scene's result goes: to `output`, a file or a folder, or `beside` it.

    `files` returns all that is written for a result's path.  The parser ends the process with
    status 2 where one of these would replace a scene or another result, and with 1 in a working
    folder that is gone.
    """
    if output is None:
        found = list(beside)
    elif is_folder(output):
        found = [os.path.join(output, os.path.basename(path)) for path in beside]
    elif len(scenes) == 1:
        found = [output]
    else:
        wrong = "several scenes need a folder; to have it made, end it in"
        parser.error(printable(f"-o {output}: {wrong} {os.sep}"))
    try:
        inputs, taken = {os.path.realpath(scene) for scene in scenes}, dict[str, str]()
        for scene, target in zip(scenes, found, strict=True):
            for path in files(target):
                place = os.path.realpath(path)
                if place in inputs:
                    wrong = "this would replace a scene; choose another with -o"
                    parser.error(printable(f"{path}: {wrong}"))
                if place in taken:
                    wrong = f"{taken[place]} and {scene} would both be written there"
                    parser.error(printable(f"{path}: {wrong}; do them one by one"))
                taken[place] = scene
    except OSError as error:
        parser.exit(FAILED, no_working_folder(error) + "\n")
    return found


def print_line(stream: TextIO | None, text: str) -> None:
    """Print a line at once, or not at all if that fails: the files that are written matter more."""
    if stream is None:
        return
    encoding = stream.encoding or "utf-8"
    with suppress(OSError):
        print(text.encode(encoding, "backslashreplace").decode(encoding), file=stream, flush=True)


@contextmanager
def atomic_file(path: str | os.PathLike[str], begins: bytes) -> Iterator[IO[bytes]]:
    """Open a new binary file that replaces `path` once it is whole, and vanishes after an error.

    A link stays one: what it points to is replaced.  Such files begin with the bytes `begins`; one
    that does not is somebody's work, and stays, unless it is empty.

    Raises
    ------
    OSError
        If it cannot be written, or what is there is no regular file, or of another kind.
    """
    target, mode = os.path.realpath(path), None
    with suppress(FileNotFoundError):
        mode = os.stat(target).st_mode
        if not stat.S_ISREG(mode):
            raise OSError(errno.EINVAL, "not a regular file", target)
        with open(target, "r+b") as there:  # to be replaced only by those who may write it
            if there.read(len(begins)) not in (begins, b""):
                raise FileExistsError(errno.EEXIST, "a file of another kind is there", target)
    folder, name = os.path.split(target)
    # Not the name itself: that may be as long as a name can be.
    prefix = os.path.join(folder, f".{zlib.crc32(os.fsencode(name)):08x}-")
    _remove_abandoned(folder, prefix)
    part = f"{prefix}{os.urandom(4).hex()}.part"
    try:
        with _new_locked(part) as file:
            yield file
            file.flush()
            if mode is not None:
                os.chmod(part, stat.S_IMODE(mode))
            if os.name == "nt":  # an open file cannot be moved there
                file.close()
            os.replace(part, target)
    except BaseException as error:
        if isinstance(error, OSError) and error.filename == part:
            error.filename = target
        with suppress(OSError):
            os.unlink(part)
        raise


def _new_locked(path: str) -> IO[bytes]:
    """Open a new file, locked if that is possible."""
    while True:
        file = open(path, "xb")  # noqa: SIM115
        if not _locked(file, wait=True) or os.fstat(file.fileno()).st_nlink:
            return file
        file.close()  # another process has found it before it was locked, and removed it


def _remove_abandoned(folder: str, prefix: str) -> None:
    """Remove part files whose writers no longer live: these would hold locks on them."""
    with suppress(OSError):
        for name in os.listdir(folder):
            path = os.path.join(folder, name)
            if path.startswith(prefix) and path.endswith(".part"):
                with suppress(OSError), open(path, "r+b") as file:
                    if _locked(file, wait=False):
                        os.unlink(path)


def _locked(file: IO[bytes], *, wait: bool) -> bool:
    """Lock a file until it is closed; return whether that was possible."""
    try:
        from fcntl import LOCK_EX, LOCK_NB, flock  # not on all systems

        flock(file, LOCK_EX if wait else LOCK_EX | LOCK_NB)
    except (ImportError, OSError):
        return False
    return True


_interruptible, _ignored_until = False, 0.0


def install_signal_handlers() -> None:
    """Let signals that end a process do so with status 130; see `allow_interrupts`."""
    for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT", "SIGXCPU"):
        number = getattr(signal, name, None)  # not all systems have the last three
        # One that is ignored stays so: in the background of a script, or under nohup.
        if number is not None and signal.getsignal(number) != signal.SIG_IGN:
            signal.signal(number, _interrupted)


def allow_interrupts() -> None:
    """From here on signals raise KeyboardInterrupt: files may be half-written, all is imported."""
    global _interruptible
    _interruptible = True


def exit_process(status: int) -> NoReturn:
    """End the process, and with it what it has started."""
    global _interruptible
    _interruptible = False
    # Otherwise Python, as it exits, would try again to print what could not be.
    for stream in (sys.stdout, sys.stderr):
        if stream is not None:
            with suppress(OSError):
                stream.close()
    sys.exit(status)


def _interrupted(_number: int, _frame: object) -> None:
    """Leave, with nothing half-written."""
    # An exception while NumPy is imported would pass for a fault of NumPy's.
    if not _interruptible:
        os._exit(INTERRUPTED)
    global _ignored_until
    now = monotonic()
    if now >= _ignored_until:
        _ignored_until = now + _GRACE
        raise KeyboardInterrupt
