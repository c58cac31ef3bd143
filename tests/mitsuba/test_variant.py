"""The choice of Mitsuba's variant: no libLLVM, good or bad, kills this process or misleads it."""

import pytest
from running import run_python
from scene_files import ONE_SPHERE

from converters import to_mitsuba
from converters.variant import LLVM, SCALAR, Choice, choose, use
from reference import check

RENDER = """
from converters.rendering import render_mitsuba
from converters.variant import use
from tracer import load_scene
from dataclasses import replace
scene = replace(load_scene("scenes/one-sphere.xml"), width=16, height=16)
choice = use()
assert render_mitsuba(scene).max() > 0.1
print(choice.variant, choice.reason)
"""


@pytest.mark.parametrize(
    "content", [pytest.param(None, id="no library", marks=pytest.mark.slow), "not a library"]
)
def test_without_a_library_the_scalar_variant_is_left(tmp_path, content):
    fake = tmp_path / "libLLVM.so"
    if content:
        fake.write_text(content)
    done = run_python("-c", RENDER, DRJIT_LIBLLVM_PATH=str(fake))
    assert done.stdout.startswith(f"{SCALAR} no usable libLLVM")


@pytest.mark.parametrize(
    ("kernel", "variant", "reason"),
    [
        ("pass", LLVM, "libLLVM works"),
        ("import os; os.abort()", SCALAR, "the libLLVM found here kills the process with SIGABRT"),
        ("import os, signal; os.kill(os.getpid(), signal.SIGSEGV)", SCALAR,
         "the libLLVM found here kills the process with SIGSEGV"),
        ("raise ImportError('not there')", SCALAR, "no usable libLLVM: ImportError: not there"),
        ("raise SystemExit(3)", SCALAR, "no usable libLLVM: it said nothing"),
        ("import time; time.sleep(60)", SCALAR, "the libLLVM found here hangs"),
        ("import os; assert not os.path.isdir(os.path.expanduser('~'))", LLVM, "libLLVM works"),
    ],
)  # fmt: skip
def test_the_probe_tells_how_its_child_ended(kernel, variant, reason, tmp_path, monkeypatch):
    # It finds no kernels at home.
    (tmp_path / ".drjit").mkdir()
    monkeypatch.setenv("HOME", str(tmp_path))
    options = {"timeout": 0.5} if "hangs" in reason else {}
    assert choose(kernel, **options) == Choice(variant, reason)


def test_the_probe_runs_once_a_process_and_scalar_can_always_be_asked_for():
    assert use() is use()
    assert use(SCALAR).variant == SCALAR
    use()


def test_asking_for_a_variant_that_does_not_work_says_why():
    code = f"from converters.variant import use; use({LLVM!r})"
    child = run_python("-c", code, DRJIT_LIBLLVM_PATH="/nonexistent")
    assert child.returncode == 1
    assert f"ImportError: {LLVM} does not work here: no usable libLLVM" in child.stderr


@pytest.mark.parametrize("variant", ["nope", "scalar_spectral", ""])
def test_variants_without_rgb_are_refused(variant, capsys):
    scene = str(ONE_SPHERE)
    assert check.main(["--variant", variant, scene]) == 2
    assert to_mitsuba.main(["--render", "--variant", variant, scene]) == 1
    wrong = f"Mitsuba cannot run: {variant or repr(variant)} is not an RGB variant; choose one of "
    first, second = capsys.readouterr().err.splitlines()
    assert first == second
    assert first.startswith(wrong)
    assert SCALAR in first
    assert "spectral" not in first.removeprefix(wrong)
