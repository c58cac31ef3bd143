"""What the commands of `reference/` say where something that they need is missing."""

from __future__ import annotations

import os
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest
from messages import told

ROOT = Path(__file__).resolve().parents[2]


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
    "module", ["benchmark", "regenerate", "report", "speed_accuracy", "stability"]
)
def test_a_command_without_its_packages_says_what_to_install(tmp_path: Path, module: str) -> None:
    (tmp_path / "mitsuba.py").write_text(
        "raise ModuleNotFoundError('No module named mitsuba', name='mitsuba')"
    )
    done = subprocess.run(
        [sys.executable, "-m", f"reference.{module}"],
        capture_output=True,
        text=True,
        cwd=ROOT,
        env=os.environ | {"PYTHONPATH": str(tmp_path)},
        check=False,
    )
    missing = "No module named mitsuba; install it with python -m pip install mitsuba\n"
    assert (done.returncode, done.stdout, told(done.stderr)) == (2, "", missing)
