"""The checker of shapes, on a module of small functions and classes of every kind."""

from __future__ import annotations

import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from types import ModuleType
from typing import Annotated as Shaped
from typing import Any

import numpy as np
import pytest
import shapes
from shape_hints import write_test
from shapes import ShapeError

SOURCE = """
from __future__ import annotations
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Annotated as Shaped
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.intp]
Triple = tuple[Floats, Floats, Floats]
Vector = tuple[float, float, float]

def argument(a: Shaped[Floats, "n"], b: Shaped[Floats, "3 n"]): pass
def keyword(*, a: Shaped[Floats, "n"], b: Shaped[Floats, "n"]): pass
def rest(a: Shaped[Floats, "n"], *arrays: Shaped[Floats, "n"], out: Shaped[Ints, "n"] | None): pass
def result(array: Shaped[Floats, "n"], value) -> Shaped[Floats, "n"]: return value
def pair(value) -> tuple[Shaped[Floats, "n"], Shaped[Ints, "n"]]: return value
def items(values) -> Iterator[Shaped[Ints, "k"]]: yield from values
def items_of(array: Shaped[Floats, "n"], values) -> Iterator[Shaped[Floats, "n"]]:
    yield from values
def iterator(values) -> Iterator[Shaped[Ints, "k"]]: return iter(values)
def vectors(a: Shaped[Triple, "n"]): pass
def one_shape(a: Shaped[list[Floats], "n"]): pass
def own_shapes(a: list[Shaped[Floats, "n n"]]): pass
def sequence(a: Sequence[Shaped[Floats, "n n"]], n: int): pass
def table(a: dict[str, Shaped[Floats, "2"]]): pass
def optional(a: Shaped[Floats, "n"], b: Shaped[Ints, "n"] | None = None): pass
def vector_or_vectors(a: Shaped[Triple, "n"] | Vector, b: Shaped[Floats, "n"]): pass
def array_or_slice(a: Shaped[Ints, "n"] | slice, b: Shaped[Floats, "n"]): pass
def array_or_number(a: Shaped[Floats, "n"] | float): pass
def alternatives(a: Shaped[Floats, "n n"] | Shaped[Floats, "n 2"], b: Shaped[Floats, "n"]): pass
def plus_one(a: Shaped[Floats, "n"], b: Shaped[Floats, "n+1"]): pass
def one_more(b: Shaped[Floats, "n+1"]): pass
def formula(a: Shaped[Floats, "n"], b: Shaped[Floats, "m"], c: Shaped[Floats, "2*n**2+m"]): pass
def size(a: Shaped[Floats, "n"], n: int): pass
def broadcast(a: Shaped[Floats, "n"], b: Shaped[Floats, "3 #n"]): pass
def ellipsis(a: Shaped[Floats, "3 ... n"]): pass
def scalar(a: Shaped[Floats, ""]): pass
def unknown_name(a: Shaped[Floats, "2*k"]): pass
TABLE = {"argument": argument}
@cache
def cached(size: int) -> Shaped[Floats, "size"]: return np.zeros(3)

class Named(NamedTuple):
    a: Shaped[Floats, "n"]
    b: Shaped[Ints, "n"] | None = None
    def compute(self, value) -> Shaped[Floats, "n"]: return value

@dataclass(frozen=True)
class Data:
    a: Shaped[Floats, "3 n"]
    count: int

    def method(self, b: Shaped[Floats, "n count"]): pass
    @property
    def by_property(self) -> Shaped[Floats, "n"]: return np.zeros(2)
    @cached_property
    def by_cached_property(self) -> Shaped[Floats, "n"]: return np.zeros(2)
    @staticmethod
    def static(a: Shaped[Floats, "n"]): pass
    @classmethod
    def of_class(cls, a: Shaped[Floats, "n"]): pass

@dataclass(frozen=True)
class Derived(Data):
    other: int = 0

class Plain:
    a: Shaped[Floats, "n"]
    b: Shaped[Floats, "n"]

    def __init__(self, a, b):
        self.a = a
        self.touch(np.zeros(1))
        self.b = b

    def touch(self, one: Shaped[Floats, "1"]): pass
    def method(self, c: Shaped[Floats, "n"]): pass
"""

# Arrays by shape; "i" is of another type.
F1, F2, F3 = np.zeros(1), np.zeros(2), np.zeros(3)
F02, F22, F23, F32, F33 = (np.zeros(shape) for shape in [(0, 2), (2, 2), (2, 3), (3, 2), (3, 3)])
I2, I3 = np.zeros(2, dtype=np.intp), np.zeros(3, dtype=np.intp)


@pytest.fixture(scope="module")
def module() -> ModuleType:
    """Return a module of `SOURCE`, whose shapes are checked."""
    module = ModuleType("module_of_shapes")
    sys.modules[module.__name__] = module
    exec(compile(SOURCE, module.__name__, "exec", dont_inherit=True), vars(module))
    shapes.wrap_module(module)
    return module


# Calls that pass, and calls that fail.  Each differs from one that passes in one thing alone.
Call = Callable[[Any], object]
PASSES: dict[str, Call] = {
    "argument": lambda m: m.argument(F2, F32),
    "keyword": lambda m: m.keyword(b=F2, a=F2),
    "rest": lambda m: m.rest(F2, F2, F2, out=I2),
    "result": lambda m: m.result(F2, F2),
    "pair": lambda m: m.pair((F2, I2)),
    "items of different sizes": lambda m: list(m.items([I2, I3])),
    "items of one size": lambda m: list(m.items_of(F2, [F2, F2])),
    "iterator": lambda m: list(m.iterator([I2, I3])),
    "vectors": lambda m: m.vectors((F2, F2, F2)),
    "one shape": lambda m: m.one_shape([F2, F2]),
    "own shapes": lambda m: m.own_shapes([F22, F33]),
    "sequence": lambda m: m.sequence((F22, F22), 2),
    "table": lambda m: m.table({"": F2}),
    "optional": lambda m: (m.optional(F2), m.optional(F2, None), m.optional(F2, I2)),
    "one vector": lambda m: m.vector_or_vectors((1, 2.0, 3.0), F2),
    "many vectors": lambda m: m.vector_or_vectors((F2, F2, F2), F2),
    "slice": lambda m: m.array_or_slice(slice(3), F2),
    "number": lambda m: m.array_or_number(1),
    "second alternative": lambda m: m.alternatives(F32, F3),
    "plus one": lambda m: m.plus_one(F2, F3),
    "formula": lambda m: m.formula(F1, F1, F3),
    "size": lambda m: m.size(F2, 2),
    "broadcast": lambda m: (m.broadcast(F2, F32), m.broadcast(F2, np.zeros((3, 1)))),
    "ellipsis": lambda m: (m.ellipsis(np.zeros((3, 7, 8, 2))), m.ellipsis(F32)),
    "scalar": lambda m: m.scalar(F2.sum()),
    "table of functions": lambda m: m.TABLE["argument"](F2, F32),
    "cached": lambda m: m.cached(3),
    "NamedTuple": lambda m: (m.Named(F2, I2), m.Named(F2), m.Named(F2).compute(F2)),
    "replaced field": lambda m: m.Named(F2, I2)._replace(a=F2),
    "dataclass": lambda m: m.Data(F32, 3).method(F23),
    "property": lambda m: (m.Data(F32, 3).by_property, m.Data(F32, 3).by_cached_property),
    "static method": lambda m: (m.Data.static(F2), m.Data.of_class(F2)),
    "plain class": lambda m: m.Plain(F2, F2).method(F2),
}
FAILS: dict[str, Call] = {
    "argument: size": lambda m: m.argument(F3, F32),
    "argument: number": lambda m: m.argument(F2, F22),
    "argument: dimensions": lambda m: m.argument(F2, F2),
    "argument: dtype": lambda m: m.argument(I2, F32),
    "argument: float32": lambda m: m.argument(F2.astype(np.float32), F32),
    "argument: no array": lambda m: m.argument([0.0, 0.0], F32),
    "keyword": lambda m: m.keyword(b=F2, a=F3),
    "rest: second of *args": lambda m: m.rest(F2, F2, F3, out=I2),
    "rest: keyword after *args": lambda m: m.rest(F2, F2, out=I3),
    "result": lambda m: m.result(F2, F3),
    "pair: size": lambda m: m.pair((F2, I3)),
    "pair: dtype": lambda m: m.pair((F2, F2)),
    "pair: three": lambda m: m.pair((F2, I2, I2)),
    "item: dtype": lambda m: list(m.items([I2, F2])),
    "item: size": lambda m: list(m.items_of(F2, [F2, F3])),
    "iterator": lambda m: list(m.iterator([F2])),
    "vectors": lambda m: m.vectors((F2, F2, F3)),
    "one shape": lambda m: m.one_shape([F2, F3]),
    "own shapes": lambda m: m.own_shapes([F22, F23]),
    "sequence": lambda m: m.sequence((F22, F33), 2),
    "table": lambda m: m.table({"": F3}),
    "optional: size": lambda m: m.optional(F2, I3),
    "optional: dtype": lambda m: m.optional(F2, F2),
    "optional: None": lambda m: m.optional(None),
    "vectors of a union": lambda m: m.vector_or_vectors((F3, F3, F3), F2),
    "vector of two": lambda m: m.vector_or_vectors((1.0, 2.0), F2),
    "array of a union": lambda m: m.array_or_slice(I3, F2),
    "neither of a union": lambda m: m.array_or_number("1"),
    "name of the second alternative": lambda m: m.alternatives(F32, F2),
    "plus one": lambda m: m.plus_one(F2, F2),
    "plus one: less than none": lambda m: m.one_more(np.zeros(0)),
    "formula": lambda m: m.formula(F1, F1, F2),
    "size of a later int": lambda m: m.size(F2, 3),
    "broadcast": lambda m: m.broadcast(F2, F33),
    "ellipsis: no dimension twice": lambda m: m.ellipsis(F3),
    "ellipsis: first": lambda m: m.ellipsis(F23),
    "scalar": lambda m: m.scalar(F1),
    "unknown name": lambda m: m.unknown_name(F2),
    "table of functions": lambda m: m.TABLE["argument"](F3, F32),
    "cached": lambda m: m.cached(2),
    "NamedTuple: size": lambda m: m.Named(F2, I3),
    "NamedTuple: dtype": lambda m: m.Named(I2),
    "NamedTuple: replaced": lambda m: m.Named(F2, I2)._replace(a=F3),
    "NamedTuple: result of a method": lambda m: m.Named(F2).compute(F3),
    "dataclass: field": lambda m: m.Data(F23, 3),
    "dataclass: field of the base": lambda m: m.Derived(F23, 3),
    "dataclass: name of a field": lambda m: m.Data(F32, 3).method(F33),
    "dataclass: size in a field": lambda m: m.Data(F32, 2).method(F23),
    "property": lambda m: m.Data(F33, 3).by_property,
    "cached property": lambda m: m.Data(F33, 3).by_cached_property,
    "static method": lambda m: m.Data.static(F22),
    "class method": lambda m: m.Data.of_class(F22),
    "plain class": lambda m: m.Plain(F2, F3),
    "plain class: name of an attribute": lambda m: m.Plain(F2, F2).method(F3),
}


@pytest.mark.parametrize("name", PASSES)
def test_correct_calls_pass(module: ModuleType, name: str) -> None:
    PASSES[name](module)


@pytest.mark.parametrize("name", FAILS)
def test_calls_against_an_annotation_fail(module: ModuleType, name: str) -> None:
    with pytest.raises(ShapeError):
        FAILS[name](module)


def test_attributes_are_checked_again_at_the_next_call(module: ModuleType) -> None:
    plain = module.Plain(F2, F2)
    plain.b = F3
    with pytest.raises(ShapeError, match=r"^Plain\.b is "):
        plain.method(F2)


def test_the_message_shows_value_annotation_and_sizes(module: ModuleType) -> None:
    with pytest.raises(ShapeError) as caught:
        module.argument(F3, F32)
    message = "argument: b is float64[3, 2], but should be Shaped[Floats, '3 n'] with {'n': 3}"
    assert str(caught.value) == message


@pytest.mark.parametrize(
    "hint",
    [
        Shaped[float, "n"],
        set[Shaped[np.ndarray[Any, np.dtype[Any]], "n"]],
    ],
)
def test_a_shape_that_cannot_be_checked_is_an_error(hint: Any) -> None:
    with pytest.raises(TypeError, match=r"no array|cannot be checked"):
        write_test(hint)


def test_threads_may_share_the_first_call(module: ModuleType) -> None:
    # All checks of a function are compiled by its first call.
    def call(size: int) -> list[str]:
        shapes.compile_function.cache_clear()
        failures = []
        for value in (np.zeros(size), np.zeros(size + 1)):
            try:
                module.result(np.zeros(size), value)
            except ShapeError as error:
                failures.append(str(error).rpartition(" with ")[2])
        return failures

    with ThreadPoolExecutor(8) as pool:
        failures = list(pool.map(call, range(400)))
    assert failures == [[f"{{'n': {size}}}"] for size in range(400)]
