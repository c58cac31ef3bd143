"""What the commands of this folder share: where files are, and the parser of their options."""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from pathlib import Path

from tqdm import tqdm

from tracer.command.arguments import real_path
from tracer.command.process import MISUSED
from tracer.messages import printable

# Without this, tqdm would have a thread of its own beside what is measured.
tqdm.monitor_interval = 0

HERE = Path(__file__).resolve().parent
SCENES = HERE.parent / "scenes"
BUILD = HERE.parent / "build"
"""Folder for files that can be made again; not under version control."""


def own_scenes() -> list[Path]:
    """This project's scenes by name, without what was converted for Mitsuba beside them."""
    return sorted(p for p in SCENES.glob("*.xml") if not p.name.endswith(".mitsuba.xml"))


def built(name: str) -> Path:
    """A file in the build folder, which is made if need be."""
    BUILD.mkdir(exist_ok=True)
    return BUILD / name


def parser(module: str, doc: str | None, quick: str | None = None) -> argparse.ArgumentParser:
    """The parser of `python -m module`, described by its docstring.

    `quick` is what its option `--quick` does.
    """
    made = argparse.ArgumentParser(
        prog=f"python -m {module}",
        description=doc,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    if quick:
        made.add_argument("--quick", action="store_true", help=f"{quick}; writes into build/")
    return made


def spare_inputs(
    used: argparse.ArgumentParser, outputs: Iterable[Path], inputs: Iterable[Path]
) -> None:
    """End with wrong usage where a result would replace what one is made from."""
    sources = {real_path(path, status=MISUSED) for path in inputs}
    for output in outputs:
        if real_path(output, status=MISUSED) in sources:
            wrong = f"{output}: this would replace an input; choose another with -o"
            used.error(printable(wrong))
