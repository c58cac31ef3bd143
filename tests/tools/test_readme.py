"""The pages and the scenes: examples run, links have targets, and figures are those stored."""

import os
import re
import sys
from dataclasses import replace
from importlib.util import find_spec
from io import BytesIO
from pathlib import Path

import pytest
from running import ROOT, run

from reference import regenerate
from reference.command import list_scene_files
from tracer import SceneFileError, load_scene, render, save_scene

README = (ROOT / "README.md").read_text(encoding="utf-8")
PAGES = ["README.md", ".github/CONTRIBUTING.md", *map(str, (ROOT / "reference").glob("*.md"))]


def code_blocks(language: str) -> list[str]:
    """Return the contents of the README's code blocks in a language, such as "python"."""
    return re.findall(rf"^```{language}\n(.*?)^```$", README, re.S | re.M)


def test_the_readme_is_one_page_with_two_commands():
    """One line each: `.ci/run` takes them from here, and runs them in a clean checkout."""
    assert README.count("\n") <= 160
    first, last = (code_blocks("sh")[k].rstrip("\n") for k in (0, -1))
    assert "\n" not in first + last
    assert first.endswith(" && tracer scenes/one-sphere.xml")
    assert last.endswith(" && python -m pytest -q -n auto")
    assert "pip install" in first
    assert "'.[test]'" in last


def stored_speedups(title: str) -> list[str]:
    """Return the speedups over stock Mitsuba from one table of the stored benchmark.

    They are as they are written, from the smallest to the largest.
    """
    page = (ROOT / "reference/benchmark.md").read_text(encoding="utf-8")
    table = page.partition(f"## {title}\n")[2].partition("## ")[0]
    assert " | speedup over stock |\n" in table
    return sorted(re.findall(r"^\| (?!geometric).* ([\d.]+)× \|$", table, re.M), key=float)


def test_speeds_in_the_readme_are_those_of_the_benchmark():
    text = " ".join(README.split())
    low, *_, high = stored_speedups("Whole process: from XML to PNG")
    assert f"Mitsuba 3 takes {low} to {high} times as long." in text
    low, *_, high = stored_speedups("Rendering alone")
    assert f"has {low} times (large pictures) to {high} times (10,000 objects)" in text


@pytest.fixture(scope="module")
def example_folder(tmp_path_factory) -> Path:
    """Run each Python block of the README as a program, and return the folder in which they ran.

    The folder contains copies of the project's scenes, with small pictures.  Worker processes are
    spawned, as on systems without fork.
    """
    folder = tmp_path_factory.mktemp("readme")
    (folder / "scenes").mkdir()
    for path in list_scene_files():
        save_scene(replace(load_scene(path), width=24, height=24), folder / "scenes" / path.name)
    # Python imports this module at its start, in worker processes as well.
    spawn = "import multiprocessing; multiprocessing.set_start_method('spawn')"
    (folder / "sitecustomize.py").write_text(spawn)
    environment = {**os.environ, "PYTHONPATH": f"{folder}{os.pathsep}{ROOT}"}
    for number, block in enumerate(code_blocks("python")):
        file = folder / f"block{number}.py"
        file.write_text(block)
        assert run(file, python=(), cwd=folder, env=environment) == (0, "", "")
    return folder


def test_python_blocks_of_the_readme_write_their_files(example_folder):
    names = {path.name for path in example_folder.iterdir()}
    assert {"ball.xml", "ball.png", *(f"frame-{k:02}.png" for k in range(100))} <= names
    first, half_a_turn = (example_folder / f"frame-{k}.png" for k in ("00", "50"))
    assert first.read_bytes() != half_a_turn.read_bytes()


def test_the_scene_file_in_the_readme_is_the_scene_built_in_python(example_folder):
    (text,) = code_blocks("xml")
    assert load_scene(BytesIO(text.encode())) == load_scene(example_folder / "ball.xml")


def test_the_readme_shows_the_message_for_an_error(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (text,) = code_blocks("xml")
    Path("bad.xml").write_text(text.replace("3 5 4", "3 five 4"))
    with pytest.raises(SceneFileError) as error:
        load_scene("bad.xml")
    assert f"\n```text\n{error.value}\n```\n" in README


USES = """
from pathlib import Path
import numpy as np
import tracer

shader: tracer.Shader = tracer.Phong(diffuse=[1, 0.5, 0], specular=np.ones(3), exponent=9)
ball = tracer.Sphere(center=np.array([1, 2, 3]), radius=np.float32(2), shader=shader)
radius: float = ball.radius
tracer.Camera(proj_distance=np.float32(1.5), view_width=np.int64(2), view_height=3)
tracer.Phong(exponent=np.int8(9))
brick = tracer.Box(min_pt=[0, 0, 0], max_pt=(1.0, 1, 1))
lights = [tracer.PointLight(position=[1, 2, 3], intensity=np.ones(3))]
scene = tracer.Scene(width=4, height=3, lights=lights, surfaces=[ball, brick])
scene = tracer.Scene(width=4, height=3, lights=scene.lights, surfaces=scene.surfaces)
x, y, z = scene.lights[0].position
height: float = ball.center[1] + y
line: int | None = scene.surfaces[0].line
count: int = len(scene.surfaces.center) + len(scene.lights)
tracer.save_scene(scene, Path("scene.xml"))
with open("scene.xml", "rb") as file:
    scene = tracer.load_scene(file)
"""


@pytest.mark.slow
@pytest.mark.parametrize("checker", ["mypy --strict", f"pyright --pythonpath {sys.executable}"])
def test_types_of_documented_usage(checker, tmp_path):
    (tmp_path / "example.py").write_text("\n".join(code_blocks("python")))
    (tmp_path / "uses.py").write_text(USES)
    files = tmp_path / "example.py", tmp_path / "uses.py"
    status, out, err = run(*files, python=("-m", *checker.split()), cwd=ROOT)
    assert status == 0, out + err


@pytest.mark.parametrize("page", PAGES)
def test_links_have_targets(page):
    path = ROOT / page
    links = re.findall(r"\]\(([^)]+)\)", path.read_text(encoding="utf-8"))
    missing = [link for link in links if "://" not in link and not (path.parent / link).exists()]
    assert missing == []


def test_documented_commands_exist():
    text = "\n".join((ROOT / page).read_text(encoding="utf-8") for page in PAGES)
    modules = set(re.findall(r"-m ((?:tracer|converters|reference)[.\w]*)", text))
    assert len(modules) >= 5
    assert [module for module in modules if find_spec(module) is None] == []


def test_the_map_names_every_module_of_the_tracer():
    text = (ROOT / "reference/map.md").read_text(encoding="utf-8")
    modules = {path.stem for path in (ROOT / "tracer").rglob("*.py")} - {"__init__", "__main__"}
    assert modules - set(re.findall(r"`(\w+)`", text)) == set()


def test_the_sheet_shows_every_scene(monkeypatch):
    """Five square scenes and nine wide ones make a row and three."""
    monkeypatch.setattr(regenerate, "_SAMPLES_PER_PIXEL", 1)
    assert regenerate.render_sheet(list_scene_files()).size == (960, 4 * (175 + 22) + 3 * 12)


def test_converted_files_are_not_among_the_own_scenes(tmp_path, monkeypatch):
    monkeypatch.setattr("reference.command.SCENES", tmp_path)
    for name in ("room.xml", "room.mitsuba.xml", "ball.xml"):
        (tmp_path / name).touch()
    assert [path.name for path in list_scene_files()] == ["ball.xml", "room.xml"]


@pytest.mark.filterwarnings("error::tracer.SceneWarning")
@pytest.mark.parametrize("path", list_scene_files(), ids=lambda path: path.stem)
def test_a_scene_is_described_and_exposed_well(path):
    source = path.read_text(encoding="utf-8")
    assert source.startswith("<!-- ")
    assert source.index("-->") > 40
    image = render(load_scene(path))
    is_lit = image.any(axis=2)
    assert is_lit.mean() > 0.1
    assert (image[is_lit].min(axis=1) > 1).mean() < 0.05
