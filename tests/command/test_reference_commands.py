"""What the commands of `reference/` say where something that they need is missing."""

from __future__ import annotations

import sys
from importlib import import_module
from pathlib import Path

import pytest
from messages import run_python, told


@pytest.mark.parametrize(
    "name", ["benchmark", "generate", "regenerate", "report", "sheet", "speed_accuracy"]
)
def test_a_command_without_the_scenes_says_what_it_needs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    """As where the project is installed without -e."""
    monkeypatch.setattr("reference.command.SCENES", tmp_path)
    output = ["-o", str(tmp_path / "made")] if name in ("regenerate", "report") else []
    monkeypatch.setattr(sys, "argv", [name, *output])
    with pytest.raises(SystemExit, match="2"):
        import_module(f"reference.{name}").main()
    assert capsys.readouterr().err == (
        f"python -m reference.{name}: {tmp_path} holds no scenes;"
        " clone the project, and install it from there with -e\n"
    )


@pytest.mark.parametrize(
    ("module", "package"),
    [
        *((m, "mitsuba") for m in ("benchmark", "check", "regenerate", "report", "stability")),
        *((m, "PIL") for m in ("check", "compare", "report", "sheet")),
        *(("speed_accuracy", package) for package in ("mitsuba", "matplotlib")),
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
