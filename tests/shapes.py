"""Check the shapes and types of arrays that annotations state, in every call, while tests run.

`Shaped[Floats, "3 n"]` states a shape in the notation of jaxtyping.  Its parts are

- a name: the dimension has the same size wherever the name occurs in a call.  If an argument of
  type int has this name, it is the size;
- `n+1`: the same, plus 1;
- a number, or a formula without spaces (`4*cells+1`) of names that occur before it;
- `#n`: as `n`, or 1, for arrays that are broadcast together;
- `...`: any number of dimensions.

In a container, `Shaped[Triple, "n"]` or `Shaped[list[Floats], "n"]` states one shape of all arrays;
`list[Shaped[Floats, "n"]]` may have another `n` in each item.  A method also knows the names in the
fields of its class.  Fields are checked when an object is created, and again by each method whose
own annotations have one of their names.  Results of generators are checked item by item: a name
that occurs only there may have another size in each item.  All other types are left to mypy.

Not checked are functions and classes inside functions, lambdas, functions that a module stores
while it is imported in anything but a dictionary, items of iterators that are arguments, arguments
of callables, and all code in processes that are not forked.  Functions and classes are checked if
the word Shaped is in their annotations; the name of an alias that contains it is not enough.

All data of a call are local to it, so several threads may call a function at the same time.
"""

import inspect
import os
import re
import sys
from collections.abc import Callable, Sequence
from functools import cache, cached_property, lru_cache, wraps
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder, SourceFileLoader
from types import FunctionType, ModuleType
from typing import Any, NamedTuple, get_args, get_origin, get_type_hints

from shape_hints import NAMESPACE, OPAQUE, Sizes, Test, refer, write_test

# Stands for an argument or a field that is not given.
_MISSING = object()


class ShapeError(AssertionError):
    """An array whose shape or type contradicts its annotation.

    It is no TypeError or ValueError, which the checked code may catch.
    """

    def __init__(self, place: str, value: Any, hint: Any, sizes: Sizes) -> None:
        super().__init__(f"{place} is {describe(value)}, but should be {hint} with {sizes}")


def describe(value: Any) -> str:
    """Return the types and shapes of the arrays in a value."""
    if isinstance(value, tuple | list):
        return f"({', '.join(map(describe, value))})"
    return f"{value.dtype}{list(value.shape)}" if hasattr(value, "dtype") else repr(value)[:50]


class _Check(NamedTuple):
    """What is checked of a value."""

    place: str  # for messages
    hint: Any  # the annotation
    test: Test

    def write(self, expression: str, indent: str = "    ") -> list[str]:
        """Write statements that check the value of an expression."""
        error = f"{refer(ShapeError)}({self.place!r}, value, {refer(self.hint)}, sizes)"
        return [
            f"{indent}value = {expression}",
            f"{indent}if value is not {refer(_MISSING)} and not ({self.test}): raise {error}",
        ]


class _Fields(NamedTuple):
    """What is checked of the objects of a class."""

    sizes: list[str]  # names of the fields of type int
    checks: dict[str, _Check]  # fields with a shape, by name

    def write(self, instance: str, names: set[str] | None = None) -> list[str]:
        """Write statements that check the fields of an object.

        If `names` are given, check only the fields that determine the sizes of these names, if
        they are set already: `__init__` may call methods.
        """
        lines = []
        for name in self.sizes:
            if names is None or name in names:
                lines += [f"    if hasattr({instance}, {name!r}):"]
                lines += [f"        sizes[{name!r}] = {instance}.{name}"]
        for name, check in self.checks.items():
            if names is None:
                lines += check.write(f"{instance}.{name}")
            elif names & find_names(check.hint):
                lines += check.write(f"getattr({instance}, {name!r}, {refer(_MISSING)})")
        return lines


def find_names(annotation: str) -> set[str]:
    """Find the names of dimensions in the source code of an annotation."""
    shapes = re.findall(r"""["'](.*?)["']""", annotation)
    return {name for shape in shapes for name in re.findall(r"[^\W\d]\w*", shape)}


@cache
def find_fields(owner: type) -> _Fields:
    """Find the sizes and the shapes in the fields of a class and its bases."""
    annotations = [inspect.get_annotations(base) for base in reversed(owner.__mro__)]
    if "Shaped" not in str(annotations):
        return _Fields(sizes=[], checks={})
    texts = {
        name: str(getattr(hint, "__forward_arg__", hint))  # NamedTuple makes ForwardRefs of strings
        for each in annotations
        for name, hint in each.items()
    }
    hints = get_type_hints(owner, include_extras=True)
    return _Fields(
        sizes=[name for name, hint in hints.items() if hint is int],
        checks={
            name: _Check(f"{owner.__qualname__}.{name}", texts[name], test)
            for name, hint in hints.items()
            if (test := write_test(hint))
        },
    )


def _compile_definition(lines: Sequence[str]) -> Callable[..., Any]:
    """Compile the source code of a function named `checked`."""
    names: dict[str, Any] = {}
    # The name is that of no file, of which tracebacks would quote unrelated lines.
    exec(compile("\n".join(lines), "<checks of shapes>", "exec"), NAMESPACE, names)
    checked: Callable[..., Any] = names["checked"]
    return checked


@cache
def compile_function(function: Callable[..., Any], owner: type | None) -> Callable[..., Any]:
    """Compile a function that checks the arguments and the results of another one."""
    texts = function.__annotations__
    hints = get_type_hints(function, include_extras=True)
    is_iterator = get_origin(hints.get("return")) in OPAQUE - {Callable}
    if is_iterator:
        hints["return"] = get_args(hints["return"])[0]
    place = function.__qualname__
    checks = {
        name: _Check(f"{place}: {name}", texts[name], test)
        for name, hint in hints.items()
        if (test := write_test(hint))
    }
    names = find_names(" ".join(map(str, texts.values())))
    lines = ["def checked(*args, **kwargs):", "    count = len(args)", "    sizes = {}"]
    if owner:
        lines += find_fields(owner).write("args[0]", names)
    value_lines = []
    for index, parameter in enumerate(inspect.signature(function).parameters.values()):
        name = parameter.name
        expression = f"kwargs.get({name!r}, {refer(_MISSING)})"
        if parameter.kind <= parameter.POSITIONAL_OR_KEYWORD:
            expression = f"args[{index}] if count > {index} else {expression}"
        if parameter.kind == parameter.VAR_POSITIONAL:
            if name in checks:
                value_lines += [f"    for each in args[{index}:]:"]
                value_lines += checks[name].write("each", indent="        ")
        elif name in checks:
            value_lines += checks[name].write(expression)
        elif name in names:
            lines += [f"    value = {expression}"]
            lines += [f"    if isinstance(value, int): sizes[{name!r}] = value"]
    lines += value_lines
    call = f"{refer(function)}(*args, **kwargs)"
    if "return" not in checks:
        lines += [f"    return {call}"]
    elif is_iterator:
        lines += [f"    return {refer(_compile_items(place, checks['return']))}({call}, sizes)"]
    else:
        check = checks["return"]._replace(place=f"{place}: result")
        lines += [*check.write(call), "    return value"]
    return _compile_definition(lines)


def _compile_items(place: str, check: _Check) -> Callable[..., Any]:
    """Compile a generator that checks items, each with the same known sizes, and yields them."""
    item_check = check._replace(place=f"{place}: item")
    return _compile_definition(
        [
            "def checked(items, known_sizes):",
            "    for item in items:",
            "        sizes = dict(known_sizes)",
            *item_check.write("item", indent="        "),
            "        yield item",
        ]
    )


def wrap(function: Callable[..., Any], owner: type | None = None) -> Callable[..., Any]:
    """Make a function check its arguments and results.

    The names in the fields of a class, `owner`, are known if the first argument is an instance.
    """
    if "Shaped" not in str(function.__annotations__.values()):
        return function

    # Annotations may name what the module defines later, so they are evaluated by the first call.
    @wraps(function)
    def checked(*args: Any, **kwargs: Any) -> Any:
        return compile_function(function, owner)(*args, **kwargs)

    return checked


def wrap_class(owner: Any) -> None:
    """Make a class check its fields, and the arguments and results of its methods."""
    dataclass_options = vars(owner).get("__dataclass_params__")
    is_init_generated = dataclass_options is not None and dataclass_options.init
    for name, member in list(vars(owner).items()):
        if name == "__new__" or (name == "__init__" and is_init_generated):
            continue  # that of a NamedTuple or a dataclass has its fields as arguments
        if isinstance(member, FunctionType):
            # Fields do not exist before __init__.
            setattr(owner, name, wrap(member, None if name == "__init__" else owner))
        elif isinstance(member, classmethod | staticmethod):
            setattr(owner, name, type(member)(wrap(member.__func__)))
        elif isinstance(member, property) and member.fget:
            setattr(owner, name, member.getter(wrap(member.fget, owner)))
        elif isinstance(member, cached_property):
            member.func = wrap(member.func, owner)
    fields = find_fields(owner)
    if not fields.checks:
        return
    check_fields = _compile_definition(
        ["def checked(instance):", "    sizes = {}", *fields.write("instance")]
    )
    is_tuple = issubclass(owner, tuple)
    create = owner.__new__ if is_tuple else owner.__init__

    @wraps(create)
    def checked_create(first: Any, *args: Any, **kwargs: Any) -> Any:
        result = create(first, *args, **kwargs)
        check_fields(result if is_tuple else first)
        return result

    if is_tuple:
        owner.__new__ = checked_create
        owner._make = classmethod(lambda cls, values: cls(*values))
    else:
        owner.__init__ = checked_create


def wrap_module(module: ModuleType) -> None:
    """Make the functions and classes of a module check their shapes.

    Functions in dictionaries of the module are replaced, too.
    """
    tables = [value for value in vars(module).values() if isinstance(value, dict)]
    for name, value in list(vars(module).items()):
        if getattr(value, "__module__", None) != module.__name__:
            continue
        if isinstance(value, FunctionType):
            setattr(module, name, checked := wrap(value))
            for table in tables:
                table |= {key: checked for key, each in table.items() if each is value}
        elif isinstance(value, type):
            wrap_class(value)
        elif hasattr(value, "cache_parameters"):
            checked = wrap(value.__wrapped__)
            setattr(module, name, lru_cache(**value.cache_parameters())(checked))


class _Loader(SourceFileLoader):
    def exec_module(self, module: ModuleType) -> None:
        super().exec_module(module)
        wrap_module(module)


class _Finder(MetaPathFinder):
    def __init__(self, packages: tuple[str, ...]) -> None:
        self.packages = packages

    def find_spec(self, fullname: str, path: Any = None, target: Any = None) -> ModuleSpec | None:
        if fullname.partition(".")[0] not in self.packages:
            return None
        spec = PathFinder.find_spec(fullname, path, target)
        if spec and isinstance(spec.loader, SourceFileLoader):
            spec.loader = _Loader(spec.loader.name, spec.loader.path)
        return spec


def install(*packages: str) -> None:
    """Check shapes in all modules of these packages, which must not be imported yet."""
    assert not any(name.partition(".")[0] in packages for name in sys.modules)
    if os.environ.get("CHECK_SHAPES") != "0":
        sys.meta_path.insert(0, _Finder(packages))
