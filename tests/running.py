"""Commands as processes, as a user starts them, and the scenes that they get."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import tracer

# The window's size is the picture's, so pixels are square.
SCENE = """<scene><camera><viewPoint>0 0 5</viewPoint><projDistance>{0}</projDistance>
<viewWidth>{0}</viewWidth><viewHeight>{1}</viewHeight></camera><image>{0} {1}</image>
<light><position>3 4 5</position></light><surface type="Sphere"/></scene>"""

ROOT = Path(tracer.__file__).parents[1]
# The tracer under test, whatever folder a process starts in.
ENVIRONMENT = {**os.environ, "PYTHONPATH": str(ROOT)}
INTERRUPTS = [signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT, signal.SIGXCPU]


def started(
    *arguments: object, python: Sequence[str] = ("-m", "tracer"), **options: Any
) -> subprocess.Popen[str]:
    """A process of the tracer, or of other Python code; it ends after five minutes at most."""
    prepare = options.pop("preexec_fn", lambda: None)

    def begin() -> None:
        signal.alarm(300)  # which stays when the program is loaded
        for kind in INTERRUPTS:  # nohup ignores some, and so does a script in the background
            signal.signal(kind, signal.SIG_DFL)
        prepare()

    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    options = {**pipes, "preexec_fn": begin, **options}
    options["env"] = ENVIRONMENT | options.get("env", {})
    return subprocess.Popen([sys.executable, *python, *map(str, arguments)], **options)


def run(*arguments: object, input: Any = None, **options: Any) -> tuple[int, Any, Any]:
    """Exit status, output and errors of a process that has ended."""
    if input is not None:
        options["stdin"] = subprocess.PIPE
    with started(*arguments, **options) as process:
        out, err = process.communicate(input)
    return process.returncode, out, err


def wait_until(holds: Callable[[], bool]) -> None:
    """Wait until something holds, 20 seconds at most."""
    deadline = time.monotonic() + 20
    while not holds():
        assert time.monotonic() < deadline
        time.sleep(0.01)


def told(err: str) -> str:
    """What a command wrote to stderr, without Dr.Jit's lines there if it has found no libLLVM."""
    return "".join(line for line in err.splitlines(True) if not line.startswith("jit"))


# A process starts out with its parent's peak memory: a small one must be in between.
_WATCH = """
import resource, subprocess, sys
subprocess.run(sys.argv[1:], check=True, stdout=subprocess.DEVNULL)
print(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss)
"""


def peak(*command: str, given: bytes = b"") -> float:
    """Peak resident memory of a process that is given input, or of its largest worker, MB."""
    watch = [sys.executable, "-c", _WATCH, *command]
    done = subprocess.run(watch, input=given, stdout=subprocess.PIPE, check=True, env=ENVIRONMENT)
    # In kibibytes on Linux, in bytes on macOS.
    return int(done.stdout) * (1 if sys.platform == "darwin" else 1024) / 1e6


def names(folder: Path) -> list[str]:
    """Files in a folder and below, but for the first scene in it."""
    paths = (path.relative_to(folder) for path in folder.rglob("*") if path.is_file())
    return sorted(str(path) for path in paths if str(path) != "ball.xml")
