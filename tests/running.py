"""Run commands as processes, as a user does."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pytest

import tracer
from tracer.picture.parallel import count_processors, has_gil

# A scene file for `str.format`, which takes the columns and the rows of the picture.  The window
# has the same size, so pixels are square.
SCENE = """<scene><camera><viewPoint>0 0 5</viewPoint><projDistance>{0}</projDistance>
<viewWidth>{0}</viewWidth><viewHeight>{1}</viewHeight></camera><image>{0} {1}</image>
<light><position>3 4 5</position></light><surface type="Sphere"/></scene>"""

ROOT = Path(tracer.__file__).parents[1]
# Processes import the tracer under test, in whatever folder they start.
ENVIRONMENT = {**os.environ, "PYTHONPATH": str(ROOT)}
INTERRUPTS = [signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT, signal.SIGXCPU]

# Seconds after which a process is ended.  Half of the time after which pytest ends the whole run
# (`faulthandler_timeout`): a test whose process waits for ever fails alone.
_MAX_SECONDS = 150


def write_ball(path: Path, width: int, height: int) -> Path:
    """Write a scene file that shows a ball in width x height pixels, and return its path."""
    path.write_text(SCENE.format(width, height))
    return path


def start_process(
    *arguments: object, python: Sequence[str] = ("-m", "tracer"), **options: Any
) -> subprocess.Popen[str]:
    """Start a command of the tracer, or other Python code, in a new process.

    All signals have their default effect in the process, and one ends it after `_MAX_SECONDS`.

    Parameters
    ----------
    python
        Arguments of the Python interpreter before those of the command.  By default, they run the
        module `tracer`.
    **options
        Keyword arguments of `subprocess.Popen`.  By default, standard output and standard error
        are pipes of text.  The variables in `env` are added to `ENVIRONMENT`.  `preexec_fn` is
        called in the new process after the default handling of signals has been restored.
    """
    prepare = options.pop("preexec_fn", lambda: None)

    def prepare_signals() -> None:
        """Set the time limit, and restore the default handling of signals."""
        signal.alarm(_MAX_SECONDS)  # the alarm survives the loading of the program
        for number in INTERRUPTS:  # nohup and background scripts ignore some signals
            signal.signal(number, signal.SIG_DFL)
        prepare()

    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    options = {**pipes, "preexec_fn": prepare_signals, **options}
    options["env"] = ENVIRONMENT | options.get("env", {})
    return subprocess.Popen([sys.executable, *python, *map(str, arguments)], **options)


def run(*arguments: object, input: Any = None, **options: Any) -> tuple[int, Any, Any]:
    """Run a command as `start_process` does, and return its exit status, output and errors.

    If a signal ended the process, the status is the negative number of the signal.  Input, output
    and errors are bytes if the option `text` is False; output and errors are None if an option
    redirected the stream.
    """
    if input is not None:
        options["stdin"] = subprocess.PIPE
    with start_process(*arguments, **options) as process:
        out, err = process.communicate(input)
    return process.returncode, out, err


needs_two = pytest.mark.skipif(count_processors() < 2, reason="there is one processor")
"""Mark of tests that need two processors."""

needs_processes = pytest.mark.skipif(not has_gil(), reason="this Python has no lock")
"""Mark of tests of the command's worker processes, in whose place such a Python has threads."""


def workers_of(process: subprocess.Popen[str]) -> list[int]:
    """Return the ids of all child processes of a running process; none if it has ended."""
    try:
        children = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text()
    except OSError:
        return []
    return [*map(int, children.split())]


def wait_until(condition: Callable[[], bool]) -> None:
    """Call a function without arguments every 0.01 seconds until it returns True.

    Raises
    ------
    AssertionError
        If the function still returns False after 20 seconds.
    """
    deadline = time.monotonic() + 20
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.01)


def drop_jit(err: str) -> str:
    """Remove the lines that begin with "jit" from the text of standard error.

    Dr.Jit, a package on which Mitsuba depends, prints such lines if it finds no libLLVM.
    """
    return "".join(line for line in err.splitlines(True) if not line.startswith("jit"))


# A new process inherits the peak memory of its parent, so a small process starts the measured one.
_WATCH = """
import resource, subprocess, sys
subprocess.run(sys.argv[1:], check=True, stdout=subprocess.DEVNULL)
print(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss)
"""


def peak_memory(*command: str, input: bytes = b"") -> float:
    """Run a command, and measure the peak memory of its largest process.

    Parameters
    ----------
    *command : str
        The program and its arguments.
    input : bytes
        The standard input of the command.

    Returns
    -------
    peak : float
        Peak resident memory, in MB, of the command's own process or of one of its children,
        whichever is larger.

    Raises
    ------
    subprocess.CalledProcessError
        If the exit status of the command is not 0.
    """
    watch = [sys.executable, "-c", _WATCH, *command]
    result = subprocess.run(watch, input=input, stdout=subprocess.PIPE, check=True, env=ENVIRONMENT)
    # The unit is a kibibyte on Linux, a byte on macOS.
    return int(result.stdout) * (1 if sys.platform == "darwin" else 1024) / 1e6


def file_names(folder: Path) -> list[str]:
    """List all files in a folder and its subfolders, except `ball.xml`, the input of most tests.

    Parameters
    ----------
    folder : Path
        The folder.

    Returns
    -------
    names : list of str
        Paths relative to the folder, sorted.
    """
    names = (str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file())
    return sorted(name for name in names if name != "ball.xml")
