"""The machine and the software that a measurement was made with."""

from __future__ import annotations

import os
import platform
import re
import subprocess
from datetime import datetime, timezone
from importlib import metadata
from pathlib import Path

__all__ = ["describe"]


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    return next(
        (line.partition(":")[2].strip() for line in lines if line.startswith("model name")),
        platform.machine(),
    )


def _version(package: str) -> str:
    try:
        return f"{package} {metadata.version(package)}"
    except metadata.PackageNotFoundError:
        return f"no {package}"


def _povray() -> str:
    try:
        told = subprocess.run(["povray", "--version"], capture_output=True, text=True)
    except FileNotFoundError:
        return "no POV-Ray"
    found = re.search(r"POV-Ray \d+(\.\d+)*", told.stdout + told.stderr)
    return found[0] if found else "POV-Ray"


def describe() -> str:
    """One line: date, processor, system, versions."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return ", ".join(
        [
            datetime.now(timezone.utc).strftime("%Y-%m-%d"),
            f"{_processor()} ({cores} cores)",
            platform.system(),
            f"Python {platform.python_version()}",
            *map(_version, ("numpy", "mitsuba", "drjit")),
            _povray(),
        ]
    )
