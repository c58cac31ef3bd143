"""Run commands as processes, as a user does."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import tracer

# A scene file for `str.format`, which takes the columns and the rows of the picture.  The window
# has the same size, so pixels are square.
SCENE = """<scene><camera><viewPoint>0 0 5</viewPoint><projDistance>{0}</projDistance>
<viewWidth>{0}</viewWidth><viewHeight>{1}</viewHeight></camera><image>{0} {1}</image>
<light><position>3 4 5</position></light><surface type="Sphere"/></scene>"""

ROOT = Path(tracer.__file__).parents[1]
# Processes import the tracer under test, in whatever folder they start.
ENVIRONMENT = {**os.environ, "PYTHONPATH": str(ROOT)}
INTERRUPTS = [signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT, signal.SIGXCPU]


def start_process(
    *arguments: object, python: Sequence[str] = ("-m", "tracer"), **options: Any
) -> subprocess.Popen[str]:
    """Start a process of the tracer, or of other Python code, which ends after 5 minutes at most.

    Parameters
    ----------
    arguments : object
        Arguments of the command, converted to str.
    python : sequence of str
        Arguments of Python: what to run.
    options : Any
        Keyword arguments of `subprocess.Popen`.  `env` is added to `ENVIRONMENT`, and
        `preexec_fn` is called after the default handling of signals has been restored.
    """
    prepare = options.pop("preexec_fn", lambda: None)

    def begin() -> None:
        signal.alarm(300)  # the alarm survives the loading of the program
        for kind in INTERRUPTS:  # nohup and background scripts ignore some signals
            signal.signal(kind, signal.SIG_DFL)
        prepare()

    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    options = {**pipes, "preexec_fn": begin, **options}
    options["env"] = ENVIRONMENT | options.get("env", {})
    return subprocess.Popen([sys.executable, *python, *map(str, arguments)], **options)


def run(*arguments: object, input: Any = None, **options: Any) -> tuple[int, Any, Any]:
    """Run a process to its end; return its exit status, its output and its errors."""
    if input is not None:
        options["stdin"] = subprocess.PIPE
    with start_process(*arguments, **options) as process:
        out, err = process.communicate(input)
    return process.returncode, out, err


def wait_until(condition: Callable[[], bool]) -> None:
    """Wait until a condition is true; fail after 20 seconds."""
    deadline = time.monotonic() + 20
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.01)


def drop_jit(err: str) -> str:
    """Remove the lines that Dr.Jit writes to stderr where it has found no libLLVM."""
    return "".join(line for line in err.splitlines(True) if not line.startswith("jit"))


# A new process inherits the peak memory of its parent, so a small process starts the measured one.
_WATCH = """
import resource, subprocess, sys
subprocess.run(sys.argv[1:], check=True, stdout=subprocess.DEVNULL)
print(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss)
"""


def peak_memory(*command: str, given: bytes = b"") -> float:
    """Return the peak resident memory of a command, or of its largest worker, in MB."""
    watch = [sys.executable, "-c", _WATCH, *command]
    done = subprocess.run(watch, input=given, stdout=subprocess.PIPE, check=True, env=ENVIRONMENT)
    # The unit is a kibibyte on Linux, a byte on macOS.
    return int(done.stdout) * (1 if sys.platform == "darwin" else 1024) / 1e6


def file_names(folder: Path) -> list[str]:
    """Return the sorted paths of all files below a folder, except ball.xml, the usual input."""
    paths = (path.relative_to(folder) for path in folder.rglob("*") if path.is_file())
    return sorted(str(path) for path in paths if str(path) != "ball.xml")
