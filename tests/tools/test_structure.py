"""Limits of size, and the direction of imports: no module imports one of a higher layer.

Sizes are counted in lines of code.  Blank lines, comments and docstrings are free.  The header of a
function counts as one line, and so does a field of a record, however the formatter divides them.
"""

import ast
import io
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path
from tokenize import COMMENT, DEDENT, ENDMARKER, INDENT, NEWLINE, NL, generate_tokens
from typing import NamedTuple

import pytest

ROOT = Path(__file__).resolve().parents[2]


FOLDERS = ("tracer", "converters", "reference", "tests")
# Maximum lines of code in a module.
MAX_MODULE_LINES = 300

# Maximum lines of code in a function.
MAX_FUNCTION_LINES = 45

# Maximum number of modules of the tracer in a chain in which each imports the next.
MAX_DEPTH = 16

# Packages and modules of the tracer, from the lowest layer to the highest.
LAYERS = ["version", "arrays", "messages", "children", "files", "scene", "geometry", "world"]
LAYERS += ["trace", "antialias", "picture", "command", "__init__", "__main__"]

# Types of tokens that do not make a line a line of code.
NO_CODE = {COMMENT, DEDENT, ENDMARKER, INDENT, NEWLINE, NL}


class Module(NamedTuple):
    """A module of the project, parsed."""

    tree: ast.Module
    code_lines: set[int]  # the line numbers of all lines of code
    imports: set[str]  # every `module` and `module.name`, also those imported inside functions


@cache
def parse_folder(folder: str) -> dict[str, Module]:
    """Parse all modules in a folder of the project and its subfolders.

    The keys are names such as "tracer.scene.model".
    """
    paths = sorted((ROOT / folder).rglob("*.py"))
    names = [".".join(path.relative_to(ROOT).with_suffix("").parts) for path in paths]
    return dict(zip(names, map(parse_module, paths), strict=True))


def parse_module(path: Path) -> Module:
    """Parse a Python file, find its lines of code, and collect the names that it imports."""
    source = path.read_text(encoding="utf-8")
    tree = ast.parse(source)
    code_lines = set[int]()
    for token in generate_tokens(io.StringIO(source).readline):
        if token.type not in NO_CODE:
            code_lines |= {*range(token.start[0], token.end[0] + 1)}
    for node in ast.walk(tree):
        # A string that stands alone is a docstring, or documents the attribute above it.
        if isinstance(node, ast.Expr) and isinstance(getattr(node.value, "value", None), str):
            code_lines -= {*range(node.lineno, (node.end_lineno or 0) + 1)}
        elif isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            code_lines -= {*range(node.lineno + 1, node.body[0].lineno)}
        elif isinstance(node, ast.AnnAssign):
            code_lines -= {*range(node.lineno + 1, (node.end_lineno or 0) + 1)}
    return Module(tree=tree, code_lines=code_lines, imports=imported_names(tree))


def imported_names(tree: ast.Module) -> set[str]:
    """Return the names of all modules, and of all objects in them, that a module imports.

    For "from package.module import name", they are "package.module" and "package.module.name".
    Imports inside functions are included, and so are constant arguments of `import_module` and
    `run`.  A relative import fails.
    """
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


def test_no_function_and_no_module_is_too_long() -> None:
    too_long = []
    modules = {name: m for folder in FOLDERS for name, m in parse_folder(folder).items()}
    for name, (tree, code_lines, _) in modules.items():
        too_long += [f"{name}: {len(code_lines)}"] * (len(code_lines) > MAX_MODULE_LINES)
        for node in ast.walk(tree):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                count = len(code_lines & {*range(node.lineno, (node.end_lineno or 0) + 1)})
                too_long += [f"{name}.{node.name}: {count}"] * (count > MAX_FUNCTION_LINES)
    assert too_long == []


def layer_height(module: str) -> int:
    """Return the height, from 0, of the layer to which a module belongs.

    A module may import modules of its own layer and of lower layers.
    """
    package, *inner_names = module.split(".")
    if package != "tracer":
        return len(LAYERS) + ["converters", "reference", "tests"].index(package)
    return LAYERS.index(inner_names[0]) if inner_names else len(LAYERS)


def test_no_module_imports_a_higher_layer() -> None:
    imports = {
        name.removesuffix(".__init__"): module.imports
        for folder in FOLDERS
        for name, module in parse_folder(folder).items()
    }
    upwards = [
        (name, imported)
        for name in imports
        for imported in imports[name] & imports.keys()
        if layer_height(imported) > layer_height(name)
    ]
    assert upwards == []


def test_imports_in_the_tracer_are_direct_and_form_no_cycle() -> None:
    tracer = parse_folder("tracer")
    packages = {name.removesuffix(".__init__") for name in tracer if name.endswith(".__init__")}
    imports = {name: module.imports & set(tracer) for name, module in tracer.items()}
    del imports["tracer.__main__"]  # is one import above the whole command
    # For each module, the number of modules in the longest chain of imports that begins with it.
    depths = dict[str, int]()
    for name in TopologicalSorter(imports).static_order():  # raises CycleError
        depths[name] = 1 + max((depths[imported] for imported in imports[name]), default=0)
    assert max(depths.values()) <= MAX_DEPTH
    # A name is imported from the module that defines it, not from its package.
    allowed = {*tracer, *packages, "tracer.__version__"}
    for name, module in tracer.items():
        from_packages = {each for each in module.imports if each.rpartition(".")[0] in packages}
        assert from_packages <= allowed, name


@pytest.mark.parametrize("folder", ["converters", "reference"])
def test_other_packages_use_only_public_names_of_the_tracer(folder: str) -> None:
    import tracer

    shared = ("tracer.command.", "tracer.files", "tracer.messages", "tracer.picture.parallel")
    public = {f"tracer.{name}" for name in tracer.__all__} | {"tracer", "tracer.__version__"}
    # The certificate needs to know which surface each sample hits, and uses the light grid.  The
    # script that measures mechanisms counts the tests of both shapes.
    internal = {"reference.judges.certified_scene", "reference.judges.shadow_volumes"}
    internal |= {"reference.measured.counted_render"}
    for name, module in parse_folder(folder).items():
        if name not in internal:
            imported = {each for each in module.imports if each.partition(".")[0] == "tracer"}
            assert {each for each in imported if not each.startswith(shared)} <= public, name


@pytest.mark.parametrize("folder", ["converters", "reference"])
def test_every_command_handles_signals_before_it_imports_the_rest(folder: str) -> None:
    start = ["from __future__ import annotations", "from tracer.command.process import run"]
    start += ["if __name__ == '__main__':\n    run(__spec__.name)"]
    command_count = 0
    for name, module in parse_folder(folder).items():
        statements = [ast.unparse(node) for node in module.tree.body]
        if any(getattr(node, "name", "") == "main" for node in module.tree.body):
            assert statements[1:4] == start, name
            command_count += 1
        else:
            assert not any("__main__" in statement for statement in statements), name
        assert "signal.signal" not in "".join(statements), name
    assert command_count


# Types of arrays, which have a shape.
ARRAYS = {"Floats", "Ints", "Bools", "Sides", "Triple", "NDArray", "Points2D", "Codes"}

# Functions and classes for users, who have only `help()`: shapes are in numpydoc.
PUBLIC = {
    "tracer.picture.png.to_codes",
    "tracer.picture.render.render",
    "tracer.trace.first_hits.FirstHits",
}

# Modules of which some arrays have no shape yet.
WITHOUT_SHAPES = {
    "tracer.scene.model",
    "tracer.scene.schema",
}


def find_arrays_without_shape(node: ast.AST) -> list[str]:
    """Return the types of arrays in an annotation that are not in `Shaped[...]`.

    Arguments of callables are not checked.
    """
    if isinstance(node, ast.Subscript) and ast.unparse(node.value) in ("Shaped", "Callable"):
        return []
    if isinstance(node, ast.Name) and node.id in ARRAYS:
        return [node.id]
    children = ast.iter_child_nodes(node)
    return [name for child in children for name in find_arrays_without_shape(child)]


def list_annotations(owner: ast.AST) -> list[ast.expr]:
    """Return the annotations in the header of a function, or of the fields of a class."""
    if isinstance(owner, ast.FunctionDef):
        arguments = [each for each in ast.walk(owner.args) if isinstance(each, ast.arg)]
        annotations = [*(each.annotation for each in arguments), owner.returns]
        return [each for each in annotations if each]
    if isinstance(owner, ast.ClassDef):
        return [each.annotation for each in owner.body if isinstance(each, ast.AnnAssign)]
    return []


@pytest.mark.parametrize("folder", ["tracer", "converters", "reference"])
def test_arrays_in_signatures_and_fields_have_shapes(folder: str) -> None:
    places = {
        f"{name}.{owner.name}"
        for name, module in parse_folder(folder).items()
        if name not in WITHOUT_SHAPES
        for owner in ast.walk(module.tree)
        if any(find_arrays_without_shape(each) for each in list_annotations(owner))
    }
    assert places <= PUBLIC


@pytest.mark.parametrize("folder", ["tracer", "converters", "reference"])
def test_no_alias_hides_a_shape_from_the_checker(folder: str) -> None:
    for name, module in parse_folder(folder).items():
        aliases = {
            ast.unparse(node.target)
            for node in module.tree.body
            if isinstance(node, ast.AnnAssign) and node.value and "Shaped[" in ast.unparse(node)
        }
        assert all(alias.startswith("_") for alias in aliases), f"{name}: only this module uses it"
        # The checker looks for the word Shaped in the annotations, and then resolves all of them.
        for owner in ast.walk(module.tree):
            annotations = [ast.unparse(annotation) for annotation in list_annotations(owner)]
            has_alias = not aliases.isdisjoint(annotations)
            assert not has_alias or "Shaped[" in "".join(annotations), f"{name}: {annotations}"
