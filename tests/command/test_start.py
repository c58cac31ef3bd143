"""How every command starts: with its packages, the number of threads, and enough memory."""

import pytest
from running import ROOT, drop_jit, run


@pytest.mark.parametrize(
    ("module", "missing"),
    [
        *(("tracer", m) for m in ("numpy", "numpy._core.gone")),
        *((f"reference.{m}", "mitsuba") for m in ("benchmark", "check", "regenerate", "report")),
        *((f"reference.{m}", "PIL") for m in ("compare", "regenerate")),
        *((f"reference.{m}", "matplotlib") for m in ("speed_accuracy", "stability")),
    ],
)
def test_a_command_without_its_packages_says_what_to_install(tmp_path, module, missing):
    package, error = missing.partition(".")[0], f"No module named {missing}"
    stub = f"raise ModuleNotFoundError({error!r}, name={missing!r})"
    (tmp_path / f"{package}.py").write_text(stub)
    status, out, err = run(python=("-m", module), env={"PYTHONPATH": f"{tmp_path}:{ROOT}"})
    error += f"; install it with python -m pip install {package.replace('PIL', 'pillow')}\n"
    assert (status, out, drop_jit(err)) == (2, "", error)


MODULES = ["tracer", "converters.to_mitsuba", *(f"reference.{m}" for m in ("certify", "compare"))]


@pytest.mark.parametrize("module", MODULES)
def test_help_is_the_same_without_docstrings(module):
    """`python -OO` removes docstrings, which describe most commands."""
    status, out, err = run("--help", python=("-m", module))
    assert (status, drop_jit(err)) == (0, "")
    assert run("--help", python=("-OO", "-m", module))[:2] == (status, out)


START = "the command cannot start: not enough memory; give it more memory, or install it again\n"
# The number of threads is 1, unless the user has chosen another.
THREADS = "return int(os.environ['OPENBLAS_NUM_THREADS'])"


@pytest.mark.parametrize(
    ("code", "environment", "status", "error"),
    [
        ("raise MemoryError", {}, 1, START),
        (THREADS, {}, 1, ""),
        (THREADS, {"OPENBLAS_NUM_THREADS": "2"}, 2, ""),
    ],
)
def test_how_any_command_starts(tmp_path, code, environment, status, error):
    (tmp_path / "other.py").write_text(f"import os\ndef main(): {code}")
    script = "from tracer.command.process import run\nrun('other')"
    result = run(python=("-c", script), env=environment, cwd=tmp_path)
    assert result == (status, "", error)
