"""What the commands of this folder share: where files are, and the parser of their options."""

from __future__ import annotations

import argparse
from pathlib import Path

from tqdm import tqdm

# Its own thread would keep the tracer from using both processors.
tqdm.monitor_interval = 0

__all__ = ["BUILD", "HERE", "SCENES", "built", "parser"]

HERE = Path(__file__).resolve().parent
SCENES = HERE.parent / "scenes"

BUILD = HERE.parent / "build"
"""Where what can be made again is kept; not under version control."""


def built(name: str) -> Path:
    """A file in the build folder, which is made if need be."""
    BUILD.mkdir(exist_ok=True)
    return BUILD / name


def parser(module: str, doc: str | None, quick: str | None = None) -> argparse.ArgumentParser:
    """The parser of `python -m module`, described by its docstring.

    `quick` is what the option `--quick` does, if there is one.
    """
    made = argparse.ArgumentParser(
        prog=f"python -m {module}",
        description=doc,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    if quick:
        made.add_argument("--quick", action="store_true", help=quick)
    return made
