"""The README keeps its word."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest
from scene_files import small_one

from reference import sheet
from reference.command import own_scenes
from tracer import SceneFileError, load_scene

ROOT = Path(__file__).resolve().parent.parent
README = (ROOT / "README.md").read_text(encoding="utf-8")


def blocks(language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```$", README, re.S | re.M)


def test_first_two_commands() -> None:
    """One line each: what `.ci/run` takes from here and runs in a clean checkout."""
    render, test = (block.rstrip("\n") for block in blocks("sh")[:2])
    assert "\n" not in render + test
    assert render.endswith(" -m tracer scenes/one-sphere.xml")
    assert "pip install" in render
    assert test.endswith(" -m pytest -q")
    assert "'.[test]'" in test


def test_python_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "scenes").symlink_to(ROOT / "scenes")
    monkeypatch.chdir(tmp_path)
    space: dict[str, object] = {}
    for block in blocks("python"):
        exec(block, space)
    assert (tmp_path / "four-spheres.png").exists()


def test_the_scene_file_is_the_scene_in_python(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (file,) = blocks("xml")
    space: dict[str, object] = {}
    exec(blocks("python")[-1], space)
    monkeypatch.chdir(tmp_path)
    Path("good.xml").write_text(file)
    assert load_scene("good.xml") == space["scene"]
    # And its fault is told as it says.
    Path("bad.xml").write_text(file.replace("3 5 4", "3 five 4"))
    with pytest.raises(SceneFileError) as told:
        load_scene("bad.xml")
    assert f"\n```\n{told.value}\n```\n" in README


def heading(line: str) -> str:
    """How a link calls a heading."""
    return re.sub(r"[^\w -]", "", line.lower()).replace(" ", "-")


@pytest.mark.parametrize("page", ["README.md", "reference/README.md", "reference/benchmark.md"])
def test_links_lead_somewhere(page: str) -> None:
    path = ROOT / page
    links = re.findall(r"\]\(([^)]+)\)", path.read_text(encoding="utf-8"))
    local = [link.partition("#") for link in links if not link.startswith("https://")]
    for name, _, part in local:
        target = path.parent / name if name else path
        assert target.exists(), name
        headings = (
            re.findall(r"^#+ (.+)$", target.read_text(encoding="utf-8"), re.M) if part else []
        )
        assert not part or part in map(heading, headings), part


def test_commands_exist() -> None:
    modules = set(re.findall(r"-m ((?:tracer|converters|reference)[.\w]*)", README))
    assert len(modules) >= 5
    files = [ROOT / module.replace(".", "/") for module in modules]
    assert [file for file in files if not (file.with_suffix(".py").exists() or file.is_dir())] == []


def test_layout_names_every_module_after_those_it_imports() -> None:
    layout = README.partition("## What is where")[2].partition("converters/")[0]
    order = re.findall(r"^    (\w+) ", layout, re.MULTILINE)
    modules = {path.stem: path for path in (ROOT / "tracer").glob("*.py")}
    assert set(order) == modules.keys() - {"__init__"}
    for place, module in enumerate(order):
        tree = ast.parse(modules[module].read_text(encoding="utf-8"))
        imported = {node.module for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
        above = {f"tracer.{name}" for name in order[:place]}
        assert {name for name in imported if f"{name}".startswith("tracer.")} <= above, module


def test_sheet_shows_every_scene(monkeypatch: pytest.MonkeyPatch) -> None:
    """Five square scenes and nine wide ones make a row and three."""
    monkeypatch.setattr(sheet, "_SAMPLES", 1)
    image = sheet.sheet(own_scenes())
    square = (960 - 4 * 12) // 5 + 22
    wide = round(180 * ((960 - 2 * 12) // 3) / 320) + 22
    assert image.size == (960, square + 3 * wide + 3 * 12)


def test_a_row_of_the_sheet_is_as_high_as_its_tallest_scene(tmp_path: Path) -> None:
    paths = []
    for name, size in (("flat", "40 20"), ("tall", "20 40")):
        (tmp_path / name).mkdir()
        paths.append(small_one(tmp_path / name, size))
    assert sheet.sheet(paths).size == (960, 2 * ((960 - 2 * 12) // 3) + 22)
