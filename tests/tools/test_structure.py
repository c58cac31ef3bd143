"""Limits of size, and the direction of imports: no module imports one of a higher layer.

Sizes are counted in lines of code, which are what a reader has to understand.  Blank lines,
comments and docstrings are free.
"""

import ast
import io
import re
from functools import cache
from pathlib import Path
from tokenize import COMMENT, DEDENT, ENDMARKER, INDENT, NEWLINE, NL, generate_tokens
from typing import NamedTuple

import pytest

ROOT = Path(__file__).resolve().parents[2]


def budgets() -> dict[str, int]:
    """Read the table of budgets in CONTRIBUTING: for folders, a module and a function, by name."""
    text = (ROOT / ".github/CONTRIBUTING.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| (?:a |`)(\w+)(?:/`)? \| ([\d,]+) \|$", text, re.M)
    return {name: int(limit.replace(",", "")) for name, limit in rows}


FOLDERS, BUDGET = ("tracer", "converters", "reference", "tests"), budgets()
# Factor by which a folder may exceed its budget.
TOLERANCE = 1.01
# Maximum number of modules of the tracer in a chain in which each imports the next.
MAX_DEPTH = 14

# Packages and modules of the tracer, from the lowest layer to the highest.
LAYERS = ["version", "arrays", "messages", "files", "scene", "geometry", "world", "trace"]
LAYERS += ["antialias", "picture", "command", "__init__", "__main__"]

RULE = "see 'Budgets' in .github/CONTRIBUTING.md"

BLANK = {COMMENT, DEDENT, ENDMARKER, INDENT, NEWLINE, NL}


class Module(NamedTuple):
    """A module of the project, parsed."""

    tree: ast.Module
    code: set[int]
    """Line numbers of the lines of code."""
    imports: set[str]
    """Every `module` and `module.name` that the module imports, also inside functions."""


@cache
def modules(folder: str) -> dict[str, Module]:
    """Parse all modules below a folder; return them by their dotted names."""
    paths = sorted((ROOT / folder).rglob("*.py"))
    return {".".join(path.relative_to(ROOT).with_suffix("").parts): parse(path) for path in paths}


def parse(path: Path) -> Module:
    """Parse one module."""
    text = path.read_text(encoding="utf-8")
    tree, code = ast.parse(text), set[int]()
    for token in generate_tokens(io.StringIO(text).readline):
        if token.type not in BLANK:
            code |= {*range(token.start[0], token.end[0] + 1)}
    for node in ast.walk(tree):
        # A string that stands alone is a docstring, or documents the attribute above it.
        if isinstance(node, ast.Expr) and isinstance(getattr(node.value, "value", None), str):
            code -= {*range(node.lineno, (node.end_lineno or 0) + 1)}
    return Module(tree, code, imports(tree))


def imports(tree: ast.Module) -> set[str]:
    """Return every `module` and `module.name` that a module imports, also inside functions."""
    names: set[str] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.Call) and ast.unparse(node.func) in ("import_module", "run"):
            names |= {arg.value for arg in node.args if isinstance(arg, ast.Constant)}
        elif isinstance(node, ast.ImportFrom):
            assert not node.level, f"a relative import: {ast.unparse(node)}"
            names |= {node.module or ""} | {f"{node.module}.{alias.name}" for alias in node.names}
    return names


@pytest.mark.parametrize("folder", FOLDERS)
def test_no_folder_exceeds_its_budget(folder: str) -> None:
    total, budget = sum(len(module.code) for module in modules(folder).values()), BUDGET[folder]
    excess = f"{folder}/ has {total:,} lines of code, {total - budget:,} more than its budget"
    assert 0 < total <= TOLERANCE * budget, f"{excess} of {budget:,}: {RULE}"


def test_no_function_and_no_module_is_too_long() -> None:
    too_long = []
    for name, (tree, code, _) in (item for folder in FOLDERS for item in modules(folder).items()):
        too_long += [f"{name}: {len(code)}"] * (len(code) > BUDGET["module"])
        for node in ast.walk(tree):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                count = len(code & {*range(node.lineno, (node.end_lineno or 0) + 1)})
                too_long += [f"{name}.{node.name}: {count}"] * (count > BUDGET["function"])
    assert too_long == [], f"too many lines of code: {RULE}"


def layer(module: str) -> int:
    """Return the height of a module's layer; a module may import others as high as itself."""
    package, *inner = module.split(".")
    if package != "tracer":
        return len(LAYERS) + ["converters", "reference", "tests"].index(package)
    return LAYERS.index(inner[0]) if inner else len(LAYERS)


def test_no_module_imports_a_higher_layer() -> None:
    names = {name.removesuffix(".__init__") for folder in FOLDERS for name in modules(folder)}
    upwards = {
        (name, used)
        for folder in FOLDERS
        for name, module in modules(folder).items()
        for used in module.imports & names
        if layer(used) > layer(name.removesuffix(".__init__"))
    }
    # A scene displays itself in a notebook as a picture.
    assert upwards == {("tracer.scene.model", "tracer.picture.render")}


def test_imports_in_the_tracer_are_direct_and_form_no_cycle() -> None:
    tracer = modules("tracer")
    packages = {name.removesuffix(".__init__") for name in tracer if name.endswith(".__init__")}
    uses = {name: module.imports & set(tracer) for name, module in tracer.items()}
    uses["tracer.scene.model"] -= {"tracer.picture.render"}

    @cache
    def depth(name: str, above: tuple[str, ...] = ()) -> int:
        assert name not in above, f"a cycle: {above}"
        return 1 + max((depth(other, (*above, name)) for other in uses[name]), default=0)

    # `__main__` is one import above the whole command.
    assert max(map(depth, {*tracer} - {"tracer.__main__"})) <= MAX_DEPTH
    # A name is imported from the module that defines it, not from its package.
    allowed = {*tracer, *packages, "tracer.__version__"}
    for name, module in tracer.items():
        from_packages = {used for used in module.imports if used.rpartition(".")[0] in packages}
        assert from_packages <= allowed, name


@pytest.mark.parametrize("folder", ["converters", "reference"])
def test_other_packages_use_only_public_names_of_the_tracer(folder: str) -> None:
    import tracer

    shared = ("tracer.command.", "tracer.files", "tracer.messages", "tracer.picture.parallel")
    public = {f"tracer.{name}" for name in tracer.__all__} | {"tracer", "tracer.__version__"}
    # The certificate needs to know which surface each sample hits, and uses the light grid.
    # Illustrations show data structures of the tracer.
    internal = {"reference.judges.faces", "reference.illustrations"}
    for name, module in modules(folder).items():
        if name not in internal:
            used = {each for each in module.imports if each.partition(".")[0] == "tracer"}
            assert {each for each in used if not each.startswith(shared)} <= public, name


@pytest.mark.parametrize("folder", ["converters", "reference"])
def test_every_command_handles_signals_before_it_imports_the_rest(folder: str) -> None:
    start = ["from __future__ import annotations", "from tracer.command.process import run"]
    start += ["if __name__ == '__main__':\n    run(__spec__.name)"]
    commands = 0
    for name, module in modules(folder).items():
        text = [ast.unparse(node) for node in module.tree.body]
        if any(getattr(node, "name", "") == "main" for node in module.tree.body):
            assert text[1:4] == start, name
            commands += 1
        else:
            assert not any("__main__" in line for line in text), name
        assert "signal.signal" not in "".join(text), name
    assert commands
