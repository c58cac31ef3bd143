"""Check the shapes and types of arrays that annotations state, in every call, while tests run.

`Shaped[Floats, "3 n"]` states a shape in the notation of jaxtyping.  Its parts are

- a name: the dimension has the same size wherever the name occurs in a call.  If an argument of
  type int has this name, it is the size;
- `n+1`: the same, plus 1;
- a number, or a formula without spaces (`4*cells+1`) of names that occur before it;
- `#n`: as `n`, or 1, for arrays that are broadcast together;
- `...`: any number of dimensions.

In a tuple of arrays, such as `Shaped[Triple, "n"]`, all arrays have this shape.  A method also
knows the names in the fields of its class.  Fields are checked when an object is created, and
results of generators item by item: a name that occurs only there may have another size in each
item.  All other types are left to mypy.
"""

import inspect
import os
import sys
from collections.abc import Callable, Iterator
from functools import cache, cached_property, wraps
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder, SourceFileLoader
from types import FunctionType, ModuleType, UnionType
from typing import Annotated, Any, TypeAlias, Union, get_args, get_origin, get_type_hints

import numpy as np

Sizes: TypeAlias = dict[str, int]
Test: TypeAlias = Callable[[Any, Sizes], bool]


class ShapeError(TypeError):
    """An array whose shape or type contradicts its annotation."""


def compile_shape(text: str) -> Callable[[tuple[int, ...], Sizes], bool]:
    """Return a function that compares a shape with a text, and adds new names to the sizes."""
    parts = text.split()
    fixed = [part for part in parts if part != "..."]
    start = parts.index("...") if len(fixed) < len(parts) else None

    def has_shape(shape: tuple[int, ...], sizes: Sizes) -> bool:
        if start is not None:
            shape = shape[:start] + shape[len(shape) - (len(fixed) - start) :]
        if len(shape) != len(fixed):
            return False
        for size, part in zip(shape, fixed, strict=True):
            if part[0] == "#" and size == 1:
                continue
            part = part.removeprefix("#")
            name, _, increment = part.partition("+")
            if name.isidentifier():
                expected = sizes.setdefault(name, size - int(increment or 0)) + int(increment or 0)
            else:
                expected = eval(part, {}, sizes)
            if size != expected:
                return False
        return True

    return has_shape


def compile_hint(hint: Any, text: str | None = None) -> Test | None:
    """Return a test of the arrays in a value by its type hint; None if there is nothing to test."""
    origin, arguments = get_origin(hint), get_args(hint)
    if origin is Annotated:
        return compile_hint(arguments[0], arguments[1])
    if origin is np.ndarray and text is not None:
        (scalar,) = get_args(arguments[1]) or (np.generic,)
        scalar, has_shape = get_origin(scalar) or scalar, compile_shape(text)
        scalar = np.generic if scalar is Any else scalar

        def test_array(value: Any, sizes: Sizes) -> bool:
            # NumPy returns scalars for arrays without dimensions.
            is_array = isinstance(value, np.ndarray | np.generic)
            return (
                is_array and issubclass(value.dtype.type, scalar) and has_shape(value.shape, sizes)
            )

        return test_array
    tests = [compile_hint(argument, text) for argument in arguments]
    if origin is None or not any(tests):
        return None
    if origin in (Union, UnionType):
        types = tuple(
            get_origin(a) or a for a, test in zip(arguments, tests, strict=True) if not test
        )

        def test_union(value: Any, sizes: Sizes) -> bool:
            return isinstance(value, types) or any(test and test(value, sizes) for test in tests)

        return test_union
    if origin is tuple and Ellipsis not in arguments:

        def test_tuple(value: Any, sizes: Sizes) -> bool:
            pairs = zip(value, tests, strict=True)
            return all(test is None or test(item, sizes) for item, test in pairs)

        return test_tuple
    if origin in (list, tuple):
        return lambda value, sizes: all(tests[0](item, dict(sizes)) for item in value)  # type: ignore[misc]
    return None


@cache
def compile_fields(owner: type) -> dict[str, Test | None]:
    """Return the tests of the fields of a class; None for sizes, which are ints."""
    if "Shaped" not in str(inspect.get_annotations(owner)):
        return {}
    hints = get_type_hints(owner, include_extras=True)
    tests = {name: compile_hint(hint) for name, hint in hints.items()}
    return {name: test for name, test in tests.items() if test or hints[name] is int}


def describe(value: Any) -> str:
    """Return the types and shapes of the arrays in a value."""
    if isinstance(value, tuple | list):
        return f"({', '.join(map(describe, value))})"
    return f"{value.dtype}{list(value.shape)}" if hasattr(value, "dtype") else repr(value)[:50]


def check(value: Any, test: Test | None, sizes: Sizes, what: str) -> None:
    """Raise `ShapeError` if a value does not pass its test."""
    if test and not test(value, sizes):
        raise ShapeError(f"{what} is {describe(value)}, against its annotation, with {sizes}")


def check_fields(instance: object, owner: type) -> Sizes:
    """Check the fields of an object, and return the sizes of the names in them."""
    sizes: Sizes = {}
    for name, test in compile_fields(owner).items():
        value = getattr(instance, name)
        if test is None:
            sizes[name] = value
        check(value, test, sizes, f"{owner.__qualname__}.{name}")
    return sizes


def wrap(function: Callable[..., Any], owner: type | None = None) -> Callable[..., Any]:
    """Make a function check its arguments and results."""
    if "Shaped" not in str(function.__annotations__.values()):
        return function
    names, where = list(inspect.signature(function).parameters), function.__qualname__
    tests: dict[str, Test | None] = {}
    is_generator = inspect.isgeneratorfunction(function)

    def check_items(items: Iterator[Any], sizes: Sizes) -> Iterator[Any]:
        for item in items:
            check(item, tests["return"], dict(sizes), f"{where}: item")
            yield item

    @wraps(function)
    def checked(*args: Any, **kwargs: Any) -> Any:
        if not tests:
            for name, hint in get_type_hints(function, include_extras=True).items():
                is_item = is_generator and name == "return"
                tests[name] = compile_hint(get_args(hint)[0] if is_item else hint)
        sizes = check_fields(args[0], owner) if owner else {}
        for name, value in [*zip(names, args, strict=False), *kwargs.items()]:
            if isinstance(value, int):
                sizes[name] = value
            check(value, tests.get(name), sizes, f"{where}: {name}")
        result = function(*args, **kwargs)
        if is_generator:
            return check_items(result, sizes)
        check(result, tests.get("return"), sizes, f"{where}: result")
        return result

    return checked


def wrap_class(owner: Any) -> None:
    """Make a class check its fields, and the arguments and results of its methods."""
    for name, member in list(vars(owner).items()):
        if isinstance(member, FunctionType):
            # Fields do not exist before __init__.
            setattr(owner, name, wrap(member, None if name == "__init__" else owner))
        elif isinstance(member, classmethod):
            setattr(owner, name, classmethod(wrap(member.__func__)))
        elif isinstance(member, property):
            setattr(owner, name, property(wrap(member.fget, owner)))  # type: ignore[arg-type]
        elif isinstance(member, cached_property):
            member.func = wrap(member.func, owner)
    if not compile_fields(owner):
        return
    is_tuple = issubclass(owner, tuple)
    create = owner.__new__ if is_tuple else owner.__init__

    @wraps(create)
    def checked_create(first: Any, *args: Any, **kwargs: Any) -> Any:
        result = create(first, *args, **kwargs)
        check_fields(result if is_tuple else first, owner)
        return result

    if is_tuple:
        owner.__new__ = checked_create
        owner._make = classmethod(lambda cls, values: cls(*values))
    else:
        owner.__init__ = checked_create


class _Loader(SourceFileLoader):
    def exec_module(self, module: ModuleType) -> None:
        super().exec_module(module)
        for name, value in list(vars(module).items()):
            if getattr(value, "__module__", None) == module.__name__:
                if isinstance(value, FunctionType):
                    setattr(module, name, wrap(value))
                elif isinstance(value, type):
                    wrap_class(value)


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
