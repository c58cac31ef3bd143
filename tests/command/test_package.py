"""The names that `import tracer` gives, when they are imported, and the contents of a wheel."""

import importlib.util
import os
import pickle
import pydoc
import re
import site
import subprocess
import sys
import venv
import weakref
from pathlib import Path
from typing import Any

import pytest

import tracer


def test_public_names_are_imported_on_first_use():
    script = """
import sys
import tracer
assert set(tracer.__all__) < set(dir(tracer))
assert "numpy" not in sys.modules
for name in tracer.__all__:
    assert name == "Shader" or getattr(tracer, name).__name__ == name
"""
    subprocess.run([sys.executable, "-c", script], check=True, timeout=60)
    with pytest.raises(AttributeError, match="module 'tracer' has no attribute 'ray'"):
        _ = tracer.ray


def test_help_shows_the_public_names():
    text = pydoc.render_doc(tracer, renderer=pydoc.plaintext)
    shown = re.findall(r"^    (?:class )?(\w+)(?:\(| = )", text, re.MULTILINE)
    assert set(shown) == set(tracer.__all__)


def test_a_notebook_shows_a_scene_from_a_pickle():
    """No public name of the package has been used there."""
    script = """
import pickle, sys
scene = pickle.load(sys.stdin.buffer)
assert scene._repr_png_().startswith(b"\\x89PNG")
"""
    pickled_scene = pickle.dumps(tracer.Scene(width=3, height=2))
    python = [sys.executable, "-W", "ignore", "-c", script]
    subprocess.run(python, input=pickled_scene, check=True, timeout=60)


def test_scenes_can_be_keys_of_a_weak_dictionary():
    scene = tracer.Scene(width=3, height=2, surfaces=[tracer.Sphere()])
    assert weakref.ref(scene)() is scene
    assert weakref.ref(scene.surfaces)() is scene.surfaces


@pytest.mark.slow
def test_a_wheel_renders_and_converts(tmp_path):
    """The wheel is used outside of the checkout, with the dependencies of this environment."""
    root = Path(tracer.__file__).parents[1]
    isolation = ["--no-build-isolation"] if importlib.util.find_spec("hatchling") else []
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check"]

    def run(*command: object, **options: Any) -> str:
        options |= {"check": True, "cwd": tmp_path, "timeout": 300, "capture_output": True}
        return subprocess.run([*map(str, command)], **options, text=True).stdout

    run(*pip, "wheel", "-q", "--no-deps", *isolation, "-w", tmp_path, root)
    (wheel,) = tmp_path.glob("*.whl")
    venv.create(tmp_path / "new", with_pip=False)
    python = tmp_path / "new" / "bin" / "python"
    (packages,) = (tmp_path / "new").glob("lib/python*/site-packages")
    run(*pip, "install", "-q", "--no-deps", "--target", packages, wheel)
    (packages / "dependencies.pth").write_text("\n".join(site.getsitepackages()))
    (tmp_path / "ball.xml").write_text(
        "<scene><camera/><image>30 20</image><surface type='Sphere'/></scene>"
    )
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"}
    for command in ("tracer ball.xml --samples 4", "converters.to_mitsuba ball.xml"):
        run(python, "-m", *command.split(), env=environment)
    path = run(python, "-c", "import tracer; print(tracer.__file__)", env=environment)
    assert path.startswith(str(packages))
    assert {path.name for path in packages.iterdir() if path.is_dir()} == {
        *("tracer", "converters", "bin"),
        f"pencil_tracer-{tracer.__version__}.dist-info",
    }
    assert {"ball.xml.png", "ball.mitsuba.xml"} < {path.name for path in tmp_path.iterdir()}
