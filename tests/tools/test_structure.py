"""The weight of the project, and the order of its modules: whoever raises a budget says why."""

import ast
import io
from functools import cache
from pathlib import Path
from tokenize import COMMENT, DEDENT, ENDMARKER, INDENT, NEWLINE, NL, generate_tokens

import pytest

ROOT = Path(__file__).resolve().parents[2]

# Lines of a folder at most; these are to come down to 6,300, 1,150, 4,700 and 7,000.
BUDGET = {"tracer": 7940, "converters": 1100, "reference": 5577, "tests": 7680}
# Lines of code of the tracer (not blank, no comment, no docstring), lines of each module, and the
# longest chain of modules that import each other.
CODE, MODULE, DEPTH = 4170, 640, 13

# Packages and modules of the tracer, from the lowest.
LAYERS = ["version", "arrays", "messages", "files", "scene", "geometry", "world", "trace"]
LAYERS += ["antialias", "picture", "command", "__init__", "__main__"]

BLANK = {COMMENT, DEDENT, ENDMARKER, INDENT, NEWLINE, NL}
DOCUMENTED = (ast.Module, ast.ClassDef, ast.FunctionDef)


def modules(folder: str) -> dict[str, Path]:
    """All modules below a folder by name."""
    paths = sorted((ROOT / folder).rglob("*.py"))
    return {".".join(path.relative_to(ROOT).with_suffix("").parts): path for path in paths}


def lines(path: Path) -> int:
    return path.read_text(encoding="utf-8").count("\n")


def lines_of_code(path: Path) -> int:
    """Lines that are not blank, no comment and no docstring."""
    text = path.read_text(encoding="utf-8")
    code, documentation = set[int](), set[int]()
    for token in generate_tokens(io.StringIO(text).readline):
        if token.type not in BLANK:
            code |= {*range(token.start[0], token.end[0] + 1)}
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, DOCUMENTED) and ast.get_docstring(node):
            documentation |= {*range(node.body[0].lineno, (node.body[0].end_lineno or 0) + 1)}
    return len(code - documentation)


def imports(path: Path) -> set[str]:
    """Every `module` and `module.name` that a module imports, wherever."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.Call) and ast.unparse(node.func) in ("import_module", "run"):
            found |= {arg.value for arg in node.args if isinstance(arg, ast.Constant)}
        elif isinstance(node, ast.ImportFrom):
            assert not node.level, f"{path}: a relative import"
            found |= {node.module or ""} | {f"{node.module}.{alias.name}" for alias in node.names}
    return found


@pytest.mark.parametrize("folder", BUDGET)
def test_no_folder_exceeds_its_budget(folder: str) -> None:
    total = sum(map(lines, modules(folder).values()))
    assert 0 < total <= BUDGET[folder]


def test_the_tracer_is_small_enough_to_read() -> None:
    paths = modules("tracer")
    assert sum(map(lines_of_code, paths.values())) <= CODE
    assert {name: lines(path) for name, path in paths.items() if lines(path) > MODULE} == {}


def layer(module: str) -> int:
    """How high a module stands: it may import what stands as high, or lower."""
    package, *inner = module.split(".")
    if package != "tracer":
        return len(LAYERS) + ["converters", "reference", "tests"].index(package)
    return LAYERS.index(inner[0]) if inner else len(LAYERS)


def test_data_goes_one_way() -> None:
    """No two packages import each other, whether at the top of a module or in a function."""
    names = {name.removesuffix(".__init__") for f in BUDGET for name in modules(f)}
    upwards = {
        (name, used)
        for folder in BUDGET
        for name, path in modules(folder).items()
        for used in imports(path) & names
        if layer(used) > layer(name.removesuffix(".__init__"))
    }
    assert upwards == {("tracer.scene.model", "tracer.picture.render")}


def test_the_tracers_modules_import_downwards() -> None:
    """No cycle, no long chains, and nothing through the face of a package."""
    paths = modules("tracer")
    faces = {name.removesuffix(".__init__") for name in paths if name.endswith(".__init__")}
    uses = {name: imports(path) & set(paths) for name, path in paths.items()}
    uses["tracer.scene.model"] -= {"tracer.picture.render"}

    @cache
    def depth(name: str, above: tuple[str, ...] = ()) -> int:
        assert name not in above, f"a cycle: {above}"
        return 1 + max((depth(other, (*above, name)) for other in uses[name]), default=0)

    # Without the one line that starts all of it.
    assert max(map(depth, {*paths} - {"tracer.__main__"})) <= DEPTH
    # A submodule is no name that a package gathers; the version stands at the top.
    allowed = {*paths, *faces, "tracer.__version__"}
    for name, path in paths.items():
        taken = {each for each in imports(path) if each.rpartition(".")[0] in faces}
        assert taken <= allowed, name


@pytest.mark.parametrize("folder", ["converters", "reference"])
def test_other_packages_use_the_public_names_alone(folder: str) -> None:
    import tracer

    shared = ("tracer.command.", "tracer.files", "tracer.messages", "tracer.picture.parallel")
    public = {f"tracer.{name}" for name in tracer.__all__} | {"tracer", "tracer.__version__"}
    # The certificate asks what single samples see, and for objects by directions from lights.
    paths = modules(folder)
    paths.pop("reference.judges.faces", None)
    for name, path in paths.items():
        used = {each for each in imports(path) if each.partition(".")[0] == "tracer"}
        assert {each for each in used if not each.startswith(shared)} <= public, name


@pytest.mark.parametrize("folder", ["converters", "reference"])
def test_commands_start_alike(folder: str) -> None:
    """What has a `main` runs it under the one handling of signals, before it imports the rest."""
    start = ["from __future__ import annotations", "from tracer.command.process import run"]
    start += ["if __name__ == '__main__':\n    run(__spec__.name)"]
    commands = 0
    for name, path in modules(folder).items():
        tree = ast.parse(path.read_text(encoding="utf-8"))
        text = [ast.unparse(node) for node in tree.body]
        if any(line.startswith("def main(") for line in text):
            assert text[1:4] == start, name
            commands += 1
        else:
            assert not any("__main__" in line for line in text), name
        assert "signal.signal" not in "".join(text), name
    assert commands
