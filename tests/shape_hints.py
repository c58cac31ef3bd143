"""Write the tests of arrays by their type hints, as source code.

A *test* is the source code of an expression that tests the variable `value`, and adds new names of
dimensions to the dict `sizes`.  Nearly all time of the checks is spent in tests, so all those of a
function are compiled together (see `shapes`, which tells the notation, too).  Source code refers to
other objects by the names that `refer` returns.
"""

from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from functools import cache
from types import CodeType, UnionType
from typing import Annotated, Any, TypeAlias, Union, get_args, get_origin

import numpy as np

# The size of each name in a call.
Sizes: TypeAlias = dict[str, int]
Test: TypeAlias = str

# Values with one of these types cannot be checked without using them up, or calling them.
OPAQUE = {Callable, Generator, Iterable, Iterator}
_ARRAYS = (np.ndarray, np.generic)  # NumPy returns scalars for arrays without dimensions

# The objects to which source code refers, by name.
NAMESPACE: dict[str, Any] = {}


def refer(value: Any) -> str:
    """Return a name by which source code refers to an object, which is kept for ever."""
    name = f"{getattr(value, '__name__', 'object')}_{id(value)}"
    name = name if name.isidentifier() else f"object_{id(value)}"
    NAMESPACE[name] = value
    return name


def compile_test(test: Test) -> Callable[[Any, Sizes], bool]:
    """Compile a test to a function of the value and the sizes."""
    function: Callable[[Any, Sizes], bool] = eval(f"lambda value, sizes: {test}", NAMESPACE)
    return function


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
        condition = f"{size} == {refer(_evaluate)}({formula!r}, sizes)"
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


@cache
def _find_scalars(dtype: Any) -> frozenset[type]:
    """Find the types of the elements of arrays that are annotated with np.dtype[SCALAR]."""
    (scalar,) = get_args(dtype) or (np.generic,)
    if scalar is Any:
        scalars: tuple[type, ...] = (np.generic,)
    elif get_origin(scalar) in (Union, UnionType):
        scalars = get_args(scalar)
    else:
        scalars = (get_origin(scalar) or scalar,)
    return frozenset(each for each in np.sctypeDict.values() if issubclass(each, scalars))


def _write_array_test(dtype: Any, text: str) -> Test:
    """Write the test of an array of this shape, whose dtype is np.dtype[SCALAR]."""
    parts = text.split()
    start = parts.index("...") if "..." in parts else len(parts)
    dimensions = [part for part in parts if part != "..."]
    conditions = [
        f"isinstance(value, {refer(_ARRAYS)})",
        f"value.dtype.type in {refer(_find_scalars(dtype))}",
        f"len(shape := value.shape) {'>=' if '...' in parts else '=='} {len(dimensions)}",
    ]
    for index, dimension in enumerate(dimensions):
        place = index if index < start else index - len(dimensions)
        conditions.append(_write_condition(dimension, f"shape[{place}]"))
    return " and ".join(conditions)


def write_test(hint: Any, text: str | None = None) -> Test | None:
    """Write a test of the arrays in a value by its type hint; return None if it has no arrays.

    `text` is the shape that an enclosing hint states for all of them.

    Raises
    ------
    TypeError
        If the hint states a shape where none can be checked.
    """
    origin, arguments = get_origin(hint), get_args(hint)
    if origin is Annotated:
        test = write_test(arguments[0], arguments[1])
        if test is None:
            raise TypeError(f"{hint} has a shape, but no array")
        return test
    if origin is np.ndarray:
        return None if text is None else _write_array_test(arguments[1], text)
    if origin in OPAQUE:
        return None
    tests = [write_test(argument, text) for argument in arguments if argument is not Ellipsis]
    if not any(tests):
        return None
    if origin in (Union, UnionType):
        return _write_union_test(arguments, tests)
    if origin is tuple and Ellipsis not in arguments:
        return _write_tuple_test(tests)
    is_one_shape = text is not None
    if origin in (list, tuple, Sequence):
        return _write_items_test(tests[0], is_one_shape, lambda value: value)
    if origin in (dict, Mapping):
        return _write_items_test(tests[1], is_one_shape, lambda value: value.values())
    raise TypeError(f"{hint}: arrays in {origin} cannot be checked")


def _write_union_test(hints: Sequence[Any], shape_tests: Sequence[Test | None]) -> Test:
    """Write the test of a union of hints, of which at least one has a test."""
    pairs = list(zip(hints, shape_tests, strict=True))
    is_optional = type(None) in hints
    tests = [test or _write_type_test(hint) for hint, test in pairs if hint is not type(None)]
    if is_optional and len(tests) == 1:  # the usual case, for speed
        return f"(value is None or {tests[0]})"
    functions = [compile_test(test) for test in tests]

    def test_union(value: Any, sizes: Sizes) -> bool:
        if value is None:
            return is_optional
        for function in functions:
            trial_sizes = dict(sizes)
            if function(value, trial_sizes):
                sizes.update(trial_sizes)
                return True
        return False

    return f"{refer(test_union)}(value, sizes)"


def _write_type_test(hint: Any) -> Test:
    """Write the test of a hint without shapes, to tell it from the other hints of a union.

    What is not a class, such as Any or a type variable, accepts every value.
    """
    origin, arguments = get_origin(hint) or hint, get_args(hint)
    if origin is tuple and arguments and Ellipsis not in arguments:
        return _write_tuple_test([_write_type_test(argument) for argument in arguments])
    if origin is float:
        return "isinstance(value, int | float)"  # as for mypy
    if not isinstance(origin, type) or getattr(origin, "_is_protocol", False):
        return "True"
    return f"isinstance(value, {refer(origin)})"


def _write_tuple_test(tests: Sequence[Test | None]) -> Test:
    """Write the test of a tuple from a test, or None, for each item."""
    conditions = ["isinstance(value, tuple)", f"len(value) == {len(tests)}"]
    for index, test in enumerate(tests):
        if test:
            conditions.append(f"{refer(compile_test(test))}(value[{index}], sizes)")
    return " and ".join(conditions)


def _write_items_test(
    test: Test | None, is_one_shape: bool, list_items: Callable[[Any], Iterable[Any]]
) -> Test:
    assert test
    function = compile_test(test)

    def test_items(value: Any, sizes: Sizes) -> bool:
        return all(function(x, sizes if is_one_shape else dict(sizes)) for x in list_items(value))

    return f"{refer(test_items)}(value, sizes)"
