"""Python in processes of its own, and what commands tell the user."""

import os
import subprocess
import sys
from pathlib import Path

from reference.command import HERE


def run_python(
    *arguments: str, cwd: Path = HERE.parent, stdout: int = subprocess.PIPE, **environment: str
) -> "subprocess.CompletedProcess[str]":
    """Run Python with this project's packages."""
    return subprocess.run(
        [sys.executable, *arguments],
        cwd=cwd,
        env=os.environ | {"PYTHONPATH": str(HERE.parent)} | environment,
        stdout=stdout,
        stderr=subprocess.PIPE,
        text=True,
        timeout=120,
    )


def told(err: str) -> str:
    """What a command wrote to stderr, without Dr.Jit's lines there if it has found no libLLVM."""
    return "".join(line for line in err.splitlines(True) if not line.startswith("jit"))
