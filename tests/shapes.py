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
fields of its class.  Fields are checked when an object is created, and again whenever one of its
methods is called.  Results of generators are checked item by item: a name that occurs only there
may have another size in each item.  All other types are left to mypy.

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
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from functools import cache, cached_property, lru_cache, wraps
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder, SourceFileLoader
from types import CodeType, FunctionType, ModuleType, UnionType
from typing import (
    Annotated,
    Any,
    NamedTuple,
    TypeAlias,
    Union,
    get_args,
    get_origin,
    get_type_hints,
)

import numpy as np

# The size of each name in a call.
Sizes: TypeAlias = dict[str, int]
# Tests a value, and adds new names to the sizes.
Test: TypeAlias = Callable[[Any, Sizes], bool]

# Values with one of these types cannot be checked without using them up, or calling them.
_OPAQUE = {Callable, Generator, Iterable, Iterator}
_MISSING = object()


class ShapeError(AssertionError):
    """An array whose shape or type contradicts its annotation.

    It is no TypeError or ValueError, which the checked code may catch.
    """

    def __init__(self, place: str, value: Any, hint: Any, sizes: Sizes) -> None:
        super().__init__(f"{place} is {describe(value)}, but should be {hint} with {sizes}")


def _write_condition(dimension: str, size: str) -> str:
    """Return source code that compares the size of a dimension, and may add it to `sizes`.

    `dimension` is a part of a shape, and `size` is the source code of its size.
    """
    formula = dimension.removeprefix("#")
    name, _, increment = formula.partition("+")
    if formula.isdigit():
        condition = f"{size} == {formula}"
    elif name.isidentifier() and not increment:
        condition = f"sizes.setdefault({name!r}, {size}) == {size}"
    elif name.isidentifier() and increment.isdigit():
        rest = f"{size} - {increment}"
        condition = f"{rest} >= 0 and sizes.setdefault({name!r}, {rest}) == {rest}"
    else:
        condition = f"{size} == evaluate({formula!r}, sizes)"
    return f"({size} == 1 or {condition})" if dimension.startswith("#") else condition


@cache
def _compile_formula(formula: str) -> CodeType:
    return compile(formula, formula, "eval")


def _evaluate(formula: str, sizes: Sizes) -> int | None:
    """Return the value of a formula; None if it has a name whose size is not known."""
    try:
        return int(eval(_compile_formula(formula), {}, sizes))
    except NameError:
        return None


def _compile_array(dtype: Any, text: str) -> Test:
    """Compile the hint of an array of this shape, whose dtype is np.dtype[SCALAR].

    The test is generated as source code, since nearly all time of the checks is spent in it.
    """
    (scalar,) = get_args(dtype) or (np.generic,)
    if scalar is Any:
        scalars: tuple[type, ...] = (np.generic,)
    elif get_origin(scalar) in (Union, UnionType):
        scalars = get_args(scalar)
    else:
        scalars = (get_origin(scalar) or scalar,)
    parts = text.split()
    start = parts.index("...") if "..." in parts else len(parts)
    dimensions = [part for part in parts if part != "..."]
    conditions = [
        "isinstance(value, arrays)",
        "value.dtype.type in types",
        f"len(value.shape) {'>=' if '...' in parts else '=='} {len(dimensions)}",
    ]
    for index, dimension in enumerate(dimensions):
        place = index if index < start else index - len(dimensions)
        conditions.append(_write_condition(dimension, f"value.shape[{place}]"))
    names = {
        # NumPy returns scalars for arrays without dimensions.
        "arrays": (np.ndarray, np.generic),
        "types": {each for each in np.sctypeDict.values() if issubclass(each, scalars)},
        "evaluate": _evaluate,
    }
    test: Test = eval(f"lambda value, sizes: {' and '.join(conditions)}", names)
    return test


def compile_hint(hint: Any, text: str | None = None) -> Test | None:
    """Return a test of the arrays in a value by its type hint; None if there is nothing to test.

    Raises
    ------
    TypeError
        If the hint states a shape where none can be checked.
    """
    origin, arguments = get_origin(hint), get_args(hint)
    if origin is Annotated:
        test = compile_hint(arguments[0], arguments[1])
        if test is None:
            raise TypeError(f"{hint} has a shape, but no array")
        return test
    if origin is np.ndarray:
        return None if text is None else _compile_array(arguments[1], text)
    if origin in _OPAQUE:
        return None
    tests = [compile_hint(argument, text) for argument in arguments if argument is not Ellipsis]
    if not any(tests):
        return None
    if origin in (Union, UnionType):
        return _compile_union(arguments, tests)
    if origin is tuple and Ellipsis not in arguments:
        return _compile_tuple(tests)
    is_one_shape = text is not None
    if origin in (list, tuple, Sequence):
        return _compile_items(tests[0], is_one_shape, lambda value: value)
    if origin in (dict, Mapping):
        return _compile_items(tests[1], is_one_shape, lambda value: value.values())
    raise TypeError(f"{hint}: arrays in {origin} cannot be checked")


def _compile_union(hints: Sequence[Any], shape_tests: Sequence[Test | None]) -> Test:
    """Compile a union of hints, of which at least one has a test."""
    pairs = list(zip(hints, shape_tests, strict=True))
    is_optional = type(None) in hints
    tests = [test or _compile_type(hint) for hint, test in pairs if hint is not type(None)]
    if is_optional and len(tests) == 1:  # the usual case, for speed
        return lambda value, sizes: value is None or tests[0](value, sizes)

    def test_union(value: Any, sizes: Sizes) -> bool:
        if value is None:
            return is_optional
        for test in tests:
            trial_sizes = dict(sizes)
            if test(value, trial_sizes):
                sizes.update(trial_sizes)
                return True
        return False

    return test_union


def _compile_type(hint: Any) -> Test:
    """Compile a hint without shapes, to tell it from the other hints of a union.

    What is not a class, such as Any or a type variable, accepts every value.
    """
    origin, arguments = get_origin(hint) or hint, get_args(hint)
    if origin is tuple and arguments and Ellipsis not in arguments:
        return _compile_tuple([_compile_type(argument) for argument in arguments])
    if origin is float:
        origin = (int, float)  # as for mypy
    elif not isinstance(origin, type) or getattr(origin, "_is_protocol", False):
        return lambda value, sizes: True
    return lambda value, sizes: isinstance(value, origin)


def _compile_tuple(tests: Sequence[Test | None]) -> Test:
    """Compile a tuple with a test, or None, for each item; as source code, for speed."""
    conditions = ["isinstance(value, tuple)", f"len(value) == {len(tests)}"]
    conditions += [f"tests[{k}](value[{k}], sizes)" for k, test in enumerate(tests) if test]
    compiled: Test = eval(f"lambda value, sizes: {' and '.join(conditions)}", {"tests": tests})
    return compiled


def _compile_items(
    test: Test | None, is_one_shape: bool, list_items: Callable[[Any], Iterable[Any]]
) -> Test:
    assert test

    def test_items(value: Any, sizes: Sizes) -> bool:
        return all(test(x, sizes if is_one_shape else dict(sizes)) for x in list_items(value))

    return test_items


class _Fields(NamedTuple):
    """What is checked of the objects of a class."""

    sizes: list[str]  # names of the fields of type int
    # Name, test, place for messages, and annotation of each field with a shape.
    tests: list[tuple[str, Test, str, str]]


@cache
def compile_fields(owner: type) -> _Fields:
    """Find the sizes and compile the tests in the fields of a class and its bases."""
    annotations = [inspect.get_annotations(base) for base in reversed(owner.__mro__)]
    if "Shaped" not in str(annotations):
        return _Fields([], [])
    texts = {name: text for each in annotations for name, text in each.items()}
    hints = get_type_hints(owner, include_extras=True)
    tests = [
        (name, test, f"{owner.__qualname__}.{name}", texts[name])
        for name, hint in hints.items()
        if (test := compile_hint(hint))
    ]
    return _Fields(sizes=[name for name, hint in hints.items() if hint is int], tests=tests)


class _Signature(NamedTuple):
    """What is checked in the calls of a function."""

    # Index of each parameter with a shape among the arguments by position, its name, and its test.
    # The index of a parameter that is passed by name only is too large for any call.
    parameters: list[tuple[int, str, Test]]
    rest: tuple[str, Test] | None  # name of *args, and the test of each of them
    # The test of the result, or of each item if the function returns an iterator.
    result: Test | None
    is_iterator: bool
    # Parameters that may be sizes, as in `parameters`.
    sizes: list[tuple[int, str]]


@cache
def compile_function(function: Callable[..., Any]) -> _Signature:
    """Compile the tests of the arguments and of the result of a function."""
    hints = get_type_hints(function, include_extras=True)
    is_iterator = get_origin(hints.get("return")) in _OPAQUE - {Callable}
    if is_iterator:
        hints["return"] = get_args(hints["return"])[0]
    tests = {name: test for name, hint in hints.items() if (test := compile_hint(hint))}
    parameters = inspect.signature(function).parameters.values()
    rest = next((each.name for each in parameters if each.kind == each.VAR_POSITIONAL), "")
    places = {
        each.name: index if each.kind <= each.POSITIONAL_OR_KEYWORD else sys.maxsize
        for index, each in enumerate(parameters)
        if each.name != rest
    }
    words = set(re.findall(r"\w+", str(function.__annotations__.values())))
    return _Signature(
        parameters=[(places[name], name, tests[name]) for name in tests if name in places],
        rest=(rest, tests[rest]) if rest in tests else None,
        result=tests.get("return"),
        is_iterator=is_iterator,
        sizes=[(index, name) for name, index in places.items() if name in words],
    )


def describe(value: Any) -> str:
    """Return the types and shapes of the arrays in a value."""
    if isinstance(value, tuple | list):
        return f"({', '.join(map(describe, value))})"
    return f"{value.dtype}{list(value.shape)}" if hasattr(value, "dtype") else repr(value)[:50]


def check_fields(instance: object, owner: type, *, is_complete: bool = True) -> Sizes:
    """Check the fields of an object, and return the sizes of the names in them.

    Fields may be missing if the object is not complete: `__init__` may call methods.
    """
    names, tests = compile_fields(owner)
    sizes = {name: getattr(instance, name) for name in names if hasattr(instance, name)}
    for name, test, place, hint in tests:
        value = getattr(instance, name, _MISSING)
        if value is _MISSING and not is_complete:
            continue
        if not test(value, sizes):
            raise ShapeError(place, value, hint, sizes)
    return sizes


def wrap(function: Callable[..., Any], owner: type | None = None) -> Callable[..., Any]:
    """Make a function check its arguments and results.

    The names in the fields of a class, `owner`, are known if the first argument is an instance.
    """
    hints = function.__annotations__
    if "Shaped" not in str(hints.values()):
        return function
    place = function.__qualname__
    positional_count = function.__code__.co_argcount

    def check_items(items: Iterator[Any], test: Test, sizes: Sizes) -> Iterator[Any]:
        for item in items:
            item_sizes = dict(sizes)
            if not test(item, item_sizes):
                raise ShapeError(f"{place}: item", item, hints["return"], item_sizes)
            yield item

    @wraps(function)
    def checked(*args: Any, **kwargs: Any) -> Any:
        signature = compile_function(function)
        sizes = check_fields(args[0], owner, is_complete=False) if owner else {}
        for index, name in signature.sizes:
            value = args[index] if index < len(args) else kwargs.get(name)
            if isinstance(value, int):
                sizes[name] = value
        for index, name, test in signature.parameters:
            value = args[index] if index < len(args) else kwargs.get(name, _MISSING)
            if value is not _MISSING and not test(value, sizes):
                raise ShapeError(f"{place}: {name}", value, hints[name], sizes)
        if signature.rest:
            name, test = signature.rest
            for value in args[positional_count:]:
                if not test(value, sizes):
                    raise ShapeError(f"{place}: {name}", value, hints[name], sizes)
        result = function(*args, **kwargs)
        if signature.result is None:
            return result
        if signature.is_iterator:
            return check_items(result, signature.result, sizes)
        if not signature.result(result, sizes):
            raise ShapeError(f"{place}: result", result, hints["return"], sizes)
        return result

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
    if not compile_fields(owner).tests:
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
