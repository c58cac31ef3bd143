"""The choice of Mitsuba's variant: no libLLVM, good or bad, kills this process or misleads it."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from converters.variant import LLVM, SCALAR, Choice, choose, use
from reference.command import HERE

# Where Debian puts shared libraries; versions 14 to 16 are known not to work, 19 to work.
LIBRARIES = sorted(Path("/usr/lib").glob("*/libLLVM*.so.*"))

_RENDER = """
import sys
from converters.rendering import render_mitsuba
from converters.variant import use
from tracer import load_scene
from dataclasses import replace
scene = replace(load_scene("scenes/one-sphere.xml"), width=16, height=16)
choice = use()
assert render_mitsuba(scene).max() > 0.1
print(choice.variant, choice.reason)
"""


def run_with(library: str, code: str) -> subprocess.CompletedProcess[str]:
    """Run a program with this libLLVM."""
    return subprocess.run(
        [sys.executable, "-c", code],
        cwd=HERE.parent,
        env=os.environ | {"DRJIT_LIBLLVM_PATH": library},
        capture_output=True,
        text=True,
        timeout=120,
    )


def rendered_with(library: str) -> str:
    """What a process that renders prints."""
    child = run_with(library, _RENDER)
    assert child.returncode == 0, child.stderr
    return child.stdout


@pytest.mark.parametrize(
    "there",
    [
        pytest.param(False, id="no library", marks=pytest.mark.slow),
        pytest.param(True, id="a file that is none"),
    ],
)
def test_without_a_library_the_scalar_variant_is_left(tmp_path: Path, there: bool) -> None:
    fake = tmp_path / "libLLVM.so"
    if there:
        fake.write_text("not a library")
    assert rendered_with(str(fake)).startswith(f"{SCALAR} no usable libLLVM")


@pytest.mark.slow
@pytest.mark.parametrize("library", LIBRARIES or [None], ids=str)
def test_every_library_on_this_machine_renders_in_some_variant(library: Path | None) -> None:
    if library is None:
        pytest.skip("libLLVM is not installed")
    variant = rendered_with(str(library)).split()[0]
    assert variant == LLVM or (variant == SCALAR and "19" not in library.name)


@pytest.mark.parametrize(
    ("kernel", "variant", "reason"),
    [
        ("pass", LLVM, "libLLVM works"),
        ("import os; os.abort()", SCALAR, "the libLLVM found here kills the process with SIGABRT"),
        ("import os, signal; os.kill(os.getpid(), signal.SIGSEGV)", SCALAR,
         "the libLLVM found here kills the process with SIGSEGV"),
        ("raise ImportError('not there')", SCALAR, "no usable libLLVM: ImportError: not there"),
        ("raise SystemExit(3)", SCALAR, "no usable libLLVM: it said nothing"),
    ],
)  # fmt: skip
def test_the_probe_tells_how_its_child_ended(kernel: str, variant: str, reason: str) -> None:
    assert choose(kernel) == Choice(variant, reason)


def test_the_probe_does_not_wait_for_ever() -> None:
    assert choose("import time; time.sleep(60)", timeout=0.5) == Choice(
        SCALAR, "the libLLVM found here hangs"
    )


def test_the_probe_finds_no_kernels_at_home(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / ".drjit").mkdir()
    monkeypatch.setenv("HOME", str(tmp_path))
    assert choose("import os; assert not os.listdir(os.path.expanduser('~'))").variant == LLVM


def test_the_probe_runs_once_a_process_and_scalar_can_always_be_asked_for() -> None:
    assert use() is use()
    assert use(SCALAR).variant == SCALAR
    use()


def test_asking_for_a_variant_that_does_not_work_says_why() -> None:
    child = run_with("/nonexistent", f"from converters.variant import use; use({LLVM!r})")
    assert child.returncode == 1
    assert f"ImportError: {LLVM} does not work here: no usable libLLVM" in child.stderr
