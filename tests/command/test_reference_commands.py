"""What the commands of `reference/` say where something that they need is missing."""

from __future__ import annotations

from pathlib import Path

import pytest
from running import run_python, told


@pytest.mark.parametrize(
    ("module", "package"),
    [
        *((m, "mitsuba") for m in ("benchmark", "check", "regenerate", "report")),
        *((m, "PIL") for m in ("compare", "regenerate")),
        *((m, "matplotlib") for m in ("speed_accuracy", "stability")),
    ],
)
def test_a_command_without_its_packages_says_what_to_install(
    tmp_path: Path, module: str, package: str
) -> None:
    missing = f"No module named {package}"
    (tmp_path / f"{package}.py").write_text(
        f"raise ModuleNotFoundError({missing!r}, name={package!r})"
    )
    done = run_python("-m", f"reference.{module}", PYTHONPATH=str(tmp_path))
    name = {"PIL": "pillow"}.get(package, package)
    remedy = f"; install it with python -m pip install {name}\n"
    assert (done.returncode, done.stdout, told(done.stderr)) == (2, "", missing + remedy)
