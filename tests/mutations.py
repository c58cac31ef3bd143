"""Whether the tests notice the mistakes of `mutations.txt`.

    python tests/mutations.py [--list] [NUMBER ...]

makes each mistake, or some of them, in a copy of this checkout, and runs the tests of its package
until one fails.  A mistake that no test notices has survived: then the exit status is 1.  By hand:
all take an hour or two.  With `--list` it runs no tests, but fails if a mistake cannot be made.
"""

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent

TESTS = {
    "tracer/scene": ["format"],
    "tracer/picture": ["command"],
    "tracer/command": ["command"],
    "tracer/files": ["command"],
    "tracer/antialias": ["accuracy/test_antialias.py", "accuracy"],
    "tracer": ["accuracy"],
}
"""Tests that are run, by what a module's path begins with; the first that fits counts."""


def mutations() -> list[tuple[str, str, str]]:
    """The module of each, its text, and the new text."""
    found, module = [], ""
    for line in Path(__file__).with_suffix(".txt").read_text(encoding="utf-8").splitlines():
        if match := re.fullmatch("    (.*) => (.*)", line):
            found.append((module, match[1], match[2]))
        elif line and not line.startswith("#"):
            module = line
    return found


def mutated(module: str, old: str, new: str) -> str:
    """The text of a module with a mistake."""
    text = (ROOT / module).read_text(encoding="utf-8")
    if text.count(old) != 1:
        raise ValueError(f"{module}: {old!r} stands there {text.count(old)} times, not once")
    return text.replace(old, new)


def notices(module: str, text: str) -> str | None:
    """The test that fails with a module's new text; None if none does."""
    with tempfile.TemporaryDirectory() as folder:
        for name in subprocess.check_output(["git", "ls-files"], cwd=ROOT, text=True).splitlines():
            (Path(folder) / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(ROOT / name, Path(folder) / name)
        (Path(folder) / module).write_text(text, encoding="utf-8")
        names = next(names for start, names in TESTS.items() if module.startswith(start))
        command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider"]
        done = subprocess.run(
            [*command, *(f"tests/{name}" for name in names)],
            cwd=folder,
            env={**os.environ, "PYTHONPATH": folder},
            stdout=subprocess.PIPE,
            text=True,
            timeout=3600,
        )
    failed = re.search("^(FAILED|ERROR) .*?(?= - |$)", done.stdout, re.M)
    return None if done.returncode == 0 else failed[0] if failed else f"status {done.returncode}"


def main() -> int:
    """Try mistakes; return 1 if any survives, else 0."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("numbers", nargs="*", type=int, metavar="NUMBER")
    parser.add_argument("--list", action="store_true", help="run no tests")
    arguments = parser.parse_args()
    survivors, every = 0, mutations()
    for number in arguments.numbers or range(len(every)):
        module, old, new = every[number]
        text = mutated(module, old, new)
        test = "" if arguments.list else notices(module, text)
        survivors += test is None
        print(f"{number} {module}: {old!r} {'SURVIVED' if test is None else test}", flush=True)
    return int(survivors > 0)


if __name__ == "__main__":
    raise SystemExit(main())
